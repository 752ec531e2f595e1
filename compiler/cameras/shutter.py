"""Declares shutters: when the rows of a picture are exposed."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import ClassVar, Literal

from scenec.compiler.cameras.imaging import ImagingPlan
from scenec.compiler.kinds.declare import key
from scenec.compiler.kinds.finding import Finding
from scenec.compiler.kinds.forms import CHOICE, PER_BATCH
from scenec.compiler.kinds.node import Node
from scenec.schemas import shutter

#: Poses that come one by one, at no time.
_STILL = ("random", "random_target")


@dataclass(frozen=True, kw_only=True)
class Shutter:
    """When the rows of a picture are exposed, while the rig goes on moving: motion blur, and a
    rolling shutter's slant. A sample's pose and time are those of the middle of the picture in the
    middle of its exposure. Before a motion begins and after it ends the rig stands still. Only on
    rigs that move over time: not beside random poses.
    """

    EXAMPLE: ClassVar = {"exposure_s": 0.01, "readout_s": 0.02, "direction": "down"}

    exposure_s: float | None = key(PER_BATCH, optional=True, at_least=0, at_most=1000, unit="s")
    """How long each row is exposed; 0: an instant. Left out, the time_s of imaging's manual
    exposure."""
    readout_s: float = key(PER_BATCH, default=0, at_least=0, at_most=1000, unit="s")
    """How much later the last row's border is exposed than the first row's; 0: all rows at once (a
    global shutter)."""
    direction: Literal["down", "up"] = key(CHOICE, default="down")
    """Whether the top row is exposed first, or the lowest."""

    @staticmethod
    def check(node: Node) -> Iterator[Finding]:
        """Finds a rig that stands still, and that nothing says how long it is open."""
        cfg, sensor = node.whole(), node.path[:-1]
        pose = cfg.at(*sensor[:-2], "pose")["type"]
        if pose in _STILL:
            yield node.key_fault(
                f'poses of the type "{pose}" are of no time, so nothing moves while a shutter '
                "is open: take it away, or let the rig move (track, orbit, lawn_mower, rover, mav, "
                "descent)"
            )
        exposure = cfg.at(*sensor, "imaging", "exposure")
        if "exposure_s" not in node and exposure["type"] != "manual":
            yield node.fault(
                'expected the key exposure_s: nothing but an imaging/exposure of type "manual" '
                "says it otherwise"
            )

    def at_samples(self, samples: int, imaging: ImagingPlan | None) -> tuple[shutter.Shutter, ...]:
        """Returns it at each sample; without a time of its own it has the imaging's."""
        upward = self.direction == "up"
        if self.exposure_s is not None:
            return (shutter.Shutter(self.exposure_s, self.readout_s, upward),) * samples
        assert imaging is not None
        return tuple(shutter.Shutter(one.time_s, self.readout_s, upward) for one in imaging.samples)
