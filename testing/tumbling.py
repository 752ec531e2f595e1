"""A body that tumbles in closed form, and rotations as scenec writes them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation


def quaternions(rotation: Rotation) -> NDArray:
    """Quaternions w, x, y, z [n, 4] of rotations."""
    return np.roll(rotation.as_quat(), 1, axis=-1)


def rotations(quaternion: NDArray) -> Rotation:
    """Rotations of quaternions w, x, y, z [n, 4]."""
    return Rotation.from_quat(np.roll(quaternion, -1, axis=-1))


def keys(
    n: int, largest: float = 2.9, seed: int = 0
) -> tuple[NDArray[np.float64], NDArray[np.float64], Rotation]:
    """Times [n], positions [n, 3] and rotations, neighbors less than an angle in radians apart."""
    rng = np.random.default_rng(seed)
    time = np.cumsum(rng.uniform(0.05, 1.0, n))
    axis = rng.normal(size=(n, 3))
    axis /= np.linalg.norm(axis, axis=1)[:, None]
    turns = Rotation.from_rotvec(axis * rng.uniform(0, largest, (n, 1)))
    found = [turns[0]]
    for k in range(1, n):
        found.append(found[-1] * turns[k])
    return time, rng.normal(size=(n, 3)), Rotation.concatenate(found)


def top(
    t: NDArray, spin: float = 2.0, nod: float = 0.6, roll: float = -1.3
) -> tuple[Rotation, NDArray, NDArray]:
    """A symmetric top without torque: attitudes at times [n], angular velocities and their change.

    Both are in the body's axes, [n, 3], rad/s and rad/s²; Euler's angles Z (spin t), X (nod),
    Z (roll t).
    """
    attitude = Rotation.from_euler("ZXZ", np.stack([spin * t, nod + 0 * t, roll * t], axis=1))
    s, c = spin * np.sin(nod), spin * np.cos(nod)
    sin, cos = np.sin(roll * t), np.cos(roll * t)
    rate = np.stack([s * sin, s * cos, c + roll + 0 * t], axis=1)
    return attitude, rate, np.stack([s * roll * cos, -s * roll * sin, 0 * t], axis=1)
