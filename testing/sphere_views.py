"""Finds the horizon of curved ground as the exact caster sees it, and as a sphere has it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from scenec.backends.contract import Rays
from scenec.backends.exact.caster import ExactCaster
from scenec.backends.stage.scene import RenderScene


def seen_horizon(
    scene: RenderScene, height_m: float, azimuths: int = 16
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Returns the horizon from above the origin: dips, radians, and distances, meters, [azimuths].

    The dip is bisected between rays that meet ground and rays that do not.
    """
    caster = ExactCaster(scene)
    turn = np.arange(azimuths) * (2.0 * np.pi / azimuths) + 0.1
    origins = np.tile([0.0, 0.0, height_m], (azimuths, 1))

    def hits(dip: NDArray[np.float64]) -> NDArray[np.float64]:
        level = np.cos(dip)
        rays = np.stack([level * np.cos(turn), level * np.sin(turn), -np.sin(dip)], axis=1)
        return caster.cast(Rays(origins, rays, (1, azimuths)))[2]

    low, high = np.zeros(azimuths), np.full(azimuths, 0.5 * np.pi)
    assert np.isinf(hits(low)).all(), "the horizon is above the eye"
    while (high - low).max() > 1e-12:
        middle = 0.5 * (low + high)
        found = np.isfinite(hits(middle))
        low, high = np.where(found, low, middle), np.where(found, middle, high)
    return high, hits(high)


def true_horizon(radius_m: float, height_m: float) -> tuple[float, float]:
    """Returns the dip and the distance of a sphere's horizon: radians, meters."""
    distance = np.sqrt(2.0 * radius_m * height_m + height_m * height_m)
    return float(np.arctan2(distance, radius_m)), float(distance)
