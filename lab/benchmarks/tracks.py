"""Poses between poses: milliseconds for 10,000 of them.

    python lab/benchmarks/tracks.py [--fast]

Best of some runs after one that compiles, beside SciPy's ``Slerp`` (turns only) with ``interp`` for
positions, and ``RotationSpline`` with ``CubicSpline``, in one process; their columns say how many
times ours they take. Errors over the rate of keys stand in ``docs/motion.md``.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation, RotationSpline, Slerp

from scenec.compiler.geometry.se3 import METHODS, interpolate
from scenec.lab.runner import Cell, Study, run, times

POSES = 10_000


def motion(t: NDArray[np.float64]) -> tuple[NDArray[np.float64], Rotation]:
    """A handheld camera that is swung about: up to 5 rad/s and 3 m/s."""
    euler = np.stack([1.2 * np.sin(2.1 * t), 0.9 * np.sin(3.3 * t), 1.5 * np.sin(1.4 * t)], axis=1)
    place = np.stack([np.sin(2.0 * t), np.cos(1.3 * t), 0.5 * np.sin(2.9 * t)], axis=1)
    return place, Rotation.from_euler("xyz", euler)


def quaternions(r: Rotation) -> NDArray[np.float64]:
    """Real part first."""
    return np.roll(r.as_quat(), 1, axis=1)


def rows(study: Study) -> Iterator[list[Cell]]:
    """A row for each number of keys and each method."""
    at, runs = np.linspace(0.0, 10.0, POSES), 3 if study.fast else 15
    for keys in (2, 301, 10_001):
        t = np.linspace(0.0, 10.0, keys)
        p, r = motion(t)
        q = quaternions(r)

        def linear(t: NDArray = t, p: NDArray = p, r: Rotation = r) -> None:
            Slerp(t, r)(at)
            np.stack([np.interp(at, t, p[:, k]) for k in range(3)], axis=1)

        def cubic(t: NDArray = t, p: NDArray = p, r: Rotation = r) -> None:
            RotationSpline(t, r)(at)
            CubicSpline(t, p)(at)

        theirs = [min(times(work, runs).wall) for work in (linear, cubic)]
        for method in METHODS:
            own = min(times(lambda m=method, t=t, p=p, q=q: interpolate(t, p, q, at, m), runs).wall)
            yield [keys, method, 1e3 * own, *(seconds / own for seconds in theirs)]


def main(study: Study) -> None:
    """Prints the table."""
    study.say(f"{POSES} poses; asked: at most 50 ms.\n")
    header = ["keys", "method", "ms", "Slerp and interp, times ours", "splines, times ours"]
    study.table(header, rows(study))


if __name__ == "__main__":
    run(main)
