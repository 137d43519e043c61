# SPDX-License-Identifier: Apache-2.0
"""Turn one scene into frames: find cameras and regions worth having, render them."""

from __future__ import annotations

import json
import math
import random
import shutil
import time
import traceback
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import bpy
import numpy as np
from mathutils import Vector

from training import cycles
from training.data.store import CHANNELS, write_atomic, write_render
from training.judge import choose_gain, choose_region, scaled, whole_picture_fault
from training.scenes.build import build_scene
from training.scenes.core import Shot, ShotMaker, Stage, apply_shot, rng_for
from training.scenes.lights import scale_lights

if TYPE_CHECKING:
    from training.render import Config, Job

#: Final resolutions that frames are cut out of, and how often. In small whole pictures (the first is as large as the
#: frame) every pixel is an edge, which is what is hardest; the larger show as much of a scene as what people render.
_RESOLUTIONS = {(0, 0): 3, (384, 256): 3, (640, 360): 3, (960, 540): 2, (1280, 720): 1, (1920, 1080): 1}
#: Sub-folder of a frame for the passes that its scene alone has, named by "extra" in meta.json, 3 channels each.
EXTRA = "extra"
#: Sampling settings that scenes may change; recorded in meta.json.
LIGHT_PATHS = ("sample_clamp_indirect", "blur_glossy", "caustics_reflective", "caustics_refractive", "max_bounces")
_PREVIEW_LONG_SIDE = 208
_PREVIEW_SPP = 3
_SHOT_TRIES = 4
_GRID = 12


@dataclass(frozen=True)
class View:
    """A camera that was found good: what to render of it."""

    attempt: int
    resolution: tuple[int, int]
    region: tuple[int, int, int, int] | None


def fingerprint(scene: bpy.types.Scene) -> str:
    """Return a digest of the built scene, to tell when a generator has changed."""
    import hashlib

    digest = hashlib.sha256()
    for obj in sorted(scene.objects, key=lambda o: o.name):
        if obj.type == "CAMERA":
            continue
        size = len(obj.data.vertices) if obj.type == "MESH" else 0
        matrix = [round(v, 3) + 0.0 for row in obj.matrix_world for v in row]
        digest.update(f"{obj.name} {size} {matrix}".encode())
    for material in sorted(bpy.data.materials, key=lambda m: m.name):
        nodes = len(material.node_tree.nodes) if material.use_nodes else 0
        digest.update(f"{material.name} {nodes}".encode())
    for name in LIGHT_PATHS:
        setting = getattr(scene.cycles, name)
        if setting != scene.cycles.bl_rna.properties[name].default:
            digest.update(f"{name} {setting}".encode())
    return digest.hexdigest()[:16]


def render_scene(config: Config, job: Job, revision: str, note: Path) -> None:
    """Render all missing frames of a scene; whatever goes wrong is recorded, not raised."""
    from training.render import missing, reject

    cameras = [c for c in range(config.cameras) if missing(config, job, c)]
    try:
        stage, maker = build_scene(job.family, job.seed)
        cycles.configure(stage.scene)
        mark = fingerprint(stage.scene)
        gain: float | None = None
        for camera in cameras:
            note.touch()
            gain = render_frame(config, job, camera, stage, maker, mark, gain, revision, note)
    except Exception as error:  # noqa: BLE001 - one broken scene must not end the night's run
        traceback.print_exc()
        for camera in cameras:
            if missing(config, job, camera):
                reject(config, job, camera, f"{type(error).__name__}: {error}")


def render_frame(
    config: Config,
    job: Job,
    camera: int,
    stage: Stage,
    maker: ShotMaker,
    mark: str,
    gain: float | None,
    revision: str,
    note: Path,
) -> float | None:
    """Render one frame; return the light gain of the scene so far (None: not chosen yet)."""
    from training.render import cycles_seed, frame_folder, missing, reject

    folder = frame_folder(config, job, camera)
    meta_path = folder / "meta.json"
    if meta_path.exists():
        meta = json.loads(meta_path.read_text(encoding="utf-8"))
        if meta["fingerprint"] != mark:
            # Renders of two different pictures in one folder would poison the data.
            print(f"{folder}: the generator has changed, frame left as it is", flush=True)
            reject(config, job, camera, "generator changed")
            return gain
        if gain is None:
            gain = meta["light_gain"]
            scale_lights(stage.scene, gain)
        view = View(meta["attempt"], tuple(meta["resolution"]), tuple(meta["region"]))
        apply_shot(stage.scene, compose(stage.scene, maker, shot_rng(job, camera, view.attempt), view.resolution))
    else:
        found, gain, reason = find_view(config, job, camera, stage, maker, gain)
        if found is None:
            reject(config, job, camera, reason)
            return gain
        view = found
        meta = {
            "family": job.family,
            "seed": job.seed,
            "camera": camera,
            "attempt": view.attempt,
            "blender": bpy.app.version_string,
            "resolution": view.resolution,
            "region": view.region,
            "channels": CHANNELS,
            "extra": cycles.extra_passes(stage.scene),
            "light_gain": gain,
            "brightness": stage.brightness,
            "motion_blur": stage.scene.render.use_motion_blur,
            "depth_of_field": stage.scene.camera.data.dof.use_dof,
            "film_transparent": stage.scene.render.film_transparent,
            "light_paths": {name: getattr(stage.scene.cycles, name) for name in LIGHT_PATHS},
            "fingerprint": mark,
            "revision": revision,
            "seconds": {},
            "cycles_seeds": {},
        }
    cycles.set_view(stage.scene, view.resolution, view.region)
    cycles.configure(stage.scene)
    folder.mkdir(parents=True, exist_ok=True)
    wanted = missing(config, job, camera)
    pending = sum(spp for _, spp in wanted)
    for name, spp in wanted:
        seed = cycles_seed(job, camera, name)
        start = time.process_time()
        render = cycles.render(stage.scene, spp, seed)
        extra = np.concatenate([*render.extra.values()]) if render.extra else None
        if not np.isfinite(render.pixels).all() or (extra is not None and not np.isfinite(extra).all()):
            reject(config, job, camera, f"non-finite values in {name}")
            return gain
        meta["seconds"][name] = round(time.process_time() - start, 2)
        meta["cycles_seeds"][name] = seed
        pending -= spp
        # The first render of a view includes the scene's preparation; judge by a later one.
        if spp >= 2 and render.seconds / spp * pending > config.limit:
            reject(config, job, camera, f"too slow: {render.seconds:.1f} s at {spp} spp")
            shutil.rmtree(folder)
            return gain
        write_atomic(meta_path, json.dumps(meta, indent=1).encode())
        if extra is not None:
            (folder / EXTRA).mkdir(exist_ok=True)
            write_render(folder / EXTRA / f"{name}.qfr", extra, spp)
        write_render(folder / f"{name}.qfr", render.pixels, spp)
        note.touch()
    return gain


def shot_rng(job: Job, camera: int, attempt: int) -> random.Random:
    """Return the randomness of one camera attempt."""
    return rng_for(job.family, job.seed, "camera", camera, attempt)


def compose(scene: bpy.types.Scene, maker: ShotMaker, rng: random.Random, resolution: tuple[int, int]) -> Shot:
    """Return the one of a few shots that has most in it, as rays through a coarse grid find."""
    shots = [maker(rng) for _ in range(_SHOT_TRIES)]
    return max(shots, key=lambda shot: interest(scene, shot, resolution[1] / resolution[0]))


def interest(scene: bpy.types.Scene, shot: Shot, aspect: float) -> float:
    """Return how many things a shot shows, less for what blocks the view or hides behind the lens."""
    graph = bpy.context.evaluated_depsgraph_get()
    axis = shot.target - shot.location
    turn = axis.to_track_quat("-Z", "Y")
    half = 18.0 / shot.lens
    seen: dict[str, int] = {}
    blocked = 0
    for row in range(_GRID):
        for column in range(_GRID):
            x, y = (2 * (column + 0.5) / _GRID - 1) * half, (2 * (row + 0.5) / _GRID - 1) * half * aspect
            ray = turn @ Vector((x, y, -1.0))
            hit, place, _, _, obj, _ = scene.ray_cast(graph, shot.location, ray)
            if hit:
                seen[obj.name] = seen.get(obj.name, 0) + 1
                blocked += (place - shot.location).length < 0.25 * axis.length
    # A thing that fills the picture counts little more than one that is met a few times.
    return sum(math.log2(1 + count) for count in seen.values()) - 0.5 * blocked


def find_view(
    config: Config, job: Job, camera: int, stage: Stage, maker: ShotMaker, gain: float | None
) -> tuple[View | None, float | None, str]:
    """Try cameras until a preview shows a region worth rendering."""
    from training.render import _CAMERA_TRIES

    scene, reason = stage.scene, "no camera"
    for attempt in range(_CAMERA_TRIES):
        view_rng = rng_for(job.family, job.seed, "view", camera, attempt)
        (resolution,) = view_rng.choices(list(_RESOLUTIONS), list(_RESOLUTIONS.values()))
        resolution = resolution if any(resolution) else (config.size, config.size)
        apply_shot(scene, compose(scene, maker, shot_rng(job, camera, attempt), resolution))
        factor = min(1.0, _PREVIEW_LONG_SIDE / max(resolution))
        small = tuple(max(16, round(v * factor)) for v in resolution)
        cycles.set_view(scene, small, None)
        preview = cycles.render(scene, _PREVIEW_SPP, 12345 + attempt).pixels
        reason = whole_picture_fault(preview)
        if reason:
            continue
        if gain is None:
            gain = choose_gain(preview, stage.brightness)
            if gain is None:
                reason = "cannot be exposed"
                continue
            scale_lights(scene, gain)
            preview = scaled(preview, gain)
        region, reason = choose_region(preview, resolution, config.size, view_rng)
        if region is not None:
            return View(attempt, resolution, region), gain, ""
    return None, gain, reason
