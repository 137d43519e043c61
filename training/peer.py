# SPDX-License-Identifier: Apache-2.0
"""Open Image Denoise (PyPI's pyoidn) run as Blender runs it, by the names Blender gives quality and prefilter."""

from __future__ import annotations

import functools

import numpy as np

#: name -> (quality, prefilter the guides with accurate filters and tell the main filter that they are clean)
SETTINGS = {
    "fast/fast": (4, False),
    "balanced/accurate": (5, True),
    "high/fast": (6, False),
    "high/accurate": (6, True),
}


@functools.cache
def device(threads: int):
    """One device for all calls; thread affinity off, as in Blender."""
    import pyoidn

    made = pyoidn.Device()
    made.set_bool("setAffinity", False)
    if threads:
        made.set_int("numThreads", threads)
    made.commit()
    return made


def run_filter(images: dict[str, np.ndarray], threads: int, **flags: bool | int) -> np.ndarray:
    """One filter; images are [h,w,3] float32, contiguous."""
    import pyoidn

    first = next(iter(images.values()))
    target = np.empty_like(first)
    task = pyoidn.Filter(device(threads), "RT")
    for name, image in {**images, "output": target}.items():
        task.set_image(name, image, pyoidn.OIDN_FORMAT_FLOAT3)
    for name, value in flags.items():
        task.set_bool(name, value) if isinstance(value, bool) else task.set_int(name, value)
    task.commit()
    task.execute()
    error = device(threads).get_error()
    task.release()
    if error:
        raise RuntimeError(f"Open Image Denoise: {error}")
    return target


def denoise(color: np.ndarray, albedo: np.ndarray, normal: np.ndarray, setting: str, threads: int = 0) -> np.ndarray:
    """Denoises Combined [h,w,3] with its guides. setting: a key of SETTINGS."""
    quality, prefilter = SETTINGS[setting]
    images = {
        "color": np.ascontiguousarray(color, np.float32),
        "albedo": np.ascontiguousarray(albedo, np.float32),
        "normal": np.ascontiguousarray(normal, np.float32),
    }
    if prefilter:
        for name in ("albedo", "normal"):
            images[name] = run_filter({name: images[name]}, threads, quality=quality)
        return run_filter(images, threads, hdr=True, cleanAux=True, quality=quality)
    return run_filter(images, threads, hdr=True, quality=quality)


def denoise_passes(
    lights: dict[str, np.ndarray],
    colors: dict[str, np.ndarray],
    albedo: np.ndarray,
    normal: np.ndarray,
    setting: str = "high/accurate",
    threads: int = 0,
) -> dict[str, np.ndarray]:
    """Denoises each pass by itself, as compositing set-ups do: lights [h,w,3] in scene light, colours in 0..1.

    Every pass has a copy of its own in the result; the guides are filtered once where the setting asks for it.
    """
    quality, prefilter = SETTINGS[setting]
    guides = {"albedo": np.ascontiguousarray(albedo, np.float32), "normal": np.ascontiguousarray(normal, np.float32)}
    flags: dict[str, bool | int] = {"quality": quality}
    if prefilter:
        guides = {name: run_filter({name: image}, threads, quality=quality) for name, image in guides.items()}
        flags["cleanAux"] = True
    out = {}
    for name, image in {**lights, **colors}.items():
        if image.any():
            images = {"color": np.ascontiguousarray(image, np.float32), **guides}
            out[name] = run_filter(images, threads, **flags, **({"hdr": True} if name in lights else {"srgb": False}))
        else:
            out[name] = image.copy()
    return out
