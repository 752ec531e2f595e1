"""For docs/relief.md: what steps in time or iterates, and what that errs."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import scipy.sparse
import scipy.sparse.linalg
from numpy.typing import NDArray

from scenec.compiler.terrain.grid import Grid
from scenec.compiler.terrain.operators import thermal
from scenec.compiler.terrain.operators.drainage import SIDES
from scenec.compiler.terrain.operators.halving import rms
from scenec.compiler.terrain.operators.multifractal import Multifractal
from scenec.compiler.terrain.operators.stream_power import StreamPower
from scenec.compiler.terrain.operators.thermal import Thermal
from scenec.compiler.terrain.sources import fill_holes
from scenec.lab.runner import Page, table

_INVENTORY = [
    [
        "`stream_power`*, time steps",
        "outlets keep their heights, other sides are insulated",
        "`steps`, or the aim `error_m`",
        "`error_rms_m`, `error_99_m`",
    ],
    ["`stream_power`, hillslopes*", "the same", "exact: one step of any size", "nothing to state"],
    [
        "`stream_power`, the implicit slope",
        "",
        "Newton, from above, to 1e-15",
        "nothing: solved to rounding (`test_relief_erosion.py`)",
    ],
    [
        "`smooth`, `diffusion`",
        "insulated: the mean is kept",
        "exact: one step of any size",
        "nothing to state",
    ],
    [
        "`thermal`*",
        "insulated: the mean is kept",
        "50 iterations on each grid",
        "`error_rms_m`, `error_99_m`, `last_iteration_m`, `steep_fraction_left`",
    ],
    [
        "holes of DEMs and meshes*",
        "heights at the rim; insulated at the file's border",
        "residual of 1e-12 of the span, or 400 iterations on each grid",
        "`holes_error_m`",
    ],
    ["drainage, `flow`, lakes", "outlets (`flow`: all sides)", "every sample once", "exact for D8"],
    [
        "wear of craters",
        "no flux at the center and at 12 radii",
        "TR-BDF2, 16 steps a doubling of the state",
        "below 3e-4 of the depth (`test_relief_craters.py`)",
    ],
    [
        "`dunes`, `barchans`, `ripples`, `terraces`, `tracks`",
        "",
        "closed forms: nothing iterates",
        "",
    ],
    ["label lines", "", "8 steps of the Illinois rule", "`chord_error_*_m`, `side_error_bound`"],
    [
        "the adaptive mesh",
        "",
        "tolerance or triangle budget",
        "`surface_error_rms_px`, `surface_error_99_9_px`, `surface_error_found_px`, at points",
    ],
    [
        "scattering of all orders in skies",
        "ground that reflects",
        "a geometric series: all orders",
        "[sky.md](sky.md), against photons",
    ],
    ["a MAV's heights", "lands at its own height", "16 lifts, else an error", "exit status 2"],
    ["ways around objects", "", "until no distance shrinks", "shortest on its grid"],
    ["rays of views to the ground", "", "40 bisections: 1e-12 of a step", "nothing to state"],
    ["open shutters", "", "poses doubled until below 1e-3 pixels, 64 at most", "`error_px`"],
    ["`scenec settle`", "", "at rest, or `max_steps`", "`unsettled`, overlap"],
]


def inventory(page: Page) -> str:
    """All that steps or iterates."""
    del page
    return (
        "## What steps or iterates\n\n"
        "Everything in the compiler that is not one formula: its boundary condition, what ends "
        "it, and the error that report.json states. Rows marked * are measured above.\n\n"
        + table(["what", "at borders", "ends", "states"], _INVENTORY)
    )


def cases(number: int) -> list[tuple[Grid, NDArray[np.float64], StreamPower]]:
    """Drawn terrains and rivers: 30 m to 30 km, short and long, with and without all that is."""
    found = []
    for k in range(100, 100 + number):
        rng = np.random.default_rng(k)
        n, size = 49, float(10 ** rng.uniform(1.5, 4.5))
        grid = Grid((size, size), (n, n))
        amplitude = size * float(10 ** rng.uniform(-2.3, -1.0))
        hills = Multifractal(
            key=k,
            amplitude_m=amplitude,
            scale_m=size / rng.uniform(1, 4),
            octaves=7,
            lacunarity=2.0,
            gain=0.5,
            variant="fbm",
            offset=0.9,
        )
        m, exponent = float(rng.uniform(0.3, 0.6)), float(rng.choice([1.0, 1.0, 0.7, 1.5]))
        years, courant = float(10 ** rng.uniform(3, 6)), float(10 ** rng.uniform(-1, 2.5))
        slope = amplitude / size
        erodibility = (
            courant * size / n / (0.2 * size * size) ** m / years * slope ** (1 - exponent)
        )
        found.append((grid, hills.apply(grid, np.zeros(grid.shape))[0], StreamPower(
            erodibility=erodibility, area_exponent=m, slope_exponent=exponent,
            channel_area_m2=float(rng.choice([0.0, 20 * (size / n) ** 2])),
            diffusivity_m2_per_a=float(rng.choice([0.0, 1.0])) * (size / n * 3) ** 2 / years,
            uplift_m_per_a=float(rng.choice([0.0, 1.0, 10.0])) * amplitude / years,
            duration_a=years, steps=1,
            outlets=[SIDES, ("south",), ("west", "north")][int(rng.integers(3))],
        )))  # fmt: skip
    return found


def river_steps(page: Page) -> str:
    """Error against time of the steps of rivers, and how often what is said held."""
    numbers = (8, 16, 32) if page.fast else (4, 8, 16, 32, 64, 128)
    drawn = cases(3 if page.fast else 40)
    seconds = dict.fromkeys(numbers, 0.0)
    true: dict[int, list[tuple[float, ...]]] = {number: [] for number in numbers}
    for grid, height, operator in drawn:
        truth = operator.run(grid, height, 8 * numbers[-1])[0]
        for number in numbers:
            start = time.process_time()
            out, report = replace(operator, steps=number).apply(grid, height)
            seconds[number] += time.process_time() - start
            off = np.abs(out - truth)
            true[number].append((
                rms(off) / max(report["change_rms_m"], 1e-300),
                rms(off) / max(report["error_rms_m"], 1e-300),
                float(np.quantile(off, 0.99)) / max(report["error_99_m"], 1e-300),
            ))  # fmt: skip
    rows = []
    for number in numbers:
        part, ratio, high = np.array(true[number]).T
        rows.append([
            str(number), f"{100 * np.median(part):.2g}", f"{100 * np.quantile(part, 0.9):.2g}",
            f"{np.median(ratio):.2f}", f"{100 * (ratio <= 1).mean():.0f}",
            f"{100 * (ratio <= 2).mean():.0f}", f"{ratio.max():.1f}",
            f"{100 * (high <= 1).mean():.0f}", f"{high.max():.1f}",
            f"{seconds[number] / len(drawn):.3f}",
        ])  # fmt: skip
    return (
        "## Stream power: the error of its steps, and the stated error\n\n"
        f"{len(drawn)} drawn terrains of 49², 30 m to 30 km wide, with and without uplift, "
        "diffusion, channel heads, closed sides; Courant numbers of the whole time from 0.1 to "
        f"300, n of 0.7, 1 and 1.5; against {8 * numbers[-1]:,} steps. The course of water "
        "changes in leaps, so the error falls with an order between 1/2 and 1. Under lasting "
        "uplift, whole catchments may join one river or another however short the steps are; the "
        "largest errors are there. The stated error is the difference from half as many steps "
        "times 1/(√2 − 1), which is right for order 1/2. It is an estimate and no bound. CPU "
        "seconds are those of both runs.\n\n"
        + table(
            ["steps", "error, % of the change: median", "nine of ten within",
             "error / said: median", "held, %", "within twice, %", "at most",
             "99 % of samples: held, %", "at most", "s"],
            rows,
        )
    )  # fmt: skip


def hillslopes(page: Page) -> str:
    """Hillslopes between fixed outlets, over steps of any size."""
    grid = Grid((200.0, 200.0), (41, 41))
    x = grid.x()[None, :]
    parabola = 1e-3 / (2.0 * 0.05) * (100.0**2 - x * x) + np.zeros(grid.shape)
    rough = np.random.default_rng(1).normal(size=grid.shape)
    rows = []
    for decade in (0, 5) if page.fast else range(-5, 6):
        years = 25.0 / 0.05 * 10.0**decade
        operator = StreamPower(
            erodibility=0.0,
            diffusivity_m2_per_a=0.05,
            uplift_m_per_a=1e-3,
            duration_a=years,
            steps=1,
            outlets=("west", "east"),
        )
        start = time.process_time()
        off = operator.run(grid, parabola, 1)[0] - parabola
        spent = time.process_time() - start
        moved = operator.run(grid, rough, 1)[0] - rough
        rows.append([
            f"1e{decade}", f"{np.abs(off).max() / parabola.max():.1e}",
            f"{np.abs(moved[:, [0, -1]]).max():.0e}", f"{spent:.4f}",
        ])  # fmt: skip
    return (
        "### Hillslopes between outlets\n\n"
        "Without rivers a hillslope between two outlets ends as the parabola h'' = −U/D, which one "
        "step of any size must keep; 41², 200 m wide, from D·Δt/Δx² of 1e-5 to 1e5. Outlets keep "
        "their heights to the bit.\n\n"
        + table(["D·Δt/Δx²", "off the parabola / its height", "outlets moved, m", "s"], rows)
    )


def iterations(page: Page) -> str:
    """What slides and filled holes err after some iterations, and what is said of it."""
    rows = []
    for name, height in _steep().items():
        rows += _slides(page, name, height)
    text = (
        "## Slides and holes: the error of their iterations\n\n"
        "Thermal erosion at 33° on 129², against 3,200 iterations on the finest grid (the "
        "operator makes 50), in meters. The stated error is 1/(√2 − 1) times the difference from "
        "half as many. It is too small for ground that is too steep everywhere, which comes to "
        "rest from its borders inward.\n\n"
        + table(["ground", "iterations", "error rms", "said", "error of 99 %", "said", "s"], rows)
    )
    holes = []
    for name, mask in _masks().items():
        holes += _filled(page, name, mask)
    return (
        text
        + "\nHoles in hills of ±50 m (200²), against a direct solver; at most 400 iterations are "
        "made on each grid.\n\n"
        + table(["hole", "iterations", "error at most, m", "said, m", "s"], holes)
    )


def _steep() -> dict[str, NDArray[np.float64]]:
    grid = Grid((128.0, 128.0), (129, 129))
    rng = np.random.default_rng(4)
    x, y = grid.x()[None, :], grid.y()[:, None]
    hills = Multifractal(
        key=3,
        amplitude_m=40.0,
        scale_m=60.0,
        octaves=7,
        lacunarity=2.0,
        gain=0.5,
        variant="fbm",
        offset=0.9,
    ).apply(grid, np.zeros(grid.shape))[0]
    return {
        "noise of 100 m": 100.0 * rng.random(grid.shape),
        "hills": hills,
        "a cliff of 30 m": np.where(x > 0.0, 30.0, 0.0) + np.zeros(grid.shape),
        "a cone": np.clip(60.0 - 2.0 * np.hypot(x, y), 0.0, None),
        "a slope of 45°": x + np.zeros(grid.shape),
    }


def _slides(page: Page, name: str, height: NDArray[np.float64]) -> list[list[str]]:
    grid = Grid((128.0, 128.0), height.shape)

    def made(number: int) -> tuple[NDArray[np.float64], dict[str, Any], float]:
        return _with(thermal, "_FINE", number, lambda: Thermal(33.0).apply(grid, height))

    truth = made(400 if page.fast else 3200)[0]
    rows = []
    for number in (50,) if page.fast else (12, 50, 200, 800):
        out, report, seconds = made(number)
        off = np.abs(out - truth)
        rows.append([
            name, str(number), f"{rms(off):.1e}", f"{report['error_rms_m']:.1e}",
            f"{np.quantile(off, 0.99):.1e}", f"{report['error_99_m']:.1e}", f"{seconds:.2f}",
        ])  # fmt: skip
    return rows


def _masks() -> dict[str, NDArray[np.bool_]]:
    x = np.arange(200.0) - 100.0
    away = np.hypot(x[None, :], x[:, None])
    rng = np.random.default_rng(4)
    return {
        "15 pixels in radius": away < 15,
        "60 pixels in radius": away < 60,
        "half of the field": (x[None, :] > 0.0) & (away >= 0.0),
        "half, at random": rng.random(away.shape) < 0.5,
        "all but some": rng.random(away.shape) < 0.9999,
    }


def _filled(page: Page, name: str, mask: NDArray[np.bool_]) -> list[list[str]]:
    x = np.arange(200.0)
    hills = np.add.outer(30.0 * np.sin(x / 20.0), 20.0 * np.cos(x / 13.0))
    truth = _solved(hills, mask)
    rows = []
    for number in (400,) if page.fast else (50, 100, 200, 400):
        filled, said, seconds = _with(
            fill_holes, "_MOST", number, lambda: fill_holes.fill_holes(hills, mask)
        )
        off = float(np.abs(filled - truth).max())
        rows.append([name, str(number), f"{off:.1e}", f"{said:.1e}", f"{seconds:.3f}"])
    return rows


def _solved(values: NDArray[np.float64], mask: NDArray[np.bool_]) -> NDArray[np.float64]:
    ny, nx = mask.shape
    number = np.full((ny + 2, nx + 2), -2)
    number[1:-1, 1:-1] = np.where(mask, np.cumsum(mask.ravel()).reshape(mask.shape) - 1, -1)
    known = np.pad(values, 1)
    j, i = np.nonzero(mask)
    diagonal, right = np.zeros(len(j)), np.zeros(len(j))
    rows, columns = [], []
    for b, a in ((0, 1), (2, 1), (1, 0), (1, 2)):
        other = number[j + b, i + a]
        diagonal += other != -2
        right += np.where(other == -1, known[j + b, i + a], 0.0)
        rows.append(np.flatnonzero(other >= 0))
        columns.append(other[other >= 0])
    row, column = np.concatenate(rows), np.concatenate(columns)
    matrix = scipy.sparse.diags_array(diagonal) - scipy.sparse.csc_array(
        (np.ones(len(row)), (row, column)), shape=(len(j), len(j))
    )
    out = values.copy()
    out[mask] = scipy.sparse.linalg.spsolve(matrix.tocsc(), right)
    return out


def _with[T](
    module: Any, name: str, value: int, call: Callable[[], tuple[NDArray[np.float64], T]]
) -> tuple[NDArray[np.float64], T, float]:
    """What a call gives with another constant, and the processor's seconds."""
    before = getattr(module, name)
    setattr(module, name, value)
    try:
        call()
        start = time.process_time()
        return *call(), time.process_time() - start
    finally:
        setattr(module, name, before)
