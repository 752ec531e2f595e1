"""Defines suns, skies, haze and lamps, a part of the Scene's vocabulary."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.arithmetic import elementary
from scenec.schemas.records import SolarTime


@dataclass(frozen=True)
class Gobo:
    """Shadows that clouds throw: pictures over the plane square to the sun, at every sample.

    Attributes:
        pictures: By file name, shares of the sun's light that come through, uint16 [h, w] from 0
            to 65535; as seen from the sun, the top row toward the second axis of
            ``poses.facing``. Mirrored beyond their borders.
        texture: File name in ``pictures`` for each sample; "": all of the light comes through.
        middle_m: Of the picture, along both axes from the world's origin, [s, 2].
        size_m: Width and height of the picture, [s, 2].
        mean: Of the picture, [s].
    """

    pictures: dict[str, NDArray[np.uint16]]
    texture: tuple[str, ...]
    middle_m: NDArray[np.float64]
    size_m: NDArray[np.float64]
    mean: NDArray[np.float64]


@dataclass(frozen=True)
class SunDisc:
    """The sun at every sample.

    Attributes:
        azimuth_deg, elevation_deg: Compass bearing (clockwise from north, +y) and height, [s].
        irradiance: On a surface facing it, W/m^2, [s].
        diameter_deg: Full angular diameter, [s].
        color: Linear Rec.709, [s, 3], of luminance 1.
        gobo: What it shines through, or None.
        times: Of a sun that was computed, what time it is at every sample.
    """

    azimuth_deg: NDArray[np.float64]
    elevation_deg: NDArray[np.float64]
    irradiance: NDArray[np.float64]
    diameter_deg: NDArray[np.float64]
    color: NDArray[np.float64]
    gobo: Gobo | None = None
    times: tuple[SolarTime, ...] = ()

    def direction(self, sample: int) -> tuple[float, float, float]:
        """Unit vector to the sun."""
        azimuth = float(self.azimuth_deg[sample]) * elementary.PI / 180.0
        elevation = float(self.elevation_deg[sample]) * elementary.PI / 180.0
        level = elementary.cos(elevation)
        return (
            level * elementary.sin(azimuth),
            level * elementary.cos(azimuth),
            elementary.sin(elevation),
        )


@dataclass(frozen=True)
class SkyLight:
    """The sky at every sample.

    Attributes:
        pictures: Lat-long pictures by file name: float32 [h, w, 3] made by us, or a file to copy.
        texture: File name in ``pictures`` for each sample.
        intensity: Factor on the picture, [s].
        rotation_deg: Turn of the picture about the vertical, clockwise from above, [s].
        sharp: Whether places in the pictures are so bright that single objects cast shadows of
            them: a sun that was left in, lamps.
    """

    pictures: dict[str, NDArray[np.float32] | Path]
    texture: tuple[str, ...]
    intensity: NDArray[np.float64]
    rotation_deg: NDArray[np.float64]
    sharp: bool = False


@dataclass(frozen=True)
class SkyLabelMaps:
    """Labels of a panorama's pixels: the sky's, and the hills' that are on it.

    Attributes:
        pictures: Lat-long pictures of label ids by file name, uint16 [h, w].
        texture: Per level, the file name for each sample, or None: the sky's one label.
        rotation_deg: As in ``SkyLight``, [s].
    """

    pictures: dict[str, NDArray[np.uint16]]
    texture: dict[str, tuple[str | None, ...]]
    rotation_deg: NDArray[np.float64]


@dataclass(frozen=True)
class Haze:
    """Dust or mist between the camera and what it sees, at every sample.

    Attributes:
        extinction: Per meter, at the world's z = 0, linear Rec.709, [s, 3].
        scale_height_m: It thins out as exp(-z / this), [s].
        asymmetry: g of its phase function, [s].
        albedo: Part of the light it meets that it scatters, linear Rec.709, [s, 3].
        airlight: Radiance that a ray through endless haze shows, [s, 3]; None: what it scatters of
            suns and sky.
    """

    extinction: NDArray[np.float64]
    scale_height_m: NDArray[np.float64]
    asymmetry: NDArray[np.float64]
    albedo: NDArray[np.float64]
    airlight: NDArray[np.float64] | None


@dataclass(frozen=True, kw_only=True)
class SpotLight:
    """A sphere that shines into a cone, at every sample.

    Attributes:
        name: Prim name.
        intensity: On the axis, far away, linear Rec.709, W/sr, [s, 3].
        radius_m: Of the sphere, [s].
        cone_deg: Half the cone's opening angle, [s].
        softness: Share of that angle over which it fades to 0, [s].
    """

    name: str
    intensity: NDArray[np.float64]
    radius_m: NDArray[np.float64]
    cone_deg: NDArray[np.float64]
    softness: NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class Lamp(SpotLight):
    """A spot light at its place.

    Attributes:
        to_world: Matrices, column vectors, [s, 4, 4]: it stands at the origin and shines along -z.
    """

    to_world: NDArray[np.float64]
