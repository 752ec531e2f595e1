"""Draws the skies that docs/light.md shows, with single and with multiple scattering.

python lab/pages/sky.py [--fast] [-o FOLDER]
"""

from __future__ import annotations

from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from numpy.typing import NDArray

from scenec.compiler.light import atmosphere
from scenec.compiler.light.atmosphere_planets import MEDIA
from scenec.compiler.light.atmosphere_spectra import weights
from scenec.compiler.light.latlong import luminance
from scenec.lab.runner import Page, run
from scenec.testing import photons

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
    page.save(figure, "skies")
    low = ROWS["Mars, sun at 6°"]
    single, both = (
        page.timed(lambda many=many: baked(low, 128, multiple=many)) for many in (False, True)
    )
    page.value("sky_cost", f"{single:.2f} CPU s; `multiple`: {both:.2f} CPU s")


def several(page: Page) -> None:
    """Skylight on the ground under dust, against photons followed one by one."""
    errors: dict[bool, list[float]] = {False: [], True: []}
    for depth, albedo, forward, g in photons.SLABS:
        medium = photons.gray_dust(depth, albedo, forward, g)
        for elevation in (15.0, 30.0, 60.0):
            sine = float(np.sin(np.radians(elevation)))
            rng = np.random.default_rng(1)
            truth = sine * photons.scattered_down(rng, depth, albedo, forward, g, sine)
            for both, found in errors.items():
                light = photons.level_irradiance(medium, elevation, both)
                found.append(100.0 * (light / truth - 1.0))
    once, more = (f"{min(found):+.0f} to {max(found):+.0f} %" for found in errors.values())
    page.value("photons", f"{more} (`single`: {once})")


if __name__ == "__main__":
    run(lambda page: page.refresh(("numpy",), (pictures, several)), page="light")
