"""Interpolates poses of single objects."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.arithmetic import elementary
from scenec.compiler.objects.prototypes import ModelPlan, PartRule
from scenec.compiler.scene.scene import Labels


@dataclass(frozen=True)
class PoseKeys:
    """One object's poses at some times.

    Attributes:
        time_s: Rising, float64 [k].
        position_m: float64 [k, 3]; z is a height over the ground, or of the world.
        quaternion: w, x, y, z, unit, float64 [k, 4].
        scale: float64 [k].
    """

    time_s: NDArray[np.float64]
    position_m: NDArray[np.float64]
    quaternion: NDArray[np.float64]
    scale: NDArray[np.float64]

    def at(self, time_s: float) -> tuple[NDArray[np.float64], NDArray[np.float64], float]:
        """Position [3], quaternion [4] and scale between the keys; before and after, as at the end.

        Positions and scales are linear in time, turns go the shorter way at an even rate (Shoemake
        1985).
        """
        times = self.time_s
        if len(times) == 1:
            return self.position_m[0], self.quaternion[0], float(self.scale[0])
        i = min(max(int(np.searchsorted(times, time_s, side="right")) - 1, 0), len(times) - 2)
        part = float(np.clip((time_s - times[i]) / (times[i + 1] - times[i]), 0.0, 1.0))
        return (
            (1.0 - part) * self.position_m[i] + part * self.position_m[i + 1],
            slerp(self.quaternion[i], self.quaternion[i + 1], part),
            float((1.0 - part) * self.scale[i] + part * self.scale[i + 1]),
        )


def slerp(a: NDArray[np.float64], b: NDArray[np.float64], part: float) -> NDArray[np.float64]:
    """The unit quaternion a part of the way from one to another, the shorter way round: [4]."""
    cosine = float((a * b).sum())
    if cosine < 0.0:
        a, cosine = -a, -cosine
    # The sine of the angle between them, from their difference: exact where they are close.
    across = b - cosine * a
    sine = float(np.sqrt((across * across).sum()))
    if sine < 1e-9:
        mixed = (1.0 - part) * a + part * b
    else:
        angle = float(elementary.atan2(sine, cosine))
        mixed = (elementary.sin((1.0 - part) * angle) * a + elementary.sin(part * angle) * b) / sine
    unit: NDArray[np.float64] = mixed / np.sqrt((mixed * mixed).sum())
    return unit


@dataclass(frozen=True)
class PlacedPlan:
    """One class of single objects.

    Attributes:
        name, material, labels, instances: As in ``Placed``.
        models: What there is.
        rules: For the models' parts.
        model: Index of each object's, int32 [n].
        ids: Local instance ids, ascending, int64 [n].
        keys: Poses of each object.
        on_ground: Whether heights are over the ground below the object's origin.
        along_normal: Whether objects stand along the ground's normal under them.
        variation: How much the models' own materials vary.
    """

    name: str
    material: str | None
    labels: Labels
    instances: bool
    models: tuple[ModelPlan, ...]
    rules: tuple[PartRule, ...]
    model: NDArray[np.int32]
    ids: NDArray[np.int64]
    keys: tuple[PoseKeys, ...]
    on_ground: bool
    along_normal: bool
    variation: float
