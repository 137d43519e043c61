# SPDX-License-Identifier: Apache-2.0
"""Writes a checkpoint as the weight file that the C library reads (docs/FORMATS.md), and reads such files back.

python -m training.export --run NAME --out weights/quell-balanced.qwt --name quell-balanced
"""

from __future__ import annotations

import argparse
import dataclasses
import hashlib
import json
import struct
from pathlib import Path

import numpy as np
import torch

from training.features import NUM_FEATURES, NUM_FLAGS
from training.models.quell import Quell, QuellConfig
from training.train import config_from_json, run_folder

MAGIC = b"QUELLWTS"
VERSION = 1
KIND = "quell-5"
NAME_BYTES = 48
ALIGNMENT = 64
FLOAT, HALF, INT, TEXT = 0, 1, 2, 3


def record(name: str, value: np.ndarray | str) -> tuple[str, int, tuple[int, ...], bytes]:
    if isinstance(value, str):
        data = value.encode()
        return name, TEXT, (len(data),), data
    kinds = {"float32": FLOAT, "float16": HALF, "int32": INT}
    return name, kinds[value.dtype.name], value.shape, value.astype(value.dtype.newbyteorder("<")).tobytes()


def write_weights(path: Path, values: dict[str, np.ndarray | str]) -> str:
    """Writes the file and returns its SHA-256."""
    records = [record(name, value) for name, value in values.items()]
    offset = 24 + 88 * len(records)
    table, body = b"", b""
    for name, kind, shape, data in records:
        padding = -(offset + len(body)) % ALIGNMENT
        body += b"\0" * padding
        dims = tuple(shape) + (1,) * (4 - len(shape))
        encoded = name.encode().ljust(NAME_BYTES, b"\0")
        table += encoded + struct.pack("<6I2Q", kind, len(shape), *dims, offset + len(body), len(data))
        body += data
    size = 24 + len(table) + len(body) + 32
    content = MAGIC + struct.pack("<IIQ", VERSION, len(records), size) + table + body
    content += hashlib.sha256(content).digest()
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(content)
    return hashlib.sha256(content).hexdigest()


def file_name(parameter: str) -> str:
    """What a parameter of the network is called in the file."""
    return parameter.replace("heads.", "head.")


def tensors(model: Quell) -> dict[str, np.ndarray]:
    """Weights in the file's order: convolutions [kh][kw][in][out], linear layers [in][out], biases as they are."""
    out = {}
    for name, value in model.net.state_dict().items():
        if value.ndim == 4:
            value = value.permute(2, 3, 1, 0)
        elif value.ndim == 2:
            value = value.t()
        out[file_name(name)] = value.contiguous().numpy().astype(np.float16)
    return out


class WeightFileError(Exception):
    """A file that is no weight file, or a damaged one."""


def read_weights(path: Path) -> dict[str, np.ndarray | str]:
    """Every record of a weight file; the inverse of write_weights."""
    content = path.read_bytes()
    if len(content) < 56 or content[:8] != MAGIC:
        raise WeightFileError(f"{path}: not a weight file")
    version, count, size = struct.unpack_from("<IIQ", content, 8)
    if version != VERSION:
        raise WeightFileError(f"{path}: version {version}, expected {VERSION}")
    if size != len(content) or hashlib.sha256(content[:-32]).digest() != content[-32:]:
        raise WeightFileError(f"{path}: damaged, its checksum differs")
    kinds = {FLOAT: "<f4", HALF: "<f2", INT: "<i4"}
    values: dict[str, np.ndarray | str] = {}
    for i in range(count):
        name, kind, ndim, *dims, offset, length = struct.unpack_from(f"<{NAME_BYTES}s6I2Q", content, 24 + 88 * i)
        data = content[offset : offset + length]
        value = data.decode() if kind == TEXT else np.frombuffer(data, kinds[kind]).reshape(dims[:ndim])
        values[name.rstrip(b"\0").decode()] = value
    return values


def config_value(values: np.ndarray) -> int | tuple[int, ...]:
    """A setting of QuellConfig: one number, or one for each level."""
    return tuple(int(v) for v in values) if len(values) > 1 else int(values[0])


def load_weights(path: Path) -> Quell:
    """The model that a weight file holds."""
    values = read_weights(path)
    if values.get("meta.kind") != KIND:
        raise WeightFileError(f"{path}: kind {values.get('meta.kind')!r}, expected {KIND!r}")
    names = [field.name for field in dataclasses.fields(QuellConfig)]
    model = Quell(QuellConfig(**{name: config_value(values[f"config.{name}"]) for name in names}))
    state = model.net.state_dict()
    for name, old in state.items():
        value = torch.from_numpy(np.array(values[file_name(name)], np.float32))
        if value.ndim == 4:
            value = value.permute(3, 2, 0, 1)
        elif value.ndim == 2:
            value = value.t()
        if value.shape != old.shape:
            raise WeightFileError(f"{path}: {name} is {tuple(value.shape)}, expected {tuple(old.shape)}")
        state[name] = value
    model.net.load_state_dict(state)
    return model


def load_run(name: str) -> tuple[Quell, int]:
    """The averaged model of a run and its step."""
    folder = run_folder(name)
    config = config_from_json(json.loads((folder / "config.json").read_text())["config"])
    model = Quell(config.model)
    state = torch.load(folder / "checkpoint.pt", weights_only=True, map_location="cpu")
    model.load_state_dict(state["ema"])
    return model, state["step"]


def average(model: Quell, checkpoint: Path) -> None:
    """Replaces the model by its mean with an earlier checkpoint of the same run: a wider average than the run's own."""
    other = torch.load(checkpoint, weights_only=True)["ema"]
    model.load_state_dict({name: 0.5 * (value + other[name]) for name, value in model.state_dict().items()})


def round_to_half(model: Quell) -> Quell:
    """The model as the file holds it."""
    with torch.no_grad():
        for parameter in model.parameters():
            parameter.copy_(parameter.half().float())
    return model


def file_records(model: Quell, name: str, description: str) -> dict[str, np.ndarray | str]:
    """Everything that a weight file of this model holds."""
    config = model.net.config
    return {
        "meta.kind": KIND,
        "meta.name": name,
        "meta.description": description,
        **{
            f"config.{field.name}": np.atleast_1d(np.array(getattr(config, field.name), np.int32))
            for field in dataclasses.fields(config)
        },
        "config.inputs": np.array([NUM_FEATURES, NUM_FLAGS], np.int32),
        **tensors(model),
    }


def export(model: Quell, path: Path, name: str, description: str) -> str:
    """Writes a model as a weight file; returns the file's SHA-256."""
    return write_weights(path, file_records(model, name, description))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--run", required=True)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--name", required=True)
    parser.add_argument("--average", type=Path, help="an earlier checkpoint of the run to take the mean with")
    args = parser.parse_args()
    model, step = load_run(args.run)
    if args.average:
        average(model, args.average)
    sha = export(model, args.out, args.name, f"kernel pyramid network, {step} training steps")
    print(f"{args.out}: {args.out.stat().st_size} bytes, sha256 {sha}")


if __name__ == "__main__":
    main()
