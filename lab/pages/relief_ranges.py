"""For docs/relief.md: noise, extents, origins and DEMs at the ends of their ranges."""

from __future__ import annotations

import json
import time
from dataclasses import replace
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from numpy.typing import NDArray

from scenec.backends.camera.rays import camera_rays
from scenec.backends.run.session import Session
from scenec.compiler.cfg.load import load
from scenec.compiler.compile import compile_cfg
from scenec.compiler.draw import draw
from scenec.compiler.terrain.grid import Grid
from scenec.compiler.terrain.operators.multifractal import Multifractal
from scenec.compiler.terrain.operators.worley import Worley
from scenec.compiler.terrain.program import run
from scenec.compiler.terrain.sources.dem import Dem
from scenec.compiler.terrain.sources.fill_holes import fill_holes
from scenec.lab.runner import Page, table
from scenec.testing.small import scaled, small_cfg, write_cfg

PASSES = ("depth", "range", "label", "instance", "face", "normal", "position")


#: All noises there are.
NOISES = ("fbm", "hetero", "hybrid", "ridged", "billow", "f1", "f2-f1")


def _noise(
    grid: Grid, variant: str, octaves: int, lacunarity: float, gain: float, amplitude: float
) -> NDArray:
    scale = grid.size_m[0] / 3.0
    if variant in ("f1", "f2-f1"):
        worley = Worley(
            key=3,
            amplitude_m=amplitude,
            scale_m=scale,
            distance=variant,
            octaves=octaves,
            lacunarity=lacunarity,
            gain=gain,
        )
        return worley.apply(grid, np.zeros(grid.shape))[0]
    fractal = Multifractal(
        key=3,
        amplitude_m=amplitude,
        scale_m=scale,
        octaves=octaves,
        lacunarity=lacunarity,
        gain=gain,
        variant=variant,
        offset=0.7,
        distortion=0.5,
    )
    return fractal.apply(grid, np.zeros(grid.shape))[0]


def noises(page: Page) -> str:
    """All noises at the ends of their parameters' ranges."""
    rows = []
    for variant in NOISES:
        worst, finite, zero, count = 0.0, True, True, 0
        for size in (1e-3, 1.0, 1e3, 1e6):
            grid = Grid.with_spacing((size, size), size / 24)
            for octaves in (0, 24) if page.fast else (0, 1, 8, 24):
                for lacunarity in (1.0, 2.0, 8.0):
                    for gain in (0.0, 0.5, 2.0):
                        for amplitude in (0.0, 1e6):
                            out = _noise(grid, variant, octaves, lacunarity, gain, amplitude)
                            finite &= bool(np.isfinite(out).all())
                            count += 1
                            if amplitude == 0.0 or octaves == 0:
                                zero &= not out.any()
                            else:
                                worst = max(worst, float(np.abs(out).max()) / amplitude)
        rows.append([variant, str(count), "all" if finite else "not all",
                     "all" if zero else "not all", f"{worst:.3g}"])  # fmt: skip
    return (
        "## Noise at the ends of its ranges\n\n"
        "Extents of 1 mm, 1 m, 1 km and 1,000 km; octaves 0, 1, 8, 24; lacunarity 1, 2, 8; gain 0, "
        "0.5, 2; amplitude 0 and 10⁶ m; fractals warped by half a feature. Zero amplitude or no "
        "octaves must give exactly 0.\n\n"
        + table(
            ["noise", "combinations", "finite", "exact zeros", "largest height / amplitude"], rows
        )
        + "\n"
        + _by_octaves(page)
    )


def _by_octaves(page: Page) -> str:
    """A plot of the largest height over the number of octaves."""
    grid = Grid.with_spacing((1.0, 1.0), 1.0 / 64)
    octaves = (0, 1, 8, 24) if page.fast else range(25)
    figure, plots = plt.subplots(1, 2, figsize=(9.6, 3.6))
    for axes, gain in zip(plots, (0.5, 2.0), strict=True):
        for variant in NOISES:
            # Lacunarity 1: no octave is finer than the grid, so all 24 count.
            found = [np.abs(_noise(grid, variant, k, 1.0, gain, 1.0)).max() for k in octaves]
            axes.semilogy(octaves, np.where(np.array(found) > 0.0, found, np.nan), label=variant)
        axes.set(xlabel="octaves", ylabel="largest height / amplitude", title=f"gain {gain:g}")
        axes.grid(alpha=0.3)
    plots[0].legend(fontsize=8)
    return page.save(figure, "octaves")


def _frames(batch: Path) -> dict[str, NDArray]:
    """All annotation of the first sample."""
    session = Session.open(batch / "stage.usda", "reference")
    camera = session.scene.cameras[0][0]
    return session.render(camera, 0, session.passes(PASSES, camera), 1, 1).arrays


def extents(page: Page) -> str:
    """A scene compiled and seen from a millimeter to a thousand kilometers."""
    rows, promised, made = [], [], []
    exponents = (-3, 0, 3, 6) if page.fast else tuple(range(-3, 7))
    for exponent in exponents:
        extent = 10.0**exponent
        cfg = scaled(small_cfg(samples=1), extent / 20.0)
        cfg["terrain"]["mesh"] = {"tolerance_px": 0}
        own = page.scratch / f"extent{exponent}"
        own.mkdir()
        path = write_cfg(own, cfg)
        start = time.perf_counter()
        batch = compile_cfg(path, seed=3, out=own / "out").out / "batch_0000"
        seconds = time.perf_counter() - start
        found = json.loads((batch / "report.json").read_text())["precision"]
        session = Session.open(batch / "stage.usda", "reference")
        camera = session.scene.cameras[0][0]
        frame = session.render(camera, 0, ("depth", "instance", "normal"), 1, 1).arrays
        rays = camera_rays(camera)
        ground = (np.isfinite(frame["depth"]) & (frame["instance"] == 0)).ravel()
        depth = frame["depth"].ravel()[ground]
        at = rays.origins[ground] + depth[:, None] * rays.directions[ground]
        plan = draw(load(path), 3, 0).terrain
        truth = run(plan.relief, Grid.with_spacing(plan.size_m, plan.spacing_m)).field
        x, y = (np.ascontiguousarray(at[:, k]) for k in (0, 1))
        normal = frame["normal"].reshape(-1, 3)[ground].astype(np.float64)
        along = np.abs((rays.directions[ground] * normal).sum(axis=1))
        error = np.abs(at[:, 2] - truth.height_at(x, y)) * np.abs(normal[:, 2]) / along / depth
        promised.append(found["promised_m"])
        made.append(found["float32_error_max_m"])
        rows.append([
            f"1e{exponent}", f"{found['promised_m']:.1e}", f"{found['promised_px']:.1e}",
            f"{made[-1]:.1e}", f"{found['float32_error_max_px']:.1e}",
            f"{np.isinf(frame['depth']).mean():.3f}", f"{depth.min():.1e} … {depth.max():.1e}",
            f"{error.max():.1e}", f"{seconds:.2f}",
        ])  # fmt: skip
    figure, (left, right) = plt.subplots(1, 2, figsize=(9.6, 3.6))
    sizes = 10.0 ** np.array(exponents, float)
    left.loglog(sizes, promised, "o-", label="promised: extent · 6e-8")
    left.loglog(sizes, made, "s-", label="largest error made")
    left.set(xlabel="extent, m", ylabel="m", title="Positions in float32")
    origins = np.geomspace(1.0, 1e7, 29)
    right.loglog(origins, np.spacing(origins.astype(np.float32)), label="if it entered positions")
    step = np.spacing(np.float32(50.0))
    right.loglog(origins, np.full(len(origins), step), label="as it is: recorded")
    right.set(xlabel="distance of the origin, m", ylabel="step of float32, m",
              title="What a georeference would cost, 100 m")  # fmt: skip
    for axes in (left, right):
        axes.grid(alpha=0.3)
        axes.legend(fontsize=8)
    return (
        "## Extents: from a millimeter to a thousand kilometers\n\n"
        "One scene, with every length multiplied, is compiled to a stage and annotated by "
        "`reference`. Vertices are float32 in tiles, so the promise is 6e-8 of the extent; the "
        "table has it in meters, and in pixels where the ground is largest (`compile` and "
        "`explain` print it, and `compile` warns above 0.05 pixels). Depth is compared with the "
        "relief in float64. Scaled by powers of two, all annotation is equal to the last bit "
        "(`tests/compiler/test_extents.py`).\n\n"
        + table(
            ["extent, m", "promised, m", "promised, px", "error, m", "error, px", "sky",
             "depth, m", "error of depth / depth", "compile, s"],
            rows,
        )
        + "\n" + page.save(figure, "extents")
    )  # fmt: skip


def origins(page: Page) -> str:
    """Frames of a scene on a DEM that lies at different places of a planet."""
    import rasterio

    field = np.random.default_rng(1).normal(size=(30, 40)).cumsum(axis=0).astype(np.float32)
    places = ((300.0, 500.0), (1e4, -1e4), (1e7, 1e7), (-1e7, 9_999_999.3))
    rows, first, bytes_of_first = [], None, b""
    for i, origin in enumerate(places[:: 2 if page.fast else 1]):
        own = page.scratch / f"origin{i}"
        own.mkdir()
        with rasterio.open(
            own / "dem.tif", "w", driver="GTiff", width=40, height=30, count=1, dtype="float32",
            crs="EPSG:32617", transform=rasterio.transform.from_origin(*origin, 1.0, 1.0),
        ) as file:  # fmt: skip
            file.write(field, 1)
        cfg = small_cfg(samples=1)
        cfg["terrain"]["relief"][0] = {"type": "dem", "file": "dem.tif", "height_scale": 0.3}
        batch = compile_cfg(write_cfg(own, cfg), seed=5, out=own / "out").out / "batch_0000"
        place = json.loads((batch / "report.json").read_text())["relief"][0]["georeference"]
        frame, geometry = _frames(batch), (batch / "terrain.usdc").read_bytes()
        if first is None:
            first, bytes_of_first = frame, geometry
        other = sum(int((frame[name] != first[name]).sum() - _both_nan(frame[name], first[name]))
                    for name in frame)  # fmt: skip
        rows.append([
            f"{origin[0]:,.1f}, {origin[1]:,.1f}", ", ".join(f"{c:,.1f}" for c in place["center"]),
            "the same" if geometry == bytes_of_first else "others",
            f"{other} of {sum(array.size for array in frame.values()):,}",
        ])  # fmt: skip
    return (
        "## Origins: up to 10⁷ m off\n\n"
        "A DEM's georeference is recorded on the stage and in the report, and never enters the "
        "arithmetic: noise and meshes use local coordinates. The table moves a scene on a "
        "GeoTIFF (with noise, label lines and rocks) to different places, and counts the values "
        "of "
        f"{', '.join(PASSES)} that differ from the first row's. The plot above shows the step of "
        "float32 if the georeference did enter.\n\n"
        + table(["corner of the DEM, m", "recorded center, m", "bytes of the terrain", "differ"],
                rows)
    )  # fmt: skip


def _both_nan(a: NDArray, b: NDArray) -> int:
    return int((np.isnan(a) & np.isnan(b)).sum()) if a.dtype.kind == "f" else 0


def dems(page: Page) -> str:
    """Places on a planet, holes, single rows."""
    y, x = np.mgrid[:80, :100].astype(float)
    field = 30 * np.sin(0.11 * x) * np.cos(0.07 * y) + 0.4 * x
    base = Dem(file=Path(), pixel_m=(1.0, 1.0), edge="clamp", holes="fill")
    grid = Grid.with_spacing((60.0, 50.0), 0.5)
    rows = []
    pictures = []
    inner = np.hypot(x - 50, y - 40)
    for name, holes in (("a hole of 30 pixels", inner < 15), ("a fifth at random",
                        np.random.default_rng(0).random(field.shape) < 0.2)):  # fmt: skip
        # At the DEM's border the membrane's slope is 0, and no plane's.
        holes[[0, -1]] = holes[:, [0, -1]] = False
        plane = 2.0 * x - y
        filled, error = fill_holes(np.where(holes, 0.0, plane), holes)
        rows.append([f"{name}, in a plane", f"{int(holes.sum()):,} samples",
                     f"off the plane by {np.abs(filled - plane).max():.1e} m at most, said "
                     f"{error:.1e} m"])  # fmt: skip
        samples = np.where(holes, np.nan, field)
        np.save(page.scratch / "holes.npy", samples)
        out, report = replace(base, file=page.scratch / "holes.npy").apply(
            grid, np.zeros(grid.shape)
        )
        pictures += [
            (name, samples),
            ("filled", fill_holes(np.nan_to_num(samples), holes)[0]),
        ]
        rows.append([f"{name}, in hills of ±30 m", f"{report['holes_filled']:,} under the terrain",
                     f"heights {out.min():.1f} to {out.max():.1f} m, whole field "
                     f"{field.min():.1f} to {field.max():.1f} m"])  # fmt: skip
    for name, samples in (("one row", field[:1]), ("one column", field[:, :1]),
                          ("one sample", field[:1, :1])):  # fmt: skip
        np.save(page.scratch / "thin.npy", samples)
        out, _ = replace(base, file=page.scratch / "thin.npy").apply(grid, np.zeros(grid.shape))
        across = out.std(axis=0).max() if samples.shape[0] == 1 else out.std(axis=1).max()
        rows.append([name, "", f"finite, spread across it {across:.1e} m"])
    colors = plt.get_cmap("gray").with_extremes(bad="red")
    figure, plots = plt.subplots(1, 4, figsize=(9.6, 2.4))
    for axes, (name, picture) in zip(plots, pictures, strict=True):
        axes.imshow(picture, cmap=colors, vmin=field.min(), vmax=field.max(), origin="lower")
        axes.set_title(name, fontsize=8)
        axes.set_axis_off()
    return (
        "## DEMs with holes, thin ones\n\n"
        "Holes (NaN, or the nodata value of the file or the cfg) are an error, or are filled by a "
        "membrane: Laplace's equation over the hole's pixels, so nothing rises above or falls "
        "below the rim.\n\n"
        + table(["DEM", "", ""], rows)
        + "\n" + page.save(figure, "holes")
    )  # fmt: skip
