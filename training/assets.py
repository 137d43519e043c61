# SPDX-License-Identifier: Apache-2.0
"""Unpack and index the furniture models that scenes are built from.

The models come from the Debian package sweethome3d-furniture (CC0 and CC-BY 3.0, per
catalogue); they are unpacked once into the user's cache and never become part of the
repository.  `python -m training.assets` prepares them and prints a summary.
"""

from __future__ import annotations

import hashlib
import json
import re
import zipfile
from collections import Counter
from dataclasses import asdict, dataclass
from functools import lru_cache
from pathlib import Path

from training.data.store import write_atomic
from training.paths import asset_root

CATALOGUES = Path("/usr/share/sweethome3d/furniture")
_VAL_SHARE = 0.25


@dataclass(frozen=True)
class Furniture:
    """One model: where its OBJ lies and how large it is in metres."""

    key: str
    name: str
    category: str
    path: str
    size: tuple[float, float, float]
    opening: bool
    creator: str
    licence: str

    @property
    def split(self) -> str:
        """Return "train" or "val": by asset, so that no model is ever in both."""
        digest = hashlib.sha256(self.key.encode()).digest()
        return "val" if digest[0] / 256 < _VAL_SHARE else "train"


def _properties(text: str) -> dict[str, dict[str, str]]:
    """Parse `key#N=value` lines into one dictionary per N ("" for the header)."""
    entries: dict[str, dict[str, str]] = {}
    for line in text.splitlines():
        match = re.match(r"([A-Za-z0-9]+)(?:#(\d+))?=(.*)", line)
        if match:
            entries.setdefault(match[2] or "", {})[match[1]] = match[3].strip()
    return entries


def _missing_images(obj: Path) -> bool:
    """Tell whether a model names an image that is not there (renders magenta)."""
    text = obj.read_text(encoding="latin-1")
    for library in re.findall(r"^mtllib\s+(.+?)\s*$", text, re.MULTILINE):
        mtl = obj.parent / library
        if not mtl.is_file():
            return True
        for image in re.findall(r"^\s*map_\w+\s+(.+?)\s*$", mtl.read_text(encoding="latin-1"), re.MULTILINE):
            if not (obj.parent / image.split()[-1]).is_file():
                return True
    return False


def _index_catalogue(source: Path, target: Path) -> list[Furniture]:
    with zipfile.ZipFile(source) as archive:
        archive.extractall(target)
        text = archive.read("PluginFurnitureCatalog.properties").decode("latin-1")
    entries = _properties(text)
    licence = entries.get("", {}).get("license", "")
    found = []
    for number, entry in entries.items():
        if not number or "model" not in entry or "modelRotation" in entry:
            continue
        obj = target / entry["model"].lstrip("/")
        if obj.suffix.lower() != ".obj" or not obj.is_file() or _missing_images(obj):
            continue
        found.append(
            Furniture(
                key=f"{source.stem}/{entry.get('id', number)}",
                name=entry.get("name", ""),
                category=entry.get("category", ""),
                path=str(obj.relative_to(asset_root())),
                size=tuple(float(entry[k]) / 100 for k in ("width", "depth", "height")),
                opening=entry.get("doorOrWindow") == "true",
                creator=entry.get("creator", ""),
                licence=licence,
            )
        )
    return found


def _build_index(index: Path) -> None:
    items: list[Furniture] = []
    for source in sorted(CATALOGUES.glob("*.sh3f")):
        items += _index_catalogue(source, asset_root() / "furniture" / source.stem)
    index.parent.mkdir(parents=True, exist_ok=True)
    payload = json.dumps([asdict(item) for item in items], indent=1)
    write_atomic(index, payload.encode())


@lru_cache(maxsize=1)
def furniture() -> tuple[Furniture, ...]:
    """Return all usable models in a fixed order, unpacking them on first use."""
    index = asset_root() / "furniture.json"
    if not index.is_file():
        if not any(CATALOGUES.glob("*.sh3f")):
            return ()
        _build_index(index)
    entries = json.loads(index.read_text(encoding="utf-8"))
    items = [Furniture(**{**entry, "size": tuple(entry["size"])}) for entry in entries]
    return tuple(sorted(items, key=lambda item: item.key))


def main() -> None:
    """Prepare the assets and say what there is."""
    items = furniture()
    print(f"{len(items)} furniture models")
    for (category, split), count in sorted(Counter((i.category, i.split) for i in items).items()):
        print(f"  {category:24s} {split:6s} {count}")


if __name__ == "__main__":
    main()
