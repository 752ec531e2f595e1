"""Windows on elevation models at the ends of their ranges, for the table of extremes."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.terrain.grid import Grid
from scenec.compiler.terrain.sources.dem import Dem, DemWindow
from scenec.schemas.georeference import Georeference

_MOON = "+proj=longlat +R=1737400 +no_defs"
_HIGH_M = 1000.0

DemCase = tuple[str, Callable[[Path], tuple[str, float | None]], str]


def cases() -> list[DemCase]:
    """What is tried, who tries it, and what is promised."""
    found: list[DemCase] = []
    for what, latitude, longitude in (
        ("at the south pole", -90.0, 0.0),
        ("10 km from the north pole", 89.67, 130.0),
        ("over the date line", 5.0, 180.0),
    ):
        work = partial(body, latitude=latitude, longitude=longitude, size=3e4)
        found.append((f"dem: 30 km {what}", work, "the curve between its pixels: 1e-5"))
    found += [
        ("dem: a window of one pixel", partial(body, latitude=45.0, longitude=7.0, size=7.6e3),
         "the curve between its pixels: 1e-5"),
        ("dem: a window of a millimeter", partial(body, latitude=45.0, longitude=7.0, size=1e-3),
         "the curve between its pixels: 1e-5"),
        ("dem: 1 km of 60,000 × 60,000 pixels", huge, "heights, 200 MiB above its own file"),
    ]  # fmt: skip
    return found


def smooth(latitude: NDArray, longitude: NDArray) -> NDArray[np.float64]:
    """Heights by the place in space, to which poles and date lines are nothing."""
    p, t = np.radians(latitude), np.radians(longitude)
    high = np.cos(p) * (np.cos(t) + 2.0 * np.sin(t)) + 0.5 * np.sin(p)
    return np.asarray(_HIGH_M * high)


def body(folder: Path, latitude: float, longitude: float, size: float) -> tuple[str, float | None]:
    """A window on a body of quarters of a degree, against PROJ and the heights' own formula."""
    from rasterio.transform import Affine
    from rasterio.warp import transform

    j, i = np.mgrid[:720, :1440] + 0.5
    heights = smooth(90.0 - 0.25 * j, -180.0 + 0.25 * i)
    file = folder / "body.tif"
    _write(file, heights, _MOON, Affine(0.25, 0.0, -180.0, 0.0, -0.25, 90.0))
    window = DemWindow((size, size), latitude_deg=latitude, longitude_deg=longitude)
    grid = Grid.with_spacing((0.9 * size, 0.9 * size), size / 50.0)
    found, report = Dem(file=file, window=window).apply(grid, np.zeros(grid.shape))
    plane, _ = Georeference(**report["georeference"]["on_body"]).plane()
    x, y = (part.ravel().tolist() for part in np.meshgrid(grid.x(), grid.y()))
    there = transform(plane, _MOON, x, y)
    off = np.abs(found.ravel() - smooth(np.array(there[1]), np.array(there[0]))).max()
    wide, high = report["read"]["pixels"]
    return f"{wide:,} × {high:,} pixels read, off by {off:.2g} m at most", float(off) / _HIGH_M


def huge(folder: Path) -> tuple[str, float | None]:
    """A kilometer of a file of 13.4 GiB, most of which is no data on disk."""
    import rasterio
    from rasterio.transform import Affine
    from rasterio.windows import Window

    file, side = folder / "huge.tif", 60_000
    j, i = np.mgrid[:1024, :1024] + 0.5
    with rasterio.open(
        file, "w", driver="GTiff", height=side, width=side, count=1, dtype="float32",
        crs="EPSG:32633", transform=Affine(1, 0, 4e5, 0, -1, 5.4e6), sparse_ok=True, tiled=True,
        compress="deflate", BIGTIFF="YES",
    ) as target:  # fmt: skip
        target.write((2 * i - j).astype(np.float32), 1, window=Window(0, 0, 1024, 1024))
    window = DemWindow((1000.0, 1000.0), x_m=4e5 + 512.0, y_m=5.4e6 - 512.0)
    grid = Grid.with_spacing((1000.0, 1000.0), 1.0)
    found, report = Dem(file=file, window=window).apply(grid, np.zeros(grid.shape))
    x, y = np.meshgrid(grid.x() + 512.0, 512.0 - grid.y())
    off = float(np.abs(found - (2.0 * x - y)).max())
    wide, high = report["read"]["pixels"]
    return f"{wide:,} × {high:,} pixels read, off by {off:.2g} m at most", off / _HIGH_M


def _write(file: Path, samples: NDArray, crs: str, place: Any) -> None:
    import rasterio

    with rasterio.open(
        file, "w", driver="GTiff", height=samples.shape[0], width=samples.shape[1], count=1,
        dtype=samples.dtype, crs=crs, transform=place,
    ) as target:  # fmt: skip
        target.write(samples, 1)
