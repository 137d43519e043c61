# SPDX-License-Identifier: GPL-3.0-or-later
"""Denoises inside the render: between Cycles' last sample and compositing, in memory, on the render's own thread.

Cycles' engine class has no documented place for this, so two of its methods are wrapped: `render`, which knows scene
and view layer, and `render_frame_finish`, which is called once per frame when all passes of all view layers and views
are there (`render` may see zeros while Cycles renders in tiles). A third, `update_render_passes`, gives the pass
"Quell" its socket. What the wrappers do beyond the original may fail, but never raises: the render goes on without it.

Seen to hold in 3.4 and 4.2 to 5.2; where problem() names something that is missing, handlers.py goes the way of files.
"""

from __future__ import annotations

import contextlib
import functools
import traceback
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import bpy

from ..io import library, memory
from ..io.settings import ADD_PASS, KEPT_NAME, PASS_NAME, Settings
from . import cycles_settings, properties, state

if TYPE_CHECKING:
    import numpy as np

_METHODS = ("render", "render_frame_finish", "update_render_passes")

_ENGINE_FUNCTIONS = ("get_result", "add_pass", "register_pass", "test_break", "update_progress")

_originals: dict[str, Callable[..., Any]] = {}
_is_active = False
_runtime_problem = ""
# Of the frame rendered last: whether it came through here, well or not, and whether its passes are clean now.
is_frame_seen = False
is_frame_denoised = False


@dataclass(frozen=True)
class _LayerFacts:
    """What a view layer's passes do not say themselves."""

    samples: int
    is_denoised: bool


class _Rendering:
    """The frame that one engine renders: noted by `render`, used by `render_frame_finish`."""

    def __init__(self, settings: Settings) -> None:
        self.settings = settings
        self.layers: dict[str, _LayerFacts] = {}


# By the engine's address: an engine object takes no attributes that would be sure to die with it.
_renderings: dict[int, _Rendering] = {}


def problem() -> str:
    """Why this way is closed in the running Blender, "" when it is open."""
    if library.problem():
        return library.problem()
    engine = _engine_class()
    if engine is None:
        return "The Cycles add-on is not enabled."
    for name in _METHODS:
        if not callable(getattr(engine, name, None)):
            return f"This version of Cycles has no {name}."
    for name in _ENGINE_FUNCTIONS:
        if name not in bpy.types.RenderEngine.bl_rna.functions:
            return f"This version of Blender's render engines has no {name}."
    return _runtime_problem


def _engine_class() -> type | None:
    try:
        import cycles
    except ImportError:
        return None
    return getattr(cycles, "CyclesRender", None)


# ---- The wrappers --------------------------------------------------------------------------------------------------


def _render(engine: bpy.types.RenderEngine, depsgraph: bpy.types.Depsgraph) -> None:
    if _is_active:
        with _contained(engine):
            _note(engine, depsgraph)
    _originals["render"](engine, depsgraph)


def _render_frame_finish(engine: bpy.types.RenderEngine) -> None:
    _originals["render_frame_finish"](engine)
    rendering = _renderings.pop(engine.as_pointer(), None)
    if rendering is None or engine.is_preview or engine.test_break():
        return
    with _contained(engine, rendering):
        _denoise(engine, rendering)


def _update_render_passes(
    engine: bpy.types.RenderEngine, scene: bpy.types.Scene, view_layer: bpy.types.ViewLayer
) -> None:
    _originals["update_render_passes"](engine, scene, view_layer)
    if not _is_active:
        return
    with _contained(engine):
        settings = scene.quell
        if settings.enabled and settings.target == ADD_PASS and settings.output != properties.OUTPUT_FILE:
            engine.register_pass(scene, view_layer, PASS_NAME, 4, "RGBA", "COLOR")


@contextlib.contextmanager
def _contained(engine: bpy.types.RenderEngine, rendering: _Rendering | None = None) -> Iterator[None]:
    """Keeps every exception from the render. The traceback goes to the console for a bug report.

    No name may hold the exception afterwards: its frames would keep the engine alive beyond its render.
    """
    try:
        yield
    except Exception as error:
        _report(error)
        if rendering is not None and rendering.settings.target == ADD_PASS:
            _fill_own_pass(engine)


def _report(error: Exception) -> None:
    global _runtime_problem
    package = library.quell()
    if isinstance(error, package.CancelledError):
        _end_frame(is_denoised=False)
        state.set_error("Denoising was cancelled; the render is noisy")
    elif isinstance(error, library.Problem):
        _fail(str(error))
    elif isinstance(error, package.QuellError):
        _fail(f"{error}. The render is noisy")
    else:
        traceback.print_exc()
        _runtime_problem = f"Quell met something unknown in this version of Blender ({error}); it works by files now."
        state.set_error(_runtime_problem)


def _fail(sentence: str) -> None:
    from . import handlers

    _end_frame(is_denoised=False)
    state.set_error(sentence)
    handlers.record_failure(sentence)


def begin_frame() -> None:
    """Called before each frame's render."""
    global is_frame_seen, is_frame_denoised
    is_frame_seen = is_frame_denoised = False


def _end_frame(is_denoised: bool) -> None:
    global is_frame_seen, is_frame_denoised
    is_frame_seen, is_frame_denoised = True, is_denoised


# ---- What they do --------------------------------------------------------------------------------------------------


def _note(engine: bpy.types.RenderEngine, depsgraph: bpy.types.Depsgraph) -> None:
    """Reads the settings here, where Blender says which scene and view layer are being rendered."""
    scene = depsgraph.scene
    if engine.is_preview or problem() or scene.quell.output == properties.OUTPUT_FILE:
        return
    if not scene.quell.wants_render(engine.is_animation):
        return
    view_layer = depsgraph.view_layer
    key = engine.as_pointer()
    rendering = _renderings.get(key) or _renderings.setdefault(key, _Rendering(scene.quell.to_plain()))
    facts = _LayerFacts(cycles_settings.samples(scene, view_layer), cycles_settings.denoises(scene, view_layer))
    rendering.layers[view_layer.name] = facts
    # Only passes that are there before Cycles begins get memory for their pixels.
    if rendering.settings.target == ADD_PASS:
        engine.add_pass(PASS_NAME, 4, "RGBA", layer=view_layer.name)
    elif rendering.settings.keep_noisy and not facts.is_denoised:
        engine.add_pass(KEPT_NAME, 4, "RGBA", layer=view_layer.name)


def _denoise(engine: bpy.types.RenderEngine, rendering: _Rendering) -> None:
    from . import handlers

    result = engine.get_result()
    if result is None:  # nothing was rendered
        return
    size = (result.resolution_x, result.resolution_y)
    state.set_running("Denoising")
    outcome, noisy = memory.denoise_layers(
        _layers(result, rendering),
        size,
        rendering.settings,
        lambda fraction: _progress(engine, fraction),
        wants_before=not bpy.app.background,
    )
    _end_frame(is_denoised=True)
    state.set_before(noisy)
    state.set_outcome(outcome)
    handlers.record(outcome)


def _progress(engine: bpy.types.RenderEngine, fraction: float) -> bool:
    engine.update_progress(fraction)
    return engine.test_break()


def _layers(result: bpy.types.RenderResult, rendering: _Rendering) -> list[memory.RenderLayer]:
    """Every view of every view layer, with readers and writers of its passes."""
    views = [view.name for view in result.views] or [""]
    size = (result.resolution_x, result.resolution_y)
    layers = []
    for layer in result.layers:
        facts = rendering.layers.get(layer.name, _LayerFacts(0, False))
        for view_id, view in enumerate(views):
            passes = [
                memory.RenderPass(
                    name=render_pass.name,
                    num_channels=render_pass.channels,
                    read=functools.partial(_read, render_pass, size),
                    write=functools.partial(_write, render_pass),
                )
                for render_pass in layer.passes
                if render_pass.view_id == view_id
            ]
            layers.append(
                memory.RenderLayer(
                    name=layer.name,
                    view=view if len(views) > 1 else "",
                    samples=facts.samples,
                    is_denoised=facts.is_denoised,
                    passes=passes,
                    fill=functools.partial(_fill, layer, view_id),
                )
            )
    return layers


def _read(render_pass: bpy.types.RenderPass, size: tuple[int, int]) -> np.ndarray:
    """[height][width][channels] with row 0 on top: a view of Blender's order, whose rows go up."""
    import numpy as np  # some distributions' Blender comes without it, and must still register the add-on

    width, height = size
    pixels = np.empty(width * height * render_pass.channels, np.float32)
    try:
        render_pass.rect.foreach_get(pixels)
    except TypeError:  # 3.4: one row per pixel
        render_pass.rect.foreach_get(pixels.reshape(width * height, render_pass.channels))
    return pixels.reshape(height, width, render_pass.channels)[::-1]


def _write(render_pass: bpy.types.RenderPass, pixels: np.ndarray) -> None:
    import numpy as np

    flat = np.ascontiguousarray(pixels[::-1]).reshape(-1)
    try:
        render_pass.rect.foreach_set(flat)
    except TypeError:  # 3.4
        render_pass.rect.foreach_set(flat.reshape(-1, render_pass.channels))


def _fill(layer: bpy.types.RenderLayer, view_id: int, name: str, pixels: np.ndarray) -> None:
    """Fills a pass that _note added."""
    for render_pass in layer.passes:
        if render_pass.name == name and render_pass.view_id == view_id:
            _write(render_pass, pixels)
            return
    raise library.Problem(f"Blender did not add the pass '{name}' to the view layer '{layer.name}'.")


def _fill_own_pass(engine: bpy.types.RenderEngine) -> None:
    """The noisy picture, where there is no better one: a compositor that uses the pass must not get black."""
    result = engine.get_result()
    size = (result.resolution_x, result.resolution_y)
    for layer in result.layers:
        noisy = {p.view_id: p for p in layer.passes if p.name == "Combined"}
        for render_pass in layer.passes:
            if render_pass.name == PASS_NAME and render_pass.view_id in noisy:
                _write(render_pass, _read(noisy[render_pass.view_id], size))


# ---- Install -------------------------------------------------------------------------------------------------------


def register() -> None:
    """Wraps Cycles' methods, unless something is missing."""
    global _is_active, _runtime_problem
    _runtime_problem = ""
    if problem():
        return
    engine = _engine_class()
    for name, wrapper in zip(_METHODS, (_render, _render_frame_finish, _update_render_passes), strict=True):
        if name not in _originals:  # there, when another add-on kept our wrapper from being taken back
            _originals[name] = getattr(engine, name)
            setattr(engine, name, wrapper)
    _is_active = True


def unregister() -> None:
    """Puts Cycles' methods back. Where another add-on has wrapped ours, it stays, and does nothing but call on."""
    global _is_active
    _is_active = False
    _renderings.clear()
    engine = _engine_class()
    for name, wrapper in zip(_METHODS, (_render, _render_frame_finish, _update_render_passes), strict=True):
        if name in _originals and getattr(engine, name, None) is wrapper:
            setattr(engine, name, _originals.pop(name))
    state.clear()
