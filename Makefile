# SPDX-License-Identifier: Apache-2.0
# Everything that is built lands under build/: build/<config>/{obj,lib,bin,tests}, build/third_party, build/venv.
#
#   make                 the library and the tool, optimised             make V=1      shows commands
#   make DEBUG=1         the same with -O0 and assertions                make help     lists the targets
#   make SAN=address,undefined                                           make windows, make linux-arm64: cross builds
#
# CC CXX CFLAGS CXXFLAGS LDFLAGS PREFIX DESTDIR are respected. Recipes run from this folder: weight files are found
# relative to it. The Makefile is not recursive; it calls itself only to build another configuration.

MAKEFLAGS += --no-builtin-rules
.SUFFIXES:
.DELETE_ON_ERROR:
.DEFAULT_GOAL := all

# ---- Configuration ----------------------------------------------------------------------------------------------------

# PLATFORM: linux, darwin or windows. Cross builds are windows by mingw-w64, and linux with another ARCH.
HOST_ARCH := $(patsubst arm64,aarch64,$(shell uname -m))
PLATFORM ?= $(if $(filter Darwin,$(shell uname -s)),darwin,linux)
ARCH ?= $(if $(filter windows,$(PLATFORM)),x86_64,$(HOST_ARCH))
ifeq ($(PLATFORM),windows)
CROSS := x86_64-w64-mingw32-
CROSS_NAME := windows
THREADS := -posix
RUN_TEST := scripts/wine.sh
EXE := .exe
else ifneq ($(ARCH),$(HOST_ARCH))
CROSS := $(ARCH)-linux-gnu-
CROSS_NAME := $(ARCH)
RUN_TEST := qemu-$(ARCH) -L /usr/$(ARCH)-linux-gnu
endif
CONFIG_ARCH := $(if $(CROSS),$(CROSS_NAME)-)
ifeq ($(origin CC),default)
CC := $(CROSS)gcc$(THREADS)
endif
ifeq ($(origin CXX),default)
CXX := $(CROSS)g++$(THREADS)
endif
ifeq ($(origin AR),default)
AR := $(CROSS)ar
endif

comma := ,
empty :=
space := $(empty) $(empty)
SAN ?=
ifneq ($(SAN),)
CONFIG := $(CONFIG_ARCH)san-$(subst $(comma),-,$(SAN))
OPTIMISE := -O1 -g -fno-omit-frame-pointer -fsanitize=$(SAN) -fno-sanitize-recover=all
LINK_SAN := -fsanitize=$(SAN)
else ifeq ($(DEBUG),1)
CONFIG := $(CONFIG_ARCH)debug
OPTIMISE := -O0 -g3
else
CONFIG := $(CONFIG_ARCH)release
OPTIMISE := -O3 -g1 -DNDEBUG
endif

# For the targets that call make again; make's own -j, where given, comes first.
JOBS ?= $(shell nproc 2>/dev/null || echo 2)
SUBMAKE = $(MAKE) $(if $(filter -j%,$(MAKEFLAGS)),,-j$(JOBS)) --no-print-directory

BUILD := build
OUT := $(BUILD)/$(CONFIG)
OBJ := $(OUT)/obj
PREFIX ?= /usr/local
LIBDIR ?= $(PREFIX)/lib
INCLUDEDIR ?= $(PREFIX)/include
BINDIR ?= $(PREFIX)/bin

# The numbers stand in quell.h alone.
version_part = $(shell sed -n 's/^\#define QUELL_VERSION_$(1) //p' include/quell.h)
VERSION_MAJOR := $(call version_part,MAJOR)
VERSION := $(VERSION_MAJOR).$(call version_part,MINOR).$(call version_part,PATCH)

V ?= 0
ifeq ($(V),1)
Q :=
say = @:
else
Q := @
say = @printf '  %-7s %s\n' $(1) $(2)
endif

# ---- Flags ------------------------------------------------------------------------------------------------------------

WARN := -Wall -Wextra -Wpedantic -Wshadow -Wconversion -Wundef -Wvla -Wwrite-strings -Wformat=2
WARN_C = $(WARN) -Wstrict-prototypes -Wmissing-prototypes
# Contraction of a * b + c would make results depend on the compiler: kernels ask for it by name where they want it.
MACHINE := -fPIC
DEFINES := -D_POSIX_C_SOURCE=200809L -DQUELL_BUILDING
ifeq ($(PLATFORM),windows)
# Windows aligns stacks to 16 bytes, and GCC does not align them further there (its bug 54412): the assembler's
# unaligned moves keep wide vectors that are spilled from faulting.
MACHINE := -Wa,-muse-unaligned-vector-move
# Windows 7's interface, and C's own printf instead of Microsoft's.
DEFINES += -D_WIN32_WINNT=0x0601 -D__USE_MINGW_ANSI_STDIO=1
# The compiler checks formats for Microsoft's printf all the same, and its isfinite converts.
WARN += -Wno-format -Wno-float-conversion
endif
COMMON := $(OPTIMISE) $(MACHINE) -fvisibility=hidden -ffp-contract=off -fno-math-errno -ffile-prefix-map=$(CURDIR)=. -MMD -MP
C_FLAGS = -std=c11 $(WARN_C) $(COMMON) $(DEFINES) -Iinclude -Isrc $(CPPFLAGS) $(CFLAGS)
# The tool is a program like any other: on Windows it imports what the library exports.
user_flag = $(if $(filter src/cli/%,$(1)),-UQUELL_BUILDING)
CXX_FLAGS = -std=c++17 $(WARN) $(COMMON) -Iinclude -Isrc $(CPPFLAGS) $(CXXFLAGS)

# One table of instruction sets: suffix of the source file -> flags, and the machine it is for.
ISA_FLAGS_avx2 := -mavx2 -mfma -mf16c
ISA_FLAGS_avx512 := -mavx512f -mavx512bw -mavx512dq -mavx512vl $(ISA_FLAGS_avx2)
ISA_FLAGS_avx512bf16 := -mavx512bf16 $(ISA_FLAGS_avx512)
ISA_FLAGS_neon :=
ISA_ARCH_avx2 := x86_64
ISA_ARCH_avx512 := x86_64
ISA_ARCH_avx512bf16 := x86_64
ISA_ARCH_neon := aarch64
ISAS := avx2 avx512 avx512bf16 neon
isa_flags = $(strip $(foreach isa,$(ISAS),$(if $(filter %_$(isa),$(basename $(1))),$(ISA_FLAGS_$(isa)))))
other_isas := $(foreach isa,$(ISAS),$(if $(filter $(ARCH),$(ISA_ARCH_$(isa))),,$(isa)))

# ---- Sources ----------------------------------------------------------------------------------------------------------

# Files that end in _posix.c or _windows.c are for those systems alone.
SYSTEM := $(if $(filter windows,$(PLATFORM)),windows,posix)
other_system := $(if $(filter windows,$(PLATFORM)),posix,windows)

LIB_FOLDERS := base kernels frame exr nn models filter plan denoise metrics api
LIB_SOURCES := $(foreach folder,$(LIB_FOLDERS),$(wildcard src/$(folder)/*.c))
LIB_SOURCES := $(filter-out $(foreach isa,$(other_isas),%_$(isa).c) %_$(other_system).c,$(LIB_SOURCES))
LIB_OBJECTS := $(LIB_SOURCES:%.c=$(OBJ)/%.o)
CLI_OBJECTS := $(patsubst %.c,$(OBJ)/%.o,$(filter-out %_$(other_system).c,$(wildcard src/cli/*.c)))
OIIO_OBJECTS := $(patsubst %.cpp,$(OBJ)/%.o,$(wildcard src/cli/*.cpp))

# Every weight file of the folder goes into the library under its name: the default, the other quell networks, the rest.
WEIGHTS_DIR ?= weights
DEFAULT_WEIGHTS := $(WEIGHTS_DIR)/quell-balanced.qwt
OTHER_WEIGHTS := $(filter-out $(DEFAULT_WEIGHTS),$(sort $(wildcard $(WEIGHTS_DIR)/*.qwt)))
WEIGHTS := $(DEFAULT_WEIGHTS) $(filter $(WEIGHTS_DIR)/quell-%,$(OTHER_WEIGHTS)) \
	$(filter-out $(WEIGHTS_DIR)/quell-%,$(OTHER_WEIGHTS))
WEIGHT_NAMES := $(basename $(notdir $(WEIGHTS)))
BUILTIN_LIST := $(OBJ)/weights/builtin_list.h
builtin_flags = $(if $(filter src/models/builtin.c,$(1)),-I$(dir $(BUILTIN_LIST)) -DQL_WEIGHTS_DIR='"$(WEIGHTS_DIR)"')

STATIC_LIB := $(OUT)/lib/libquell.a
ifeq ($(PLATFORM),windows)
SHARED_LIB := $(OUT)/bin/quell.dll
IMPORT_LIB := $(OUT)/lib/libquell.dll.a
else ifeq ($(PLATFORM),darwin)
SHARED_LIB := $(OUT)/lib/libquell.$(VERSION).dylib
SONAME := libquell.$(VERSION_MAJOR).dylib
DEVNAME := libquell.dylib
else
SHARED_LIB := $(OUT)/lib/libquell.so.$(VERSION)
SONAME := libquell.so.$(VERSION_MAJOR)
DEVNAME := libquell.so
endif
CLI := $(OUT)/bin/quell$(EXE)
OIIO_MODULE := $(OUT)/lib/quell/quell_oiio.so
# Cross builds have no OpenImageIO, and do without pictures.
PICTURES := $(if $(CROSS),,$(OIIO_MODULE))

# tests/<folder>/test_*.c are programs; other .c files of the folder are linked into each of them.
TEST_SOURCES := $(sort $(wildcard tests/*/test_*.c))
TESTS := $(TEST_SOURCES:tests/%.c=$(OUT)/tests/%$(EXE))
test_helpers = $(patsubst %.c,$(OBJ)/%.o,$(filter-out $(wildcard $(dir $(1))test_*.c),$(wildcard $(dir $(1))*.c))) \
	$(OBJ)/tests/system_$(SYSTEM).o

BENCH_SOURCES := $(wildcard bench/*.c)
BENCHES := $(BENCH_SOURCES:bench/%.c=$(OUT)/bench/%)

# ---- Libraries from elsewhere -----------------------------------------------------------------------------------------

# OpenEXR is always built here. cJSON and cmocka are the system's, but in cross builds, which have no such system.
FOREIGN := $(BUILD)/third_party
OPENEXR := $(FOREIGN)/openexr$(CROSS_NAME:%=-%)
OPENEXR_STAMP := $(OPENEXR)/stamp
ifneq ($(CROSS),)
TOOLCHAIN := $(CURDIR)/scripts/cmake/$(PLATFORM)-$(ARCH).cmake
CJSON := $(FOREIGN)/cjson-$(CROSS_NAME)
CJSON_STAMP := $(CJSON)/stamp
CJSON_FLAGS := -isystem $(CJSON)/include/cjson -DCJSON_HIDE_SYMBOLS
CJSON_LINK := $(CJSON)/lib/libcjson.a
CMOCKA := $(FOREIGN)/cmocka-$(CROSS_NAME)
CMOCKA_STAMP := $(CMOCKA)/stamp
CMOCKA_FLAGS := -isystem $(CMOCKA)/include
CMOCKA_LINK := $(CMOCKA)/lib/libcmocka-static.a
else
CJSON_FLAGS = $(patsubst -I%,-isystem %,$(shell pkg-config --cflags libcjson))
CJSON_LINK = $$(pkg-config --libs libcjson)
CMOCKA_LINK := -lcmocka
endif

# What OpenEXR and the library itself need of the system. Only on Linux is the C++ run-time library a matter of ours:
# on Windows all is static, on macOS it is a part of the system.
ifeq ($(PLATFORM),linux)
LIB_LINK = $$(cat $(OPENEXR)/link.flags) -lm -pthread
else
LIB_LINK = $(OPENEXR)/lib/libOpenEXRCore-3_5.a $(if $(filter windows,$(PLATFORM)),-static -lstdc++,-lc++) -lm -pthread
endif

$(OPENEXR)/stamp: scripts/build_openexr.sh
	$(call say,DEPS,OpenEXRCore)
	$(Q)env -u MAKEFLAGS -u CFLAGS -u CXXFLAGS $(TOOLCHAIN:%=CMAKE_TOOLCHAIN_FILE=%) scripts/build_openexr.sh $(OPENEXR)
	@touch $@

$(FOREIGN)/%-$(CROSS_NAME)/stamp: scripts/build_debian_source.sh
	$(call say,DEPS,$*)
	$(Q)env -u MAKEFLAGS -u CFLAGS CMAKE_TOOLCHAIN_FILE=$(TOOLCHAIN) scripts/build_debian_source.sh $* $(@D)
	@touch $@

# ---- Compile ----------------------------------------------------------------------------------------------------------

# Rebuild when the flags change, which no file's time would tell.
$(OBJ)/flags: FORCE
	@mkdir -p $(@D)
	@printf '%s\n' '$(subst ',,$(CC) $(CXX) $(C_FLAGS) $(CXX_FLAGS) $(LDFLAGS))' >$@.new
	@if cmp -s $@.new $@; then rm $@.new; else mv $@.new $@; fi

# Rewritten when the folder has other files, which no file's time would tell.
$(BUILTIN_LIST): FORCE
	@mkdir -p $(@D)
	@printf 'QL_BUILTIN(%s, "%s")\n' $(foreach name,$(WEIGHT_NAMES),$(subst -,_,$(name)) $(name)) >$@.new
	@if cmp -s $@.new $@; then rm $@.new; else mv $@.new $@; fi

$(OBJ)/%.o: %.c $(OBJ)/flags
	$(call say,CC,$<)
	@mkdir -p $(@D)
	$(Q)$(CC) $(C_FLAGS) $(call user_flag,$<) $(call isa_flags,$<) $(call builtin_flags,$<) $(EXTRA_FLAGS) -c $< -o $@

$(OBJ)/%.o: %.cpp $(OBJ)/flags
	$(call say,CXX,$<)
	@mkdir -p $(@D)
	$(Q)$(CXX) $(CXX_FLAGS) $(EXTRA_FLAGS) -c $< -o $@

$(OBJ)/src/exr/%.o: EXTRA_FLAGS := -isystem $(OPENEXR)/include
$(patsubst %.c,$(OBJ)/%.o,$(wildcard src/exr/*.c)): | $(OPENEXR_STAMP)
$(OBJ)/src/models/builtin.o: $(WEIGHTS) $(BUILTIN_LIST)
# For --version alone; quell.h does not speak of OpenEXR.
openexr_version = $(shell sed -n 's/^\#define OPENEXR_VERSION_STRING //p' $(OPENEXR)/include/OpenEXR/OpenEXRConfig.h)
$(OBJ)/src/cli/main.o: EXTRA_FLAGS = -DCLI_OPENEXR_VERSION='$(openexr_version)'
$(OBJ)/src/cli/main.o: | $(OPENEXR_STAMP)
$(addprefix $(OBJ)/src/cli/,bench.o json.o denoise.o inspect.o compare.o): EXTRA_FLAGS = $(CJSON_FLAGS)
$(CLI_OBJECTS): | $(CJSON_STAMP)
$(patsubst %.cpp,$(OBJ)/%.o,$(wildcard src/cli/*.cpp)): EXTRA_FLAGS = \
	$(patsubst -I%,-isystem %,$(shell pkg-config --cflags OpenImageIO)) -isystem /usr/include/Imath
$(OBJ)/tests/%.o: EXTRA_FLAGS := -Itests -isystem $(OPENEXR)/include $(CMOCKA_FLAGS) -UNDEBUG
$(patsubst %.c,$(OBJ)/%.o,$(filter-out tests/kernels/%,$(TEST_SOURCES))): | $(CMOCKA_STAMP)
$(OBJ)/bench/%.o: EXTRA_FLAGS := -Ibench

-include $(shell test -d $(OBJ) && find $(OBJ) -name '*.d')

# ---- Link -------------------------------------------------------------------------------------------------------------

$(STATIC_LIB): $(LIB_OBJECTS)
	$(call say,AR,$@)
	@mkdir -p $(@D)
	$(Q)rm -f $@ && $(AR) rcs$(if $(filter darwin,$(PLATFORM)),,D) $@ $(LIB_OBJECTS)

# The public names alone leave the library: by the list on Linux and macOS, by QUELL_API's dllexport on Windows.
ifeq ($(PLATFORM),windows)
STRIP := $(if $(filter 1,$(DEBUG)),,-s) # nothing on Windows reads this compiler's debug information but its own gdb
SHARED_FLAGS := $(STRIP) -Wl,--no-insert-timestamp -Wl,--out-implib,$(IMPORT_LIB) -Wl,--output-def,$(OUT)/lib/quell.def
CLI_LINK := $(STRIP) -municode -static -Wl,--no-insert-timestamp $(IMPORT_LIB)
else ifeq ($(PLATFORM),darwin)
SHARED_FLAGS := -Wl,-install_name,@rpath/$(SONAME) -Wl,-exported_symbol,_quell_*
CLI_LINK := -L$(OUT)/lib -lquell -Wl,-rpath,@loader_path/../lib
else
# Parts of the C++ run-time library that nothing calls would ask for a newer glibc: sections without use are left out.
SHARED_FLAGS := -Wl,-soname,$(SONAME) -Wl,--version-script=src/libquell.map -Wl,-z,defs -Wl,-z,relro -Wl,-z,now \
	-Wl,-z,noexecstack -Wl,--gc-sections
CLI_LINK := -L$(OUT)/lib -lquell -Wl,-rpath,'$$ORIGIN/../lib' -ldl
endif

$(SHARED_LIB): $(LIB_OBJECTS) src/libquell.map $(OPENEXR_STAMP)
	$(call say,LINK,$@)
	@mkdir -p $(@D) $(OUT)/lib
	$(Q)$(CC) -shared -o $@ $(LIB_OBJECTS) $(LINK_SAN) $(LDFLAGS) $(SHARED_FLAGS) $(LIB_LINK)
ifneq ($(PLATFORM),windows)
	$(Q)ln -sf $(notdir $@) $(@D)/$(SONAME) && ln -sf $(SONAME) $(@D)/$(DEVNAME)
endif

# The tool uses the public interface alone: it links against the shared library like any other program.
$(CLI): $(CLI_OBJECTS) $(SHARED_LIB)
	$(call say,LINK,$@)
	@mkdir -p $(@D)
	$(Q)$(CC) -o $@ $(CLI_OBJECTS) $(LINK_SAN) $(LDFLAGS) $(CLI_LINK) $(CJSON_LINK) -lm -pthread

# OpenImageIO is loaded only when a picture is written: see src/cli/image_oiio.h.
$(OIIO_MODULE): $(OIIO_OBJECTS)
	$(call say,LINK,$@)
	@mkdir -p $(@D)
	$(Q)$(CXX) -shared -o $@ $(OIIO_OBJECTS) $(LINK_SAN) $(LDFLAGS) $(if $(filter linux,$(PLATFORM)),-Wl$(comma)-z$(comma)defs) \
		$$(pkg-config --libs OpenImageIO)

.SECONDEXPANSION:
# The kernels stand on src/base alone, so that cross builds test them without the rest.
KERNEL_OBJECTS := $(filter $(OBJ)/src/base/% $(OBJ)/src/kernels/%,$(LIB_OBJECTS))
$(OUT)/tests/kernels/%$(EXE): $(OBJ)/tests/kernels/%.o $$(call test_helpers,tests/kernels/%.c) $(KERNEL_OBJECTS)
	$(call say,LINK,$@)
	@mkdir -p $(@D)
	$(Q)$(CC) -o $@ $^ $(LINK_SAN) $(LDFLAGS) $(if $(filter windows,$(PLATFORM)),-static) -lm -pthread

$(OUT)/tests/%$(EXE): $(OBJ)/tests/%.o $$(call test_helpers,tests/%.c) $(STATIC_LIB) $(OPENEXR_STAMP)
	$(call say,LINK,$@)
	@mkdir -p $(@D)
	$(Q)$(CC) -o $@ $(filter %.o,$^) $(STATIC_LIB) $(LINK_SAN) $(LDFLAGS) $(LIB_LINK) $(CMOCKA_LINK)

$(OUT)/bench/%: $(OBJ)/bench/%.o $(STATIC_LIB) $(OPENEXR_STAMP)
	$(call say,LINK,$@)
	@mkdir -p $(@D)
	$(Q)$(CC) -o $@ $< $(STATIC_LIB) $(LINK_SAN) $(LDFLAGS) $(LIB_LINK)

# ---- Python environment -----------------------------------------------------------------------------------------------

VENV := $(BUILD)/venv
PYTHON := $(VENV)/bin/python

$(VENV)/stamp-%: scripts/requirements-%.txt
	$(call say,VENV,$<)
	$(Q)test -x $(PYTHON) || python3 -m venv $(VENV)
	$(Q)$(PYTHON) -m pip install --quiet --disable-pip-version-check -r $<
	@touch $@

# ---- Python package ---------------------------------------------------------------------------------------------------

WHEEL := $(OUT)/wheel

# This machine's platform is auditwheel's to name; Debian 12's cross compiler links against glibc 2.36.
WHEEL_PLATFORM := $(if $(CROSS),$(if $(filter windows,$(PLATFORM)),win_amd64,manylinux_2_36_$(ARCH)))

# The wheel, and beside it in site/ what installing it leaves, for tests.
$(WHEEL)/stamp: $(SHARED_LIB) scripts/build_wheel.py $(wildcard python/* python/quell/*.py) $(VENV)/stamp-wheel
	$(call say,WHEEL,quell)
	$(Q)rm -rf $(WHEEL)
	$(Q)$(PYTHON) scripts/build_wheel.py --library $(SHARED_LIB) $(WHEEL_PLATFORM:%=--platform %) \
		--third-party $(OPENEXR)/LICENSES --out $(WHEEL) >/dev/null
	$(Q)$(PYTHON) -m pip install --quiet --disable-pip-version-check --no-deps --only-binary=:all: \
		$(WHEEL_PLATFORM:%=--platform %) --target $(WHEEL)/site $(WHEEL)/*.whl
	@touch $@

ADDON := $(OUT)/addon

$(ADDON)/stamp: $(WHEEL)/stamp scripts/build_addon.py $(shell find blender_addon -name '*.py' -o -name '*.toml' -o -name '*.md')
	$(call say,ADDON,quell)
	$(Q)rm -rf $(ADDON)
	$(Q)$(PYTHON) scripts/build_addon.py --wheel $(WHEEL)/*.whl --out $(ADDON) >/dev/null
	@touch $@

# Blender as a module insists on an older NumPy, so it lives apart.
RENDER_VENV := $(BUILD)/venv-render

$(RENDER_VENV)/stamp: scripts/requirements-render.txt
	$(call say,VENV,$<)
	$(Q)test -x $(@D)/bin/python || python3 -m venv $(@D)
	$(Q)$(@D)/bin/python -m pip install --quiet --disable-pip-version-check -r $<
	@touch $@

# ---- Targets ----------------------------------------------------------------------------------------------------------

## all: the library and the tool (the default)
all: lib cli

## lib: libquell.so and libquell.a
lib: $(SHARED_LIB) $(STATIC_LIB)

## cli: the quell tool
cli: $(CLI) $(PICTURES)

## wheel: the Python package with the library inside, build/<config>/wheel/*.whl
wheel: $(WHEEL)/stamp

## addon: the Blender add-on: an extension (4.2 and later) and a legacy zip (3.4 to 4.1) in build/<config>/addon
addon: $(ADDON)/stamp

## c-tests: build the C test programs without running them
c-tests: $(TESTS)

## check: the quick tests, all in C, and the warnings of every source as errors (under a minute once built)
check: syntax run-c-tests

## test: install what tests need, build, and run every test (WITHOUT_TRAINING=1: without PyTorch and Blender)
test: deps-test
	$(Q)+$(SUBMAKE) all c-tests $(if $(wildcard bench/*.c),benches) addon $(VENV)/stamp-test
ifeq ($(WITHOUT_TRAINING),)
	$(Q)+$(SUBMAKE) $(VENV)/stamp-training || echo "PyTorch could not be installed: the tests of training are skipped"
	$(Q)+$(SUBMAKE) $(RENDER_VENV)/stamp || echo "Blender could not be installed: the test that renders is skipped"
endif
	$(Q)QUELL_BUILD=$(OUT) $(PYTHON) -m pytest tests --ignore=tests/blender --ignore=tests/farm --ignore=tests/cross $(PYTEST_FLAGS)

## test-blender: the add-on in Debian's Blender and a few of PyPI's (1 GB each, into build/blender); the farm samples
test-blender: BLENDERS ?= 4.2 5.0 5.2
## test-blender-all: the same in every version that there is
test-blender-all: BLENDERS ?= 4.2 4.3 4.4 4.5 5.0 5.1 5.2
test-blender test-blender-all: deps-blender
	$(Q)+$(SUBMAKE) cli addon $(VENV)/stamp-test $(VENV)/stamp-farm
	$(Q)+$(SUBMAKE) types
	$(Q)scripts/install_blenders.sh $(BUILD)/blender $(BLENDERS)
	$(Q)QUELL_BUILD=$(OUT) $(PYTHON) -m pytest tests/blender tests/farm $(PYTEST_FLAGS)

TYPES := $(BUILD)/types

## types: the add-on against the types of the oldest and the newest Blender
types: $(TYPES)/stamp
	$(Q)for version in $(BPY_TYPES); do echo "bpy $$version"; \
		MYPYPATH=$(TYPES)/$$version $(PYTHON) -m mypy --cache-dir=$(TYPES)/cache-$$version blender_addon || exit 1; done

BPY_TYPES := 3-4 5-2
$(TYPES)/stamp: $(VENV)/stamp-types
	$(Q)for version in $(BPY_TYPES); do $(PYTHON) -m pip install --quiet --disable-pip-version-check --no-deps --upgrade \
		--target $(TYPES)/$$version "fake-bpy-module-$$version" || exit 1; done
	@touch $@

## test-long: the tests, and again under the address, undefined-behaviour and thread sanitizers
test-long: test stress
	$(Q)+$(SUBMAKE) asan
	$(Q)+$(SUBMAKE) ubsan
	$(Q)+$(SUBMAKE) tsan

## stress: numerical stability over the whole grid of sizes, bad values, exposures and missing passes, as a table
stress: $(OUT)/tests/stress/test_stress
	$(Q)QUELL_STRESS=all $<

## stability: samples with something wrong put into them, beside Open Image Denoise: docs/stability.md (ten minutes)
stability: deps-bench
	$(Q)+$(SUBMAKE) all $(VENV)/stamp-bench
	$(Q)$(PYTHON) bench/stability.py --build $(OUT)

## asan: the C tests, and the tool's, under the address sanitizer
asan: SANITIZER := address
## ubsan: the same under the undefined-behaviour sanitizer
ubsan: SANITIZER := undefined
asan ubsan: deps-test
	$(Q)+$(SUBMAKE) SAN=$(SANITIZER) all check $(VENV)/stamp-test
	$(Q)QUELL_BUILD=$(BUILD)/san-$(SANITIZER) $(PYTHON) -m pytest tests/cli tests/metrics $(PYTEST_FLAGS)

## tsan: the C tests under the thread sanitizer
tsan:
	$(Q)+$(SUBMAKE) SAN=thread check

## qemu: cross build the kernels for aarch64 and run their tests under qemu
qemu:
	$(Q)+$(SUBMAKE) ARCH=aarch64 cross-check

KERNEL_TESTS := $(filter $(OUT)/tests/kernels/%,$(TESTS))
cross-check: $(KERNEL_TESTS)
	$(Q)QUELL_TEST_RUNNER="$(RUN_TEST)" scripts/run_c_tests.sh $(KERNEL_TESTS)

## windows: cross build quell.exe and quell.dll with mingw-w64, into build/windows-release
windows: deps-windows
	$(Q)+$(SUBMAKE) PLATFORM=windows all

## linux-arm64: cross build the library and the tool for 64-bit ARM, into build/aarch64-release
linux-arm64: deps-arm64
	$(Q)+$(SUBMAKE) ARCH=aarch64 all

## test-windows: the C tests, the tool's and the samples on the Windows build under Wine; the same bits as on Linux
test-windows: deps-test deps-windows
	$(Q)+$(SUBMAKE) all $(VENV)/stamp-test
	$(Q)+$(SUBMAKE) PLATFORM=windows all c-tests wheel windows-zip
	$(Q)+$(MAKE) --no-print-directory PLATFORM=windows run-c-tests
	$(Q)QUELL_BUILD=$(BUILD)/windows-release $(PYTHON) -m pytest tests/cross/test_windows.py tests/cli $(PYTEST_FLAGS)

## test-arm64: a sample on the ARM build under qemu, bit-equal to this machine's C kernels
test-arm64: deps-test deps-arm64
	$(Q)+$(SUBMAKE) all $(VENV)/stamp-test
	$(Q)+$(SUBMAKE) ARCH=aarch64 all
	$(Q)QUELL_BUILD=$(BUILD)/aarch64-release $(PYTHON) -m pytest tests/cross/test_arm64.py $(PYTEST_FLAGS)

run-c-tests: $(TESTS)
	$(Q)QUELL_TEST_RUNNER="$(RUN_TEST)" scripts/run_c_tests.sh $(TESTS)

## demo: install what is needed, build, denoise the samples and compare them with their references
demo: deps-demo
	$(Q)+$(SUBMAKE) all $(VENV)/stamp-demo
	$(Q)+$(SUBMAKE) $(VENV)/stamp-peer || echo "Open Image Denoise could not be installed: its columns stay empty"
	$(Q)$(PYTHON) scripts/demo.py --quell $(CLI) --out $(BUILD)/demo

.PHONY: train-smoke deps-train
## train-smoke: render two tiny scenes, train a few steps, export, compare the library with PyTorch
train-smoke: deps-train
	$(Q)+$(SUBMAKE) all $(VENV)/stamp-test $(VENV)/stamp-training $(RENDER_VENV)/stamp
	$(Q)rm -rf $(BUILD)/smoke
	$(Q)$(PYTHON) -m training.smoke --renderer $(RENDER_VENV)/bin/python --quell $(CLI) --out $(BUILD)/smoke

benches: $(BENCHES)

## bench-peers: error, time and memory beside Open Image Denoise: bench/results/*.csv, docs/benchmarks.md (an hour)
bench-peers: BENCH_OUT :=
## bench-quick: a small part of it in two minutes, under build/bench/
bench-quick: BENCH_OUT := $(BUILD)/bench
## bench: time and memory by size and by layers, whole jobs beside a copy by oiiotool, without the peer (ten minutes)
bench: BENCH_OUT :=
bench: BENCH_FLAGS ?= --no-peer --runs 3 --only layers,resolution,job
bench bench-peers bench-quick: deps-bench
	$(Q)+$(SUBMAKE) all $(VENV)/stamp-bench
	$(Q)$(PYTHON) bench/peers.py --build $(OUT) $(if $(BENCH_OUT),--quick --results $(BENCH_OUT)/results) $(BENCH_FLAGS)
	$(Q)$(PYTHON) bench/report.py $(if $(BENCH_OUT),--results $(BENCH_OUT)/results --out $(BENCH_OUT)/docs)

## bench-blender: the add-on beside Cycles' own denoiser, in Blender: bench/results/blender_*.csv, docs/blender.md
bench-blender: deps-bench deps-blender
	$(Q)+$(SUBMAKE) addon $(VENV)/stamp-bench
	$(Q)scripts/install_blenders.sh $(BUILD)/blender 4.5 5.0
	$(Q)$(PYTHON) bench/blender.py --addon $(ADDON) $(BENCH_FLAGS)

# A Python with what training needs (training/README.md) and the runs of training/dgan/runs.py.
TRAINING_PYTHON ?= python3
## ablation: measure the parts of DGAN-KPN on the samples and write the tables of docs/ablation.md
ablation: all
	$(Q)$(TRAINING_PYTHON) -m training.dgan.ablation --quell $(CLI)

## deps-demo deps-test deps-bench deps-blender deps-windows deps-arm64 deps-train: only install what those targets need
deps-demo deps-test deps-bench deps-blender deps-windows deps-arm64 deps-train: deps-%:
	$(Q)scripts/install_deps.sh $*

## install: library, header, pkg-config file and tool under $(DESTDIR)$(PREFIX)
install: all
	$(call say,INSTALL,$(DESTDIR)$(PREFIX))
	$(Q)install -d $(DESTDIR)$(LIBDIR)/pkgconfig $(DESTDIR)$(INCLUDEDIR) $(DESTDIR)$(BINDIR) \
		$(DESTDIR)$(PREFIX)/share/doc/quell
	$(Q)install -m 755 $(SHARED_LIB) $(DESTDIR)$(LIBDIR)/
	$(Q)ln -sf $(notdir $(SHARED_LIB)) $(DESTDIR)$(LIBDIR)/$(SONAME)
	$(Q)ln -sf $(SONAME) $(DESTDIR)$(LIBDIR)/$(DEVNAME)
	$(Q)install -m 644 include/quell.h $(DESTDIR)$(INCLUDEDIR)/
	$(Q)install -m 755 $(CLI) $(DESTDIR)$(BINDIR)/
	$(Q)install -d $(DESTDIR)$(PREFIX)/lib/quell && install -m 755 $(OIIO_MODULE) $(DESTDIR)$(PREFIX)/lib/quell/
	$(Q)sed -e 's|@PREFIX@|$(PREFIX)|; s|@LIBDIR@|$(LIBDIR)|; s|@INCLUDEDIR@|$(INCLUDEDIR)|; s|@VERSION@|$(VERSION)|' \
		quell.pc.in >$(DESTDIR)$(LIBDIR)/pkgconfig/quell.pc
	$(Q)install -m 644 LICENSE README.md docs/cli.md $(DESTDIR)$(PREFIX)/share/doc/quell/
	$(Q)if test -d $(OPENEXR)/LICENSES; then cp -R $(OPENEXR)/LICENSES $(DESTDIR)$(PREFIX)/share/doc/quell/; fi

## dist: a source archive of the committed tree
dist:
	@mkdir -p $(BUILD)
	$(Q)git archive --format=tar.gz --prefix=quell-$(VERSION)/ -o $(BUILD)/quell-$(VERSION).tar.gz HEAD
	@echo $(BUILD)/quell-$(VERSION).tar.gz

# What the mingw-w64 programs contain of others: OpenEXR and its codecs, cJSON, and mingw-w64's own run-time libraries.
MINGW_LICENSE := /usr/share/doc/mingw-w64-x86-64-dev/copyright
DIST_WINDOWS := quell-$(VERSION)-windows-x86_64

## dist-windows: a zip with tool, library, header, import library and licences
dist-windows: windows
	$(Q)+$(SUBMAKE) PLATFORM=windows windows-zip

windows-zip: all
	$(Q)rm -rf $(OUT)/dist && mkdir -p $(OUT)/dist/$(DIST_WINDOWS)/LICENSES
	$(Q)cp $(CLI) $(SHARED_LIB) include/quell.h $(IMPORT_LIB) $(OUT)/lib/quell.def LICENSE README.md docs/cli.md \
		$(OUT)/dist/$(DIST_WINDOWS)/
	$(Q)cp $(OPENEXR)/LICENSES/* $(OUT)/dist/$(DIST_WINDOWS)/LICENSES/
	$(Q)cp $(CJSON)/LICENSE $(OUT)/dist/$(DIST_WINDOWS)/LICENSES/cJSON
	$(Q)cp $(MINGW_LICENSE) $(OUT)/dist/$(DIST_WINDOWS)/LICENSES/mingw-w64
	$(Q)cd $(OUT)/dist && cmake -E tar cf $(DIST_WINDOWS).zip --format=zip $(DIST_WINDOWS)
	@echo $(OUT)/dist/$(DIST_WINDOWS).zip

FORMATTED := $(wildcard include/*.h src/*/*.[ch] src/*/*.cpp tests/*/*.[ch] samples/*.c bench/*.c)

## format: reformat the C, C++ and Python sources in place
format:
	$(Q)clang-format -i $(FORMATTED)
	$(Q)if command -v ruff >/dev/null; then ruff format scripts tests bench training python blender_addon; fi

## lint: the arrows between folders, warnings as errors, and the formatting
lint: syntax
	$(Q)python3 tests/check_includes.py
	$(Q)clang-format --dry-run -Werror $(FORMATTED)
	$(Q)if command -v ruff >/dev/null; then ruff check scripts tests bench training python blender_addon; fi

# Warnings are errors here and only here: a new compiler's warning must not break somebody's build.
SYNTAX := $(LIB_SOURCES:%=$(OBJ)/%.syntax)
syntax: $(SYNTAX)
$(OBJ)/%.syntax: % $(OBJ)/flags | $(OPENEXR_STAMP) $(BUILTIN_LIST)
	@mkdir -p $(@D)
	$(Q)$(CC) $(C_FLAGS) $(call isa_flags,$<) $(call builtin_flags,$<) -isystem $(OPENEXR)/include -Werror -fsyntax-only -MT $@ -MF $@.d $<
	@touch $@

## clean: remove this configuration's results (build/third_party and build/venv stay)
clean:
	$(Q)rm -rf $(OUT)

## distclean: remove everything under build/
distclean:
	$(Q)rm -rf $(BUILD)

## help: this list
help:
	@sed -n 's/^## \([^:]*\): /\1\t/p' $(firstword $(MAKEFILE_LIST)) | expand -t 34

.PHONY: types ablation all lib cli wheel addon c-tests run-c-tests check test test-long stress stability asan ubsan tsan qemu cross-check demo benches bench bench-peers \
	bench-quick bench-blender deps-demo deps-test deps-bench deps-blender test-blender test-blender-all install dist format lint syntax \
	clean distclean windows linux-arm64 dist-windows windows-zip test-windows test-arm64 deps-windows deps-arm64 help FORCE
.SECONDARY:
