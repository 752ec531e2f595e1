"""Poses between poses: seconds for 10,000 of them, and the error against the rate of the keys.

    python studies/benchmarks/tracks.py

Best of some runs after one that compiles, beside SciPy's ``Slerp`` (turns only) with ``interp`` for
positions, and ``RotationSpline`` with ``CubicSpline``, in one process; their columns say how many
times ours they take. Errors are against a motion whose turns reach 5 rad/s, at all rates of keys.
"""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation, RotationSpline, Slerp

from scenec.compiler.cameras.se3 import METHODS, interpolate

RUNS = 15
POSES = 10_000


def best(work: Callable[[], object]) -> float:
    work()
    seconds = []
    for _ in range(RUNS):
        start = time.perf_counter()
        work()
        seconds.append(time.perf_counter() - start)
    return min(seconds)


def motion(t: np.ndarray) -> tuple[np.ndarray, Rotation]:
    """A handheld camera that is swung about: up to 5 rad/s and 3 m/s."""
    euler = np.stack([1.2 * np.sin(2.1 * t), 0.9 * np.sin(3.3 * t), 1.5 * np.sin(1.4 * t)], axis=1)
    place = np.stack([np.sin(2.0 * t), np.cos(1.3 * t), 0.5 * np.sin(2.9 * t)], axis=1)
    return place, Rotation.from_euler("xyz", euler)


def quaternions(r: Rotation) -> np.ndarray:
    return np.roll(r.as_quat(), 1, axis=1)


def main() -> None:
    print(f"{POSES} poses; asked for: at most 50 ms")
    print("keys     method   ms      Slerp+interp  RotationSpline+CubicSpline (times ours)")
    at = np.linspace(0.0, 10.0, POSES)
    for keys in (2, 301, 10_001):
        t = np.linspace(0.0, 10.0, keys)
        p, r = motion(t)
        q = quaternions(r)

        def linear(t: np.ndarray = t, p: np.ndarray = p, r: Rotation = r) -> None:
            Slerp(t, r)(at)
            np.stack([np.interp(at, t, p[:, k]) for k in range(3)], axis=1)

        def cubic(t: np.ndarray = t, p: np.ndarray = p, r: Rotation = r) -> None:
            RotationSpline(t, r)(at)
            CubicSpline(t, p)(at)

        other = best(linear), best(cubic)
        for method in METHODS:
            own = best(lambda m=method, t=t, p=p, q=q: interpolate(t, p, q, at, m))  # type: ignore[misc]
            ratios = "  ".join(f"{seconds / own:12.2f}" for seconds in other)
            print(f"{keys:6d}   {method:7s}{1e3 * own:6.2f}  {ratios}")
    print()
    print("rate, Hz  method   largest error of position, mm   of turn, degrees")
    inner = at[(at > 1.0) & (at < 9.0)]
    place, turn = motion(inner)
    for rate in (3, 10, 30, 100):
        t = np.arange(10 * rate + 1) / rate
        p, r = motion(t)
        for method in METHODS:
            pp, qq = interpolate(t, p, quaternions(r), inner, method)
            off = (turn.inv() * Rotation.from_quat(np.roll(qq, -1, axis=1))).magnitude().max()
            away = 1e3 * np.linalg.norm(pp - place, axis=1).max()
            print(f"{rate:6d}    {method:7s}{away:16.4f}{np.degrees(off):28.5f}")


if __name__ == "__main__":
    main()
