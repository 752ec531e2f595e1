"""Declares how light is led to a picture: lenses, and what is in focus."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from scenec.compiler.arithmetic import elementary
from scenec.compiler.cameras.imaging import ImagingPlan
from scenec.compiler.distributions.numbers import Number
from scenec.compiler.geometry.lenses import sound_intrinsics
from scenec.compiler.kinds import Context, Finding, Node, forms, key, kind_of
from scenec.compiler.kinds.declare import keys_of
from scenec.compiler.kinds.table import name_of
from scenec.compiler.scene import rig
from scenec.schemas import lens
from scenec.schemas.correspondence import PARTNER
from scenec.schemas.errors import SceneError
from scenec.schemas.lens import COEFFICIENTS, EQUIRECTANGULAR


class LensKind:
    """Defines what all lenses share."""

    @staticmethod
    def check(node: Node) -> Iterator[Finding]:
        """Finds that it is asked for a stereo pair's outputs, and that it is not one-to-one."""
        sensor = node.whole().at(*node.path[:-1])
        outputs = sensor.at("outputs")
        for i, name in outputs.entries.items():
            if name in PARTNER:
                yield outputs.fault(f'"{name}" is of rectified pairs, which have no lens', i)
        message = _fold(sensor, node)
        if message is not None:
            yield node.fault(message)

    def build(self) -> lens.Lens:
        """Returns what computes."""
        model = name_of("lens", type(self))
        numbers = tuple(float(getattr(self, name)) for name in COEFFICIENTS[model])
        angle = getattr(self, "max_angle_deg", 180.0) * (elementary.PI / 180.0)
        return lens.Lens(model, numbers, min(angle, math.pi))


@dataclass(frozen=True, kw_only=True)
class BrownConrady(LensKind):
    """Radial and tangential distortion (Brown 1966; OpenCV's rational model): radii times (1 + k1
    r^2 + k2 r^4 + k3 r^6) / (1 + k4 r^2 + k5 r^4 + k6 r^6). It must be one-to-one over the picture.
    fov_deg includes radial distortion only.
    """

    EXAMPLE: ClassVar = {"type": "brown_conrady", "k1": -0.28, "k2": 0.07, "p1": 0.0002}

    TITLE: ClassVar = "Lens: brown_conrady"

    k1: float = key(forms.PER_BATCH, default=0, at_least=-10_000, at_most=10_000)
    """Coefficient of r^2 above the fraction line."""
    k2: float = key(forms.PER_BATCH, default=0, at_least=-10_000, at_most=10_000)
    """Coefficient of r^4 above the fraction line."""
    p1: float = key(forms.PER_BATCH, default=0, at_least=-10, at_most=10)
    """Tangential: y gets p1 (r^2 + 2 y^2), x 2 p1 x y."""
    p2: float = key(forms.PER_BATCH, default=0, at_least=-10, at_most=10)
    """Tangential: x gets p2 (r^2 + 2 x^2), y 2 p2 x y."""
    k3: float = key(forms.PER_BATCH, default=0, at_least=-10_000, at_most=10_000)
    """Coefficient of r^6 above the fraction line."""
    k4: float = key(forms.PER_BATCH, default=0, at_least=-10_000, at_most=10_000)
    """Coefficient of r^2 below the fraction line."""
    k5: float = key(forms.PER_BATCH, default=0, at_least=-10_000, at_most=10_000)
    """Coefficient of r^4 below the fraction line."""
    k6: float = key(forms.PER_BATCH, default=0, at_least=-10_000, at_most=10_000)
    """Coefficient of r^6 below the fraction line."""


@dataclass(frozen=True, kw_only=True)
class KannalaBrandt(LensKind):
    """A fisheye: a ray at the angle t to the axis lies t (1 + k1 t^2 + k2 t^4 + k3 t^6 + k4 t^8)
    focal lengths from the principal point (Kannala and Brandt 2006; OpenCV's fisheye). Without
    coefficients it is equidistant; fx and fy are pixels per radian.
    """

    EXAMPLE: ClassVar = {"type": "kannala_brandt", "k1": -0.01, "max_angle_deg": 95}

    TITLE: ClassVar = "Lens: kannala_brandt"

    k1: float = key(forms.PER_BATCH, default=0, at_least=-1000, at_most=1000)
    """Coefficient of t^3."""
    k2: float = key(forms.PER_BATCH, default=0, at_least=-1000, at_most=1000)
    """Coefficient of t^5."""
    k3: float = key(forms.PER_BATCH, default=0, at_least=-1000, at_most=1000)
    """Coefficient of t^7."""
    k4: float = key(forms.PER_BATCH, default=0, at_least=-1000, at_most=1000)
    """Coefficient of t^9."""
    max_angle_deg: float = key(forms.ANGLE_PER_BATCH, default=180, above=0, at_most=180)
    """Largest angle of a ray to the axis: the border of the image circle, beyond which nothing
    shows."""


@dataclass(frozen=True, kw_only=True)
class Equirectangular(LensKind):
    """A panorama: columns are longitudes around the camera's y axis, rows latitudes. Alone it is
    the whole sphere; with fov_deg it has square pixels, with intrinsics fx and fy pixels per
    radian. Beyond the sphere nothing shows.
    """

    EXAMPLE: ClassVar = {"type": "equirectangular"}


def _fold(sensor: Node, node: Node) -> str | None:
    """Why a lens is not one-to-one; what is drawn is looked at when it is (``Sensor.draw``)."""
    size, kind = sensor["resolution"], kind_of("lens", node["type"])
    numbers = {name: node.constant(name) for name in keys_of(kind) if name in node}
    if None in (size, *numbers.values()):
        return None
    lens_, given = kind(**numbers).build(), sensor.at("intrinsics")
    fov = sensor.constant("fov_deg")
    five: Any = None
    if "intrinsics" in sensor:
        five = tuple(map(given.constant, ("fx", "fy", "cx", "cy", "skew")))
        if None in five:
            return None
    elif fov is None and ("fov_deg" in sensor or lens_.model != EQUIRECTANGULAR):
        return None
    found = sound_intrinsics(lens_, tuple(size), fov, five)
    return found if isinstance(found, str) else None


#: What a focus says that imaging says by a key of its own.
_OF_IMAGING = {"f_number": "f_number", "focal_length_mm": "pixel_um"}


@dataclass(frozen=True, kw_only=True)
class FocusKeys:
    """A lens of finite aperture: rgb is sharp at one distance, blurred before and behind it. Field
    of view and annotation stay the pinhole's. Not with lens.
    """

    EXAMPLE: ClassVar = {"distance_m": 4, "f_number": 2.8, "focal_length_mm": 35}

    distance_m: Number = key(forms.LENGTH_PER_SAMPLE, above=0, at_most=1_000_000_000)
    """Distance of the sharp plane along the optical axis; beyond the focal length."""
    f_number: Number | None = key(forms.PER_SAMPLE, optional=True, at_least=0.5, at_most=1000)
    """Focal length over aperture. Required without imaging, whose f_number counts."""
    focal_length_mm: float | None = key(
        forms.PER_BATCH, optional=True, above=0, at_most=1_000_000, unit="mm"
    )
    """Focal length. Required without imaging, whose pixel_um gives it."""

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
