"""Makes messages of ROS 2 out of what frames, scans and rigs hold."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenec.datasets.formats.poses import LINK_POSE, distortion, opencv_intrinsics, product
from scenec.datasets.formats.rectify import Rectified
from scenec.datasets.source import LoadedFrame
from scenec.schemas.georeference import Georeference
from scenec.schemas.imu import Imu, RigState
from scenec.schemas.lens import BROWN_CONRADY, KANNALA_BRANDT
from scenec.schemas.quaternions import quaternion
from scenec.schemas.scans import Scan

#: What sensor_msgs/CameraInfo calls lenses of ours, and how many of their coefficients it takes.
_LENSES = {
    BROWN_CONRADY: [("plumb_bob", 5), ("rational_polynomial", 8)],
    KANNALA_BRANDT: [("equidistant", 4)],
}
NANO = 1_000_000_000
#: STATUS_FIX, SERVICE_GPS and COVARIANCE_TYPE_DIAGONAL_KNOWN of sensor_msgs.
_FIX, _GPS, _DIAGONAL_KNOWN = 0, 1, 2


class Messages:
    """Makes messages of the types that a store of rosbags has."""

    def __init__(self, types: Any) -> None:
        self._types = types

    def _make(self, kind: str, *values: Any, **named: Any) -> Any:
        package, _, name = kind.partition("/")
        return self._types[f"{package}/msg/{name}"](*values, **named)

    def header(self, frame_id: str, stamp: int) -> Any:
        """std_msgs/Header."""
        time = self._make("builtin_interfaces/Time", stamp // NANO, stamp % NANO)
        return self._make("std_msgs/Header", time, frame_id)

    def image(self, pixels: NDArray[Any], encoding: str, frame_id: str, stamp: int) -> Any:
        """sensor_msgs/Image of pixels [h, w] or [h, w, 3]."""
        rows = np.ascontiguousarray(pixels)
        return self._make(
            "sensor_msgs/Image",
            header=self.header(frame_id, stamp),
            height=rows.shape[0],
            width=rows.shape[1],
            encoding=encoding,
            is_bigendian=0,
            step=rows.strides[0],
            data=rows.view(np.uint8).reshape(-1),
        )

    def camera_info(
        self,
        frame: LoadedFrame,
        baseline_m: float,
        pair: Rectified | None,
        frame_id: str,
        stamp: int,
    ) -> Any:
        """sensor_msgs/CameraInfo.

        Args:
            frame: Of the camera.
            baseline_m: How far it is to the right of its rectified pair's left camera; else 0.
            pair: How it becomes one of a rectified pair, or None.
            frame_id: Of the camera's axes.
            stamp: Nanoseconds.
        """
        k = opencv_intrinsics(frame)
        lens = distortion(frame, _LENSES)
        model, coefficients = ("plumb_bob", [0.0] * 5) if lens is None else lens
        r, p = np.eye(3), np.zeros((3, 4))
        p[:, :3], p[0, 3] = k, -k[0, 0] * baseline_m
        if pair is not None:
            r, p = pair
        return self._make(
            "sensor_msgs/CameraInfo",
            header=self.header(frame_id, stamp),
            height=frame.height,
            width=frame.width,
            distortion_model=model,
            d=np.array(coefficients, np.float64),
            k=k.reshape(-1),
            r=r.reshape(-1),
            p=p.reshape(-1) + 0.0,
            binning_x=0,
            binning_y=0,
            roi=self._make("sensor_msgs/RegionOfInterest", 0, 0, 0, 0, False),
        )

    def disparity(self, frame: LoadedFrame, baseline_m: float, frame_id: str, stamp: int) -> Any:
        """stereo_msgs/DisparityImage; -1 where there is none."""
        values = frame.passes["disparity"].astype("<f4")
        known = np.isfinite(values)
        values = np.where(known, np.maximum(values, np.float32(0.0)), np.float32(-1.0))
        return self._make(
            "stereo_msgs/DisparityImage",
            header=self.header(frame_id, stamp),
            image=self.image(values, "32FC1", frame_id, stamp),
            f=float(frame.intrinsics[0, 0]),
            t=baseline_m,
            valid_window=self._make(
                "sensor_msgs/RegionOfInterest", 0, 0, frame.height, frame.width, False
            ),
            min_disparity=0.0,
            max_disparity=max(float(values.max()), 0.0),
            delta_d=0.0,
        )

    def pose(self, pose: NDArray[np.float64], stamp: int) -> Any:
        """geometry_msgs/PoseStamped in the world."""
        return self._make(
            "geometry_msgs/PoseStamped", self.header("world", stamp), self._pose(pose)
        )

    def _pose(self, pose: NDArray[np.float64]) -> Any:
        place, turn = self._place(pose)
        return self._make("geometry_msgs/Pose", self._make("geometry_msgs/Point", *place), turn)

    def _place(self, pose: NDArray[np.float64]) -> tuple[list[float], Any]:
        turn = self._make("geometry_msgs/Quaternion", *quaternion(pose[:3, :3]).tolist())
        return pose[:3, 3].tolist(), turn

    def _vector(self, values: NDArray[np.float64]) -> Any:
        return self._make("geometry_msgs/Vector3", *values.tolist())

    def tf(self, links: Sequence[tuple[str, str, NDArray[np.float64]]], stamp: int) -> Any:
        """tf2_msgs/TFMessage of parents, children and poses [4, 4]."""
        found = []
        for parent, child, pose in links:
            place, turn = self._place(pose)
            vector = self._make("geometry_msgs/Vector3", *place)
            found.append(
                self._make(
                    "geometry_msgs/TransformStamped",
                    self.header(parent, stamp),
                    child,
                    self._make("geometry_msgs/Transform", vector, turn),
                )
            )
        return self._make("tf2_msgs/TFMessage", found)

    def odometry(self, motion: RigMotionAt, frame_id: str, stamp: int) -> Any:
        """nav_msgs/Odometry; it is exact, and its covariances 0."""
        none = np.zeros(36)
        twist = self._make(
            "geometry_msgs/Twist", self._vector(motion.velocity), self._vector(motion.spin)
        )
        return self._make(
            "nav_msgs/Odometry",
            self.header("world", stamp),
            frame_id,
            self._make("geometry_msgs/PoseWithCovariance", self._pose(motion.pose), none),
            self._make("geometry_msgs/TwistWithCovariance", twist, none),
        )

    def fix(
        self,
        place: Georeference,
        at: NDArray[np.float64],
        altitude_m: float,
        frame_id: str,
        stamp: int,
    ) -> Any:
        """Makes a sensor_msgs/NavSatFix of a place of the scene on Earth: exact, of covariance 0.

        Args:
            place: Where the scene lies.
            at: The place's x, y and z [3], in meters.
            altitude_m: Above the DEM's datum, whatever that is.
            frame_id: Of the antenna, which is the rig's origin.
            stamp: In nanoseconds.
        """
        latitude, longitude = place.latitude_longitude(at[0], at[1])
        return self._make(
            "sensor_msgs/NavSatFix",
            self.header(frame_id, stamp),
            self._make("sensor_msgs/NavSatStatus", _FIX, _GPS),
            float(latitude),
            float(longitude),
            altitude_m,
            np.zeros(9),
            _DIAGONAL_KNOWN,
        )

    def path(self, poses: Sequence[NDArray[np.float64]], stamps: Sequence[int]) -> Any:
        """nav_msgs/Path."""
        stamped = [self.pose(pose, at) for pose, at in zip(poses, stamps, strict=True)]
        return self._make("nav_msgs/Path", self.header("world", stamps[0]), stamped)

    def imu(self, imu: Imu, k: int, frame_id: str, stamp: int) -> Any:
        """sensor_msgs/Imu of a reading; it knows no orientation.

        That is a covariance of -1 by the message's definition, and a quaternion of zeros by what
        RealSense's driver writes and rtabmap looks at: any other is the rig's attitude to it.
        """
        unknown = np.zeros(9)
        unknown[0] = -1.0
        rate = imu.rate_hz
        spin = imu.noise.gyroscope_noise_density * imu.noise.gyroscope_noise_density * rate
        felt = imu.noise.accelerometer_noise_density * imu.noise.accelerometer_noise_density * rate
        return self._make(
            "sensor_msgs/Imu",
            self.header(frame_id, stamp),
            self._make("geometry_msgs/Quaternion", 0.0, 0.0, 0.0, 0.0),
            unknown,
            self._vector(imu.gyroscope[k]),
            np.diag([spin] * 3).reshape(-1),
            self._vector(imu.accelerometer[k]),
            np.diag([felt] * 3).reshape(-1),
        )

    def cloud(self, scan: Scan, frame_id: str, stamp: int) -> Any:
        """sensor_msgs/PointCloud2 of a scan's answers, with the beam of each as ring.

        Intensity is there where the scan has one, the number of the return (from 1) where a beam
        may have several; time is after the stamp, seconds: 0, since a scan is taken at one instant.
        """
        arrays = scan.arrays
        there = np.isfinite(arrays["range"])
        points = arrays["points"][there]
        columns = {axis: points[:, i] for i, axis in enumerate("xyz")}
        if "intensity" in arrays:
            columns["intensity"] = arrays["intensity"][there]
        types = {**dict.fromkeys(columns, "<f4"), "ring": "<u2", "time": "<f4"}
        columns["ring"] = np.nonzero(there)[0]
        if there.ndim == 3:
            types["return"] = "<u2"
            columns["return"] = there.cumsum(axis=2)[there]
        table = np.zeros(len(points), [*types.items()])
        for name, values in columns.items():
            table[name] = values
        kinds = {"<f4": 7, "<u2": 4}
        assert table.dtype.fields is not None
        fields = [
            self._make("sensor_msgs/PointField", name, table.dtype.fields[name][1], kinds[kind], 1)
            for name, kind in types.items()
        ]
        return self._make(
            "sensor_msgs/PointCloud2",
            header=self.header(frame_id, stamp),
            height=1,
            width=len(table),
            fields=fields,
            is_bigendian=False,
            point_step=table.itemsize,
            row_step=table.nbytes,
            data=np.frombuffer(table.tobytes(), np.uint8),
            is_dense=True,
        )


class RigMotionAt:
    """Holds a rig's pose and velocities at a sample: x forward, y left, z up.

    Velocities are central differences over the samples, one-sided at the ends.

    Attributes:
        pose: In the world, [4, 4].
        velocity, spin: In the rig's own axes, m/s and rad/s, [3]; 0 where times do not rise.
    """

    def __init__(self, rig: RigState, sample: int) -> None:
        poses, times = rig.to_world, rig.time_s
        first, last = max(sample - 1, 0), min(sample + 1, len(poses) - 1)
        self.pose = product(poses[sample], LINK_POSE)
        self.velocity, self.spin = np.zeros(3), np.zeros(3)
        seconds = float(times[last] - times[first])
        if seconds > 0.0:
            way = (poses[last, :3, 3] - poses[first, :3, 3]) / seconds
            self.velocity = product(self.pose[:3, :3].T, way[:, None])[:, 0]
            axes = [product(poses[k, :3, :3], LINK_POSE[:3, :3]) for k in (first, last)]
            x, y, z, w = quaternion(product(axes[0].T, axes[1])).tolist()
            half = math.sqrt(x * x + y * y + z * z)
            scale = 2.0 * math.atan2(half, w) / half if half > 0.0 else 0.0
            self.spin = np.array([x, y, z]) * (scale / seconds)
