"""What was drawn for a batch's light: the part of the Plan that this room reads."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.scene import Haze, SunLight


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
class ImageSkyPlan:
    """A measured sky.

    Attributes:
        files: Picture of each sample.
        strength, rotation_deg: [s].
    """

    files: tuple[Path, ...]
    strength: NDArray[np.float64]
    rotation_deg: NDArray[np.float64]


@dataclass(frozen=True)
class LightPlan:
    """All light of a batch.

    Attributes:
        sun: The sun; None for none.
        sky: What surrounds the scene; None for black.
        more_suns: Further distant discs, by prim name.
        haze: Between cameras and the scene.
    """

    sun: SunLight | None
    sky: ClearSkyPlan | ImageSkyPlan | None
    more_suns: dict[str, SunLight] = field(default_factory=dict)
    haze: Haze | None = None
