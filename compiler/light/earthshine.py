"""Makes the Earth a lamp over the Moon.

An airless ball that scatters by Lambert's law shows (sin a + (pi - a) cos a) / pi of its light at
the phase angle a (Russell 1916); seen from the Moon at its mean distance, a ball of geometric
albedo p gives p * (radius / distance)**2 of the Sun's irradiance at a = 0. Cox 2000 (Allen's
Astrophysical Quantities) has p = 0.367 in visible light: 0.137 W/m^2. Glenar et al. 2019 model
0.15 W/m^2 in all wavelengths, about half of it thermal; their sunlight has p near 0.22.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.arithmetic import elementary

EARTH_RADIUS_KM = 6371.0
MOON_DISTANCE_KM = 384400.0
_ROUNDING = 1e-12


def earthshine_irradiance(
    phase_deg: NDArray[np.float64],
    solar_irradiance: NDArray[np.float64],
    geometric_albedo: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Irradiance on a surface of the Moon that faces the Earth, W/m^2, [s].

    Args:
        phase_deg: Between Sun and Moon, seen from the Earth: 0 is a full Earth.
        solar_irradiance: Of the Sun at the Earth, W/m^2.
    """
    angle = phase_deg * (elementary.PI / 180.0)
    law = elementary.sin_array(angle) + (elementary.PI - angle) * elementary.cos_array(angle)
    # Near 180 degrees the two terms cancel, but for a rounding error of either sign.
    law = np.where(law > _ROUNDING, law, 0.0)
    ratio = EARTH_RADIUS_KM / MOON_DISTANCE_KM
    full = geometric_albedo * solar_irradiance * (ratio * ratio)
    return full * (law / elementary.PI)
