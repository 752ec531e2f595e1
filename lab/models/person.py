"""A standing person as a dressed mannequin: smooth unions of round cones and ellipsoids."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from scenec.lab.models.glb import Look, Model
from scenec.lab.models.solids import Assembly, gradient, surface_nets
from scenec.lab.models.surfaces import Floats, unit

LOOKS = {
    "skin": Look((0.430, 0.270, 0.200), 0.55),
    "hair": Look((0.030, 0.021, 0.016), 0.60),
    "jacket": Look((0.055, 0.095, 0.150), 0.85),
    "trousers": Look((0.075, 0.068, 0.055), 0.90),
    "leather": Look((0.040, 0.025, 0.018), 0.45),
}

type Field = Callable[[Floats], Floats]


def _cone(a: Sequence[float], b: Sequence[float], r: float, s: float) -> Field:
    """A round cone from radius ``r`` at ``a`` to ``s`` at ``b``; a capsule where they are equal."""
    start, along = np.asarray(a, np.float64), np.asarray(b, np.float64) - np.asarray(a, np.float64)
    length = float(along @ along)

    def field(p: Floats) -> Floats:
        t = np.clip((p - start) @ along / length, 0.0, 1.0)
        away = p - start - t[:, None] * along
        distance: Floats = np.sqrt((away * away).sum(axis=1)) - (r + (s - r) * t)
        return distance

    return field


def _ball(center: Sequence[float], radii: Sequence[float]) -> Field:
    """An ellipsoid; of first order near its surface (Quilez)."""
    middle, size = np.asarray(center, np.float64), np.asarray(radii, np.float64)

    def field(p: Floats) -> Floats:
        q = (p - middle) / size
        near = np.sqrt((q * q).sum(axis=1))
        slope = np.sqrt(((q / size) ** 2).sum(axis=1))
        distance: Floats = near * (near - 1.0) / np.maximum(slope, 1e-6)
        return distance

    return field


def _joined(*fields: Field, soft: float) -> Field:
    """Their smooth union: polynomial, over a width of ``soft``."""

    def field(p: Floats) -> Floats:
        out = fields[0](p)
        for other in fields[1:]:
            more = other(p)
            h = np.maximum(soft - np.abs(out - more), 0.0) / soft
            out = np.minimum(out, more) - 0.25 * soft * h * h
        return out

    return field


def _cut(inside: Field, direction: Sequence[float], at: float) -> Field:
    """What lies on the side of a plane that its direction points away from."""
    normal = np.asarray(direction, np.float64)

    def field(p: Floats) -> Floats:
        return np.maximum(inside(p), p @ normal - at)

    return field


def _both(fields: Callable[[float], Field], soft: float) -> Field:
    return _joined(fields(-1.0), fields(1.0), soft=soft)


def _arm(s: float) -> Field:
    shoulder, elbow = (s * 0.178, 0.012, 1.412), (s * 0.248, 0.030, 1.135)
    wrist = (s * 0.275, -0.040, 0.905)
    return _joined(
        _cone(shoulder, elbow, 0.060, 0.047), _cone(elbow, wrist, 0.047, 0.037), soft=0.02
    )


def _hand(s: float) -> Field:
    palm = _ball((s * 0.276, -0.062, 0.835), (0.019, 0.040, 0.052))
    wrist = _cone((s * 0.275, -0.045, 0.92), (s * 0.276, -0.055, 0.865), 0.026, 0.024)
    fingers = [
        _cone(
            (s * 0.275, -0.086 + 0.018 * k, 0.80),
            (s * (0.262 + 0.002 * k), -0.080 + 0.014 * k, 0.735 - 0.006 * (1.5 - abs(k - 1.5))),
            0.0095,
            0.0080,
        )
        for k in range(4)
    ]
    thumb = _cone((s * 0.272, -0.085, 0.850), (s * 0.250, -0.118, 0.795), 0.013, 0.009)
    return _joined(palm, wrist, *fingers, thumb, soft=0.014)


def _leg(s: float) -> Field:
    hip, knee = (s * 0.085, 0.0, 0.900), (s * 0.102, -0.012, 0.490)
    ankle = (s * 0.112, 0.022, 0.085)
    calf = _ball((s * 0.108, 0.034, 0.360), (0.058, 0.062, 0.150))
    return _joined(
        _cone(hip, knee, 0.084, 0.066), _cone(knee, ankle, 0.066, 0.058), calf, soft=0.03
    )


def _shoe(s: float) -> Field:
    sole = _cone((s * 0.114, 0.045, 0.040), (s * 0.140, -0.140, 0.030), 0.043, 0.045)
    instep = _cone((s * 0.113, 0.022, 0.075), (s * 0.130, -0.080, 0.052), 0.044, 0.036)
    return _cut(_joined(sole, instep, soft=0.03), (0.0, 0.0, -1.0), 0.0)


def person() -> Model:
    """A person standing, 1.80 m, as a mannequin in jacket and trousers; faces -y."""
    parts = Assembly(LOOKS)
    head = _joined(
        _ball((0.0, 0.008, 1.695), (0.077, 0.098, 0.103)),
        _ball((0.0, -0.028, 1.625), (0.060, 0.068, 0.070)),
        _cone((0.0, 0.020, 1.46), (0.0, 0.012, 1.60), 0.056, 0.052),
        soft=0.05,
    )
    face = _joined(
        head,
        _cone((0.0, -0.092, 1.685), (0.0, -0.112, 1.650), 0.008, 0.014),
        _ball((-0.079, 0.018, 1.668), (0.009, 0.018, 0.030)),
        _ball((0.079, 0.018, 1.668), (0.009, 0.018, 0.030)),
        soft=0.012,
    )
    skull = _joined(
        _ball((0.0, 0.020, 1.705), (0.085, 0.102, 0.100)),
        _ball((0.0, 0.055, 1.655), (0.078, 0.062, 0.090)),
        soft=0.04,
    )
    hair = _cut(skull, (0.0, -0.62, -0.785), -1.345)
    torso = _joined(
        _ball((0.0, 0.005, 1.300), (0.172, 0.112, 0.180)),
        _ball((0.0, 0.000, 1.080), (0.150, 0.106, 0.180)),
        _cone((-0.082, 0.004, 0.880), (0.082, 0.004, 0.880), 0.118, 0.118),
        _cone((-0.150, 0.012, 1.418), (0.150, 0.012, 1.418), 0.058, 0.058),
        _cone((0.0, 0.018, 1.42), (0.0, 0.016, 1.505), 0.080, 0.066),
        soft=0.09,
    )
    jacket = _joined(torso, _both(_arm, 0.01), soft=0.035)
    jacket = _cut(_cut(jacket, (0.0, 0.0, -1.0), -0.860), (0.0, -0.25, 1.0), 1.518)
    trousers = _joined(
        _ball((0.0, 0.004, 0.930), (0.152, 0.108, 0.120)), _both(_leg, 0.015), soft=0.05
    )
    trousers = _cut(_cut(trousers, (0.0, 0.0, -1.0), -0.062), (0.0, 0.0, 1.0), 0.98)

    def grown(
        name: str, material: str, field: Field, low: Sequence[float], high: Sequence[float],
        step: float,
    ) -> None:  # fmt: skip
        solid = surface_nets(field, low, high, step)
        normals = unit(gradient(field, solid.points, 0.3 * step))
        parts.part(name, material).add(solid.points, solid.faces, normals)

    face = _cut(face, (0.0, 0.0, -1.0), -1.47)
    grown("head", "skin", face, (-0.12, -0.16, 1.44), (0.12, 0.15, 1.83), 0.0115)
    grown("hair", "hair", hair, (-0.12, -0.14, 1.50), (0.12, 0.16, 1.84), 0.014)
    for s in (-1.0, 1.0):
        x = sorted((s * 0.22, s * 0.32))
        grown("hands", "skin", _hand(s), (x[0], -0.15, 0.70), (x[1], 0.02, 0.97), 0.0095)
        x = sorted((s * 0.04, s * 0.21))
        grown("shoes", "leather", _shoe(s), (x[0], -0.21, -0.0337), (x[1], 0.12, 0.14), 0.013)
    grown("jacket", "jacket", jacket, (-0.35, -0.18, 0.80), (0.35, 0.18, 1.60), 0.0200)
    grown("trousers", "trousers", trousers, (-0.22, -0.17, 0.03), (0.22, 0.17, 1.02), 0.0190)
    return parts.model()
