"""Draws the densities of docs/objects.md in plan, and tables chi-square against their formulas.

python lab/pages/densities.py [--fast] [-o FOLDER]
"""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from numpy.typing import NDArray
from PIL import Image

from scenec.compiler.mesh.surface import GroundSurface
from scenec.compiler.objects.conditions import OnRelief, PlacementCondition
from scenec.compiler.objects.density import (
    AroundDensity,
    ClusterDensity,
    Density,
    ImageDensity,
    NoiseDensity,
    PathDensity,
    UniformDensity,
    WorleyDensity,
)
from scenec.compiler.objects.height_candidates import candidates_on
from scenec.compiler.objects.lattice import Circles
from scenec.compiler.objects.placement_context import PlacementContext
from scenec.compiler.objects.rings import RingDensity
from scenec.compiler.terrain.condition import Interval, Slope
from scenec.compiler.terrain.grid import Grid, HeightField
from scenec.compiler.terrain.operators.craters import Craters
from scenec.lab.benchmarks.cfgs import fbm
from scenec.lab.runner import Page, run

#: Extent of the terrain, meters.
SIZE = (40.0, 32.0)
_CORNERS = np.array([[-18.0, -10.0], [-4.0, 7.0], [15.0, -6.0]])
# Smallest squares over which a law is integrated, meters.
_FINE = 0.1


def _away(x: NDArray, y: NDArray) -> NDArray[np.float64]:
    """Distance from the path."""
    found = np.full(x.shape, np.inf)
    for a, b in pairwise(_CORNERS):
        t = ((x - a[0]) * (b - a)[0] + (y - a[1]) * (b - a)[1]) / ((b - a) ** 2).sum()
        t = np.clip(t, 0.0, 1.0)
        found = np.minimum(found, np.hypot(x - a[0] - t * (b - a)[0], y - a[1] - t * (b - a)[1]))
    return found


def _rings(x: NDArray, y: NDArray, craters: Craters) -> NDArray[np.float64]:
    """0.14 R^0.74 (r/R)^-3 about fresh craters, faded in from 0.8 R to R, out to 4 R."""
    found = np.zeros(x.shape)
    for cx, cy, d in zip(craters.x_m, craters.y_m, craters.diameter_m, strict=True):
        r = np.hypot(x - cx, y - cy) / (0.5 * d)
        t = np.clip(1.0 - 5.0 * (1.0 - r), 0.0, 1.0)
        law = 0.14 * (0.5 * d) ** 0.74 * t * t * (3.0 - 2.0 * t) / np.maximum(r, 0.1) ** 3
        found += np.where(r < 4.0, law, 0.0)
    return found


def _skirts(x: NDArray, y: NDArray, there: Circles) -> NDArray[np.float64]:
    found = np.zeros(x.shape)
    for cx, cy, radius in zip(*there, strict=True):
        s = np.hypot(x - cx, y - cy) / radius
        left = np.clip(1.0 - (s - 1.0) / 1.5, 0.0, 1.0)
        found += np.where(s >= 0.8, left * left, 0.0)
    return found


def _cases(
    folder: Path, around: PlacementContext
) -> list[tuple[str, Density, tuple[PlacementCondition, ...], NDArray]]:
    """Name, density, where, and the density by its formula at the middles of fine squares."""
    axes = [_FINE * (np.arange(round(n / _FINE)) + 0.5) - 0.5 * n for n in SIZE]
    x, y = np.meshgrid(*axes)
    flat = x.ravel(), y.ravel()
    rng = np.random.default_rng(4)
    parents = rng.uniform(-1, 1, (2, 9)) * [[19], [15]]
    square = (x[..., None] - parents[0]) ** 2 + (y[..., None] - parents[1]) ** 2
    thomas = np.where(square < 16 * 1.2**2, np.exp(-0.5 * square / 1.2**2), 0.0).sum(axis=2)
    path = folder / "path.csv"
    path.write_text("x_m,y_m\n" + "".join(f"{a:g},{b:g}\n" for a, b in _CORNERS))
    picture = np.hypot(*np.meshgrid(np.linspace(-1, 1, 40), np.linspace(-1, 1, 32)))
    gray = (255 * np.clip(1.2 - np.abs(picture - 0.6) * 3, 0, 1)).astype(np.uint8)
    gray[:8, :10] = 255
    Image.fromarray(gray).save(folder / "map.png")
    craters = Craters(
        np.array([-9.0, 9.0]), np.array([3.0, -5.0]), np.array([9.0, 6.0]), np.full(2, 0.2),
        np.full(2, 0.04), np.zeros(2), np.arange(2, dtype=np.uint64), 0.0,
    )  # fmt: skip
    there = Circles(
        np.array([-10.0, 2.0, 12.0]), np.array([-4.0, 6.0, -7.0]), np.array([3.0, 2.0, 1.0])
    )
    around.objects["boulders"] = there
    lines = WorleyDensity(key=3, scale_m=7.0, distance="f2-f1", sharpness=6.0, jitter=0.9)
    heaps = WorleyDensity(key=3, scale_m=6.0, distance="f1", sharpness=4.0, jitter=0.9)
    noise = NoiseDensity(key=5, scale_m=6.0, octaves=3, contrast=2.0)
    away = _away(x, y)
    band = (np.abs(away - 2.0) <= 0.7).astype(float)
    gentle = OnRelief(Interval(Slope(over_m=0.0), None, 8.0, 4.0))
    # As coarse as the grid, by the page's own account: at the middles of its cells.
    coarse = [0.4 * (np.arange(round(n / 0.4)) + 0.5) - 0.5 * n for n in SIZE]
    even = np.kron(_gentle(around.surface.field, *np.meshgrid(*coarse)), np.ones((4, 4)))
    gaussian = PathDensity(file=path, law="gaussian", width_m=0.8, offset_m=0.0, background=0.0)
    beside = PathDensity(file=path, law="band", width_m=0.7, offset_m=2.0, background=0.2)
    rings = RingDensity(
        craters=((craters, ()),), min_radii=1.0, max_radii=4.0, freshness=1.0, background=0.0
    )
    skirts = AroundDensity(of="boulders", reach=1.5, inside=0.8, min_size_m=0.0, background=0.0)
    image = ImageDensity(file=folder / "map.png")
    return [
        ("uniform", UniformDensity(), (), np.ones(x.shape)),
        ("noise", noise, (), noise.at(*flat).reshape(x.shape)),
        ("worley f1", heaps, (), heaps.at(*flat).reshape(x.shape)),
        ("worley f2-f1", lines, (), lines.at(*flat).reshape(x.shape)),
        ("image", image, (), np.kron(gray[::-1].astype(float), np.ones((10, 10)))),
        ("clusters", ClusterDensity(parents[0], parents[1], 1.2, 0.0), (), thomas),
        ("path, gaussian", gaussian, (), np.exp(-0.5 * (away / 0.8) ** 2)),
        ("path, band", beside, (), 0.2 + 0.8 * band / band.mean()),
        ("rings", rings, (), _rings(x, y, craters)),
        ("around", skirts, (), _skirts(x, y, there)),
        ("uniform, slope ≤ 8°", UniformDensity(), (gentle,), even),
    ]


def _gentle(field: HeightField, x: NDArray, y: NDArray) -> NDArray[np.float64]:
    """Weighs a slope of at most 8 degrees, soft over 4, by central differences at samples.

    Between samples slopes are linear over the grid's triangles, as heights are.
    """
    gy, gx = np.gradient(field.height, field.grid.spacing_m[1], field.grid.spacing_m[0])
    slopes = HeightField(field.grid, np.degrees(np.arctan(np.hypot(gx, gy))))
    degrees = slopes.height_at(x.ravel(), y.ravel()).reshape(x.shape)
    t = np.clip((8.0 - degrees) / 4.0 + 0.5, 0.0, 1.0)
    return np.asarray(t * t * (3.0 - 2.0 * t))


def _chi_square(x: NDArray, y: NDArray, wanted: NDArray) -> tuple[float, int]:
    """Chi-square and its degrees of freedom, over squares of 2 m that expect five or more."""
    shape = (round(SIZE[1] / 2), round(SIZE[0] / 2))
    extent = [[-0.5 * SIZE[1], 0.5 * SIZE[1]], [-0.5 * SIZE[0], 0.5 * SIZE[0]]]
    found, _, _ = np.histogram2d(y, x, bins=shape, range=extent)
    per = round(2.0 / _FINE)
    sums = wanted.reshape(shape[0], per, shape[1], per).sum(axis=(1, 3))
    sums *= len(x) / sums.sum()
    there = sums > 5.0
    chi = ((found - sums) ** 2 / np.where(there, sums, 1.0))[there].sum()
    return float(chi), int(there.sum()) - 1


def densities(page: Page) -> None:
    """Every spatial law: a picture, chi-square, seconds."""
    grid = Grid.with_spacing(SIZE, 0.4)
    hills = fbm(1, 1.5, 8.0, 5).apply(grid, np.zeros(grid.shape))[0]
    around = PlacementContext(GroundSurface(HeightField(grid, hills)), np.zeros((0, 3)))
    n, shown = 100_000, 3000
    u = np.random.default_rng(1).random((n, 3))
    cases = _cases(page.scratch, around)
    figure, plots = plt.subplots(3, 4, figsize=(10.4, 6.9))
    rows = []
    for axes, (name, density, where, wanted) in zip(plots.ravel(), cases, strict=False):
        field = around.surface.field
        places = candidates_on(field, density, where, around, name)
        x, y, _ = places.at(u)
        seconds = page.timed(
            lambda d=density, w=where: candidates_on(around.surface.field, d, w, around, "").at(u)
        )
        chi, degrees = _chi_square(x, y, wanted)
        sigmas = (chi - degrees) / np.sqrt(2.0 * degrees)
        rows.append([name, f"{degrees}", f"{chi / degrees:.3f}", f"{sigmas:+.1f}",
                     f"{places.lattice.dx:.3g}", f"{seconds:.4f}"])  # fmt: skip
        axes.scatter(x[:shown], y[:shown], s=0.5, c="black", linewidths=0)
        axes.set(title=name, xticks=[], yticks=[], aspect="equal", xlim=(-20, 20), ylim=(-16, 16))
        axes.title.set_fontsize(9)
    # The last case's objects, held against its condition at their own places.
    astray = 100 * float((_gentle(around.surface.field, x, y) == 0.0).mean())
    page.say(f"{astray:.0f} % lie where the slope between samples is beyond the bound\n")
    plots.ravel()[-1].axis("off")
    page.save(figure, "densities")
    small = Image.open(page.picture("densities")).convert("L").quantize(16)
    small.save(page.picture("densities"), optimize=True)
    page.table(
        ["density", "degrees of freedom", "χ² / degree", "standard deviations", "cells, m", "s"],
        rows,
    )


if __name__ == "__main__":
    run(lambda page: page.refresh((), (densities,)), page="objects")
