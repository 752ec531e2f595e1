"""Declares lenses: how the picture is bent."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import ClassVar

from scenec.compiler.arithmetic import elementary
from scenec.compiler.geometry.lenses import find_fault, lens_intrinsics
from scenec.compiler.kinds.declare import key, keys_of
from scenec.compiler.kinds.finding import Finding
from scenec.compiler.kinds.forms import ANGLE_PER_BATCH, PER_BATCH
from scenec.compiler.kinds.node import Node
from scenec.compiler.kinds.table import kind_of
from scenec.schemas import lens
from scenec.schemas.correspondence import PARTNER
from scenec.schemas.lens import BROWN_CONRADY, COEFFICIENTS, EQUIRECTANGULAR, KANNALA_BRANDT


class Lens:
    """What lenses have in common."""

    #: As in ``schemas.lens``.
    MODEL: ClassVar[str]

    @staticmethod
    def check(node: Node) -> Iterator[Finding]:
        """Finds that it is asked for a stereo pair's outputs, and that it is not one-to-one."""
        sensor = node.whole().at(*node.path[:-1])
        if "partner" in sensor:
            yield sensor.key_fault(
                "a sensor with a lens is no half of a rectified pair: take one of both away",
                "partner",
            )
        outputs = sensor.at("outputs")
        for i, name in outputs.entries.items():
            if name in PARTNER:
                yield outputs.fault(f'"{name}" is of rectified pairs, which have no lens', i)
        message = _fold(sensor, node)
        if message is not None:
            yield node.fault(message)

    def made(self) -> lens.Lens:
        """Returns what computes."""
        numbers = tuple(float(getattr(self, name)) for name in COEFFICIENTS[self.MODEL])
        angle = getattr(self, "max_angle_deg", 180.0) * (elementary.PI / 180.0)
        return lens.Lens(self.MODEL, numbers, min(angle, math.pi))


@dataclass(frozen=True, kw_only=True)
class BrownConrady(Lens):
    """Radial and tangential distortion of a pinhole's picture (Brown 1966; OpenCV's rational
    model): radii are multiplied by (1 + k1 r^2 + k2 r^4 + k3 r^6) / (1 + k4 r^2 + k5 r^4 + k6 r^6).
    It must be one-to-one over the whole picture. The sensor's fov_deg counts radial distortion in,
    tangential not.
    """

    EXAMPLE: ClassVar = {"type": "brown_conrady", "k1": -0.28, "k2": 0.07, "p1": 0.0002}

    TITLE: ClassVar = "Lens: brown_conrady"
    MODEL: ClassVar = BROWN_CONRADY

    k1: float = key(PER_BATCH, default=0, at_least=-10_000, at_most=10_000)
    """Coefficient of r^2 above the fraction line."""
    k2: float = key(PER_BATCH, default=0, at_least=-10_000, at_most=10_000)
    """Coefficient of r^4 above the fraction line."""
    p1: float = key(PER_BATCH, default=0, at_least=-10, at_most=10)
    """Tangential: y gets p1 (r^2 + 2 y^2), x 2 p1 x y."""
    p2: float = key(PER_BATCH, default=0, at_least=-10, at_most=10)
    """Tangential: x gets p2 (r^2 + 2 x^2), y 2 p2 x y."""
    k3: float = key(PER_BATCH, default=0, at_least=-10_000, at_most=10_000)
    """Coefficient of r^6 above the fraction line."""
    k4: float = key(PER_BATCH, default=0, at_least=-10_000, at_most=10_000)
    """Coefficient of r^2 below the fraction line."""
    k5: float = key(PER_BATCH, default=0, at_least=-10_000, at_most=10_000)
    """Coefficient of r^4 below the fraction line."""
    k6: float = key(PER_BATCH, default=0, at_least=-10_000, at_most=10_000)
    """Coefficient of r^6 below the fraction line."""


@dataclass(frozen=True, kw_only=True)
class KannalaBrandt(Lens):
    """A fisheye: a ray at the angle t to the axis lies t (1 + k1 t^2 + k2 t^4 + k3 t^6 + k4 t^8)
    focal lengths from the principal point (Kannala and Brandt 2006; OpenCV's fisheye). Without
    coefficients it is equidistant. Here fx and fy are pixels per radian, and fov_deg may be up to
    360.
    """

    EXAMPLE: ClassVar = {"type": "kannala_brandt", "k1": -0.01, "max_angle_deg": 95}

    TITLE: ClassVar = "Lens: kannala_brandt"
    MODEL: ClassVar = KANNALA_BRANDT

    k1: float = key(PER_BATCH, default=0, at_least=-1000, at_most=1000)
    """Coefficient of t^3."""
    k2: float = key(PER_BATCH, default=0, at_least=-1000, at_most=1000)
    """Coefficient of t^5."""
    k3: float = key(PER_BATCH, default=0, at_least=-1000, at_most=1000)
    """Coefficient of t^7."""
    k4: float = key(PER_BATCH, default=0, at_least=-1000, at_most=1000)
    """Coefficient of t^9."""
    max_angle_deg: float = key(ANGLE_PER_BATCH, default=180, above=0, at_most=180)
    """Largest angle of a ray to the axis, the border of the image circle: what the picture has
    beyond it shows nothing."""


@dataclass(frozen=True, kw_only=True)
class Equirectangular(Lens):
    """A panorama: columns are longitudes around the camera's y axis, rows latitudes.

    Without fov_deg and intrinsics it is the whole sphere; with fov_deg it has square pixels,
    with intrinsics fx and fy pixels per radian. What lies beyond the poles, or beyond 180° to
    the left and right, shows nothing.
    """

    EXAMPLE: ClassVar = {"type": "equirectangular"}
    MODEL: ClassVar = EQUIRECTANGULAR


def _fold(sensor: Node, node: Node) -> str | None:
    """Why a lens is not one-to-one; what is drawn is looked at when it is (``Sensor.draw``)."""
    size, kind = sensor["resolution"], kind_of("lens", node["type"])
    numbers = {name: node.constant(name) for name in keys_of(kind) if name in node}
    if None in (size, *numbers.values()):
        return None
    made = kind(**numbers).made()
    fov, given = sensor.constant("fov_deg"), sensor.at("intrinsics")
    if "intrinsics" in sensor:
        fx, fy, cx, cy = map(given.constant, ("fx", "fy", "cx", "cy"))
        skew = given.constant("skew") if "skew" in given else 0.0
        if fx is None or fy is None or cx is None or cy is None or skew is None:
            return None
        return find_fault(made, (fx, fy, cx, cy, skew), tuple(size))
    if fov is None and ("fov_deg" in sensor or made.model != EQUIRECTANGULAR):
        return None
    intrinsics = lens_intrinsics(made, tuple(size), fov)
    if isinstance(intrinsics, str):
        return intrinsics
    return find_fault(made, intrinsics, tuple(size))
