# SPDX-License-Identifier: Apache-2.0
"""Contexts, models and frames: the library's handles as Python objects that free themselves.

One Context serves one thread at a time; Context.cancel alone may be called from others. Calls release the
interpreter's lock while they compute. Pixels are NumPy arrays [height][width][channels] (or [height][width] for one
channel), row 0 on top; float32 and float16 arrays of any strides are used where they lie, without a copy.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from . import native
from .errors import FileError, QuellError
from .report import LayerReport, Report

# Called with the fraction done, 0 to 1, a few times a second; returning True cancels.
Progress = Callable[[float], "bool | None"]


@dataclass(frozen=True)
class ModelInfo:
    name: str
    description: str
    sha256: str
    num_parameters: int
    macs_per_pixel: float
    macs_per_pixel_all: float
    weight_file: str  # path as it was opened; "quell-balanced.qwt" for one inside the library
    quality: str | None  # the level that this network of the library is


@dataclass(frozen=True)
class LayerInfo:
    """A layer's identity, as its file or maker named it. `samples` is 0 where unknown."""

    role: str  # "combined", "diffuse-direct", ...; "other"
    view_layer: str
    pass_name: str
    view: str
    full_name: str
    channels: str  # letters in reading order
    num_channels: int
    samples: int
    is_denoised: bool


class _Handle:
    """Owns a pointer of the library and gives it back once."""

    _destroy: str

    def __init__(self, pointer: native.HANDLE) -> None:
        self._pointer: native.HANDLE | None = pointer

    @property
    def pointer(self) -> native.HANDLE:
        if self._pointer is None:
            raise QuellError(f"this {type(self).__name__} is closed")
        return self._pointer

    def close(self) -> None:
        """Frees it now; a second time does nothing."""
        pointer, self._pointer = getattr(self, "_pointer", None), None
        if pointer is not None:
            getattr(native.load(), self._destroy)(pointer)

    def __enter__(self) -> Any:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def __del__(self) -> None:
        self.close()


class Model(_Handle):
    """Weights. Immutable: several contexts and threads may share one. Made by Context.open_model."""

    _destroy = "quell_model_destroy"

    @property
    def info(self) -> ModelInfo:
        info = native.ModelInfo()
        native.check(native.load().quell_model_get_info(self.pointer, native.byref(info)))
        return ModelInfo(
            name=native.text(info.name),
            description=native.text(info.description),
            sha256=native.text(info.sha256),
            num_parameters=info.num_parameters,
            macs_per_pixel=info.macs_per_pixel,
            macs_per_pixel_all=info.macs_per_pixel_all,
            weight_file=native.text(info.weight_file),
            quality=native.text(native.load().quell_quality_name(info.quality)) or None,
        )


class Frame(_Handle):
    """A frame of named layers. Made by Context.new_frame or Context.read_exr."""

    _destroy = "quell_frame_destroy"

    def __init__(self, pointer: native.HANDLE, context: Context) -> None:
        super().__init__(pointer)
        self._context = context
        self._borrowed: list[np.ndarray] = []  # kept alive for the library

    def add_layer(self, name: str, pixels: np.ndarray, borrow: bool = False) -> int:
        """Adds a layer and returns its index.

        borrow: the library reads from, and writes the result to, this array itself (float32 or float16, writeable, any
        strides). Otherwise the pixels are copied, converted to float32 where they are of another type.
        """
        if pixels.dtype not in (np.float32, np.float16):
            if borrow:
                raise QuellError(f"layer '{name}': only float32 and float16 arrays can be borrowed, not {pixels.dtype}")
            pixels = pixels.astype(np.float32)
        if not borrow and 0 in pixels.strides:  # broadcast: to the library a stride of 0 means "packed"
            pixels = np.ascontiguousarray(pixels)
        if borrow and not pixels.flags.writeable:
            raise QuellError(f"layer '{name}': a borrowed array must be writeable")
        index = native.Index()
        ownership = native.LAYER_BORROW if borrow else native.LAYER_COPY
        status = native.load().quell_frame_add_layer(
            self._context.pointer,
            self.pointer,
            native.encoded(name),
            native.byref(_image(pixels, name)),
            ownership,
            native.byref(index),
        )
        native.check(status, self._context.pointer)
        if borrow:
            self._borrowed.append(pixels)
        return index.value

    def set_samples(self, samples: int) -> None:
        """Samples per pixel of all layers so far, where no file says so; 0: unknown."""
        native.check(native.load().quell_frame_set_samples(self.pointer, samples))

    @property
    def layers(self) -> list[LayerInfo]:
        library = native.load()
        result = []
        for index in range(library.quell_frame_num_layers(self.pointer)):
            info = native.LayerInfo()
            native.check(library.quell_frame_get_layer(self.pointer, index, native.byref(info)))
            result.append(
                LayerInfo(
                    role=native.text(library.quell_role_name(info.role)),
                    view_layer=native.text(info.view_layer),
                    pass_name=native.text(info.pass_),
                    view=native.text(info.view),
                    full_name=native.text(info.full_name),
                    channels=native.text(info.channels),
                    num_channels=info.num_channels,
                    samples=info.samples,
                    is_denoised=bool(info.is_denoised),
                )
            )
        return result

    @property
    def size(self) -> tuple[int, int]:
        """Width and height; (0, 0) for a frame without layers."""
        info = native.LayerInfo()
        library = native.load()
        if not library.quell_frame_num_layers(self.pointer):
            return 0, 0
        native.check(library.quell_frame_get_layer(self.pointer, 0, native.byref(info)))
        return info.width, info.height

    def find(self, name: str) -> int:
        """Index of a layer by full or pass name. Raises KeyError."""
        index = native.load().quell_frame_find_layer(self.pointer, native.encoded(name))
        if index < 0:
            raise KeyError(name)
        return index

    def pixels(self, name: str, out: np.ndarray | None = None) -> np.ndarray:
        """A layer's present pixels (denoised, once it was), in `out` or in a new float32 array."""
        index = self.find(name)
        if out is None:
            width, height = self.size
            out = np.empty((height, width, self.layers[index].num_channels), np.float32)
        elif not out.flags.writeable:
            raise QuellError(f"layer '{name}': the array to fill must be writeable")
        status = native.load().quell_frame_copy_layer(
            self._context.pointer, self.pointer, index, native.byref(_image(out, name))
        )
        native.check(status, self._context.pointer)
        return out

    def write_exr(self, path: str | os.PathLike[str], codec: str = "keep") -> None:
        """Writes the frame as the file it was read from; the file appears whole or not at all. codec: native.CODEC."""
        options = native.WriteOptions(codec=_choice(native.CODEC, codec, "codec"))
        status = native.load().quell_frame_write_exr(
            self._context.pointer, self.pointer, native.encoded(path), native.byref(options)
        )
        native.check(status, self._context.pointer)


class Context(_Handle):
    """Threads, limits and kernels of one user of the library.

    threads: 0 for one per core. cpu: a key of native.CPU. max_memory_bytes: working memory beyond the frame's own
    pixels, 0 for the library's default. log: called with finished lines.
    """

    _destroy = "quell_context_destroy"

    def __init__(
        self,
        threads: int = 0,
        cpu: str = "auto",
        max_memory_bytes: int = 0,
        log: Callable[[str], None] | None = None,
    ) -> None:
        self._pointer = None
        options = native.ContextOptions(
            num_threads=threads, cpu=_choice(native.CPU, cpu, "cpu"), max_memory_bytes=max_memory_bytes
        )
        if log is not None:
            options.log = native.LogFn(lambda _user, _level, message: log(native.text(message)))
        self._log = options.log  # the library calls it as long as the context lives
        self._levels: dict[str, Model] = {}  # opened by denoise and plan
        pointer = native.HANDLE()
        status = native.load().quell_context_create(native.byref(options), native.byref(pointer))
        native.check(status)
        super().__init__(pointer)

    @property
    def cpu(self) -> str:
        """Name of the kernels in use: "c", "avx2", "avx512", "avx512bf16" or "neon"."""
        return native.text(native.load().quell_context_cpu_name(self.pointer))

    @property
    def threads(self) -> int:
        return native.load().quell_context_num_threads(self.pointer)

    def cancel(self) -> None:
        """Stops the call that runs on this context; it raises CancelledError soon after. From any thread."""
        native.load().quell_cancel(self.pointer)

    def open_model(self, name_or_path: str | os.PathLike[str] = "", quality: str | None = None) -> Model:
        """A quality level's network (native.QUALITY), a built-in model by name, or a weight file; "": the default."""
        if quality and name_or_path:
            raise QuellError(
                f"model '{name_or_path}' and quality '{quality}': each level is a network of its own: give one of them"
            )
        pointer = native.HANDLE()
        library = native.load()
        if quality:
            level = _choice(native.QUALITY, quality, "quality")
            status = library.quell_model_open_quality(self.pointer, level, native.byref(pointer))
        else:
            status = library.quell_model_open(self.pointer, native.encoded(name_or_path), native.byref(pointer))
        native.check(status, self.pointer)
        return Model(pointer)

    def _choose_model(self, model: Model | None, quality: str | None) -> Model:
        """The model given, or that of a level, which stays open as long as the context."""
        if model is not None and quality:
            raise QuellError(f"a model and quality '{quality}': each level is a network of its own: give one of them")
        if model is not None:
            return model
        key = quality or ""
        if key not in self._levels:
            self._levels[key] = self.open_model(quality=quality)
        return self._levels[key]

    def close(self) -> None:
        for model in getattr(self, "_levels", {}).values():
            model.close()
        super().close()

    def new_frame(self, width: int, height: int) -> Frame:
        """An empty frame, to be filled by Frame.add_layer."""
        pointer = native.HANDLE()
        native.check(native.load().quell_frame_create(self.pointer, width, height, native.byref(pointer)), self.pointer)
        return Frame(pointer, self)

    def read_exr(self, path: str | os.PathLike[str]) -> Frame:
        """A multilayer or plain EXR file. The file is not changed, and must stay until the frame is closed."""
        pointer = native.HANDLE()
        status = native.load().quell_frame_read_exr(self.pointer, native.encoded(path), native.byref(pointer))
        native.check(status, self.pointer)
        return Frame(pointer, self)

    def denoise(
        self,
        frame: Frame,
        model: Model | None = None,
        layers: str | None = None,
        keep_noisy: bool = False,
        tile_size: int = 0,
        progress: Progress | None = None,
        debug_layers: bool = False,
        quality: str | None = None,
        precision: str = "auto",
    ) -> Report:
        """Denoises the frame's layers in place and says what was done.

        model: from open_model, or instead quality, a level of native.QUALITY; neither: the default. layers: "all",
        "beauty" (Combined alone), or names, comma-separated; None: what suits the model. keep_noisy: the noisy Combined
        stays as a layer "Noisy Image". debug_layers: the frame gets layers "Quell Noise", "Quell Confidence" and "Quell
        Skipped" (docs/cli.md). precision: of numbers inside the network, a key of native.PRECISION; "auto" is bfloat16
        with the kernels "avx512bf16" and float32 with others. On any error the pixels are as they were.
        """
        network = self._choose_model(model, quality)
        raised: list[BaseException] = []

        def forward(_user: int | None, fraction: float) -> int:
            try:
                return 1 if progress is not None and progress(fraction) else 0
            except BaseException as error:  # an exception cannot pass through C: it cancels, and is raised below
                raised.append(error)
                return 1

        flags = native.DENOISE_KEEP_NOISY if keep_noisy else 0
        flags |= native.DENOISE_DEBUG_LAYERS if debug_layers else 0
        options = native.Options(
            flags=flags,
            layers=None if layers is None else native.encoded(layers),
            tile_size=tile_size,
            progress=native.ProgressFn(forward),
            precision=_choice(native.PRECISION, precision, "precision"),
        )
        report = native.HANDLE()
        status = native.load().quell_denoise(
            self.pointer, network.pointer, frame.pointer, native.byref(options), native.byref(report)
        )
        try:
            if raised:
                raise raised[0]
            native.check(status, self.pointer)
            return _report(report)
        finally:
            native.load().quell_report_destroy(report)

    def plan(
        self,
        frame: Frame,
        model: Model | None = None,
        layers: str | None = None,
        quality: str | None = None,
        precision: str = "auto",
    ) -> Report:
        """What denoise would do, without doing it."""
        network = self._choose_model(model, quality)
        options = native.Options(
            layers=None if layers is None else native.encoded(layers),
            precision=_choice(native.PRECISION, precision, "precision"),
        )
        report = native.HANDLE()
        status = native.load().quell_plan(
            self.pointer, network.pointer, frame.pointer, native.byref(options), native.byref(report)
        )
        try:
            native.check(status, self.pointer)
            return _report(report)
        finally:
            native.load().quell_report_destroy(report)


def version() -> str:
    """Version of the library that is loaded."""
    return native.text(native.load().quell_version_string())


def models() -> list[str]:
    """Names of the models inside the library, the default first."""
    names = []
    while (name := native.load().quell_model_builtin_name(len(names))) is not None:
        names.append(native.text(name))
    return names


def qualities() -> list[str]:
    """Quality levels whose network is inside the library, from the smallest on."""
    found = []
    with Context(threads=1) as context:
        for quality in native.QUALITY:
            try:
                context.open_model(quality=quality).close()
                found.append(quality)
            except FileError:  # built without that weight file
                continue
    return found


def roles(passes: dict[str, int]) -> dict[str, str]:
    """What passes are, by name: {"DiffDir": 3} (name: channels) -> {"DiffDir": "diffuse-direct"}.

    "other": data, or unknown, or channels that do not fit the name.
    """
    result = {}
    with Context(threads=1) as context:
        for name, channels in passes.items():
            with context.new_frame(1, 1) as frame:
                try:
                    frame.add_layer(name, np.zeros((1, 1, channels), np.float32))
                    result[name] = frame.layers[0].role
                except QuellError:
                    result[name] = "other"
    return result


def _choice(table: dict[str, int], key: str, what: str) -> int:
    if key not in table:
        raise QuellError(f"no such {what}: '{key}' (known: {', '.join(table)})")
    return table[key]


def _image(pixels: np.ndarray, name: str) -> native.Image:
    if pixels.dtype not in (np.float32, np.float16) or pixels.ndim not in (2, 3):
        raise QuellError(
            f"layer '{name}': pixels must be float32 or float16 of shape [height][width][channels], "
            f"not {pixels.dtype} of shape {pixels.shape}"
        )
    if pixels.ndim == 2:
        pixels = pixels[:, :, None]
    height, width, channels = pixels.shape
    row, column, channel = pixels.strides
    return native.Image(
        format=native.FORMAT_FLOAT if pixels.dtype == np.float32 else native.FORMAT_HALF,
        width=width,
        height=height,
        num_channels=channels,
        data=pixels.ctypes.data,
        channel_stride_bytes=channel,
        pixel_stride_bytes=column,
        row_stride_bytes=row,
    )


def _report(pointer: native.HANDLE) -> Report:
    library = native.load()
    summary = native.ReportSummary()
    native.check(library.quell_report_get_summary(pointer, native.byref(summary)))
    layers = []
    for index in range(summary.num_layers):
        layer = native.ReportLayer()
        native.check(library.quell_report_get_layer(pointer, index, native.byref(layer)))
        layers.append(
            LayerReport(
                name=native.text(layer.full_name),
                action=native.ACTION.get(layer.action, "untouched"),
                reason=native.text(layer.reason),
                bad_pixels=layer.num_bad_pixels,
                limited_pixels=layer.num_limited_pixels,
                mean_before=layer.mean_before,
                mean_after=layer.mean_after,
            )
        )
    return Report(
        layers=tuple(layers),
        model=native.text(summary.model_name),
        combined=native.text(summary.combined),
        peak_bytes=summary.peak_bytes,
        num_tiles=summary.num_tiles,
        precision=next(name for name, value in native.PRECISION.items() if value == summary.precision),
        macs_per_pixel=summary.macs_per_pixel,
        seconds_features=summary.seconds_features,
        seconds_network=summary.seconds_network,
        seconds_filter=summary.seconds_filter,
        seconds_total=summary.seconds_total,
    )
