"""Covers stones with what has settled on them or seeped up: dust, snow, moss, a wet foot."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.arithmetic import elementary
from scenec.compiler.geometry.icosphere import EDGE
from scenec.compiler.kinds import forms, key, noise_key
from scenec.compiler.noise.perlin import fbm3
from scenec.compiler.objects.rocks import Chain
from scenec.compiler.scene.objects import Coating, Prototype
from scenec.schemas.kernels import kernel

#: Slopes over which a coating thins out at its steepest, degrees to either side.
_SOFT_DEG = 12.0
#: Width of the hollows that count, in radians seen from a stone's middle.
_REACH = 0.2
#: What lies so far below its surroundings is a hollow, so far above a ridge, in a stone's size.
_DEEP = 0.012
#: How far a coating's border wanders, in parts of what it thins out over.
_RAGGED = 0.9
#: Frequency of that, in waves a size.
_WAVES = 7.0


@dataclass(frozen=True, kw_only=True)
class CoatingPlan:
    """A material on rocks as they rest: on tops, in hollows, and next to the ground. Labels ignore
    it.
    """

    EXAMPLE: ClassVar = {"material": "dust", "tops": 0.7, "foot_height": 0.2}

    TITLE: ClassVar = "Objects: rocks: coating"
    material: str = key(forms.TEXT)
    """Name of a material."""
    tops: float = key(forms.FRACTION_PER_BATCH, default=0.8)
    """Share of what faces up that it covers; ridges stay bare."""
    max_slope_deg: float = key(forms.PER_BATCH, default=35, at_least=0, at_most=180, unit="deg")
    """Steepest slope that it lies on, fading over 12 degrees to either side."""
    hollows: float = key(forms.FRACTION_PER_BATCH, default=0.6)
    """Share that it covers of hollows, unless they face down."""
    foot: float = key(forms.FRACTION_PER_BATCH, default=1)
    """Share that it covers next to the ground, at the mean embed of the class."""
    foot_height: float = key(forms.PER_BATCH, default=0.15, at_least=0.01, at_most=1)
    """How high the foot reaches, in parts of a rock's height."""
    key: int = noise_key()


def coat(chains: Sequence[Chain], plans: Sequence[CoatingPlan], embed: float) -> tuple[Chain, ...]:
    """All levels of stones with their coatings.

    Args:
        embed: Part of a stone's height below ground, the same for all instances of a prototype.
    """
    return tuple(tuple(_coated(mesh, plans, embed) for mesh in chain) for chain in chains)


def _coated(mesh: Prototype, plans: Sequence[CoatingPlan], embed: float) -> Prototype:
    points, normals = mesh.points.astype(np.float64), mesh.normals.astype(np.float64)
    # Of an icosphere: 10 * 4^n + 2 points.
    spacing = EDGE / np.sqrt(0.1 * (len(points) - 2.0))
    edges = _REACH / spacing
    below = _depths(points, normals, mesh.faces, max(1, round(edges * edges)))
    low, high = points[:, 2].min(), points[:, 2].max()
    above = (points[:, 2] - low) / (high - low) - embed
    return replace(
        mesh,
        coatings=tuple(
            Coating(plan.material, _weights(plan, points, normals, below / _DEEP, above))
            for plan in plans
        ),
    )


def _weights(
    plan: CoatingPlan,
    points: NDArray[np.float64],
    normals: NDArray[np.float64],
    hollow: NDArray[np.float64],
    above: NDArray[np.float64],
) -> NDArray[np.float32]:
    """Share of the surface that a coating covers at each vertex, float32 [n]."""
    ragged = _RAGGED * _noise(np.uint64(plan.key), points)
    up = normals[:, 2]
    steepest, flattest = (
        elementary.cos(elementary.PI / 180.0 * min(max(plan.max_slope_deg + side, 0.0), 180.0))
        for side in (_SOFT_DEG, -_SOFT_DEG)
    )
    lies = elementary.smoothstep_array((up - steepest) / (flattest - steepest) + 0.5 * ragged)
    swept = elementary.smoothstep_array(-hollow - 0.5 + 0.5 * ragged)
    kept = elementary.smoothstep_array(hollow + 0.5 * ragged)
    kept *= elementary.smoothstep_array((up + 0.5) / 0.5)
    near = 1.0 - elementary.smoothstep_array(above / plan.foot_height + ragged)
    bare = (
        (1.0 - plan.tops * lies * (1.0 - swept))
        * (1.0 - plan.hollows * kept)
        * (1.0 - plan.foot * near)
    )
    return (1.0 - bare).astype(np.float32)


@kernel
def _noise(key, points):  # type: ignore[no-untyped-def]
    out = np.empty(len(points))
    for n in range(len(points)):
        x, y, z = points[n]
        out[n] = fbm3(key, _WAVES * x, _WAVES * y, _WAVES * z, 3, 0.6)
    return out


@kernel
def _depths(points, normals, faces, steps):  # type: ignore[no-untyped-def]
    """Returns each vertex's depth below a surface that diffusion has smoothed, along its normal."""
    smooth = points.copy()
    for _step in range(steps):
        total = np.zeros(points.shape)
        count = np.zeros(len(points))
        for f in range(len(faces)):
            for k in range(3):
                a, b = faces[f, k], faces[f, (k + 1) % 3]
                count[a] += 1.0
                for i in range(3):
                    total[a, i] += smooth[b, i]
        for n in range(len(points)):
            for i in range(3):
                smooth[n, i] = 0.5 * (smooth[n, i] + total[n, i] / count[n])
    out = np.empty(len(points))
    for n in range(len(points)):
        out[n] = 0.0
        for i in range(3):
            out[n] += (smooth[n, i] - points[n, i]) * normals[n, i]
    # A smoothed ball is smaller: what is convex all over is no ridge.
    return out - np.mean(out)
