"""Makes the Earth a lamp over the Moon.

An airless ball that scatters by Lambert's law shows (sin a + (pi - a) cos a) / pi of its light at
the phase angle a (Russell 1916); seen from the Moon at its mean distance, a ball of geometric
albedo p gives p * (radius / distance)**2 of the Sun's irradiance at a = 0. Cox 2000 (Allen's
Astrophysical Quantities) has p = 0.367 in visible light: 0.137 W/m^2. Glenar et al. 2019 model
0.15 W/m^2 in all wavelengths, about half of it thermal; their sunlight has p near 0.22.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.arithmetic import elementary
from scenec.compiler.distributions.numbers import Number
from scenec.compiler.kinds import Context, Finding, Node, black, forms, is_black, key
from scenec.compiler.light.ephemeris import EARTH_RADIUS_KM
from scenec.compiler.light.suns import of_luminance_one
from scenec.compiler.scene.light import SunDisc

MOON_DISTANCE_KM = 384400.0
_ROUNDING = 1e-12


@dataclass(frozen=True, kw_only=True)
class Earthshine:
    """The Earth as it shines on the Moon: (6371 km / 384400 km)² times geometric albedo, solar
    irradiance and (sin a + (pi - a) cos a) / pi, a Lambert sphere's phase law. By default 0.137
    W/m² at full Earth. The light comes from a full disc at any phase.
    """

    EXAMPLE: ClassVar = {
        "type": "earthshine",
        "phase_deg": 60,
        "elevation_deg": 40,
        "azimuth_deg": 200,
    }

    phase_deg: Number = key(forms.ANGLE_PER_SAMPLE, default=0, at_least=0, at_most=180)
    """Angle between Sun and Moon seen from the Earth: 0 is a full Earth, 90 half, 180 dark."""
    elevation_deg: Any = key(forms.SUN_ELEVATION_DEG)
    azimuth_deg: Number = key(forms.TURN_PER_SAMPLE, default=135)
    """Compass bearing of the Earth, clockwise from +Y (north)."""
    solar_irradiance: Number = key(
        forms.PER_SAMPLE, default=1361, above=0, at_most=1_000_000_000_000, unit="W/m²"
    )
    """Of the Sun on a facing surface, in the units of the sun's irradiance."""
    geometric_albedo: Number = key(forms.PER_SAMPLE, default=0.367, above=0, at_most=1)
    """The Earth's: 0.367 in visible light (Cox 2000), about 0.22 over all sunlight. With as much
    thermal infrared, the latter makes the 0.15 W/m² of Glenar et al. (2019)."""
    diameter_deg: Number = key(forms.ANGLE_PER_SAMPLE, default=1.9, at_least=0, at_most=90)
    """Angular diameter."""
    color: Any = key(forms.COLOR, default=[0.63, 0.74, 1])
    """Color, scaled so that the irradiance is as said; not black. Bluish by default: B-V of the
    Earth is 0.2, of the Sun 0.65 (Cox 2000)."""

    @staticmethod
    def check(node: Node) -> Iterator[Finding]:
        """Yields whether it can be black."""
        if is_black(node):
            yield node.fault(black("what is asked for"), "color")

    def draw(self, context: Context) -> SunDisc:
        """Returns the Earth's disc at every sample."""
        drawn = context.sampled(self)
        drawn["irradiance"] = earthshine_irradiance(
            drawn.pop("phase_deg"), drawn.pop("solar_irradiance"), drawn.pop("geometric_albedo")
        )
        drawn["color"] = of_luminance_one(drawn["color"])
        return SunDisc(**drawn)


def earthshine_irradiance(
    phase_deg: NDArray[np.float64],
    solar_irradiance: NDArray[np.float64],
    geometric_albedo: NDArray[np.float64],
    distance_km: NDArray[np.float64] | float = MOON_DISTANCE_KM,
) -> NDArray[np.float64]:
    """Irradiance on a surface of the Moon that faces the Earth, W/m^2, [s].

    Args:
        phase_deg: Between Sun and Moon, seen from the Earth: 0 is a full Earth.
        solar_irradiance: Of the Sun at the Earth, W/m^2.
        distance_km: Of the Earth's center.
    """
    angle = phase_deg * (elementary.PI / 180.0)
    law = elementary.sin_array(angle) + (elementary.PI - angle) * elementary.cos_array(angle)
    # Near 180 degrees the two terms cancel, but for a rounding error of either sign.
    law = np.where(law > _ROUNDING, law, 0.0)
    ratio = EARTH_RADIUS_KM / distance_km
    full = geometric_albedo * solar_irradiance * (ratio * ratio)
    return full * (law / elementary.PI)
