"""Relief operators: seconds on big grids, beside pyfastnoiselite and fastscapelib where they are.

    python studies/benchmarks/relief.py

Best and median wall-clock time of some runs after one that compiles, and the processor seconds of
the best one: on a machine with other work, the latter over the number of cores is what an idle one
would take. The yardsticks (development dependencies; fastscapelib is GPL-3) run in the same
process, and their rows say how many times ours they take.
"""

from __future__ import annotations

import os
import statistics
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from scenec.compiler.frontend.streams import Streams
from scenec.compiler.terrain.barchans import draw_barchans
from scenec.compiler.terrain.drainage import SIDES
from scenec.compiler.terrain.draw_craters import draw_craters
from scenec.compiler.terrain.dunes import Dunes, Ripples
from scenec.compiler.terrain.grid import Grid
from scenec.compiler.terrain.multifractal import Multifractal
from scenec.compiler.terrain.smooth import Smooth
from scenec.compiler.terrain.stream_power import StreamPower
from scenec.compiler.terrain.terraces import Terraces
from scenec.compiler.terrain.thermal import Thermal
from scenec.compiler.terrain.tracks import Tracks
from scenec.compiler.terrain.worley import Worley

RUNS = 5
CRATERS = {
    "min_diameter_m": 3.0, "max_diameter_m": 300.0, "density_per_m2": 0.0218 * 1.54,
    "reference_diameter_m": 1.0, "exponent": 2.0, "depth_ratio": 0.15, "rim_ratio": 0.04,
    "degradation": 0.4, "irregularity": 0.08,
}  # fmt: skip
BARCHANS = {"count": 200, "height_m": 6.0, "wind_deg": 20.0, "repose_deg": 33.0}


@dataclass(frozen=True)
class Timing:
    """Best wall-clock seconds, their median, and the processor seconds of the best run."""

    best: float
    median: float
    processor: float


def timed(work: Callable[[], object]) -> Timing:
    """Times of ``RUNS`` runs after one that compiles."""
    work()
    rows = []
    for _ in range(RUNS):
        wall, processor = time.perf_counter(), time.process_time()
        work()
        rows.append((time.perf_counter() - wall, time.process_time() - processor))
    best = min(rows)
    return Timing(best[0], statistics.median(row[0] for row in rows), best[1])


def row(name: str, timing: Timing | None, asked: str = "") -> None:
    """One line of the table."""
    if timing is None:
        print(f"{name:52}{'not installed':>27}")
    else:
        print(
            f"{name:52}{timing.best:9.3f}{timing.median:9.3f}{timing.processor:9.3f}  {asked}",
            flush=True,
        )


def ratio(theirs: Timing | None, ours: Timing) -> str:
    """How many times as long theirs takes, by the clock and in processor time."""
    if theirs is None:
        return ""
    return (
        f"{theirs.best / ours.best:.2f} times ours ({theirs.processor / ours.processor:.2f} times "
        "its processor time)"
    )


def fast_noise_lite(n: int, octaves: int) -> Timing | None:
    """Perlin fBm of pyfastnoiselite on a grid, the making of coordinates not counted."""
    try:
        from pyfastnoiselite.pyfastnoiselite import FastNoiseLite, FractalType, NoiseType
    except ImportError:
        return None
    noise = FastNoiseLite(seed=1)
    noise.noise_type = NoiseType.NoiseType_Perlin
    noise.frequency = 1.0 / 512.0
    noise.fractal_type = FractalType.FractalType_FBm
    noise.fractal_octaves = octaves
    x, y = np.meshgrid(np.arange(n, dtype=np.float32), np.arange(n, dtype=np.float32))
    coordinates = np.ascontiguousarray(np.stack([x.ravel(), y.ravel()]))
    return timed(lambda: noise.gen_from_coords(coordinates))


def fastscape(
    height: np.ndarray, spacing: float, erodibility: float, exponent: float, years: float
) -> Timing | None:
    """One step of fastscapelib: sinks resolved, water routed, rivers eroded."""
    try:
        import fastscapelib
    except ImportError:
        return None
    grid = fastscapelib.RasterGrid(
        list(height.shape), [spacing, spacing], fastscapelib.NodeStatus.FIXED_VALUE
    )
    operators = [fastscapelib.SingleFlowRouter(), fastscapelib.MSTSinkResolver()]
    graph = fastscapelib.FlowGraph(grid, operators)
    eroder = fastscapelib.SPLEroder(graph, erodibility, 0.5, exponent, 1e-5)

    def step() -> object:
        graph.update_routes(height)
        return height - eroder.erode(height, graph.accumulate(1.0), years)

    return timed(step)


def main() -> None:
    """Prints the table."""
    print(f"{os.cpu_count()} cores, {RUNS} runs, seconds")
    print(f"{'':52}{'best':>9}{'median':>9}{'CPU':>9}  asked")
    grid = Grid((2047.0, 2047.0), (2048, 2048))
    flat = np.zeros(grid.shape)

    ours = {}
    for variant in ("fbm", "hetero", "hybrid", "ridged", "billow"):
        noise = Multifractal(1, 1.0, 512.0, 8, 2.0, 0.5, variant, 0.7)
        ours[variant] = timed(lambda n=noise: n.apply(grid, flat))
        row(f"{variant}, 2048², 8 octaves", ours[variant], "≤ 0.3")
    theirs = fast_noise_lite(2048, 8)
    row("pyfastnoiselite, Perlin fBm, 2048², 8 octaves", theirs, ratio(theirs, ours["fbm"]))
    warped = Multifractal(1, 1.0, 512.0, 8, 2.0, 0.5, "fbm", 0.7, 0.5, 2)
    row("fbm, warped by 2 octaves, 2048², 8 octaves", timed(lambda: warped.apply(grid, flat)))
    for distance in ("f1", "f2-f1"):
        cells = Worley(1, 1.0, 64.0, distance, 1.0, 1, 2.0, 0.5)
        row(f"worley {distance}, 2048²", timed(lambda c=cells: c.apply(grid, flat)))

    hills = Multifractal(1, 60.0, 512.0, 8, 2.0, 0.5, "fbm", 0.7).apply(grid, flat)[0]
    for length in (0.1, 30.0, 1e6):
        smooth = Smooth(length)
        row(
            f"diffusion, 2048², {length:g} m", timed(lambda s=smooth: s.apply(grid, hills)), "≤ 0.5"
        )

    half = Grid((10_230.0, 10_230.0), (1024, 1024))
    valley = Multifractal(1, 300.0, 6000.0, 8, 2.0, 0.5, "fbm", 0.7)
    valleys = valley.apply(half, np.zeros(half.shape))[0]
    for n, asked in ((1.0, "< fastscapelib's"), (1.5, "")):
        river = StreamPower(2e-5, 0.5, n, 0.0, 0.0, 0.0, 1e5, 1, SIDES)
        timing = timed(lambda r=river: r.apply(half, valleys))
        row(f"stream power, n = {n:g}, 1024², one step", timing, asked)
        theirs = fastscape(valleys, 10.0, 2e-5, n, 1e5)
        row(f"fastscapelib, n = {n:g}, 1024², one step", theirs, ratio(theirs, timing))

    slides = Thermal(20.0)
    row("thermal erosion, 1024²", timed(lambda: slides.apply(half, 5.0 * valleys)))

    craters = draw_craters(CRATERS, Streams(1, 0), "craters", grid.size_m)
    row(
        f"{len(craters.x_m):,} craters of 3 to 300 m in equilibrium, 2048²",
        timed(lambda: craters.apply(grid, flat)),
    )
    dunes = Dunes(1, 4.0, 60.0, 20.0, 33.0, 0.3)
    row("dunes, 2048²", timed(lambda: dunes.apply(grid, flat)))
    ripples = Ripples(1, 0.6, 10.0, 20.0, 28.0, 0.4)
    row("ripples, 2048²", timed(lambda: ripples.apply(grid, flat)))
    heaps = draw_barchans(BARCHANS, Streams(1, 0), "barchans", grid.size_m)
    row("200 barchans, 2048²", timed(lambda: heaps.apply(grid, flat)))
    layers = Terraces(1, 6.0, 0.3, 0.2, 0.5, 2.0, 100.0)
    row("terraces, 2048²", timed(lambda: layers.apply(grid, hills)))
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "path.csv"
        x = np.linspace(-900.0, 900.0, 200)
        points = np.stack([x, 300.0 * np.sin(x / 200.0)], axis=1)
        np.savetxt(path, points, delimiter=",", header="x_m,y_m", comments="")
        rover = Tracks(path, 20.0, 6.0, 0.5, 4.0, 0.2, "chevrons")
        row("tracks, 200 points, 2048²", timed(lambda: rover.apply(grid, hills)))


if __name__ == "__main__":
    main()
