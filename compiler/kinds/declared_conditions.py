"""Declares keys of conditions."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

from scenec.compiler.kinds.declare import key
from scenec.compiler.kinds.forms import (
    ANGLE_PER_BATCH,
    COUNT,
    FRACTION_PER_BATCH,
    GAIN,
    LACUNARITY,
    LENGTH_PER_BATCH,
    PER_BATCH,
    RAGGED,
    SOFTNESS_M,
    TEXT,
    WHOLE_PER_BATCH,
    file,
)


@dataclass(frozen=True, kw_only=True)
class ConditionCamera:
    """Distances in plan from the nearest camera of any sample, between two bounds."""

    EXAMPLE: ClassVar = {"type": "camera", "min_m": 6, "softness_m": 3}

    min_m: float | None = key(LENGTH_PER_BATCH, optional=True, at_least=0, at_most=1000000000.0)
    """Smallest distance; left out, no bound."""
    max_m: float | None = key(LENGTH_PER_BATCH, optional=True, at_least=0, at_most=1000000000.0)
    """Largest distance; left out, no bound."""
    softness_m: float = key(LENGTH_PER_BATCH, default=0, at_least=0, at_most=1000000000.0)
    """Width over which it fades about a bound: half of it on either side."""
    ragged: Any | None = key(RAGGED, optional=True)


@dataclass(frozen=True, kw_only=True)
class ConditionCraterFreshness:
    """Freshness of the ground that craters left, between two bounds in [0, 1].

    A crater's is the part of its depth that wear has left; its ejecta cover all within the rim,
    half at 2.3 radii and nothing beyond 5, the newest over the oldest. 0 where no crater
    reaches. Later operators leave it as it is.
    """

    EXAMPLE: ClassVar = {"type": "crater_freshness", "min": 0.7, "softness": 0.2}

    min: float | None = key(FRACTION_PER_BATCH, optional=True)
    """Smallest freshness; left out, no bound."""
    max: float | None = key(FRACTION_PER_BATCH, optional=True)
    """Largest freshness; left out, no bound."""
    softness: float = key(PER_BATCH, default=0.1, at_least=0, at_most=1_000_000_000)
    """Width over which it fades about a bound: half of it on either side. On the ground at least an
    eighth of what changes over a spacing there."""
    ragged: Any | None = key(RAGGED, optional=True)


@dataclass(frozen=True, kw_only=True)
class ConditionCurvature:
    """Curvature of the ground between two bounds: the Laplacian of the height, above 0 in hollows,
    below 0 on crests. A bowl z = (x² + y²) / 2R has 2 / R.
    """

    EXAMPLE: ClassVar = {"type": "curvature", "max_per_m": -0.05, "over_m": 2}

    min_per_m: float | None = key(
        PER_BATCH, optional=True, at_least=-1_000_000_000, at_most=1_000_000_000, unit="1/m"
    )
    """Smallest curvature; left out, no bound."""
    max_per_m: float | None = key(
        PER_BATCH, optional=True, at_least=-1_000_000_000, at_most=1_000_000_000, unit="1/m"
    )
    """Largest curvature; left out, no bound."""
    softness_per_m: float = key(PER_BATCH, default=0, at_least=0, at_most=1_000_000_000, unit="1/m")
    """Width over which it fades about a bound: half of it on either side. On the ground at least an
    eighth of what changes over a spacing there."""
    over_m: float | None = key(LENGTH_PER_BATCH, optional=True, at_least=0, at_most=1_000_000_000)
    """Length over which the heights are smoothed first (standard deviation of a Gaussian). Left
    out, two spacings."""
    ragged: Any | None = key(RAGGED, optional=True)


@dataclass(frozen=True, kw_only=True)
class ConditionFlow:
    """Area that drains through a place between two bounds: small on crests, large along valleys.

    Water leaves over all borders and parts among all lower neighbors; through hollows it takes
    one of eight directions, a sample wide. The area is averaged over a spacing, so that such a
    line counts 0.4 of what it drains and grows wider with it.
    """

    EXAMPLE: ClassVar = {"type": "flow", "min_m2": 40, "softness_doublings": 1}

    min_m2: float | None = key(
        PER_BATCH, optional=True, above=0, at_most=1_000_000_000_000, unit="m²"
    )
    """Smallest area; left out, no bound."""
    max_m2: float | None = key(
        PER_BATCH, optional=True, above=0, at_most=1_000_000_000_000, unit="m²"
    )
    """Largest area; left out, no bound."""
    softness_doublings: float = key(PER_BATCH, default=1, at_least=0, at_most=1_000_000_000)
    """Doublings of the area over which it fades about a bound: half of it on either side. On the
    ground at least an eighth of what changes over a spacing there."""
    over_m: float | None = key(LENGTH_PER_BATCH, optional=True, at_least=0, at_most=1_000_000_000)
    """Length over which the heights are smoothed first (standard deviation of a Gaussian). Left
    out, two spacings."""
    ragged: Any | None = key(RAGGED, optional=True)


@dataclass(frozen=True, kw_only=True)
class ConditionHeight:
    """Heights between two bounds."""

    EXAMPLE: ClassVar = {
        "type": "height",
        "max_m": 1.5,
        "softness_m": 0.4,
        "ragged": {"amplitude": 0.3, "scale_m": 4},
    }

    min_m: float | None = key(
        LENGTH_PER_BATCH, optional=True, at_least=-1_000_000_000, at_most=1_000_000_000
    )
    """Smallest height; left out, no bound."""
    max_m: float | None = key(
        LENGTH_PER_BATCH, optional=True, at_least=-1_000_000_000, at_most=1_000_000_000
    )
    """Largest height; left out, no bound."""
    softness_m: float = key(SOFTNESS_M)
    ragged: Any | None = key(RAGGED, optional=True)


@dataclass(frozen=True, kw_only=True)
class ConditionNoise:
    """Where a noise lies between two bounds.

    One octave lies in [-1, 1], half of it within ±0.2.
    """

    EXAMPLE: ClassVar = {"type": "noise", "scale_m": 14, "octaves": 3, "min": 0.1, "softness": 0.3}

    scale_m: float = key(LENGTH_PER_BATCH, above=0, at_most=1_000_000_000)
    """Size of the noise's largest features."""
    octaves: int = key(WHOLE_PER_BATCH, default=4, at_least=0, at_most=24)
    """Number of octaves at most; in the mask of an operator those finer than the spacing can show
    are left out."""
    lacunarity: float = key(LACUNARITY)
    gain: float = key(GAIN)
    min: float | None = key(PER_BATCH, optional=True, at_least=-100, at_most=1_000_000_000)
    """Smallest value; left out, no bound."""
    max: float | None = key(PER_BATCH, optional=True, at_least=-100, at_most=1_000_000_000)
    """Largest value; left out, no bound."""
    softness: float = key(PER_BATCH, default=0.1, at_least=0, at_most=1_000_000_000)
    """Width over which it fades about a bound: half of it on either side. On the ground at least an
    eighth of what changes over a spacing there."""
    ragged: Any | None = key(RAGGED, optional=True)


@dataclass(frozen=True, kw_only=True)
class ConditionObject:
    """Distances in plan from the objects of an earlier class, between two bounds: from the circle
    around each, below 0 within it.
    """

    EXAMPLE: ClassVar = {"type": "object", "of": "lander", "min_m": 2}

    of: str = key(TEXT)
    """The class."""
    min_m: float | None = key(
        LENGTH_PER_BATCH, optional=True, at_least=-1000000000.0, at_most=1000000000.0
    )
    """Smallest distance; left out, no bound."""
    max_m: float | None = key(
        LENGTH_PER_BATCH, optional=True, at_least=-1000000000.0, at_most=1000000000.0
    )
    """Largest distance; left out, no bound."""
    softness_m: float = key(LENGTH_PER_BATCH, default=0, at_least=0, at_most=1000000000.0)
    """Width over which it fades about a bound: half of it on either side."""
    ragged: Any | None = key(RAGGED, optional=True)


@dataclass(frozen=True, kw_only=True)
class ConditionPath:
    """Distances in plan from a path, between two bounds."""

    EXAMPLE: ClassVar = {"type": "path", "file": "track.csv", "max_m": 3, "softness_m": 1}

    file: Path = key(file("polyline"))
    """CSV of the path's points, columns x_m and y_m: relative to the cfg, or "package:NAME/path".
    """
    min_m: float | None = key(LENGTH_PER_BATCH, optional=True, at_least=0, at_most=1_000_000_000)
    """Smallest distance; left out, no bound."""
    max_m: float | None = key(LENGTH_PER_BATCH, optional=True, at_least=0, at_most=1_000_000_000)
    """Largest distance; left out, no bound."""
    softness_m: float = key(SOFTNESS_M)
    ragged: Any | None = key(RAGGED, optional=True)


@dataclass(frozen=True, kw_only=True)
class ConditionPoint:
    """Distances in plan from a point, between two bounds."""

    EXAMPLE: ClassVar = {"type": "point", "x_m": 0, "y_m": 0, "min_m": 20, "softness_m": 5}

    x_m: float = key(LENGTH_PER_BATCH, at_least=-1_000_000_000, at_most=1_000_000_000)
    """The point's x."""
    y_m: float = key(LENGTH_PER_BATCH, at_least=-1_000_000_000, at_most=1_000_000_000)
    """The point's y."""
    min_m: float | None = key(LENGTH_PER_BATCH, optional=True, at_least=0, at_most=1_000_000_000)
    """Smallest distance; left out, no bound."""
    max_m: float | None = key(LENGTH_PER_BATCH, optional=True, at_least=0, at_most=1_000_000_000)
    """Largest distance; left out, no bound."""
    softness_m: float = key(SOFTNESS_M)
    ragged: Any | None = key(RAGGED, optional=True)


@dataclass(frozen=True, kw_only=True)
class ConditionRagged:
    """An fBm that is added to what a condition asks for, before it is held against the bounds."""

    EXAMPLE: ClassVar = {"amplitude": 3, "scale_m": 20}

    amplitude: float = key(PER_BATCH, at_least=0, at_most=1_000_000_000)
    """Amplitude of the first octave, in the unit of the bounds (of the area: in doublings); each
    later one has half of the one before it."""
    scale_m: float = key(LENGTH_PER_BATCH, at_least=1e-09, at_most=1_000_000_000)
    """Size of the largest features."""
    octaves: int = key(WHOLE_PER_BATCH, default=4, at_least=1, at_most=24)
    """Number of octaves."""


@dataclass(frozen=True, kw_only=True)
class ConditionSlope:
    """Slopes between two bounds."""

    EXAMPLE: ClassVar = {"type": "slope", "max_deg": 12, "softness_deg": 3, "over_m": 2}

    min_deg: float | None = key(ANGLE_PER_BATCH, optional=True, at_least=0, at_most=1_000_000_000)
    """Smallest slope; left out, no bound."""
    max_deg: float | None = key(ANGLE_PER_BATCH, optional=True, at_least=0, at_most=1_000_000_000)
    """Largest slope; left out, no bound."""
    softness_deg: float = key(ANGLE_PER_BATCH, default=0, at_least=0, at_most=1_000_000_000)
    """Width over which it fades about a bound: half of it on either side. On the ground at least an
    eighth of what changes over a spacing there."""
    over_m: float | None = key(LENGTH_PER_BATCH, optional=True, at_least=0, at_most=1_000_000_000)
    """Length over which the heights are smoothed before the slope is taken (standard deviation of a
    Gaussian). Left out, 0 in the mask of an operator and two spacings on the ground."""
    ragged: Any | None = key(RAGGED, optional=True)


@dataclass(frozen=True, kw_only=True)
class ReliefMaskMaterial:
    """Where a ground material shows, were the ground laid on the heights before the operator: with
    the weight of its color.
    """

    EXAMPLE: ClassVar = {"type": "material", "material": "lava"}

    TITLE: ClassVar = "Mask: material"
    material: str = key(TEXT)
    """Material of a ground layer; all layers of it count."""
    layer: int | None = key(COUNT, optional=True, at_least=0, at_most=1000)
    """The one layer that counts, where the material has more than one: its index in ground, 0 for
    the base."""
