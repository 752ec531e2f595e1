"""What looks at the ground from where, with its lens: for rays that it sees along, and pixels."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from scenec.compiler.geometry.lenses import FUNCTIONS, pixel_rays
from scenec.compiler.geometry.poses import compose
from scenec.compiler.scene.rig import Lidar, Rig, Sensor
from scenec.compiler.views.frustum import lidar_directions, sensor_poses
from scenec.quality.ladder.points import Bools, Floats, Integers
from scenec.schemas.lens import project


@dataclass(frozen=True, eq=False)
class Eye:
    """A camera or a lidar at one pose.

    Attributes:
        pose: To the world, OpenCV axes, float64 [3, 4].
        sensor: It.
    """

    pose: Floats
    sensor: Sensor | Lidar

    def rays(self, u: Floats, v: Floats) -> Floats:
        """Unit vectors that it looks along, world, float64 [m, 3]; none beyond an image circle.

        Args:
            u, v: Places, parts of a picture's width and height, or of a scan's turn and beams, [n].
        """
        local, known = self.looking(u, v)
        return self.turned(local[known])

    def looking(self, u: Floats, v: Floats) -> tuple[Floats, Bools]:
        """Rays of all places, own axes, float64 [n, 3], and whether there is such a ray, [n]."""
        if isinstance(self.sensor, Lidar):
            beams, rays = self.sensor.elevations_deg, self.sensor.rays
            if rays is None:
                low, high = self.sensor.azimuth_deg
                angles = np.stack([beams[_entry(v, len(beams))], low + u * (high - low)], axis=1)
            else:
                angles = rays[_entry(v, len(rays)), _entry(u, rays.shape[1])]
            return lidar_directions(angles), np.ones(len(u), np.bool_)
        width, height = self.sensor.resolution
        return pixel_rays(self.sensor.lens, self.sensor.intrinsics, u * width, v * height)

    def turned(self, local: Floats) -> Floats:
        """Vectors of its own axes as unit vectors of the world, float64 [n, 3]."""
        world = (local[:, None, :] * self.pose[None, :, :3]).sum(axis=2)
        unit: Floats = world / np.sqrt((world * world).sum(axis=1))[:, None]
        return unit

    def rows(self, points: Floats) -> Floats:
        """Rows of a camera's picture at which points lie, float64 [n]; NaN out of the picture.

        Args:
            points: World, float64 [n, 3].
        """
        assert isinstance(self.sensor, Sensor)
        away = points - self.pose[:, 3]
        local = (away[:, :, None] * self.pose[None, :, :3]).sum(axis=1)
        plane, shown = project(self.sensor.lens, local, FUNCTIONS)
        fx, fy, cx, cy, skew = self.sensor.intrinsics
        width, height = self.sensor.resolution
        u, v = fx * plane[:, 0] + skew * plane[:, 1] + cx, fy * plane[:, 1] + cy
        shown &= (u >= 0.0) & (u <= width) & (v >= 0.0) & (v <= height)
        return np.where(shown, v, np.nan)


def _entry(part: Floats, count: int) -> Integers:
    """Of so many entries, those at parts of the way through, [n]."""
    return np.minimum((part * count).astype(np.int64), count - 1)


def eyes_of(rigs: tuple[Rig, ...]) -> tuple[Eye, ...]:
    """All cameras and lidars at all samples, and cameras while their shutters are open."""
    found = []
    for rig in rigs:
        for sensor in rig.sensors:
            found += [Eye(pose[:3], sensor) for pose in sensor_poses(rig, sensor)]
        for lidar in rig.lidars:
            found += [Eye(compose(pose, lidar.to_rig)[:3], lidar) for pose in rig.to_world]
    return tuple(found)
