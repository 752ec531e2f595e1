"""Makes a clear sky by the CIE's standard luminance distribution, colored by height."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.arithmetic import elementary
from scenec.compiler.kinds import Array, Finding, Node, black, forms, is_black, key
from scenec.compiler.light.latlong import directions, far_ground, horizontal_irradiance, luminance
from scenec.compiler.light.sky import ROWS, Sky, SkyAndSun
from scenec.compiler.scene.light import SkyLight, SunDisc
from scenec.schemas.kernels import kernel
from scenec.schemas.threads import over_threads


@dataclass(frozen=True, kw_only=True)
class ClearSky(Sky):
    """A smooth gradient from zenith to horizon."""

    EXAMPLE: ClassVar = {
        "type": "clear",
        "irradiance": 220,
        "zenith_color": [0.12, 0.3, 0.9],
        "horizon_color": [0.45, 0.65, 0.95],
    }

    irradiance: Array = key(
        forms.PER_SAMPLE, default=200, above=0, at_most=1_000_000_000_000, unit="W/m²"
    )
    """Diffuse irradiance on a horizontal surface."""
    zenith_color: Array = key(forms.COLOR, default=[0.12, 0.3, 0.9])
    """Color overhead, relative to the others. Not black together with the horizon."""
    horizon_color: Array = key(forms.COLOR, default=[0.45, 0.65, 0.95])
    """Color at the horizon, relative to the others."""
    ground_color: Array = key(forms.GROUND_COLOR)
    resolution: int = key(ROWS)

    @staticmethod
    def check(node: Node) -> Iterator[Finding]:
        """Yields whether it can be black."""
        if is_black(node, "zenith_color") and is_black(node, "horizon_color"):
            yield node.fault(black("an irradiance"), "zenith_color")

    @staticmethod
    def takes_clouds(sky: Node) -> bool:
        """Returns True."""
        return True

    def build(self, sun: SunDisc | None, samples: int) -> SkyAndSun:
        """Returns pictures of a clear sky, and which of them each sample shows.

        They are baked with the sun at its true bearing, so none is ever turned. Samples with the
        same picture share one file.
        """
        pictures: dict[str, NDArray[np.float32]] = {}
        # By what it is made from, and by what it then is: samples may be many.
        name_of: dict[bytes, str] = {}
        same: dict[bytes, str] = {}
        texture = []
        for i in range(samples):
            toward = sun.direction(i) if sun else (0.0, 0.0, 1.0)
            level = level_sun_irradiance(sun, i)
            colors = self.zenith_color[i], self.horizon_color[i], self.ground_color[i]
            numbers = (toward, [self.irradiance[i]], *colors, level)
            key = np.concatenate([np.asarray(one, np.float64) for one in numbers]).tobytes()
            if key not in name_of:
                picture = clear_sky(
                    self.resolution, toward, float(self.irradiance[i]), *colors, level
                )
                digest = hashlib.sha256(picture.tobytes()).digest()
                name_of[key] = same.setdefault(digest, f"sky_{i:04d}.exr")
                pictures[name_of[key]] = picture
            texture.append(name_of[key])
        sky = SkyLight({**pictures}, tuple(texture), np.ones(samples), np.zeros(samples))
        return sky, sun, {}


def level_sun_irradiance(sun: SunDisc | None, sample: int) -> NDArray[np.float64]:
    """Irradiance of the sun on level ground, linear Rec.709, W/m^2, float64 [3]."""
    if sun is None:
        return np.zeros(3)
    height = max(sun.direction(sample)[2], 0.0)
    return sun.color[sample] * (sun.irradiance[sample] * height)


def clear_sky(
    height: int,
    to_sun: tuple[float, float, float],
    irradiance: float,
    zenith_color: NDArray[np.float64],
    horizon_color: NDArray[np.float64],
    ground_color: NDArray[np.float64],
    sun_irradiance: NDArray[np.float64],
) -> NDArray[np.float32]:
    """Radiance of a clear sky without the sun's disc, and of far ground below the horizon.

    The distribution is type 12 of ISO 15469:2004 (CIE S 011), standard clear sky:
    L ~ f(chi) * phi(Z), phi(Z) = 1 + a exp(b / cos Z), f(chi) = 1 + c (exp(d chi) - exp(d pi/2))
    + e cos^2 chi, a = -1, b = -0.32, c = 10, d = -3, e = 0.45, with Z the angle from the zenith and
    chi that from the sun. The standard gives no colors: they go from ``horizon_color`` to
    ``zenith_color`` with sqrt(cos Z). Below the horizon lies a diffuse plane of albedo
    ``ground_color`` under this light, fading into the horizon's mean radiance (haze).

    Args:
        height: Rows of the picture; it is twice as wide.
        to_sun: Unit vector; a sun below the horizon counts as on it.
        irradiance: Diffuse irradiance on level ground, of luminance, W/m^2.
        zenith_color: Linear Rec.709, relative, [3].
        horizon_color: Likewise.
        ground_color: Albedo of the far ground, [3].
        sun_irradiance: Of the sun on level ground, [3], W/m^2.

    Returns:
        float32 [height, 2 * height, 3], W/(m^2 sr).
    """
    sun = np.array([to_sun[0], to_sun[1], max(to_sun[2], 0.0)])
    sun /= np.sqrt((sun * sun).sum())
    to, picture = directions(height), np.zeros((height, 2 * height, 3))
    over_threads(_distribution_part, height // 2, to, sun, zenith_color, horizon_color, picture)
    of_sky = horizontal_irradiance(picture)
    level = float(luminance(of_sky))
    scale = irradiance / level if level > 0.0 else 0.0
    picture *= scale
    far_ground(picture, ground_color * (of_sky * scale + sun_irradiance) / elementary.PI)
    return picture.astype(np.float32)


@kernel
def _distribution_part(first, last, to, sun, zenith, horizon, out):  # type: ignore[no-untyped-def]
    a, b, c, d, e = -1.0, -0.32, 10.0, -3.0, 0.45
    _h, w, _ = to.shape
    at_right_angle = elementary.exp(d * elementary.PI / 2.0)
    for j in range(first, last):
        for i in range(w):
            up = to[j, i, 2]
            cos_chi = to[j, i, 0] * sun[0] + to[j, i, 1] * sun[1] + up * sun[2]
            cos_chi = min(max(cos_chi, -1.0), 1.0)
            chi = elementary.acos(cos_chi)
            gradation = 1.0 + a * elementary.exp(b / max(up, 1e-3))
            indicatrix = (
                1.0 + c * (elementary.exp(d * chi) - at_right_angle) + e * cos_chi * cos_chi
            )
            mix = np.sqrt(up)
            for k in range(3):
                color = horizon[k] + mix * (zenith[k] - horizon[k])
                out[j, i, k] = gradation * indicatrix * color
