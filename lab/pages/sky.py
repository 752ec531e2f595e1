"""Makes what docs/sky.md shows: skies by scattering, beside Blender's, with their error and cost.

    python lab/pages/sky.py [--fast] [-o FOLDER]

Seconds are single readings on the machine that runs it; errors are facts of the code.
"""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from numpy.typing import NDArray

from scenec.compiler.light import atmosphere
from scenec.compiler.light.atmosphere_planets import MEDIA
from scenec.compiler.light.atmosphere_spectra import black_body, weights, weights_of
from scenec.compiler.light.latlong import luminance
from scenec.lab.runner import ROOT, Page, run
from scenec.testing import nishita, photons

SAND, RUST = (0.3, 0.26, 0.22), (0.3, 0.16, 0.09)
#: Planet, elevation of the sun, altitude, factors on air, dust, ozone.
Case = tuple[str, float, float, tuple[float, float, float]]
USUAL = (1.0, 1.0, 1.0)
ROWS: dict[str, Case] = {
    "Earth, sun at 60°": ("earth", 60.0, 0.0, USUAL),
    "Earth, sun at 8°": ("earth", 8.0, 0.0, USUAL),
    "Earth, sun at 0.5°": ("earth", 0.5, 0.0, USUAL),
    "Earth, sun at -5°": ("earth", -5.0, 0.0, USUAL),
    "Earth, sun at 30°, dust 8": ("earth", 30.0, 0.0, (1.0, 8.0, 1.0)),
    "Earth, sun at 30°, 30 km high": ("earth", 30.0, 30_000.0, USUAL),
    "Mars, sun at 55°": ("mars", 55.0, 0.0, USUAL),
    "Mars, sun at 6°": ("mars", 6.0, 0.0, USUAL),
    "Mars, sun at 6°, exposed for the sun": ("mars", 6.0, 0.0, USUAL),
    "Mars, sun at 30°, dust 4": ("mars", 30.0, 0.0, (1.0, 4.0, 1.0)),
}
#: Of the comparison with Blender: elevation, altitude, factors.
BESIDE = [
    (30.0, 100.0, (1.0, 1.0, 1.0)),
    (5.0, 100.0, (1.0, 1.0, 1.0)),
    (60.0, 3000.0, (2.0, 0.5, 3.0)),
    (50.0, 2000.0, (1.0, 0.0, 1.0)),
]


def baked(case: Case, height: int, **how: Any) -> NDArray:
    """A sky under sunlight of luminance 1."""
    planet, elevation, altitude, factors = case
    count = atmosphere.WAVELENGTHS
    ground = np.array(RUST if planet == "mars" else SAND)
    medium = MEDIA[planet](count, *factors)
    return atmosphere.bake(
        medium, weights(count), altitude, np.radians(elevation), ground, height, **how
    )


def displayed(picture: NDArray, gray: float) -> NDArray:
    """sRGB, the luminance ``gray`` at 0.4."""
    x = np.clip(picture * (0.4 / gray), 0.0, 1.0)
    return np.where(x < 0.0031308, 12.92 * x, 1.055 * x ** (1 / 2.4) - 0.055)


def pictures(page: Page) -> None:
    """Skies from the zenith to 20 degrees below the horizon."""
    height = 64 if page.fast else 180
    figure, axes = plt.subplots(len(ROWS), 2, figsize=(13, 1.6 * len(ROWS)))
    for (name, case), pair in zip(ROWS.items(), axes, strict=True):
        for axis, multiple in zip(pair, (False, True), strict=True):
            picture = baked(case, height, multiple=multiple)[: height * 11 // 18]
            part = 99.9 if "exposed" in name else 75
            gray = float(np.percentile(luminance(picture[: height // 2]), part))
            axis.imshow(displayed(picture, gray), extent=(-180, 180, -20, 90), aspect="auto")
            how = "multiple" if multiple else "single"
            zenith = luminance(picture[0]).mean()
            axis.set_title(f"{name}, {how} (zenith {zenith:.1e}/sr)", fontsize=8)
            axis.set_yticks((0, 30, 60, 90))
            axis.set_xticks(())
    page.save(figure, "rows")
    low = baked(ROWS["Mars, sun at 6°"], 360)
    angle = np.radians(6.0)
    row = round(360 * (0.5 - angle / np.pi))
    ratio = low[row, 360:720, 0] / low[row, 360:720, 2]
    degrees = (np.arange(360) + 0.5) / 2
    figure, axis = plt.subplots(figsize=(6, 2.6))
    axis.plot(degrees, ratio)
    axis.axhline(1.0, color="gray", linewidth=0.7)
    axis.set(xlabel="bearing off the sun's, degrees", ylabel="red / blue")
    page.save(figure, "aureole")
    page.value("at", f"{ratio[0]:.2f}")
    page.value("aside", f"{ratio[180]:.2f}")


def blenders(height: int) -> list[NDArray]:
    """Blender's skies above the horizon, under sunlight of luminance 1 (single scattering's)."""
    asked = json.dumps([["SINGLE_SCATTERING", e, a, *factors] for e, a, factors in BESIDE])
    script = ROOT / "testing" / "blender_sky.py"
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder, "sky.npz")
        subprocess.run([sys.executable, str(script), str(out), str(height), asked], check=True)
        with np.load(out) as found:
            return [found[name][: height // 2].astype(float) for name in found.files]


def beside_blender(page: Page) -> None:
    """Relative difference to Blender's single scattering, and what its sums err."""
    height = 32 if page.fast else 64
    up = (np.pi / 2 - np.pi * (np.arange(height // 2) + 0.5) / height)[:, None]
    bearing = (np.pi - np.pi * (np.arange(2 * height) + 0.5) / height)[None]
    to = nishita.looking(up, bearing)
    count = atmosphere.WAVELENGTHS
    ours_sun = weights(count).sum(axis=0)
    tint = weights_of(black_body(5777.0), count).sum(axis=0) / ours_sun
    single = blenders(height)
    figure, axes = plt.subplots(len(BESIDE), 3, figsize=(11, 1.9 * len(BESIDE)))
    rows = []
    for case, theirs, row in zip(BESIDE, single, axes, strict=True):
        elevation, altitude, factors = case
        blender = theirs / nishita.unit()
        medium = MEDIA["earth"](count, *factors)
        ours = (
            tint
            * atmosphere.bake(
                medium, weights(count), altitude, np.radians(elevation), np.zeros(3), height
            )[: height // 2]
        )
        there = nishita.sky(nishita.as_blender_looks(up, bearing), *case)
        fine = nishita.sky(to, *case, fine=64 if page.fast else 256)
        away = to @ nishita.sun_direction(elevation) < np.cos(np.radians(10.0))

        def differ(a: NDArray, b: NDArray) -> NDArray:
            return 100.0 * (luminance(a) / luminance(b) - 1.0)

        maps = (differ(ours, blender), differ(fine, there), differ(ours * there / fine, blender))
        for axis, values in zip(row, maps, strict=True):
            shown = np.where(away, values, np.nan)
            image = axis.imshow(
                shown, cmap="RdBu_r", vmin=-5, vmax=5, extent=(-180, 180, 0, 90), aspect="auto"
            )
            axis.set_xticks(())
        figure.colorbar(image, ax=row[2], label="%")
        name = f"{elevation:g}°, {altitude:g} m, {', '.join(f'{f:g}' for f in factors)}"
        row[0].set_ylabel(name, fontsize=7)
        worst = [np.abs(m)[away].max() for m in maps]
        channel = 100.0 * np.abs(ours * (there / fine) / blender - 1.0)[away].max()
        high = away & (up > np.radians(30.0))
        means = (np.abs(maps[0])[part].mean() for part in (away, high))
        others = (worst[0], np.abs(differ(there, blender))[away].max(),
                  np.abs(differ(ours, fine))[away].max(), worst[2], channel)  # fmt: skip
        cells = zip((*means, *others), (2, 2, 1, 2, 2, 2, 2), strict=True)
        rows.append([name, *(f"{value:.{digits}f}" for value, digits in cells)])
    for axis, name in zip(
        axes[0], ("ours against Blender's", "what Blender's sums err", "the rest"), strict=True
    ):
        axis.set_title(name, fontsize=9)
    page.save(figure, "blender")
    page.rows(rows)


def several(page: Page) -> None:
    """The approximation of multiple scattering against photons."""
    rows = []
    for depth, albedo, forward, g in photons.SLABS:
        for elevation in (15.0, 30.0, 60.0):
            medium = photons.gray_dust(depth, albedo, forward, g)
            sine = float(np.sin(np.radians(elevation)))
            rng = np.random.default_rng(1)
            truth = sine * photons.scattered_down(rng, depth, albedo, forward, g, sine)
            light = [photons.level_irradiance(medium, elevation, both) for both in (False, True)]
            rows.append(
                [f"{depth:g}", f"{albedo:g}", f"{forward:g} at {g:g}", f"{elevation:g}"]
                + [f"{truth:.4f}"]
                + [f"{100.0 * (value / truth - 1.0):+.1f}" for value in light]
            )
    for name, both in (("single", False), ("multiple", True)):
        took = page.timed(lambda both=both: baked(ROWS["Mars, sun at 6°"], 128, multiple=both))
        page.value(name, f"{took:.2f} s")
    page.rows(rows)


def main(page: Page) -> None:
    """Writes the page."""
    baked(ROWS["Earth, sun at 60°"], 16)
    parts = (pictures, beside_blender, several)
    page.refresh(("numpy", "numba", "bpy"), parts)


if __name__ == "__main__":
    run(main, page="sky")
