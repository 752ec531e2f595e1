"""Computes rigid poses: OpenCV camera axes (x right, y down, z forward) in the Z-up world."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.arithmetic import elementary
from scenec.schemas.quaternions import rotation_entries


def look_at(
    position: NDArray[np.float64], target: NDArray[np.float64], roll_deg: float
) -> NDArray[np.float64]:
    """Camera-to-world matrix of a camera that looks at a point, float64 [4, 4].

    Args:
        position, target: World, meters, [3]. A target straight above or below leaves north (+y) as
            the direction of the picture's top (below) or bottom (above).
        roll_deg: Turn about the viewing axis, clockwise as the camera sees itself.
    """
    forward = target - position
    length = np.sqrt((forward * forward).sum())
    forward = forward / length if length > 0.0 else np.array([0.0, 1.0, 0.0])
    level = np.sqrt(forward[0] * forward[0] + forward[1] * forward[1])
    if level > 1e-9:
        right = np.array([forward[1] / level, -forward[0] / level, 0.0])
    else:
        right = np.array([1.0, 0.0, 0.0])
    down = cross(forward, right)
    roll = roll_deg * elementary.PI / 180.0
    c, s = elementary.cos(roll), elementary.sin(roll)
    matrix = np.eye(4)
    matrix[:3, 0] = c * right + s * down
    matrix[:3, 1] = c * down - s * right
    matrix[:3, 2] = forward
    matrix[:3, 3] = position
    return matrix


def from_quaternion(
    position: NDArray[np.float64], quaternion: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Matrix of a pose given as position [3] and quaternion (w, x, y, z) of any length, [4, 4]."""
    w, x, y, z = quaternion
    matrix = np.eye(4)
    entries = rotation_entries(x, y, z, w, 2.0 / (w * w + x * x + y * y + z * z))
    matrix[:3, :3] = np.reshape(entries, (3, 3))
    matrix[:3, 3] = position
    return matrix


def from_euler(position: tuple[float, ...], degrees: tuple[float, ...]) -> NDArray[np.float64]:
    """Matrix that turns about x, y, z in turn (fixed axes), then moves to ``position``, [4, 4]."""
    matrix = np.eye(4)
    for axis, angle in enumerate(degrees):
        c = elementary.cos(angle * elementary.PI / 180.0)
        s = elementary.sin(angle * elementary.PI / 180.0)
        i, j = (axis + 1) % 3, (axis + 2) % 3
        turned = matrix.copy()
        turned[i] = c * matrix[i] - s * matrix[j]
        turned[j] = s * matrix[i] + c * matrix[j]
        matrix = turned
    matrix[:3, 3] = position
    return matrix


def bearing_vector(degrees: float) -> NDArray[np.float64]:
    """Level unit vector of a compass bearing: clockwise from north (+y), float64 [3]."""
    angle = degrees * elementary.PI / 180.0
    return np.array([elementary.sin(angle), elementary.cos(angle), 0.0])


def compose(parent: NDArray[np.float64], child: NDArray[np.float64]) -> NDArray[np.float64]:
    """The product parent * child of two affine 4 x 4 matrices, without BLAS."""
    return composed(parent[None], child)[0]


def composed(parents: NDArray[np.float64], child: NDArray[np.float64]) -> NDArray[np.float64]:
    """Products of matrices [n, 4, 4] and one [4, 4]."""
    out = np.zeros(parents.shape)
    for k in range(4):
        out += parents[:, :, k, None] * child[None, None, k, :]
    return out


def facing(z: NDArray[np.float64]) -> NDArray[np.float64]:
    """A right-handed frame whose third axis is a unit vector; columns are its axes, float64 [3, 3].

    The first is level wherever the third is 26 degrees or more from the vertical.
    """
    helper = np.array([0.0, 0.0, 1.0]) if abs(z[2]) < 0.9 else np.array([0.0, 1.0, 0.0])
    x = cross(helper, z)
    x = x / np.sqrt((x * x).sum())
    return np.stack([x, cross(z, x), z], axis=1)


def cross(a: NDArray[np.float64], b: NDArray[np.float64]) -> NDArray[np.float64]:
    """Returns the cross product of vectors [3, ...]; NumPy's own is not on our list."""
    return np.array(
        [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
    )
