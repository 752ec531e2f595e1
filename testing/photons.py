"""Photons followed one by one through a slab of dust: what the light of a sky is held against."""

from __future__ import annotations

import numpy as np

from scenec.compiler.light import atmosphere
from scenec.compiler.light.atmosphere_planets import MARS, AirMedium
from scenec.compiler.light.atmosphere_spectra import weights
from scenec.compiler.light.latlong import horizontal_irradiance
from scenec.schemas.kernels import kernel

COUNT = 4
PHOTONS = 200_000
#: Mean cosine of the dust's wide lobe.
WIDE = 0.09
#: Optical depth, single-scattering albedo, share and mean cosine of the forward lobe.
SLABS = (
    (0.5, 0.97, 0.75, 0.89),  # a usual day on Mars
    (2.0, 0.97, 0.75, 0.89),  # a storm
    (0.3, 1.0, 1.0, 0.0),  # even scattering, nothing lost
    (1.0, 0.6, 1.0, 0.76),
)


@kernel
def scattered_down(
    rng: np.random.Generator, depth: float, albedo: float, forward: float, g: float, sine: float
) -> float:
    """Share of photons that reach the ground of a slab, scattered; Henyey and Greenstein's."""
    arrived = 0
    for _ in range(PHOTONS):
        x = 0.0
        mu = -sine
        scattered = False
        while True:
            x -= mu * -np.log(1.0 - rng.random())
            if x >= depth:
                arrived += scattered
                break
            if x < 0.0 or rng.random() > albedo:
                break
            own = g if rng.random() < forward else WIDE
            cosine = 2.0 * rng.random() - 1.0
            if own > 0.0:
                part = (1.0 - own * own) / (1.0 + own * cosine)
                cosine = (1.0 + own * own - part * part) / (2.0 * own)
            turn = np.cos(2.0 * np.pi * rng.random())
            mu = mu * cosine + np.sqrt(max((1.0 - mu * mu) * (1.0 - cosine * cosine), 0.0)) * turn
            scattered = True
    return arrived / PHOTONS


def gray_dust(depth: float, albedo: float, forward: float, g: float) -> AirMedium:
    """Mars's air, but with dust alone that is the same at all wavelengths."""
    ones = np.ones(COUNT)
    loss = depth / MARS.aerosol_m * ones
    phase = np.stack([forward * ones, g * ones, WIDE * ones, 0.0 * ones])
    return AirMedium(MARS, 0.0 * ones, albedo * loss, loss, 0.0 * ones, phase)


def level_irradiance(medium: AirMedium, elevation_deg: float, multiple: bool) -> float:
    """Of the sky on the ground, over that of the sun facing it."""
    picture = atmosphere.bake(
        medium, weights(COUNT), 0.0, np.radians(elevation_deg), np.zeros(3), 64, multiple=multiple
    )
    # Gray, so that all channels hold the sunlight's color.
    channel = horizontal_irradiance(picture)[1]
    return float(channel / weights(COUNT).sum(axis=0)[1])
