"""Writes docs/numerics.md: the error of every approximation beside its run time, over whole ranges.

    python lab/pages/numerics.py [--fast] [-o FOLDER]

Times are single readings on the machine that runs it; errors are facts of the code.
"""

from __future__ import annotations

import time
from fractions import Fraction
from itertools import pairwise

import mpmath
import numpy as np
from numpy.typing import NDArray

from scenec.backends.contract import Rays
from scenec.backends.exact import ExactCaster
from scenec.backends.picture.compose import compose
from scenec.backends.run.session import Session
from scenec.compiler.arithmetic import elementary
from scenec.compiler.compile import compile_cfg
from scenec.compiler.geometry.icosphere import icosphere
from scenec.compiler.mesh.merge import Merge, label_index
from scenec.compiler.mesh.surface import GroundSurface
from scenec.compiler.mesh.tiles import build_tiles
from scenec.compiler.terrain.grid import Grid, HeightField
from scenec.lab.runner import Page, run, table, times
from scenec.schemas.polygons import triangulate
from scenec.testing.outlines import comb
from scenec.testing.scenes import affine, mesh, scene
from scenec.testing.small import small_cfg, write_cfg

HEAD = """# Error against run time, and stability over extreme values

The error of each elementary approximation, beside its cost. Seconds are single readings on {cores}
cores ({versions});
errors do not depend on the machine. Tests check the same facts; this page makes them readable.
The errors of the relief operators, over extents, origins and steps, are in [relief.md](relief.md).
"""


def elementary_functions(page: Page) -> str:
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
    return "## Elementary functions with the same bits everywhere\n\n" + table(
        ["function", "range", "largest error, ulp", "ms a million", "NumPy's, ms"], rows
    )


def label_lines(page: Page) -> str:
    """Chord error and wrongly labeled area of the cut, over spacings."""
    merge = Merge(5, 9.0, 3, 0.5, 2.0, 0.0, 5.0, 0.5)
    rows = []
    for spacing in (1.6, 0.8) if page.fast else (1.6, 0.8, 0.4, 0.2, 0.1):
        field = HeightField(Grid.with_spacing((40.0, 40.0), spacing), np.zeros((1, 1)))
        field = HeightField(field.grid, np.zeros(field.grid.shape))
        start = time.perf_counter()
        tiles, report = build_tiles(GroundSurface(field, (merge,)), 1, color=False)
        seconds = time.perf_counter() - start
        cut = report["cuts"][0]
        rows.append(
            [
                f"{spacing:g}",
                f"{cut['chord_error_rms_m']:.2e}",
                f"{cut['chord_error_max_m']:.2e}",
                f"{cut['snap_max_m']:.1e}",
                f"{100 * wrong_area(tiles, merge):.4f}",
                f"{report['faces']:,}",
                f"{seconds:.3f}",
            ]
        )
    return (
        "## Labels as geometry: the cut along label lines\n\n"
        "40 m × 40 m, a 9 m noise of three octaves. *Wrong area* is the share of the area where a "
        "face's label differs from the merge function's, by 10⁶ random points. Near saddles, and "
        "for islands that cross no edge, the line's distance is large although the area is "
        "small.\n\n"
        + table(
            [
                "spacing, m",
                "chord rms, m",
                "chord worst, m",
                "snapped, m",
                "wrong area, %",
                "faces",
                "s",
            ],
            rows,
        )
    )


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


def spheres(page: Page) -> str:
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
    return "## Depth of a tessellated sphere of radius 1\n\n" + table(
        ["triangles", "rms error, m", "worst, m", "chord bound, m", "100,000 rays, s"], rows
    )


def polygons(page: Page) -> str:
    """Tabulates area, winding and time of triangulated polygons that are no fans."""
    rng = np.random.default_rng(0)
    c = np.array(
        [(-1, 0), (1, 0), (1, 0.5), (-0.5, 0.5), (-0.5, 1.5), (1, 1.5), (1, 2), (-1, 2)], np.float64
    )
    outlines: dict[str, NDArray[np.float64]] = {
        "C, 2 m": c,
        "C, 2e-9 m": 1e-9 * c,
        "C, 2e9 m": 1e9 * c,
        "C, 2 m, 4,000 km from the origin": c + np.array([3e6, -3e6]),
        "C, 2 m × 2e-9 m": c * np.array([1.0, 1e-9]),
    }
    for n in (100, 1000) if page.fast else (100, 1000, 10_000):
        outlines |= {f"comb, {n:,} corners": np.array(comb(rng, n), np.float64)}
        angle = np.sort(rng.uniform(0.0, 2.0 * np.pi, n))
        ring = rng.uniform(0.1, 1.0, n) * np.stack([np.cos(angle), np.sin(angle)])
        outlines |= {f"star, {n:,} corners": ring.T}
    rows = []
    for name, outline in outlines.items():
        points = np.column_stack([outline, np.zeros(len(outline))])
        faces, counts = np.arange(len(points)), np.array([len(points)])
        cost = times(lambda p=points, f=faces, k=counts: triangulate(p, f, k), 3)
        exact = [(Fraction(x), Fraction(y)) for x, y in outline.tolist()]
        area = _twice(exact)
        parts = [_twice([exact[k] for k in corners])
                 for corners in triangulate(points, faces, counts).corners.tolist()]  # fmt: skip
        error = abs(sum(map(abs, parts)) - abs(area)) / abs(area)
        wrong = sum(part * area <= 0 for part in parts)
        rows.append(
            [name, f"{len(parts):,}", f"{float(error):g}", wrong, f"{1e3 * min(cost.cpu):.2f}"]
        )
    return (
        "## Polygons as triangles\n\n"
        "*Error*: of the sum of the triangles' areas, each without its sign, in exact arithmetic. "
        "Time grows with the square of the corners at worst; a convex quad takes 0.05 µs.\n\n"
        + table(["polygon", "triangles", "error of area", "wound wrongly", "CPU ms"], rows)
    )


def _twice(outline: list[tuple[Fraction, Fraction]]) -> Fraction:
    """Returns twice the signed area."""
    return sum(
        (a[0] * b[1] - a[1] * b[0] for a, b in pairwise([*outline, outline[0]])), Fraction(0)
    )


def monte_carlo(page: Page) -> str:
    """Noise of rgb: the estimate in the sidecar, the true error, the time."""
    cfg = small_cfg(samples=1)
    cfg["rigs"]["rover"]["sensors"]["front"]["resolution"] = [160, 120]
    out = compile_cfg(write_cfg(page.scratch, cfg), seed=4, out=page.scratch / "out").out
    session = Session.open(out / "batch_0000" / "stage.usda", "mitsuba")
    camera = session.scene.cameras[0][0]
    session.backend.load(session.scene)
    best = session.backend.radiance(camera, 0, 256 if page.fast else 16384, 99)
    covered = best.coverage > 0.0
    reference = best.halves.astype(np.float64).mean(axis=0)[covered]
    rows, errors, counts = [], [], (4, 16) if page.fast else (4, 16, 64, 256, 1024)
    for spp in counts:
        start = time.perf_counter()
        radiance = session.backend.radiance(camera, 0, spp, spp)
        seconds = time.perf_counter() - start
        mean = radiance.halves.astype(np.float64).mean(axis=0)[covered]
        error = np.sqrt(((mean - reference) ** 2).mean()) / reference.mean()
        errors.append(error)
        estimate = compose(radiance, session.scene, camera, 0).noise.relative_rms
        rows.append([str(spp), f"{100 * estimate:.2f}", f"{100 * error:.2f}", f"{seconds:.3f}"])
    slope = np.polyfit(np.log(counts), np.log(errors), 1)[0]
    return (
        "## Noise of the picture\n\n"
        "Mitsuba, 160 × 120, RMSE over the mean on surfaces, against 16,384 samples. The "
        "estimate, which sidecars state, comes from the two half renders alone. Slope of the error "
        f"over samples: {slope:.2f} (independent samples: −0.5).\n\n"
        + table(["samples per pixel", "estimated, %", "true, %", "seconds"], rows)
    )


def main(page: Page) -> None:
    """Writes the page."""
    parts = (elementary_functions, label_lines, spheres, polygons, monte_carlo)
    page.write(HEAD, ("scenec", "numpy", "numba", "mitsuba"), parts)


if __name__ == "__main__":
    run(main, page="numerics")
