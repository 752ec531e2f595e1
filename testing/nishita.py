"""Blender's single-scattering sky, written out anew in NumPy: the same model, quadrature by choice.

With Blender's quadrature it gives Blender's numbers, errors of integration and of table look-up
included; with a fine one, what the model has.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.light import atmosphere_spectra
from scenec.compiler.light.atmosphere_planets import _OZONE as OZONE

RADIUS, TOP = 6_360e3, 6_420e3
NM = np.arange(380.0, 781.0, 20.0)
AIR = 8 * np.pi**3 * (1.0002926**2 - 1) ** 2 / (3 * 2.504e25) / (NM * 1e-9) ** 4
AEROSOL, LOSS, G = 2e-5, 2.22e-5, 0.76
#: Rows of Blender's table of the sky above the horizon, and columns all around.
ROWS, COLUMNS = 128, 512
# Gauss and Laguerre's rule of 8 points over [0, 25], exponential included.
_LAGUERRE = np.polynomial.laguerre.laggauss(8)
_BLENDER = _LAGUERRE[0] / 25.0, _LAGUERRE[1] * np.exp(_LAGUERRE[0]) / 25.0


def sunlight() -> NDArray:
    """Of the black body that Blender takes, W/(m^2 nm)."""
    h, c, k = 6.62607015e-34, 299_792_458.0, 1.380649e-23
    m = NM * 1e-9
    sun = np.pi * (6.957e8 / 1.495978707e11) ** 2
    return sun * 2e-9 * h * c * c / m**5 / (np.exp(h * c / (m * k * 5777.0)) - 1)


def _observer() -> NDArray:
    tables = (atmosphere_spectra._X, atmosphere_spectra._Y, atmosphere_spectra._Z)
    return np.stack([t[::2] for t in tables])


def unit() -> float:
    """Luminance of Blender's sun above the atmosphere in Blender's unit."""
    return float((sunlight() * _observer()[1]).sum() * 20.0)


def sun_direction(elevation_deg: float) -> NDArray:
    """The unit vector towards a sun in the plane of x and z."""
    angle = np.radians(elevation_deg)
    return np.array([np.cos(angle), 0.0, np.sin(angle)])


def looking(elevation: NDArray, bearing: NDArray) -> NDArray:
    """Directions [..., 3] by elevation and the bearing off the sun's, radians."""
    e, b = np.broadcast_arrays(elevation, bearing)
    return np.stack([np.cos(e) * np.cos(b), np.cos(e) * np.sin(b), np.sin(e)], axis=-1)


def as_blender_looks(elevation: NDArray, bearing: NDArray) -> NDArray:
    """Where Blender's table was made for what is read from it: half a texel off."""
    row = np.sqrt(elevation / (np.pi / 2)) - 0.5 / ROWS
    return looking(np.pi / 2 * row * row, bearing + np.sign(bearing) * np.pi / COLUMNS)


def _density(height: NDArray) -> NDArray:
    layer = np.maximum(0.0, 1.0 - np.abs(height - 25e3) / 15e3)
    return np.stack([np.exp(-height / 8e3), np.exp(-height / 1.2e3), layer], axis=-1)


def _length(start: NDArray, to: NDArray) -> NDArray:
    b = (start * to).sum(axis=-1)
    return -b + np.sqrt(b * b - (start * start).sum(axis=-1) + TOP * TOP)


def sky(
    directions: NDArray,
    elevation_deg: float,
    altitude_m: float,
    factors: tuple[float, float, float],
    fine: int = 0,
) -> NDArray:
    """Radiance under sunlight of luminance 1, linear Rec.709, [..., 3].

    Args:
        directions: [..., 3], the sun in the plane of x and z.
        elevation_deg: Of the sun, 0 or more.
        altitude_m: Of the observer.
        factors: On air, aerosol and ozone.
        fine: Steps of a fine quadrature; 0 for Blender's.
    """
    sun, scale = sun_direction(elevation_deg), np.array(factors)
    to = directions.reshape(-1, 3)
    origin = np.array([0.0, 0.0, RADIUS + altitude_m])
    length = _length(np.broadcast_to(origin, to.shape), to)
    nodes, shares = _BLENDER
    edges = np.linspace(0.0, 1.0, 33)
    if fine:
        x, w = np.polynomial.legendre.leggauss(96)
        x = 0.5 + 0.5 * x
        nodes, shares = x**3, 1.5 * x * x * w
        edges = np.linspace(0.0, 1.0, fine + 1) ** 3
    loss = np.stack([AIR, np.full(21, LOSS), OZONE])
    cosine = to @ sun
    of_gas = 3 / (16 * np.pi) * (1 + cosine**2)
    of_aerosol = 3 * (1 - G * G) * (1 + cosine**2) / (8 * np.pi * (2 + G * G))
    of_aerosol = of_aerosol / (1 + G * G - 2 * G * cosine) ** 1.5
    total, column = np.zeros((len(to), 21)), np.zeros((len(to), 3))
    for low, high in pairwise(edges):
        step = ((high - low) * length)[:, None]
        place = origin + (0.5 * (low + high) * length)[:, None] * to
        density = _density(np.linalg.norm(place, axis=1) - RADIUS) * scale
        # Blender counts the whole step as passed, the fine rule half of it.
        before = column + density * step * (0.5 if fine else 1.0)
        column = column + density * step
        far = _length(place, np.broadcast_to(sun, place.shape))
        along = place[:, None] + (nodes * far[:, None])[..., None] * sun
        above = _density(np.linalg.norm(along, axis=-1) - RADIUS) * shares[:, None]
        arriving = np.exp(-(before + above.sum(axis=1) * far[:, None] * scale) @ loss)
        source = density[:, :1] * AIR * of_gas[:, None]
        source = source + density[:, 1:2] * AEROSOL * of_aerosol[:, None]
        total += arriving * source * step
    xyz = (total[:, None] * sunlight() * _observer()).sum(axis=2) * 20.0 / unit()
    rgb = np.maximum(xyz @ np.array(atmosphere_spectra._TO_RGB).T, 0.0)
    return rgb.reshape(directions.shape)
