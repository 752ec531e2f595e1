"""Depth as PNG of 16 bits: a whole number of steps, 0 where there is no depth."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scenec.datasets.formats.contract import Narrowed

#: The most steps that 16 bits hold.
LARGEST = 65535


@dataclass(frozen=True)
class Depth16:
    """A depth picture in whole steps.

    Attributes:
        steps: uint16 [h, w]; 0 where nothing is hit, or the depth cannot be said.
        hits: Pixels that hit something.
        beyond: Of these, those farther than ``LARGEST`` steps; they are 0.
        under: Of these, those nearer than half a step; they are 0.
        narrowed: All that are 0 though they hit something, for ``Written.narrowed``.
    """

    steps: NDArray[np.uint16]
    hits: int
    beyond: int
    under: int
    narrowed: dict[str, Narrowed]

    def counts(self) -> dict[str, int]:
        """Returns the counts that a task records."""
        return {"hits": self.hits, "beyond": self.beyond, "under": self.under}


def to_16_bits(depth: NDArray[np.floating], steps_per_m: float) -> Depth16:
    """Depth in whole steps, to the nearest: within half a step of what it was.

    Args:
        depth: Meters, [h, w]; not finite where nothing is hit.
        steps_per_m: Steps per meter.
    """
    hit = np.isfinite(depth)
    steps = np.rint(np.where(hit, depth, 0.0).astype(np.float64) * steps_per_m)
    beyond, under = hit & (steps > LARGEST), hit & (steps <= 0.0)
    kept = np.where(beyond, 0.0, np.maximum(steps, 0.0)).astype(np.uint16)
    hits, lost = int(hit.sum()), int(beyond.sum()) + int(under.sum())
    what = (
        f"hits have no depth: 16 bits hold {0.5 / steps_per_m:.3g} to {LARGEST / steps_per_m:.5g} m"
    )
    narrowed = {what: Narrowed(lost, hits, float(depth[hit].max()) if hits else 0.0)}
    return Depth16(kept, hits, int(beyond.sum()), int(under.sum()), narrowed)


def fitting_scale(farthest: float) -> float:
    """Returns the most steps a meter, in two digits, at which 16 bits hold a depth; 1 of none."""
    if not 0.0 < farthest < math.inf:
        # Nothing before the camera: any scale holds that.
        return 1.0
    most = LARGEST / farthest
    unit = 10.0 ** (math.floor(math.log10(most)) - 1)
    return math.floor(most / unit * (1.0 + 1e-12)) * unit
