"""Places spot lights over the finished terrain, and meters them."""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.arithmetic import elementary
from scenec.compiler.cache.memo import memoized
from scenec.compiler.cameras.plan import RigPlan
from scenec.compiler.geometry.lenses import pixel_rays
from scenec.compiler.geometry.poses import bearing_vector, compose, look_at
from scenec.compiler.light.lamp import LampPlan, RigMount, WorldMount
from scenec.compiler.light.latlong import luminance
from scenec.compiler.mesh.surface import GroundSurface
from scenec.compiler.scene.exposure import incident_exposure
from scenec.compiler.scene.light import Lamp, SpotLight
from scenec.compiler.scene.rig import Rig, Sensor
from scenec.schemas import stage as names
from scenec.schemas.errors import SceneError

#: From a frame that looks along +z (OpenCV) to one that shines along -z (USD).
_HALF_TURN = np.diag([*names.HALF_TURN, 1.0])
#: A meter's way along its line of sight: first step, steps, and how much longer each is.
_NEAREST_M, _STEPS, _GROWTH = 0.1, 256, 1.05
#: Where it looks for lamplight, as a share of the picture's height, in this order.
_ROWS = (0.5, 0.625, 0.75, 0.875, 1.0)


@memoized("lamps")
def build_lamps(
    plans: tuple[LampPlan, ...], rigs: tuple[Rig, ...], surface: GroundSurface
) -> tuple[Lamp, ...]:
    """All lamps, in the plan's order.

    Raises:
        SceneError: A lamp is so far away that float64 does not hold it.
    """
    return tuple(_lamp(plan, rigs, surface) for plan in plans)


def _lamp(plan: LampPlan, rigs: tuple[Rig, ...], surface: GroundSurface) -> Lamp:
    if isinstance(plan.mount, RigMount):
        mount = plan.mount
        carrier = next(rig for rig in rigs if rig.name == mount.rig)
        poses = [compose(pose, mount.to_rig()) for pose in carrier.to_world]
    else:
        poses = _world_poses(plan.mount, surface)
    to_world = np.stack([compose(pose, _HALF_TURN) for pose in poses])
    if not np.isfinite(to_world).all():
        raise SceneError(f"light/lamps/{plan.name}: its poses overflow; use smaller numbers")
    own = {field.name: getattr(plan, field.name) for field in dataclasses.fields(SpotLight)}
    return Lamp(**own, to_world=to_world)


def _world_poses(mount: WorldMount, surface: GroundSurface) -> list[NDArray[np.float64]]:
    """Poses of a lamp that stands in the world; it looks along +z."""
    on_ground = mount.heights == "ground"
    position = _world_points(mount.points(), on_ground, surface)
    if mount.target is not None:
        target = _world_points(mount.target.points(), on_ground, surface)
    else:
        angle = mount.elevation_deg * (elementary.PI / 180.0)
        level, up = elementary.cos_array(angle), elementary.sin_array(angle)
        bearing = np.array([bearing_vector(float(b)) for b in mount.bearing_deg])
        # In meters about the lamp: far from the origin a unit vector would drown.
        ahead = level[:, None] * bearing
        ahead[:, 2] = up
        poses = [look_at(np.zeros(3), way, 0.0) for way in ahead]
        for pose, at in zip(poses, position, strict=True):
            pose[:3, 3] = at
        return poses
    return [look_at(a, b, 0.0) for a, b in zip(position, target, strict=True)]


def _world_points(
    at: NDArray[np.float64], on_ground: bool, surface: GroundSurface
) -> NDArray[np.float64]:
    out = at.copy()
    if on_ground:
        x, y = (np.ascontiguousarray(at[:, axis]) for axis in (0, 1))
        out[:, 2] += surface.height_at(x, y)
    return out


def lamp_irradiance(lamp: Lamp, sample: int, point: NDArray[np.float64]) -> float:
    """Luminance of the irradiance at a point [3] on a surface that faces the lamp, W/m^2."""
    pose = lamp.to_world[sample]
    offset = point - pose[:3, 3]
    squared = float((offset * offset).sum())
    radius = float(lamp.radius_m[sample])
    if squared <= radius * radius or squared == 0.0:
        return 0.0
    cosine = -float((offset * pose[:3, 2]).sum()) / float(np.sqrt(squared))
    angle = elementary.acos(min(max(cosine, -1.0), 1.0)) * (180.0 / elementary.PI)
    cone = float(lamp.cone_deg[sample])
    start = cone * (1.0 - float(lamp.softness[sample]))
    if angle > cone:
        return 0.0
    x = (angle - start) / (cone - start) if angle > start else 0.0
    falloff = 1.0 - float(elementary.smoothstep_array(x))
    return float(luminance(lamp.intensity[sample])) * falloff / squared


@memoized("lamps")
def meter_lamps(
    rigs: tuple[Rig, ...],
    plans: tuple[RigPlan, ...],
    lamps: tuple[Lamp, ...],
    surface: GroundSurface,
    irradiance: NDArray[np.float64],
) -> tuple[Rig, ...]:
    """The rigs, with metered exposures that count the light of lamps.

    A lamp lights a part of a scene, so it counts where the middle of a picture meets the ground
    (or a place below it, if no lamp lights that), on a surface that faces it: level ground before
    a rover gets its light at a grazing angle, but rocks do not.

    Args:
        irradiance: Of suns and sky, on level ground, [s].
    """
    out = []
    for rig, plan in zip(rigs, plans, strict=True):
        sensors = []
        for sensor, drawn in zip(rig.sensors, plan.sensors, strict=True):
            if drawn.metered:
                poses = [compose(pose, sensor.to_rig) for pose in rig.to_world]
                total = irradiance + _on_ground(np.stack(poses), sensor, lamps, surface)
                exposure = drawn.sensor.exposure_ev + incident_exposure(total)
                sensor = dataclasses.replace(sensor, exposure_ev=exposure)
            sensors.append(sensor)
        out.append(dataclasses.replace(rig, sensors=tuple(sensors)))
    return tuple(out)


def _on_ground(
    poses: NDArray[np.float64], sensor: Sensor, lamps: tuple[Lamp, ...], surface: GroundSurface
) -> NDArray[np.float64]:
    """Irradiance from lamps at the first lit place from the middle of a picture downwards: [s]."""
    _, fy, cx, cy, _ = sensor.intrinsics
    height = float(sensor.resolution[1])
    rays = None
    if sensor.lens is not None:
        rows = height * np.array(_ROWS)
        rays, _ = pixel_rays(sensor.lens, sensor.intrinsics, np.full(len(rows), cx), rows)
    out = np.zeros(len(poses))
    for i, pose in enumerate(poses):
        for row, part in enumerate(_ROWS):
            if rays is None:
                way = pose[:3, 2] + (height * part - cy) / fy * pose[:3, 1]
            else:
                way = (rays[row] * pose[:3, :3]).sum(axis=1)
            point = _ground_hit(pose[:3, 3], way, surface)
            if point is not None:
                out[i] = sum(lamp_irradiance(lamp, i, point) for lamp in lamps)
            if out[i] > 0.0:
                break
    return out


def _ground_hit(
    origin: NDArray[np.float64], direction: NDArray[np.float64], surface: GroundSurface
) -> NDArray[np.float64] | None:
    """Returns where a ray meets the ground, as fine as its grid; None: nowhere."""
    lengths = np.zeros(_STEPS)
    length = _NEAREST_M
    for i in range(_STEPS):
        lengths[i] = length
        length *= _GROWTH
    half = 0.5 * np.array(surface.field.grid.size_m)
    points = origin + lengths[:, None] * direction
    at = np.clip(points[:, :2], -half, half)
    above = points[:, 2] - surface.field.height_at(at[:, 0].copy(), at[:, 1].copy())
    under = np.flatnonzero((np.abs(points[:, :2]) <= half).all(axis=1) & (above <= 0.0))
    if not len(under):
        return None
    k = int(under[0])
    if k == 0 or above[k - 1] <= 0.0:
        return points[k]
    share = above[k - 1] / (above[k - 1] - above[k])
    return points[k - 1] + share * (points[k] - points[k - 1])
