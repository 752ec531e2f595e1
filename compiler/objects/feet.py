"""Finds where stones that are seated meet the ground, for the fines that are heaped there."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.distributions.numbers import Number, draw_number
from scenec.compiler.kinds import Context, forms, key
from scenec.compiler.mesh.surface import GroundSurface
from scenec.compiler.noise.perlin import fbm3
from scenec.compiler.objects.bodies import Bodies, vertices_of
from scenec.compiler.objects.placement_context import PlacementContext
from scenec.compiler.scene.objects import Scatter
from scenec.compiler.terrain.fillets import SIDES, Feet, Fillets, directions
from scenec.compiler.views.resolution import NEAREST_M, pixels_of_balls
from scenec.schemas.kernels import kernel
from scenec.schemas.threads import over_threads

#: How much a ramp varies about its stone, at most and in waves of noise a unit circle has across.
_VARIES, _MOST_VARIED, _WAVES = 1.3, 0.7, 1.1
#: Ramps lower than so many tolerances of the mesh are left out: they cost triangles, and show less.
_LEAST = 2.0
#: Part of what stands out of the ground that a ramp hides at most, before it varies.
_OF_EXPOSED = 0.3
#: Between the noises of two stones, in waves.
_APART = 7.31
#: Points about a stone that its ground is leveled by, and how far from its middle in its radii.
_POINTS, _AROUND = 8, 0.8


@dataclass(frozen=True, kw_only=True)
class Fillet:
    """A ramp of the ground about a rock's foot, higher and longer on some sides (by up to 70 %);
    the highest counts where several overlap. It is detail of the ground's mesh, with the ground's
    material and labels; later classes are seated on it, poses of cameras ignore it. At most 30 % of
    what stands out of the ground counts as the height. Rocks have none lower than twice
    tolerance_px in the nearest view, and none on a terrain from a mesh, with tolerance_px 0, or
    without cameras.
    """

    EXAMPLE: ClassVar = {"height": {"type": "uniform", "min": 0.04, "max": 0.1}, "reach": 0.4}

    TITLE: ClassVar = "Objects: rocks: fillet"
    height: Number = key(
        forms.FRACTION_PER_INSTANCE, default={"type": "uniform", "min": 0.04, "max": 0.12}
    )
    """Height where it meets the rock, in parts of the rock's size."""
    reach: Number = key(
        forms.PER_INSTANCE,
        default={"type": "uniform", "min": 0.25, "max": 0.6},
        at_least=0.01,
        at_most=10,
    )
    """How far from the rock it ends, in parts of the rock's size."""

    def draw(self, context: Context, n: int) -> FilletPlan:
        """Returns the fillets of n stones."""
        height, reach = (
            draw_number(number, context.streams, f"{context.path}/{name}", n).astype(np.float64)
            for name, number in (("height", self.height), ("reach", self.reach))
        )
        return FilletPlan(height, reach, context.key())


@dataclass(frozen=True)
class FilletPlan:
    """Fines heaped about the feet of a class of stones.

    Attributes:
        height, reach: Of the ramp, in parts of a stone's size, float64 [n].
        key: Of the noise by which it differs from side to side.
    """

    height: NDArray[np.float64]
    reach: NDArray[np.float64]
    key: int


def add_fillets(
    plan: FilletPlan, stones: Scatter, context: PlacementContext
) -> tuple[GroundSurface, int]:
    """The ground with fines about a class of stones, for all that is placed after it.

    Stones have none whose ramp is lower than twice the error that may show in the view that is
    nearest, wherever it looks: what stays is the same whatever is pruned.

    Args:
        stones: At their finest level, where they stand.
        context: The ground that they stand on, and the cameras.

    Returns:
        The ground of ``context``, with detail more or as it was; how many stones have a ramp.
    """
    surface, tolerance_px = context.surface, context.tolerance_px
    if tolerance_px is None or not surface.smooth or not stones.count:
        return surface, 0
    own = stones.ids.astype(np.int64) - 1
    middles, radii = stones.balls()
    size = 2.0 * radii
    height, reach = plan.height[own] * size, plan.reach[own] * size
    near = pixels_of_balls(
        context.views, middles, radii + reach, 1.0, min(NEAREST_M, float(radii.min()))
    )
    least = _LEAST * tolerance_px
    some = np.flatnonzero((height * near >= least) & (height > 0.0) & (reach > 0.0))
    feet = _feet(stones, some, surface, (height[some], reach[some]))
    share = np.empty(feet.outline.shape)
    _shares(np.uint64(plan.key), own[some], directions(), share)
    shown = feet.height * near[some] >= least
    standing = np.flatnonzero(shown & (feet.outline.max(axis=1) > 0.0))
    if not len(standing):
        return surface, 0
    feet = Feet._make(each[standing] for each in feet._replace(share=share))
    return replace(surface, details=(*surface.details, Fillets.of(feet))), len(standing)


def _feet(
    stones: Scatter,
    some: NDArray[np.int64],
    surface: GroundSurface,
    ramps: tuple[NDArray[np.float64], NDArray[np.float64]],
) -> Feet:
    """Outlines of some stones at the height that their ramps have there, 0 where there is none."""
    x, y, z = np.ascontiguousarray(stones.positions[some].T, np.float64)
    bodies = Bodies.of(
        stones.prototypes, stones.prototype[some], (x, y), stones.orientations[some],
        stones.scales[some, 0].astype(np.float64), np.zeros(len(some)),
    )  # fmt: skip
    sizes = [len(p.faces) for p in stones.prototypes]
    faces = np.concatenate([p.faces for p in stones.prototypes])
    planes = _planes(surface, x, y, _AROUND * stones.balls()[1][some])
    middle, outline = np.zeros((2, len(some))), np.zeros((len(some), SIDES))
    height, reach = ramps[0].copy(), ramps[1]
    over_threads(
        _outlines_part, len(some), bodies, z, (faces, np.cumsum([0, *sizes])),
        (planes, height), directions(), (middle, outline),
    )  # fmt: skip
    # As steep as it was.
    reach = reach * (height / ramps[0])
    return Feet(middle[0], middle[1], height, reach, outline, np.ones(outline.shape))


def _planes(
    surface: GroundSurface,
    x: NDArray[np.float64],
    y: NDArray[np.float64],
    radius: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Planes through the ground at even points on circles, least squares: float64 [n, 3].

    Returns:
        Height at the middle, meters, and slopes in x and y.
    """
    round_about = directions()[:: SIDES // _POINTS]
    at = np.stack([x, y], axis=1)[:, None] + radius[:, None, None] * round_about
    px, py = np.ascontiguousarray(at.reshape(-1, 2).T)
    height = surface.height_at(px, py).reshape(-1, _POINTS, 1)
    slopes = (height * round_about).sum(axis=1) / (0.5 * _POINTS * radius[:, None])
    return np.concatenate([height.mean(axis=1), slopes], axis=1)


@kernel
def _outlines_part(first, last, bodies, z0, meshes, ground, ways, out):  # type: ignore[no-untyped-def]
    """Outlines of bodies in planes that are lifted along z, about the middle of their extents.

    Lifts are lowered, in place, to a part of what stands out of the unlifted plane.
    """
    faces, offsets = meshes
    planes, lift = ground
    middle, outline = out
    room = np.empty((4, np.diff(bodies.offsets).max()))
    ends = np.empty((np.diff(offsets).max(), 4))
    for n in range(first, last):
        x, y, z = vertices_of(bodies, n, room[:3])
        above = room[3]
        level, top = planes[n, 0] - z0[n], 0.0
        for p in range(len(z)):
            dx, dy = x[p] - bodies.x[n], y[p] - bodies.y[n]
            above[p] = z[p] - level - planes[n, 1] * dx - planes[n, 2] * dy
            top = max(top, above[p])
        if top == 0.0:
            continue
        lift[n] = min(lift[n], _OF_EXPOSED * top)
        for p in range(len(z)):
            above[p] -= lift[n]
        count = 0
        left = front = np.inf
        right = back = -np.inf
        kind = bodies.prototype[n]
        for f in range(offsets[kind], offsets[kind + 1]):
            found = 0
            for k in range(3):
                a, b = faces[f, k], faces[f, (k + 1) % 3]
                if (above[a] < 0.0) != (above[b] < 0.0):
                    t = above[a] / (above[a] - above[b])
                    px, py = x[a] + t * (x[b] - x[a]), y[a] + t * (y[b] - y[a])
                    ends[count, 2 * found], ends[count, 2 * found + 1] = px, py
                    left, right = min(left, px), max(right, px)
                    front, back = min(front, py), max(back, py)
                    found += 1
            count += found == 2
        if count == 0:
            continue
        mx, my = 0.5 * (left + right), 0.5 * (front + back)
        middle[0, n], middle[1, n] = mx, my
        for s in range(count):
            ax, ay, bx, by = ends[s, 0] - mx, ends[s, 1] - my, ends[s, 2] - mx, ends[s, 3] - my
            for k in range(len(ways)):
                # Where the ray from the middle crosses the line between both.
                before = ways[k, 0] * ay - ways[k, 1] * ax
                after = ways[k, 0] * by - ways[k, 1] * bx
                if (before < 0.0) != (after < 0.0):
                    t = before / (before - after)
                    along = ways[k, 0] * (ax + t * (bx - ax)) + ways[k, 1] * (ay + t * (by - ay))
                    outline[n, k] = max(outline[n, k], along)


@kernel
def _shares(key, stones, ways, out):  # type: ignore[no-untyped-def]
    """By how much ramps of some stones are larger or smaller in each direction."""
    for n in range(len(stones)):
        for k in range(len(ways)):
            x, y = _WAVES * ways[k, 0], _WAVES * ways[k, 1]
            noise = _VARIES * fbm3(key, x, y, _APART * stones[n], 2, 0.5)
            out[n, k] = 1.0 + min(max(noise, -_MOST_VARIED), _MOST_VARIED)
