"""Defines what was drawn for a batch's light: a part of the Plan."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.scene.light import Haze, SpotLight, SunLight


@dataclass(frozen=True)
class ClearSkyPlan:
    """A sky to be baked, one a sample.

    Attributes:
        resolution: Rows of the picture.
        irradiance: Diffuse, on level ground, [s].
        zenith_color, horizon_color, ground_color: [s, 3].
    """

    resolution: int
    irradiance: NDArray[np.float64]
    zenith_color: NDArray[np.float64]
    horizon_color: NDArray[np.float64]
    ground_color: NDArray[np.float64]


@dataclass(frozen=True)
class OvercastSkyPlan:
    """A sky behind one even layer of cloud.

    Attributes:
        resolution: Rows of the picture.
        optical_depth: Of the layer, [s].
        color, ground_color: [s, 3].
        irradiance: Diffuse, on level ground, [s]; None: what comes through of the sun.
    """

    resolution: int
    optical_depth: NDArray[np.float64]
    color: NDArray[np.float64]
    ground_color: NDArray[np.float64]
    irradiance: NDArray[np.float64] | None = None


@dataclass(frozen=True)
class AtmospherePlan:
    """A planet's sky to be baked, one a sample.

    Attributes:
        planet: "earth", "mars" or "moon".
        scattering: "single" or "multiple".
        resolution: Rows of the picture.
        air_density, dust_density, ozone_density: Factors, [s].
        altitude_m: Of the scene, [s].
        ground_color: [s, 3].
    """

    planet: str
    scattering: str
    resolution: int
    air_density: NDArray[np.float64]
    dust_density: NDArray[np.float64]
    ozone_density: NDArray[np.float64]
    altitude_m: NDArray[np.float64]
    ground_color: NDArray[np.float64]


@dataclass(frozen=True)
class LabelMapPlan:
    """A label map as the cfg has it.

    Attributes:
        ids: Pixel values, as the cfg writes them, and the label id of each.
    """

    file: Path
    ids: tuple[tuple[str, int], ...]


@dataclass(frozen=True)
class ImageSkyPlan:
    """A measured sky.

    Attributes:
        files: Picture of each sample.
        strength, rotation_deg: [s].
        extract_sun: Whether the pictures' sun becomes a distant light.
        label_maps: Per level that has any, the label map of each sample, or None.
    """

    files: tuple[Path, ...]
    strength: NDArray[np.float64]
    rotation_deg: NDArray[np.float64]
    extract_sun: bool = False
    label_maps: dict[str, tuple[LabelMapPlan | None, ...]] = field(default_factory=dict)


@dataclass(frozen=True)
class CumulusPlan:
    """A layer of cumulus.

    Attributes:
        key: Of its pattern.
        size_m: Of a cloud with the gap beside it.
        coverage: Share of the ground below clouds, [s].
        optical_depth: Of the tallest, straight down, [s].
        base_m: Height of the base over the world's z = 0, [s].
        thickness_m: Of the tallest, [s].
        offset_m: Of the pattern to the east and to the north, [s, 2].
    """

    key: int
    size_m: float
    coverage: NDArray[np.float64]
    optical_depth: NDArray[np.float64]
    base_m: NDArray[np.float64]
    thickness_m: NDArray[np.float64]
    offset_m: NDArray[np.float64]


@dataclass(frozen=True)
class CirrusPlan:
    """A sheet of cirrus.

    Attributes:
        key, size_m, coverage, offset_m: As in ``CumulusPlan``; the size is the width of streaks.
        optical_depth: Where it is thickest, [s].
        height_m: Over the world's z = 0, [s].
        bearing_deg: That streaks run along, [s].
    """

    key: int
    size_m: float
    coverage: NDArray[np.float64]
    optical_depth: NDArray[np.float64]
    height_m: NDArray[np.float64]
    bearing_deg: NDArray[np.float64]
    offset_m: NDArray[np.float64]


@dataclass(frozen=True)
class CloudsPlan:
    """Clouds to be drawn into the sky.

    Attributes:
        resolution: Rows of the sky's picture with them, if it has fewer without.
        cumulus, cirrus: None for none.
    """

    resolution: int
    cumulus: CumulusPlan | None
    cirrus: CirrusPlan | None


@dataclass(frozen=True)
class RigMount:
    """A lamp's place on a rig: the rig's name, and the lamp-to-rig matrix [4, 4], both OpenCV."""

    rig: str
    to_rig: NDArray[np.float64]


@dataclass(frozen=True)
class WorldMount:
    """A lamp's place in the world.

    Attributes:
        position: [s, 3]; z is the height over the ground or over 0.
        bearing_deg, elevation_deg: Where it shines without a target, [s].
        target: Where it shines to, as ``position``, or None.
    """

    position: NDArray[np.float64]
    on_ground: bool
    bearing_deg: NDArray[np.float64]
    elevation_deg: NDArray[np.float64]
    target: NDArray[np.float64] | None


@dataclass(frozen=True, kw_only=True)
class LampPlan(SpotLight):
    """A spot light, and what carries it."""

    mount: RigMount | WorldMount


@dataclass(frozen=True)
class LightPlan:
    """All light of a batch.

    Attributes:
        sun: The sun; None for none. Above an atmosphere its color is a factor on that of sunlight;
            with an overcast sky it is the sun above the clouds.
        sky: What surrounds the scene; None for black.
        clouds: Before an atmosphere or a clear sky.
        more_suns: Further distant discs, by prim name.
    """

    sun: SunLight | None
    sky: ClearSkyPlan | OvercastSkyPlan | AtmospherePlan | ImageSkyPlan | None
    more_suns: dict[str, SunLight] = field(default_factory=dict)
    haze: Haze | None = None
    clouds: CloudsPlan | None = None
    lamps: tuple[LampPlan, ...] = ()

    @property
    def lit(self) -> bool:
        """Whether there is a sun, a sky or a lamp."""
        return self.sun is not None or self.sky is not None or bool(self.lamps)
