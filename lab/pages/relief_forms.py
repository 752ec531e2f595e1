"""For docs/relief.md: what every operator looks like, and the sizes and wear of craters."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw

from scenec.compiler.distributions.numbers import Distribution
from scenec.compiler.distributions.streams import Streams
from scenec.compiler.kinds.context import Context
from scenec.compiler.kinds.draw import draw_kind
from scenec.compiler.terrain.condition import FromPoint, Interval
from scenec.compiler.terrain.grid import Grid
from scenec.compiler.terrain.mask import Masked
from scenec.compiler.terrain.operator import ReliefOperator
from scenec.compiler.terrain.operators.crater_profile import profile_table
from scenec.compiler.terrain.operators.crust import Crust
from scenec.compiler.terrain.operators.dunes import Dunes, Ripples
from scenec.compiler.terrain.operators.footprints import Walks
from scenec.compiler.terrain.operators.multifractal import Multifractal
from scenec.compiler.terrain.operators.polygons import Polygons
from scenec.compiler.terrain.operators.smooth import Smooth
from scenec.compiler.terrain.operators.stream_power import StreamPower
from scenec.compiler.terrain.operators.terraces import Terraces
from scenec.compiler.terrain.operators.thermal import Thermal
from scenec.compiler.terrain.operators.tracks import Tracks
from scenec.compiler.terrain.operators.worley import Worley
from scenec.lab.runner import Page, table


def gallery(page: Page) -> str:
    """A sheet of hillshades, one an operator."""
    size, n = 200.0, 301
    grid = Grid((size, size), (n, n))
    streams = Streams(4, 0)
    soft = Multifractal(
        key=11,
        amplitude_m=1.2,
        scale_m=60.0,
        octaves=8,
        lacunarity=2.0,
        gain=0.5,
        variant="fbm",
        offset=0.7,
    )
    rock = Multifractal(
        key=12,
        amplitude_m=28.0,
        scale_m=130.0,
        octaves=8,
        lacunarity=2.0,
        gain=0.42,
        variant="ridged",
        offset=0.9,
    )
    base = soft.apply(grid, np.zeros(grid.shape))[0]
    hills = rock.apply(grid, np.zeros(grid.shape))[0]
    pits = {
        "type": "craters",
        "min_diameter_m": 2.0, "max_diameter_m": 90.0, "density_per_m2": 0.0218 * 1.54,
        "reference_diameter_m": 1.0, "exponent": 2.0, "depth_ratio": 0.16, "rim_ratio": 0.04,
        "degradation": 0.4, "irregularity": 0.1,
    }  # fmt: skip
    heaps = {
        "type": "barchans",
        "count": 9,
        "wind_deg": 15.0,
        "repose_deg": 33.0,
        "height_m": Distribution("log_uniform", "instance", False, 1.0, 4.0),
    }
    (page.scratch / "path.csv").write_text(
        "x_m,y_m\n" + "\n".join(f"{x},{1.5 * np.sin(x / 2)}" for x in np.linspace(-7, 7, 60))
    )
    small = Grid((12.0, 12.0), (n, n))
    ground = Multifractal(
        key=5,
        amplitude_m=0.12,
        scale_m=5.0,
        octaves=8,
        lacunarity=2.0,
        gain=0.5,
        variant="fbm",
        offset=0.7,
    ).apply(small, np.zeros(small.shape))[0]
    large = Grid((6000.0, 6000.0), (n, n))
    upland = Multifractal(
        key=9,
        amplitude_m=250.0,
        scale_m=4000.0,
        octaves=8,
        lacunarity=2.0,
        gain=0.5,
        variant="fbm",
        offset=0.7,
    )
    uplands = upland.apply(large, np.zeros(large.shape))[0]
    rivers = StreamPower(
        erodibility=2e-5, diffusivity_m2_per_a=0.02, uplift_m_per_a=5e-4, duration_a=6e5, steps=300
    )
    wide = Grid((60.0, 60.0), (n, n))

    def fractal(
        variant: str, offset: float, amplitude: float, distortion: float = 0.0, gain: float = 0.5
    ) -> NDArray:
        operator = Multifractal(
            key=7,
            amplitude_m=amplitude,
            scale_m=90.0,
            octaves=9,
            lacunarity=2.0,
            gain=gain,
            variant=variant,
            offset=offset,
            distortion=distortion,
        )
        return operator.apply(grid, np.zeros(grid.shape))[0]

    def scattered(path: str, node: dict[str, Any], size_m: float = size) -> ReliefOperator:
        made: ReliefOperator = draw_kind("relief", node, path, Context(streams, (size_m, size_m)))
        return made

    six = Grid((6.0, 6.0), (n, n))
    cracks = Worley(key=3, amplitude_m=2.0, scale_m=16.0, distance="f2-f1", jitter=0.8)
    lumps = Worley(key=3, amplitude_m=5.0, scale_m=30.0, octaves=2, lacunarity=2.2, gain=0.4)
    ledges = Terraces(
        key=4, step_m=5.0, tread_slope=0.15, irregularity=0.8, bend_m=1.5, bend_scale_m=60.0
    )
    plates = Crust(key=3, height_m=0.1, plate_m=1.5)
    ice = Polygons(key=3, scale_m=6.0, depth_m=0.3, width_m=1.0, shoulder_m=0.06, irregularity=0.6)
    sand = Dunes(key=8, height_m=2.2, wavelength_m=24.0, wind_deg=15.0, repose_deg=33.0, order=0.25)
    waves = Ripples(
        key=8, height_m=0.018, wavelength_m=0.24, wind_deg=15.0, repose_deg=28.0, order=0.35
    )
    rover = Tracks(
        file=page.scratch / "path.csv",
        depth_m=0.05,
        grouser_spacing_m=0.18,
        grouser_depth_m=0.02,
        pattern="chevrons",
    )
    grain = Multifractal(
        key=5,
        amplitude_m=0.4,
        scale_m=20.0,
        octaves=8,
        lacunarity=2.0,
        gain=0.5,
        variant="fbm",
        offset=0.7,
    ).apply(wide, np.zeros(wide.shape))[0]
    fresh = scattered("m", {**pits, "degradation": 0.1, "density_per_m2": 0.2}, 60.0)
    close = Grid((2.0, 2.0), (n, n))
    boots = Walks().draw(Context(streams, close.size_m, path="f"))
    disk = Interval(FromPoint(x_m=0.0, y_m=0.0), None, 20.0, 6.0)
    panels: list[tuple[str, NDArray, Grid]] = [
        ("multifractal fbm", fractal("fbm", 0.7, 9.0), grid),
        ("hetero", fractal("hetero", 0.2, 16.0), grid),
        ("hybrid", fractal("hybrid", 0.6, 10.0, gain=0.9), grid),
        ("ridged", fractal("ridged", 0.9, 10.0), grid),
        ("billow", fractal("billow", 0.7, 6.0), grid),
        ("fbm, warped", fractal("fbm", 0.7, 7.0, 0.5), grid),
        ("worley f1", lumps.apply(grid, base)[0], grid),
        ("worley f2-f1", cracks.apply(grid, base)[0], grid),
        ("polygons", ice.apply(wide, 0.4 * grain)[0], wide),
        ("craters in equilibrium", scattered("c", pits).apply(grid, base)[0], grid),
        ("stream power, uplift, creep", rivers.apply(large, uplands)[0], large),
        ("ridged, steep", hills, grid),
        ("thermal: it slid to 33°", Thermal(33.0).apply(grid, hills)[0], grid),
        ("terraces", ledges.apply(grid, hills)[0], grid),
        ("dunes", sand.apply(grid, 0.3 * base)[0], grid),
        ("barchans", scattered("b", heaps).apply(grid, 0.2 * base)[0], grid),
        ("ripples", waves.apply(six, np.zeros(six.shape))[0], six),
        ("diffusion of ridged", Smooth(4.0).apply(grid, hills)[0], grid),
        ("tracks", rover.apply(small, ground)[0], small),
        ("footprints", boots.apply(close, 0.2 * ground)[0], close),
        ("crust", plates.apply(six, 0.3 * ground)[0], six),
        ("masked: craters in a disk", Masked(fresh, (disk,)).apply(wide, grain)[0], wide),
        ("mare: craters, worn, and grain", lunar(grid, streams, pits), grid),
    ]
    columns, width = 4, n
    sheet = Image.new(
        "L", (columns * (width + 6) - 6, -(-len(panels) // columns) * (width + 24)), 255
    )
    draw = ImageDraw.Draw(sheet)
    for k, (name, height, own) in enumerate(panels):
        x, y = (k % columns) * (width + 6), (k // columns) * (width + 24)
        sheet.paste(Image.fromarray(shaded(height, own.spacing_m[0])), (x, y + 18))
        draw.text((x + 2, y + 3), f"{name}, {own.size_m[0]:g} m", fill=0)
    sheet.save(page.picture("gallery"), optimize=True)
    return (
        "## The operators\n\n"
        "Hillshades with the sun in the north-west, 30° high. The width of each square is beside "
        "its name.\n\n![Hillshades of every operator](pictures/relief_gallery.png)\n"
    )


def lunar(grid: Grid, streams: Streams, pits: dict) -> NDArray:
    """A program of several operators."""
    height = Multifractal(
        key=21,
        amplitude_m=2.0,
        scale_m=120.0,
        octaves=4,
        lacunarity=2.0,
        gain=0.45,
        variant="fbm",
        offset=0.7,
    ).apply(grid, np.zeros(grid.shape))[0]
    height = draw_kind(
        "relief", {"type": "craters", **pits}, "old", Context(streams, grid.size_m)
    ).apply(grid, height)[0]
    height = Smooth(1.0).apply(grid, height)[0]
    young = {**pits, "max_diameter_m": 25.0, "density_per_m2": 0.01, "degradation": 0.05}
    height = draw_kind(
        "relief", {"type": "craters", **young}, "young", Context(streams, grid.size_m)
    ).apply(grid, height)[0]
    return Multifractal(
        key=22,
        amplitude_m=0.25,
        scale_m=8.0,
        octaves=6,
        lacunarity=2.0,
        gain=0.55,
        variant="fbm",
        offset=0.7,
    ).apply(grid, height)[0]


def craters(page: Page) -> str:
    """Drawn counts beside the law, and the worn profiles."""
    cfg = {
        "min_diameter_m": 1.0,
        "max_diameter_m": 64.0,
        "density_per_m2": 0.0218 * 1.54,
        "reference_diameter_m": 1.0,
        "exponent": 2.0,
        "depth_ratio": 0.2,
        "rim_ratio": 0.04,
        "degradation": 0.4,
        "irregularity": 0.0,
    }
    bounds = (1.0, 2.0, 4.0, 8.0, 16.0, 32.0)
    seeds, size = 6 if page.fast else 60, 200.0
    rows = []
    figure, (left, right) = plt.subplots(1, 2, figsize=(9.2, 3.4))
    for exponent, density in ((2.0, 0.0218 * 1.54), (3.0, 0.2)):
        law = {**cfg, "exponent": exponent, "density_per_m2": density}
        diameters = []
        for seed in range(seeds):
            c = draw_kind(
                "relief",
                {"type": "craters", **law},
                "craters",
                Context(Streams(seed, 0), (size, size)),
            )
            here = (np.abs(c.x_m) < size / 2) & (np.abs(c.y_m) < size / 2)
            diameters.append(c.diameter_m[here])
        pooled = np.sort(np.concatenate(diameters))[::-1]
        counts = np.arange(1, pooled.size + 1) / (seeds * size * size)
        left.loglog(pooled, counts, ".", markersize=2, label=f"drawn, b = {exponent:g}")
        at = np.geomspace(1.0, 60.0, 50)
        left.loglog(at, density * (at**-exponent - 64.0**-exponent), "k-", linewidth=0.8)
        for low, high in pairwise(bounds):
            inside = [int(((d >= low) & (d < high)).sum()) for d in diameters]
            expected = size * size * density * (low**-exponent - high**-exponent)
            rows.append(
                [
                    f"{exponent:g}",
                    f"{low:g} to {high:g}",
                    f"{expected:.2f}",
                    f"{np.mean(inside):.2f} ± {np.sqrt(expected / seeds):.2f}",
                    f"{np.var(inside) / expected:.2f}",
                ]
            )
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
    return (
        "## Craters: sizes and wear\n\n"
        f"Mean counts over {seeds} seeds on 200 m × 200 m beside the law's, and their variance "
        "over their mean (1 for a Poisson process). b = 2 is the equilibrium of small lunar "
        "craters, N(>D) = 0.0218 · 1.54 · D⁻² per m².\n\n"
        + table(["b", "diameters, m", "expected", "drawn", "variance / mean"], rows)
        + "\n"
        + page.save(figure, "craters")
    )


def shaded(
    height: NDArray, spacing: float, azimuth: float = 315.0, elevation: float = 30.0
) -> NDArray:
    """Hillshade: Lambert's cosine under a sun, gray uint8, north up."""
    gy, gx = np.gradient(height, spacing)
    a, e = np.deg2rad(azimuth), np.deg2rad(elevation)
    toward = (np.sin(a) * np.cos(e), np.cos(a) * np.cos(e), np.sin(e))
    cosine = (-gx * toward[0] - gy * toward[1] + toward[2]) / np.sqrt(1.0 + gx * gx + gy * gy)
    gray = np.clip(0.55 * cosine / np.sin(e), 0.0, 1.0) ** 0.7
    # Few levels, for small files.
    return (np.round(gray * 48.0) * (255.0 / 48.0)).astype(np.uint8)[::-1]
