"""Declares what cameras and lidars have alike: a place on the rig, and when they are triggered."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.geometry.poses import from_euler
from scenec.compiler.kinds import Finding, Node, forms, key


@dataclass(frozen=True, kw_only=True)
class Mount:
    """Pose of a sensor in its rig's frame (x right, y down, z forward)."""

    EXAMPLE: ClassVar = {"position_m": [0.12, 0, 0], "rotation_deg": [0, 5, 0]}

    position_m: tuple[float, ...] = key(forms.MOUNT_POSITION_M)
    rotation_deg: tuple[float, ...] = key(forms.MOUNT_ROTATION_DEG)

    @property
    def to_rig(self) -> NDArray[np.float64]:
        """Sensor-to-rig matrix, OpenCV axes on both sides, float64 [4, 4]."""
        return from_euler(self.position_m, self.rotation_deg)


@dataclass(frozen=True, kw_only=True)
class Trigger:
    """Samples at which a sensor is triggered: first, first + every, and so on. With samples at 30
    Hz, every 3 is 10 Hz.
    """

    EXAMPLE: ClassVar = {"every": 5, "first": 2}

    every: int = key(forms.COUNT, default=1, at_least=1, at_most=1_000_000_000)
    """Samples from one to the next."""
    first: int = key(forms.COUNT, default=0, at_least=0, at_most=1_000_000_000)
    """The first one."""

    @staticmethod
    def check(node: Node) -> Iterator[Finding]:
        """Finds a first sample that there is none of."""
        cfg, first = node.whole(), node["first"]
        samples = cfg["samples"]
        if "samples" in cfg and first is not None and samples is not None and first >= samples:
            yield node.fault(f"is never reached: there are samples 0 to {samples - 1}", "first")
