"""Samples poses of cameras while their shutter is open.

A rig that moves over time is asked for its poses at these times, too. Between them, positions go
straight and turns are slerps (``schemas.shutter.between``), which is what readers of the stage
take; there are as many as that errs by less than ``ERROR_PX``, measured at twice as many times or
more, for what is no nearer than the ground below the camera. The number is the same for all samples
of a sensor, and bounded; what error is left stands in report.json.

Before a motion begins and after it ends the rig stands still, as tracks do beyond their ends. A gap
of a track is one for these times as for samples.
"""

from __future__ import annotations

import dataclasses
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.cameras.paths.motion import MotionContext, RigMotion, RigPoses, Way
from scenec.compiler.cameras.sensor import SensorPlan
from scenec.compiler.cameras.tracks import poses_at
from scenec.compiler.geometry.lenses import FUNCTIONS, sight_of
from scenec.compiler.geometry.poses import composed
from scenec.compiler.scene.rig import Between, OpenShutter, Rig, Sensor
from scenec.schemas.codec import Facts, read_facts
from scenec.schemas.report import MotionFacts
from scenec.schemas.shutter import Shutter, between

#: What interpolation may err by, pixels.
ERROR_PX: Final = 1e-3
#: Steps from the first pose to the last: the fewest, the most; and those it is measured at.
_FEWEST, _MOST = 2, 64
_MEASURED: Final = ((8, 16), (_MOST, 2 * _MOST))
#: Nothing counts as nearer than this, meters.
_NEAREST_M: Final = 0.05
#: Poses of all samples that are looked at in the second round at most.
_MOST_IN_ALL: Final = 1_000_000
#: Samples whose errors are measured at once.
_AT_ONCE: Final = 4096
#: Codes that differ by less are one.
_SAME_CODE: Final = 1e-9


def open_shutters(
    rig: Rig, plans: tuple[SensorPlan, ...], way: Way | None, context: MotionContext
) -> tuple[Rig, Facts]:
    """A rig whose sensors know where they are while their shutters are open.

    Args:
        way: How it moves; None: it stands still around each sample.

    Returns:
        The rig; and by sensor, for report.json, how many poses there are and what they err by.

    Raises:
        SceneError: The motion cannot be as it is asked for.
    """
    if all(plan.shutter is None for plan in plans):
        return rig, {}
    sensors, facts = [], {}
    poses: list[NDArray[np.float64]] = []
    for sensor, plan in zip(rig.sensors, plans, strict=True):
        if plan.shutter is None:
            sensors.append(sensor)
            continue
        opened, on_rig, told = _opened(rig, sensor, plan.shutter, way, context)
        sensors.append(dataclasses.replace(sensor, shutter=opened))
        facts[sensor.name] = told
        poses.append(on_rig)
    moving = None
    if way is not None and _rises(way.times):
        moving = _between(way.times, sensors, poses)
    return dataclasses.replace(rig, sensors=tuple(sensors), between=moving), facts


def way_of(pose: RigMotion, built: RigPoses, context: MotionContext) -> Way | None:
    """Returns how a rig moves between its samples; None where it does not."""
    duration = read_facts(built.facts, MotionFacts).duration_s
    if built.way is not None or built.times is None or duration is None:
        return built.way
    what = f"while a shutter is open: {context.what}"

    def at(times: NDArray[np.float64]) -> NDArray[np.float64]:
        within = np.clip(times, 0.0, duration)
        # Motions are made for times that rise.
        rising = np.sort(within, kind="stable")
        rising = rising[np.append(True, rising[1:] > rising[:-1])]
        made = poses_at(pose, dataclasses.replace(context, what=what), rising)
        return np.asarray(made.to_world[np.searchsorted(rising, within)])

    return Way(at, built.times)


def _opened(
    rig: Rig, sensor: Sensor, shutters: tuple[Shutter, ...], way: Way | None, context: MotionContext
) -> tuple[OpenShutter, NDArray[np.float64], dict[str, Any]]:
    """Its poses; those of the rig at the same times [s, k, 4, 4]; and what to say of them."""
    half = max(shutter.half_span for shutter in shutters)
    middle = rig.to_world[:, None]
    times, on_rig, error = np.zeros(1), middle, 0.0
    ground = context.ground(rig.to_world[:, :2, 3])
    at = composed(rig.to_world, sensor.to_rig)[:, 2, 3] - ground
    away = np.maximum(at, _NEAREST_M)
    if half > 0.0:
        for most, measured in _MEASURED:
            if most == _MOST and len(rig.to_world) * measured > _MOST_IN_ALL:
                # What the first round found is left as it is, and its error said.
                break
            times = half * np.arange(-measured, measured + 1, 2) / measured
            on_rig = np.repeat(middle, measured + 1, axis=1)
            if way is not None:
                found = way.at((way.times[:, None] + times).ravel())
                on_rig = found.reshape(len(way.times), measured + 1, 4, 4)
                # The sample's own, to the last bit.
                on_rig[:, measured // 2] = rig.to_world
            cameras = composed(on_rig.reshape(-1, 4, 4), sensor.to_rig).reshape(on_rig.shape)
            steps = _FEWEST
            error = _error_px(sensor, cameras, steps, away)
            while error > ERROR_PX and steps < most:
                steps *= 2
                error = _error_px(sensor, cameras, steps, away)
            every = measured // steps
            times, on_rig = times[::every], on_rig[:, ::every]
            if error <= ERROR_PX:
                break
    to_world = composed(on_rig.reshape(-1, 4, 4), sensor.to_rig).reshape(on_rig.shape)
    facts = {"poses": len(times), "error_px": error, "no_nearer_than_m": float(away.min())}
    return OpenShutter(shutters, times, to_world), on_rig, facts


def _error_px(
    sensor: Sensor, poses: NDArray[np.float64], steps: int, away: NDArray[np.float64]
) -> float:
    """Returns the largest error of interpolating between some of the poses, pixels.

    Args:
        poses: Camera-to-world, [s, n + 1, 4, 4].
        steps: Between the poses that are kept: a divisor of n.
        away: Distance of what is seen, [s].
    """
    if len(poses) > _AT_ONCE:
        parts = range(0, len(poses), _AT_ONCE)
        ends = [slice(begin, begin + _AT_ONCE) for begin in parts]
        return max(_error_px(sensor, poses[part], steps, away[part]) for part in ends)
    samples, count = poses.shape[:2]
    every = (count - 1) // steps
    kept = poses[:, ::every].reshape(-1, 4, 4)
    # In steps as units of time, one sample after the other: these are exact.
    begins = np.arange(samples, dtype=np.float64)[:, None] * (steps + 1)
    keys = (begins + np.arange(steps + 1)).ravel()
    at = (begins + np.arange(count) / every).ravel()
    off = between(keys, kept, at, FUNCTIONS).reshape(poses.shape) - poses
    shift = np.sqrt((off[..., :3, 3] * off[..., :3, 3]).sum(axis=-1))
    # Of matrices that differ by a turn of the angle a: 2 sqrt(2) sin(a / 2).
    turn = np.sqrt(0.5 * (off[..., :3, :3] * off[..., :3, :3]).sum(axis=(-2, -1)))
    return _pixels_a_radian(sensor) * float((turn + shift / away[:, None]).max())


def _pixels_a_radian(sensor: Sensor) -> float:
    """The most pixels that a small turn moves anything by, per radian."""
    if sensor.lens is not None:
        return float(sight_of(sensor.lens, sensor.intrinsics, sensor.resolution, 0.0)[1][0])
    fx, fy, cx, cy, skew = sensor.intrinsics
    width, height = sensor.resolution
    focal = max(fx, fy) + abs(skew)
    y = max(abs(cy), abs(height - cy)) / fy
    x = (max(abs(cx), abs(width - cx)) + abs(skew) * y) / fx
    return float(focal * (1.0 + x * x + y * y))


def _between(
    times: NDArray[np.float64], sensors: list[Sensor], on_rig: list[NDArray[np.float64]]
) -> Between | None:
    """The rig's poses at fractional time codes, for viewers."""
    codes, poses = [], []
    opened = [s.shutter for s in sensors if s.shutter is not None]
    for shutter, found in zip(opened, on_rig, strict=True):
        codes.append(codes_at(times, times[:, None] + shutter.times).ravel())
        poses.append(found.reshape(-1, 4, 4))
    code, pose = np.concatenate(codes), np.concatenate(poses)
    order = np.argsort(code, kind="stable")
    code, pose = code[order], pose[order]
    new = np.append(True, code[1:] - code[:-1] > _SAME_CODE)
    # Samples stand where they stand.
    new &= np.abs(code - np.floor(code + 0.5)) > _SAME_CODE
    return Between(code[new], pose[new]) if new.any() else None


def clock(rig: Rig) -> NDArray[np.float64]:
    """Times that a rig's samples count as, [s]: of one whose time stands still, a second each."""
    if rig.times is not None and _rises(rig.times):
        return rig.times
    return np.arange(len(rig.to_world), dtype=np.float64)


def _rises(times: NDArray[np.float64]) -> bool:
    return bool((times[1:] > times[:-1]).all())


def codes_at(times: NDArray[np.float64], at: NDArray[np.float64]) -> NDArray[np.float64]:
    """Time codes of times, of the shape of ``at``: linear between samples, and beyond them.

    Args:
        times: Of the samples, rising, [s]; of a single one, a second is a code.
    """
    if len(times) == 1:
        return at - times[0]
    i = np.clip(np.searchsorted(times, at, side="right") - 1, 0, len(times) - 2)
    return np.asarray(i + (at - times[i]) / (times[i + 1] - times[i]))
