"""Relief operators: seconds on big grids, beside pyfastnoiselite and fastscapelib where they are.

    python lab/benchmarks/relief.py [--fast]

Best and median wall-clock time of some runs after one that compiles, and the processor seconds of
the best one: on a machine with other work, the latter over the number of cores is what an idle one
would take. The yardsticks (development dependencies; fastscapelib is GPL-3) run in the same
process, and their rows say how many times ours they take. ``docs/relief.md`` has the table, too.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.distributions.streams import Streams
from scenec.compiler.kinds.context import Context
from scenec.compiler.kinds.draw import draw_kind
from scenec.compiler.terrain.grid import Grid
from scenec.compiler.terrain.operator import ReliefOperator
from scenec.compiler.terrain.operators.barchans import BarchanField
from scenec.compiler.terrain.operators.dunes import Dunes, Ripples
from scenec.compiler.terrain.operators.multifractal import Multifractal
from scenec.compiler.terrain.operators.smooth import Smooth
from scenec.compiler.terrain.operators.stream_power import StreamPower
from scenec.compiler.terrain.operators.terraces import Terraces
from scenec.compiler.terrain.operators.thermal import Thermal
from scenec.compiler.terrain.operators.tracks import Tracks
from scenec.compiler.terrain.operators.worley import Worley
from scenec.lab.runner import Cell, Study, run, times

HEADER = ("operator", "best s", "median s", "CPU s", "asked, or times ours (of CPU)")
CRATERS = {
    "min_diameter_m": 3.0, "max_diameter_m": 300.0, "density_per_m2": 0.0218 * 1.54,
    "reference_diameter_m": 1.0, "exponent": 2.0, "depth_ratio": 0.15, "rim_ratio": 0.04,
    "degradation": 0.4, "irregularity": 0.08,
}  # fmt: skip
BARCHANS = BarchanField(count=200, height_m=6.0, wind_deg=20.0)


def fast_noise_lite(n: int, octaves: int) -> Callable[[], object] | None:
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
    return lambda: noise.gen_from_coords(coordinates)


def fastscape(
    height: NDArray, spacing: float, erodibility: float, exponent: float, years: float
) -> Callable[[], object] | None:
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

    def step(_kept: object = (grid, operators)) -> object:
        graph.update_routes(height)
        return height - eroder.erode(height, graph.accumulate(1.0), years)

    return step


def rows(n: int, runs: int, folder: Path) -> Iterator[list[Cell]]:
    """Of ``HEADER``.

    Args:
        n: Samples along each side of the large grid; erosion takes half as many.
        runs: That count.
        folder: For a file.
    """
    ours = None

    def row(name: str, work: Callable[[], object] | None, asked: str = "") -> list[Cell]:
        if work is None:
            return [name, None, None, None, "not installed"]
        found = times(work, runs)
        best = min(zip(found.wall, found.cpu, strict=True))
        if asked == "yardstick":
            assert ours is not None
            asked = f"{best[0] / ours[0]:.2f} ({best[1] / ours[1]:.2f})"
        latest.append(best)
        return [name, best[0], found.median, best[1], asked]

    latest: list[tuple[float, float]] = []
    grid = Grid((n - 1.0, n - 1.0), (n, n))
    flat = np.zeros(grid.shape)

    def on(operator: ReliefOperator, height: NDArray = flat, of: Grid = grid) -> Callable:
        return lambda: operator.apply(of, height)

    for variant in ("hetero", "hybrid", "ridged", "billow", "fbm"):
        noise = Multifractal(
            key=1,
            amplitude_m=1.0,
            scale_m=512.0,
            octaves=8,
            lacunarity=2.0,
            gain=0.5,
            variant=variant,
            offset=0.7,
        )
        yield row(f"{variant}, {n}², 8 octaves", on(noise), "≤ 0.3")
    ours = latest[-1]
    yield row(f"pyfastnoiselite, Perlin fBm, {n}², 8 octaves", fast_noise_lite(n, 8), "yardstick")
    warped = Multifractal(
        key=1,
        amplitude_m=1.0,
        scale_m=512.0,
        octaves=8,
        lacunarity=2.0,
        gain=0.5,
        variant="fbm",
        offset=0.7,
        distortion=0.5,
        distortion_octaves=2,
    )
    yield row(f"fbm, warped by 2 octaves, {n}², 8 octaves", on(warped))
    for distance in ("f1", "f2-f1"):
        yield row(
            f"worley {distance}, {n}²",
            on(Worley(key=1, amplitude_m=1.0, scale_m=64.0, distance=distance)),
        )
    hills = Multifractal(
        key=1,
        amplitude_m=60.0,
        scale_m=512.0,
        octaves=8,
        lacunarity=2.0,
        gain=0.5,
        variant="fbm",
        offset=0.7,
    ).apply(grid, flat)[0]
    for length in (0.1, 30.0, 1e6):
        yield row(f"diffusion, {n}², {length:g} m", on(Smooth(length), hills), "≤ 0.5")

    m = n // 2
    half = Grid((10.0 * m - 10.0, 10.0 * m - 10.0), (m, m))
    valley = Multifractal(
        key=1,
        amplitude_m=300.0,
        scale_m=6000.0,
        octaves=8,
        lacunarity=2.0,
        gain=0.5,
        variant="fbm",
        offset=0.7,
    )
    valleys = valley.apply(half, np.zeros(half.shape))[0]
    for power, asked in ((1.0, "< fastscapelib's"), (1.5, "")):
        river = StreamPower(erodibility=2e-5, slope_exponent=power, duration_a=1e5, steps=1)
        name = f"n = {power:g}, {m}², one step"
        yield row(f"stream power, {name}", on(river, valleys, half), asked)
        ours = latest[-1]
        theirs = fastscape(valleys, 10.0, 2e-5, power, 1e5)
        yield row(f"fastscapelib, {name}", theirs, "yardstick")
    yield row(f"thermal erosion, {m}²", on(Thermal(20.0), 5.0 * valleys, half))

    craters = draw_kind(
        "relief", {"type": "craters", **CRATERS}, "craters", Context(Streams(1, 0), grid.size_m)
    )
    yield row(f"{len(craters.x_m):,} craters of 3 to 300 m in equilibrium, {n}²", on(craters))
    yield row(
        f"dunes, {n}²",
        on(
            Dunes(key=1, height_m=4.0, wavelength_m=60.0, wind_deg=20.0, repose_deg=33.0, order=0.3)
        ),
    )
    yield row(
        f"ripples, {n}²",
        on(
            Ripples(
                key=1, height_m=0.6, wavelength_m=10.0, wind_deg=20.0, repose_deg=28.0, order=0.4
            )
        ),
    )
    heaps = BARCHANS.draw(Context(Streams(1, 0), grid.size_m, path="barchans"))
    yield row(f"200 barchans, {n}²", on(heaps))
    yield row(f"terraces, {n}²", on(Terraces(key=1, step_m=6.0, bend_m=2.0), hills))
    path = folder / "path.csv"
    x = np.linspace(-0.44, 0.44, 200) * grid.size_m[0]
    points = np.stack([x, 300.0 * np.sin(x / 200.0)], axis=1)
    np.savetxt(path, points, delimiter=",", header="x_m,y_m", comments="")
    rover = Tracks(
        file=path,
        wheel_distance_m=20.0,
        wheel_width_m=6.0,
        depth_m=0.5,
        grouser_spacing_m=4.0,
        grouser_depth_m=0.2,
        pattern="chevrons",
    )
    yield row(f"tracks, 200 points, {n}²", on(rover, hills))


def main(study: Study) -> None:
    """Prints the table."""
    study.table(HEADER, rows(*((256, 1) if study.fast else (2048, 5)), study.scratch))


if __name__ == "__main__":
    run(main)
