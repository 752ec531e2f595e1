"""Makes the tables of docs/numerics.md: errors of elementary approximations beside run times.

    python lab/pages/numerics.py [--fast] [-o FOLDER]

Times are single readings on the machine that runs it; errors are facts of the code.
"""

from __future__ import annotations

import mpmath
import numpy as np

from scenec.backends.contract import Rays
from scenec.backends.exact import ExactCaster
from scenec.compiler.arithmetic import elementary
from scenec.compiler.geometry.icosphere import icosphere
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
        caster = ExactCaster(sphere)
        depth = caster.cast(rays)[2]
        seconds = page.timed(lambda caster=caster, rays=rays: caster.cast(rays))
        exact = 10.0 - np.sqrt(1.0 - (at * at).sum(axis=1))
        error = np.abs(depth - exact)
        # The sagitta of a circumscribed triangle, seen under 45 degrees at worst.
        bound = edge * edge / 6.0 * np.sqrt(2.0)
        rows.append([f"{len(faces):,}", f"{np.sqrt((error**2).mean()):.2e}", f"{error.max():.2e}",
                     f"{bound:.2e}", f"{seconds:.3f}"])  # fmt: skip
    page.rows(rows)
    # The last table names tests.
    page.rows(None)


def main(page: Page) -> None:
    """Refreshes the page."""
    parts = (elementary_functions, spheres)
    page.refresh(("numpy", "numba"), parts)


if __name__ == "__main__":
    run(main, page="numerics")
