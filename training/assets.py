# SPDX-License-Identifier: Apache-2.0
"""Unpack and index the third-party assets that scenes are built from.

Models come from the Debian package sweethome3d-furniture (CC0 and CC-BY 3.0, per
catalogue), surface textures from redeclipse-data (CC-BY-SA and freer, per folder),
environment pictures from Blender itself and from the npm package @pmndrs/assets (both
CC0).  They are unpacked once into the user's cache and never become part of the
repository; scenes do without those that are not installed.  `python -m training.assets`
prepares them and prints a summary.
"""

from __future__ import annotations

import base64
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
TEXTURES = Path("/usr/share/games/redeclipse/data")
_VAL_SHARE = 0.25


def split_of(key: str) -> str:
    """Return "train" or "val" for an asset: by its name, so that none is ever in both."""
    digest = hashlib.sha256(key.encode()).digest()
    return "val" if digest[0] / 256 < _VAL_SHARE else "train"


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
        """Return the side of the split that this model serves."""
        return split_of(self.key)


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


@dataclass(frozen=True)
class Texture:
    """One tileable picture of a surface, with its height map where there is one."""

    kind: str
    path: Path
    height: Path | None

    @property
    def split(self) -> str:
        """Return the side of the split; variants of one surface stay together."""
        return split_of(re.sub(r"[\W_]*\d*[a-e]?$", "", self.path.stem) + re.sub(r"\D", "", self.path.stem))


#: Kind of surface -> patterns of the files that show it, colour only.
_SURFACES: dict[str, tuple[str, ...]] = {
    "wood": ("wicked/wickedwood??.jpg", "trak/trak4/wood*.jpg", "mikeplus64/wood_c.png", "appleflap/randomwood*.jpg"),
    "stone": (
        "wicked/wicked[rs]*[!nsz].jpg",
        "wicked/wickedmarble*[!nsz].jpg",
        "wicked/stone0?d.jpg",
        "trak/trak4/concrete*.jpg",
        "trak/trak4/plaster*.jpg",
        "jojo/concrete??.png",
        "jojo/red*.png",
        "luckystrike/conc*.jpg",
        "appleflap/dirtyconcrete.jpg",
    ),
    "tile": (
        "wicked/wickedtile*[!nsz].jpg",
        "wicked/highqualitybrick.jpg",
        "trak/trak4/brick*.jpg",
        "trak/trak4/tile*.jpg",
        "unnamed/unnamedtile*.png",
        "unnamed/brick0?.png",
        "jojo/bathtile*.png",
        "mikeplus64/*tile*_c.png",
        "luckystrike/paris_wall*.jpg",
    ),
    "metal": ("wicked/wickedmetal*[!nsz].jpg", "wicked/metal01d.jpg", "philipk/pk02/*_c.png", "trak/trak5/*[a-e].jpg"),
    "cloth": ("torley/desat/*.png", "jojo/carpet01.png"),
    "ground": ("wicked/wickedgr*[!nsz].jpg", "wicked/wickedmoss*[!nsz].jpg", "jojo/grass*.png", "luckystrike/asp*.jpg"),
    "picture": (
        "freezurbern/*_[fblr][tkf].*",
        "elyvisions/*_[fblr][tkf].*",
        "jwin/*_[fblr][tkf].*",
        "luckystrike/pub?.*",
    ),
}
_NOT_COLOR = re.compile(r"_(n|n2|nm|s|z|g|h|i|spec|local|add|glow|light)$", re.IGNORECASE)


def _height_map(path: Path) -> Path | None:
    stem = re.sub(r"_[cd]$", "", path.stem)
    names = (f"{stem}{tail}{path.suffix}" for tail in ("z", "_z"))
    return next((path.with_name(name) for name in names if path.with_name(name).is_file()), None)


@lru_cache(maxsize=1)
def textures() -> tuple[Texture, ...]:
    """Return all surface pictures in a fixed order; none if the package is not there."""
    found = {
        path: Texture(kind, path, _height_map(path))
        for kind, patterns in _SURFACES.items()
        for pattern in patterns
        for path in TEXTURES.glob(pattern)
        if not _NOT_COLOR.search(path.stem)
    }
    return tuple(found[path] for path in sorted(found))


@lru_cache(maxsize=1)
def environments() -> tuple[Path, ...]:
    """Return the environment pictures of @pmndrs/assets, decoded on first use; none if it is not there."""
    folder = asset_root() / "hdri"
    for source in sorted((asset_root() / "node_modules/@pmndrs/assets/hdri").glob("*.exr.js")):
        target = folder / source.name.removesuffix(".js")
        if not target.is_file():
            folder.mkdir(parents=True, exist_ok=True)
            text = source.read_text(encoding="utf-8").split("base64,", 1)[1]
            write_atomic(target, base64.b64decode(re.match(r"[A-Za-z0-9+/=]+", text)[0]))
    return tuple(sorted(folder.glob("*.exr")))


def main() -> None:
    """Prepare the assets and say what there is."""
    print(f"{len(environments())} environment pictures beside Blender's own")
    print(f"{len(textures())} surface textures")
    for (kind, split), count in sorted(Counter((t.kind, t.split) for t in textures()).items()):
        print(f"  {kind:24s} {split:6s} {count}")
    items = furniture()
    print(f"{len(items)} furniture models")
    for (category, split), count in sorted(Counter((i.category, i.split) for i in items).items()):
        print(f"  {category:24s} {split:6s} {count}")


if __name__ == "__main__":
    main()
