"""For docs/relief.md: diffusion, rivers, slides, extents and horizons, and what each errs."""

from __future__ import annotations

import time
from dataclasses import replace

import matplotlib.pyplot as plt
import numpy as np
from numpy.typing import NDArray

from scenec.compiler.build import BuildLog, build, build_to
from scenec.compiler.cfg.load import load
from scenec.compiler.draw import draw
from scenec.compiler.mesh.build import build_land
from scenec.compiler.terrain.grid import Grid
from scenec.compiler.terrain.operators.drainage import SIDES, drain, drainage_area, outlet_samples
from scenec.compiler.terrain.operators.smooth import Smooth
from scenec.compiler.terrain.operators.stream_power import StreamPower
from scenec.compiler.terrain.operators.thermal import Thermal
from scenec.compiler.views.resolution import pixels_of_balls, views_of
from scenec.lab.runner import Page
from scenec.testing.small import small_cfg, write_cfg


def _diffused(height: NDArray, spacing: float, strength: float) -> NDArray:
    """One step of kappa * dt, square meters."""
    ny, nx = height.shape
    grid = Grid(((nx - 1) * spacing, (ny - 1) * spacing), height.shape)
    return Smooth(float(np.sqrt(2.0 * strength))).apply(grid, height)[0]


def diffusion(page: Page) -> None:
    """Takes one exact step over twelve decades: range kept, mean kept, seconds."""
    n = 64 if page.fast else 256
    grid = Grid((n - 1.0, n - 1.0), (n, n))
    rng = np.random.default_rng(1)
    fields = [
        np.where(rng.random(grid.shape) < 0.05, 100.0, rng.normal(size=grid.shape)),
        np.where(grid.x() > 0.0, 1e6, 0.0)[None, :] + np.zeros(grid.shape),
        np.full(grid.shape, 1234.5),
    ]
    rows = []
    for exponent in range(-6, 7):
        cells = [f"1e{exponent}"]
        for height in fields:
            out = _diffused(height, 1.0, 10.0**exponent)
            drift = abs(out.mean() - height.mean()) / max(abs(height.mean()), 1e-300)
            over = max(out.max() - height.max(), height.min() - out.min(), 0.0)
            cells += [f"{drift:.1e}", f"{over / (float(np.ptp(height)) or 1.0):.1e}"]
        seconds = page.timed(lambda k=10.0**exponent: _diffused(fields[0], 1.0, k))
        rows.append([*cells, f"{seconds:.4f}"])
    page.rows(rows)


def rivers(page: Page) -> None:
    """Holds slopes against the slope-area law, at steps far beyond the explicit limit."""
    grid = Grid((4000.0, 3000.0), (61, 81))
    dx = grid.spacing_m[0]
    noise = np.random.default_rng(2).normal(size=grid.shape)
    outlets = outlet_samples(grid.shape, SIDES)
    inner = ~outlets.ravel()
    k, uplift = 1e-5, 1e-3
    largest = drainage_area(drain(noise, outlets, dx, dx), dx * dx).max()
    limit = dx / (k * np.sqrt(largest))
    rows = []
    figure, (axes, right) = plt.subplots(1, 2, figsize=(9.6, 3.6))
    numbers = (1.0, 1e4) if page.fast else (1e-2, 0.1, 1.0, 10.0, 1e2, 1e3, 1e4, 1e6)
    for m, n in ((0.5, 1.0), (0.4, 1.3)):
        operator = StreamPower(
            erodibility=k, area_exponent=m, slope_exponent=n, uplift_m_per_a=uplift,
            duration_a=1e9, steps=100,
        )  # fmt: skip
        steady, deviations = operator.apply(grid, noise)[0], []
        for number in numbers:
            run = replace(operator, duration_a=40 * number * limit, steps=40)
            out = run.apply(grid, steady)[0]
            ways = drain(out, outlets, dx, dx)
            area = drainage_area(ways, dx * dx)[inner]
            slope = (out.ravel() - out.ravel()[ways.receiver])[inner] / ways.distance[inner]
            law = (uplift / (k * area**m)) ** (1.0 / n)
            deviations.append(100 * np.abs(slope / law - 1).max())
            wild, report = replace(run, uplift_m_per_a=0.0, steps=3, duration_a=3 * number * limit
                                   ).apply(grid, 50.0 * noise)  # fmt: skip
            rows.append([
                f"{m:g}, {n:g}", f"{number:g}", f"{deviations[-1]:.1e}",
                str(_pits(out, outlets)), str(_pits(wild, outlets)),
                "none" if np.isfinite(wild).all() else "some",
                f"{report['filled_m3'] / (4000 * 3000):.3g}",
            ])  # fmt: skip
        axes.loglog(area, slope, ".", markersize=3, label=f"m = {m:g}, n = {n:g}")
        order = np.argsort(area, kind="stable")
        axes.loglog(area[order], law[order], "k-", linewidth=0.8)
        right.loglog(numbers, deviations, "o-", label=f"m = {m:g}, n = {n:g}")
    axes.set(xlabel="drainage area, m²", ylabel="slope", title="Steady state and the law (lines)")
    right.axhline(1.0, color="k", linestyle="--", linewidth=0.8, label="asked: 1 %")
    right.set(xlabel="step / explicit limit", ylabel="%", title="Largest deviation from the law",
              ylim=(1e-15, 10))  # fmt: skip
    for each in (axes, right):
        each.grid(alpha=0.3)
        each.legend(fontsize=8)
    page.save(figure, "slope_area")
    page.rows(rows)


def _pits(height: NDArray, outlets: NDArray) -> int:
    """Counts samples with no lower neighbor that are no outlets."""
    padded = np.pad(height, 1, constant_values=np.inf)
    ny, nx = height.shape
    lower = np.zeros(height.shape, bool)
    for a in range(3):
        for b in range(3):
            lower |= padded[a : a + ny, b : b + nx] < height
    return int((~lower & ~outlets).sum())


def slides(page: Page) -> None:
    """Lets cliffs and noise slide over six decades of drops."""
    grid = Grid((199.0, 199.0), (200, 200))
    rng = np.random.default_rng(4).random(grid.shape)
    x = grid.x()[None, :] + np.zeros(grid.shape)
    rows = []
    for drop in (1.0, 1e6) if page.fast else (1.0, 10.0, 100.0, 1e3, 1e4, 1e6):
        cliff = np.where(x < 0.0, drop, 0.0)
        out, report = Thermal(33.0).apply(grid, cliff)
        ramp = np.clip(0.5 * drop - np.tan(np.deg2rad(33.0)) * x, 0.0, drop)
        noisy, of_noise = Thermal(33.0).apply(grid, drop * rng)
        seconds = page.timed(lambda d=drop: Thermal(33.0).apply(grid, d * rng), 1)
        rows.append([
            f"{drop:g}", f"{np.abs(out - ramp).max():.2e}", f"{report['slope_max_deg']:.2f}",
            f"{abs(out.mean() - cliff.mean()) / cliff.mean():.1e}",
            f"{of_noise['slope_max_before_deg']:.2f}", f"{of_noise['slope_max_deg']:.2f}",
            f"{100 * of_noise['steep_fraction_left']:.3f}",
            f"{abs(noisy.mean() - drop * rng.mean()) / (drop * rng.mean()):.1e}", f"{seconds:.2f}",
        ])  # fmt: skip
    page.rows(rows)


#: Land beyond the border.
_FAR = {
    "reach_m": 6000, "spacing_m": 30, "material": "sand",
    "relief": [
        {"type": "plane"},
        {"type": "multifractal", "variant": "fbm", "amplitude_m": 9, "scale_m": 420, "gain": 0.42},
        {"type": "multifractal", "variant": "ridged", "amplitude_m": 300, "scale_m": 2500,
         "octaves": 9,
         "mask": [{"type": "point", "x_m": 0, "y_m": 0, "min_m": 1500, "softness_m": 2500}]},
    ],
}  # fmt: skip


def horizon(page: Page) -> None:
    """Errors of the mesh, in pixels of what is seen, by tolerance."""
    cfg = small_cfg()
    cfg["terrain"]["horizon"] = _FAR
    for sensor in cfg["rigs"]["rover"]["sensors"].values():
        sensor |= {"resolution": [640, 480], "fov_deg": 60}
    plan = draw(load(write_cfg(page.scratch, cfg)), 1, 0)
    land = build_to(build_land, plan)["land"]
    rows = []
    for tolerance in (0.25, 0.5, 1.0, 2.0):
        meshing = replace(plan.terrain.meshing, tolerance_px=tolerance)
        asked = replace(plan, terrain=replace(plan.terrain, meshing=meshing))
        without = replace(asked, terrain=replace(asked.terrain, horizon=None))
        seconds = []
        for one in (without, asked):
            begun = time.process_time()
            scene = build(one, BuildLog())
            seconds.append(time.process_time() - begun)
        assert scene.ground.horizon is not None
        tile = scene.ground.horizon.tile
        shares = np.random.default_rng(1).dirichlet([1, 1, 1], (len(tile.faces), 16))
        corners = tile.points.astype(float)[tile.faces]
        at = (shares[..., None] * corners[:, None]).sum(axis=2).reshape(-1, 3)
        # Within a cell of the border its roughness fades out, which the land does not have.
        at = at[land.distance_m(at[:, 0], at[:, 1]) > 1.0]
        error = np.abs(land.height_at(*np.ascontiguousarray(at[:, :2].T)) - at[:, 2])
        pixels = error * pixels_of_balls(views_of(scene.rigs), at, np.zeros(len(at)), 0.0, 1.0)
        seen = pixels[pixels > 0.0]
        share = (float(v) for v in np.percentile(seen, [50.0, 99.0, 99.9]))
        rows.append((tolerance, len(tile.faces), len(seen), *share, float(seen.max()),
                     seconds[1] - seconds[0]))  # fmt: skip
    page.rows(rows)
