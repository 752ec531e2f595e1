"""Makes the tables of docs/numerics.md: errors of elementary approximations beside run times.

    python lab/pages/numerics.py [--fast] [-o FOLDER]

Times are single readings on the machine that runs it; errors are facts of the code.
"""

from __future__ import annotations

import time

import mpmath
import numpy as np

from scenec.backends.contract import Rays
from scenec.backends.exact import ExactCaster
from scenec.compiler.arithmetic import elementary
from scenec.compiler.geometry.icosphere import icosphere
from scenec.compiler.mesh.merge import Merge, label_index
from scenec.compiler.mesh.surface import Surface
from scenec.compiler.mesh.tiles import build_tiles
from scenec.compiler.terrain.grid import Grid, HeightField
from scenec.lab.runner import Page, run
from scenec.testing.scenes import affine, mesh, scene


def elementary_functions(page: Page) -> None:
    """Ulps against exact values, time against NumPy's."""
    mpmath.mp.prec = 200
    rng = np.random.default_rng(0)
    ranges = {
        "exp": (-700, 700, np.exp, mpmath.exp),
        "log": (1e-300, 1e300, np.log, mpmath.log),
        "sin": (-1e6, 1e6, np.sin, mpmath.sin),
        "cos": (-1e6, 1e6, np.cos, mpmath.cos),
        "atan": (-50, 50, np.arctan, mpmath.atan),
        "acos": (-1, 1, np.arccos, mpmath.acos),
        "asin": (-1, 1, np.arcsin, mpmath.asin),
    }
    rows = []
    for name, (low, high, theirs, exact) in ranges.items():
        x = rng.uniform(low, high, 1_000_000)
        if name == "log":
            x = np.exp(rng.uniform(-690, 690, 1_000_000))
        ours = getattr(elementary, f"{name}_array")
        few = x[: 100 if page.fast else 4000]
        truth = [exact(mpmath.mpf(v)) for v in few.tolist()]
        worst = max(
            float(abs(mpmath.mpf(got) - t)) / np.spacing(abs(float(t)))
            for got, t in zip(ours(few).tolist(), truth, strict=True)
        )
        a, b = page.timed(lambda x=x, f=ours: f(x)), page.timed(lambda x=x, f=theirs: f(x))
        span = f"{low:g} … {high:g}"
        rows.append([f"`{name}`", span, f"{worst:.2f}", f"{a * 1e3:.1f}", f"{b * 1e3:.1f}"])
    page.rows(rows)


def label_lines(page: Page) -> None:
    """Chord error and wrongly labeled area of the cut, over spacings."""
    merge = Merge(5, 9.0, 3, 0.5, 2.0, 0.0, 5.0, 0.5)
    rows = []
    for spacing in (1.6, 0.8) if page.fast else (1.6, 0.8, 0.4, 0.2, 0.1):
        field = HeightField(Grid.with_spacing((40.0, 40.0), spacing), np.zeros((1, 1)))
        field = HeightField(field.grid, np.zeros(field.grid.shape))
        start = time.perf_counter()
        tiles, report = build_tiles(Surface(field, (merge,)), 1, color=False)
        seconds = time.perf_counter() - start
        cut = report["cuts"][0]
        rows.append([
            f"{spacing:g}", f"{cut['chord_error_rms_m']:.2e}", f"{cut['chord_error_max_m']:.2e}",
            f"{cut['snap_max_m']:.1e}", f"{100 * wrong_area(tiles, merge):.4f}",
            f"{report['faces']:,}", f"{seconds:.3f}",
        ])  # fmt: skip
    page.rows(rows)


def wrong_area(tiles: tuple, merge: Merge) -> float:
    """Fraction of the area with another label than the merge function's."""
    rng = np.random.default_rng(0)
    wrong, total = 0.0, 0.0
    for tile in tiles:
        points = tile.translate + tile.points.astype(np.float64)
        corners = points[tile.faces]
        edge, other = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
        area = 0.5 * (edge[:, 0] * other[:, 1] - edge[:, 1] * other[:, 0])
        count = max(1, int(1e6 * area.sum() / 1600.0))
        face = rng.choice(len(area), count, p=area / area.sum())
        bary = rng.dirichlet([1, 1, 1], count)
        at = (bary[:, :, None] * corners[face]).sum(axis=1)
        side = merge.side(np.ascontiguousarray(at[:, 0]), np.ascontiguousarray(at[:, 1]))
        wrong += (label_index([side]) != tile.layer[face]).mean() * area.sum()
        total += area.sum()
    return float(wrong / total)


def spheres(page: Page) -> None:
    """Depth of a tessellated sphere against the true one."""
    rows = []
    rng = np.random.default_rng(2)
    for subdivisions in range(1, 3 if page.fast else 7):
        points, faces = icosphere(subdivisions)
        sphere = scene([mesh(points, faces)], [(0, affine())])
        edge = np.linalg.norm(points[faces[:, 0]] - points[faces[:, 1]], axis=1).max()
        at = rng.uniform(-0.5, 0.5, (100_000, 2))
        origins = np.column_stack([at, np.full(len(at), 10.0)])
        rays = Rays(origins, np.tile([0.0, 0.0, -1.0], (len(at), 1)), (1, len(at)))
        start = time.perf_counter()
        _, _, depth = ExactCaster(sphere).cast(rays)
        seconds = time.perf_counter() - start
        exact = 10.0 - np.sqrt(1.0 - (at * at).sum(axis=1))
        error = np.abs(depth - exact)
        # The sagitta of a circumscribed triangle, seen under 45 degrees at worst.
        bound = edge * edge / 6.0 * np.sqrt(2.0)
        rows.append([f"{len(faces):,}", f"{np.sqrt((error**2).mean()):.2e}", f"{error.max():.2e}",
                     f"{bound:.2e}", f"{seconds:.3f}"])  # fmt: skip
    page.rows(rows)


def main(page: Page) -> None:
    """Refreshes the page."""
    parts = (elementary_functions, label_lines, spheres)
    page.refresh(("scenec", "numpy", "numba"), parts)


if __name__ == "__main__":
    run(main, page="numerics")
