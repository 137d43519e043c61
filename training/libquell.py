# SPDX-License-Identifier: Apache-2.0
"""The library from Python, as far as evaluation needs it: denoise named layers, compare images.

The shared object is build/release/lib/libquell.so of this checkout (`make lib`), or what QUELL_LIBRARY names.
"""

from __future__ import annotations

import ctypes
import functools
import os
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from ctypes import POINTER, Structure, byref, c_char_p, c_double, c_int32, c_int64, c_uint32, c_uint64, c_void_p, sizeof
from dataclasses import dataclass
from pathlib import Path

import numpy as np

_OK = 0
_FORMAT_FLOAT = 0
_LAYER_BORROW = 1


class _ContextOptions(Structure):
    _fields_ = [
        ("struct_size", c_uint32),
        ("num_threads", c_uint32),
        ("cpu", c_int32),
        ("reserved0", c_uint32),
        ("max_memory_bytes", c_uint64),
        ("max_image_pixels", c_uint64),
        ("log", c_void_p),
        ("log_user", c_void_p),
    ]


class _Image(Structure):
    _fields_ = [
        ("struct_size", c_uint32),
        ("format", c_int32),
        ("width", c_uint32),
        ("height", c_uint32),
        ("num_channels", c_uint32),
        ("reserved0", c_uint32),
        ("data", c_void_p),
        ("channel_stride_bytes", c_int64),
        ("pixel_stride_bytes", c_int64),
        ("row_stride_bytes", c_int64),
    ]


class _Metrics(Structure):
    _fields_ = [
        ("struct_size", c_uint32),
        ("reserved0", c_uint32),
        ("mse", c_double),
        ("rel_mse", c_double),
        ("psnr", c_double),
        ("ssim", c_double),
        ("gmsd", c_double),
        ("num_non_finite", c_uint64),
    ]


@dataclass(frozen=True)
class Metrics:
    """What quell_compare says; relMSE and PSNR with the references' own noise cancelled."""

    rel_mse: float
    psnr: float
    ssim: float
    gmsd: float


class QuellError(Exception):
    """A call of the library failed; the text is its own sentence."""


_SIGNATURES: dict[str, tuple[object, list[object]]] = {
    "quell_status_name": (c_char_p, [c_int32]),
    "quell_context_create": (c_int32, [POINTER(_ContextOptions), POINTER(c_void_p)]),
    "quell_context_destroy": (None, [c_void_p]),
    "quell_context_last_error": (c_char_p, [c_void_p]),
    "quell_model_open": (c_int32, [c_void_p, c_char_p, POINTER(c_void_p)]),
    "quell_model_destroy": (None, [c_void_p]),
    "quell_frame_create": (c_int32, [c_void_p, c_uint32, c_uint32, POINTER(c_void_p)]),
    "quell_frame_destroy": (None, [c_void_p]),
    "quell_frame_set_samples": (c_int32, [c_void_p, c_uint32]),
    "quell_frame_add_layer": (c_int32, [c_void_p, c_void_p, c_char_p, POINTER(_Image), c_int32, POINTER(c_uint32)]),
    "quell_denoise": (c_int32, [c_void_p, c_void_p, c_void_p, c_void_p, c_void_p]),
    "quell_compare": (
        c_int32,
        [c_void_p, POINTER(_Image), POINTER(_Image), POINTER(_Image), POINTER(_Metrics)],
    ),
}


@functools.cache
def library() -> ctypes.CDLL:
    """Load the shared object, once."""
    default = Path(__file__).resolve().parents[1] / "build" / "release" / "lib" / "libquell.so"
    path = Path(os.environ.get("QUELL_LIBRARY", default))
    if not path.exists():
        raise SystemExit(f"{path} is missing: run `make lib`, or name the library in QUELL_LIBRARY")
    loaded = ctypes.CDLL(str(path))
    for name, (result, arguments) in _SIGNATURES.items():
        function = getattr(loaded, name)
        function.restype, function.argtypes = result, arguments
    return loaded


def _check(context: c_void_p | None, status: int) -> None:
    if status != _OK:
        sentence = library().quell_context_last_error(context) if context else b""
        raise QuellError((sentence or library().quell_status_name(status)).decode())


@contextmanager
def _owned(destroy: str) -> Iterator[c_void_p]:
    handle = c_void_p()
    try:
        yield handle
    finally:
        getattr(library(), destroy)(handle)


@contextmanager
def _context(threads: int) -> Iterator[c_void_p]:
    with _owned("quell_context_destroy") as handle:
        options = _ContextOptions(struct_size=sizeof(_ContextOptions), num_threads=threads)
        _check(None, library().quell_context_create(byref(options), byref(handle)))
        yield handle


def _view(pixels: np.ndarray) -> _Image:
    """Describe [h,w,c] float32 memory, which must outlive the view."""
    height, width, channels = pixels.shape
    return _Image(
        struct_size=sizeof(_Image),
        format=_FORMAT_FLOAT,
        width=width,
        height=height,
        num_channels=channels,
        data=pixels.ctypes.data,
    )


def denoise(
    model: str, layers: Mapping[str, np.ndarray], spp: int, threads: int = 0
) -> tuple[dict[str, np.ndarray], float]:
    """Denoise named layers [h,w,c]; return them all, filtered or not, and the CPU seconds of the call.

    model: a weight file, or the name of a built-in one; spp 0 where it is unknown; threads 0 for all cores.
    """
    out = {name: np.array(pixels, np.float32, order="C") for name, pixels in layers.items()}
    height, width = next(iter(out.values())).shape[:2]
    call = library()
    with (
        _context(threads) as context,
        _owned("quell_model_destroy") as opened,
        _owned("quell_frame_destroy") as frame,
    ):
        _check(context, call.quell_model_open(context, str(model).encode(), byref(opened)))
        _check(context, call.quell_frame_create(context, width, height, byref(frame)))
        for name, pixels in out.items():
            status = call.quell_frame_add_layer(
                context, frame, name.encode(), byref(_view(pixels)), _LAYER_BORROW, None
            )
            _check(context, status)
        _check(context, call.quell_frame_set_samples(frame, spp))
        start = time.process_time()
        _check(context, call.quell_denoise(context, opened, frame, None, None))
        seconds = time.process_time() - start
    return out, seconds


def compare(image: np.ndarray, reference_a: np.ndarray, reference_b: np.ndarray) -> Metrics:
    """Compare [h,w,3] with two independent references."""
    planes = [np.ascontiguousarray(x, np.float32) for x in (image, reference_a, reference_b)]
    views = [_view(x) for x in planes]
    metrics = _Metrics(struct_size=sizeof(_Metrics))
    with _context(1) as context:
        _check(context, library().quell_compare(context, *map(byref, views), byref(metrics)))
    return Metrics(metrics.rel_mse, metrics.psnr, metrics.ssim, metrics.gmsd)
