"""Makes overcast skies: the CIE's luminance distribution, as bright as what a cloud lets through.

The cloud is one even layer of droplets that absorb nothing. What comes through it is that of the
two-stream equations, after Eddington (within 12 % of photons followed one by one). The direct beam
fades as exp(-depth / sine of its height), so the sun of a sky worth the name is gone.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.arithmetic import elementary
from scenec.compiler.kinds import Array, Finding, Node, black, forms, is_black, key
from scenec.compiler.light.latlong import far_ground, horizontal_irradiance, luminance
from scenec.compiler.light.sky import ROWS, Sky, SkyAndSun
from scenec.compiler.scene.light import SkyLight, SunDisc

#: Mean cosine of the angle by which droplets of clouds turn light (Hu and Stamnes 1993).
ASYMMETRY = 0.85
#: A beam of which less is left is no sun any more.
NIL = 1e-6


@dataclass(frozen=True, kw_only=True)
class OvercastSky(Sky):
    """The CIE's standard overcast sky, three times as bright overhead as at the horizon. light.sun
    is the sun above the cloud; what comes through sets the brightness. The beam is gone, but behind
    thin cloud under a high sun.
    """

    EXAMPLE: ClassVar = {
        "type": "overcast",
        "optical_depth": {"type": "log_uniform", "min": 10, "max": 60},
    }

    optical_depth: Array = key(forms.PER_SAMPLE, default=40, at_least=5, at_most=1000)
    """Straight down: 10 is bright, 40 usual, 100 a thunderstorm."""
    irradiance: Array | None = key(
        forms.PER_SAMPLE, optional=True, above=0, at_most=1_000_000_000_000, unit="W/m²"
    )
    """Diffuse irradiance on a horizontal surface, in place of what the cloud lets through."""
    color: Array = key(forms.COLOR, default=[0.92, 0.96, 1])
    """Color of the sky, relative. Not black."""
    ground_color: Array = key(forms.GROUND_COLOR)
    resolution: int = key(ROWS)

    @staticmethod
    def check(node: Node) -> Iterator[Finding]:
        """Yields whether it can be black, or has no light."""
        if is_black(node):
            yield node.fault(black("an irradiance"), "color")
        if node.whole().at("light").entries.get("sun", {}) is None and "irradiance" not in node:
            yield node.fault("expected the key irradiance, or a sun above the cloud (light.sun)")

    def build(self, sun: SunDisc | None, samples: int) -> SkyAndSun:
        """Returns pictures of overcast skies, and what is left of the sun.

        A picture is of irradiance 1, so that samples that differ in strength alone share it.

        Args:
            sun: Above the clouds; None only where the plan has an irradiance.
            samples: How many.
        """
        strength = self.irradiance
        tint = self.color / luminance(self.color)[:, None]
        left = np.zeros(samples)
        if sun is not None:
            sine = np.array([sun.direction(i)[2] for i in range(samples)])
            total, left = transmitted(self.optical_depth, sine)
            if strength is None:
                diffuse = sun.irradiance * np.maximum(sine, 0.0) * (total - left)
                back = self.ground_color * reflected(self.optical_depth)[:, None]
                tint = tint * (1.0 / (1.0 - back))
                strength = diffuse * luminance(tint)
        assert strength is not None, "an overcast sky without a sun or an irradiance"
        tint = tint / luminance(tint)[:, None]
        pictures: dict[str, NDArray[np.float32]] = {}
        names: dict[bytes, str] = {}
        texture = []
        for i in range(samples):
            key = np.concatenate([tint[i], self.ground_color[i]]).tobytes()
            if key not in names:
                names[key] = f"sky_{i:04d}.exr"
                picture = overcast_sky(self.resolution, tint[i], self.ground_color[i])
                pictures[names[key]] = picture
            texture.append(names[key])
        sky = SkyLight({**pictures}, tuple(texture), strength, np.zeros(samples))
        return sky, None if sun is None else replace(sun, irradiance=sun.irradiance * left), {}


def transmitted(
    depth: NDArray[np.float64], sine: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Shares of a beam that come through a layer over black ground: of all of it, and direct.

    Eddington's approximation for droplets that absorb nothing (Shettle and Weinman 1970, J. Atmos.
    Sci. 27); scaling the forward peak out (Joseph, Wiscombe and Weinman 1976) leaves it as it is,
    but for the part that counts as direct, which is the true beam here.

    Args:
        depth: Optical depth, [s].
        sine: Of the beam's height, [s]; from below nothing comes through.
    """
    up = np.maximum(sine, 1e-9)
    direct = elementary.exp_array(-depth / up)
    within = elementary.exp_array(-(1.0 - ASYMMETRY * ASYMMETRY) * depth / up)
    total = 2.0 + 3.0 * up + (2.0 - 3.0 * up) * within
    total /= 4.0 + 3.0 * (1.0 - ASYMMETRY) * depth
    risen = sine > 0.0
    return np.where(risen, total, 0.0), np.where(risen & (direct >= NIL), direct, 0.0)


def reflected(depth: NDArray[np.float64]) -> NDArray[np.float64]:
    """Share of diffuse light from the ground that the layer throws back, [s]."""
    lost = 3.0 * (1.0 - ASYMMETRY) * depth
    return lost / (4.0 + lost)


def overcast_sky(
    height: int, color: NDArray[np.float64], ground_color: NDArray[np.float64]
) -> NDArray[np.float32]:
    """Radiance of an overcast sky, and of far ground below the horizon.

    L = Lz (1 + 2 sin(elevation)) / 3 (Moon and Spencer 1942), which is type 16 of ISO 15469:2004
    (CIE S 011), the traditional overcast sky: three times as bright overhead as at the horizon, all
    around alike, and of irradiance 7 pi / 9 Lz on level ground.

    Args:
        height: Rows of the picture; it is twice as wide.
        color: Linear Rec.709 of luminance 1, [3]: the irradiance on level ground.
        ground_color: Albedo of the far ground, [3].

    Returns:
        float32 [height, 2 * height, 3], W/(m^2 sr).
    """
    picture = np.zeros((height, 2 * height, 3))
    polar = elementary.PI * (np.arange(height // 2) + 0.5) / height
    rows = (1.0 + 2.0 * elementary.cos_array(polar)) / 3.0
    picture[: height // 2] = rows[:, None, None]
    # The irradiance is that of the texels, whatever their number.
    level = horizontal_irradiance(picture)[0]
    picture *= color / level
    far_ground(picture, ground_color * color / elementary.PI)
    return picture.astype(np.float32)
