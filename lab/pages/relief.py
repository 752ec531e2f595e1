"""Makes what docs/relief.md shows: the look of relief operators, and how sound they are.

    python lab/pages/relief.py [--fast] [-o FOLDER]

Needs the extra "demo" (matplotlib), and for the table of seconds pyfastnoiselite and
fastscapelib, which may be missing (their rows say how many times our seconds they take). Times are
best readings on the machine that runs it; everything else is a fact of the code.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw

from scenec.compiler.build import BuildLog, build, build_to
from scenec.compiler.cfg.load import load
from scenec.compiler.distributions.numbers import Distribution
from scenec.compiler.distributions.streams import Streams
from scenec.compiler.draw import draw
from scenec.compiler.kinds.context import Context
from scenec.compiler.kinds.draw import draw_kind
from scenec.compiler.mesh.build import build_land
from scenec.compiler.terrain.condition import FromPoint, Interval
from scenec.compiler.terrain.detail import Detail
from scenec.compiler.terrain.grid import Grid, HeightField
from scenec.compiler.terrain.mask import Masked
from scenec.compiler.terrain.operators.crater_profile import profile_table
from scenec.compiler.terrain.operators.crust import Crust
from scenec.compiler.terrain.operators.dunes import Dunes, Ripples
from scenec.compiler.terrain.operators.footprints import Footprints, Walks
from scenec.compiler.terrain.operators.polygons import Polygons
from scenec.compiler.terrain.operators.smooth import Smooth
from scenec.compiler.terrain.operators.stream_power import StreamPower
from scenec.compiler.terrain.operators.terraces import Terraces
from scenec.compiler.terrain.operators.thermal import Thermal
from scenec.compiler.terrain.operators.tracks import Tracks
from scenec.compiler.terrain.operators.worley import Worley
from scenec.compiler.views.resolution import pixels_of_balls, views_of
from scenec.lab.benchmarks.cfgs import fbm
from scenec.lab.runner import Cell, Page, run, times
from scenec.testing.small import small_cfg, write_cfg

#: The equilibrium of small lunar craters, N(>D) = 0.0218 * 1.54 / D^2 a square meter.
CRATERS = {
    "type": "craters", "density_per_m2": 0.0218 * 1.54, "reference_diameter_m": 1.0,
    "exponent": 2.0, "rim_ratio": 0.04, "degradation": 0.4,
}  # fmt: skip


def made(operator: Any, grid: Grid, height: NDArray | float = 0.0) -> NDArray:
    """Heights after an operator."""
    found: NDArray = operator.apply(grid, height + np.zeros(grid.shape))[0]
    return found


def drawn(path: str, grid: Grid, seed: int = 4, **keys: Any) -> Any:
    """An operator whose forms are drawn."""
    return draw_kind("relief", keys, path, Context(Streams(seed, 0), grid.size_m))


def track(page: Page, x: NDArray, y: NDArray, **keys: Any) -> Tracks:
    """A rover's tracks along a path."""
    path = page.scratch / "path.csv"
    np.savetxt(path, np.stack([x, y], axis=1), delimiter=",", header="x_m,y_m", comments="")
    return Tracks(file=path, pattern="chevrons", **keys)


def gallery(page: Page) -> None:
    """Draws a sheet of hillshades, one an operator."""
    n = 301
    grid, small, six, close, wide, large = (
        Grid((size, size), (n, n)) for size in (200.0, 12.0, 6.0, 2.0, 60.0, 6000.0)
    )
    base = made(fbm(11, 1.2, 60.0), grid)
    hills = made(fbm(12, 28.0, 130.0, gain=0.42, variant="ridged", offset=0.9), grid)
    ground, grain = made(fbm(5, 0.12, 5.0), small), made(fbm(5, 0.4, 20.0), wide)
    pits = CRATERS | {"min_diameter_m": 2.0, "max_diameter_m": 90.0, "depth_ratio": 0.16,
                      "irregularity": 0.1}  # fmt: skip
    few = {"degradation": 0.1, "density_per_m2": 0.2}
    young = {"max_diameter_m": 25.0, "density_per_m2": 0.01, "degradation": 0.05}
    mare = made(drawn("old", grid, **pits), grid, made(fbm(21, 2.0, 120.0, 4, gain=0.45), grid))
    mare = made(drawn("young", grid, **pits | young), grid, made(Smooth(1.0), grid, mare))
    heaps = drawn(
        "b", grid, type="barchans", count=9, wind_deg=15.0, repose_deg=33.0,
        height_m=Distribution("log_uniform", "instance", False, 1.0, 4.0),
    )  # fmt: skip
    x = np.linspace(-7, 7, 60)
    rover = track(page, x, 1.5 * np.sin(x / 2), depth_m=0.05, grouser_spacing_m=0.18,
                  grouser_depth_m=0.02)  # fmt: skip
    rivers = StreamPower(
        erodibility=2e-5, diffusivity_m2_per_a=0.02, uplift_m_per_a=5e-4, duration_a=6e5, steps=300
    )
    lumps = Worley(key=3, amplitude_m=5.0, scale_m=30.0, octaves=2, lacunarity=2.2, gain=0.4)
    cracks = Worley(key=3, amplitude_m=2.0, scale_m=16.0, distance="f2-f1", jitter=0.8)
    ice = Polygons(key=3, scale_m=6.0, depth_m=0.3, width_m=1.0, shoulder_m=0.06, irregularity=0.6)
    ledges = Terraces(
        key=4, step_m=5.0, tread_slope=0.15, irregularity=0.8, bend_m=1.5, bend_scale_m=60.0
    )
    sand = Dunes(key=8, height_m=2.2, wavelength_m=24.0, wind_deg=15.0, repose_deg=33.0, order=0.25)
    waves = Ripples(
        key=8, height_m=0.018, wavelength_m=0.24, wind_deg=15.0, repose_deg=28.0, order=0.35
    )
    boots = Walks().draw(Context(Streams(4, 0), close.size_m, path="f"))
    disk = Interval(FromPoint(x_m=0.0, y_m=0.0), None, 20.0, 6.0)

    def fractal(variant: str, offset: float, amplitude: float, **more: float) -> NDArray:
        return made(fbm(7, amplitude, 90.0, 9, variant=variant, offset=offset, **more), grid)

    panels: list[tuple[str, NDArray, Grid]] = [
        ("multifractal fbm", fractal("fbm", 0.7, 9.0), grid),
        ("hetero", fractal("hetero", 0.2, 16.0), grid),
        ("hybrid", fractal("hybrid", 0.6, 10.0, gain=0.9), grid),
        ("ridged", fractal("ridged", 0.9, 10.0), grid),
        ("billow", fractal("billow", 0.7, 6.0), grid),
        ("fbm, warped", fractal("fbm", 0.7, 7.0, distortion=0.5), grid),
        ("worley f1", made(lumps, grid, base), grid),
        ("worley f2-f1", made(cracks, grid, base), grid),
        ("polygons", made(ice, wide, 0.4 * grain), wide),
        ("craters in equilibrium", made(drawn("c", grid, **pits), grid, base), grid),
        ("stream power, uplift, creep",
         made(rivers, large, made(fbm(9, 250.0, 4e3), large)), large),
        ("ridged, steep", hills, grid),
        ("thermal: it slid to 33°", made(Thermal(33.0), grid, hills), grid),
        ("terraces", made(ledges, grid, hills), grid),
        ("dunes", made(sand, grid, 0.3 * base), grid),
        ("barchans", made(heaps, grid, 0.2 * base), grid),
        ("ripples", made(waves, six), six),
        ("diffusion of ridged", made(Smooth(4.0), grid, hills), grid),
        ("tracks", made(rover, small, ground), small),
        ("footprints", made(boots, close, 0.2 * ground), close),
        ("crust", made(Crust(key=3, height_m=0.1, plate_m=1.5), six, 0.3 * ground), six),
        ("masked: craters in a disk",
         made(Masked(drawn("m", wide, **pits | few), (disk,)), wide, grain), wide),
        ("mare: craters, worn, and grain",
         made(fbm(22, 0.25, 8.0, 6, gain=0.55), grid, mare), grid),
    ]  # fmt: skip
    columns = 4
    sheet = Image.new("L", (columns * (n + 6) - 6, -(-len(panels) // columns) * (n + 24)), 255)
    draw = ImageDraw.Draw(sheet)
    for k, (name, height, own) in enumerate(panels):
        left, top = (k % columns) * (n + 6), (k // columns) * (n + 24)
        sheet.paste(shaded(height, own.spacing_m[0]), (left, top + 18))
        draw.text((left + 2, top + 3), f"{name}, {own.size_m[0]:g} m", fill=0)
    sheet.save(page.picture("gallery"), optimize=True)


def shaded(height: NDArray, spacing: float) -> Image.Image:
    """Hillshade: Lambert's cosine under a sun in the north-west, 30 degrees high; north up."""
    gy, gx = np.gradient(height, spacing)
    a, e = np.deg2rad((315.0, 30.0))
    toward = (np.sin(a) * np.cos(e), np.cos(a) * np.cos(e), np.sin(e))
    cosine = (-gx * toward[0] - gy * toward[1] + toward[2]) / np.sqrt(1.0 + gx * gx + gy * gy)
    gray = np.clip(0.55 * cosine / np.sin(e), 0.0, 1.0) ** 0.7
    # Few levels, for small files.
    return Image.fromarray((np.round(gray * 48.0) * (255.0 / 48.0)).astype(np.uint8)[::-1])


def prints(page: Page) -> None:
    """Draws footprints and crust; tables their error against the spacing of a mesh's vertices."""
    crust = Crust(key=3, height_m=0.02, plate_m=0.3, missing=0.25).everywhere()
    one = Footprints(np.array([[0.0, 0.0, 1.0, 0.0, 1.0]]), 0.33, 0.025, 0.006, (1.0, 1.0))
    n, rough = 480, fbm(5, 0.06, 2.0, 9)
    walk = Walks().draw(Context(Streams(2, 0), (6.0, 6.0), path="page")).everywhere()
    sheet = Image.new("L", (3 * n + 12, n), 255)
    for k, (detail, size, share) in enumerate(
        ((walk, 4.0, 1.0), (walk, 1.2, 0.3), (crust, 5, 0.5))
    ):
        grid = Grid((size, size), (n, n))
        own = detail.at(*grid.points())  # type: ignore[attr-defined]
        height = share * made(rough, grid) + own.reshape(grid.shape)
        sheet.paste(shaded(height, grid.spacing_m[0]), (k * (n + 6), 0))
    sheet.save(page.picture("prints"), optimize=True)
    rows = []
    for spacing in (0.003, 0.007, 0.01, 0.02, 0.04, 0.08):
        row = [f"{1e3 * spacing:g}"]
        for detail, size, places in ((one.everywhere(), 0.8, 40), (crust, 4.0, 4)):
            height_m, volume = _vertex_errors(detail, size, spacing, 1 if page.fast else places)
            row += [f"{1e3 * height_m:.2f}", f"{100 * volume:.2g}"]
        rows.append(row)
    page.rows(rows)
    walks = Walks(walks=3).draw(Context(Streams(1, 0), (80.0, 80.0), path="page")).everywhere()
    x, y = np.random.default_rng(1).uniform(-40.0, 40.0, (2, 1 << (14 if page.fast else 20)))
    for name, detail in (("walks", walks), ("crust", crust)):
        page.value(name, f"{1e9 * min(times(partial(detail.at, x, y)).cpu) / x.size:.0f} ns")


def _vertex_errors(
    detail: Detail, size_m: float, spacing_m: float, places: int
) -> tuple[float, float]:
    """Errors of heights between vertices, meters, and of their sum, as a share of it: rms."""
    grid = Grid.with_spacing((size_m, size_m), spacing_m)
    fine = np.linspace(-0.45, 0.45, 801) * size_m
    x, y = (a.ravel() for a in np.meshgrid(fine, fine))
    true = detail.at(x, y)
    heights, volumes = [], []
    for moved in np.random.default_rng(2).uniform(-0.5, 0.5, (places, 2)) * spacing_m:
        at = [np.ascontiguousarray(a + m) for a, m in zip(grid.points(), moved, strict=True)]
        field = HeightField(grid, detail.at(*at).reshape(grid.shape))
        off = field.height_at(x - moved[0], y - moved[1]) - true
        heights.append((off * off).sum() / np.count_nonzero(true))
        volumes.append((off.sum() / true.sum()) ** 2)
    return float(np.sqrt(np.mean(heights))), float(np.sqrt(np.mean(volumes)))


def craters(page: Page) -> None:
    """Draws sizes beside their law, and worn profiles."""
    seeds, grid = 6 if page.fast else 60, Grid((200.0, 200.0), (2, 2))
    figure, (left, right) = plt.subplots(1, 2, figsize=(9.2, 3.4))
    for exponent, density in ((2.0, 0.0218 * 1.54), (3.0, 0.2)):
        law = CRATERS | {"min_diameter_m": 1.0, "max_diameter_m": 64.0, "depth_ratio": 0.2,
                         "irregularity": 0.0, "exponent": exponent,
                         "density_per_m2": density}  # fmt: skip
        diameters = []
        for seed in range(seeds):
            c = drawn("craters", grid, seed, **law)
            here = (np.abs(c.x_m) < 100.0) & (np.abs(c.y_m) < 100.0)
            diameters.append(c.diameter_m[here])
        pooled = np.sort(np.concatenate(diameters))[::-1]
        counts = np.arange(1, pooled.size + 1) / (seeds * 200.0**2)
        left.loglog(pooled, counts, ".", markersize=2, label=f"drawn, b = {exponent:g}")
        at = np.geomspace(1.0, 60.0, 50)
        left.loglog(at, density * (at**-exponent - 64.0**-exponent), "k-", linewidth=0.8)
    left.set(xlabel="diameter, m", ylabel="larger ones per m²", title="Sizes drawn, and the law")
    profile = profile_table(1.0)
    x = (np.arange(profile.rim.shape[1]) + 0.5) * profile.step
    for state in (0.0, 0.01, 0.03, 0.1, 0.3, 1.0):
        row = int(np.abs(profile.states - state).argmin())
        z = 0.04 * profile.rim[row] - 0.2 * profile.depth[row]
        right.plot(np.concatenate([-x[::-1], x]), np.concatenate([z[::-1], z]), label=f"{state:g}")
    right.set(xlabel="r / R", ylabel="height / diameter", title="Wear: κt/R²", xlim=(-3, 3))
    for axes in (left, right):
        axes.grid(alpha=0.3)
        axes.legend(fontsize=8)
    page.save(figure, "craters")


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


def fastscape(height: NDArray, exponent: float) -> Callable[[], object] | None:
    """One step of fastscapelib: sinks resolved, water routed, rivers eroded."""
    try:
        import fastscapelib
    except ImportError:
        return None
    grid = fastscapelib.RasterGrid(
        list(height.shape), [10.0, 10.0], fastscapelib.NodeStatus.FIXED_VALUE
    )
    operators = [fastscapelib.SingleFlowRouter(), fastscapelib.MSTSinkResolver()]
    graph = fastscapelib.FlowGraph(grid, operators)
    eroder = fastscapelib.SPLEroder(graph, 2e-5, 0.5, exponent, 1e-5)

    def step(_kept: object = (grid, operators)) -> object:
        graph.update_routes(height)
        return height - eroder.erode(height, graph.accumulate(1.0), 1e5)

    return step


def seconds(page: Page) -> None:
    """Times operators on big grids, beside pyfastnoiselite and fastscapelib."""
    n, runs = (256, 1) if page.fast else (2048, 5)
    m = n // 2
    grid, half = Grid((n - 1.0, n - 1.0), (n, n)), Grid((10.0 * m - 10.0,) * 2, (m, m))
    hills, valleys = made(fbm(1, 60.0, 512.0), grid), made(fbm(1, 300.0, 6e3), half)
    rows: list[list[Cell]] = []
    best = 1.0

    def row(name: str, work: Callable[[], object] | None, asked: str = "") -> None:
        nonlocal best
        if work is None:
            rows.append([name, None, "not installed"])
            return
        last, best = best, min(times(work, runs).cpu)
        rows.append([name, best, f"{best / last:.2f}" if asked == "yardstick" else asked])

    def on(operator: Any, of: Grid = grid, height: NDArray | float = 0.0) -> Callable[[], NDArray]:
        return partial(made, operator, of, height)

    row(f"fbm, {n}², 8 octaves", on(fbm(1, 1.0, 512.0, variant="fbm")), "≤ 0.3")
    row(f"pyfastnoiselite, Perlin fBm, {n}², 8 octaves", fast_noise_lite(n, 8), "yardstick")
    warped = fbm(1, 1.0, 512.0, distortion=0.5, distortion_octaves=2)
    row(f"fbm, warped by 2 octaves, {n}², 8 octaves", on(warped))
    row(f"worley, {n}²", on(Worley(key=1, amplitude_m=1.0, scale_m=64.0, distance="f1")))
    row(f"diffusion, {n}², any length", on(Smooth(30.0), grid, hills), "≤ 0.5")
    for power, asked in ((1.0, "< fastscapelib's"), (1.5, "")):
        river = StreamPower(erodibility=2e-5, slope_exponent=power, duration_a=1e5, steps=1)
        name = f"n = {power:g}, {m}², one step"
        row(f"stream power, {name}", on(river, half, valleys), asked)
        row(f"fastscapelib, {name}", fastscape(valleys, power), "yardstick")
    row(f"thermal erosion, {m}²", on(Thermal(20.0), half, 5.0 * valleys))
    pits = drawn("craters", grid, 1, **CRATERS, min_diameter_m=3.0, max_diameter_m=300.0,
                 depth_ratio=0.15, irregularity=0.08)  # fmt: skip
    row(f"{len(pits.x_m):,} craters of 3 to 300 m in equilibrium, {n}²", on(pits))
    dunes = Dunes(key=1, height_m=4.0, wavelength_m=60.0, wind_deg=20.0, repose_deg=33.0, order=0.3)
    row(f"dunes, {n}²", on(dunes))
    page.rows(rows)


def skip(page: Page) -> None:
    """Leaves a table that is not measured as it is."""
    page.rows(None)


def main(page: Page) -> None:
    """Refreshes the page."""
    page.refresh(("numpy", "numba", "scipy"), [
        gallery, skip, prints, skip, craters, horizon, seconds,
    ])  # fmt: skip


if __name__ == "__main__":
    run(main, page="relief")
