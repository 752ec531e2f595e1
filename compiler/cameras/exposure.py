"""Declares how much light makes a picture, and when: exposures and shutters."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import ClassVar, Literal

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.cameras.imaging import ImagingPlan
from scenec.compiler.distributions.numbers import Number
from scenec.compiler.kinds import Context, Finding, Node, key
from scenec.compiler.kinds.forms import CHOICE, PER_BATCH, PER_SAMPLE
from scenec.schemas import shutter


class ExposureRule:
    """Defines what all exposures share."""

    #: The key that says how bright it is, and whether that is on top of what the light says.
    EV: ClassVar = ""
    METERED: ClassVar = True
    #: What renderers find one exposure for; None: they find none.
    per: Literal["batch", "sample"] | None = None

    def at_samples(self, context: Context) -> NDArray[np.float64]:
        """Returns what radiance is multiplied by at each sample, EV, float64 [s]."""
        return context.per_sample(getattr(self, self.EV, 0.0), self.EV)


@dataclass(frozen=True, kw_only=True)
class AutoExposure(ExposureRule):
    """Shows the mean luminance of surfaces as 0.18, unless the brightest hundredth would then be
    above 1. Where more than a twentieth of the picture, sky included but not the sun's disc, would
    be above 1, it takes back half of those stops, three at most. The same in all backends; each
    frame's sidecar states it.
    """

    EXAMPLE: ClassVar = {"type": "auto", "per": "sample"}

    per: Literal["batch", "sample"] = key(CHOICE, default="batch")
    """What shares one exposure: the batch (no flicker, a dark sample stays dark), or each
    sample."""


@dataclass(frozen=True, kw_only=True)
class Incident(ExposureRule):
    """An incident light meter: suns and sky on level ground, and lamps on a surface facing them
    where the middle of the picture meets the ground (or the first lit place below). Without light,
    radiance is shown as it is.
    """

    EXAMPLE: ClassVar = {"type": "incident", "ev_offset": 0.5}

    EV: ClassVar = "ev_offset"

    ev_offset: Number = key(PER_SAMPLE, default=0, at_least=-64, at_most=64, unit="EV")
    """Correction; +1 is twice as bright."""


@dataclass(frozen=True, kw_only=True)
class Fixed(ExposureRule):
    """The same for all light."""

    EXAMPLE: ClassVar = {"type": "fixed", "ev": -8}

    EV: ClassVar = "ev"
    METERED: ClassVar = False

    ev: Number = key(PER_SAMPLE, at_least=-64, at_most=64, unit="EV")
    """Radiance times 2^ev is shown."""


@dataclass(frozen=True, kw_only=True)
class ShutterKeys:
    """When rows are exposed while the rig moves: motion blur, rolling shutter. Pose and time of a
    sample are those of the picture's middle at mid-exposure; before and after its motion the rig
    stands still. Not with random poses.
    """

    EXAMPLE: ClassVar = {"exposure_s": 0.01, "readout_s": 0.02, "direction": "down"}

    exposure_s: float | None = key(PER_BATCH, optional=True, at_least=0, at_most=1000, unit="s")
    """How long each row is exposed; 0: an instant. Left out, time_s of imaging's manual
    exposure."""
    readout_s: float = key(PER_BATCH, default=0, at_least=0, at_most=1000, unit="s")
    """How much later the last row's border is exposed than the first's; 0: a global shutter."""
    direction: Literal["down", "up"] = key(CHOICE, default="down")
    """Whether the top row is exposed first, or the lowest."""

    @staticmethod
    def check(node: Node) -> Iterator[Finding]:
        """Finds a rig that stands still, and that nothing says how long it is open."""
        cfg, sensor = node.whole(), node.path[:-1]
        pose = cfg.at(*sensor[:-2], "pose")
        if (name := pose["type"]) is not None and not pose.takes("sampling"):
            yield node.key_fault(
                f'poses of the type "{name}" are of no time, so nothing moves while a shutter '
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
