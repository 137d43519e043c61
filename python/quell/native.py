# SPDX-License-Identifier: Apache-2.0
"""libquell through ctypes: every struct, constant and signature of quell.h that this package uses, and nothing else.

The only module that knows ctypes. `load()` finds the library, checks its version and declares its functions; `check()`
turns a status into an exception. Contracts stand in quell.h and are not repeated here.
"""

from __future__ import annotations

import ctypes as C
import functools
import os
import platform
import re
import sys
from pathlib import Path

from .errors import LibraryError, QuellError, error_for_status

# Before 1.0 any minor version may change the ABI: the library must be of exactly this one. tests/python compares it,
# and every offset below, with quell.h.
ABI_VERSION = (0, 1)

OK = 0

CPU = {"auto": 0, "c": 1, "avx2": 2, "avx512": 3, "neon": 4, "avx512bf16": 5}
PRECISION = {"auto": 0, "float32": 1, "bfloat16": 2}
QUALITY = {"fast": 1, "balanced": 2, "high": 3}
CODEC = {
    "keep": 0,
    "none": 1,
    "rle": 2,
    "zips": 3,
    "zip": 4,
    "piz": 5,
    "pxr24": 6,
    "b44": 7,
    "b44a": 8,
    "dwaa": 9,
    "dwab": 10,
    "htj2k": 11,
}
FORMAT_FLOAT = 0
FORMAT_HALF = 1
LAYER_COPY = 0
LAYER_BORROW = 1
DENOISE_KEEP_NOISY = 1
DENOISE_DEBUG_LAYERS = 8
ACTION = {1: "denoised", 2: "skipped", 3: "guide", 4: "untouched"}

LogFn = C.CFUNCTYPE(None, C.c_void_p, C.c_int32, C.c_char_p)  # user, level, message
ProgressFn = C.CFUNCTYPE(C.c_int32, C.c_void_p, C.c_double)  # user, fraction -> non-zero cancels


class SizedStruct(C.Structure):
    """A struct of quell.h. struct_size is set on creation; every field of zero means its default."""

    def __init__(self, **fields: object) -> None:
        super().__init__(struct_size=C.sizeof(type(self)), **fields)


class ContextOptions(SizedStruct):
    _fields_ = [
        ("struct_size", C.c_uint32),
        ("num_threads", C.c_uint32),
        ("cpu", C.c_int32),
        ("reserved0", C.c_uint32),
        ("max_memory_bytes", C.c_uint64),
        ("max_image_pixels", C.c_uint64),
        ("log", LogFn),
        ("log_user", C.c_void_p),
    ]


class ModelInfo(SizedStruct):
    _fields_ = [
        ("struct_size", C.c_uint32),
        ("file_version", C.c_uint32),
        ("name", C.c_char_p),
        ("description", C.c_char_p),
        ("sha256", C.c_char_p),
        ("num_parameters", C.c_uint64),
        ("macs_per_pixel", C.c_double),
        ("macs_per_pixel_all", C.c_double),
        ("weight_file", C.c_char_p),
        ("quality", C.c_int32),
        ("reserved0", C.c_uint32),
    ]


class Image(SizedStruct):
    _fields_ = [
        ("struct_size", C.c_uint32),
        ("format", C.c_int32),
        ("width", C.c_uint32),
        ("height", C.c_uint32),
        ("num_channels", C.c_uint32),
        ("reserved0", C.c_uint32),
        ("data", C.c_void_p),
        ("channel_stride_bytes", C.c_int64),
        ("pixel_stride_bytes", C.c_int64),
        ("row_stride_bytes", C.c_int64),
    ]


class LayerInfo(SizedStruct):
    _fields_ = [
        ("struct_size", C.c_uint32),
        ("role", C.c_int32),
        ("view_layer", C.c_char_p),
        ("pass_", C.c_char_p),  # quell.h: pass
        ("view", C.c_char_p),
        ("full_name", C.c_char_p),
        ("channels", C.c_char_p),
        ("compression", C.c_char_p),
        ("format", C.c_int32),
        ("num_channels", C.c_uint32),
        ("width", C.c_uint32),
        ("height", C.c_uint32),
        ("samples", C.c_uint32),
        ("is_denoised", C.c_int32),
    ]


class WriteOptions(SizedStruct):
    _fields_ = [("struct_size", C.c_uint32), ("codec", C.c_int32)]


class Options(SizedStruct):
    _fields_ = [
        ("struct_size", C.c_uint32),
        ("flags", C.c_uint32),
        ("layers", C.c_char_p),
        ("tile_size", C.c_uint32),
        ("reserved0", C.c_uint32),
        ("progress", ProgressFn),
        ("progress_user", C.c_void_p),
        ("dgan", C.c_void_p),  # quell_dgan_options *, of which this package makes none
        ("precision", C.c_int32),
        ("reserved1", C.c_uint32),
    ]


class ReportLayer(SizedStruct):
    _fields_ = [
        ("struct_size", C.c_uint32),
        ("action", C.c_int32),
        ("full_name", C.c_char_p),
        ("reason", C.c_char_p),
        ("num_bad_pixels", C.c_uint64),
        ("num_limited_pixels", C.c_uint64),
        ("mean_before", C.c_double),
        ("mean_after", C.c_double),
    ]


class ReportSummary(SizedStruct):
    _fields_ = [
        ("struct_size", C.c_uint32),
        ("num_layers", C.c_uint32),
        ("tile_width", C.c_uint32),
        ("tile_height", C.c_uint32),
        ("num_tiles", C.c_uint32),
        ("halo", C.c_uint32),
        ("peak_bytes", C.c_uint64),
        ("macs_per_pixel", C.c_double),
        ("seconds_features", C.c_double),
        ("seconds_network", C.c_double),
        ("seconds_filter", C.c_double),
        ("seconds_total", C.c_double),
        ("combined", C.c_char_p),
        ("model_name", C.c_char_p),
        ("seconds_decode", C.c_double),
        ("seconds_analyse", C.c_double),
        ("seconds_recombine", C.c_double),
        ("iterations", C.c_uint32),
        ("reserved0", C.c_uint32),
        ("num_cells", C.c_uint32),
        ("num_active_cells", C.c_uint32),
        ("precision", C.c_int32),
        ("reserved1", C.c_uint32),
    ]


byref = C.byref
Index = C.c_uint32
HANDLE = C.c_void_p  # quell_context *, quell_model *, quell_frame *, quell_report *

# name: (result, arguments)
SIGNATURES: dict[str, tuple[object, list[object]]] = {
    "quell_status_name": (C.c_char_p, [C.c_int32]),  # status
    "quell_version_string": (C.c_char_p, []),
    "quell_version_number": (C.c_uint32, []),  # major * 10000 + minor * 100 + patch
    "quell_context_create": (
        C.c_int32,
        [
            C.POINTER(ContextOptions),  # options: or NULL
            C.POINTER(HANDLE),  # out
        ],
    ),
    "quell_context_destroy": (None, [HANDLE]),
    "quell_context_last_error": (C.c_char_p, [HANDLE]),
    "quell_context_cpu_name": (C.c_char_p, [HANDLE]),
    "quell_context_num_threads": (C.c_uint32, [HANDLE]),
    "quell_cancel": (None, [HANDLE]),  # from any thread
    "quell_model_open": (
        C.c_int32,
        [
            HANDLE,  # context
            C.c_char_p,  # name_or_path: UTF-8; "" for the default
            C.POINTER(HANDLE),  # out
        ],
    ),
    "quell_model_open_quality": (
        C.c_int32,
        [
            HANDLE,  # context
            C.c_int32,  # quality: a value of QUALITY; 0: the default
            C.POINTER(HANDLE),  # out
        ],
    ),
    "quell_quality_name": (C.c_char_p, [C.c_int32]),  # quality -> NULL for other values
    "quell_model_destroy": (None, [HANDLE]),
    "quell_model_get_info": (C.c_int32, [HANDLE, C.POINTER(ModelInfo)]),
    "quell_model_builtin_name": (C.c_char_p, [C.c_uint32]),  # index -> NULL past the end
    "quell_role_name": (C.c_char_p, [C.c_int32]),  # QUELL_ROLE_*
    "quell_frame_create": (
        C.c_int32,
        [
            HANDLE,  # context
            C.c_uint32,  # width
            C.c_uint32,  # height
            C.POINTER(HANDLE),  # out
        ],
    ),
    "quell_frame_read_exr": (
        C.c_int32,
        [
            HANDLE,  # context
            C.c_char_p,  # path: UTF-8
            C.POINTER(HANDLE),  # out
        ],
    ),
    "quell_frame_destroy": (None, [HANDLE]),
    "quell_frame_add_layer": (
        C.c_int32,
        [
            HANDLE,  # context
            HANDLE,  # frame
            C.c_char_p,  # name: of the pass, with or without a view layer before it
            C.POINTER(Image),  # image: the struct is copied, the pixels as ownership says
            C.c_int32,  # ownership: LAYER_COPY or LAYER_BORROW
            C.POINTER(C.c_uint32),  # out_index: or NULL
        ],
    ),
    "quell_frame_set_samples": (C.c_int32, [HANDLE, C.c_uint32]),  # frame, samples per pixel
    "quell_frame_num_layers": (C.c_uint32, [HANDLE]),
    "quell_frame_get_layer": (
        C.c_int32,
        [
            HANDLE,  # frame
            C.c_uint32,  # index
            C.POINTER(LayerInfo),  # info: its texts live as long as the frame
        ],
    ),
    "quell_frame_find_layer": (C.c_int64, [HANDLE, C.c_char_p]),  # frame, name -> index or -1
    "quell_frame_copy_layer": (
        C.c_int32,
        [
            HANDLE,  # context
            HANDLE,  # frame
            C.c_uint32,  # index
            C.POINTER(Image),  # image: where to
        ],
    ),
    "quell_frame_write_exr": (
        C.c_int32,
        [
            HANDLE,  # context
            HANDLE,  # frame
            C.c_char_p,  # path: UTF-8
            C.POINTER(WriteOptions),  # options: or NULL
        ],
    ),
    "quell_denoise": (
        C.c_int32,
        [
            HANDLE,  # context
            HANDLE,  # model
            HANDLE,  # frame
            C.POINTER(Options),  # options: or NULL
            C.POINTER(HANDLE),  # out_report: or NULL
        ],
    ),
    "quell_plan": (
        C.c_int32,
        [
            HANDLE,  # context
            HANDLE,  # model
            HANDLE,  # frame
            C.POINTER(Options),  # options: or NULL
            C.POINTER(HANDLE),  # out_report
        ],
    ),
    "quell_report_destroy": (None, [HANDLE]),
    "quell_report_get_summary": (C.c_int32, [HANDLE, C.POINTER(ReportSummary)]),
    "quell_report_get_layer": (C.c_int32, [HANDLE, C.c_uint32, C.POINTER(ReportLayer)]),  # report, index, layer
}

_BAD_EXE_FORMAT = 193  # of Windows

# Beside this file in the wheel; the first that exists is taken.
LIBRARY_NAMES = {
    "win32": ("quell.dll", "libquell.dll"),
    "darwin": ("libquell.dylib",),
}.get(sys.platform, ("libquell.so",))


def library_path() -> Path:
    """The file that QUELL_LIBRARY names, else the one beside this module."""
    named = os.environ.get("QUELL_LIBRARY")
    if named:
        return Path(named)
    folder = Path(__file__).resolve().parent
    for name in LIBRARY_NAMES:
        if (folder / name).exists():
            return folder / name
    raise LibraryError(
        f"{LIBRARY_NAMES[0]} is missing from {folder}: install the package of this system, "
        "or name the library in the environment variable QUELL_LIBRARY"
    )


@functools.lru_cache(maxsize=1)
def load() -> C.CDLL:
    """The library with all its functions declared; loaded once. Raises LibraryError."""
    path = library_path()
    try:
        # Symbols stay local to it, so that no other OpenEXR in this process is seen by it or sees it.
        library = C.CDLL(str(path))
        version = declare(library)
    except OSError as error:
        raise LibraryError(_why_not_loaded(path, error)) from error
    except AttributeError as error:
        raise LibraryError(f"{path} is no libquell of version {ABI_VERSION[0]}.{ABI_VERSION[1]}: {error}") from error
    if version != ABI_VERSION:
        raise LibraryError(
            f"{path} is of version {version[0]}.{version[1]}, this package needs {ABI_VERSION[0]}.{ABI_VERSION[1]}: "
            "install the two together"
        )
    return library


def _why_not_loaded(path: Path, error: OSError) -> str:
    """A sentence for what the system's loader said."""
    said = str(error)
    needed = re.search(r"GLIBC_([\d.]+)' not found", said)
    if needed:
        return (
            f"{path.name} needs glibc {needed[1]} or later, and this system has {' '.join(platform.libc_ver())}: "
            "use a newer Linux, such as Ubuntu 22.04, Debian 12 or Fedora 36, or build Quell on this one"
        )
    # Linux's loader overlooks a file for another processor as if it were not there.
    is_foreign = ("wrong ELF class", "No such file") if path.exists() else ()
    if getattr(error, "winerror", None) == _BAD_EXE_FORMAT or any(
        text in said for text in (*is_foreign, "incompatible")
    ):
        return f"{path.name} is built for another processor or system: install the package that is for this one"
    return f"{path} cannot be loaded: {error}"


def declare(library: C.CDLL) -> tuple[int, int]:
    """Sets all signatures and returns (major, minor). Raises AttributeError where a function is missing."""
    for name, (result, arguments) in SIGNATURES.items():
        function = getattr(library, name)
        function.restype = result
        function.argtypes = arguments
    number = library.quell_version_number()
    return number // 10000, number // 100 % 100


def check(status: int, context: C.c_void_p | None = None) -> None:
    """Raises the exception of a failed status, with the context's sentence where there is one."""
    if status == OK:
        return
    library = load()
    sentence = library.quell_context_last_error(context) if context else b""
    name = library.quell_status_name(status).decode()
    raise error_for_status(status, name, text(sentence) or name)


def text(value: bytes | None) -> str:
    """A lent string as Python's own. Names in files need not be valid UTF-8: bad bytes survive as surrogates."""
    return (value or b"").decode("utf-8", "surrogateescape")


def encoded(value: str | os.PathLike[str]) -> bytes:
    """A name or path as the library takes it."""
    result = os.fspath(value).encode("utf-8", "surrogateescape")
    if b"\0" in result:
        raise QuellError(f"a name or path cannot hold a zero byte: {value!r}")
    return result
