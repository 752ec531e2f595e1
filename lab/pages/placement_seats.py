"""For docs/placement.md: how objects sit on rough ground, and how coarse they may be."""

from __future__ import annotations

import time
from unittest import mock

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.objects import seating
from scenec.compiler.objects.bodies import Bodies
from scenec.compiler.objects.height_pyramid import HeightPyramid
from scenec.compiler.objects.lod import budget_factor, choose_levels, see_levels
from scenec.compiler.objects.rocks import build_chains
from scenec.compiler.scene.objects import Scatter
from scenec.compiler.views.resolution import views_of
from scenec.lab.pages.placement_field import PLANE, cfg, gaps, stand
from scenec.lab.runner import Page, table
from scenec.schemas.errors import SceneError

#: Octaves far below the grid's spacing: detail that only the mesh near cameras shows.
_ROUGH = {"type": "multifractal", "amplitude_m": 1.5, "scale_m": 10, "octaves": 11, "gain": 0.55}


def seats(page: Page) -> str:
    """Error against cost of seating on what is finer than the grid."""
    count = 300 if page.fast else 5000
    thing = {
        "count": count, "subdivisions": 3, "lod_px": 0, "clearance_m": 0,
        "size_m": {"type": "log_uniform", "min": 0.1, "max": 1.5},
    }  # fmt: skip
    stood = stand(cfg({"rocks": thing}, spacing_m=0.5, relief=(PLANE, _ROUGH)))
    (scatter,) = stood.objects
    assert isinstance(scatter, Scatter)
    surface, plan = stood.surface, stood.plan.objects[0]
    assert surface.smooth
    embed = plan.embed[scatter.ids - 1]
    x, y = (np.ascontiguousarray(at) for at in scatter.positions[:, :2].astype(np.float64).T)
    size = scatter.scales[:, 0].astype(np.float64)
    bodies = Bodies.of(
        scatter.prototypes, scatter.prototype, (x, y), scatter.orientations, size, embed
    )
    ground = HeightPyramid.of(surface.field)
    vertices = len(scatter.prototypes[0].points)

    def on_grid() -> NDArray[np.float64]:
        return seating.seat(ground, bodies)

    def lifted() -> NDArray[np.float64]:
        return on_grid() + surface.lift_at(x, y)

    def with_lowest(most: int) -> NDArray[np.float64]:
        with mock.patch.object(seating, "LOWEST", most):
            return seating.seat_on_detail(surface, ground, bodies)

    ways = [
        ("all, against the grid's triangles only", on_grid),
        ("the same, and the detail at the middle", lifted),
        *(
            (f"{most:,} lowest{' (as compiled)' * (most == seating.LOWEST)}",
             lambda most=most: with_lowest(most))
            for most in (1, 8, 32, 128)
        ),
        (f"all {vertices:,}", lambda: with_lowest(vertices)),
    ]  # fmt: skip
    # Places in plan are the same: how far all vertices are above the ground counts once.
    low = np.stack([x, y, np.zeros(count)], axis=1)
    rest_at = (scatter.prototypes, scatter.prototype, low, scatter.orientations, size, embed)
    at_zero = gaps(surface, *rest_at)
    with_lowest(1)
    rows = []
    for name, way in ways:
        start = time.perf_counter()
        z = way()
        seconds = time.perf_counter() - start
        off = z + at_zero
        rms = float(np.sqrt((off * off).mean()))
        rows.append([name, f"{max(off.max(), 0.0):.2e}", f"{max(-off.min(), 0.0):.2e}",
                     f"{rms:.2e}", f"{100 * float(np.median(np.abs(off) / size)):.2f}",
                     f"{seconds:.3f}"])  # fmt: skip
    return (
        "## Seats: error against cost\n\n"
        f"{count:,} rocks of 0.1 m to 1.5 m, {vertices} vertices each, on relief every 0.5 m with "
        f"detail down to {10 / 2**10:.2g} m (about {surface.amplitude_m():.2f} m high in all). "
        "Each way of lowering them is compared with the surface with all its detail, at all "
        "vertices. *Float* and *sink* are how far the deepest vertex is above or below the "
        "requested depth, in meters; the median is in percent of a rock's size. `scenec compile` "
        "takes the second way where no view shows the difference larger than half a pixel, and "
        "the 32 lowest vertices elsewhere.\n\n"
        + table(
            ["vertices held against it", "float, m", "sink, m", "rms, m", "median, % of size", "s"],
            rows,
        )
    )


def levels(page: Page) -> str:
    """Levels of detail by error and by budget."""
    count = 1000 if page.fast else 20_000
    thing = {
        "count": count, "family": "angular", "subdivisions": 2 if page.fast else 4,
        "prototypes": 8, "lod_px": 0, "clearance_m": 0.3,
        "size_m": {"type": "log_uniform", "min": 0.05, "max": 1},
    }  # fmt: skip
    stood = stand(cfg({"rocks": thing}, size_m=(120.0, 96.0), spacing_m=0.6))
    (scatter,) = stood.objects
    assert isinstance(scatter, Scatter)
    plan = stood.plan.objects[0]
    start = time.perf_counter()
    chains = build_chains(plan.source.shapes)
    shapes = time.perf_counter() - start
    views = views_of(stood.rigs)
    unseen = stood.plan.terrain.meshing.unseen
    rows = []
    for lod_px in (0.0, 0.1, 0.25, 0.5, 1.0, 2.0, 4.0):

        def choose(lod_px: float = lod_px) -> dict:
            return choose_levels(see_levels(scatter, chains, views, unseen, lod_px))[1]

        seconds = page.timed(choose, 2)
        facts = choose()
        rows.append([f"{lod_px:g}", f"{facts['triangles']:,}",
                     f"{100 * facts['triangles'] / facts['triangles_finest']:.2f}",
                     f"{facts['lod_error_max_px']:.3f}", f"{seconds:.4f}"])  # fmt: skip
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
    return (
        "## Levels of detail, and a budget\n\n"
        f"{count:,} rocks of 0.05 m to 1 m on 120 m × 96 m, one camera of 640 × 480; eight shapes "
        f"with all levels took {shapes:.2f} s. The worst error is that of the coarsest rock in "
        "the view that shows it largest. Seconds are those of choosing the levels.\n\n"
        + table(["`lod_px`", "triangles", "% of the finest", "worst, px", "s"], rows)
        + "\nWith `lod_px` 0.5 and `max_triangles`: the factor by which errors exceed the "
        "request.\n\n"
        + table(["`max_triangles`", "triangles", "factor", "worst, px", "s"], spent)
    )  # fmt: skip
