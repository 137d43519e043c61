# SPDX-License-Identifier: Apache-2.0
"""What is compared: our models, and Open Image Denoise by Blender's names for its quality and prefilter.

A method is set up once for a picture (filters, frames and memory are made) and then run; `run` is what is timed, from
memory to memory.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from bench.common import ROOT
from bench.pictures import LIGHT

sys.path.insert(0, str(ROOT / "python"))

GUIDES = ("Denoising Albedo", "Denoising Normal", "Denoising Depth")


class Ready(Protocol):
    """A method set up for one picture."""

    def run(self) -> float:
        """Denoises once; seconds."""

    def combined(self) -> np.ndarray:
        """The result of the last run, [height][width][3]."""

    def close(self) -> None: ...


@dataclass(frozen=True)
class Method:
    name: str
    is_ours: bool
    set_up: Callable[[dict[str, np.ndarray], int, int], Ready] = field(repr=False)  # passes, spp, threads
    macs_per_pixel: float = float("nan")  # as published for the peer; ours come from the report
    wants_light: bool = False  # one node for each light pass: works only where all of them are there


# ---- Ours ------------------------------------------------------------------------------------------------------------


class Ours:
    def __init__(self, passes: dict[str, np.ndarray], spp: int, threads: int, model: str) -> None:
        import quell

        self.context = quell.Context(threads=threads)
        self.model = self.context.open_model(model)
        height, width = passes["Combined"].shape[:2]
        self.frame = self.context.new_frame(width, height)
        for name, pixels in passes.items():
            self.frame.add_layer(name, pixels)
        self.frame.set_samples(spp)
        self.report = None

    def run(self) -> float:
        start = time.perf_counter()
        self.report = self.context.denoise(self.frame, self.model)
        return time.perf_counter() - start

    def combined(self) -> np.ndarray:
        return self.frame.pixels("Combined")[..., :3]

    def close(self) -> None:
        self.frame.close()
        self.model.close()
        self.context.close()


def only_combined(passes: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    return {name: passes[name] for name in ("Combined", *GUIDES) if name in passes}


def our_models() -> list[str]:
    """The networks inside the library: the quality levels, and what else there is."""
    import quell

    return quell.models()


def our_methods() -> list[Method]:
    methods = []
    for model in our_models():

        def all_passes(passes, spp, threads, model=model):
            return Ours(passes, spp, threads, model)

        def beauty(passes, spp, threads, model=model):
            return Ours(only_combined(passes), spp, threads, model)

        methods.append(Method(model, True, all_passes))
        methods.append(Method(f"{model}, beauty", True, beauty))
    return methods


# ---- Open Image Denoise ----------------------------------------------------------------------------------------------

#: Blender's names -> quality as the library counts it, accurate prefilter, multiply-adds per pixel of its networks
PEER_SETTINGS = {
    "OIDN Fast/Fast": (4, False, 62_136.0),
    "OIDN Balanced/Accurate": (5, True, 365_850.0),
    "OIDN High/Fast": (6, False, 125_406.0),
    "OIDN High/Accurate": (6, True, 922_752.0),
}


PER_PASS_SETTING = "OIDN High/Accurate"  # Blender's default


class Filters:
    """The filters of one Denoise node, as Blender sets them: the guides are prefiltered or not, and the main filter is
    told which."""

    def __init__(self, device, images: dict[str, np.ndarray], quality: int, is_accurate: bool) -> None:
        self.images = {name: np.ascontiguousarray(image, np.float32) for name, image in images.items()}
        self.output = np.empty_like(self.images["color"])
        self.filters = []
        if is_accurate:
            for name in ("albedo", "normal"):
                clean = np.empty_like(self.images[name])
                self.filters.append(self.make(device, {name: self.images[name]}, clean, quality=quality))
                self.images[name] = clean
        self.filters.append(
            self.make(device, self.images, self.output, quality=quality, hdr=True, cleanAux=is_accurate)
        )

    @staticmethod
    def make(device, images: dict[str, np.ndarray], output: np.ndarray, **flags: bool | int):
        import pyoidn

        made = pyoidn.Filter(device, "RT")
        for name, image in {**images, "output": output}.items():
            made.set_image(name, image, pyoidn.OIDN_FORMAT_FLOAT3)
        for name, value in flags.items():
            made.set_bool(name, value) if isinstance(value, bool) else made.set_int(name, value)
        made.commit()
        return made

    def run(self) -> np.ndarray:
        for each in self.filters:
            each.execute()
        return self.output

    def close(self) -> None:
        for each in self.filters:
            each.release()


class Peer:
    """color: the names of the layers that are denoised, each by a node of its own."""

    def __init__(self, passes: dict[str, np.ndarray], threads: int, setting: str, layers: list[str]) -> None:
        import pyoidn

        quality, is_accurate, _ = PEER_SETTINGS[setting]
        self.device = pyoidn.Device()
        self.device.set_bool("setAffinity", False)  # as Blender does
        self.device.set_int("numThreads", threads)
        self.device.commit()
        guides = {"albedo": passes["Denoising Albedo"][..., :3], "normal": passes["Denoising Normal"][..., :3]}
        self.passes = passes
        self.nodes = {
            layer: Filters(self.device, {"color": passes[layer][..., :3], **guides}, quality, is_accurate)
            for layer in layers
        }

    def run(self) -> float:
        start = time.perf_counter()
        for node in self.nodes.values():
            node.run()
        seconds = time.perf_counter() - start
        error = self.device.get_error()
        if error:
            sys.exit(f"Open Image Denoise: {error}")
        return seconds

    def combined(self) -> np.ndarray:
        return self.nodes["Combined"].output

    def close(self) -> None:
        for node in self.nodes.values():
            node.close()
        self.device.release()


class PeerPerPass(Peer):
    """Every light pass and colour through a node of its own, then put together again as Cycles defines them."""

    def __init__(self, passes: dict[str, np.ndarray], threads: int, setting: str) -> None:
        self.added = added_passes(passes)
        super().__init__(passes, threads, setting, nodes_of(passes))

    def combined(self) -> np.ndarray:
        def clean(name: str) -> np.ndarray:
            return self.nodes[name].output if name in self.nodes else np.zeros_like(self.passes[name][..., :3])

        return total_of({name: clean(name) for name in (*LIGHT, *self.added)}, self.added)


def added_passes(passes: dict[str, np.ndarray]) -> list[str]:
    """Passes that are summed as they are. Environment is one unless the film is transparent: what closes better on the
    noisy passes is taken."""
    added = [name for name in ("VolumeDir", "VolumeInd", "Emit") if name in passes]
    if "Env" in passes:
        rest = passes["Combined"][..., :3] - total_of({n: p[..., :3] for n, p in passes.items()}, added)
        if np.abs(rest - passes["Env"][..., :3]).mean() < np.abs(rest).mean():
            added.append("Env")
    return added


def nodes_of(passes: dict[str, np.ndarray]) -> list[str]:
    """The passes that need a node: those that hold anything."""
    return [name for name in (*LIGHT, *added_passes(passes)) if np.any(passes[name])]


def total_of(passes: dict[str, np.ndarray], added: list[str]) -> np.ndarray:
    """Combined as the sum of its passes; added: those that come as they are."""
    total = sum((passes[name] for name in added), np.float32(0))
    for group in ("Diff", "Gloss", "Trans"):
        total = total + (passes[f"{group}Dir"] + passes[f"{group}Ind"]) * passes[f"{group}Col"]
    return total


def peer_methods() -> list[Method]:
    methods = []
    for setting, (_, _, macs) in PEER_SETTINGS.items():

        def one(passes, spp, threads, setting=setting):
            return Peer(passes, threads, setting, ["Combined"])

        methods.append(Method(setting, False, one, macs))

    def per_pass(passes, spp, threads):
        return PeerPerPass(passes, threads, PER_PASS_SETTING)

    methods.append(Method(f"{PER_PASS_SETTING} per light pass", False, per_pass, wants_light=True))
    return methods


def has_light(passes: dict[str, np.ndarray]) -> bool:
    return all(name in passes for name in LIGHT)
