# SPDX-License-Identifier: Apache-2.0
"""Runs inside a Blender with a window: renders as F12 does, presses the buttons, takes pictures: ADDON.zip WORK.

A generator that a timer steps on the main thread, so that Blender draws and handles events between the steps.
WORK/window.json gets {what: value}; the pictures are WORK/*.png, larger and slower ones with the argument "pictures".
"""

from __future__ import annotations

import importlib
import json
import subprocess
import sys
import time
import traceback
from collections.abc import Iterator
from pathlib import Path

import bpy

sys.path.insert(0, str(Path(__file__).resolve().parent))

import scene as test_scene  # noqa: E402

_arguments = sys.argv[sys.argv.index("--") + 1 :]
ADDON_ZIP, WORK = map(Path, _arguments[:2])
SIZE = (480, 360) if "pictures" in _arguments else (160, 120)
# Where 3.4 draws the sidebar's tab "Quell" in a window of 1280x800: before 4.2 only the mouse can choose a tab.
TAB = (930, 285)
MODULE = "bl_ext.user_default.quell" if bpy.app.version >= (4, 2, 0) else "quell_denoiser"
WAIT = 0.2
PATIENCE = 300.0

found: dict[str, object] = {}


def part(name: str):
    return importlib.import_module(f"{MODULE}.{name}")


def picture(name: str) -> None:
    """What the window shows now."""
    window = bpy.context.window_manager.windows[0]
    with bpy.context.temp_override(window=window):
        bpy.ops.screen.screenshot(filepath=str(WORK / f"{name}.png"))


def area(kind: str) -> bpy.types.Area:
    return next(a for a in bpy.context.window_manager.windows[0].screen.areas if a.type == kind)


def in_image_editor():
    editor = area("IMAGE_EDITOR")
    region = next(r for r in editor.regions if r.type == "WINDOW")
    return bpy.context.temp_override(window=bpy.context.window_manager.windows[0], area=editor, region=region)


def until(condition, what: str) -> Iterator[float]:
    end = time.monotonic() + PATIENCE
    while not condition():
        if time.monotonic() > end:
            raise TimeoutError(what)
        yield WAIT


def arrange() -> None:
    """A big image editor, and the render properties with everything but sampling closed."""
    bpy.context.preferences.view.show_splash = False
    bpy.context.preferences.view.render_display_type = "NONE"
    area("VIEW_3D").ui_type = "IMAGE_EDITOR"
    area("PROPERTIES").spaces.active.context = "RENDER"
    window = bpy.context.window_manager.windows[0]
    for kind in ("OUTLINER", "DOPESHEET_EDITOR"):
        with bpy.context.temp_override(window=window, area=area(kind)):
            bpy.ops.screen.area_close()


def mouse(*arguments: object) -> float:
    """One command of xdotool, and then time for Blender to see it."""
    subprocess.run(["xdotool", *map(str, arguments)], check=False)
    return 0.5


def show_panel() -> Iterator[float]:
    """Makes the properties wide enough for words, and scrolls them to the end, where Quell's panel is."""
    properties = area("PROPERTIES")
    window = bpy.context.window_manager.windows[0]
    edge = properties.x - 1
    yield mouse("mousemove", edge, 400)
    yield mouse("mousedown", 1)
    yield mouse("mousemove", edge - 60, 400)
    yield mouse("mousemove", edge - 120, 400)
    yield mouse("mouseup", 1)
    region = next(r for r in properties.regions if r.type == "WINDOW")
    with bpy.context.temp_override(window=window, area=properties, region=region):
        bpy.ops.view2d.scroll_down(deltay=-5000)
    yield 0.5


def stage(size: tuple[int, int], samples: int) -> bpy.types.Scene:
    """A room's worth of things to look at."""
    scene = test_scene.make()
    scene.cycles.samples = samples
    scene.render.threads_mode = "AUTO"
    scene.render.resolution_x, scene.render.resolution_y = size
    bpy.ops.object.select_all(action="SELECT")
    bpy.data.objects["Camera"].select_set(False)
    bpy.data.objects["Light"].select_set(False)
    bpy.ops.object.delete()
    bpy.ops.mesh.primitive_plane_add(size=40)
    bpy.ops.mesh.primitive_monkey_add(size=2.6, location=(0, 0, 1.1), rotation=(-0.6, 0, 0.6))
    bpy.ops.object.shade_smooth()
    bpy.ops.mesh.primitive_uv_sphere_add(radius=0.9, location=(-1.9, 1.6, 0.9))
    bpy.ops.object.shade_smooth()
    for name, color, metallic, roughness in (
        ("Plane", (0.55, 0.5, 0.45), 0.0, 0.6),
        ("Suzanne", (0.75, 0.2, 0.08), 0.0, 0.4),
        ("Sphere", (0.9, 0.8, 0.5), 1.0, 0.15),
    ):
        material = bpy.data.materials.new(name)
        material.use_nodes = True
        inputs = material.node_tree.nodes["Principled BSDF"].inputs
        inputs["Base Color"].default_value = (*color, 1)
        inputs["Metallic"].default_value = metallic
        inputs["Roughness"].default_value = roughness
        bpy.data.objects[name].data.materials.append(material)
    bpy.data.lights["Light"].type = "AREA"
    light = bpy.data.lights["Light"]  # of another class now
    light.size, light.energy = 3.0, 900.0
    return scene


def render_in_window() -> Iterator[float]:
    """As F12 does it."""
    done: list[str] = []
    finish = lambda *_: done.append("done")  # noqa: E731
    bpy.app.handlers.render_complete.append(finish)
    bpy.app.handlers.render_cancel.append(finish)
    with bpy.context.temp_override(window=bpy.context.window_manager.windows[0]):
        bpy.ops.render.render("INVOKE_DEFAULT")
    yield from until(lambda: done, "the render")
    yield from until(lambda: not bpy.app.is_job_running("RENDER"), "the render job's end")
    bpy.app.handlers.render_complete.remove(finish)
    bpy.app.handlers.render_cancel.remove(finish)
    area("IMAGE_EDITOR").spaces.active.image = part("blender.images").render_result()
    yield 1.0


ticks: list[float] = []


def tick() -> float:
    """Runs whenever the interface is free to."""
    ticks.append(time.monotonic())
    return 0.005


def longest_gap(start: float, end: float) -> float:
    """Seconds for which the interface stood still between two times."""
    inside = [start, *(t for t in ticks if start < t < end), end]
    return max(b - a for a, b in zip(inside, inside[1:], strict=False))


def measure_gaps(scene: bpy.types.Scene) -> Iterator[float]:
    """How long the interface stands still while Cycles renders a larger picture with all passes, and while Quell
    denoises it on the same thread."""
    memory = part("io.memory")
    denoise_layers = memory.denoise_layers
    times: list[float] = []

    def timed(*arguments: object, **options: object) -> object:
        times.append(time.monotonic())
        try:
            return denoise_layers(*arguments, **options)
        finally:
            times.append(time.monotonic())

    memory.denoise_layers = timed
    samples, scene.cycles.samples = scene.cycles.samples, 1
    scene.render.resolution_percentage = 400
    bpy.app.timers.register(tick)
    start = time.monotonic()
    yield from render_in_window()
    bpy.app.timers.unregister(tick)
    memory.denoise_layers = denoise_layers
    scene.render.resolution_percentage, scene.cycles.samples = 100, samples
    found["gap_in_render"] = longest_gap(start, times[0])
    found["gap_in_denoise"] = longest_gap(*times)
    found["denoise_seconds"] = times[1] - times[0]


def cancel_in_render(scene: bpy.types.Scene) -> Iterator[float]:
    """F12, and Esc when Cycles is done and Quell at work."""
    hook = part("blender.engine_hook")
    progress = hook._progress
    waiting: list[bool] = []

    def wait(engine: bpy.types.RenderEngine, fraction: float) -> bool:
        waiting.append(True)
        end = time.monotonic() + PATIENCE
        while not progress(engine, fraction) and time.monotonic() < end:
            time.sleep(0.02)
        return progress(engine, fraction)

    def press() -> float | None:
        if not waiting:
            return WAIT
        mouse("mousemove", 400, 500, "key", "Escape")
        return None

    hook._progress = wait
    bpy.app.timers.register(press)
    yield from render_in_window()
    hook._progress = progress


def steps() -> Iterator[float]:
    state = part("blender.state")
    scene = stage(SIZE, 4)
    scene.render.filepath = str(WORK / "shot_")
    yield 1.0
    editor = area("IMAGE_EDITOR").spaces.active
    editor.show_region_ui = True

    # F12 with Quell: denoised on the render thread, before anything is shown.
    scene.quell.enabled = True
    yield from render_in_window()
    found["render"] = state.status.text
    with in_image_editor():
        bpy.ops.image.view_zoom_ratio(ratio=1.0)
    area("IMAGE_EDITOR").regions[0].tag_redraw()
    yield 1.0
    yield from show_panel()
    yield mouse("mousemove", *TAB, "click", 1)
    yield 1.0
    picture("panel")

    with in_image_editor():
        bpy.ops.quell.toggle_before()
    yield 1.0
    found["before"] = editor.image.name
    picture("before")
    with in_image_editor():
        bpy.ops.quell.toggle_before()
    found["after"] = editor.image.type

    yield from measure_gaps(scene)
    yield from cancel_in_render(scene)
    found["cancel_render"] = state.status.text

    # The button on a noisy render, and Esc while it works. The work waits halfway, for Esc or for the picture.
    files = part("io.files")
    denoise_fresh_file = files.denoise_fresh_file

    def wait(work, is_cancelled: bool, source, output, settings, progress, *rest):
        end = time.monotonic() + (PATIENCE if is_cancelled else 2.0)
        while not progress(0.5) and time.monotonic() < end:
            time.sleep(0.02)
        return work(source, output, settings, progress, *rest)

    scene.quell.when = "BUTTON"
    yield from render_in_window()
    for name in ("cancel", "button"):
        files.denoise_fresh_file = lambda *arguments, name=name: wait(denoise_fresh_file, name == "cancel", *arguments)
        with in_image_editor():
            started = time.monotonic()
            result = bpy.ops.quell.denoise_render("INVOKE_DEFAULT")
            found[f"{name}_started"] = [sorted(result), time.monotonic() - started]
        yield 0.5
        if name == "cancel":
            yield mouse("mousemove", 400, 500, "key", "Escape")
        else:
            picture("progress")
        yield from until(lambda: state.status.icon != "SORTTIME", "the denoising")
        found[name] = state.status.text
    files.denoise_fresh_file = denoise_fresh_file
    yield 1.0
    found["button_image"] = editor.image.name
    picture("button")

    # The compositor, and undo.
    tree = test_scene.compositing_tree(scene)
    bpy.ops.ed.undo_push(message="before")
    before = len(tree.nodes)
    with in_image_editor():
        bpy.ops.quell.use_in_compositor()
    tree = part("blender.compositor").node_tree(bpy.context.scene, create=False)
    found["nodes_added"] = len(tree.nodes) - before
    bpy.ops.ed.undo_push(message="after")
    bpy.ops.ed.undo()
    yield 0.5
    tree = part("blender.compositor").node_tree(bpy.context.scene, create=False)
    found["nodes_after_undo"] = len(tree.nodes) - before


def run() -> float | None:
    try:
        return next(stepper)
    except StopIteration:
        pass
    except Exception:
        found["error"] = traceback.format_exc()
        picture("error")
    (WORK / "window.json").write_text(json.dumps(found, indent=1))
    bpy.ops.wm.quit_blender()
    return None


if bpy.app.version >= (4, 2, 0):
    bpy.ops.extensions.package_install_files(filepath=str(ADDON_ZIP), repo="user_default", enable_on_install=True)
else:
    bpy.ops.preferences.addon_install(filepath=str(ADDON_ZIP))
    bpy.ops.preferences.addon_enable(module=MODULE)
arrange()
stepper = steps()
bpy.app.timers.register(run, first_interval=1.0)
