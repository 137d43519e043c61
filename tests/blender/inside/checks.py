# SPDX-License-Identifier: Apache-2.0
"""Runs inside Blender: every way through the add-on once. What is rendered stays in the work folder, where the tests
compare it with the tool's result; what can be asserted here is.

    blender -b --factory-startup -P checks.py -- ADDON.zip WORK [CHECK...]          (executable)
    python checks.py -- ADDON.zip WORK [CHECK...]                                   (bpy module)

WORK/results.json gets {check: "ok" | traceback}. By default all checks run, in their order here.
"""

from __future__ import annotations

import importlib
import json
import shutil
import sys
import traceback
from collections.abc import Callable
from pathlib import Path

import bpy

sys.path.insert(0, str(Path(__file__).resolve().parent))

import layout  # noqa: E402
import scene as test_scene  # noqa: E402

_arguments = sys.argv[sys.argv.index("--") + 1 :]
ADDON_ZIP, WORK = map(Path, _arguments[:2])
ONLY = _arguments[2:]
IS_EXTENSION = bpy.app.version >= (4, 2, 0)
MODULE = "bl_ext.user_default.quell" if IS_EXTENSION else "quell_denoiser"

CHECKS: list[Callable[[bpy.types.Scene], None]] = []


def check(function: Callable[[bpy.types.Scene], None]) -> Callable[[bpy.types.Scene], None]:
    CHECKS.append(function)
    return function


def part(name: str):
    """A module of the add-on, by its path inside it."""
    return importlib.import_module(f"{MODULE}.{name}")


def status() -> str:
    return part("blender.state").status.text


def enable(scene: bpy.types.Scene, **settings: object) -> bpy.types.PropertyGroup:
    """Quell on, with these settings and defaults for the others."""
    test_scene.reset(scene.quell)
    for name, value in settings.items():
        setattr(scene.quell, name, value)
    scene.quell.enabled = True
    return scene.quell


def render_denoised(scene: bpy.types.Scene, name: str) -> None:
    """Renders, and insists on Quell's word that it went well."""
    test_scene.render(scene, WORK / name)
    assert status().startswith("Denoised "), status()


def disable(scene: bpy.types.Scene) -> None:
    scene.quell.enabled = False


def install() -> None:
    if IS_EXTENSION:
        bpy.ops.extensions.package_install_files(filepath=str(ADDON_ZIP), repo="user_default", enable_on_install=True)
    else:
        bpy.ops.preferences.addon_install(filepath=str(ADDON_ZIP))
        bpy.ops.preferences.addon_enable(module=MODULE)
    assert MODULE in bpy.context.preferences.addons, "the add-on was not enabled"
    # Small pictures on machines with many cores: threads would mostly wait for one another.
    bpy.context.preferences.addons[MODULE].preferences.threads = 1


# ---- Inside the render ---------------------------------------------------------------------------------------------


@check
def noisy(scene):
    """What the others start from: the same render without Quell."""
    test_scene.render(scene, WORK / "noisy.exr")
    assert status() == "Nothing denoised yet"


@check
def replace(scene):
    enable(scene)
    render_denoised(scene, "replace.exr")


@check
def replace_keep_noisy(scene):
    enable(scene, keep_noisy=True)
    render_denoised(scene, "keep_noisy.exr")


@check
def combined_only(scene):
    enable(scene, layers="COMBINED")
    render_denoised(scene, "beauty.exr")


@check
def quality_levels(scene):
    """Levels whose network was packed work; with another the render is kept, and its weight file is named."""
    for level in part("io.settings").LEVELS:
        enable(scene, quality=level.upper())
        test_scene.render(scene, WORK / f"quality_{level}.exr")
        is_there = level in part("io.library").qualities()
        assert ("Denoised " if is_there else f"quell-{level}.qwt") in status(), status()


@check
def by_name(scene):
    enable(scene, layers="NAMES", layer_names="Combined, no such pass")
    test_scene.render(scene, WORK / "no_such_pass.exr")
    assert "no such pass" in status(), status()


@check
def own_pass(scene):
    enable(scene, target="PASS")
    tree = test_scene.compositing_tree(scene)
    layers = tree.nodes["layers"]
    assert "Quell" in [output.name for output in layers.outputs if output.enabled]
    tree.links.new(layers.outputs["Quell"], tree.nodes["output"].inputs["Image"])
    try:
        render_denoised(scene, "own_pass.exr")
    finally:
        test_scene.drop_compositing(scene)


@check
def compositor_gets_the_result(scene):
    enable(scene)
    test_scene.compositing_tree(scene)
    try:
        render_denoised(scene, "composite.exr")
    finally:
        test_scene.drop_compositing(scene)


@check
def in_tiles(scene):
    enable(scene)
    scene.cycles.use_auto_tile, before = True, scene.cycles.tile_size
    scene.cycles.tile_size = 32
    try:
        render_denoised(scene, "tiles.exr")
    finally:
        scene.cycles.tile_size = before


@check
def two_view_layers(scene):
    other = scene.view_layers.new("Second.Layer")
    other.samples = 5
    other.cycles.denoising_store_passes = True
    try:
        disable(scene)
        test_scene.render(scene, WORK / "two_layers_noisy.exr")
        enable(scene)
        render_denoised(scene, "two_layers.exr")
    finally:
        scene.view_layers.remove(other)


@check
def stereo(scene):
    scene.render.use_multiview = True
    scene.render.views_format = "STEREO_3D"
    scene.render.image_settings.views_format = "MULTIVIEW"
    try:
        disable(scene)
        test_scene.render(scene, WORK / "stereo_noisy.exr")
        enable(scene)
        render_denoised(scene, "stereo.exr")
    finally:
        scene.render.use_multiview = False


@check
def border(scene):
    render = scene.render
    render.use_border = render.use_crop_to_border = True
    render.border_min_x, render.border_max_x, render.border_min_y, render.border_max_y = 0.25, 0.9, 0.1, 0.7
    try:
        disable(scene)
        test_scene.render(scene, WORK / "border_noisy.exr")
        enable(scene)
        render_denoised(scene, "border.exr")
    finally:
        render.use_border = render.use_crop_to_border = False


@check
def stereo_by_the_button(scene):
    """With Blender's default, which is one file for each eye, and which stays the user's."""
    scene.render.use_multiview = True
    scene.render.views_format = "STEREO_3D"
    image_settings = scene.render.image_settings
    try:
        enable(scene, when="BUTTON")
        test_scene.set_format(scene, "OPEN_EXR_MULTILAYER")
        image_settings.views_format = "MULTIVIEW"
        test_scene.render(scene, WORK / "stereo_button.exr")
        image_settings.views_format = "INDIVIDUAL"
        scene.render.filepath = str(WORK / "stereo_pressed")
        assert bpy.ops.quell.denoise_render() == {"FINISHED"}
        assert image_settings.views_format == "INDIVIDUAL"
    finally:
        scene.render.use_multiview = False
        image_settings.views_format = "INDIVIDUAL"


@check
def border_in_a_full_picture(scene):
    """Without cropping: Blender's file has black around the border, and so has the result."""
    render = scene.render
    render.use_border, render.use_crop_to_border = True, False
    render.border_min_x, render.border_max_x, render.border_min_y, render.border_max_y = 0.25, 0.9, 0.1, 0.7
    try:
        enable(scene, output="FILE")
        render_denoised(scene, "border_open.exr")
        enable(scene)
        render_denoised(scene, "border_open_inside.exr")
    finally:
        render.use_border = False


@check
def animation(scene):
    test_scene.set_format(scene, "OPEN_EXR_MULTILAYER")
    scene.frame_start, scene.frame_end = 1, 3
    for name in ("animation_noisy", "animation"):
        disable(scene) if name.endswith("noisy") else enable(scene, when="ANIMATION")
        scene.render.filepath = str(WORK / name / "f_####")
        bpy.ops.render.render(animation=True)
    assert len(list((WORK / "animation").iterdir())) == 3


@check
def stills_are_left_alone_when_only_animations_are_wanted(scene):
    enable(scene, when="ANIMATION")
    test_scene.render(scene, WORK / "still_untouched.exr")


@check
def nothing_happens_by_button_only(scene):
    enable(scene, when="BUTTON")
    test_scene.render(scene, WORK / "button_only.exr")


# ---- By files ------------------------------------------------------------------------------------------------------


@check
def file_beside_the_render(scene):
    enable(scene, output="FILE")
    render_denoised(scene, "beside.exr")
    assert (WORK / "beside_quell.exr").exists()
    assert status().startswith("Denoised "), status()


@check
def file_in_place(scene):
    enable(scene, output="FILE", pattern="{name}")
    render_denoised(scene, "in_place.exr")


@check
def file_beside_another_format(scene):
    """A PNG is rendered: the passes come from the render result."""
    enable(scene, output="FILE", pattern="{name}_all")
    test_scene.set_format(scene, "PNG")
    before = {f: getattr(scene.render.image_settings, f) for f in ("file_format", "color_mode", "color_depth")}
    scene.frame_set(1)
    scene.render.filepath = str(WORK / "picture_####")
    bpy.ops.render.render(write_still=True)
    assert (WORK / "picture_0001_all.exr").exists(), sorted(p.name for p in WORK.iterdir())
    assert {f: getattr(scene.render.image_settings, f) for f in before} == before


@check
def both(scene):
    enable(scene, output="BOTH")
    render_denoised(scene, "both.exr")
    assert (WORK / "both_quell.exr").exists()


@check
def animation_of_files(scene):
    enable(scene, output="FILE")
    test_scene.set_format(scene, "OPEN_EXR_MULTILAYER")
    scene.render.filepath = str(WORK / "animation_files" / "f_####")
    bpy.ops.render.render(animation=True)
    assert len(list((WORK / "animation_files").glob("*_quell.exr"))) == 3


@check
def without_the_hook(scene):
    """As in a version whose engine lacks what the hook needs."""
    hook = part("blender.engine_hook")
    hook._runtime_problem = "closed for this test"
    try:
        enable(scene)
        render_denoised(scene, "closed.exr")
    finally:
        hook._runtime_problem = ""
    assert (WORK / "closed_quell.exr").exists()


# ---- The buttons ---------------------------------------------------------------------------------------------------


@check
def button(scene):
    enable(scene, when="BUTTON")
    test_scene.render(scene, WORK / "button.exr")
    scene.render.filepath = str(WORK / "pressed")
    assert bpy.ops.quell.denoise_render() == {"FINISHED"}
    assert (WORK / "pressed0001_quell.exr").exists(), sorted(p.name for p in WORK.iterdir())
    assert "Quell Result" in bpy.data.images


@check
def use_in_compositor(scene):
    """Goes on from the button's result."""
    tree = test_scene.compositing_tree(scene)
    layers, output = tree.nodes["layers"], tree.nodes["output"]
    blur = tree.nodes.new("CompositorNodeBlur")
    tree.links.new(layers.outputs["Depth"], blur.inputs["Image"])
    before = len(tree.nodes)
    try:
        for _ in range(2):  # the second click changes nothing
            bpy.ops.quell.use_in_compositor()
            assert len(tree.nodes) == before + 1
            (image_link,) = output.inputs["Image"].links
            (depth_link,) = blur.inputs["Image"].links
            assert image_link.from_node == depth_link.from_node == tree.nodes["Quell layers"]
            assert (image_link.from_socket.name, depth_link.from_socket.name) == ("Combined", "Depth")
        scene.quell.enabled = False
        test_scene.render(scene, WORK / "used_in_compositor.exr")
    finally:
        test_scene.drop_compositing(scene)


@check
def enable_passes(scene):
    layer = scene.view_layers[0]
    layer.use_pass_emit = layer.cycles.denoising_store_passes = False
    passes = part("blender.passes")
    assert not passes.is_on(layer, passes.GUIDES) and not passes.is_on(layer, passes.LIGHT)
    bpy.ops.quell.enable_passes()
    assert passes.is_on(layer, passes.GUIDES) and passes.is_on(layer, passes.LIGHT)
    assert passes.megabytes(scene, passes.GUIDES) == test_scene.SIZE**2 * 7 * 4 / 2**20


@check
def passes_and_their_cost_by_undo(scene):
    """The dialog's default, and Ctrl Z."""
    layer = scene.view_layers[0]
    layer.cycles.denoising_store_passes = False
    bpy.ops.ed.undo_push(message="before")
    assert bpy.ops.quell.enable_passes("EXEC_DEFAULT") == {"FINISHED"}
    assert layer.cycles.denoising_store_passes
    bpy.ops.ed.undo_push(message="after")
    bpy.ops.ed.undo()
    assert not bpy.context.scene.view_layers[0].cycles.denoising_store_passes
    bpy.ops.ed.redo()
    assert bpy.context.scene.view_layers[0].cycles.denoising_store_passes


def drawn(name: str) -> str:
    """What a panel shows, in one line: there is no region that sentences could be broken for."""
    panels = part("blender.panels")
    before = panels._draw_text
    panels._draw_text = lambda layout, text, icon="NONE": layout.label(text=text, icon=icon)
    try:
        return " ".join(layout.draw(getattr(panels, name), bpy.context))
    finally:
        panels._draw_text = before


@check
def panels_draw(scene):
    """Every panel as the user meets it, with what stands in the way and how to mend it."""
    enable(scene)
    view_layer = scene.view_layers[0]
    assert "Quality" in drawn("QUELL_PT_render") and "Enable" not in drawn("QUELL_PT_render")
    assert "File Name" not in drawn("QUELL_PT_output")
    scene.quell.output = "FILE"
    assert "File Name" in drawn("QUELL_PT_output") and "Result" not in drawn("QUELL_PT_output")
    scene.quell.layers = "NAMES"
    assert "Names" in drawn("QUELL_PT_render")

    view_layer.cycles.denoising_store_passes = False
    assert "Enable the Passes Quell Wants" in drawn("QUELL_PT_render")
    view_layer.cycles.denoising_store_passes = True

    scene.cycles.use_denoising = True
    assert "Cycles denoises this scene too. Turn Off Cycles' Denoiser" in drawn("QUELL_PT_render")
    bpy.ops.quell.use_quell_alone()
    assert "too" not in drawn("QUELL_PT_render") and not scene.cycles.use_denoising

    node = test_scene.compositing_tree(scene).nodes.new("CompositorNodeDenoise")
    assert "A Denoise node in the compositor denoises once more." in drawn("QUELL_PT_render")
    node.mute = True
    assert "once more" not in drawn("QUELL_PT_render")
    test_scene.drop_compositing(scene)

    hook = part("blender.engine_hook")
    hook._runtime_problem = "closed for this test"
    assert "closed for this test Results go into EXR files" not in drawn("QUELL_PT_output")
    scene.quell.output = "RENDER"
    assert "closed for this test Results go into EXR files instead." in drawn("QUELL_PT_output")
    hook._runtime_problem = ""


@check
def the_dialog_says_what_passes_cost(scene):
    operator = part("blender.passes").QUELL_OT_enable_passes
    percentage, scene.render.resolution_percentage = scene.render.resolution_percentage, 1600
    shown = layout.draw(operator, bpy.context, bl_rna=bpy.ops.quell.enable_passes.get_rna_type())
    scene.render.resolution_percentage = percentage
    assert "28 MB of memory at this size, in each view layer" in shown, shown
    assert "156 MB of memory at this size, in each view layer" in shown, shown


@check
def files_operator(scene):
    enable(scene)
    folder = WORK / "files"
    folder.mkdir()
    for name in ("a.exr", "b.exr"):
        shutil.copy(WORK / "noisy.exr", folder / name)
    assert bpy.ops.quell.denoise_files(filepath=str(folder / "a.exr")) == {"FINISHED"}
    first = (folder / "a_quell.exr").stat().st_mtime_ns
    assert bpy.ops.quell.denoise_files(directory=str(folder)) == {"FINISHED"}
    assert sorted(p.name for p in folder.iterdir()) == ["a.exr", "a_quell.exr", "b.exr", "b_quell.exr"]
    assert (folder / "a_quell.exr").stat().st_mtime_ns == first, "a finished file was done again"


@check
def dropped_files(scene):
    """As Blender calls it when files are dropped onto an editor: with a folder and names, without the file browser."""
    if not hasattr(bpy.types, "FileHandler"):
        return
    handler = bpy.types.QUELL_FH_exr
    assert (handler.bl_import_operator, handler.bl_file_extensions) == ("quell.denoise_files", ".exr")
    window = bpy.context.window_manager.windows[0]
    area = window.screen.areas[0]
    before = area.type
    try:
        for kind, is_taken in (("IMAGE_EDITOR", True), ("VIEW_3D", False)):
            area.type = kind
            with bpy.context.temp_override(window=window, area=area):
                assert handler.poll_drop(bpy.context) == is_taken
    finally:
        area.type = before
    enable(scene)
    folder = WORK / "dropped"
    folder.mkdir()
    for name in ("a.exr", "b.exr", "c.exr"):
        shutil.copy(WORK / "noisy.exr", folder / name)
    dropped = {"directory": str(folder), "files": [{"name": "a.exr"}, {"name": "c.exr"}]}
    assert bpy.ops.quell.denoise_files("INVOKE_DEFAULT", **dropped) == {"FINISHED"}
    assert sorted(p.stem for p in folder.iterdir()) == ["a", "a_quell", "b", "c", "c_quell"]


@check
def command(scene):
    run = part("io.command").command
    out = WORK / "command"
    assert run(["denoise", str(WORK / "noisy.exr"), "-o", str(out), "-n", "{name}"]) == 0
    (WORK / "broken.exr").write_text("no picture")
    assert run(["denoise", str(WORK / "broken.exr")]) == 1
    assert run(["denoise", str(WORK / "missing.exr")]) == 2
    assert run(["nonsense"]) == 2


@check
def cycles_denoiser_is_switched(scene):
    cycles, layer = scene.cycles, scene.view_layers[0].cycles
    disable(scene)
    cycles.use_denoising, layer.denoising_store_passes = True, False
    scene.quell.enabled = True
    assert (cycles.use_denoising, layer.denoising_store_passes) == (False, True)
    scene.quell.enabled = False
    assert (cycles.use_denoising, layer.denoising_store_passes) == (True, False)
    cycles.use_denoising, layer.denoising_store_passes = False, True


# ---- When something goes wrong -------------------------------------------------------------------------------------


def expect_error(text: str, **arguments: object) -> None:
    """The button's error, which is also what the panel says."""
    try:
        bpy.ops.quell.denoise_render(**arguments)
    except RuntimeError as error:
        assert text in str(error), str(error)
    else:
        raise AssertionError(f"no error; wanted: {text}")
    assert text in status(), status()


@check
def another_engine(scene):
    scene.render.engine = "BLENDER_WORKBENCH"
    try:
        expect_error("made with Cycles")
    finally:
        scene.render.engine = "CYCLES"


@check
def a_render_of_another_engine(scene):
    """Cycles is chosen only after it. Blender's other engines need a graphics card: only what they tell is played."""
    scene.render.engine = "BLENDER_WORKBENCH"
    part("blender.handlers")._on_pre(scene)
    scene.render.engine = "CYCLES"
    expect_error("another engine than Cycles")
    enable(scene)
    render_denoised(scene, "cycles_again.exr")


@check
def no_passes(scene):
    """Combined alone: denoised, with a word about what would help."""
    layer = scene.view_layers[0]
    attributes = [name for name in dir(layer) if name.startswith("use_pass_") and name != "use_pass_combined"]
    before = {name: getattr(layer, name) for name in attributes}
    enable(scene)
    layer.cycles.denoising_store_passes = False
    for name in before:
        setattr(layer, name, False)
    try:
        render_denoised(scene, "no_passes.exr")
        assert "enable the passes Quell wants" in " ".join(part("blender.state").status.details)
    finally:
        layer.cycles.denoising_store_passes = True
        for name, value in before.items():
            setattr(layer, name, value)


@check
def files_without_a_picture(scene):
    """What Quell cannot denoise is said in words, by name; none of it is touched."""
    (WORK / "text.exr").write_text("no picture")
    for source, words in (("text.exr", "text.exr"), ("no_such_file.exr", "There is no file")):
        try:
            bpy.ops.quell.denoise_files(filepath=str(WORK / source))
        except RuntimeError as error:
            assert words in str(error), str(error)
        else:
            raise AssertionError(f"no error for {source}")
        assert words in status(), status()
    assert (WORK / "text.exr").read_text() == "no picture" and not (WORK / "text_quell.exr").exists()


@check
def disk_full(scene):
    """Files may not grow beyond a few bytes, which writers cannot tell from a full disk."""
    import resource
    import signal

    enable(scene, when="BUTTON")
    test_scene.render(scene, WORK / "disk_full.exr")
    scene.render.filepath = str(WORK / "disk_full_pressed")
    handler = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    _, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (10_000, hard))
    try:
        expect_error("could not write")
        try:
            bpy.ops.quell.denoise_files(filepath=str(WORK / "noisy.exr"))
        except RuntimeError as error:
            assert "noisy_quell" in str(error), str(error)
        else:
            raise AssertionError("no error")
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (hard, hard))
        signal.signal(signal.SIGXFSZ, handler)
    assert not list(WORK.glob("disk_full_pressed*")) and not list(WORK.glob("noisy_quell*"))


@check
def a_library_that_cannot_be_loaded(scene):
    """Too old a system, or another processor's package: the panel's sentence, and the render is kept."""
    library = part("io.library")
    native = library.quell().native
    path = native.library_path()
    content = path.read_bytes()
    newer = WORK / "newer.so"
    newer.write_bytes(content.replace(b"GLIBC_2.3", b"GLIBC_9.3"))
    foreign = WORK / "foreign.so"
    foreign.write_bytes(content[:4] + bytes([3 - content[4]]) + content[5:])
    import os

    for file, words in ((newer, "newer.so needs glibc 9.3"), (foreign, "built for another processor")):
        library.quell.cache_clear()
        native.load.cache_clear()
        os.environ["QUELL_LIBRARY"] = str(file)
        try:
            enable(scene)
            test_scene.render(scene, WORK / "not_loaded.exr")
            expect_error(words)
            assert words in library.problem() and words in drawn("QUELL_PT_render")
        finally:
            del os.environ["QUELL_LIBRARY"]
            library.quell.cache_clear()
            native.load.cache_clear()
    render_denoised(scene, "loaded_again.exr")


@check
def pressed_twice(scene):
    enable(scene)
    render_denoised(scene, "twice.exr")
    expect_error("denoised already")


@check
def denoised_by_cycles(scene):
    """Only where Cycles has a denoiser: not in every distribution's build."""
    import _cycles

    if not _cycles.with_openimagedenoise:
        return
    layer = scene.view_layers[0]
    try:
        enable(scene)
        scene.cycles.use_denoising = True
        render_denoised(scene, "from_noisy_image.exr")
        disable(scene)
        scene.cycles.use_denoising = layer.cycles.denoising_store_passes = True
        test_scene.render(scene, WORK / "from_noisy_image_noisy.exr")
    finally:
        disable(scene)
        scene.cycles.use_denoising, layer.cycles.denoising_store_passes = False, True


@check
def cancelled_in_the_render(scene):
    hook = part("blender.engine_hook")
    before = hook._progress
    hook._progress = lambda engine, fraction: True
    try:
        enable(scene)
        test_scene.render(scene, WORK / "cancelled.exr")
    finally:
        hook._progress = before
    assert "cancelled" in status(), status()


@check
def cancelled_by_the_user(scene):
    """As Esc does it: on the job, from outside."""
    job = part("io.job")
    enable(scene, when="BUTTON")
    test_scene.render(scene, WORK / "before_cancel.exr")
    scene.render.filepath = str(WORK / "cancel")
    wait = job.Job.wait
    job.Job.wait = lambda self: (self.cancel(), wait(self))[1]
    try:
        assert bpy.ops.quell.denoise_render() == {"CANCELLED"}
    finally:
        job.Job.wait = wait
    assert "cancelled" in status() and not (WORK / "cancel0001_quell.exr").exists()


@check
def a_fault_in_the_hook(scene):
    """Something nobody thought of: the render is kept, and this frame and the next go by files."""
    hook = part("blender.engine_hook")
    before = hook._read
    hook._read = lambda *_: 1 / 0
    try:
        enable(scene)
        test_scene.render(scene, WORK / "fault.exr")
        assert hook.problem()
    finally:
        hook._read = before
        hook._runtime_problem = ""
    assert (WORK / "fault_quell.exr").exists()


@check
def no_room_for_the_file(scene):
    enable(scene, output="FILE", pattern="no_such_folder/{name}")
    test_scene.render(scene, WORK / "no_room.exr")
    assert "no_such_folder" in status(), status()


@check
def another_librarys_version(scene):
    library = part("io.library")
    package = library.quell()
    before = package.native.ABI_VERSION
    library.quell.cache_clear()
    package.native.load.cache_clear()
    package.native.ABI_VERSION = (7, 0)
    try:
        enable(scene)
        test_scene.render(scene, WORK / "other_version.exr")
        expect_error("needs 7.0")
    finally:
        package.native.ABI_VERSION = before
        library.quell.cache_clear()


@check
def the_batch_record(scene):
    record = WORK / "record.jsonl"
    import os

    os.environ["QUELL_JOURNAL"] = str(record)
    try:
        enable(scene)
        render_denoised(scene, "recorded.exr")
        enable(scene, output="FILE", pattern="no_such_folder/{name}")
        test_scene.render(scene, WORK / "recorded_failure.exr")
    finally:
        del os.environ["QUELL_JOURNAL"]
    lines = [json.loads(line) for line in record.read_text().splitlines()]
    assert [(line["frame"], line["status"]) for line in lines] == [(1, "done"), (1, "failed")]
    assert "ViewLayer.Combined" in lines[0]["denoised"] and "no_such_folder" in lines[1]["message"]


# ---- The end -------------------------------------------------------------------------------------------------------


@check
def nothing_is_left_behind(scene):
    import cycles

    disable(scene)
    bpy.ops.preferences.addon_disable(module=MODULE)
    assert not hasattr(bpy.types.Scene, "quell")
    assert not [name for name in dir(bpy.types) if name.startswith("QUELL_")]
    for name in dir(bpy.app.handlers):
        handlers = getattr(bpy.app.handlers, name)
        if isinstance(handlers, list):
            assert not [h for h in handlers if h.__module__.startswith(MODULE)], name
    for name in ("render", "render_frame_finish", "update_render_passes"):
        assert getattr(cycles.CyclesRender, name).__module__ == "cycles", name
    assert not hasattr(bpy.ops.quell, "denoise_render") or "denoise_render" not in dir(bpy.ops.quell)
    test_scene.render(scene, WORK / "disabled.exr")
    bpy.ops.preferences.addon_enable(module=MODULE)
    enable(scene)
    render_denoised(scene, "enabled_again.exr")
    disable(scene)
    # The bpy module dies when Python handlers are left at its end.
    bpy.ops.preferences.addon_disable(module=MODULE)


def main() -> None:
    results = {}
    try:
        install()
        test_scene.make()
    except Exception:
        results["install"] = traceback.format_exc()
    else:
        results["install"] = "ok"
        for function in CHECKS:
            if ONLY and function.__name__ not in ONLY:
                continue
            try:
                function(bpy.context.scene)  # undo makes it another object
                results[function.__name__] = "ok"
            except Exception:
                results[function.__name__] = traceback.format_exc()
    (WORK / "results.json").write_text(json.dumps(results, indent=1))


main()
