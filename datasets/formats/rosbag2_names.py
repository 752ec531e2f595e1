"""Names topics and frames of ROS 2 bags: ours, and those that SLAM packages look for."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from typing import Final

from scenec.schemas.errors import OutputError

#: Topics of one rig as a package has them where nobody remaps any: of the left and the right camera
#: of its first pair, or of its first camera where it has none, of its first IMU and lidar. {} is
#: our name within a camera's topics; an entry of a single one, "left image_raw", goes first.
#: Read off rtabmap.launch.py (introlab/rtabmap_ros), stereo_image_proc.launch.py (ros-perception/
#: image_pipeline), Examples_old/ROS (UZ-SLAMLab/ORB_SLAM3), src (zang09/ORB_SLAM3_ROS2) and
#: config/euroc (HKUST-Aerial-Robotics/VINS-Fusion).
LAYOUTS: Final[Mapping[str, Mapping[str, str]]] = {
    "scenec": {},
    "rtabmap": {
        "left": "/stereo_camera/left/{}",
        "left image_raw": "/stereo_camera/left/image_rect_color",
        "right": "/stereo_camera/right/{}",
        "right image_raw": "/stereo_camera/right/image_rect",
        "single": "/camera/rgb/{}",
        "single image_raw": "/camera/rgb/image_rect_color",
        "single depth/image_raw": "/camera/depth_registered/image_raw",
        "imu": "/imu/data",
        "lidar": "/scan_cloud",
    },
    "stereo_image_proc": {"left": "/left/{}", "right": "/right/{}"},
    "orb_slam3": {
        "left": "/camera/left/{}",
        "right": "/camera/right/{}",
        "single": "/camera/{}",
        "imu": "/imu",
    },
    "orb_slam3_ros2": {
        "left": "/camera/left/{}",
        "left image_raw": "/camera/left",
        "right": "/camera/right/{}",
        "right image_raw": "/camera/right",
        "single": "/camera/{}",
        "single image_raw": "/camera",
        "imu": "/imu",
    },
    "vins": {"left": "/cam0/{}", "right": "/cam1/{}", "single": "/cam0/{}", "imu": "/imu0"},
}
#: Packages that look for a pair's right pictures in the frame of the left camera, which P is of:
#: image_geometry (StereoCameraModel.fromCameraInfo) stops the program elsewhere.
IN_LEFT_FRAME: Final = frozenset({"stereo_image_proc"})
#: Frames of that rig then: the body, which the package itself places, and where it truly is.
BODY: Final = "base_link"
TRUTH: Final = "ground_truth"


def ros_names(names: Sequence[str], what: str) -> dict[str, str]:
    """Names as a ROS topic may have them: letters, digits, single underscores, no digit first.

    Raises:
        OutputError: Two become one.
    """
    topics: dict[str, str] = {}
    for name in names:
        text = re.sub(r"_+", "_", re.sub(r"[^A-Za-z0-9_]", "_", name)).strip("_") or what[0]
        text = f"{what[0]}{text}" if text[0].isdigit() else text
        for other, taken in topics.items():
            if taken == text:
                raise OutputError(
                    f"format rosbag2: {what} {name!r} and {other!r} would both be {text!r} as a "
                    "ROS topic; export them apart with --cameras"
                )
        topics[name] = text
    return topics


def rig_frames(rigs: Sequence[str], frames: Iterable[str]) -> dict[str, str]:
    """Names the frames of rigs, none as the world or as one that there is already.

    Args:
        rigs: Names in the stage.
        frames: Those that there are.
    """
    taken = {"world", BODY, TRUTH, *frames}
    named = ros_names(rigs, "rig")
    return {rig: f"{name}_rig" if name in taken else name for rig, name in named.items()}


class Topics:
    """Names topics by the layout that was asked for.

    Args:
        layout: One of ``LAYOUTS``.
        roles: What of a bag has a place in it: name of a camera, an IMU or a lidar -> its role.
    """

    def __init__(self, layout: str, roles: Mapping[str, str]) -> None:
        self._layout, self._roles = LAYOUTS[layout], roles

    def of(self, name: str, below: str = "") -> str:
        """Returns the topic of a sensor, or one below it: "/rover_left/image_raw"."""
        role = self._roles.get(name, "")
        found = self._layout.get(f"{role} {below}") or self._layout.get(role)
        if found is None:
            return f"/{name}/{below}" if below else f"/{name}"
        return found.format(below)
