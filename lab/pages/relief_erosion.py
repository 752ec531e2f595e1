"""For docs/relief.md: rivers and slides, at any step and any drop."""

from __future__ import annotations

from dataclasses import replace

import matplotlib.pyplot as plt
import numpy as np
from numpy.typing import NDArray

from scenec.compiler.terrain.grid import Grid
from scenec.compiler.terrain.operators.drainage import SIDES, drain, drainage_area, outlet_samples
from scenec.compiler.terrain.operators.stream_power import StreamPower
from scenec.compiler.terrain.operators.thermal import Thermal
from scenec.lab.runner import Page, table


def rivers(page: Page) -> str:
    """The slope-area law, pits and NaN, at steps far beyond the explicit limit."""
    grid = Grid((4000.0, 3000.0), (61, 81))
    dx = grid.spacing_m[0]
    noise = np.random.default_rng(2).normal(size=grid.shape)
    outlets = outlet_samples(grid.shape, SIDES)
    inner = ~outlets.ravel()
    k, uplift = 1e-5, 1e-3
    largest = drainage_area(drain(noise, outlets, dx, dx), dx * dx).max()
    limit = dx / (k * np.sqrt(largest))
    rows, scatter, deviations = [], {}, {}
    numbers = (1.0, 1e4) if page.fast else (1e-2, 0.1, 1.0, 10.0, 1e2, 1e3, 1e4, 1e6)
    for m, n in ((0.5, 1.0), (0.4, 1.3)):
        operator = StreamPower(
            erodibility=k,
            area_exponent=m,
            slope_exponent=n,
            uplift_m_per_a=uplift,
            duration_a=1e9,
            steps=100,
        )
        steady = operator.apply(grid, noise)[0]
        for number in numbers:
            run = replace(operator, duration_a=40 * number * limit, steps=40)
            out = run.apply(grid, steady)[0]
            ways = drain(out, outlets, dx, dx)
            area = drainage_area(ways, dx * dx)[inner]
            drop = (out.ravel() - out.ravel()[ways.receiver])[inner]
            slope = drop / ways.distance[inner]
            law = (uplift / (k * area**m)) ** (1.0 / n)
            scatter[(m, n)] = (area, slope, law)
            worst = 100 * np.abs(slope / law - 1).max()
            deviations.setdefault((m, n), []).append(worst)
            wild, report = replace(run, uplift_m_per_a=0.0, steps=3, duration_a=3 * number * limit
                                   ).apply(grid, 50.0 * noise)  # fmt: skip
            rows.append([
                f"{m:g}, {n:g}", f"{number:g}", f"{worst:.1e}",
                str(pits(out, outlets)), str(pits(wild, outlets)),
                "none" if np.isfinite(wild).all() else "some",
                f"{report['filled_m3'] / (4000 * 3000):.3g}",
            ])  # fmt: skip
    figure, (axes, right) = plt.subplots(1, 2, figsize=(9.6, 3.6))
    for (m, n), (area, slope, law) in scatter.items():
        axes.loglog(area, slope, ".", markersize=3, label=f"m = {m:g}, n = {n:g}")
        order = np.argsort(area, kind="stable")
        axes.loglog(area[order], law[order], "k-", linewidth=0.8)
        right.loglog(numbers, deviations[(m, n)], "o-", label=f"m = {m:g}, n = {n:g}")
    axes.set(xlabel="drainage area, m²", ylabel="slope", title="Steady state and the law (lines)")
    right.axhline(1.0, color="k", linestyle="--", linewidth=0.8, label="asked: 1 %")
    right.set(xlabel="step / explicit limit", ylabel="%", title="Largest deviation from the law",
              ylim=(1e-15, 10))  # fmt: skip
    for each in (axes, right):
        each.grid(alpha=0.3)
        each.legend(fontsize=8)
    return (
        "## Stream power: the slope-area law at any step\n\n"
        "61 × 81 samples of 50 m, K = 1e-5, uplift 1 mm a year. Forty steps start from the steady "
        "state of much longer ones; the step is a multiple of the explicit limit Δx/(K·A^m). The "
        "deviation is the largest of any slope from S = (U/(K·A^m))^(1/n). The right half shows "
        "three steps on noise of 50 m without uplift: remaining pits, NaN, and the mean depth of "
        "what was filled.\n\n"
        + table(
            ["m, n", "step / explicit limit", "largest deviation from the law, %", "pits",
             "pits (noise)", "NaN (noise)", "filled (noise), m"],
            rows,
        )
        + "\n" + page.save(figure, "slope_area")
    )  # fmt: skip


def pits(height: NDArray, outlets: NDArray) -> int:
    """Samples with no lower neighbor that are no outlets."""
    padded = np.pad(height, 1, constant_values=np.inf)
    ny, nx = height.shape
    lower = np.zeros(height.shape, bool)
    for a in range(3):
        for b in range(3):
            lower |= padded[a : a + ny, b : b + nx] < height
    return int((~lower & ~outlets).sum())


def slides(page: Page) -> str:
    """Thermal erosion over six decades of drops."""
    grid = Grid((199.0, 199.0), (200, 200))
    rng = np.random.default_rng(4).random(grid.shape)
    slope = np.tan(np.deg2rad(33.0))
    x = grid.x()[None, :] + np.zeros(grid.shape)
    rows = []
    for drop in (1.0, 1e6) if page.fast else (1.0, 10.0, 100.0, 1e3, 1e4, 1e6):
        cliff = np.where(x < 0.0, drop, 0.0)
        out, report = Thermal(33.0).apply(grid, cliff)
        ramp = np.clip(0.5 * drop - slope * x, 0.0, drop)
        noisy, noise_report = Thermal(33.0).apply(grid, drop * rng)
        seconds = page.timed(lambda d=drop: Thermal(33.0).apply(grid, d * rng), 1)
        rows.append([
            f"{drop:g}", f"{np.abs(out - ramp).max():.2e}", f"{report['slope_max_deg']:.2f}",
            f"{abs(out.mean() - cliff.mean()) / cliff.mean():.1e}",
            f"{noise_report['slope_max_before_deg']:.2f}", f"{noise_report['slope_max_deg']:.2f}",
            f"{100 * noise_report['steep_fraction_left']:.3f}",
            f"{abs(noisy.mean() - drop * rng.mean()) / (drop * rng.mean()):.1e}", f"{seconds:.2f}",
        ])  # fmt: skip
    return (
        "## Thermal erosion: slides to the angle of repose\n\n"
        "200², 33°, spacing 1 m. A cliff must become a straight ramp about its middle; the "
        "largest difference is at the ramp's two ends, within a sample. White noise is the other "
        "extreme. The mean is kept. The table counts what the iteration leaves too steep (by "
        "more than 2 %).\n\n"
        + table(
            ["drop, m", "cliff: off the ramp, m", "steepest, °", "drift of the mean",
             "noise: steepest before, °", "after, °", "too steep, %", "drift of the mean", "s"],
            rows,
        )
    )  # fmt: skip
