"""Makes what docs/placement.md shows: how well objects are placed, beside how long that takes.

    python lab/pages/placement.py [--fast] [-o FOLDER]

Needs the extra "demo" (matplotlib). Times are single readings on the machine that runs it; all else
is a fact of the code.
"""

from __future__ import annotations

import time

import numpy as np

from scenec.compiler.objects import seating
from scenec.compiler.objects.bodies import Bodies
from scenec.compiler.objects.height_pyramid import HeightPyramid
from scenec.compiler.objects.lod import budget_factor, choose_levels, see_levels
from scenec.compiler.objects.rocks import build_chains
from scenec.compiler.views.resolution import views_of
from scenec.lab.benchmarks.growth import measure
from scenec.lab.pages import placement_extremes, placement_space
from scenec.lab.pages.placement_field import PLANE, gaps, place
from scenec.lab.runner import Page, apart, run
from scenec.schemas.errors import SceneError

#: Octaves far below the grid's spacing: detail that only the mesh near cameras shows.
_ROUGH = {"type": "multifractal", "amplitude_m": 1.5, "scale_m": 10, "octaves": 11, "gain": 0.55}


def seats(page: Page) -> None:
    """Holds the ways of seating on what is finer than the grid against all vertices."""
    count = 300 if page.fast else 5000
    thing = {
        "count": count, "subdivisions": 3, "lod_px": 0, "clearance_m": 0,
        "size_m": {"type": "log_uniform", "min": 0.1, "max": 1.5},
    }  # fmt: skip
    placed = place({"rocks": thing}, spacing_m=0.5, relief=(PLANE, _ROUGH))
    scatter, surface = placed.scatter, placed.surface
    assert surface.smooth
    embed = placed.plan.objects[0].embed[scatter.ids - 1]
    x, y = (np.ascontiguousarray(at) for at in scatter.positions[:, :2].astype(np.float64).T)
    size = scatter.scales[:, 0].astype(np.float64)
    bodies = Bodies.of(
        scatter.prototypes, scatter.prototype, (x, y), scatter.orientations, size, embed
    )
    ground = HeightPyramid.of(surface.field)
    ways = {
        "all, against the grid's triangles only": lambda: seating.seat(ground, bodies),
        "the same, and the detail at the middle":
            lambda: seating.seat(ground, bodies) + surface.lift_at(x, y),
        f"{seating.LOWEST} lowest": lambda: seating.seat_on_detail(surface, ground, bodies),
    }  # fmt: skip
    # Places in plan are the same: how far all vertices are above the ground counts once.
    at_zero = gaps(placed, count, np.zeros(count))
    rows = []
    for name, way in ways.items():
        way()
        start = time.perf_counter()
        off = way() + at_zero
        seconds = time.perf_counter() - start
        rms = float(np.sqrt((off * off).mean()))
        rows.append([name, f"{max(off.max(), 0.0):.2e}", f"{max(-off.min(), 0.0):.2e}",
                     f"{rms:.2e}", f"{100 * float(np.median(np.abs(off) / size)):.2f}",
                     f"{seconds:.3f}"])  # fmt: skip
    page.rows(rows)


def levels(page: Page) -> None:
    """Tables what budgets of triangles take."""
    count = 1000 if page.fast else 20_000
    thing = {
        "count": count, "family": "angular", "subdivisions": 2 if page.fast else 4,
        "prototypes": 8, "lod_px": 0, "clearance_m": 0.3,
        "size_m": {"type": "log_uniform", "min": 0.05, "max": 1},
    }  # fmt: skip
    placed = place({"rocks": thing}, size_m=(120.0, 96.0), spacing_m=0.6)
    scatter = placed.scatter
    start = time.perf_counter()
    chains = build_chains(placed.plan.objects[0].source.shapes)
    page.value("shapes", f"{time.perf_counter() - start:.2f} s")
    views = views_of(placed.rigs)
    unseen = placed.plan.terrain.meshing.unseen
    seen = see_levels(scatter, chains, views, unseen, 0.5)
    most = int(seen.triangles[seen.chosen()].sum())
    least = int(sum(seen.triangles[seen.finest + seen.lengths - 1]))
    budgets = [2 * most, most, most // 2, (most + least) // 3, (most + 9 * least) // 10, least,
               least - 1]  # fmt: skip
    spent = []
    for budget in budgets:
        try:
            start = time.perf_counter()
            factor = budget_factor([seen], budget)
            facts = choose_levels(seen, factor)[1]
            seconds = time.perf_counter() - start
            spent.append([f"{budget:,}", f"{facts['triangles']:,}", f"{factor or 1.0:.4g}",
                          f"{facts['lod_error_max_px']:.3f}", f"{seconds:.4f}"])  # fmt: skip
        except SceneError as error:
            spent.append([f"{budget:,}", f"refused: {str(error).split(': ', 1)[1]}", "", "", ""])
    page.rows(spent)


def growth(page: Page) -> None:
    """Tables seconds and memory over the number of objects."""
    counts = (1000, 10_000) if page.fast else (1000, 10_000, 100_000, 1_000_000)
    rows, slopes = [], []
    for case in ("uniform", "clusters", "overlap-free"):
        found = [apart(measure, count, case).value for count in counts]
        seconds = np.array([draw + lay for _, draw, _, lay, _, _ in found])
        memory = np.array([max(more, 1.0) for *_, more, _ in found])
        for (count, draw, _, lay, more, peak), total in zip(found, seconds, strict=True):
            micro = 1e6 * total / count
            rows.append([case, f"{count:,}", draw, lay, micro, f"{more:,.0f}", f"{peak:,.0f}"])
        # Below some thousand it is the fixed part that is measured.
        exponents = [np.polyfit(np.log(counts[-2:]), np.log(y[-2:]), 1)[0]
                     for y in (seconds, memory)]  # fmt: skip
        slopes.append(f"{case} {exponents[0]:.2f} and {exponents[1]:.2f}")
    page.value("exponents", "; ".join(slopes))
    page.rows(rows)


def main(page: Page) -> None:
    """Refreshes the page and its picture."""
    page.refresh(("scenec", "numpy", "numba", "scipy"), [
        placement_space.densities, placement_space.isolated, seats,
        levels, placement_extremes.rocks, growth,
    ])  # fmt: skip


if __name__ == "__main__":
    run(main, page="placement")
