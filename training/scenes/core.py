# SPDX-License-Identifier: Apache-2.0
"""What every scene family shares: the registry, the stage and camera shots."""

from __future__ import annotations

import hashlib
import math
import random
from collections.abc import Callable
from dataclasses import dataclass, field

import bpy
from mathutils import Vector


@dataclass(frozen=True)
class Shot:
    """One camera: where it stands, what it looks at and how its lens is set."""

    location: Vector
    target: Vector
    lens: float = 35.0
    #: Blur of the lens; None for everything sharp.
    fstop: float | None = None
    focus: float | None = None
    roll: float = 0.0
    #: Camera travel over the shutter time, in metres, for motion blur.
    travel: Vector | None = None


ShotMaker = Callable[[random.Random], Shot]


@dataclass
class Stage:
    """An empty scene being filled, with the only source of randomness it may use."""

    rng: random.Random
    split: str
    scene: bpy.types.Scene
    #: Mean of the tone-mapped picture that lights are scaled to; None leaves them alone.
    brightness: float | None = field(default=None)

    def chance(self, probability: float) -> bool:
        """Return True with the given probability."""
        return self.rng.random() < probability


Builder = Callable[[Stage], ShotMaker]


@dataclass(frozen=True)
class Family:
    """A scene generator with its side of the train/validation split."""

    name: str
    split: str
    build: Builder


FAMILIES: dict[str, Family] = {}


def family(name: str, split: str = "train") -> Callable[[Builder], Builder]:
    """Register a scene generator under a name and a split."""

    def register(build: Builder) -> Builder:
        if name in FAMILIES:
            raise ValueError(f"scene family {name} registered twice")
        FAMILIES[name] = Family(name, split, build)
        return build

    return register


def rng_for(*parts: object) -> random.Random:
    """Return a generator that depends on its arguments alone, on any machine."""
    digest = hashlib.sha256("/".join(str(part) for part in parts).encode()).digest()
    return random.Random(int.from_bytes(digest[:8], "little"))


def log_uniform(rng: random.Random, low: float, high: float) -> float:
    """Return a number whose logarithm is uniform between two bounds."""
    return math.exp(rng.uniform(math.log(low), math.log(high)))


def apply_shot(scene: bpy.types.Scene, shot: Shot) -> None:
    """Point the scene's only camera as the shot says."""
    camera = scene.camera
    if camera is None:
        camera = bpy.data.objects.new("Camera", bpy.data.cameras.new("Camera"))
        scene.collection.objects.link(camera)
        scene.camera = camera
    camera.animation_data_clear()
    data = camera.data
    data.lens = shot.lens
    data.clip_start = 0.005
    data.clip_end = 2000.0
    direction = shot.target - shot.location
    rotation = direction.to_track_quat("-Z", "Y")
    camera.rotation_mode = "QUATERNION"
    camera.rotation_quaternion = rotation
    camera.rotation_quaternion.rotate(_roll(direction, shot.roll))
    camera.location = shot.location
    data.dof.use_dof = shot.fstop is not None
    if shot.fstop is not None:
        data.dof.aperture_fstop = shot.fstop
        data.dof.focus_distance = shot.focus or direction.length
    if shot.travel is not None:
        scene.render.use_motion_blur = True
        move(camera, shot.travel)


def _roll(axis: Vector, angle: float):  # noqa: ANN202 - mathutils has no stable type names
    from mathutils import Quaternion

    return Quaternion(axis.normalized(), angle)


def move(obj: bpy.types.Object, travel: Vector, turn: Vector | None = None) -> None:
    """Let an object move and turn evenly around frame 1, which is the one rendered."""
    start = obj.location.copy()
    for frame, side in ((0, -1.0), (2, 1.0)):
        obj.location = start + travel * side
        obj.keyframe_insert("location", frame=frame)
    if turn is not None and obj.rotation_mode == "XYZ":
        angle = Vector(obj.rotation_euler)
        for frame, side in ((0, -1.0), (2, 1.0)):
            obj.rotation_euler = angle + turn * side
            obj.keyframe_insert("rotation_euler", frame=frame)
    for curve in _curves(obj.animation_data):
        for point in curve.keyframe_points:
            point.interpolation = "LINEAR"


def _curves(animation: bpy.types.AnimData) -> list[bpy.types.FCurve]:
    """Return the curves of an object's own action in any Blender version."""
    if hasattr(animation.action, "fcurves"):
        return list(animation.action.fcurves)
    # Blender 5 keeps them in layers, one bag per animated thing.
    strips = [strip for layer in animation.action.layers for strip in layer.strips]
    bags = [strip.channelbag(animation.action_slot) for strip in strips]
    return [curve for bag in bags if bag is not None for curve in bag.fcurves]


def random_lens(rng: random.Random, low: float = 18.0, high: float = 85.0) -> float:
    """Return a focal length, half of the time one that photographers own."""
    primes = [f for f in (18.0, 24.0, 28.0, 35.0, 50.0, 85.0) if low <= f <= high]
    if primes and rng.random() < 0.5:
        return rng.choice(primes)
    return log_uniform(rng, low, high)


def lens_blur(
    rng: random.Random,
    lens: float,
    distance: float,
    probability: float = 0.2,
    opening: tuple[float, float] = (0.002, 0.02),
) -> tuple[float | None, float | None]:
    """Return (fstop, focus distance), or (None, None) for a sharp picture.

    The opening is the lens' diameter in terms of the distance to the subject: what decides
    how many pixels things before and behind it are blurred by.
    """
    if rng.random() >= probability:
        return None, None
    diameter = log_uniform(rng, *opening) * distance
    return lens / 1000 / diameter, distance * rng.uniform(0.85, 1.1)


def orbit(
    center: Vector,
    radius: tuple[float, float],
    elevation: tuple[float, float] = (5.0, 50.0),
    lens: tuple[float, float] = (24.0, 85.0),
    azimuth: tuple[float, float] = (0.0, 360.0),
    spread: float = 0.15,
    blur: float = 0.2,
) -> ShotMaker:
    """Return shots that circle a subject; angles in degrees, radius for a 50 mm lens."""

    def make(rng: random.Random) -> Shot:
        focal = random_lens(rng, *lens)
        # A longer lens steps back, though not all the way: close-ups are wanted too.
        distance = rng.uniform(*radius) * (focal / 50.0) ** 0.7
        polar = math.radians(rng.uniform(*elevation))
        around = math.radians(rng.uniform(*azimuth))
        offset = Vector(
            (
                math.cos(polar) * math.cos(around),
                math.cos(polar) * math.sin(around),
                math.sin(polar),
            )
        )
        size = radius[0] * spread
        target = center + Vector([rng.gauss(0, size) for _ in range(2)] + [rng.gauss(0, size / 2)])
        fstop, focus = lens_blur(rng, focal, distance, blur)
        roll = rng.gauss(0, 0.08) if rng.random() < 0.15 else 0.0
        return Shot(center + offset * distance, target, focal, fstop, focus, roll)

    return make


def inside(low: Vector, high: Vector, lens: tuple[float, float] = (16.0, 40.0), blur: float = 0.15) -> ShotMaker:
    """Return shots from near the walls of a box-shaped room towards its middle."""

    def make(rng: random.Random) -> Shot:
        size = high - low
        side = rng.choice("xXyY")
        along = rng.uniform(0.15, 0.85)
        near = rng.uniform(0.06, 0.2)
        x, y = (near, along) if side.lower() == "x" else (along, near)
        if side.isupper():
            x, y = 1.0 - x, 1.0 - y
        height = min(rng.uniform(0.7, 1.9), size.z - 0.3)
        location = low + Vector((size.x * x, size.y * y, height))
        target = low + Vector(
            (
                size.x * rng.uniform(0.25, 0.75),
                size.y * rng.uniform(0.25, 0.75),
                min(rng.uniform(0.3, 1.5), size.z * 0.7),
            )
        )
        focal = random_lens(rng, *lens)
        fstop, focus = lens_blur(rng, focal, (target - location).length, blur)
        return Shot(location, target, focal, fstop, focus)

    return make
