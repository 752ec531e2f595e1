"""Declares exposures: how the radiance that a camera sees becomes an 8-bit picture."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Literal

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.distributions.numbers import Number
from scenec.compiler.kinds.context import Context
from scenec.compiler.kinds.declare import key
from scenec.compiler.kinds.forms import CHOICE, PER_SAMPLE


class Exposure:
    """What exposures have in common."""

    #: Whether it follows the light; what ``at_samples`` says is then relative.
    METERED: ClassVar = True
    #: What renderers find one exposure for; None: they find none.
    per: Literal["batch", "sample"] | None = None

    def at_samples(self, context: Context) -> NDArray[np.float64]:
        """Returns what radiance is multiplied by at each sample, EV, float64 [s]."""
        return np.zeros(context.samples)


@dataclass(frozen=True, kw_only=True)
class Auto(Exposure):
    """As a camera's own meter finds it, from what the camera sees: the mean luminance of surfaces
    is shown as 0.18, unless the brightest hundredth of them would then be shown above 1. Where more
    than a twentieth of all that is seen, sky included, would be shown above 1, as against the
    light, it is half of those stops less, three at most; the sun's disc never counts. The same in
    all backends, whichever frames are rendered; each frame's sidecar states it.
    """

    EXAMPLE: ClassVar = {"type": "auto", "per": "sample"}

    per: Literal["batch", "sample"] = key(CHOICE, default="batch")
    """What has one exposure: the batch, so that a sequence does not flicker (a dark sample among
    bright ones stays dark), or each sample."""


@dataclass(frozen=True, kw_only=True)
class Incident(Exposure):
    """Follows the light that falls on the scene, as an incident light meter does: that of suns and
    sky on level ground, and that of lamps on a surface that faces them where the middle of the
    picture meets the ground, or the first lit place below that. Where no light arrives, radiance is
    shown as it is (EV 0 and the offset).
    """

    EXAMPLE: ClassVar = {"type": "incident", "ev_offset": 0.5}

    ev_offset: Number = key(PER_SAMPLE, default=0, at_least=-64, at_most=64, unit="EV")
    """Correction; +1 is twice as bright."""

    def at_samples(self, context: Context) -> NDArray[np.float64]:
        """Returns what is added to the light's, EV, float64 [s]."""
        return context.per_sample(self.ev_offset, "ev_offset")


@dataclass(frozen=True, kw_only=True)
class Fixed(Exposure):
    """The same for all light."""

    EXAMPLE: ClassVar = {"type": "fixed", "ev": -8}

    METERED: ClassVar = False

    ev: Number = key(PER_SAMPLE, at_least=-64, at_most=64, unit="EV")
    """Radiance times 2^ev is shown."""

    def at_samples(self, context: Context) -> NDArray[np.float64]:
        """Returns what radiance is multiplied by at each sample, EV, float64 [s]."""
        return context.per_sample(self.ev, "ev")
