"""For docs/placement.md: objects at the ends of every range, and one row for what happened."""

from __future__ import annotations

import re
from typing import Any

import numpy as np
from PIL import Image

from scenec.lab.pages.placement_field import HILLS, PLANE, SIZE, gaps, place
from scenec.lab.runner import Page
from scenec.schemas.errors import ScenecError

_SMALL = {"type": "log_uniform", "min": 0.05, "max": 0.5}
_LAW = {"type": "golombek_rapp", "min": 1e-3, "max": 2}
_MANY = {"count": 500}
_STEEP = {"type": "plane", "slope": [float(np.tan(np.radians(89))), 0]}
_APART = {"count": 50, "apart": {"gap_m": 100}}
_HIGH = [{"type": "height", "min_m": 1000}]
_FEW = {"count": 3, "size_m": 200}


def _of_size(size: float) -> list[tuple[str, dict[str, Any], dict[str, Any]]]:
    """Rocks of a size on the usual terrain, and on one whose lengths go with it."""
    unit = size / 0.25
    thing = _MANY | {"size_m": size, "clearance_m": 0}
    scene = {"size_m": (SIZE[0] * unit, SIZE[1] * unit), "spacing_m": 0.4 * unit,
             "relief": (PLANE, {**HILLS, "amplitude_m": unit, "scale_m": 8 * unit})}  # fmt: skip
    return [
        (f"size {size:g} m, terrain {SIZE[0]:g} m", thing, {}),
        (f"size {size:g} m, terrain {scene['size_m'][0]:g} m", thing, scene),
    ]


#: Name, keys of the rocks, keys of the terrain.
ROCKS: list[tuple[str, dict[str, Any], dict[str, Any]]] = [
    ("no objects", {"count": 0}, {}),
    ("one object", {"count": 1}, {}),
    ("very many", {"count": 1_000_000, "subdivisions": 1},
     {"size_m": (1000.0, 800.0), "spacing_m": 2.0}),
    *(case for size in (1e-4, 1e-2, 1.0, 1e2, 1e4) for case in _of_size(size)),
    ("apart: one, larger than the terrain",
     {"count": 1, "size_m": 500, "apart": {}, "clearance_m": 0}, {}),
    ("apart: two of them", {"count": 2, "size_m": 500, "apart": {}, "clearance_m": 0}, {}),
    ("apart: a gap larger than the terrain", _APART | {"count": 2}, {}),
    ("the same, shortfall fewer", _APART | {"shortfall": "fewer"}, {}),
    ("apart: jammed, shortfall fewer",
     {"count": 3000, "size_m": 1, "apart": {}, "shortfall": "fewer"}, {}),
    ("a map that is zero everywhere",
     _MANY | {"density": {"type": "image", "file": "black.png"}}, {}),
    ("a map of one cell that is not",
     _MANY | {"density": {"type": "image", "file": "one.png"}}, {}),
    ("all masked away", _MANY | {"where": _HIGH}, {}),
    ("all masked away, per_m2 1", {"per_m2": 1, "where": _HIGH}, {}),
    ("masked to one spot of 0.5 m",
     _MANY | {"where": [{"type": "point", "x_m": 3, "y_m": 2, "max_m": 0.5}]}, {}),
    ("per_m2 1e9", {"per_m2": 1e9}, {}),
    ("per_m2 1e-9", {"per_m2": 1e-9}, {}),
    ("golombek_rapp, k 0", {"size_m": _LAW | {"k": 0}}, {}),
    ("golombek_rapp, k 1e-6", {"size_m": _LAW | {"k": 1e-6}}, {}),
    *((f"golombek_rapp, k {k:g}, from 1 mm, on 8 m", {"size_m": _LAW | {"k": k}},
       {"size_m": (8.0, 6.4), "spacing_m": 0.08}) for k in (1e-3, 0.4)),
    ("embed 0", _MANY | {"embed": 0}, {}),
    ("embed 1", _MANY | {"embed": 1}, {}),
    ("rocks about the camera, none of which may hold it",
     {"count": 300, "size_m": 3, "where": [{"type": "camera", "max_m": 4}]}, {}),
    ("no place that is clear of the camera", _FEW, {}),
    ("the same, shortfall fewer", _FEW | {"shortfall": "fewer"}, {}),
    ("slopes of 89°", _MANY, {"relief": (_STEEP,)}),
    ("slopes of 89°, along the normal", _MANY | {"orientation": "normal"}, {"relief": (_STEEP,)}),
    ("heights of 1e7 m", _MANY, {"relief": ({"type": "plane", "height_m": 1e7}, HILLS)}),
    ("lean of 180°", _MANY | {"orientation": "upright", "lean_deg": 180}, {}),
    ("lean of 180°, along the normal", _MANY | {"orientation": "normal", "lean_deg": 180}, {}),
    ("cliffs: hills of 100 m, 2 m wide", _MANY,
     {"relief": (PLANE, HILLS | {"amplitude_m": 100, "scale_m": 2})}),
    ("one cell of relief", _MANY, {"spacing_m": 40.0}),
]  # fmt: skip


def _message(error: ScenecError) -> str:
    """Returns an error's text without where the file is."""
    text = re.sub(r"\S*placement\.json:\d+:\d+: ", "", str(error))
    return "refused: " + text.splitlines()[0].replace("|", "\\|")


def rocks(page: Page) -> None:
    """Places a class of rocks at the ends of every range."""
    gray = np.zeros((64, 80), np.uint8)
    Image.fromarray(gray).save(page.scratch / "black.png")
    gray[20, 30] = 255
    Image.fromarray(gray).save(page.scratch / "one.png")
    page.rows(_row(name, thing, scene, page) for name, thing, scene in ROCKS)


def _row(name: str, thing: dict[str, Any], scene: dict[str, Any], page: Page) -> list[str]:
    asked = thing.get("count", "by its law" if "per_m2" not in thing else "per m²")
    asked = f"{asked:,}" if isinstance(asked, int) else str(asked)
    if page.fast and name == "very many":
        thing = thing | {"count": 20_000}
    try:
        placed = place({"rocks": {"size_m": _SMALL, "lod_px": 0} | thing}, page.scratch, **scene)
    except ScenecError as error:
        return [name, asked, _message(error), "", "", "", ""]
    off = np.abs(gaps(placed)).max(initial=0.0)
    widest = float(placed.scatter.radii().max(initial=0.0)) * 2.0
    own = placed.facts["rocks"]
    share = f"{100 * off / widest:.1g}" if widest else ""
    px = f"{own['gap_max_px']:.2g}" if "gap_max_px" in own else ""
    return [name, asked, f"{placed.scatter.count:,}", f"{placed.seconds:.2f}", f"{off:.1e}", share,
            px]  # fmt: skip
