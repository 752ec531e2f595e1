"""For docs/relief.md: what is left of footprints and crust at each fineness, and their cost."""

from __future__ import annotations

from functools import partial

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from scenec.compiler.distributions.streams import Streams
from scenec.compiler.kinds.context import Context
from scenec.compiler.terrain.detail import Detail
from scenec.compiler.terrain.grid import Grid, HeightField
from scenec.compiler.terrain.operators.crust import Crust
from scenec.compiler.terrain.operators.footprints import Footprints, Walks
from scenec.compiler.terrain.operators.multifractal import Multifractal
from scenec.lab.pages.relief_forms import shaded
from scenec.lab.runner import Page, table, times

_SPACINGS_M = (0.003, 0.007, 0.01, 0.02, 0.04, 0.08)


def prints(page: Page) -> str:
    """Pictures of both, and their error against the spacing of a mesh's vertices."""
    one = Footprints(np.array([[0.0, 0.0, 1.0, 0.0, 1.0]]), 0.33, 0.025, 0.006, (1.0, 1.0))
    crust = Crust(key=3, height_m=0.02, plate_m=0.3, missing=0.25).everywhere()
    _picture(page, crust)
    rows = []
    for spacing in _SPACINGS_M:
        pressed = _error(one.everywhere(), 0.8, spacing, 4 if page.fast else 40)
        broken = _error(crust, 4.0, spacing, 1 if page.fast else 4)
        rows.append([f"{1e3 * spacing:g}", f"{1e3 * pressed[0]:.2f}", f"{100 * pressed[1]:.2g}",
                     f"{1e3 * broken[0]:.2f}", f"{100 * broken[1]:.2g}"])  # fmt: skip
    walks = Walks(walks=3).draw(Context(Streams(1, 0), (80.0, 80.0), path="page"))
    x, y = np.random.default_rng(1).uniform(-40.0, 40.0, (2, 1 << (14 if page.fast else 20)))
    cost = [
        1e9 * times(partial(detail.at, x, y)).median / x.size
        for detail in (walks.everywhere(), crust)
    ]
    return (
        "## Footprints and crust: finer than the grid\n\n"
        "Grids of scenes are coarser than boots and the walls of plates. Where a grid does not "
        "hold them (three samples a rib, one a wall), it holds nothing of them, and the mesh shows "
        "them where cameras are near: as fine as `terrain.mesh.finest_m` lets it be. Far from "
        "cameras, and where a later operator reshapes the ground, they are left out; three tenths "
        "of a print's volume stand in its rim, the rest is compacted. The "
        "table has the root mean square error of heights over what is not level, and that of the "
        "volume, if vertices lie so far apart.\n\n"
        "![footprints and crust](pictures/relief_prints.png)\n\n"
        + table(["spacing, mm", "print, mm", "volume, %", "crust, mm", "volume, %"], rows)
        + f"\nA point costs {cost[0]:.0f} ns for three walks over 80 m × 80 m and {cost[1]:.0f} ns "
        "for a crust. Prints are added to what is there: grains in them are not leveled, and "
        "prints that overlap add up. Plates of a crust are cells, each by itself: no plate lies "
        "upon another one.\n"
    )


def _error(detail: Detail, size_m: float, spacing_m: float, places: int) -> tuple[float, float]:
    """Errors of heights between vertices, meters, and of their sum, as a share of it: rms."""
    grid = Grid.with_spacing((size_m, size_m), spacing_m)
    fine = np.linspace(-0.45, 0.45, 801) * size_m
    x, y = (a.ravel() for a in np.meshgrid(fine, fine))
    true = detail.at(x, y)
    heights, volumes = [], []
    for moved in np.random.default_rng(2).uniform(-0.5, 0.5, (places, 2)) * spacing_m:
        at = [np.ascontiguousarray(a + m) for a, m in zip(grid.points(), moved, strict=True)]
        field = HeightField(grid, detail.at(*at).reshape(grid.shape))
        off = field.height_at(x - moved[0], y - moved[1]) - true
        heights.append((off * off).sum() / np.count_nonzero(true))
        volumes.append((off.sum() / true.sum()) ** 2)
    return float(np.sqrt(np.mean(heights))), float(np.sqrt(np.mean(volumes)))


def _picture(page: Page, crust: Detail) -> None:
    """Hillshades: a walk of 4 m, three prints, plates of 6 m."""
    n = 480
    ground = Multifractal(
        key=5,
        amplitude_m=0.06,
        scale_m=2.0,
        octaves=9,
        lacunarity=2.0,
        gain=0.5,
        variant="fbm",
        offset=0.7,
    )
    walk = Walks().draw(Context(Streams(2, 0), (6.0, 6.0), path="page")).everywhere()
    sheet = Image.new("L", (3 * n + 12, n), 255)
    panels: list[tuple[Detail, float, float]] = [(walk, 4.0, 1.0), (walk, 1.2, 0.3),
                                                 (crust, 5.0, 0.5)]  # fmt: skip
    for k, (detail, size, rough) in enumerate(panels):
        grid = Grid((size, size), (n, n))
        height: NDArray = rough * ground.apply(grid, np.zeros(grid.shape))[0]
        height += detail.at(*grid.points()).reshape(grid.shape)
        sheet.paste(Image.fromarray(shaded(height, grid.spacing_m[0])), (k * (n + 6), 0))
    sheet.save(page.picture("prints"), optimize=True)
