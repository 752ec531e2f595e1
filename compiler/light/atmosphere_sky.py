"""Makes the skies of a batch under an atmosphere, and what comes through of its sun."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, ClassVar, Literal

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.arithmetic import elementary
from scenec.compiler.kinds import Array, Finding, Node, forms, key
from scenec.compiler.light.sky import ROWS, Sky, SkyAndSun
from scenec.schemas.codec import JsonObject

if TYPE_CHECKING:
    # A cfg is checked without what shines.
    from scenec.compiler.scene.light import SunDisc

#: At which optical depths are reported, nm.
_REPORTED_NM = 550.0
_RADIAN = elementary.PI / 180.0

#: What the sun is above a planet's atmosphere, where the cfg is silent: mean irradiance (Kopp
#: and Lean 2011, Geophys. Res. Lett. 38:L01706; on Mars over 1.524 au squared) and diameter.
SUNS: dict[str, JsonObject] = {
    "earth": {"irradiance": 1361.0, "diameter_deg": 0.53, "color": None},
    "mars": {"irradiance": 590.0, "diameter_deg": 0.35, "color": None},
    "moon": {"irradiance": 1361.0, "diameter_deg": 0.53, "color": None},
}


@dataclass(frozen=True, kw_only=True)
class AtmosphereSky(Sky):
    """A planet's sky, by scattering in its air. light.sun gives direction and irradiance above the
    atmosphere; what comes through is computed.
    """

    EXAMPLE: ClassVar = {
        "type": "atmosphere",
        "planet": "mars",
        "scattering": "multiple",
        "dust_density": {"type": "uniform", "min": 0.5, "max": 2},
        "labels": {"class": "sky"},
    }

    planet: Literal["earth", "mars", "moon"] = key(forms.CHOICE, default="earth")
    """Whose: "moon" has no air, so its sky is black."""
    scattering: Literal["single", "multiple"] = key(forms.CHOICE, default="single")
    """single: Nishita's sky, exact for light scattered once. multiple: approximates all further
    orders, without which thick air and dust are too dark, black at low sun."""
    air_density: Array = key(forms.PER_SAMPLE, default=1, at_least=0, at_most=10)
    """Factor on the gas."""
    dust_density: Array = key(forms.PER_SAMPLE, default=1, at_least=0, at_most=10)
    """Factor on dust and haze: 1 is clear air on Earth, optical depth 0.5 on Mars."""
    ozone_density: Array = key(forms.PER_SAMPLE, default=1, at_least=0, at_most=10)
    """Factor on Earth's ozone; 1 is 300 Dobson units."""
    altitude_m: Array = key(forms.LENGTH_PER_SAMPLE, default=0, at_least=0, at_most=60_000)
    """Height of the scene above the planet's mean level."""
    ground_color: Array = key(forms.GROUND_COLOR)
    resolution: int = key(ROWS)

    @staticmethod
    def check(node: Node) -> Iterator[Finding]:
        """Yields whether it has no sun."""
        light = node.whole().at("light")
        if light.entries.get("sun", {}) is None:
            yield light.fault(
                "an atmosphere shows the light of the sun: expected a sun (below the horizon for "
                'night), or a sky of the type "none"',
                "sun",
            )

    @staticmethod
    def takes_clouds(sky: Node) -> bool:
        """Returns whether there is water in the air."""
        return bool(sky["planet"] == "earth")

    @staticmethod
    def usual_sun(sky: JsonObject) -> JsonObject:
        """Returns what the sun is above the planet."""
        return SUNS[sky["planet"]]

    def build(self, sun: SunDisc | None, samples: int) -> SkyAndSun:
        """Returns pictures, the sun at the observer, and facts of each picture.

        Samples that differ in the sun's bearing alone share a picture and turn it.

        Args:
            sun: Above the atmosphere; its color is a factor on that of sunlight.
        """
        # Imported here: a cfg's faults are told without it.
        from scenec.compiler.light import atmosphere
        from scenec.compiler.light.atmosphere_planets import MEDIA
        from scenec.compiler.light.atmosphere_spectra import wavelengths, weights
        from scenec.compiler.light.latlong import luminance
        from scenec.compiler.scene.light import SkyLight

        assert sun is not None, "an atmosphere without a sun"
        count = atmosphere.WAVELENGTHS
        of_nodes = weights(count)
        sunlight = of_nodes.sum(axis=0)
        # However it is colored, the light above the atmosphere has the irradiance of the cfg.
        tint = sun.color / luminance(sun.color * sunlight)[:, None]
        if self.planet == "moon":
            return None, replace(sun, color=tint * sunlight), {}
        pictures: dict[str, NDArray[np.float32]] = {}
        names: dict[tuple[float, ...], str] = {}
        facts: dict[str, Any] = {}
        texture = []
        arriving = np.zeros((samples, 3))
        for i in range(samples):
            factors = (self.air_density[i], self.dust_density[i], self.ozone_density[i])
            medium = MEDIA[self.planet](count, *map(float, factors))
            altitude, elevation = float(self.altitude_m[i]), float(sun.elevation_deg[i]) * _RADIAN
            above = tint[i] * sun.irradiance[i]
            arriving[i] = above * atmosphere.direct(
                medium, of_nodes, altitude, elevation, float(sun.diameter_deg[i]) * _RADIAN
            )
            key = (*factors, altitude, elevation, *above, *self.ground_color[i])
            if key not in names:
                names[key] = name = f"sky_{i:04d}.exr"
                picture = above * atmosphere.bake(
                    medium, of_nodes, altitude, elevation, self.ground_color[i], self.resolution,
                    multiple=self.scattering == "multiple",
                )  # fmt: skip
                pictures[name] = picture.astype(np.float32)
                depth = atmosphere.zenith_depth(medium, altitude, _REPORTED_NM, wavelengths(count))
                facts[name] = {
                    "optical_depth_550nm": depth,
                    "resolution_error": resolution_error(picture),
                }
            texture.append(names[key])
        level = luminance(arriving)
        color = np.where(
            level[:, None] > 0.0, arriving / np.where(level > 0.0, level, 1.0)[:, None], 1.0
        )
        turn = sun.azimuth_deg - 180.0
        sky = SkyLight(
            pictures={**pictures},
            texture=tuple(texture),
            intensity=np.ones(samples),
            rotation_deg=turn - 360.0 * np.floor(turn / 360.0),
        )
        return sky, replace(sun, irradiance=level, color=color), facts


def resolution_error(picture: NDArray[np.float64]) -> float:
    """Estimates the error of reading a picture linearly between texels, above the horizon.

    Halfway between texels a linear reading errs by an eighth of the second difference: of the
    luminance, its root mean square over the sky, relative to the sky's mean.
    """
    from scenec.compiler.light.latlong import luminance

    height = len(picture)
    level = luminance(picture[: height // 2])
    if level.shape[0] < 3 or not level.any():
        return 0.0
    polar = elementary.PI * (np.arange(height // 2) + 0.5) / height
    size = elementary.sin_array(polar)[1:-1, None] * np.ones(level.shape[1])
    across = np.roll(level, 1, axis=1) + np.roll(level, -1, axis=1) - 2.0 * level
    down = level[2:] + level[:-2] - 2.0 * level[1:-1]
    square = (across[1:-1] * across[1:-1] + down * down) / 64.0
    mean = (level[1:-1] * size).sum() / size.sum()
    return float(np.sqrt((square * size).sum() / size.sum()) / mean)
