"""Refuses cameras and lidars that are below the ground, inside of an object or off the terrain.

What counts is what the stage holds: the ground's triangles, the land's beyond its border, and the
objects' meshes where they are. A vertical line through each camera meets their triangles; a face's
edges belong to one of the faces at them (a half-open rule of equal arithmetic on both sides), so a
line neither slips through a seam nor counts it twice.

A camera is below the ground where the next surface above it shows its upper side, or where all of
the ground is above it; so it may be under an overhang. It is inside of an object if the line leaves
a closed piece of the object's mesh more often than it enters one. Pieces with a border (leaves,
sheets, the shell of a room without a floor) have no inside.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.assets.joining import weld
from scenec.compiler.cameras.plan import RigPlan
from scenec.compiler.geometry.pieces import pieces_of
from scenec.compiler.geometry.poses import composed, cross
from scenec.compiler.geometry.rotations import turned
from scenec.compiler.scene.ground import Ground
from scenec.compiler.scene.objects import Objects, Placed, Prototype, Scatter
from scenec.compiler.scene.rig import Rig
from scenec.schemas.depth_camera import StereoDepth
from scenec.schemas.errors import SceneError
from scenec.schemas.kernels import inlined, kernel

#: So many are listed; of the others their number.
_LISTED: Final = 3
#: Share of the terrain within which its rounded border is.
_WITHIN: Final = 1.0 - 1e-6


@dataclass(frozen=True)
class _Eyes:
    """Holds positions of the sensors of all rigs, at the samples that trigger them.

    Attributes:
        at: float64 [n, 3], meters.
        sample: int64 [n].
        sensor: Index of the sensor's name, int64 [n].
        names: Places of sensors in the cfg.
    """

    at: NDArray[np.float64]
    sample: NDArray[np.int64]
    sensor: NDArray[np.int64]
    names: tuple[str, ...]


class _PointColumn(NamedTuple):
    """Describes what vertical lines through points meet, [n] each.

    Attributes:
        above: Height of the next surface above, +inf without one.
        upper: Whether that shows its upper side there.
        below: Height of the next surface below, or at the point; -inf without one.
        leaves: How much more often the line leaves the mesh above than it enters it.
        crosses: How often it meets the mesh above.
    """

    above: NDArray[np.float64]
    upper: NDArray[np.bool_]
    below: NDArray[np.float64]
    leaves: NDArray[np.int64]
    crosses: NDArray[np.int64]

    @classmethod
    def empty(cls, count: int) -> _PointColumn:
        """Makes the column of lines that have met nothing yet."""
        return cls(
            np.full(count, np.inf),
            np.zeros(count, np.bool_),
            np.full(count, -np.inf),
            np.zeros(count, np.int64),
            np.zeros(count, np.int64),
        )


def require_open(
    drawn_rigs: tuple[RigPlan, ...],
    rigs: tuple[Rig, ...],
    ground: Ground,
    objects: Objects,
    size_m: tuple[float, float],
) -> None:
    """Refuses sensors that are where no camera can be; rigs with ``allow_below`` may be anywhere.

    Args:
        drawn_rigs, rigs: The rigs as drawn and as built.
        ground: The terrain, and the land around it.
        objects: All of them, before any is left out.
        size_m: The terrain's.

    Raises:
        SceneError: Names the first such sensors, their samples and places and the ground there.
    """
    eyes = _eyes_of(
        [rig for plan, rig in zip(drawn_rigs, rigs, strict=True) if not plan.allow_below]
    )
    if not len(eyes.at):
        return
    order = np.argsort(eyes.at[:, 0], kind="stable")
    eyes = _Eyes(eyes.at[order], eyes.sample[order], eyes.sensor[order], eyes.names)
    column, half = _PointColumn.empty(len(eyes.at)), 0.5 * np.array(size_m)
    at, on = eyes.at.copy(), np.abs(eyes.at[:, :2]) <= half
    # One exactly on the border is on the terrain, whose corners are rounded; the order stays.
    inner = np.clip(at[:, :2], -_WITHIN * half, _WITHIN * half)
    at[:, :2] = np.where(on, inner, at[:, :2])
    for tile in ground.meshes:
        _meet(tile.points + tile.translate, tile.faces, at, *column)
    wrong: dict[int, str] = {}
    nothing = np.isinf(column.above) & np.isinf(column.below) & ~on.all(axis=1)
    for k in np.flatnonzero(nothing).tolist():
        wrong[k] = (
            f"is off the terrain, which goes from {_place(-half)} to {_place(half)} m: there is no "
            "ground (a terrain.horizon makes some)"
        )
    below = np.isfinite(column.above) & (column.upper | np.isinf(column.below))
    for k in np.flatnonzero(below).tolist():
        deep = column.above[k] - eyes.at[k, 2]
        wrong[k] = f"is {deep:.4g} m below the ground, which is at {column.above[k]:.6g} m there"
    for one in objects:
        for k, number in _inside(one, eyes):
            ground_m = f"; the ground is at {column.below[k]:.6g} m there"
            known = ground_m if np.isfinite(column.below[k]) else ""
            wrong.setdefault(k, f"is inside of object {number} of objects/{one.name}{known}")
    if wrong:
        raise SceneError(_message(eyes, wrong))


def _place(xy: NDArray[np.float64]) -> str:
    return f"({xy[0]:g}, {xy[1]:g})"


def _eyes_of(rigs: Sequence[Rig]) -> _Eyes:
    at: list[NDArray[np.float64]] = []
    sample: list[NDArray[np.int64]] = []
    sensor: list[NDArray[np.int64]] = []
    names: list[str] = []

    def add(name: str, poses: NDArray[np.float64], trigger: tuple[int, int]) -> None:
        """Adds poses of a sensor, [s, k, 4, 4]."""
        every, first = trigger
        fired = np.arange(first, len(poses), every)
        at.append(poses[fired, :, :3, 3].reshape(-1, 3))
        sample.append(np.repeat(fired, poses.shape[1]))
        sensor.append(np.full(len(at[-1]), len(names)))
        names.append(name)

    for rig in rigs:
        for one in rig.sensors:
            poses = composed(rig.to_world, one.to_rig)[:, None]
            if one.depth_camera is not None and isinstance(one.depth_camera.model, StereoDepth):
                other = poses.copy()
                other[..., :3, 3] += one.depth_camera.model.baseline_m * poses[..., :3, 0]
                poses = np.concatenate([poses, other], axis=1)
            if one.shutter is not None:
                poses = np.concatenate([poses, one.shutter.to_world], axis=1)
            add(f"rigs/{rig.name}/sensors/{one.name}", poses, one.trigger)
        for lidar in rig.lidars:
            poses = composed(rig.to_world, lidar.to_rig)[:, None]
            add(f"rigs/{rig.name}/lidars/{lidar.name}", poses, lidar.trigger)
    if not names:
        return _Eyes(np.zeros((0, 3)), np.zeros(0, np.int64), np.zeros(0, np.int64), ())
    return _Eyes(np.concatenate(at), np.concatenate(sample), np.concatenate(sensor), tuple(names))


def _inside(objects: Scatter | Placed, eyes: _Eyes) -> Iterator[tuple[int, int]]:
    """Yields points, and the ids of the objects that hold them."""
    middles, radii = objects.balls()
    steps = len(middles) // max(objects.count, 1)
    pairs = _near(middles, radii, steps, eyes)
    if not len(pairs):
        return
    which, at = pairs[:, 0] // max(steps, 1), eyes.at[pairs[:, 1]]
    if isinstance(objects, Scatter):
        turn = turned(objects.orientations[which], objects.scales[which]).astype(np.float64)
    else:
        turn = objects.to_world[which, pairs[:, 0] % steps, :, :3]
    for number in np.unique(objects.prototype[which]):
        own = np.flatnonzero(objects.prototype[which] == number)
        local = _solved(turn[own], at[own] - middles[pairs[own, 0]])
        order = np.argsort(local[:, 0], kind="stable")
        held = np.zeros(len(own), np.bool_)
        held[order] = _held(objects.prototypes[number], np.ascontiguousarray(local[order]))
        for k in own[held]:
            yield int(pairs[k, 1]), int(objects.ids[which[k]])


def _near(
    middles: NDArray[np.float64], radii: NDArray[np.float64], steps: int, eyes: _Eyes
) -> NDArray[np.int64]:
    """Pairs each ball with the points in it at its sample: int64 [p, 2]."""
    none = np.zeros((0, 2), np.int64)
    count = _balls(middles, radii, steps, eyes.at, eyes.sample, none)
    out = np.zeros((count, 2), np.int64)
    _balls(middles, radii, steps, eyes.at, eyes.sample, out)
    return out


def _solved(turn: NDArray[np.float64], offset: NDArray[np.float64]) -> NDArray[np.float64]:
    """Solves for points that matrices [k, 3, 3] bring to offsets [k, 3]; NaN where singular."""
    a, b, c = (turn[:, :, axis].T for axis in range(3))
    rows = np.stack([cross(b, c), cross(c, a), cross(a, b)])
    with np.errstate(divide="ignore", invalid="ignore"):
        whole = (a * rows[0]).sum(axis=0)
        return np.asarray(((rows * offset.T).sum(axis=1) / whole).T)


def _held(prototype: Prototype, local: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Tells which points are inside of closed pieces; points ascend in x, float64 [k, 3]."""
    points = prototype.points.astype(np.float64)
    wound, unwound = _closed(points, prototype.faces)
    oriented = _PointColumn.empty(len(local))
    _meet(points, wound, local, *oriented)
    # Where faces of a closed piece are turned against each other, only their number counts.
    turned_about = _PointColumn.empty(len(local))
    _meet(points, unwound, local, *turned_about)
    return (oriented.leaves != 0) | (turned_about.crosses % 2 == 1)


def _closed(
    points: NDArray[np.float64], faces: NDArray[np.int32]
) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """Returns faces of pieces without a border: consistently wound ones, and others."""
    corners = weld(points)[faces]
    piece = pieces_of(corners, len(points))[corners[:, 0]]
    begin, end = corners.ravel(), np.roll(corners, -1, axis=1).ravel()
    edges = np.minimum(begin, end) * len(points) + np.maximum(begin, end)
    edge = np.unique(edges, return_inverse=True)[1]
    balance = np.bincount(edge, np.where(begin < end, 1.0, -1.0))[edge]
    odd = np.bincount(edge)[edge] % 2
    of = np.repeat(piece, 3)
    open_, twisted = (np.bincount(of, some != 0)[piece] > 0 for some in (odd, balance))
    return faces[~open_ & ~twisted], faces[~open_ & twisted]


def _message(eyes: _Eyes, wrong: dict[int, str]) -> str:
    """Lists the first of each sensor and sample that is wrong, in a line, in the cfg's order."""
    first: dict[tuple[int, int], int] = {}
    for k in sorted(wrong):
        first.setdefault((int(eyes.sensor[k]), int(eyes.sample[k])), k)
    # A fault of the rig is one of each of its sensors: what differs is said first.
    parts = []
    for sensor, sample in sorted(first, key=lambda one: (one[1], one[0]))[:_LISTED]:
        k = first[sensor, sample]
        x, y, z = eyes.at[k]
        place = f"sample {sample} at ({x:.6g}, {y:.6g}, {z:.6g}) m"
        parts.append(f"{eyes.names[sensor]}: {place} {wrong[k]}")
    more = len(first) - len(parts)
    text = "; ".join(parts) + (f"; and {more} more like these" if more else "")
    return (
        f"{text}: expected sensors above the ground and outside of objects (allow_below: true on a "
        "rig is for those that are meant to be there)"
    )


@inlined
def _rise(ax, ay, bx, by, x, y):  # type: ignore[no-untyped-def]
    """Returns 1 or -1 if an edge passes right of a point, up or down in y; else 0."""
    if (ay > y) == (by > y):
        return 0
    if by > ay:
        return 1 if (bx - ax) * (y - ay) > (x - ax) * (by - ay) else 0
    # As of the face on the other side, so that both say the same.
    return -1 if (ax - bx) * (y - by) > (x - bx) * (ay - by) else 0


@inlined
def _first(at, x):  # type: ignore[no-untyped-def]
    """Returns the first point not below a value; points ascend in x."""
    low, high = 0, len(at)
    while low < high:
        middle = (low + high) // 2
        if at[middle, 0] < x:
            low = middle + 1
        else:
            high = middle
    return low


@kernel
def _meet(points, faces, at, above, upper, below, leaves, crosses):  # type: ignore[no-untyped-def]
    """Adds a mesh to what vertical lines through points, rising in x, meet (``_PointColumn``)."""
    for f in range(len(faces)):
        a, b, c = faces[f]
        ax, ay, az = points[a]
        bx, by, bz = points[b]
        cx, cy, cz = points[c]
        right = max(ax, max(bx, cx))
        low, high = min(ay, min(by, cy)), max(ay, max(by, cy))
        k = _first(at, min(ax, min(bx, cx)))
        while k < len(at) and at[k, 0] <= right:
            x, y, z = at[k]
            k += 1
            if not low <= y <= high:
                continue
            turn = _rise(ax, ay, bx, by, x, y)
            turn += _rise(bx, by, cx, cy, x, y)
            turn += _rise(cx, cy, ax, ay, x, y)
            if turn == 0:
                continue
            # A vertical face that rounding lets a line meet counts with its middle.
            height = (az + bz + cz) / 3.0
            area = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)
            if area != 0.0:
                v = ((x - ax) * (cy - ay) - (y - ay) * (cx - ax)) / area
                w = ((bx - ax) * (y - ay) - (by - ay) * (x - ax)) / area
                height = az + v * (bz - az) + w * (cz - az)
            n = k - 1
            if height > z:
                leaves[n] += turn
                crosses[n] += 1
                if height < above[n]:
                    above[n], upper[n] = height, turn > 0
            elif height > below[n]:
                below[n] = height


@kernel
def _balls(middles, radii, steps, at, sample, out):  # type: ignore[no-untyped-def]
    """Counts pairs of ball and point in it; writes them where there is room, int64 [p, 2]."""
    count = 0
    for i in range(len(middles)):
        x, y, z = middles[i]
        radius = radii[i]
        k = _first(at, x - radius)
        while k < len(at) and at[k, 0] <= x + radius:
            dx, dy, dz = at[k, 0] - x, at[k, 1] - y, at[k, 2] - z
            if (steps <= 1 or sample[k] == i % steps) and (
                dx * dx + dy * dy + dz * dz <= radius * radius
            ):
                if count < len(out):
                    out[count, 0], out[count, 1] = i, k
                count += 1
            k += 1
    return count
