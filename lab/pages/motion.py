"""Measures for docs/objects.md how far tracks are off between their keys.

python lab/pages/motion.py [--fast] [-o FOLDER]
"""

from __future__ import annotations

from functools import partial

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from scenec.compiler.geometry.pose_spline import spline_poses
from scenec.compiler.geometry.se3 import METHODS, interpolate
from scenec.lab.runner import Cell, Page, run, times

HEADER = (
    "`interpolation`",
    "10 Hz: position, mm",
    "turn, °",
    "100 Hz: position, mm",
    "turn, °",
    "ms",
)


def motion(t: NDArray[np.float64]) -> tuple[NDArray[np.float64], Rotation]:
    """A handheld camera that is swung about: up to 5 rad/s and 3 m/s."""
    euler = np.stack([1.2 * np.sin(2.1 * t), 0.9 * np.sin(3.3 * t), 1.5 * np.sin(1.4 * t)], axis=1)
    place = np.stack([np.sin(2.0 * t), np.cos(1.3 * t), 0.5 * np.sin(2.9 * t)], axis=1)
    return place, Rotation.from_euler("xyz", euler)


def quaternions(r: Rotation) -> NDArray[np.float64]:
    """Real part first."""
    return np.roll(r.as_quat(), 1, axis=1)


def between(
    t: NDArray[np.float64],
    p: NDArray[np.float64],
    q: NDArray[np.float64],
    at: NDArray[np.float64],
    method: str,
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Positions and quaternions by any of the methods."""
    if method != "spline":
        return interpolate(t, p, q, at, method)
    found = spline_poses(t, p, q, at)
    assert found is not None
    return found.position, found.quaternion


def tracks(page: Page) -> None:
    """Errors between keys, and milliseconds for 10,000 poses."""
    at, many = np.linspace(1.0, 9.0, 2000), np.linspace(0.0, 10.0, 10_000)
    place, turn = motion(at)
    rows: list[list[Cell]] = []
    for method in (*METHODS, "spline"):
        row: list[Cell] = [method]
        for rate in (10, 100):
            t = np.arange(10 * rate + 1) / rate
            p, r = motion(t)
            pp, qq = between(t, p, quaternions(r), at, method)
            off = (turn.inv() * Rotation.from_quat(np.roll(qq, -1, axis=1))).magnitude().max()
            row += [f"{1e3 * _length(pp - place).max():.2g}", f"{np.degrees(off):.2g}"]
        t = np.linspace(0.0, 10.0, 301)
        p, r = motion(t)
        work = partial(between, t, p, quaternions(r), many, method)
        rows.append([*row, 1e3 * min(times(work, 3 if page.fast else 15).wall)])
    page.block("tracks", HEADER, rows)


def _length(rows: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.linalg.norm(rows, axis=1)


if __name__ == "__main__":
    run(lambda page: page.refresh(("scipy",), (tracks,)), page="objects")
