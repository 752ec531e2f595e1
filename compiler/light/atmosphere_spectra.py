"""Tabulates sunlight above the atmosphere and what the eye makes of it, 380 to 780 nm."""

from __future__ import annotations

from functools import cache

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.arithmetic import elementary
from scenec.compiler.light.latlong import luminance

#: Wavelengths of the tables, nm.
GRID_NM = np.arange(380.0, 781.0, 10.0)
#: Sunlight at 1 au, W/(m^2 nm), means about each wavelength of the grid (weight falling to 0 at its
#: neighbors): the extraterrestrial column of ASTM G173-03 (Gueymard 2004, Solar Energy 76:423),
#: which differs from that of ASTM E-490 by less than the two differ from measurement.
SUNLIGHT = np.array(
    [1.0837, 1.0635, 1.4745, 1.7185, 1.7283, 1.5928, 1.8050, 1.9966, 2.0294, 2.0077, 2.0103,
     1.9209, 1.9264, 1.9018, 1.8256, 1.8851, 1.8599, 1.8642, 1.8338, 1.8358, 1.8342, 1.7843,
     1.7670, 1.7259, 1.6872, 1.6594, 1.6277, 1.5669, 1.5311, 1.5323, 1.4902, 1.4620, 1.4244,
     1.3918, 1.3510, 1.3267, 1.2924, 1.2766, 1.2535, 1.2175, 1.1970]
)  # fmt: skip
#: CIE 1931 2 degree observer (CIE 15:2004, table 4).
_X = np.array(
    [0.001368, 0.004243, 0.01431, 0.04351, 0.13438, 0.2839, 0.34828, 0.3362, 0.2908, 0.19536,
     0.09564, 0.03201, 0.0049, 0.0093, 0.06327, 0.1655, 0.2904, 0.4334499, 0.5945, 0.7621, 0.9163,
     1.0263, 1.0622, 1.0026, 0.8544499, 0.6424, 0.4479, 0.2835, 0.1649, 0.0874, 0.04677, 0.0227,
     0.01135916, 0.005790346, 0.002899327, 0.001439971, 0.0006900786, 0.0003323011, 0.0001661505,
     0.00008307527, 0.00004150994]
)  # fmt: skip
_Y = np.array(
    [0.000039, 0.00012, 0.000396, 0.00121, 0.004, 0.0116, 0.023, 0.038, 0.06, 0.09098, 0.13902,
     0.20802, 0.323, 0.503, 0.71, 0.862, 0.954, 0.9949501, 0.995, 0.952, 0.87, 0.757, 0.631, 0.503,
     0.381, 0.265, 0.175, 0.107, 0.061, 0.032, 0.017, 0.00821, 0.004102, 0.002091, 0.001047,
     0.00052, 0.0002492, 0.00012, 0.00006, 0.00003, 0.00001499]
)  # fmt: skip
_Z = np.array(
    [0.006450001, 0.02005001, 0.06785001, 0.2074, 0.6456, 1.3856, 1.74706, 1.77211, 1.6692,
     1.28764, 0.8129501, 0.46518, 0.272, 0.1582, 0.07824999, 0.04216, 0.0203, 0.008749999, 0.0039,
     0.0021, 0.001650001, 0.0011, 0.0008, 0.00034, 0.00019, 0.00004999999, 0.00002, 0.0, 0.0, 0.0,
     0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]
)  # fmt: skip
#: XYZ to linear Rec.709 with its white point, D65 (ITU-R BT.709-6).
_TO_RGB = (
    (3.2404542, -1.5371385, -0.4985314),
    (-0.9692660, 1.8760108, 0.0415560),
    (0.0556434, -0.2040259, 1.0572252),
)


def wavelengths(count: int) -> NDArray[np.float64]:
    """Nodes at which a medium is looked at, evenly over 380 to 780 nm, [count]."""
    return 380.0 + 400.0 * np.arange(count) / (count - 1)


@cache
def weights(count: int) -> NDArray[np.float64]:
    """Returns each node's part of a color where all of the sunlight arrives, [count, 3].

    Between nodes a medium is taken to be a cubic, while sunlight and the eye keep the detail of
    their tables. The sum over the nodes is the color of sunlight above the atmosphere, linear
    Rec.709 of luminance 1.

    Args:
        count: Number of nodes, 4 or more.
    """
    return weights_of(SUNLIGHT, count)


def weights_of(sunlight: NDArray[np.float64], count: int) -> NDArray[np.float64]:
    """``weights`` under another sun, by its spectrum at ``GRID_NM``."""
    nodes = wavelengths(count)
    # Beyond the ends a medium goes on straight: what would fall to a node there, its neighbors get.
    step = nodes[1] - nodes[0]
    outer = np.concatenate([[nodes[0] - step], nodes, [nodes[-1] + step]])
    share = _cardinal((GRID_NM - outer[:, None]) / step)
    share[1] += 2.0 * share[0]
    share[2] -= share[0]
    share[-2] += 2.0 * share[-1]
    share[-3] -= share[-1]
    rgb = np.stack([sunlight * (r[0] * _X + r[1] * _Y + r[2] * _Z) for r in _TO_RGB])
    of_nodes = np.stack([(share[1:-1] * c).sum(axis=1) for c in rgb], axis=1)
    return of_nodes / luminance(of_nodes.sum(axis=0))


def _cardinal(x: NDArray[np.float64]) -> NDArray[np.float64]:
    """Catmull and Rom's cubic that is 1 at 0 and 0 at all other whole numbers."""
    x = np.abs(x)
    near = 1.0 + x * x * (1.5 * x - 2.5)
    far = 2.0 + x * (-4.0 + x * (2.5 - 0.5 * x))
    return np.where(x < 1.0, near, np.where(x < 2.0, far, 0.0))


def black_body(kelvin: float) -> NDArray[np.float64]:
    """Planck's spectrum at ``GRID_NM``, of any unit."""
    # hc / (k * 1 nm), in K.
    exponent = 1.438776877e7 / (GRID_NM * kelvin)
    fifth = GRID_NM * GRID_NM * GRID_NM * GRID_NM * GRID_NM
    return 1e12 / (fifth * (elementary.exp_array(exponent) - 1.0))
