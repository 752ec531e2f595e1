"""How closely the cameras of a batch look at each part of the terrain."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.arithmetic import elementary
from scenec.compiler.cache.memo import memoized
from scenec.compiler.geometry.lenses import sight_of
from scenec.compiler.geometry.poses import camera_poses, compose
from scenec.compiler.scene.rig import Lidar, Rig
from scenec.compiler.terrain.grid import HeightField
from scenec.compiler.views.hidden import hidden_blocks
from scenec.schemas.kernels import inlined, kernel
from scenec.schemas.threads import POINTS, over_threads

#: Views reach this far beyond their picture's border, in parts of its size: what lies just outside
#: is seen from the next pixel's corner, and casts the nearest shadows.
MARGIN = 0.05
#: No sample counts as nearer than this, meters, or than the grid's spacing where that is finer.
NEAREST_M = 0.05


class Views(NamedTuple):
    """All cameras at all samples.

    Attributes:
        poses: Camera-to-world, OpenCV axes, float64 [c, 3, 4].
        numbers: fx, fy, cx, cy, skew, width, height in pixels, float64 [c, 7].
        hidden: Blocks of ground that lie behind others, bool [c, by, bx]; one of no size: none is
            known to.
        blocks: x and y of the first block's corner, and a block's width in both, float64 [4].
        cones: Of cameras with a lens, cosine and sine of the half angle of a cone around the axis
            that holds all their rays (``lenses.sight_of``; -1 and 0: everything), which counts in
            place of the picture's borders; their fx and fy bound what they magnify. NaN for
            pinholes; without any, all are. float64 [c, 2].
    """

    poses: NDArray[np.float64]
    numbers: NDArray[np.float64]
    hidden: NDArray[np.bool_]
    blocks: NDArray[np.float64]
    cones: NDArray[np.float64] = np.zeros((0, 2))


#: Of a batch without cameras.
NO_VIEWS = Views(np.zeros((0, 3, 4)), np.zeros((0, 7)), np.zeros((0, 0, 0), np.bool_), np.zeros(4))


def views_of(
    rigs: tuple[Rig, ...], field: HeightField | None = None, margin_m: float = 0.0
) -> Views:
    """The views of all rigs' sensors at every sample.

    Args:
        rigs: The cameras.
        field: The terrain, for what hides behind it; None: nothing does.
        margin_m: How far the ground may lie above or below that.
    """
    poses, numbers, cones = [], [], []
    for rig in rigs:
        for sensor in rig.sensors:
            cone, intrinsics = (math.nan, math.nan), sensor.intrinsics
            if sensor.lens is not None:
                cone, focals = sight_of(sensor, MARGIN)
                intrinsics = (*focals, *intrinsics[2:])
            for pose in camera_poses(rig, sensor):
                poses.append(pose[:3])
                numbers.append((*intrinsics, *map(float, sensor.resolution)))
                cones.append(cone)
        for lidar in rig.lidars:
            scale = rays_a_radian(lidar)
            for pose in rig.to_world:
                poses.append(compose(pose, lidar.to_rig)[:3])
                numbers.append((scale, scale, 0.0, 0.0, 0.0, 1.0, 1.0))
                # It looks all around.
                cones.append((-1.0, 0.0))
    if not poses:
        return NO_VIEWS
    cameras = np.array(poses, np.float64)
    views = NO_VIEWS._replace(
        poses=cameras, numbers=np.array(numbers, np.float64), cones=np.array(cones, np.float64)
    )
    if field is None:
        return views
    hidden, blocks = hidden_blocks(field, cameras[:, :, 3], margin_m)
    return views._replace(hidden=hidden, blocks=blocks)


@memoized("views")
def pixels_per_meter(field: HeightField, views: Views, unseen: float) -> NDArray[np.float64]:
    """Pixels that a meter across the view takes at each sample, in the view that shows it largest.

    A sample outside of a view, or behind a hill, counts with a fraction of that: its shadows and
    the light it sends on may still be seen.

    Args:
        field: The terrain.
        views: Cameras at every sample; none: 0 everywhere.
        unseen: The fraction, in [0, 1].

    Returns:
        float64 [ny, nx].
    """
    out = np.zeros(field.grid.shape)
    if len(views.poses):
        over_threads(
            _nearest_views,
            len(field.height),
            *views,
            field.grid.x(),
            field.grid.y(),
            field.height,
            unseen,
            min(NEAREST_M, *field.grid.spacing_m),
            out,
        )
    return out


def pixels_of_balls(
    views: Views,
    points: NDArray[np.float64],
    radius: NDArray[np.float64],
    unseen: float,
    nearest_m: float,
) -> NDArray[np.float64]:
    """Pixels that a meter takes at most anywhere in balls, in the view that shows it largest.

    Args:
        views: The cameras.
        points, radius: The balls, float64 [n, 3] and [n].
        unseen: As in ``pixels_per_meter``.
        nearest_m: No point counts as nearer than this.

    Returns:
        float64 [n].
    """
    out = np.zeros(len(points))
    over_threads(
        _of_balls, len(points), *views, points, radius, unseen, nearest_m, out, least=POINTS
    )
    return out


@inlined
def _is_hidden(hidden, blocks, c, x, y, radius):  # type: ignore[no-untyped-def]
    """Whether all blocks that a ball touches hide from view c."""
    if hidden.shape[0] == 0:
        return False
    i0 = int(np.floor((x - radius - blocks[0]) / blocks[2]))
    i1 = int(np.floor((x + radius - blocks[0]) / blocks[2]))
    j0 = int(np.floor((y - radius - blocks[1]) / blocks[3]))
    j1 = int(np.floor((y + radius - blocks[1]) / blocks[3]))
    # A large one seldom hides as a whole.
    if (i1 - i0) * (j1 - j0) > 16:
        return False
    for j in range(max(j0, 0), min(j1, hidden.shape[1] - 1) + 1):
        for i in range(max(i0, 0), min(i1, hidden.shape[2] - 1) + 1):
            if not hidden[c, j, i]:
                return False
    return True


@inlined
def _in_cone(cosine, sine, depth, square, radius):  # type: ignore[no-untyped-def]
    """Whether a ball reaches into a cone around the axis, from the cosine and sine of its angle."""
    if cosine <= -1.0 or square <= radius * radius:
        return True
    distance = np.sqrt(square)
    ball = radius / distance
    rest = np.sqrt(1.0 - ball * ball)
    # Of the sum of both angles.
    return sine * rest + cosine * ball <= 0.0 or depth >= distance * (cosine * rest - sine * ball)


@inlined
def _pixels(poses, numbers, hidden, blocks, cones, x, y, z, radius, unseen, nearest):  # type: ignore[no-untyped-def]
    """Pixels a meter of a ball in the view that shows it largest."""
    best = 0.0
    for c in range(poses.shape[0]):
        m = poses[c]
        fx, fy, cx, cy, skew, width, rows = numbers[c]
        px = x - m[0, 3]
        py = y - m[1, 3]
        pz = z - m[2, 3]
        distance = max(np.sqrt(px * px + py * py + pz * pz) - radius, nearest)
        value = max(fx, fy) / distance
        # Most views lose here, which spares the rest.
        if value <= best:
            continue
        depth = m[0, 2] * px + m[1, 2] * py + m[2, 2] * pz
        seen = False
        if c < cones.shape[0] and cones[c, 0] == cones[c, 0]:
            seen = _in_cone(cones[c, 0], cones[c, 1], depth, px * px + py * py + pz * pz, radius)
        elif depth > radius:
            # A ball spreads over the picture as it does at its nearest depth, and no farther.
            spread = radius / (depth - radius)
            right = (m[0, 0] * px + m[1, 0] * py + m[2, 0] * pz) / depth
            down = (m[0, 1] * px + m[1, 1] * py + m[2, 1] * pz) / depth
            u = fx * right + skew * down + cx
            v = fy * down + cy
            tall = 1.0 + abs(down)
            wide = MARGIN * width + (fx * (1.0 + abs(right)) + abs(skew) * tall) * spread
            high = MARGIN * rows + fy * tall * spread
            seen = -wide <= u <= width + wide and -high <= v <= rows + high
        elif depth > -radius:
            # The picture's plane through the eye cuts the ball.
            seen = True
        if not seen or _is_hidden(hidden, blocks, c, x, y, radius):
            value *= unseen
        best = max(best, value)
    return best


@kernel
def _of_balls(  # type: ignore[no-untyped-def]
    first, last, poses, numbers, hidden, blocks, cones, points, radius, unseen, nearest, out
):
    for n in range(first, last):
        x, y, z = points[n]
        out[n] = _pixels(poses, numbers, hidden, blocks, cones, x, y, z, radius[n], unseen, nearest)


@kernel
def _nearest_views(  # type: ignore[no-untyped-def]
    first, last, poses, numbers, hidden, blocks, cones, x, y, height, unseen, nearest, out
):
    for j in range(first, last):
        for i in range(x.size):
            out[j, i] = _pixels(
                poses,
                numbers,
                hidden,
                blocks,
                cones,
                x[i],
                y[j],
                height[j, i],
                0.0,
                unseen,
                nearest,
            )


def rays_a_radian(lidar: Lidar) -> float:
    """The largest number of its rays in a radian along the scan, or across it."""
    low, high = lidar.azimuth_deg
    per_degree = lidar.azimuths / max(abs(high - low), 1e-9)
    steps = np.abs(np.diff(np.sort(lidar.elevations_deg, kind="stable")))
    steps = steps[steps > 0.0]
    if len(steps):
        per_degree = max(per_degree, 1.0 / float(steps.min()))
    return per_degree * 180.0 / elementary.PI
