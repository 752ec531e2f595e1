"""Declares what a camera is focused on."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from scenec.compiler.cameras.imaging import ImagingPlan
from scenec.compiler.distributions.numbers import Number
from scenec.compiler.kinds.context import Context
from scenec.compiler.kinds.declare import key
from scenec.compiler.kinds.finding import Finding
from scenec.compiler.kinds.forms import LENGTH_PER_SAMPLE, PER_BATCH, PER_SAMPLE
from scenec.compiler.kinds.node import Node
from scenec.compiler.scene import rig
from scenec.schemas.errors import SceneError

#: What a focus says that imaging says by a key of its own.
_OF_IMAGING = {"f_number": "f_number", "focal_length_mm": "pixel_um"}


@dataclass(frozen=True, kw_only=True)
class Focus:
    """A lens of finite aperture: rgb is sharp at one distance and blurred before and behind it.

    Field of view and annotation stay those of the pinhole in the aperture's middle. Not with
    lens.
    """

    EXAMPLE: ClassVar = {"distance_m": 4, "f_number": 2.8, "focal_length_mm": 35}

    distance_m: Number = key(LENGTH_PER_SAMPLE, above=0, at_most=1_000_000_000)
    """Distance along the optical axis of the plane that is sharp; beyond the focal length."""
    f_number: Number | None = key(PER_SAMPLE, optional=True, at_least=0.5, at_most=1000)
    """Focal length over diameter of the aperture. With imaging its f_number stands for it; without,
    it must be given."""
    focal_length_mm: float | None = key(
        PER_BATCH, optional=True, above=0, at_most=1_000_000, unit="mm"
    )
    """Focal length. With imaging it follows from pixel_um and the field of view; without, it must
    be given."""

    @staticmethod
    def check(node: Node) -> Iterator[Finding]:
        """Finds a lens beside it, and what imaging says, too, or does not say."""
        sensor = node.whole().at(*node.path[:-1])
        if "lens" in sensor:
            yield node.key_fault("a bent picture has no aperture here: take focus or lens away")
        for name, other in _OF_IMAGING.items():
            if "imaging" in sensor and name in node:
                yield node.key_fault(
                    f"imaging/{other} says it already: take it away here, and give it there", name
                )
            elif "imaging" not in sensor and name not in node:
                yield node.fault(
                    f"expected the key {name}: there is no imaging, whose {other} would say it"
                )

    def draw(self, context: Context, focal_px: float, imaging: ImagingPlan | None) -> rig.Focus:
        """Returns the aperture.

        With imaging, f-number and size of pixels are its own; the focal length is that of pixels of
        this size that see what ``focal_px``, fx, says.

        Raises:
            SceneError: It is to focus nearer than its focal length.
        """
        distance = context.per_sample(self.distance_m, "distance_m")
        if imaging is None:
            assert self.f_number is not None
            assert self.focal_length_mm is not None
            f_number = context.per_sample(self.f_number, "f_number")
            length = self.focal_length_mm * 1e-3
        else:
            f_number = np.array([one.f_number for one in imaging.samples], np.float64)
            length = focal_px * imaging.samples[0].pixel_um * 1e-6
        nearest = float(distance.min())
        if nearest <= length:
            raise SceneError(
                f"{context.path}/distance_m: {nearest:g} m is not beyond the focal length, "
                f"{length * 1e3:g} mm"
            )
        return rig.Focus(distance, f_number, length)
