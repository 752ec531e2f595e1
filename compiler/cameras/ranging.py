"""Declares what measures distances: depth cameras and lidars."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator
from dataclasses import astuple, dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.cameras.mount import Mount, Trigger
from scenec.compiler.kinds import Context, Finding, Node, an, bounded, forms, key, list_of
from scenec.compiler.scene import rig
from scenec.schemas.depth_camera import DepthCamera, StereoDepth, TimeOfFlightDepth
from scenec.schemas.errors import SceneError
from scenec.schemas.lidar import (
    MOST_DEG,
    MOST_RAYS,
    MOST_RETURNS,
    LidarDetection,
    LidarFootprint,
    LidarIntensity,
)
from scenec.schemas.spelling import shown

_RANGE_M = list_of(bounded(forms.CONSTANT, at_least=0, at_most=1e9, unit="m"), "A bound.", count=2)
_DISTANCE = bounded(forms.CONSTANT, at_least=0, at_most=1_000_000_000, unit="m")
_UPWARD = bounded(forms.CONSTANT, at_least=-90, at_most=90, unit="°")
_AROUND = bounded(forms.CONSTANT, at_least=-720, at_most=720, unit="°")
#: Bounds of a ray's elevation and azimuth: those of the keys above.
_ANGLES = (90.0, 720.0)
#: What a lidar says of its rays itself, where it has no pattern.
_GRID = ("beams", "elevation_deg", "elevations_deg", "azimuths", "azimuth_deg")


@dataclass(frozen=True, kw_only=True)
class Stereo:
    """Depth from a pair: the sensor's camera and one to its right. No answer where the other does
    not see the point.
    """

    EXAMPLE: ClassVar = {
        "type": "stereo",
        "baseline_m": 0.055,
        "noise_px": 0.1,
        "step_px": 0.125,
        "range_m": [0.4, 10],
    }

    TITLE: ClassVar = "Stereo depth"
    baseline_m: float = key(forms.LENGTH_PER_BATCH, above=0, at_most=1000000.0)
    """Distance of the two cameras."""
    noise_px: float = key(forms.PER_BATCH, default=0.2, at_least=0, at_most=1000, unit="px")
    """Standard deviation of disparities."""
    step_px: float = key(forms.PER_BATCH, default=0.0625, at_least=0, at_most=1000, unit="px")
    """Disparities are multiples of it; 0: any number."""
    range_m: tuple[float, float] = key(_RANGE_M, default=[0.3, 50])
    """Nearest and farthest depth that is answered."""
    bias_px: float = key(
        forms.PER_BATCH, default=0, sparse=True, at_least=-100, at_most=100, unit="px"
    )
    """Offset of all disparities; above 0, depths are short."""
    edge_px: float = key(forms.PER_BATCH, default=0, sparse=True, at_least=0, at_most=64, unit="px")
    """No answer within so many pixels of a step of disparity above one pixel."""
    lost: float = key(forms.FRACTION_PER_BATCH, default=0, sparse=True)
    """Share of answers lost by chance: 1 less the fill rate."""

    def draw(self, context: Context) -> DepthCamera:
        """Returns what measures."""
        return DepthCamera(StereoDepth(**vars(self)), context.key("noise"))


@dataclass(frozen=True, kw_only=True)
class TimeOfFlight:
    """Depth from the phase of modulated light: noise in sunlight, which grows with the square of
    the range and with slant.
    """

    EXAMPLE: ClassVar = {
        "type": "time_of_flight",
        "noise_m": 0.005,
        "ambiguity_m": 7.5,
        "range_m": [0.3, 6],
    }

    TITLE: ClassVar = "Time-of-flight depth"
    noise_m: float = key(forms.LENGTH_PER_BATCH, default=0.01, at_least=0, at_most=1000)
    """Standard deviation of ranges at at_m, of a facing surface."""
    at_m: float = key(forms.LENGTH_PER_BATCH, default=2, above=0, at_most=1000000.0)
    """Range of that."""
    ambiguity_m: float = key(forms.LENGTH_PER_BATCH, default=15, above=0, at_most=1000000000.0)
    """Ranges are told modulo this, c / (2 f): 15 m at 10 MHz."""
    blur_px: float = key(forms.PER_BATCH, default=0.4, at_least=0, at_most=16, unit="px")
    """Standard deviation of a pixel's spot; at outlines ranges mix."""
    range_m: tuple[float, float] = key(_RANGE_M, default=[0.1, 15])
    """Nearest and farthest range that is answered."""
    bias_m: float = key(
        forms.LENGTH_PER_BATCH, default=0, sparse=True, at_least=-1000, at_most=1000
    )
    """What all ranges are off by."""
    lost: float = key(forms.FRACTION_PER_BATCH, default=0, sparse=True)
    """Share of answers lost by chance: 1 less the fill rate."""

    def draw(self, context: Context) -> DepthCamera:
        """Returns what measures."""
        return DepthCamera(TimeOfFlightDepth(**vars(self)), context.key("noise"))


@dataclass(frozen=True, kw_only=True)
class LidarNoiseKeys:
    """Errors of a lidar, drawn from seed, batch, sample and its name alone."""

    EXAMPLE: ClassVar = {"range_m": 0.02, "dropout": 0.01}

    TITLE: ClassVar = "Lidar's noise"
    range_m: float = key(forms.LENGTH_PER_BATCH, default=0.02, at_least=0, at_most=1000)
    """Standard deviation of ranges, whatever the range."""
    range_ratio: float = key(forms.FRACTION_PER_BATCH, default=0)
    """Relative standard deviation of ranges, added in square to range_m."""
    angle_deg: float = key(forms.ANGLE_PER_BATCH, default=0, at_least=0, at_most=10)
    """Standard deviation of azimuth and elevation: the beam meets what lies that far beside its
    nominal direction."""
    dropout: float = key(forms.FRACTION_PER_BATCH, default=0)
    """Share of answers that are lost."""


@dataclass(frozen=True, kw_only=True)
class LidarIntensityKeys:
    """Intensity: reflectance at the laser's wavelength times the cosine of incidence, and with at_m
    over squared range. Reflectance is a weighted sum of the cameras' colors; gloss counts as matte.
    """

    EXAMPLE: ClassVar = {"bands": [1, 0, 0], "at_m": 10}

    TITLE: ClassVar = "Lidar's intensity"
    bands: tuple[float, float, float] = key(
        list_of(bounded(forms.CONSTANT, at_least=-10, at_most=10), "Of one color.", count=3),
        default=list(LidarIntensity.bands),
    )
    """Weights of red, green and blue; red is nearest to 850 to 1550 nm."""
    at_m: float = key(
        forms.LENGTH_PER_BATCH, default=LidarIntensity.at_m, at_least=0, at_most=1_000_000
    )
    """Range at which a white facing surface has intensity 1, which falls with squared range; 0:
    calibrated away."""


@dataclass(frozen=True, kw_only=True)
class LidarFootprintKeys:
    """The width of a lidar's beams, which then may have several returns."""

    EXAMPLE: ClassVar = {"divergence_deg": 0.18, "rays": 37, "separation_m": 0.6, "returns": 2}

    TITLE: ClassVar = "Lidar's beam"
    divergence_deg: float = key(forms.ANGLE_PER_BATCH, at_least=0, at_most=MOST_DEG)
    """Full angle of a Gaussian beam, to 1/e² of its power."""
    rays: int = key(forms.COUNT, default=LidarFootprint.rays, at_least=1, at_most=MOST_RAYS)
    """Rays of equal energy that sample a beam; one alone goes along its axis."""
    separation_m: float = key(
        forms.LENGTH_PER_BATCH, default=LidarFootprint.separation_m, at_least=0, at_most=1000
    )
    """Ranges that differ by more make returns of their own: half the length of a pulse."""
    returns: int = key(
        forms.COUNT, default=LidarFootprint.returns, at_least=1, at_most=MOST_RETURNS
    )
    """Most returns that are told: the strongest, nearest first."""


@dataclass(frozen=True, kw_only=True)
class LidarDetectionKeys:
    """Detects returns whose energy (reflectance times cosine over squared range, plus noise)
    reaches a threshold, as data sheets state ranges by reflectance.
    """

    EXAMPLE: ClassVar = {"range_m": 100, "reflectance": 0.1, "probability": 0.9, "noise": 0.1}

    TITLE: ClassVar = "Lidar's detection"
    range_m: float = key(forms.LENGTH_PER_BATCH, above=0, at_most=1_000_000)
    """Range at which a facing surface of that reflectance has that probability."""
    reflectance: float = key(
        forms.PER_BATCH, default=LidarDetection.reflectance, above=0, at_most=1
    )
    """Reflectance of that surface."""
    probability: float = key(forms.PER_BATCH, default=LidarDetection.probability, above=0, below=1)
    """Probability that its return is detected."""
    noise: float = key(forms.PER_BATCH, default=LidarDetection.noise, at_least=0, at_most=10)
    """Standard deviation of the energy, as a share of the threshold; 0: a sharp one."""


class ScanPattern(ABC):
    """Defines where the rays of a lidar go, in another package."""

    @abstractmethod
    def rays(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Returns elevation and azimuth of each ray, degrees, each float64 [beams, azimuths].

        Elevations are upward, azimuths counterclockwise from above, 0 ahead; rows are in the order
        in which a beam takes its rays.
        """


@dataclass(frozen=True, kw_only=True)
class LidarKeys:
    """A scanner that turns beams of fixed elevations about its upward axis, or follows another
    package's pattern. A scan is of one instant. Give azimuths and beams or elevations_deg, or a
    pattern.
    """

    EXAMPLE: ClassVar = {
        "beams": 32,
        "elevation_deg": [10, -30],
        "azimuths": 900,
        "range_m": [0.5, 100],
    }

    KEYWORDS: ClassVar = {"if": {"required": ["pattern"]}, "else": {"required": ["azimuths"]}}

    mount: Mount = key(an("mount", drawn=True), default={})
    """Where the lidar sits on the rig; unturned it looks ahead, as a camera does."""
    beams: int | None = key(forms.COUNT, optional=True, at_least=1, at_most=65_536)
    """Number of beams, evenly spaced over elevation_deg."""
    elevation_deg: tuple[float, float] = key(
        list_of(_UPWARD, "Upward.", count=2), default=[15, -15]
    )
    """Elevations of the first and the last beam."""
    elevations_deg: tuple[float, ...] | None = key(
        list_of(_UPWARD, "Upward.", least=1, most=65536), optional=True
    )
    """Elevation of each beam."""
    azimuths: int | None = key(forms.COUNT, optional=True, at_least=1, at_most=1_048_576)
    """Directions of each beam in a scan, evenly spaced over azimuth_deg."""
    azimuth_deg: tuple[float, float] = key(
        list_of(_AROUND, "Counterclockwise from above.", count=2), default=[180, -180]
    )
    """First azimuth, and where the next scan would begin; 0 is ahead, 90 left."""
    pattern: ScanPattern | None = key(an("scan_pattern", drawn=True), sparse=True)
    """Where its rays go, in place of beams, elevations and azimuths."""
    range_m: tuple[float, float] = key(
        list_of(_DISTANCE, "Along the beam.", count=2), default=[0.5, 120]
    )
    """Nearest and farthest range that is answered."""
    noise: LidarNoiseKeys = key(an("lidar_noise", drawn=True), default={})
    """What is wrong with its answers."""
    intensity: LidarIntensityKeys | None = key(an("lidar_intensity", drawn=True), sparse=True)
    """How it tells intensities; left out, it tells none."""
    footprint: LidarFootprintKeys | None = key(an("lidar_footprint", drawn=True), sparse=True)
    """Width of its beams; left out, they have none, and one return each."""
    detection: LidarDetectionKeys | None = key(an("lidar_detection", drawn=True), sparse=True)
    """Which returns are strong enough; left out, all are."""
    trigger: Trigger = key(an("trigger", drawn=True), default={})
    """At which samples it scans."""

    @staticmethod
    def check(node: Node) -> Iterator[Finding]:
        """Finds what does not go together."""
        name = str(node.path[-1])
        if name in node.whole().at(*node.path[:-2], "sensors"):
            yield node.fault(f"a sensor has the name {shown(name)}, too")
        if "pattern" in node:
            for of_grid in _GRID:
                yield from node.both("pattern", of_grid, "where its rays go")
        else:
            yield from node.either("beams", "elevations_deg", "how many beams there are")
        low, high = node["range_m"] or (0.0, 0.0)
        if low > high:
            yield node.fault(f"expected the nearest range first: {high:g}, {low:g}", "range_m")
        low, high = node["azimuth_deg"] or (0.0, 360.0)
        if not 0.0 < abs(high - low) <= 360.0:
            yield node.fault(
                f"spans {abs(high - low):g} degrees, expected above 0, at most 360", "azimuth_deg"
            )

    def draw(self, context: Context) -> rig.Lidar:
        """Returns the scanner, which has the name that its path ends with.

        Raises:
            SceneError: Its pattern returns what are no rays.
        """
        rays = None if self.pattern is None else _rays(self.pattern)
        if self.elevations_deg is not None:
            elevations = np.array(self.elevations_deg, np.float64)
        else:
            beams, (first, last) = self.beams or 0, self.elevation_deg
            elevations = first + (last - first) * np.arange(beams) / max(beams - 1, 1)
        return rig.Lidar(
            name=context.path.rpartition("/")[2],
            to_rig=self.mount.to_rig,
            elevations_deg=elevations,
            azimuths=self.azimuths or 0,
            azimuth_deg=self.azimuth_deg,
            range_m=self.range_m,
            noise=rig.LidarErrors(**vars(self.noise)),
            noise_key=context.key("noise/key"),
            trigger=astuple(self.trigger),
            rays=rays,
            intensity=None if self.intensity is None else LidarIntensity(**vars(self.intensity)),
            footprint=None if self.footprint is None else LidarFootprint(**vars(self.footprint)),
            detection=None if self.detection is None else LidarDetection(**vars(self.detection)),
        )


def _rays(pattern: ScanPattern) -> NDArray[np.float64]:
    """Returns elevation and azimuth of each ray, [beams, azimuths, 2]; checks what was returned."""
    answer: Any = pattern.rays()
    try:
        rays = np.stack([np.asarray(angles, np.float64) for angles in answer], axis=-1)
    except (TypeError, ValueError):
        rays = np.zeros(0)
    of_shape = rays.ndim == 3 and rays.shape[2] == 2 and rays.size
    if not of_shape or not (np.abs(rays) <= _ANGLES).all():
        who = f"scan pattern {type(pattern).__module__}:{type(pattern).__qualname__}"
        raise SceneError(
            f"{who}: returned {' '.join(repr(answer).split()):.60}: expected elevations and "
            "azimuths (each float64 [beams, azimuths]) from -90 to 90 and from -720 to 720 degrees"
        )
    return rays
