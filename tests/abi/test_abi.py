# SPDX-License-Identifier: Apache-2.0
"""What leaves the library: symbols, the header in three languages, an installed copy that strangers build against."""

from __future__ import annotations

import ctypes
import os
import re
import subprocess
from pathlib import Path

import pytest


def run(*command: object, **keywords: object) -> str:
    done = subprocess.run([str(c) for c in command], capture_output=True, text=True, check=False, **keywords)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def declared(root: Path) -> set[str]:
    header = re.sub(r"/\*.*?\*/", "", (root / "include" / "quell.h").read_text(), flags=re.DOTALL)
    return set(re.findall(r"\b(quell_\w+)\(", re.sub(r"\(\*\w+\)\([^;]*;", ";", header)))


def test_exported_symbols_are_those_of_the_header(root, build):
    lines = run("nm", "-D", "--defined-only", build / "lib" / "libquell.so").splitlines()
    exported = {line.split()[-1].split("@")[0] for line in lines} - {"QUELL_0.1"}
    listed = set(re.findall(r"^\s+(quell_\w+);", (root / "src" / "libquell.map").read_text(), re.MULTILINE))
    assert exported == listed == declared(root)


def test_soname_and_dependencies(build):
    text = run("readelf", "-d", build / "lib" / "libquell.so")
    assert "soname: [libquell.so.0]" in text
    needed = set(re.findall(r"NEEDED.*\[(.*)\]", text))
    assert {n.split(".")[0] for n in needed} <= {"libc", "libm", "ld-linux-x86-64", "libpthread"}, needed


def test_no_writable_globals(build):
    """The library keeps no global state of its own. Constants with pointers are in .data.rel.ro."""
    text = run("size", "-A", build / "lib" / "libquell.a")
    sizes = re.findall(r"^(\.data|\.bss|\.tdata|\.tbss)(?:\.(?!rel\.ro)\S*)?\s+(\d+)", text, re.MULTILINE)
    assert sizes and all(size == "0" for _, size in sizes)


@pytest.mark.parametrize(
    "command",
    [
        ["gcc", "-std=c99", "-x", "c"],
        ["gcc", "-std=c11", "-x", "c"],
        ["g++", "-std=c++98", "-Wno-long-long", "-Wno-variadic-macros", "-x", "c++"],
        ["g++", "-std=c++17", "-x", "c++"],
    ],
    ids=["c99", "c11", "c++98", "c++17"],
)
def test_header_compiles(root, tmp_path, command):
    source = tmp_path / "use.c"
    source.write_text(
        '#include "quell.h"\n#include "quell.h"\nint main() { return (int)sizeof(quell_options) == 0; }\n'
    )
    run(*command, "-Wall", "-Wextra", "-Werror", "-pedantic", f"-I{root}/include", "-fsyntax-only", source)


def test_header_includes_only_two_others(root):
    includes = re.findall(r"#include (\S+)", (root / "include" / "quell.h").read_text())
    assert includes == ["<stddef.h>", "<stdint.h>"]


def test_every_declaration_says_since_when(root):
    text = (root / "include" / "quell.h").read_text()
    blocks = re.findall(r"/\*(?:(?!\*/).)*?\*/\n(?=QUELL_API)", text, re.DOTALL)
    assert blocks and all("Since: 0.1" in block for block in blocks)


@pytest.fixture(scope="module")
def installed(root, build, tmp_path_factory) -> Path:
    """make install into a DESTDIR, found by pkg-config as a packager would."""
    destination = tmp_path_factory.mktemp("destination")
    config = ["DEBUG=1"] if build.name == "debug" else []
    run("make", "-s", "install", f"DESTDIR={destination}", "PREFIX=/opt/quell", *config, cwd=root)
    return destination


def pkg_config(destination: Path, *options: str) -> list[str]:
    environment = {
        **os.environ,
        "PKG_CONFIG_SYSROOT_DIR": str(destination),
        "PKG_CONFIG_LIBDIR": f"{destination}/opt/quell/lib/pkgconfig",
    }
    return run("pkg-config", *options, "quell", env=environment).split()


def test_installed_sample(root, installed, tmp_path):
    source = root / "samples" / "denoise_buffer.c"
    assert len(source.read_text().splitlines()) < 80
    flags = pkg_config(installed, "--cflags", "--libs")
    run("gcc", "-std=c99", "-Wall", "-Wextra", "-Wpedantic", "-Werror", "-o", tmp_path / "sample", source, *flags)
    output = run(tmp_path / "sample", env={"LD_LIBRARY_PATH": f"{installed}/opt/quell/lib"})
    before, after = (float(line.split()[-1]) for line in output.splitlines())
    assert after < before / 4


def test_installed_tool(root, installed, data):
    tool = installed / "opt" / "quell" / "bin" / "quell"
    version = pkg_config(installed, "--modversion")[0]
    assert run(tool, "--version") == f"quell {version}\n"  # finds its library beside it
    assert "combined" in run(tool, "inspect", data / "45_plain.exr")
    names = {str(p.relative_to(installed / "opt" / "quell")) for p in installed.rglob("*") if not p.is_dir()}
    assert {
        "include/quell.h",
        "lib/libquell.so",
        "lib/libquell.so.0",
        f"lib/libquell.so.{version}",
        "lib/pkgconfig/quell.pc",
        "lib/quell/quell_oiio.so",
        "share/doc/quell/LICENSE",
    } <= names


def test_ctypes_caller(build):
    """What the add-on will do: no compiler, structs by hand."""

    class ContextOptions(ctypes.Structure):
        _fields_ = [
            ("struct_size", ctypes.c_uint32),
            ("num_threads", ctypes.c_uint32),
            ("cpu", ctypes.c_int32),
            ("reserved0", ctypes.c_uint32),
            ("max_memory_bytes", ctypes.c_uint64),
            ("max_image_pixels", ctypes.c_uint64),
            ("log", ctypes.c_void_p),
            ("log_user", ctypes.c_void_p),
        ]

    library = ctypes.CDLL(str(build / "lib" / "libquell.so"))
    library.quell_context_create.argtypes = [ctypes.POINTER(ContextOptions), ctypes.POINTER(ctypes.c_void_p)]
    library.quell_context_create.restype = ctypes.c_int32
    library.quell_context_destroy.argtypes = [ctypes.c_void_p]
    library.quell_context_cpu_name.argtypes = [ctypes.c_void_p]
    library.quell_context_cpu_name.restype = ctypes.c_char_p
    context = ctypes.c_void_p()
    options = ContextOptions(struct_size=ctypes.sizeof(ContextOptions), cpu=1)
    assert library.quell_context_create(ctypes.byref(options), ctypes.byref(context)) == 0
    assert library.quell_context_cpu_name(context) == b"c"
    library.quell_context_destroy(context)
