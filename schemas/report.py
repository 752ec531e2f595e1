"""The report of a batch, ``report.json``: what was built, erred and left out, as steps wrote it.

``facts`` are those that a kind reports of its own. The compiler writes more than is read here.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from scenec.schemas.codec import JSON, Natural, omitted, read_record, rest
from scenec.schemas.errors import OutputError

Texels = tuple[Natural, Natural]


def _beside(other: str) -> Callable[[Mapping[str, Any]], bool]:
    return lambda given: other in given


@dataclass(frozen=True, kw_only=True)
class ReliefFacts:
    """A step of the relief."""

    type: str
    facts: Mapping[str, JSON] = rest()


@dataclass(frozen=True, kw_only=True)
class HeightFacts:
    """Records how a DEM's samples became heights, among the facts of its step."""

    scale: float = 1.0
    offset: float = 0.0
    unit_m: float = 1.0
    band: JSON = None


@dataclass(frozen=True, kw_only=True)
class IterationFacts:
    """Records how far an iteration came, among the facts of its step."""

    steps: Natural = 0
    error_rms_m: float | None = None
    error_aim_m: float = math.inf
    last_iteration_m: float | None = None


@dataclass(frozen=True, kw_only=True)
class CraterFacts:
    """Counts craters, and those too narrow for the grid, among the facts of their step."""

    craters: Natural
    craters_below_grid: Natural


@dataclass(frozen=True, kw_only=True)
class ConditionFacts:
    """A condition of a ground layer: the share of the ground on which it holds."""

    type: str
    holds: float
    smoothed_over_m: float | None = None


@dataclass(frozen=True, kw_only=True)
class CoverFacts:
    """A ground layer: the share of the ground that it covers, and on which it shows."""

    layer: Natural
    covers: float
    shows: float
    conditions: tuple[ConditionFacts, ...]


@dataclass(frozen=True, kw_only=True)
class FinerFacts:
    """The surface between samples: its error there, and at how many points it was looked at."""

    surface_error_rms_px: float
    checked_points: Natural
    finest_leg_m: float
    surface_error_found_px: float
    surface_error_found_m: float


@dataclass(frozen=True, kw_only=True)
class MeshFacts:
    """The adaptive mesh of the ground."""

    triangles: Natural
    triangles_of_grid: Natural
    tolerance_px: float
    tolerance_reached_px: float
    budget_bound: bool
    height_error_max_px: float
    height_error_max_m: float = 0.0
    label_error_max_px: float | None = omitted()
    finer: FinerFacts | None = None


@dataclass(frozen=True, kw_only=True)
class CutFacts:
    """A line along which labels cut the ground."""

    chord_error_rms_m: float
    chord_error_max_m: float
    snap_max_m: float


@dataclass(frozen=True, kw_only=True)
class GroundFacts:
    """The ground's meshes."""

    faces: Natural
    float32_error_max_m: float
    mesh: MeshFacts | None = None
    cuts: tuple[CutFacts, ...]


@dataclass(frozen=True, kw_only=True)
class LevelFacts:
    """A level of detail: meters from the finest, of an object of scale 1."""

    error: float


@dataclass(frozen=True, kw_only=True)
class LodFacts:
    """Records the levels of detail that were chosen, among the facts of a class of objects."""

    triangles: Natural
    lod_error_max_px: float = 0.0
    lod_error_max_m: float


@dataclass(frozen=True, kw_only=True)
class ClassFacts:
    """A class of objects."""

    count: Natural
    asked_for: Natural | None = omitted()
    triangles: Natural
    triangles_finest: Natural | None = omitted()
    lod_px: float = omitted(0.0, needed=_beside("triangles_finest"))
    lod_error_max_px: float = omitted(0.0, needed=_beside("triangles_finest"))
    gap_max_px: float | None = omitted()
    float_max_m: float = omitted(0.0, needed=_beside("gap_max_px"))
    sink_max_m: float = omitted(0.0, needed=_beside("gap_max_px"))
    seating_error_max_m: float | None = omitted()
    moved_off_cameras: Natural | None = omitted()
    float32_error_max_m: float
    left_out: tuple[str, ...] = ()
    levels: Mapping[str, LevelFacts] = field(default_factory=dict)

    @property
    def triangles_spared(self) -> int:
        """Counts the triangles more with all objects at their finest level."""
        return 0 if self.triangles_finest is None else self.triangles_finest - self.triangles


@dataclass(frozen=True, kw_only=True)
class BudgetFacts:
    """Records the triangles that all objects may have, and the factor on their errors."""

    max_triangles: Natural
    error_factor: float


@dataclass(frozen=True, kw_only=True)
class PrecisionFacts:
    """Errors of positions; pixels of the nearest view, None without views."""

    promised_m: float
    promised_px: float | None
    float32_error_max_m: float
    float32_error_max_px: float | None
    extent_m: float = 0.0


@dataclass(frozen=True, kw_only=True)
class SetToZero:
    """The share of a sky picture that was below 0."""

    negative_fraction: float


@dataclass(frozen=True, kw_only=True)
class SkyPicture:
    """A picture of the sky: the rms error of its resolution, where it was baked."""

    resolution_error: float | None = omitted()
    facts: Mapping[str, JSON] = rest()


@dataclass(frozen=True, kw_only=True)
class SkyFacts:
    """The pictures of the sky, by name."""

    set_to_zero: Mapping[str, SetToZero] = field(default_factory=dict)
    pictures: Mapping[str, SkyPicture] = rest()


@dataclass(frozen=True, kw_only=True)
class CloudFacts:
    """Clouds: the share of the sun's light that they leave at the origin, at each sample."""

    sun_transmittance: tuple[float, ...]
    facts: Mapping[str, JSON] = rest()


@dataclass(frozen=True, kw_only=True)
class PictureFacts:
    """A picture of a material: what of its texels was kept, and what that lost."""

    texels: Texels
    texels_per_pixel: float
    texels_kept: Texels | None = omitted(needed=_beside("bytes_saved"))
    rms_error: float = omitted(0.0, needed=_beside("texels_kept"))
    slope_rms_kept: float | None = omitted()
    slope_rms: float = omitted(0.0, needed=_beside("slope_rms_kept"))
    bytes_saved: float = 0


@dataclass(frozen=True, kw_only=True)
class SurfaceFacts:
    """A material."""

    pictures: Mapping[str, PictureFacts] = field(default_factory=dict)
    bytes: JSON = None
    facts: Mapping[str, JSON] = rest()


@dataclass(frozen=True, kw_only=True)
class MotionFacts:
    """A rig's motion: how long it takes, where it is one over time."""

    duration_s: float | None = None
    facts: Mapping[str, JSON] = rest()


@dataclass(frozen=True, kw_only=True)
class DescentFacts:
    """How long a descent takes, and how it slows down, among the facts of its motion."""

    duration_s: float
    deceleration_m_s2: float


@dataclass(frozen=True, kw_only=True)
class PrunedLight:
    """Records the light that pruning neglects."""

    min_view_factor: float | None = omitted()
    everywhere: bool = False
    facts: Mapping[str, JSON] = rest()


@dataclass(frozen=True, kw_only=True)
class PrunedTiles:
    """Records how many tiles of the terrain were kept."""

    kept: Natural
    of: Natural


@dataclass(frozen=True, kw_only=True)
class PruneFacts:
    """Pruning: of each class, how many objects have which reason."""

    light: PrunedLight | None = None
    tiles: PrunedTiles | None = omitted()
    objects: Mapping[str, Mapping[str, Natural]] = field(default_factory=dict)


@dataclass(frozen=True, kw_only=True)
class LeftOutEntry:
    """Something that is not in the stage: see ``schemas.left_out.entry``."""

    what: str
    why: str
    instances: Natural = 0
    triangles: Natural = 0
    bytes: Natural | None = 0


@dataclass(frozen=True, kw_only=True)
class BatchReport:
    """The report of a batch; objects, materials and moving things by name."""

    bytes: Natural
    relief: tuple[ReliefFacts, ...]
    cover: tuple[CoverFacts, ...] = ()
    ground: GroundFacts
    objects: Mapping[str, ClassFacts] = field(default_factory=dict)
    object_budget: BudgetFacts | None = None
    precision: PrecisionFacts | None = omitted()
    sky: SkyFacts = field(default_factory=SkyFacts)
    clouds: CloudFacts | None = omitted()
    surfaces: Mapping[str, SurfaceFacts] = field(default_factory=dict)
    motion: Mapping[str, Mapping[str, JSON]] = field(default_factory=dict)
    prune: PruneFacts | None = None
    left_out: tuple[LeftOutEntry, ...] = ()


@dataclass(frozen=True, kw_only=True)
class Timings:
    """Seconds of a compilation, ``timings.json``: of each step, by batch."""

    compile: Mapping[str, Mapping[str, float]] = field(default_factory=dict)


def read_output_record[T](path: Path, kind: type[T]) -> T:
    """Reads a ``BatchReport``, or ``Timings``.

    Raises:
        OutputError: It is missing or damaged; with the JSON pointer.
    """
    try:
        return read_record(path, kind, OutputError, "report of scenec")
    except FileNotFoundError as error:
        raise OutputError(f"{path}: cannot be read: {error.strerror}") from error
