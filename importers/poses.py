"""Poses of other programs as a cfg has them: matrices, quaternions, tracks."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

#: From a camera's axes in Blender and USD (y up, looking down -z) to those of a rig (y down, z
#: ahead), and back.
FLIP = np.diag((1.0, -1.0, -1.0))


def rotation_of(quaternion: Sequence[float]) -> NDArray[np.float64]:
    """Rotation matrix [3, 3] of w, x, y, z of any length but 0."""
    w, x, y, z = np.asarray(quaternion, float) / np.linalg.norm(quaternion)
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )


def quaternion_of(rotation: NDArray[np.float64]) -> NDArray[np.float64]:
    """w, x, y, z of a rotation matrix, w not below 0 (Shepperd 1978)."""
    r = rotation
    squares = np.array(
        [
            1 + r[0, 0] + r[1, 1] + r[2, 2],
            1 + r[0, 0] - r[1, 1] - r[2, 2],
            1 - r[0, 0] + r[1, 1] - r[2, 2],
            1 - r[0, 0] - r[1, 1] + r[2, 2],
        ]
    )
    rows = [
        [squares[0], r[2, 1] - r[1, 2], r[0, 2] - r[2, 0], r[1, 0] - r[0, 1]],
        [r[2, 1] - r[1, 2], squares[1], r[1, 0] + r[0, 1], r[0, 2] + r[2, 0]],
        [r[0, 2] - r[2, 0], r[1, 0] + r[0, 1], squares[2], r[2, 1] + r[1, 2]],
        [r[1, 0] - r[0, 1], r[0, 2] + r[2, 0], r[2, 1] + r[1, 2], squares[3]],
    ]
    found = np.array(rows[int(np.argmax(squares))])
    found /= np.linalg.norm(found)
    return -found if found[0] < 0 else found


def turns_of(rotation: NDArray[np.float64]) -> tuple[float, float, float]:
    """Turns about x, then y, then z, fixed axes, in degrees, that make a rotation."""
    r = rotation
    y = math.asin(-min(max(float(r[2, 0]), -1.0), 1.0))
    if abs(r[2, 0]) > 1.0 - 1e-12:
        # Gimbal lock: all of the turn about the vertical is given to z.
        return 0.0, math.degrees(y), math.degrees(math.atan2(-r[0, 1], r[1, 1]))
    x, z = math.atan2(r[2, 1], r[2, 2]), math.atan2(r[1, 0], r[0, 0])
    return math.degrees(x), math.degrees(y), math.degrees(z)


def track_writer(
    times_s: Sequence[float], poses: Sequence[NDArray[np.float64]]
) -> Callable[[Path], None]:
    """What writes a track: ``time_s,x_m,y_m,z_m,qw,qx,qy,qz``.

    Args:
        times_s: Rising.
        poses: From the rig's frame (x right, y down, z ahead) to the world, [4, 4] each.
    """
    lines = ["time_s,x_m,y_m,z_m,qw,qx,qy,qz"]
    for time, pose in zip(times_s, poses, strict=True):
        numbers = [time, *pose[:3, 3], *quaternion_of(pose[:3, :3])]
        lines.append(",".join(f"{float(number):.12g}" for number in numbers))
    text = "\n".join(lines) + "\n"

    def write(path: Path) -> None:
        path.write_text(text, encoding="ascii")

    return write
