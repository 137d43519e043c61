#!/bin/sh
# SPDX-License-Identifier: Apache-2.0
# build_openexr.sh DEST - builds OpenEXRCore 3.5.3, the only part of OpenEXR that Quell uses, as a static library.
#
# Why not the system's: Debian 12 has 3.1.5, which cannot decode DWAA and DWAB, silently misreads multi-part B44 files
# and does not know HTJ2K. The source package `OpenEXR` of the Python registry holds 3.5.3 with all its codecs inside.
#
# Makes:
#   DEST/include/OpenEXR/*.h         headers, to be included as <OpenEXR/openexr.h> with -isystem DEST/include
#   DEST/lib/libOpenEXRCore-3_5.a    position independent, hidden symbols, libdeflate, zstd and OpenJPH inside
#   DEST/link.flags                  one line: what to append to a C link command
#   DEST/LICENSES/                   the licences of everything in the archive
#
# Does nothing when DEST is already built by this script with the same compiler and flags. Environment, all optional:
#   CMAKE_TOOLCHAIN_FILE   for cross builds
#   CC CXX CFLAGS CXXFLAGS as cmake understands them
#   IMATH_INCLUDE          folder of Imath's headers, where it is not the system's
#   OPENEXR_ARCHIVE        path of openexr-3.5.3.tar.gz, to build without a network
#   JOBS                   parallel compile jobs (default: number of cores)
set -eu

version=3.5.3
sha256=5645cc5493802832860a715ceb621139b44ee867084cec1501a2b8685e40d88a
archive_name=openexr-$version.tar.gz

die() {
    echo "build_openexr.sh: $*" >&2
    exit 1
}

[ $# -eq 1 ] && [ -n "$1" ] || die "usage: build_openexr.sh DEST"
mkdir -p "$1" || die "cannot make the folder $1"
dest=$(cd "$1" && pwd)
self=$(cd "$(dirname "$0")" && pwd)/$(basename "$0")

key="$sha256 $(cksum <"$self") ${CC:-} ${CXX:-} ${CFLAGS:-} ${CXXFLAGS:-} ${CMAKE_TOOLCHAIN_FILE:-}"
if [ -f "$dest/stamp" ] && [ "$(cat "$dest/stamp")" = "$key" ] && [ -f "$dest/lib/libOpenEXRCore-3_5.a" ]; then
    exit 0
fi

for tool in cmake tar sha256sum; do
    command -v "$tool" >/dev/null 2>&1 ||
        die "'$tool' is missing (Debian and Ubuntu: apt-get install cmake g++ libimath-dev python3-pip)"
done

work=$dest/work
log=$dest/build.log
rm -rf "$work" "$dest/stamp"
mkdir -p "$work"
: >"$log"
trap 'rm -rf "$work"' EXIT
trap 'exit 1' HUP INT TERM

step() { # step DESCRIPTION COMMAND...: runs it into the log, and shows the log's end when it fails
    what=$1
    shift
    "$@" >>"$log" 2>&1 || {
        tail -n 25 "$log" >&2
        die "$what failed; the whole log is in $log"
    }
}

checked() { # checked FILE: whether it is the archive that we know
    [ -f "$1" ] && [ "$(sha256sum <"$1" | cut -d ' ' -f 1)" = "$sha256" ]
}

cached=$dest/$archive_name
if [ -n "${OPENEXR_ARCHIVE:-}" ]; then
    checked "$OPENEXR_ARCHIVE" || die "$OPENEXR_ARCHIVE is missing or is not $archive_name (SHA-256 $sha256)"
    cached=$OPENEXR_ARCHIVE
elif ! checked "$cached"; then
    python3 -m pip --version >/dev/null 2>&1 ||
        die "python3 has no pip, which fetches the sources (Debian and Ubuntu: apt-get install python3-pip);
  or set OPENEXR_ARCHIVE to the path of $archive_name"
    echo "fetching the OpenEXR $version source package" >&2
    # pip insists on running the package's build backend for its metadata. A stand-in that answers with name and
    # version spares it from fetching that backend (and, where there is none, a cmake).
    mkdir -p "$work/backend/scikit_build_core" "$work/download"
    : >"$work/backend/scikit_build_core/__init__.py"
    cat >"$work/backend/scikit_build_core/build.py" <<PY
import pathlib


def prepare_metadata_for_build_wheel(folder, config_settings=None):
    info = pathlib.Path(folder) / "openexr-$version.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: OpenEXR\nVersion: $version\n")
    (info / "WHEEL").write_text("Wheel-Version: 1.0\nGenerator: none\nRoot-Is-Purelib: true\nTag: py3-none-any\n")
    return info.name


def build_wheel(folder, config_settings=None, metadata_directory=None):
    raise RuntimeError("metadata only")
PY
    fetch() {
        python3 -m pip download --quiet --no-deps --no-binary OpenEXR --dest "$work/download" "$@" "OpenEXR==$version"
    }
    PYTHONPATH="$work/backend${PYTHONPATH:+:$PYTHONPATH}" fetch --no-build-isolation >>"$log" 2>&1 ||
        step "fetching the sources with pip (is there a network?)" fetch
    checked "$work/download/$archive_name" ||
        die "the downloaded $archive_name is not the one we know (SHA-256 should be $sha256)"
    mv "$work/download/$archive_name" "$cached"
fi

echo "building OpenEXRCore $version" >&2
step "unpacking the sources" tar -xzf "$cached" -C "$work"
source=$work/openexr-$version

# Of Imath, OpenEXRCore uses the half type alone, from five headers that no machine type changes. A cmake package made
# of them serves cross builds too, where the build machine's own package would bring its own library along.
imath=${IMATH_INCLUDE:-/usr/include/Imath}
[ -f "$imath/half.h" ] || imath=$(pkg-config --variable=includedir Imath 2>/dev/null || true)/Imath
[ -f "$imath/half.h" ] || die "Imath's headers are missing (Debian and Ubuntu: apt-get install libimath-dev)"
mkdir -p "$work/imath/include/Imath"
for header in half.h ImathConfig.h ImathExport.h ImathNamespace.h ImathPlatform.h; do
    cp "$imath/$header" "$work/imath/include/Imath/"
done
cat >"$work/imath/ImathConfig.cmake" <<'CMAKE'
set(Imath_VERSION 3.1.0)
set(Imath_VERSION_MAJOR 3)
set(Imath_VERSION_MINOR 1)
set(Imath_VERSION_PATCH 0)
if(NOT TARGET Imath::Imath)
  add_library(Imath::Imath INTERFACE IMPORTED)
  add_library(Imath::ImathConfig INTERFACE IMPORTED)
  foreach(target Imath::Imath Imath::ImathConfig)
    set_target_properties(${target} PROPERTIES
      INTERFACE_INCLUDE_DIRECTORIES "${CMAKE_CURRENT_LIST_DIR}/include;${CMAKE_CURRENT_LIST_DIR}/include/Imath")
  endforeach()
endif()
CMAKE
cat >"$work/imath/ImathConfigVersion.cmake" <<'CMAKE'
set(PACKAGE_VERSION 3.1.0)
set(PACKAGE_VERSION_COMPATIBLE TRUE)
CMAKE

# EMBEDDED marks every exr_ function hidden, so that none can leave libquell.so.
flags="-ffile-prefix-map=$source=openexr-$version -DOPENEXR_CORE_FUNCTIONS_EMBEDDED -DIMATH_HALF_NO_LOOKUP_TABLE="
step "configuring OpenEXR with cmake" cmake -S "$source" -B "$work/build" \
    ${CMAKE_TOOLCHAIN_FILE:+"-DCMAKE_TOOLCHAIN_FILE=$CMAKE_TOOLCHAIN_FILE"} \
    -DCMAKE_BUILD_TYPE=Release -DBUILD_SHARED_LIBS=OFF -DCMAKE_POSITION_INDEPENDENT_CODE=ON \
    -DCMAKE_C_FLAGS="${CFLAGS:-} $flags" -DCMAKE_CXX_FLAGS="${CXXFLAGS:-} $flags" \
    -DCMAKE_C_VISIBILITY_PRESET=hidden -DCMAKE_CXX_VISIBILITY_PRESET=hidden -DCMAKE_VISIBILITY_INLINES_HIDDEN=ON \
    -DOPENEXR_BUILD_TOOLS=OFF -DOPENEXR_BUILD_EXAMPLES=OFF -DOPENEXR_BUILD_PYTHON=OFF -DBUILD_TESTING=OFF \
    -DBUILD_WEBSITE=OFF -DOPENEXR_INSTALL=OFF -DOPENEXR_INSTALL_PKG_CONFIG=OFF -DOPENEXR_FORCE_INTERNAL_DEFLATE=ON \
    -DOPENEXR_FORCE_INTERNAL_OPENJPH=ON -DOPENEXR_FORCE_INTERNAL_ZSTD=ON -DImath_DIR="$work/imath"
jobs=${JOBS:-$(getconf _NPROCESSORS_ONLN 2>/dev/null || echo 2)}
step "compiling OpenEXRCore" cmake --build "$work/build" --target OpenEXRCore -j "$jobs"

library=$(find "$work/build" -name 'libOpenEXRCore*.a' | head -n 1)
[ -n "$library" ] || die "the build made no libOpenEXRCore*.a; the log is in $log"

rm -rf "$dest/include" "$dest/lib" "$dest/LICENSES"
mkdir -p "$dest/include/OpenEXR" "$dest/lib" "$dest/LICENSES"
cp "$library" "$dest/lib/libOpenEXRCore-3_5.a"
cp "$source"/src/lib/OpenEXRCore/openexr*.h "$dest/include/OpenEXR/"
for header in OpenEXRConfig.h IlmThreadConfig.h; do
    cp "$work/build/cmake/$header" "$dest/include/OpenEXR/" || die "cmake made no $header; the log is in $log"
done
cp -R "$work/imath/include/Imath" "$dest/include/"
cp "$source/LICENSE.md" "$dest/LICENSES/OpenEXR"
for part in deflate/COPYING OpenJPH/LICENSE zstd/LICENSE; do
    if [ -f "$source/external/$part" ]; then cp "$source/external/$part" "$dest/LICENSES/${part%%/*}"; fi
done

# OpenJPH is C++: its run-time library goes in statically, so that Quell depends on libc alone.
echo "$dest/lib/libOpenEXRCore-3_5.a -Wl,--exclude-libs,ALL -l:libstdc++.a -static-libgcc -lm -lpthread" >"$dest/link.flags"
echo "$key" >"$dest/stamp"
