"""For docs/placement.md: objects at the ends of every range, and one row for what happened."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from scenec.compiler.scene.objects import Placed, Scatter
from scenec.lab.pages.placement_field import (
    HILLS,
    PLANE,
    SIZE,
    Stood,
    cfg,
    gaps_of,
    rotations,
    stand,
)
from scenec.lab.runner import Page, table
from scenec.schemas.errors import ScenecError

_SMALL = {"type": "log_uniform", "min": 0.05, "max": 0.5}


def _message(error: ScenecError) -> str:
    """What a user reads, without where the file is and the rocks' name."""
    text = re.sub(r"\S*placement\.json:\d+:\d+: ", "", str(error))
    return "refused: " + text.splitlines()[0].replace("|", "\\|")


def _row(name: str, thing: dict[str, Any], folder: Path, **scene: Any) -> list[str]:
    """Places one class of rocks."""
    asked = thing.get("count", "by its law" if "per_m2" not in thing else "per m²")
    asked = f"{asked:,}" if isinstance(asked, int) else str(asked)
    try:
        stood = stand(cfg({"rocks": {"size_m": _SMALL, "lod_px": 0} | thing}, **scene), folder)
    except ScenecError as error:
        return [name, asked, _message(error), "", "", "", ""]
    (scatter,) = stood.objects
    assert isinstance(scatter, Scatter)
    off = np.abs(gaps_of(stood)).max(initial=0.0)
    widest = float(scatter.radii().max(initial=0.0)) * 2.0
    own = stood.facts["rocks"]
    share = f"{100 * off / widest:.1g}" if widest else ""
    px = f"{own['gap_max_px']:.2g}" if "gap_max_px" in own else ""
    return [name, asked, f"{scatter.count:,}", f"{stood.seconds:.2f}", f"{off:.1e}", share, px]


def _scaled(size_m: float) -> dict[str, Any]:
    """A scene whose lengths go with an object's size: 40 m for 0.25 m."""
    unit = size_m / 0.25
    hills = {**HILLS, "amplitude_m": unit, "scale_m": 8 * unit}
    return {"size_m": (SIZE[0] * unit, SIZE[1] * unit), "spacing_m": 0.4 * unit,
            "relief": (PLANE, hills)}  # fmt: skip


def _maps(folder: Path) -> None:
    gray = np.zeros((64, 80), np.uint8)
    Image.fromarray(gray).save(folder / "black.png")
    gray[20, 30] = 255
    Image.fromarray(gray).save(folder / "one.png")


def _rows(page: Page) -> list[list[str]]:
    folder, many = page.scratch, 20_000 if page.fast else 1_000_000
    n = 500
    steep = {"type": "plane", "slope": [float(np.tan(np.radians(89))), 0]}
    high = {"type": "plane", "height_m": 1e7}
    rows = [
        _row("no objects", {"count": 0}, folder),
        _row("one object", {"count": 1}, folder),
        _row(
            "very many",
            {"count": many, "subdivisions": 1},
            folder,
            size_m=(1000.0, 800.0),
            spacing_m=2.0,
        ),
    ]
    for size in (1e-4, 1e-2, 1.0, 1e2, 1e4):
        thing = {"count": n, "size_m": size, "clearance_m": 0}
        rows.append(_row(f"size {size:g} m, terrain {SIZE[0]:g} m", thing, folder))
        scene = _scaled(size)
        rows.append(_row(f"size {size:g} m, terrain {scene['size_m'][0]:g} m", thing, folder,
                         **scene))  # fmt: skip
    wide = {"count": 1, "size_m": 500, "apart": {}, "clearance_m": 0}
    law = {"type": "golombek_rapp", "min": 1e-3, "max": 2}
    rows += [
        _row("apart: one, larger than the terrain", wide, folder),
        _row("apart: two of them", wide | {"count": 2}, folder),
        _row("apart: a gap larger than the terrain", {"count": 2, "apart": {"gap_m": 100}}, folder),
        _row("the same, shortfall fewer",
             {"count": 50, "apart": {"gap_m": 100}, "shortfall": "fewer"}, folder),
        _row("apart: jammed, shortfall fewer",
             {"count": 3000, "size_m": 1, "apart": {}, "shortfall": "fewer"}, folder),
        _row("a map that is zero everywhere",
             {"count": n, "density": {"type": "image", "file": "black.png"}}, folder),
        _row("a map of one cell that is not",
             {"count": n, "density": {"type": "image", "file": "one.png"}}, folder),
        _row("all masked away",
             {"count": n, "where": [{"type": "height", "min_m": 1000}]}, folder),
        _row("all masked away, per_m2 1",
             {"per_m2": 1, "where": [{"type": "height", "min_m": 1000}]}, folder),
        _row("masked to one spot of 0.5 m",
             {"count": n, "where": [{"type": "point", "x_m": 3, "y_m": 2, "max_m": 0.5}]}, folder),
        _row("per_m2 1e9", {"per_m2": 1e9}, folder),
        _row("per_m2 1e-9", {"per_m2": 1e-9}, folder),
        _row("golombek_rapp, k 0", {"size_m": law | {"k": 0}}, folder),
        _row("golombek_rapp, k 1e-6", {"size_m": law | {"k": 1e-6}}, folder),
        *(
            _row(f"golombek_rapp, k {k:g}, from 1 mm, on 8 m", {"size_m": law | {"k": k}}, folder,
                 size_m=(8.0, 6.4), spacing_m=0.08)
            for k in (1e-3, 0.4)
        ),
        _row("embed 0", {"count": n, "embed": 0}, folder),
        _row("embed 1", {"count": n, "embed": 1}, folder),
        _row("rocks about the camera, none of which may hold it",
             {"count": 300, "size_m": 3, "where": [{"type": "camera", "max_m": 4}]}, folder),
        _row("no place that is clear of the camera", {"count": 3, "size_m": 200}, folder),
        _row("the same, shortfall fewer",
             {"count": 3, "size_m": 200, "shortfall": "fewer"}, folder),
        _row("slopes of 89°", {"count": n}, folder, relief=(steep,)),
        _row("slopes of 89°, along the normal", {"count": n, "orientation": "normal"}, folder,
             relief=(steep,)),
        _row("heights of 1e7 m", {"count": n}, folder, relief=(high, HILLS)),
        _row("lean of 180°", {"count": n, "orientation": "upright", "lean_deg": 180}, folder),
        _row("lean of 180°, along the normal",
             {"count": n, "orientation": "normal", "lean_deg": 180}, folder),
        _row("cliffs: hills of 100 m, 2 m wide", {"count": n}, folder,
             relief=(PLANE, HILLS | {"amplitude_m": 100, "scale_m": 2})),
        _row("one cell of relief", {"count": n}, folder, spacing_m=40.0),
    ]  # fmt: skip
    return rows


def extremes(page: Page) -> str:
    """One row each."""
    folder = page.scratch
    _maps(folder)
    return (
        "## At the ends of every range\n\n"
        f"Rocks on {SIZE[0]:g} m × {SIZE[1]:g} m of hills, relief every 0.4 m, 0.05 m to 0.5 m "
        "large unless the row says otherwise, at their finest level. Everything goes through the "
        "checks of the cfg, as in `scenec compile`. The error is the distance of the deepest "
        "vertex from its requested depth, against the ground with all its detail, measured from "
        "the stage's numbers with all vertices of up to 500 rocks; the next column has it in "
        "percent of the largest rock. Where no view would show half a pixel of it, detail is "
        "followed only at a rock's middle, which causes most of the error; the last column is "
        "the report's error in pixels of the view that shows it largest. If a case is refused, "
        "the table has the message, and nothing is written.\n\n"
        + table(
            ["case", "asked", "placed, or the message", "s", "largest error, m",
             "% of the largest", "px"], _rows(page),
        )
        + "\nTwo errors are large. At heights of 1e7 m, positions, which the stage holds in "
        "float32, are off by up to half a meter (use heights near 0; a DEM's offset is recorded "
        "instead). Hills of 100 m that are 2 m wide have detail between the samples that is far "
        "taller than a rock. A rock's 32 lowest vertices do not find it, so rocks sink.\n"
        + "\n" + _single(page)
    )  # fmt: skip


def _single(page: Page) -> str:
    """Placed objects."""
    folder = page.scratch
    (folder / "box.obj").write_text(
        "".join(f"v {x} {y} {z}\n" for x in (-1, 1) for y in (-1, 1) for z in (0, 2))
        + "f 1 2 4 3\nf 5 7 8 6\nf 1 5 6 2\nf 3 4 8 7\nf 1 3 7 5\nf 2 6 8 4\n"
    )
    model = {"type": "placed", "models": [{"file": "box.obj", "unit_m": 1, "up": "z"}],
             "material": "stone"}  # fmt: skip
    rng = np.random.default_rng(3)
    x, y = rng.uniform(-1, 1, (2, 1000)) * [[0.5 * SIZE[0]], [0.5 * SIZE[1]]]
    cases: list[tuple[str, list[dict[str, Any]], dict[str, Any]]] = []
    cases += [
        (f"scale {scale:g}", [{"x_m": 1, "y_m": 2, "scale": scale}], {})
        for scale in (1e-4, 1e-2, 1.0, 1e2, 1e4)
    ]
    grid = [{"x_m": a, "y_m": b, "rotation_deg": [10, 20, 30]}
            for a, b in zip(x.tolist(), y.tolist(), strict=True)]  # fmt: skip
    corners = [{"x_m": a * SIZE[0] / 2, "y_m": b * SIZE[1] / 2} for a in (-1, 1) for b in (-1, 1)]
    cases += [
        ("1,000 poses, turned", grid, {}),
        ("1,000 poses, along the normal", grid, {"orientation": "normal"}),
        ("on the terrain's four corners", corners, {}),
        ("the same, along the normal", corners, {"orientation": "normal"}),
        ("1 mm beyond the border", [{"x_m": SIZE[0] / 2 + 1e-3, "y_m": 0}], {}),
        ("the same, heights of the world", [{"x_m": SIZE[0] / 2 + 1e-3, "y_m": 0}],
         {"heights": "world"}),
        ("1e9 m away, heights of the world", [{"x_m": 1e9, "y_m": 0}], {"heights": "world"}),
    ]  # fmt: skip
    rows = []
    for name, poses, change in cases:
        thing = model | {"poses": poses} | change
        rocks = {"count": 1, "size_m": 0.1}
        try:
            stood = stand(cfg({"lander": thing, "rocks": rocks}), folder)
        except ScenecError as error:
            rows.append([name, f"{len(poses):,}", _message(error), "", "", ""])
            continue
        rows.append([name, f"{len(poses):,}", *_errors(stood, poses, "heights" in change,
                                                       "orientation" in change)])  # fmt: skip
    return (
        "### Single objects\n\n"
        "A box at given poses on the same hills. The error of its place is measured against the "
        "surface below it. The error of its turn and scale is the largest difference of its "
        "matrix, over the scale, from the requested rotations (about x, then y, then z); along "
        "the normal it is that of the upright axis' length.\n\n"
        + table(
            ["case", "asked", "placed, or the message", "s", "error of place, m",
             "error of turn and scale"], rows,
        )
    )  # fmt: skip


def _errors(stood: Stood, poses: list[dict[str, Any]], world: bool, tilted: bool) -> list[str]:
    placed = stood.objects[0]
    assert isinstance(placed, Placed)
    at = np.array([[pose["x_m"], pose["y_m"], 0.0] for pose in poses])
    if not world:
        at[:, 2] = stood.surface.height_at(at[:, 0].copy(), at[:, 1].copy())
    got = placed.to_world[:, 0]
    scale = np.array([pose.get("scale", 1.0) for pose in poses])
    angles = np.radians([pose.get("rotation_deg", [0, 0, 0]) for pose in poses])
    turn = np.tile(np.eye(3), (len(poses), 1, 1))
    for axis in range(3):
        q = np.zeros((len(poses), 4))
        q[:, axis], q[:, 3] = np.sin(angles[:, axis] / 2), np.cos(angles[:, axis] / 2)
        turn = rotations(q) @ turn
    bare = got[:, :, :3] / scale[:, None, None]
    off = np.abs(bare - turn).max()
    if tilted:
        off = np.abs(np.sqrt((bare[:, :, 2] ** 2).sum(axis=1)) - 1.0).max()
    return [f"{placed.count:,}", f"{stood.seconds:.2f}", f"{np.abs(got[:, :, 3] - at).max():.0e}",
            f"{off:.0e}"]  # fmt: skip
