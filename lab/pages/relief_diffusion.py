"""For docs/relief.md: diffusion over twelve decades, beside the schemes that were not taken."""

from __future__ import annotations

from collections.abc import Callable

import matplotlib.pyplot as plt
import numpy as np
import scipy.fft
from numpy.typing import NDArray

from scenec.compiler.terrain.grid import Grid
from scenec.compiler.terrain.operators.smooth import Smooth, laplacian_eigenvalues
from scenec.lab.runner import Page, table

#: One step of a scheme: heights and spacing and kappa * dt to heights.
Step = Callable[[NDArray, float, float], NDArray]


def ours(height: NDArray, spacing: float, strength: float) -> NDArray:
    """The compiler's step."""
    ny, nx = height.shape
    grid = Grid(((nx - 1) * spacing, (ny - 1) * spacing), height.shape)
    return Smooth(float(np.sqrt(2.0 * strength))).apply(grid, height)[0]


def _spectral(height: NDArray, spacing: float, factor: Callable[[NDArray], NDArray]) -> NDArray:
    """Modes of the DCT-II times a function of the discrete eigenvalues."""
    a, b = (laplacian_eigenvalues(n, spacing) for n in height.shape)
    return scipy.fft.idctn(scipy.fft.dctn(height) * factor(a[:, None] + b[None, :]))


def crank_nicolson(height: NDArray, spacing: float, strength: float) -> NDArray:
    """One step of the trapezoidal rule."""
    return _spectral(
        height, spacing, lambda e: (1.0 - 0.5 * strength * e) / (1.0 + 0.5 * strength * e)
    )


def backward_euler(height: NDArray, spacing: float, strength: float) -> NDArray:
    """One implicit step of first order."""
    return _spectral(height, spacing, lambda e: 1.0 / (1.0 + strength * e))


def continuous(height: NDArray, spacing: float, strength: float) -> NDArray:
    """Decay by the eigenvalues of the continuous Laplacian: the Gaussian of signal processing."""
    squares = [np.square(np.pi * np.arange(n) / (n * spacing)) for n in height.shape]
    decay = np.exp(-strength * (squares[0][:, None] + squares[1][None, :]))
    return scipy.fft.idctn(scipy.fft.dctn(height) * decay)


def euler(height: NDArray, spacing: float, strength: float) -> NDArray:
    """One explicit step."""
    padded = np.pad(height, 1, mode="edge")
    around = padded[:-2, 1:-1] + padded[2:, 1:-1] + padded[1:-1, :-2] + padded[1:-1, 2:]
    return height + strength / (spacing * spacing) * (around - 4.0 * height)


SCHEMES: dict[str, Step] = {
    "ours: exact, discrete eigenvalues": ours,
    "backward Euler": backward_euler,
    "Crank-Nicolson": crank_nicolson,
    "continuous eigenvalues": continuous,
    "explicit Euler": euler,
}


def overshoot(before: NDArray, after: NDArray) -> float:
    """How far heights leave the range they had, over that range."""
    span = float(np.ptp(before)) or 1.0
    return float(max(after.max() - before.max(), before.min() - after.min(), 0.0)) / span


def steps(page: Page) -> str:
    """One exact step over twelve decades: range kept, mean kept, seconds."""
    n = 64 if page.fast else 256
    grid = Grid((n - 1.0, n - 1.0), (n, n))
    rng = np.random.default_rng(1)
    fields = {
        "spikes": np.where(rng.random(grid.shape) < 0.05, 100.0, rng.normal(size=grid.shape)),
        "a cliff": np.where(grid.x() > 0.0, 1e6, 0.0)[None, :] + np.zeros(grid.shape),
        "constant": np.full(grid.shape, 1234.5),
    }
    rows = []
    one = page.timed(lambda: euler(fields["spikes"], 1.0, 0.2))
    for exponent in range(-6, 7):
        number = 10.0**exponent
        cells = [f"1e{exponent}"]
        for height in fields.values():
            out = ours(height, 1.0, number)
            drift = abs(out.mean() - height.mean()) / max(abs(height.mean()), 1e-300)
            cells += [f"{drift:.1e}", f"{overshoot(height, out):.1e}"]
        seconds = page.timed(lambda k=number: ours(fields["spikes"], 1.0, k))
        count = max(1, int(np.ceil(number / 0.2)))
        rows.append([*cells, f"{seconds:.4f}", f"{count:,}", f"{one * count:.3g}"])
    return (
        "## Diffusion: any step, no new extrema, the mean kept\n\n"
        "`smooth` and `diffusion` are one exact step of the "
        f"semi-discrete equation (DCT-II with the discrete eigenvalues). {n}², κΔt/Δx² from 1e-6 "
        "to 1e6; Explicit Euler is unstable above 1/4, so it needs many steps (its time is that "
        "of one step times their number). The columns show the relative drift of the mean and "
        "the overshoot over the range of heights; 2.2e-16 is the last bit. With a mask an "
        "operator blends the heights before and after and conserves nothing; its report says so "
        "(`mask_conserves`).\n\n"
        + table(
            [
                "κΔt/Δx²", "spikes: drift", "overshoot", "cliff of 10⁶ m: drift", "overshoot",
                "constant: drift", "overshoot", "seconds", "Euler's steps", "Euler, s",
            ],
            rows,
        )
    )  # fmt: skip


def schemes(page: Page) -> str:
    """The same step by other schemes: what each adds, and what it leaves of a checkerboard."""
    n = 64
    rng = np.random.default_rng(1)
    spike = np.where(rng.random((n, n)) < 0.05, 100.0, rng.normal(size=(n, n)))
    cosine = np.cos(np.pi * (n - 1) * (np.arange(n) + 0.5) / n)
    finest = cosine[:, None] * cosine[None, :]
    numbers = np.geomspace(1e-6, 1e6, 13 if page.fast else 49)
    rows = []
    figure, (left, right) = plt.subplots(1, 2, figsize=(9.6, 3.6))
    # A marker each: below the axis' foot all are one line.
    for (name, scheme), mark in zip(SCHEMES.items(), "o^sv.", strict=True):
        over = [overshoot(spike, scheme(spike, 1.0, k)) for k in numbers]
        kept = [np.abs(scheme(finest, 1.0, k)).max() / np.abs(finest).max() for k in numbers]
        style = {"marker": mark, "markersize": 3.5, "markevery": 4, "label": name}
        if scheme is ours:
            style |= {"linewidth": 2.5, "zorder": 3, "color": "k"}
        left.loglog(numbers, np.maximum(over, 1e-17), **style)
        right.loglog(numbers, np.clip(kept, 1e-17, None), **style)
        cells = [name]
        for number in (1e-2, 0.5, 1e2, 1e6):
            out = scheme(spike, 1.0, number)
            drift = abs(out.mean() - spike.mean()) / abs(spike.mean())
            mode = np.abs(scheme(finest, 1.0, number)).max() / np.abs(finest).max()
            cells.append(f"{overshoot(spike, out):.0e}, {drift:.0e}, {mode:.0e}")
        rows.append(cells)
    left.set(title="New extrema: overshoot / range", xlabel="κΔt/Δx²", ylim=(1e-18, 1e8))
    right.set(title="What is left of the finest mode", xlabel="κΔt/Δx²", ylim=(1e-18, 1e8))
    for axes in (left, right):
        axes.grid(alpha=0.3)
    left.legend(fontsize=7, loc="upper left")
    return (
        "### Beside other schemes\n\n"
        "One step of each on the spikes (64²). The cells hold the overshoot over the range of "
        "heights, the relative drift of the mean, and the remaining share of the finest mode (1 "
        "is undamped). Crank-Nicolson does not damp the finest mode at large steps. Continuous "
        "eigenvalues overshoot at small steps. Backward Euler makes no new extrema, but has an "
        "error of first order in time.\n\n"
        + table(["scheme", *(f"κΔt/Δx² = {k}" for k in ("0.01", "0.5", "100", "10⁶"))], rows)
        + "\n" + page.save(figure, "schemes")
    )  # fmt: skip


def convergence(page: Page) -> str:
    """Second order in the spacing, and error against run time beside explicit Euler."""
    modes, duration = (3, 2), 0.0032
    rows, own, theirs = [], [], []
    others = {name: SCHEMES[name] for name in ("backward Euler", "Crank-Nicolson")}
    previous = None
    for n in (16, 32, 64) if page.fast else (16, 32, 64, 128, 256, 512, 1024):
        spacing = 1.0 / n
        at = (np.arange(n) + 0.5) / n
        height = np.cos(np.pi * modes[0] * at)[None, :] * np.cos(np.pi * modes[1] * at)[:, None]
        exact = height * np.exp(-duration * np.pi**2 * (modes[0] ** 2 + modes[1] ** 2))

        def error(scheme: Step, h: NDArray = height, s: float = spacing, e: NDArray = exact) -> str:
            return f"{np.abs(scheme(h, s, duration) - e).max():.1e}"

        worst = float(np.abs(ours(height, spacing, duration) - exact).max())
        seconds = page.timed(lambda h=height, s=spacing: ours(h, s, duration))
        own.append((seconds, worst))
        order = "" if previous is None else f"{np.log2(previous / worst):.3f}"
        previous = worst
        count = int(np.ceil(duration / (0.2 * spacing * spacing)))
        cells = [f"{n}²", f"{worst:.2e}", order, f"{seconds:.4f}", *map(error, others.values()),
                 error(continuous), f"{count:,}", "", ""]  # fmt: skip
        if n <= 256:

            def march(h: NDArray = height, s: float = spacing, c: int = count) -> NDArray:
                for _ in range(c):
                    h = euler(h, s, duration / c)
                return h

            slow = page.timed(march, 1)
            theirs.append((slow, float(np.abs(march() - exact).max())))
            cells[-2:] = [f"{theirs[-1][1]:.2e}", f"{slow:.3f}"]
        rows.append(cells)
    figure, axes = plt.subplots(figsize=(5.2, 3.4))
    for points, name in ((own, "one exact step (DCT)"), (theirs, "explicit Euler")):
        axes.loglog(*zip(*points, strict=True), "o-", label=name)
    axes.set(xlabel="run time, s", ylabel="largest error", title="Decay of a cosine mode")
    axes.grid(alpha=0.3)
    axes.legend()
    return (
        "### Against the analytic decay of a cosine mode\n\n"
        "cos 3πx · cos 2πy on the unit square, until it has fallen to two thirds. The table shows "
        "the largest error against continuous diffusion; each scheme takes one step, except "
        "explicit Euler. Ours converges with order 2 in space. A single implicit step keeps its "
        "error in time. Continuous eigenvalues are exact here, where nothing is sharp, and "
        "overshoot elsewhere.\n\n"
        + table(
            ["grid", "error", "order", "seconds", *others, "continuous eigenvalues",
             "Euler's steps", "Euler's error", "Euler, s"],
            rows,
        )
        + "\n" + page.save(figure, "diffusion")
    )  # fmt: skip
