"""Makes what docs/motion.md shows: motions over a terrain, tracks between their keys.

    python lab/pages/motion.py [--fast] [-o FOLDER]

Seconds are single readings on the machine that runs it; errors are facts of the code.
"""

from __future__ import annotations

from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation, RotationSpline, Slerp

from scenec.compiler.build import BuildLog, build_to
from scenec.compiler.cameras.rigs import place_rigs
from scenec.compiler.cfg.load import load
from scenec.compiler.draw import draw
from scenec.compiler.geometry.pose_spline import spline_poses
from scenec.compiler.geometry.se3 import METHODS, interpolate
from scenec.compiler.mesh.build import build_surface
from scenec.lab.runner import Cell, Page, run, times
from scenec.testing.small import small_cfg

MOTIONS: dict[str, dict[str, Any]] = {
    "orbit": {"radius_m": 5, "height_m": 2},
    "lawn_mower": {
        "along_m": 7, "across_m": 8, "spacing_m": 2, "height_m": 3, "turn_radius_m": 1.4,
        "bearing_deg": 20,
    },
    "rover": {"goals": 5, "max_slope_deg": 20},
    "mav": {"height_m": 1.5, "waypoints_m": [[-8, -5], [0, 5], [6, -4], [8, 5]], "follow_m": 3},
    "descent": {"entry_height_m": 20, "x_m": 2, "y_m": 1, "drift_m_s": 2, "drift_deg": 60},
}  # fmt: skip


def made(page: Page) -> None:
    """All motions that are made, over one terrain."""
    samples = 200 if page.fast else 2000
    cfg = small_cfg(samples=samples)
    cfg["outputs"] = ["label", "depth"]
    sensors = cfg["rigs"].pop("rover")["sensors"]
    for kind, keys in MOTIONS.items():
        cfg["rigs"][kind] = {"pose": {"type": kind, **keys}, "sensors": sensors}
    plan = draw(load(page.cfg(cfg)), 7, 0)
    log = BuildLog()
    surface = build_to(build_surface, plan)["surface"]
    seconds = page.timed(lambda: build_to(place_rigs, plan, surface=surface), 1)
    page.value("seconds", f"{seconds:.2f} s")
    rigs = build_to(place_rigs, plan, log=log, surface=surface)["rigs"]
    figure, axes = plt.subplots(3, len(rigs), figsize=(16, 8), constrained_layout=True)
    half = 0.5 * np.array(plan.terrain.size_m)
    rows = []
    for column, rig in zip(axes.T, rigs, strict=True):
        at = rig.to_world[:, :3, 3]
        assert rig.times is not None
        h = rig.times[1] - rig.times[0]
        velocity, bend = np.diff(at, axis=0) / h, np.diff(at, n=2, axis=0) / h**2
        ground = surface.height_at(at[:, 0].copy(), at[:, 1].copy())
        column[0].imshow(
            surface.field.height, origin="lower", extent=(-half[0], half[0], -half[1], half[1]),
            cmap="gray",
        )  # fmt: skip
        column[0].plot(at[:, 0], at[:, 1], "r")
        column[0].plot(*at[0, :2], "ro")
        column[0].set_title(rig.name)
        column[1].plot(rig.times, at[:, 2], "r", rig.times, ground, "k")
        column[1].set_ylabel("height, m (black: the ground)")
        speed = _length(velocity)
        column[2].plot(rig.times[1:], speed, "b")
        column[2].set_ylim(0.0, 1.1 * float(speed.max()))
        column[2].set_xlabel("s")
        column[2].set_ylabel("speed, m/s")
        rows.append(
            [rig.name, f"{rig.times[-1]:.1f}", f"{speed.max():.2f}", f"{_length(bend).max():.2f}",
             f"{(at[:, 2] - ground).min():.2f}", f"{(at[:, 2] - ground).max():.2f}"]
        )  # fmt: skip
    page.save(figure, "made", 60)
    page.rows(rows)


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
    """Errors between keys."""
    at = np.linspace(1.0, 9.0, 2000)
    place, turn = motion(at)
    rates = [3, 10, 30, 100]
    rows, found = [], {}
    for method in (*METHODS, "spline"):
        for rate in rates:
            t = np.arange(10 * rate + 1) / rate
            p, r = motion(t)
            pp, qq = between(t, p, quaternions(r), at, method)
            off = (turn.inv() * Rotation.from_quat(np.roll(qq, -1, axis=1))).magnitude().max()
            found[method, rate] = 1e3 * _length(pp - place).max(), np.degrees(off)
            away, angle = found[method, rate]
            rows.append([method, str(rate), f"{away:.4f}", f"{angle:.5f}"])
    figure, axes = plt.subplots(1, 2, figsize=(10, 3.5), constrained_layout=True)
    for k, (axis, what) in enumerate(zip(axes, ("position, mm", "turn, degrees"), strict=True)):
        for method in (*METHODS, "spline"):
            axis.loglog(rates, [found[method, rate][k] for rate in rates], "o-", label=method)
        axis.set_xlabel("keys a second")
        axis.set_title(f"largest error of {what}")
        axis.legend()
    page.save(figure, "error", 60)
    page.rows(rows)


def cost(page: Page) -> None:
    """Times 10,000 poses between keys, beside SciPy."""
    at, runs = np.linspace(0.0, 10.0, 10_000), 3 if page.fast else 15
    rows: list[list[Cell]] = []
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
        for method in (*METHODS, "spline"):
            own = min(times(lambda m=method, t=t, p=p, q=q: between(t, p, q, at, m), runs).wall)
            rows.append([str(keys), method, 1e3 * own, *(one / own for one in theirs)])
    page.rows(rows)


def main(page: Page) -> None:
    """Refreshes the page."""
    page.refresh(("scenec", "numpy"), (made, tracks, cost))


def _length(rows: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.linalg.norm(rows, axis=1)


if __name__ == "__main__":
    run(main, page="motion")
