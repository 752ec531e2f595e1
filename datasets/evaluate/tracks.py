"""Trajectories: absolute and relative error, by evo.

ATE (absolute trajectory error) is the distance between true and estimated positions after one
alignment of all of them; RPE (relative pose error) is what a motion over a fixed step is off.
J. Sturm and others, A benchmark for the evaluation of RGB-D SLAM systems, IROS 2012.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenec.datasets.evaluate.breakdown import SUN, Attribute, Attributes, filled, sun_elevation
from scenec.datasets.evaluate.evaluation import Cell, Evaluation, Table
from scenec.datasets.source import Source, sequences
from scenec.schemas.errors import FrameError, OutputError
from scenec.schemas.quaternions import quaternions
from scenec.schemas.sidecars import read_sidecar

TRUTH = "groundtruth.txt"
_COLUMNS = "timestamp tx ty tz qx qy qz qw"
#: Meters whose squares add up in double precision, and far beyond any track's.
_MOST = 1e15
#: Least poses that positions can be aligned by.
_LEAST = 3


@dataclass(frozen=True)
class Track:
    """Poses over time.

    Attributes:
        path: Where they are from.
        times: Seconds, rising, [n].
        positions: Meters, [n, 3].
        quaternions: (x, y, z, w), camera to world, [n, 4].
        sun: Elevation in degrees at each, NaN where unknown, [n].
    """

    path: Path
    times: NDArray[np.float64]
    positions: NDArray[np.float64]
    quaternions: NDArray[np.float64]
    sun: NDArray[np.float64]


def read_tum(path: Path) -> Track:
    """A trajectory as TUM files have it: ``timestamp tx ty tz qx qy qz qw``, # for comments.

    Raises:
        FrameError: It is none; names file and line.
    """
    try:
        lines = path.read_text(encoding="utf-8").splitlines()
    except (OSError, ValueError) as error:
        raise FrameError(f"{path}: cannot be read as a trajectory: {error}") from error
    rows: list[list[float]] = []
    for number, line in enumerate(lines, 1):
        words = line.replace(",", " ").split()
        if not words or words[0].startswith("#"):
            continue
        try:
            row = [float(word) for word in words]
        except ValueError:
            row = []
        if len(row) != 8 or not all(map(math.isfinite, row)):
            raise FrameError(f"{path}:{number}: expected eight finite numbers, {_COLUMNS}")
        if max(map(abs, row[1:])) > _MOST:
            raise FrameError(f"{path}:{number}: expected positions within {_MOST:g} m")
        if max(map(abs, row[4:])) < 1.0 / _MOST:
            raise FrameError(f"{path}:{number}: its quaternion is 0, which is no rotation")
        if rows and row[0] <= rows[-1][0]:
            raise FrameError(f"{path}:{number}: its time is not after that of the pose before")
        rows.append(row)
    if not rows:
        raise FrameError(f"{path}: holds no pose; expected lines of {_COLUMNS}")
    values = np.array(rows)
    turns = values[:, 4:] / np.linalg.norm(values[:, 4:], axis=1, keepdims=True)
    return Track(path, values[:, 0], values[:, 1:4], turns, np.full(len(rows), np.nan))


def track_of(source: Source) -> Track:
    """The poses of one camera in one batch.

    Raises:
        FrameError: A sidecar cannot be read.
        OutputError: There are several sequences.
    """
    found = list(sequences(source.frames))
    if len(found) > 1:
        names = ", ".join(f"{run[0].batch_name}/{run[0].camera}" for run in found[:12])
        raise OutputError(
            f"{source.out}: holds {len(found)} sequences ({names}); choose one by --cameras and "
            "--batches"
        )
    sidecars = [read_sidecar(ref.stem.with_suffix(".json")) for ref in found[0]]
    times = np.array(
        [
            float(ref.sample if one.time_s is None else one.time_s)
            for ref, one in zip(found[0], sidecars, strict=True)
        ]
    )
    if (np.diff(times) <= 0.0).any():
        at = found[0][int(np.argmax(np.diff(times) <= 0.0)) + 1]
        raise OutputError(f"{at.stem}.json: its time is not after that of the frame before")
    poses = np.array([one.camera_to_world for one in sidecars], np.float64)
    sun = np.array([sun_elevation(one) for one in sidecars])
    return Track(source.out, times, poses[:, :3, 3], quaternions(poses[:, :3, :3]), sun)


def evaluate_track(
    estimate: Track,
    truth: Track,
    attributes: Attributes,
    *,
    align: str = "se3",
    delta: float = 1.0,
    delta_unit: str = "frames",
    max_difference_s: float = 0.01,
) -> Evaluation:
    """Hold a trajectory against the true one.

    Args:
        estimate: To be judged.
        truth: What it should be.
        attributes: Bins; that of the sun is used.
        align: ``se3`` (turned and moved to fit best), ``sim3`` (scaled, too: for one camera
            without depth), ``origin`` (first poses laid on each other), ``none``.
        delta: Step of the relative error …
        delta_unit: … in ``frames`` or in meters of the true path, ``m``.
        max_difference_s: Poses further apart in time are not compared.

    Raises:
        OutputError: evo is not installed, or cannot compare these.
    """
    try:
        from evo import EvoException
        from evo.core import metrics, sync
        from evo.core.trajectory import PoseTrajectory3D
        from evo.core.units import Unit
    except ImportError as error:
        raise OutputError(
            f"trajectories are judged by evo: pip install 'scenec[evaluate]' ({error})"
        ) from error
    if delta_unit == "frames" and (delta < 1 or delta != int(delta)):
        raise OutputError(f"--delta {delta:g}: a step of frames is a whole number from 1")
    try:
        true, guessed = sync.associate_trajectories(
            _evo(truth, PoseTrajectory3D),
            _evo(estimate, PoseTrajectory3D),
            max_diff=max_difference_s,
        )
        if true.num_poses < _LEAST:
            raise OutputError(_too_few(estimate, truth, true.num_poses))
        # Lengths before any scaling.
        found = Evaluation("track", estimate.path, truth.path)
        guess_length = guessed.path_length
        scale = 1.0
        if align == "origin":
            guessed.align_origin(true)
        elif align != "none":
            _, _, scale = guessed.align(true, correct_scale=align == "sim3")
        unit = Unit.frames if delta_unit == "frames" else Unit.meters
        ate = metrics.APE(metrics.PoseRelation.translation_part)
        ate.process_data((true, guessed))
        relations = (
            metrics.PoseRelation.translation_part,
            metrics.PoseRelation.rotation_angle_deg,
        )
        # Of meters, pairs overlap and are those of the true path.
        meters = delta_unit == "m"
        rpes = [
            metrics.RPE(one, delta, unit, all_pairs=meters, pairs_from_reference=meters)
            for one in relations
        ]
        for rpe in rpes:
            rpe.process_data((true, guessed))
    except EvoException as error:
        raise OutputError(
            f"{estimate.path}: evo cannot compare it with {truth.path}: {error}"
            + (" (--align origin or none needs none)" if align in ("se3", "sim3") else "")
        ) from error
    found.settings = {
        "align": align, "delta": delta, "delta_unit": delta_unit,
        "max_time_difference_s": max_difference_s,
    }  # fmt: skip
    found.units = {"scale": ""}
    for name, metric, unit_text in (
        ("ate", ate, "m"), ("rpe_translation", rpes[0], "m"), ("rpe_rotation", rpes[1], "deg")
    ):  # fmt: skip
        statistics = metric.get_all_statistics()
        for kind in ("rmse", "mean", "median", "max"):
            found.measures[f"{name}_{kind}"] = float(statistics[kind])
            found.units[f"{name}_{kind}"] = unit_text
    length = float(true.path_length)
    found.measures |= {
        "path_length": length,
        "path_length_estimated": float(guess_length),
        "ate_percent_of_path": 100.0 * float(found.measures["ate_rmse"] or 0.0) / length
        if length
        else None,
        "scale": float(scale),
        "poses": true.num_poses,
        "tracked": true.num_poses / len(truth.times),
    }
    found.units |= {"path_length": "m", "path_length_estimated": "m", "ate_percent_of_path": "%"}
    if found.measures["tracked"] != 1.0:
        found.notes.append(
            f"{true.num_poses} of {len(truth.times)} true poses have an estimate; the others do "
            "not count"
        )
    errors = np.asarray(ate.error)
    at = np.searchsorted(truth.times, true.timestamps)
    found.tables = [
        *_by_sun(attributes[SUN.name], truth.sun[np.clip(at, 0, len(truth.sun) - 1)], errors),
        Table(
            "pose", "by pose", ("time", "ate"),
            [(f"{t:.6f}", e) for t, e in zip(true.timestamps.tolist(), errors, strict=True)],
        ),
    ]  # fmt: skip
    found.arrays = {
        "true": np.array(true.positions_xyz),
        "estimated": np.array(guessed.positions_xyz),
        "error": errors,
    }
    return found


def _evo(track: Track, kind: Any) -> Any:
    turns = np.roll(track.quaternions, 1, axis=1)
    return kind(track.positions, turns, track.times)


def _too_few(estimate: Track, truth: Track, common: int) -> str:
    spans = (f"{one.times[0]:.6g} to {one.times[-1]:.6g} s" for one in (estimate, truth))
    return (
        f"{estimate.path}: {common} of its poses are at times of {truth.path}, and {_LEAST} are "
        f"needed; it spans {' and the truth '.join(spans)} (--max-time-difference allows more)"
    )


def _by_sun(one: Attribute, sun: NDArray[np.float64], errors: NDArray[np.float64]) -> list[Table]:
    bins = one.numbers(sun)
    rows: list[tuple[Cell, ...] | None] = []
    for number in range(one.count):
        inside = errors[bins == number]
        rows.append(
            (float(np.sqrt(np.mean(inside**2))), float(inside.max()), len(inside))
            if len(inside)
            else None
        )
    found = filled(one, rows)
    columns = (one.name, "ate_rmse", "ate_max", "poses")
    return [Table(one.name, f"by {one.name}: {one.what}", columns, found)] if found else []
