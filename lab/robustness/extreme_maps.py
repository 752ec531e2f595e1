"""Maps of bare ground at the ends of what they are asked, for the table of extremes."""

from __future__ import annotations

import json
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenec.backends.annotation.overhead import map_tile
from scenec.backends.exact import ExactCaster
from scenec.backends.stage.read import read_stage
from scenec.compiler.compile import compile_cfg
from scenec.compiler.views.needed import Keep
from scenec.schemas.site_map import MapGrid, MapOptions

MapCase = tuple[str, Callable[[Path], tuple[str, float | None]], str]
_SIZE_M, _SPACING_M = 400.0, 4.0


def cases() -> list[MapCase]:
    """What is tried, who tries it, and what is promised."""
    return [
        ("map: bare ground 8 km below zero", partial(level, height=-8000.0), "1e-7 of the height"),
        ("map: on a sphere of 2 km", partial(level, radius=2000.0), "the sphere, chords of 4 m"),
        ("map: a strip a millimeter wide", partial(level, area=(-150.0, 0.0, 150.0, 1e-3)),
         "1e-7 of the height"),
        ("map: a DEM whose first row is south", south_up, "its plane: 1e-7 of the relief"),
    ]  # fmt: skip


def level(
    folder: Path,
    height: float = 100.0,
    radius: float | None = None,
    area: tuple[float, float, float, float] = (-150.0, -150.0, 150.0, 150.0),
) -> tuple[str, float | None]:
    """Level ground without a stone, flat or on a sphere, against the closed form.

    Returns:
        In words, and the largest error over the height or, on a sphere, over the drop.
    """
    planet = {} if radius is None else {"planet": {"radius_m": radius}}
    x, y, found, slope = _mapped(folder, [{"type": "plane", "height_m": height}], area, planet)
    if radius is None:
        off = np.abs(found - height).max()
        return f"{found.size:,} cells, off by {off:.2g} m at most", float(off / abs(height))
    away2 = x * x + y * y
    off = np.abs(found - (height - radius + np.sqrt(radius * radius - away2))).max()
    drop = radius - np.sqrt(radius * radius - away2.max())
    tilt = np.abs(slope - np.degrees(np.arcsin(np.sqrt(away2) / radius))).max()
    said = f"{found.size:,} cells, off by {off:.2g} m, slopes by {tilt:.2g}° at most"
    return said, float(off / drop)


def south_up(folder: Path) -> tuple[str, float | None]:
    """A plane in a raster whose first row is the southern one, against its own heights."""
    import rasterio
    from rasterio.transform import Affine

    file, side = folder / "south_up.tif", 128
    j, i = np.mgrid[:side, :side] + 0.5
    with rasterio.open(
        file, "w", driver="GTiff", height=side, width=side, count=1, dtype="float64",
        crs="EPSG:32633", transform=Affine(4, 0, 4e5, 0, 4, 5.4e6),
    ) as target:  # fmt: skip
        target.write(i + 0.5 * j, 1)
    relief = [{"type": "dem", "file": str(file), "height_offset_m": 0}]
    x, y, found, slope = _mapped(folder, relief, (-150.0, -150.0, 150.0, 150.0), {})
    # 1 m up in 4 m to the east and 0.5 m to the north; 64 columns and rows to the middle.
    off = np.abs(found - (64.0 + x / 4.0 + 0.5 * (64.0 + y / 4.0))).max()
    tilt = np.abs(slope - np.degrees(np.arctan(np.hypot(0.25, 0.125)))).max()
    said = f"{found.size:,} cells, off by {off:.2g} m, slopes by {tilt:.2g}° at most"
    return said, float(off / 112.5)


def _mapped(
    folder: Path,
    relief: list[dict[str, Any]],
    area: tuple[float, float, float, float],
    terrain: dict[str, Any],
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[Any], NDArray[Any]]:
    """Centers' x and y, heights and slopes of the map of some ground."""
    cfg = {
        "version": 1, "name": "ground", "samples": 1, "labels": {"class": {"ground": 1}},
        "materials": {"sand": {"base_color": [0.4, 0.3, 0.2]}},
        "terrain": {
            "size_m": [_SIZE_M, _SIZE_M], "spacing_m": _SPACING_M, "relief": relief,
            "mesh": {"tolerance_px": 0}, **terrain,
            "ground": [{"material": "sand", "labels": {"class": "ground"}}],
        },
        "light": {"sun": {"elevation_deg": 40}, "sky": {"type": "none"}},
        "rigs": {"one": {"sensors": {"eye": {"resolution": [8, 6], "fov_deg": 60}},
                         "pose": {"type": "random_target",
                                  "position": {"x_m": 0, "y_m": 0, "height_m": 20},
                                  "target": {"distance_m": 5, "height_m": 0, "bearing_deg": 0}}}},
    }  # fmt: skip
    file = folder / "ground.json"
    file.write_text(json.dumps(cfg), encoding="utf-8")
    made = compile_cfg(file, seed=1, out=folder / "out", keep=Keep.ALL).out
    scene = read_stage(made / "batch_0000/stage.usda")
    grid = MapGrid.over(area, min(2.5, area[3] - area[1]) if area[3] - area[1] > 1 else 0.5)
    layers = ("height", "slope")
    options = MapOptions(cell_m=grid.cell_m, layers=layers)
    found = map_tile(scene, ExactCaster(scene), grid, (0, 0), options, layers)
    x, y = np.meshgrid(*grid.centers((0, 0), found["height"].shape))
    return x, y, found["height"], found["slope"]
