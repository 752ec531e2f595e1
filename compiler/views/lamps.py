"""Finds what lamps shine on, and leaves out those whose cones hold nothing of the scene."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.arithmetic import elementary
from scenec.compiler.scene.ground import Ground
from scenec.compiler.scene.light import Lamp
from scenec.compiler.scene.objects import Placed, Scatter
from scenec.compiler.views.needed import PASS
from scenec.schemas.affine import box_around
from scenec.schemas.codec import Facts
from scenec.schemas.left_out import entry

#: What rounding can do to angles and distances, relative: far more than it does.
_SLACK = 1e-6


def without_idle(
    lamps: Sequence[Lamp], ground: Ground, objects: Sequence[Scatter | Placed]
) -> tuple[tuple[Lamp, ...], list[Facts]]:
    """The lamps that light something at one sample at least; entries about the others.

    Conservative: geometry counts as the balls around tiles and instances, at all samples; a lamp as
    the ball it is.
    """
    if not lamps:
        return (), []
    balls = [_ball_of_tiles(ground), *(one.balls() for one in objects)]
    middles = np.concatenate([middle for middle, _ in balls])
    radii = np.concatenate([radius for _, radius in balls])
    kept, left_out = [], []
    for lamp in lamps:
        if any(in_cone(lamp, i, middles, radii).any() for i in range(len(lamp.to_world))):
            kept.append(lamp)
            continue
        why = "nothing of the scene is in its cone at any sample"
        left_out.append(entry(PASS, f"light/lamps/{lamp.name}", why))
    return tuple(kept), left_out


def _ball_of_tiles(ground: Ground) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    boxes = [box_around(tile.points) for tile in ground.meshes]
    low, high = (np.array([box[end] for box in boxes], np.float64) for end in (0, 1))
    half = 0.5 * (high - low)
    middles = np.array([tile.translate for tile in ground.meshes]) + low + half
    return middles, np.sqrt((half * half).sum(axis=1))


def in_cone(
    lamp: Lamp, sample: int, middles: NDArray[np.float64], radii: NDArray[np.float64]
) -> NDArray[np.bool_]:
    """Selects the balls in a lamp's cone, its apex moved back, at a sample, bool [n]."""
    if not lamp.intensity[sample].any():
        return np.zeros(len(middles), np.bool_)
    half = float(lamp.cone_deg[sample]) * (elementary.PI / 180.0)
    if half >= 0.5 * elementary.PI:
        # More than half of all directions.
        return np.ones(len(middles), np.bool_)
    matrix = lamp.to_world[sample]
    axis = -matrix[:3, 2] / np.sqrt((matrix[:3, 2] * matrix[:3, 2]).sum())
    way = middles - matrix[:3, 3]
    distance = np.sqrt((way * way).sum(axis=1))
    reach = radii + float(lamp.radius_m[sample]) + _SLACK * (distance + radii)
    along = (way * axis).sum(axis=1)
    across = np.sqrt(np.maximum(distance * distance - along * along, 0.0))
    # Distance of a ball's middle to the cone's side; behind the apex it is farther than that.
    beside = across * elementary.cos(half) - along * elementary.sin(half)
    return np.asarray((distance <= reach) | (beside <= reach))
