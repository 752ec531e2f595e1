"""Lists the models that come with scenec, by what their files say of themselves."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from scenec.compiler.assets.gltf_file import chunks
from scenec.schemas.codec import Facts
from scenec.schemas.errors import ScenecError

FOLDER = Path(__file__).resolve().parents[2] / "assets" / "models"
#: Ids of suggested labels begin here, out of the way of a cfg's own.
_FIRST_ID = 100
#: What is scattered; all else is placed.
_SCATTERED = ("grass", "flower", "fern", "litter", "shrub", "tree", "dead_wood", "stone")


class Asset(NamedTuple):
    """A model that comes with scenec, by what its file says.

    Attributes:
        name: Of the file, without suffix.
        about: What it is, a sentence.
        size_m: Extents along x, y and z (up), as it stands in a scene.
        parts: Triangles by the name of the part.
        materials: The material of each part.
        label: Suggested for the whole on the level ``class``.
        license: SPDX identifier.
        bytes: Of the file.
    """

    name: str
    about: str
    size_m: tuple[float, float, float]
    parts: dict[str, int]
    materials: dict[str, str]
    label: str
    license: str
    bytes: int

    @property
    def triangles(self) -> int:
        """Counts the triangles of all parts."""
        return sum(self.parts.values())


def shipped() -> dict[str, Asset]:
    """The models that come with scenec, by name.

    Raises:
        ScenecError: They are not where they belong.
    """
    files = sorted(FOLDER.glob("*.glb"))
    if not files:
        raise ScenecError("this installation has no assets: install scenec again")
    return {file.stem: _read(file) for file in files}


def _read(file: Path) -> Asset:
    data = file.read_bytes()
    document = json.loads(chunks(data)[0])
    accessors = document["accessors"]
    parts: dict[str, int] = {}
    materials: dict[str, str] = {}
    lowest, highest = [], []
    for node in document["nodes"]:
        (primitive,) = document["meshes"][node["mesh"]]["primitives"]
        name, copies = node["name"], 1
        if "extensions" in node:
            places = node["extensions"]["EXT_mesh_gpu_instancing"]["attributes"]
            copies = accessors[places["TRANSLATION"]]["count"]
        faces = accessors[primitive["indices"]]["count"] // 3
        parts[name] = parts.get(name, 0) + faces * copies
        materials[name] = document["materials"][primitive["material"]]["name"]
        extent = accessors[primitive["attributes"]["POSITION"]]
        lowest.append(extent["min"])
        highest.append(extent["max"])
    wide, high, deep = (float(v) for v in np.max(highest, axis=0) - np.min(lowest, axis=0))
    card = document["asset"]["extras"]
    # Of instances the extents are of one: then the file says how large the whole is.
    size = tuple(map(float, card.get("size_m", (wide, deep, high))))
    return Asset(
        file.stem, card["about"], (size[0], size[1], size[2]), parts, materials, card["label"],
        card["license"], len(data),
    )  # fmt: skip


def snippet(asset: Asset, assets: dict[str, Asset]) -> Facts:
    """Returns what a cfg needs for an asset: its labels and a class of objects.

    Ids are the same whichever assets are pasted together.

    Args:
        asset: The one asked for.
        assets: All, of which the ids come.
    """
    classes = sorted({other.label for other in assets.values()})
    parts = sorted({part for other in assets.values() for part in other.parts})
    how: dict[str, Any] = {"type": "placed", "poses": [{"x_m": 0, "y_m": 0}]}
    if asset.label in _SCATTERED:
        how = {"type": "meshes", "count": 20}
        if asset.label == "stone":
            how["embed"] = 0.2
    return {
        "labels": {
            "class": {asset.label: _FIRST_ID + classes.index(asset.label)},
            "part": {part: _FIRST_ID + parts.index(part) for part in asset.parts},
        },
        "objects": {
            asset.name: {
                **how,
                "models": [{"file": f"package:assets/models/{asset.name}.glb"}],
                "labels": {"class": asset.label},
                "parts": {part: {"labels": {"part": part}} for part in asset.parts},
            }
        },
    }
