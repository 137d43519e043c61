# SPDX-License-Identifier: Apache-2.0
"""What C and Python both have to know, compared one by one; and the features, number by number."""

from __future__ import annotations

import re
import subprocess
from pathlib import Path

import numpy as np
import pytest
import torch

from training import export, features, infer
from training.data import store
from training.features import Guides, Layers, log_exponent, make_features
from training.models import pyramid, quell

#: C expression, header, the same in Python.
SHARED = [
    ("QL_NUM_FEATURES", "models/features.h", features.NUM_FEATURES),
    ("QL_NUM_FLAGS", "models/features.h", features.NUM_FLAGS),
    ("QL_KEY_EXPONENT", "models/features.h", features.KEY_EXPONENT),
    ("QL_FIREFLY_FACTOR", "filter/scan.h", features.FIREFLY_FACTOR),
    ("QL_MIN_FIREFLY_FACTOR", "filter/scan.h", features.MIN_FIREFLY_FACTOR),
    ("QL_MAX_FIREFLY_FACTOR", "filter/scan.h", features.MAX_FIREFLY_FACTOR),
    ("QL_UNKNOWN_FIREFLY_FACTOR", "filter/scan.h", features.UNKNOWN_FIREFLY_FACTOR),
    ("QL_BACKGROUND_DEPTH", "frame/roles.h", store.BACKGROUND_DEPTH),
    ("QL_FILTER_TAPS", "models/quell_net.h", pyramid.FILTER_TAPS),
    ("QL_UP_TAPS", "models/quell_net.h", pyramid.UP_TAPS),
    ("QL_NET_DIMS", "models/quell_net.h", quell.EMBEDDING),
    ("QL_FIRST_GUIDE", "models/features.h", features.GUIDE_PLANES.start),
    ("QL_FIRST_GUIDE + QL_NUM_GUIDES", "models/features.h", features.GUIDE_PLANES.stop),
    ("QL_SHARPNESS_RANGE", "kernels/poly.h", pyramid.MAX_SCALE),
    ("QL_NET_GROUPS", "models/quell_net.h", len(quell.GROUPS)),
    ("QL_NET_ALIGNMENT", "models/quell_net.h", infer.ALIGNMENT),
    ("QL_PYRAMID_LEVELS", "filter/pyramid.h", quell.LEVELS),
    ("QL_SIGMOID_RANGE", "kernels/poly.h", quell.IMPORTANCE_RANGE),
]

#: Constants that one C source keeps to itself: file, pattern of its definition, the same in Python.
PRIVATE = [
    ("src/filter/scan.c", r"BAND = (\d+)", features.BIN),
    ("src/filter/scan.c", r"REACH = (\d+)", 2),  # limit_fireflies: 24 neighbours
    ("src/filter/scan.c", r"MIN_NEIGHBOURS = (\d+)", features.MIN_NEIGHBOURS),
]


def compiled(source: str, folder: Path, root: Path, *more: object) -> Path:
    program = folder / "program"
    command = ["gcc", "-std=c11", "-D_POSIX_C_SOURCE=200809L", f"-I{root}/src", f"-I{root}/include", "-o", program]
    subprocess.run([*command, "-x", "c", "-", "-x", "none", *more], input=source, text=True, check=True)
    return program


def test_constants_are_the_same_in_c(root: Path, tmp_path: Path) -> None:
    headers = "".join(f'#include "{header}"\n' for header in sorted({header for _, header, _ in SHARED}))
    prints = "".join(f'    printf("%.9g\\n", (double)({name}));\n' for name, _, _ in SHARED)
    source = f"{headers}#include <stdio.h>\nint main(void)\n{{\n{prints}    return 0;\n}}\n"
    out = subprocess.run([compiled(source, tmp_path, root)], capture_output=True, text=True, check=True).stdout
    found = {name: float(line) for (name, _, _), line in zip(SHARED, out.split(), strict=True)}
    assert found == {name: float(value) for name, _, value in SHARED}


@pytest.mark.parametrize(("file", "pattern", "value"), PRIVATE)
def test_private_constants_are_the_same(file: str, pattern: str, value: float, root: Path) -> None:
    match = re.search(pattern, (root / file).read_text(), re.MULTILINE)
    assert match, f"{file} no longer matches {pattern}"
    assert float(match[1]) == value


def test_weight_file_header_is_what_c_reads(root: Path) -> None:
    text = (root / "src" / "nn" / "weights.c").read_text() + (root / "src" / "nn" / "weights.h").read_text()
    assert export.MAGIC.decode() in text
    assert any(f'"{export.KIND}"' in path.read_text() for path in (root / "src" / "models").glob("*.c"))


@pytest.fixture(scope="module")
def feature_row(root: Path, build: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    library = build / "lib" / "libquell.a"
    assert library.exists(), f"{library} is missing: run make"
    source = (root / "tests" / "training" / "feature_row.c").read_text()
    return compiled(source, tmp_path_factory.mktemp("feature_row"), root, library, "-lm", "-pthread")


NUM = 257
PLANES = {
    "beauty": 3,
    "light": 12,
    "direct": 9,
    "emission": 3,
    "color": 9,
    "albedo": 3,
    "normal": 3,
    "depth": 1,
    "alpha": 1,
}


@pytest.mark.parametrize(
    "without", [(), ("light",), ("albedo",), ("normal",), ("depth",), ("light", "albedo", "depth")]
)
@pytest.mark.parametrize("spp", [0, 1, 64])
def test_features_are_the_same_in_c(without: tuple[str, ...], spp: int, feature_row: Path) -> None:
    """Every plane from values of its own, so that two exchanged planes cannot hide."""
    rng = np.random.default_rng(len(without) + spp)
    rows = {name: rng.lognormal(0, 2, (count, NUM)).astype(np.float32) for name, count in PLANES.items()}
    rows["normal"] = rng.normal(0, 1, (3, NUM)).astype(np.float32)
    rows["alpha"] = rng.uniform(-0.1, 1.1, (1, NUM)).astype(np.float32)
    rows["depth"][0, :4] = 0, 1e10, 3.4e38, -1
    rows["albedo"][0, :2] = 1e20, 0
    exposure, depth_exponent = 3, -2
    head = [
        NUM,
        *(name not in without for name in ("light", "albedo", "normal", "depth")),
        spp,
        exposure,
        depth_exponent,
    ]
    # The library is given direct light, and the sums of direct and indirect; volumes are all indirect here.
    sums = rows["light"].copy()
    sums[:9] += rows["direct"]
    message = np.array(head, "<i4").tobytes() + b"".join({**rows, "light": sums}[name].tobytes() for name in PLANES)
    done = subprocess.run([feature_row], input=message, capture_output=True, check=True)
    flags, found = np.split(np.frombuffer(done.stdout, "<f4"), [features.NUM_FLAGS])

    def plane(name: str, *shape: int) -> torch.Tensor | None:
        return None if name in without else torch.from_numpy(rows[name]).reshape(1, *shape, 1, NUM)

    beauty, light = plane("beauty", 3), plane("light", 4, 3)
    assert beauty is not None
    if light is None:
        layers = Layers(beauty)
    else:
        direct = torch.cat([plane("direct", 3, 3), torch.zeros_like(light[:, :1])], 1)
        layers = Layers(beauty, torch.stack([direct, light], 2), plane("color", 3, 3), plane("emission", 3))
    guides = Guides(plane("albedo", 3), plane("normal", 3), plane("depth", 1), plane("alpha", 1))
    scalars = (torch.tensor([float(v)]) for v in (spp, exposure, depth_exponent))
    wanted = make_features(layers, guides, *scalars)
    np.testing.assert_allclose(flags, wanted.flags[0].numpy(), rtol=1e-6)
    planes = wanted.planes[0, :, 0].numpy()
    for i in range(features.NUM_FEATURES):
        np.testing.assert_allclose(
            found.reshape(NUM, -1)[:, i], planes[i], rtol=3e-6, atol=3e-6, err_msg=f"feature {i}"
        )


def test_log_exponent_moves_with_powers_of_two() -> None:
    image = torch.rand(3, 40, 24, generator=torch.Generator().manual_seed(1)) ** 4
    base = log_exponent(image)
    for stops in (-20, -1, 1, 30):
        assert log_exponent(image * 2.0**stops) == base + stops
    assert log_exponent(torch.zeros(3, 8, 8)) == 0
    # Flat 1/4: log2 is -2 exactly.
    assert log_exponent(torch.full((3, 16, 16), 0.25)) == -2
