"""A batch in three dimensions, as the page stores it: arrays of a ``Model``, deflated.

An element is a line of JSON and a line of base64. Inflated, that is all arrays one after the other,
little-endian, each at a multiple of four bytes; where an array stands in JSON it is
``[type, offset, values]``. Matrices are positions in float32 and nine linear entries in 16 bits of
the largest of their placement (off by 1/65,534 of it).
"""

from __future__ import annotations

import json
import re
import zlib
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenec.datasets.view.layers import Layer
from scenec.datasets.view.record import short
from scenec.schemas.model import Model, Part, Placement, View
from scenec.schemas.picture import srgb_bytes

#: Whole numbers that linear entries of matrices are stored as.
_LINEAR = 32767
#: Tracks keep so many poses of a camera.
_POSES = 500
_EFFORT = 6
_LIBRARY = re.compile(rb"/\*\*(?:\n \*[^\n/]*)*Three\.js Authors(?:[^/]*)\*/\n!function\([^\n]*")
_ZIP = ("resources", "templates", "viewer.zip")


def three() -> bytes | None:
    """The library that draws: three.js (MIT), as trimesh carries it; None without trimesh.

    Its license stands at its head and goes along.
    """
    import importlib.util
    import zipfile

    found = importlib.util.find_spec("trimesh")
    if found is None or found.origin is None:
        return None
    file = Path(found.origin).parent.joinpath(*_ZIP)
    try:
        with zipfile.ZipFile(file) as held:
            page = held.read("viewer.html.template")
    except (OSError, KeyError, zipfile.BadZipFile):
        return None
    # Its license, then the library in one line; behind it stand controls, loaders and their page.
    found_library = _LIBRARY.search(page)
    return None if found_library is None else found_library[0]


class _Arrays:
    """Arrays one after the other."""

    def __init__(self) -> None:
        self.bytes = bytearray()

    def add(self, values: NDArray[Any], kind: str) -> list[Any]:
        """Appends; returns what JSON says of it."""
        self.bytes += bytes(-len(self.bytes) % 4)
        at = len(self.bytes)
        stored = np.ascontiguousarray(values, np.dtype(kind).newbyteorder("<"))
        self.bytes += stored.tobytes()
        return [kind, at, stored.size]


def space_text(model: Model) -> bytes:
    """The element's content: a line of JSON, a line of base64."""
    arrays = _Arrays()
    facts = {
        "name": model.name,
        "origin": [short(v, 12) for v in model.origin.tolist()],
        "parts": [_part(arrays, model, part) for part in model.parts],
        "placements": [_placement(arrays, placement) for placement in model.placements],
        "cameras": [_camera(arrays, view) for view in model.views],
        "suns": [
            [[short(v, 6) for v in to_light.tolist()] for to_light, _ in suns]
            for suns in model.suns
        ],
        "left_out": list(model.losses),
    }
    layer = Layer(facts, zlib.compress(bytes(arrays.bytes), _EFFORT))
    line = json.dumps(facts, allow_nan=False, separators=(",", ":")).replace("<", "\\u003c")
    return line.encode() + b"\n" + layer.text()


def _part(arrays: _Arrays, model: Model, part: Part) -> dict[str, Any]:
    narrow = "u2" if len(part.points) < 1 << 16 else "u4"
    look = model.looks[part.look]
    facts: dict[str, Any] = {
        "path": part.path,
        "points": arrays.add(part.points, "f4"),
        "faces": arrays.add(part.faces, narrow),
        "color": srgb_bytes(np.array(look.base_color)).tolist(),
        "labels": {},
    }
    if part.colors is not None:
        facts["colors"] = arrays.add(srgb_bytes(part.colors), "u1")
    for level, ids in part.labels.items():
        one = len(ids) > 0 and bool((ids == ids[0]).all())
        facts["labels"][level] = int(ids[0]) if one else arrays.add(ids, "u4")
    return facts


def _placement(arrays: _Arrays, placement: Placement) -> dict[str, Any]:
    linear = placement.to_world[:, :, :3]
    most = float(np.abs(linear).max(initial=0.0)) or 1.0
    return {
        "owner": placement.owner,
        "parts": list(placement.parts),
        "count": len(placement.ids),
        "positions": arrays.add(placement.to_world[:, :, 3], "f4"),
        "scale": most,
        "linear": arrays.add(np.rint(linear / most * _LINEAR), "i2"),
        "ids": arrays.add(placement.ids, "u4"),
        "variation": arrays.add(np.rint(127.0 * np.clip(placement.variation, -1, 1)), "i1"),
    }


def _camera(arrays: _Arrays, view: View) -> dict[str, Any]:
    every = max(1, -(-len(view.poses) // _POSES))
    k = view.intrinsics
    return {
        "name": view.name,
        "size": [view.width, view.height],
        "k": [short(float(v), 9) for v in (k[0, 0], k[1, 1], k[0, 2], k[1, 2])],
        "every": every,
        "poses": arrays.add(view.poses[::every, :3], "f4"),
    }
