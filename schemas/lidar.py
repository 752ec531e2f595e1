"""Describes what lidars receive of their light, for cfgs, stages and scans.

Of a surface at the range r a beam gets back energy in proportion to reflectance * cos(incidence) /
r^2 (the lidar equation, of targets that scatter as Lambert's law says and are larger than the
beam; Wagner et al., ISPRS J. Photogrammetry 60 (2006) 100): 1 of a white one that faces the lidar
at 1 m.

A stage lists the four numbers of each model in the order of its fields.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import astuple, dataclass

#: Rays and returns of a beam: beyond, sorting costs more than casting. Its divergence: tangents.
MOST_RAYS, MOST_RETURNS, MOST_DEG = 1024, 16, 30.0


@dataclass(frozen=True, kw_only=True)
class LidarIntensity:
    """Says how intensities are told; fields are the cfg's keys.

    Attributes:
        bands: Weights of red, green and blue base colors in the reflectance at the laser's
            wavelength.
        at_m: Intensity is 1 of a white surface that faces the lidar there, and falls with the
            square of the range; 0: it is reflectance times cosine, whatever the range.
    """

    bands: tuple[float, float, float] = (1.0, 0.0, 0.0)
    at_m: float = 0.0


@dataclass(frozen=True, kw_only=True)
class LidarFootprint:
    """Describes a beam that has a width; fields are the cfg's keys.

    Attributes:
        divergence_deg: Full angle out to 1/e^2 of the middle's power per solid angle; Gaussian.
        rays: Exact rays of equal energy that sample it.
        separation_m: What is farther apart than this, along the beam, makes returns of its own.
        returns: Most returns that are told: the strongest.
    """

    divergence_deg: float
    rays: int = 19
    separation_m: float = 0.5
    returns: int = 2


@dataclass(frozen=True, kw_only=True)
class LidarDetection:
    """Says which returns are detected; fields are the cfg's keys.

    Attributes:
        range_m: At this range a surface of ``reflectance`` that faces the lidar and fills the beam
            is detected with ``probability``.
        noise: Standard deviation of the energy received, as a share of the threshold.
    """

    range_m: float
    reflectance: float = 0.1
    probability: float = 0.5
    noise: float = 0.1


def as_numbers(model: LidarIntensity | LidarFootprint | LidarDetection) -> list[float]:
    """Lists the four numbers of a model."""
    first, *others = astuple(model)
    return [float(x) for x in (*(first if isinstance(first, tuple) else (first,)), *others)]


def intensity_of(numbers: Sequence[float]) -> LidarIntensity:
    """Makes a model of its four numbers.

    Raises:
        ValueError: They are none of such a model.
    """
    red, green, blue, at_m = numbers
    return LidarIntensity(bands=(red, green, blue), at_m=_sound("at_m", at_m, at_m >= 0.0))


def footprint_of(numbers: Sequence[float]) -> LidarFootprint:
    """Makes a model of its four numbers; raises as ``intensity_of``."""
    divergence, rays, separation, returns = numbers
    return LidarFootprint(
        divergence_deg=_sound("divergence_deg", divergence, 0.0 <= divergence <= MOST_DEG),
        rays=int(_sound("rays", rays, rays in range(1, MOST_RAYS + 1))),
        separation_m=_sound("separation_m", separation, separation >= 0.0),
        returns=int(_sound("returns", returns, returns in range(1, MOST_RETURNS + 1))),
    )


def detection_of(numbers: Sequence[float]) -> LidarDetection:
    """Makes a model of its four numbers; raises as ``intensity_of``."""
    reach, reflectance, chance, noise = numbers
    return LidarDetection(
        range_m=_sound("range_m", reach, reach > 0.0),
        reflectance=_sound("reflectance", reflectance, reflectance > 0.0),
        probability=_sound("probability", chance, 0.0 < chance < 1.0),
        noise=_sound("noise", noise, noise >= 0.0),
    )


def _sound(name: str, value: float, fine: bool) -> float:
    if not fine:
        raise ValueError(f"{name} is {value:g}")
    return value
