# SPDX-License-Identifier: Apache-2.0
"""Runs inside Blender for bench/blender.py: renders the samples' scenes, denoises them, and times a frame.

    python inside_blender.py samples FOLDER SPP,...          renders what FOLDER lacks
    python inside_blender.py denoise ADDON.zip FOLDER        denoises what is there, by the add-on
    python inside_blender.py time ADDON.zip FOLDER RUNS WIDTH HEIGHT      FOLDER/time.json

`python` is one with bpy. Cycles' own denoiser is at Blender's defaults, which are checked.
"""

from __future__ import annotations

import importlib
import json
import os
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType

import bpy

ROOT = Path(__file__).resolve().parents[1]
MODULE = "bl_ext.user_default.quell"


@dataclass(frozen=True)
class Method:
    """What is asked of Quell: on its command line, and as settings of the scene."""

    name: str
    options: list[str]
    settings: dict[str, str]

    @property
    def has_light(self) -> bool:
        return self.settings["layers"] == "ALL"


def install(addon: Path) -> None:
    bpy.ops.extensions.package_install_files(filepath=str(addon), repo="user_default", enable_on_install=True)
    assert MODULE in bpy.context.preferences.addons, "the add-on was not enabled"


def package() -> ModuleType:
    """The Python package inside the add-on."""
    return importlib.import_module(f"{MODULE}.io.library").quell()


def methods() -> list[Method]:
    """Every quality level that there is a network for, on all passes and on Combined alone."""
    return [
        Method(f"Quell {level}, {title}", ["--quality", level, *options], {"quality": level.upper(), "layers": layers})
        for level in package().qualities()
        for title, options, layers in (
            ("all passes", [], "ALL"),
            ("Combined only", ["--layers", "beauty"], "COMBINED"),
        )
    ]


def turn_on_cycles_denoiser(scene: bpy.types.Scene) -> None:
    cycles = scene.cycles
    cycles.use_denoising = True
    found = (cycles.denoiser, cycles.denoising_quality, cycles.denoising_prefilter, cycles.denoising_input_passes)
    assert found == ("OPENIMAGEDENOISE", "HIGH", "ACCURATE", "RGB_ALBEDO_NORMAL"), found


# ---- The samples' scenes ---------------------------------------------------------------------------------------------


def render_samples(folder: Path, spps: list[int]) -> None:
    """SCENE_Nspp.exr of the scenes whose sample names the running version: Combined is what Cycles' denoiser made,
    Noisy Image what it had. Sizes and passes are the samples', so that their references serve."""
    sys.path.insert(0, str(ROOT / "samples"))
    import make_samples

    for name, sample in make_samples.SAMPLES.items():
        if sample.version != bpy.app.version[:2]:
            continue
        wanted = {folder / f"{name}_{spp}spp.exr": spp for spp in spps}
        missing = {path: spp for path, spp in wanted.items() if not path.exists()}
        if not missing:
            continue
        scene = make_samples.prepare(sample)
        make_samples.choose_passes(scene, sample, reference=False)
        scene.render.use_compositing = False
        scene.render.image_settings.color_depth = "32"
        turn_on_cycles_denoiser(scene)
        for index, (path, spp) in enumerate(missing.items()):
            unfinished = path.with_suffix(".part.exr")
            make_samples.render(scene, unfinished, spp, sample.seed + 100 + index)
            unfinished.rename(path)


def denoise_samples(addon: Path, folder: Path) -> None:
    install(addon)
    command = importlib.import_module(f"{MODULE}.io.command").command
    files = [str(path) for path in sorted(folder.glob("*spp.exr"))]
    for method in methods():
        out = ["--out", str(folder / method.name), "--name", "{name}", "--again"]
        if command(["denoise", *files, *out, *method.options]) != 0:
            sys.exit(f"{method.name}: some of the files failed")
    bpy.ops.preferences.addon_disable(module=MODULE)


# ---- Seconds of a frame ----------------------------------------------------------------------------------------------


def build_scene(size: tuple[int, int]) -> bpy.types.Scene:
    """Cheap to render, with light in every light pass: a glossy ball, a glass one, a lamp's mesh, mist, a sky."""
    bpy.ops.wm.read_factory_settings()
    scene = bpy.context.scene
    scene.render.engine = "CYCLES"
    scene.cycles.device = "CPU"
    scene.cycles.samples = 1
    scene.cycles.use_adaptive_sampling = False
    scene.cycles.use_denoising = False
    scene.render.use_compositing = scene.render.use_sequencer = False
    scene.render.resolution_x, scene.render.resolution_y = size
    scene.render.resolution_percentage = 100
    for place, values in (
        ((3, -1, 0), {"Metallic": 1.0, "Roughness": 0.3}),
        ((0, -4, 0), {"Transmission Weight": 1.0, "Roughness": 0.1}),
        ((-3, 2, 1), {"Emission Strength": 3.0}),
    ):
        bpy.ops.mesh.primitive_uv_sphere_add(location=place)
        material = bpy.data.materials.new("ball")
        material.use_nodes = True
        inputs = material.node_tree.nodes["Principled BSDF"].inputs
        for name, value in values.items():
            inputs[name].default_value = value
        bpy.context.object.data.materials.append(material)
    bpy.ops.mesh.primitive_plane_add(size=40, location=(0, 0, -1))
    bpy.ops.mesh.primitive_cube_add(size=1, location=(2, 1, 0))
    mist = bpy.data.materials.new("mist")
    mist.use_nodes = True
    nodes = mist.node_tree.nodes
    nodes.clear()
    scatter = nodes.new("ShaderNodeVolumeScatter")
    scatter.inputs["Density"].default_value = 0.05
    mist.node_tree.links.new(scatter.outputs[0], nodes.new("ShaderNodeOutputMaterial").inputs["Volume"])
    bpy.context.object.data.materials.append(mist)
    return scene


class Clock:
    """Times what the engine does after the last sample, Quell's part included: Cycles' method as the add-on has wrapped
    it. `busy` is the time that its thread was on a processor, without the library's work: other programs do not change
    it. `longest` is that of the longest step which keeps the interface waiting: one pass that is read or written."""

    def __init__(self) -> None:
        import cycles

        hook = importlib.import_module(f"{MODULE}.blender.engine_hook")
        self.wrapped = [
            (cycles.CyclesRender, "render_frame_finish"),
            (package().Context, "denoise"),
            (hook, "_read"),
            (hook, "_write"),
        ]
        self.originals = [getattr(owner, name) for owner, name in self.wrapped]
        self.seconds = self.busy = self.busy_library = self.longest = 0.0
        finish, denoise, read, write = self.originals

        def timed_finish(engine: bpy.types.RenderEngine) -> None:
            self.busy_library = self.longest = 0.0
            start, start_busy = time.perf_counter(), time.thread_time()
            finish(engine)
            self.seconds = time.perf_counter() - start
            self.busy = time.thread_time() - start_busy - self.busy_library

        def timed_denoise(*arguments: object, **options: object) -> object:
            start = time.thread_time()
            try:
                return denoise(*arguments, **options)
            finally:
                self.busy_library += time.thread_time() - start

        def timed_step(step: Callable[..., object]) -> Callable[..., object]:
            def timed(*arguments: object) -> object:
                start = time.thread_time()
                result = step(*arguments)
                self.longest = max(self.longest, time.thread_time() - start)
                return result

            return timed

        timed = (timed_finish, timed_denoise, timed_step(read), timed_step(write))
        for (owner, name), function in zip(self.wrapped, timed, strict=True):
            setattr(owner, name, function)

    def close(self) -> None:
        for (owner, name), function in zip(self.wrapped, self.originals, strict=True):
            setattr(owner, name, function)


def time_frame(addon: Path, folder: Path, runs: int, size: tuple[int, int]) -> None:
    """Renders one frame by turns without a denoiser, with Cycles' own and with Quell, after a tiny one of each."""
    scene = build_scene(size)
    install(addon)
    passes = importlib.import_module(f"{MODULE}.blender.passes")
    journal = folder / "journal.jsonl"
    os.environ["QUELL_JOURNAL"] = str(journal)
    view_layer = scene.view_layers[0]

    def plain(**_: object) -> None:
        scene.quell.enabled = scene.cycles.use_denoising = False

    def set_light_passes(is_on: bool) -> None:
        for name in passes.LIGHT.attributes:
            owner = view_layer.cycles if name.startswith("cycles.") else view_layer
            setattr(owner, name.removeprefix("cycles."), is_on)

    def case(has_light: bool, set_up: Callable[[], None]) -> Callable[[], dict[str, object]]:
        def run() -> dict[str, object]:
            plain()
            set_light_passes(has_light)
            set_up()
            journal.unlink(missing_ok=True)
            start, start_cpu = time.perf_counter(), time.process_time()
            bpy.ops.render.render()
            row: dict[str, object] = {"frame": time.perf_counter() - start, "cpu": time.process_time() - start_cpu}
            row |= {"finish": clock.seconds, "busy": clock.busy}
            if scene.quell.enabled:
                entry = json.loads(journal.read_text())
                assert entry["status"] == "done", entry
                row |= {"stages": entry["seconds"], "denoised": len(entry["denoised"]), "longest": clock.longest}
            return row

        return run

    def quell(settings: dict[str, str]) -> Callable[[], None]:
        def set_up() -> None:
            for name, value in settings.items():
                setattr(scene.quell, name, value)
            scene.quell.enabled = True

        return set_up

    cases = {
        "nothing": case(False, plain),
        "nothing, all passes": case(True, plain),
        "Cycles' own denoiser": case(False, lambda: turn_on_cycles_denoiser(scene)),
        **{method.name: case(method.has_light, quell(method.settings)) for method in methods()},
    }
    clock = Clock()
    rows = []
    try:
        for run in range(runs + 1):
            scene.render.resolution_percentage = 100 if run else 10
            for name, render in cases.items():
                row = {"case": name, "run": run, **render()}
                if run:
                    rows.append(row)
                    print(f"{name}: {row['frame']:.2f} s", flush=True)
    finally:
        clock.close()
        bpy.ops.preferences.addon_disable(module=MODULE)
    (folder / "time.json").write_text(json.dumps(rows))


def main() -> None:
    task, *arguments = sys.argv[1:]
    if task == "samples":
        render_samples(Path(arguments[0]), [int(spp) for spp in arguments[1].split(",")])
    elif task == "denoise":
        denoise_samples(Path(arguments[0]), Path(arguments[1]))
    else:
        runs, width, height = map(int, arguments[2:])
        time_frame(Path(arguments[0]), Path(arguments[1]), runs, (width, height))


main()
