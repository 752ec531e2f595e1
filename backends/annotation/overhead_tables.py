"""Tables that stand beside maps: instances and how deep they lie in the ground, cameras' paths."""

from __future__ import annotations

from dataclasses import fields

import numpy as np
from numpy.typing import NDArray

from scenec.backends.annotation.instances import Instances
from scenec.backends.annotation.terrain import look_down
from scenec.backends.exact import ExactCaster
from scenec.backends.stage.scene import RenderScene
from scenec.schemas import stage as names
from scenec.schemas.kernels import kernel
from scenec.schemas.site_map import Table
from scenec.schemas.threads import over_threads


def ground_area(scene: RenderScene) -> tuple[float, float, float, float]:
    """West, south, east and north border of what is no instance, without the horizon.

    Of a scene that is instances alone those of all.
    """
    ground = scene.rows.instance_id == 0
    far = np.array([mesh.path == names.HORIZON for mesh in scene.meshes], bool)
    ground &= ~far[scene.rows.mesh]
    which = np.flatnonzero(ground if ground.any() else ~far[scene.rows.mesh])
    boxes = world_boxes(scene, which, 0)
    if not len(boxes):
        return 0.0, 0.0, 0.0, 0.0
    low, high = boxes[:, 0].min(axis=0), boxes[:, 1].max(axis=0)
    return float(low[0]), float(low[1]), float(high[0]), float(high[1])


def world_boxes(scene: RenderScene, rows: NDArray[np.int64], sample: int) -> NDArray[np.float64]:
    """Boxes around the vertices of rows as they stand at a sample, float64 [n, 2, 3], exact."""
    points = [mesh.used_points if len(mesh.faces) else mesh.box for mesh in scene.meshes]
    first = np.cumsum([0, *map(len, points)])
    flat = np.concatenate([np.empty((0, 3)), *points])
    at = scene.rows_at(sample).to_world[rows]
    out = np.empty((len(rows), 2, 3))
    over_threads(_boxes, len(rows), flat, first, scene.rows.mesh[rows], at, out)
    return out


@kernel
def _boxes(first, last, points, start, mesh, to_world, out):  # type: ignore[no-untyped-def]
    for k in range(first, last):
        m = to_world[k]
        for i in range(3):
            low, high = np.inf, -np.inf
            for n in range(start[mesh[k]], start[mesh[k] + 1]):
                p = points[n]
                value = ((m[i, 0] * p[0] + m[i, 1] * p[1]) + m[i, 2] * p[2]) + m[i, 3]
                low, high = min(low, value), max(high, value)
            out[k, 0, i], out[k, 1, i] = low, high


def objects_table(
    scene: RenderScene,
    caster: ExactCaster,
    instances: Instances,
    sample: int,
    area_m: tuple[float, ...],
) -> Table:
    """Instances whose middle lies in an area: where, how large, how deep in the ground.

    Args:
        scene: The stage.
        caster: Of it; is posed at the sample.
        instances: Of it.
        sample: Time code.
        area_m: West, south, east and north border.

    Returns:
        Columns. ``x_m`` and ``y_m`` are the middle of the box around its vertices, ``size_m`` the
        longest side of that in its own frame, ``height_m`` what its vertices rise from the lowest
        to the highest. ``ground_m`` is the height of the highest ground (what is no instance) at
        that middle; above it stand ``above_ground_m``, and ``burial`` is the share of ``height_m``
        that lies below it. NaN where there is no ground.
    """
    table = instances.table()
    slots = instances.slot_of_row
    rows = np.flatnonzero(slots >= 0)
    rows = rows[np.argsort(slots[rows], kind="stable")]
    boxes = world_boxes(scene, rows, sample)
    # What is hidden is a point: it would widen the box of what is one of several poses.
    hidden = (boxes[:, 0] == boxes[:, 1]).all(axis=1)
    boxes[hidden] = np.array([np.inf, -np.inf])[:, None]
    begin = np.flatnonzero(np.diff(slots[rows], prepend=-1))
    none = np.empty((0, 3))
    low = np.minimum.reduceat(boxes[:, 0], begin) if len(begin) else none
    high = np.maximum.reduceat(boxes[:, 1], begin) if len(begin) else none
    with np.errstate(invalid="ignore"):
        x, y = 0.5 * (low[:, :2] + high[:, :2]).T
    west, south, east, north = area_m
    inside = (west <= x) & (x <= east) & (south <= y) & (y <= north) & (high > low).any(axis=1)
    which = np.flatnonzero(inside)
    x, y, bottom, top = x[which], y[which], low[which, 2], high[which, 2]
    ground = ground_heights(scene, caster, sample, x, y)
    box = table.size(sample)[1][which].astype(np.float64)
    with np.errstate(invalid="ignore", divide="ignore"):
        burial = np.clip((ground - bottom) / (top - bottom), 0.0, 1.0)
    return {
        "instance": table.id[which],
        "class": [table.classes[k] for k in table.class_index[which].tolist()],
        "id": table.local_id[which],
        "x_m": x,
        "y_m": y,
        "z_m": 0.5 * (bottom + top),
        "size_m": (box[:, 1] - box[:, 0]).max(axis=1, initial=0.0),
        "height_m": top - bottom,
        "ground_m": ground,
        "above_ground_m": top - ground,
        "burial": burial,
    }


def craters_table(
    scene: RenderScene, caster: ExactCaster, sample: int, area_m: tuple[float, ...]
) -> Table:
    """Craters whose centers lie in an area, oldest first; no column where the stage tells of none.

    Returns:
        Columns: those of ``CraterTable``; ``crater`` is the place in the stage's table, ``z_m`` the
        height of the ground at the center, NaN where there is none.
    """
    table = scene.craters
    if table is None:
        return {}
    west, south, east, north = area_m
    x, y = table.x_m, table.y_m
    which = np.flatnonzero((west <= x) & (x <= east) & (south <= y) & (y <= north))
    columns = {one.name: getattr(table, one.name)[which] for one in fields(table)}
    x, y = columns.pop("x_m"), columns.pop("y_m")
    z = ground_heights(scene, caster, sample, x, y)
    return {"crater": which, "x_m": x, "y_m": y, "z_m": z, **columns}


def ground_heights(
    scene: RenderScene,
    caster: ExactCaster,
    sample: int,
    x: NDArray[np.float64],
    y: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Heights of the highest of what is no instance, NaN where there is none, float64 [n]."""
    caster.pose(sample)
    rays, hits = look_down(scene, caster, x, y, scene.rows.instance_id == 0)
    return np.where(hits.row < 0, np.nan, rays.origins[:, 2] - hits.t)


def paths_table(scene: RenderScene) -> Table:
    """Where each camera is at each sample, and where it looks.

    Returns:
        Columns; ``heading_deg`` is clockwise from north, ``pitch_deg`` above the horizontal plane.
    """
    cameras = [(n, camera) for n, of in enumerate(scene.cameras) for camera in of]
    cameras.sort(key=lambda pair: (pair[1].name, pair[0]))
    sample = np.array([n for n, _ in cameras], np.int64)
    poses = np.array([camera.camera_to_world for _, camera in cameras]).reshape(-1, 4, 4)
    place, ahead = poses[:, :3, 3], poses[:, :3, 2]
    return {
        "camera": [camera.name for _, camera in cameras],
        "sample": sample,
        "time_s": scene.times[sample],
        "x_m": place[:, 0],
        "y_m": place[:, 1],
        "z_m": place[:, 2],
        "heading_deg": np.degrees(np.arctan2(ahead[:, 0], ahead[:, 1])) % 360.0,
        "pitch_deg": np.degrees(np.arctan2(ahead[:, 2], np.hypot(ahead[:, 0], ahead[:, 1]))),
    }
