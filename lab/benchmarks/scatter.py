"""Scattering: how long objects take to be placed and seated, and how much memory that needs.

    python lab/benchmarks/scatter.py [--counts N,N] [--subdivisions N] [--cases A,B] [--fast]

Each case runs in a process of its own, whose peak memory is that of drawing, placing and seating
alone (terrain and compiled kernels come off it). The overlap-free case has radii that cover about
a quarter of the terrain. ``docs/placement.md`` shows how both grow.
"""

from __future__ import annotations

import time
from typing import Any

import numpy as np

from scenec.compiler.cfg.fill import fill
from scenec.compiler.distributions.streams import Streams
from scenec.compiler.kinds.context import Context
from scenec.compiler.kinds.draw import draw_kind
from scenec.compiler.mesh.surface import GroundSurface
from scenec.compiler.objects.rocks import build_chains
from scenec.compiler.objects.scatter import scatter
from scenec.compiler.objects.surroundings import PlacementContext
from scenec.compiler.terrain.grid import Grid, HeightField
from scenec.compiler.terrain.operators.multifractal import Multifractal
from scenec.lab.runner import Study, apart, peak_mib, run

_SIZE = 400.0
CASES: dict[str, dict[str, Any]] = {
    "uniform": {},
    "noise": {"density": {"type": "noise", "scale_m": 20}},
    "clusters": {"density": {"type": "clusters", "parents": 200, "sigma_m": 4}},
    "slope": {"where": [{"type": "slope", "max_deg": 20, "softness_deg": 5}]},
    "overlap-free": {"apart": {}},
}
HEADER = ("objects", "draw, s", "shapes, s", "place and seat, s", "memory, MiB", "peak, MiB")


def rocks(count: int, subdivisions: int, case: dict[str, Any]) -> dict[str, Any]:
    """One class in full."""
    largest = 0.5 * _SIZE / max(count, 1) ** 0.5
    thing = {
        "type": "rocks",
        "count": count,
        "material": "stone",
        "subdivisions": subdivisions,
        "size_m": {"type": "power_law", "exponent": 2.5, "min": 0.2 * largest, "max": 4 * largest},
        **case,
    }
    terrain = {"size_m": [_SIZE, _SIZE], "spacing_m": 0.4, "relief": [], "ground": [{}]}
    cfg = {"terrain": terrain, "objects": {"rocks": thing}, "materials": {}, "rigs": {}}
    filled: dict[str, Any] = fill(cfg)["objects"]["rocks"]
    return filled


def measure(count: int, subdivisions: int, name: str) -> tuple[float, ...]:
    """Of ``HEADER``: count, seconds of each step, memory beyond that before, in this process."""
    grid = Grid.with_spacing((_SIZE, _SIZE), 0.4)
    relief = Multifractal(
        key=1,
        amplitude_m=3.0,
        scale_m=40.0,
        octaves=8,
        lacunarity=2.0,
        gain=0.5,
        variant="fbm",
        offset=0.7,
    )
    surface = GroundSurface(HeightField(grid, relief.apply(grid, np.zeros(grid.shape))[0]))
    cameras = np.array([[x, 0.0, 2.0] for x in np.linspace(-100, 100, 100)])
    setting = Context(Streams(1, 0), (_SIZE, _SIZE))

    def once(n: int) -> tuple[float, ...]:
        cfg = rocks(n, subdivisions, CASES[name])
        clock = [time.perf_counter()]
        plan = draw_kind("objects", cfg, "objects/rocks", setting)
        clock.append(time.perf_counter())
        chains = build_chains(plan.source.shapes, coarser=False)
        clock.append(time.perf_counter())
        made = scatter(plan, chains, PlacementContext(surface, cameras), {})
        clock.append(time.perf_counter())
        return made.count, *np.diff(clock).tolist()

    once(100)
    before = peak_mib()
    found = once(count)
    return *found, peak_mib() - before, peak_mib()


def main(study: Study) -> None:
    """Prints the table."""
    counts = study.options.counts[:1] if study.fast else study.options.counts
    rows = (
        [name, *apart(measure, count, study.options.subdivisions, name).value]
        for name in study.options.cases
        for count in counts
    )
    study.table(["case", *HEADER], rows)


if __name__ == "__main__":
    counts = (30_000, 100_000, 300_000, 1_000_000)
    run(main, counts=counts, subdivisions=1, cases=tuple(CASES))
