"""Measures what float32 positions cost in a batch, against what is promised and a pixel shows."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.arithmetic import elementary
from scenec.compiler.mesh.plan import TerrainPlan
from scenec.compiler.mesh.tiles import TILE_CELLS
from scenec.compiler.scene.ground import Ground
from scenec.compiler.scene.objects import Objects
from scenec.compiler.scene.rig import Rig, Sensor
from scenec.compiler.terrain.grid import HeightField
from scenec.compiler.terrain.program import ReliefResult
from scenec.compiler.views.resolution import pixels_per_meter, views_of
from scenec.schemas.affine import box_around
from scenec.schemas.codec import Facts
from scenec.schemas.errors import SceneError

#: Precision promised of a position: this part of the extent, the step of float32 (2**-24).
FLOAT32_STEP = 6e-8
#: From here on the compiler warns: a fiftieth of the tolerance that meshes have by default.
WARN_PX = 0.01
#: Beyond it there is no stage: annotation is what is at pixels' centers, and what is moved by half
#: a pixel is at its neighbor's.
REFUSE_PX = 0.5


def require_resolvable(
    rigs: tuple[Rig, ...],
    field: HeightField,
    pixels_per_m: NDArray[np.float64] | None,
    unseen: float,
) -> None:
    """Refuse ground that float32 cannot hold, and cameras whose pixels are finer than it can.

    Asked before the ground is meshed as finely as such a camera would have it.

    Args:
        field: The terrain; positions in its tiles are off by between 2**-26 and 2**-25 of the
            largest tile's size. The first of these counts.
        pixels_per_m: Of all of them, see ``views.resolution``; None without cameras.
        unseen: As it was made with.

    Raises:
        SceneError: The error of positions exceeds half the grid's spacing, so that its samples fall
            together, or ``REFUSE_PX`` where a camera is nearest.
    """
    span = _largest_tile(field)
    error = 0.25 * FLOAT32_STEP * span
    spacing = min(field.grid.spacing_m)
    if error > 0.5 * spacing:
        raise SceneError(
            f"/terrain/relief: a tile of the ground is {span:.6g} m high, and float32 holds its "
            f"positions within {error:.3g} m, with samples {spacing:.6g} m apart; expected at most "
            f"half of that: relief of {0.5 * spacing / error * span:.3g} m or less within a tile"
        )
    if pixels_per_m is None:
        return
    if error * float(pixels_per_m.max(initial=0.0)) > REFUSE_PX:
        refuse(rigs, field, unseen, error, f"in tiles of {span:.6g} m")


def _largest_tile(field: HeightField) -> float:
    """Largest extent of a tile of the ground along any axis, meters."""
    (rows, columns), (step_x, step_y) = field.height.shape, field.grid.spacing_m
    span = 0.0
    for v in range(0, rows - 1, TILE_CELLS):
        for u in range(0, columns - 1, TILE_CELLS):
            tile = field.height[v : v + TILE_CELLS + 1, u : u + TILE_CELLS + 1]
            high, wide = tile.shape
            span = max(span, (wide - 1) * step_x, (high - 1) * step_y, float(np.ptp(tile)))
    return span


def refuse(
    rigs: tuple[Rig, ...], field: HeightField, unseen: float, error_m: float, where: str
) -> None:
    """Raise what is wrong with the camera that looks most closely.

    Args:
        unseen: See ``views.resolution``.
        error_m: How far float32 moves a position.
        where: Over what extent it holds positions.

    Raises:
        SceneError: Always but where the closest look is a lidar's, which has no pixels.
    """
    candidates: list[tuple[float, Rig, Sensor]] = []
    for rig in rigs:
        for sensor in rig.sensors:
            alone = Rig(rig.name, rig.to_world, (sensor,), rig.times, (), rig.between)
            near = pixels_per_meter(field, views_of((alone,)), unseen)
            candidates.append((float(near.max(initial=0.0)), rig, sensor))
    if not candidates:
        return
    nearest, rig, sensor = max(candidates, key=lambda one: one[0])
    off = error_m * nearest
    if off <= REFUSE_PX:
        return
    width, focal = sensor.resolution[0], max(sensor.intrinsics[:2])
    most = focal * REFUSE_PX / off
    least = 360.0 / elementary.PI * elementary.atan2(0.5 * width, most)
    now = 360.0 / elementary.PI * elementary.atan2(0.5 * width, focal)
    raise SceneError(
        f"/rigs/{rig.name}/sensors/{sensor.name}: float32 holds positions {where} within "
        f"{error_m:.3g} m, which is {off:,.3g} pixels of this camera, whose field of view is "
        f"{now:.6g} degrees (a focal length of {focal:.6g} px); expected at most {REFUSE_PX:g}: a "
        f"field of view of {least:.3g} degrees or more (a focal length of {most:.6g} px or less), "
        f"or a camera {off / REFUSE_PX:.3g} times as far from the ground, or a smaller terrain"
    )


def find_precision(
    drawn_terrain: TerrainPlan,
    relief: ReliefResult,
    rigs: tuple[Rig, ...],
    near: NDArray[np.float64] | None,
    ground: Ground,
    ground_error_m: float,
    objects: Objects,
    errors_m: tuple[float, ...],
) -> tuple[NDArray[np.float64], Facts]:
    """Finds the bounds of terrain and objects, float64 [2, 3], and how precise float32 is there.

    Reported are the longest side of the bounds, the precision promised for it and the largest
    error made, in meters, and in pixels where the ground is seen largest (None without cameras).
    Vertices are held in tiles, which keeps the error far below the promise where there are many.

    Args:
        near: Pixels of a meter on the ground; None without cameras.
        ground_error_m, errors_m: The largest of positions, of each class.

    Raises:
        SceneError: Positions are off by more than ``REFUSE_PX``.
    """
    bounds = _bounds(ground, objects)
    extent = float((bounds[1] - bounds[0]).max())
    error = max((ground_error_m, *errors_m))
    nearest = None if near is None else float(near.max(initial=0.0))
    if nearest is not None and error * nearest > REFUSE_PX:
        what = f"over {extent:.6g} m up to {np.abs(bounds).max():.6g} m away"
        refuse(rigs, relief.field, drawn_terrain.meshing.unseen, error, what)
    return bounds, {
        "precision": {
            "extent_m": extent,
            "promised_m": FLOAT32_STEP * extent,
            "float32_error_max_m": error,
            "pixels_per_m_max": nearest,
            "promised_px": None if nearest is None else FLOAT32_STEP * extent * nearest,
            "float32_error_max_px": None if nearest is None else error * nearest,
        }
    }


def _bounds(ground: Ground, objects: Objects) -> NDArray[np.float64]:
    low, high = np.full(3, np.inf), np.full(3, -np.inf)
    for tile in ground.tiles:
        ends = tile.translate + box_around(tile.points)
        low, high = np.minimum(low, ends[0]), np.maximum(high, ends[1])
    for one in objects:
        if one.count:
            middles, radii = one.balls()
            low = np.minimum(low, box_around(middles - radii[:, None])[0])
            high = np.maximum(high, box_around(middles + radii[:, None])[1])
    return np.stack([low, high])
