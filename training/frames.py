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
from training.data.store import CHANNELS, pass_slice, write_atomic, write_render
from training.scenes.build import build_scene
from training.scenes.core import Shot, ShotMaker, Stage, apply_shot, rng_for
from training.scenes.lights import scale_lights

if TYPE_CHECKING:
    from training.render import Config, Job

#: Final resolutions that frames are cut out of, so that a pixel covers as much of the
#: scene as in pictures that people render; the first is a whole small picture.
_RESOLUTIONS = ((0, 0), (640, 360), (960, 540), (1280, 720), (1920, 1080))
#: Sub-folder of a frame for the passes that its scene alone has, named by "extra" in meta.json, 3 channels each.
EXTRA = "extra"
#: Sampling settings that scenes may change; recorded in meta.json.
LIGHT_PATHS = ("sample_clamp_indirect", "blur_glossy", "caustics_reflective", "caustics_refractive", "max_bounces")
_PREVIEW_LONG_SIDE = 208
_PREVIEW_SPP = 3
#: Lights that would need to be stronger or weaker by more than this are not where the scene needs them.
_MOST_GAIN = 100.0
_REGION_TRIES = 40
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
        index = view_rng.choice((0, 1, 1, 1, 2, 2, 3, 4))
        resolution = _RESOLUTIONS[index] if index else (config.size, config.size)
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


_LIT = tuple(
    i
    for i, name in enumerate(CHANNELS)
    if name.split(".")[0] in ("Combined", "Emit", "Env") and not name.endswith(".A")
)


def scaled(preview: np.ndarray, gain: float) -> np.ndarray:
    """Return a preview as it will look once its lights are multiplied."""
    out = preview.copy()
    out[list(_LIT)] *= gain
    return out


def luminance(pixels: np.ndarray) -> np.ndarray:
    """Return the luminance of [3,H,W]."""
    return 0.2126 * pixels[0] + 0.7152 * pixels[1] + 0.0722 * pixels[2]


def smooth(image: np.ndarray, size: int = 4) -> np.ndarray:
    """Return block means: noise of a few samples must not look like detail."""
    h, w = (n - n % size for n in image.shape)
    return image[:h, :w].reshape(h // size, size, w // size, size).mean((1, 3))


def whole_picture_fault(preview: np.ndarray) -> str:
    """Say what makes the whole view useless, "" if nothing does."""
    depth = preview[pass_slice("Depth")][0]
    hit = depth > 0
    if hit.mean() < 0.15 and not preview[pass_slice("VolumeDir")].any():
        return "nothing to see"
    if hit.any() and (depth[hit] < 0.12).mean() > 0.35:
        return "camera too close to something"
    if not np.isfinite(preview).all():
        return "non-finite preview"
    light, alpha = luminance(preview[pass_slice("Combined")]), preview[pass_slice("Combined")][3]
    if light.max() <= 1e-6:
        return "black"
    # Where most samples find no light at all, an artist would light the scene in another way.
    if (light[alpha > 0.5] <= 1e-6).mean() > 0.6:
        return "hardly lit"
    return ""


def choose_gain(preview: np.ndarray, brightness: float | None) -> float | None:
    """Return the factor that brings the mean tone-mapped luminance to what is wanted."""
    if brightness is None:
        return 1.0
    combined = preview[pass_slice("Combined")]
    light, alpha = smooth(luminance(combined)), smooth(combined[3])
    # On transparent film the emptiness around a cut-out says nothing about its exposure.
    light = light[alpha > 0.5] if (alpha > 0.5).mean() > 0.02 else light
    low, high = math.log(1 / 512), math.log(512)
    for _ in range(40):
        middle = (low + high) / 2
        mean = float(np.mean(tone(light * math.exp(middle))))
        low, high = (middle, high) if mean < brightness else (low, middle)
    gain = math.exp((low + high) / 2)
    if not 1 / _MOST_GAIN < gain < _MOST_GAIN:
        return None
    # Quantised, so that rounding in the preview cannot make two machines differ.
    return 2.0 ** (round(4 * math.log2(gain)) / 4)


def tone(light: np.ndarray) -> np.ndarray:
    """Map scene light to 0..1 roughly as a view transform does."""
    return (light / (1.0 + light)) ** (1 / 1.8)


def choose_region(
    preview: np.ndarray, resolution: tuple[int, int], size: int, rng: random.Random
) -> tuple[tuple[int, int, int, int] | None, str]:
    """Pick one of the regions that are not flat, black, burnt out or sky; None with a reason."""
    width, height = resolution
    ph, pw = preview.shape[1:]
    if (width, height) == (size, size):
        candidates = [(0, 0)]
    else:
        candidates = [(rng.randint(0, width - size), rng.randint(0, height - size)) for _ in range(_REGION_TRIES)]
    scored, reasons = [], []
    for x, y in candidates:
        x0, y0 = x * pw // width, y * ph // height
        x1, y1 = max(x0 + 16, (x + size) * pw // width), max(y0 + 16, (y + size) * ph // height)
        score, reason = region_score(preview[:, y0:y1, x0:x1])
        if reason:
            reasons.append(reason)
        else:
            scored.append(((x, y, size, size), score))
    if not scored:
        return None, f"region: {reasons[0]}"
    # Not always the very best: plainer regions are part of every picture too.
    return rng.choices([r for r, _ in scored], [s for _, s in scored])[0], ""


def edges(planes: np.ndarray) -> float:
    """Return how much [C,H,W] changes from one 2x2 block to the next: little where all is plain or out of focus."""
    blocks = np.stack([smooth(plane, 2) for plane in planes])
    return float(np.abs(np.diff(blocks, axis=1)).mean() + np.abs(np.diff(blocks, axis=2)).mean())


def region_score(part: np.ndarray) -> tuple[float, str]:
    """Return how much there is to see in a region, or why it is not worth rendering."""
    light = smooth(luminance(part[pass_slice("Combined")]), 2)
    toned = tone(np.maximum(light, 0.0))
    hit = part[pass_slice("Depth")][0] > 0
    fog = part[pass_slice("VolumeDir")].any()
    shine = smooth(luminance(part[pass_slice("Emit")] + part[pass_slice("Env")]), 2)
    if toned.mean() < 0.05:
        return 0.0, "black"
    if (toned > 0.93).mean() > 0.4:
        return 0.0, "burnt out"
    if hit.mean() < 0.25 and not fog:
        return 0.0, "empty sky"
    if (shine > 0.6 * light).mean() > 0.6:
        return 0.0, "all emission"
    albedo = np.clip(part[pass_slice("Denoising Albedo")], 0.0, 1.0)
    detail = edges(albedo) + 0.5 * edges(part[pass_slice("Denoising Normal")])
    if detail < 0.05 and not fog:
        return 0.0, "flat"
    if toned.std() < 0.03:
        return 0.0, "no contrast"
    return (min(detail, 0.3) + 0.4 * float(toned.std())) ** 3, ""
