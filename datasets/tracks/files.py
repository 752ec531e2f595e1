"""Files of a camera's point tracks: arrays, a table, and TAP-Vid's pickle.

TAP-Vid (Doersch et al. 2022, arXiv:2211.03726) keeps its videos as a pickled dict of name ->
``video`` uint8 [t, h, w, 3], ``points`` float32 [n, t, 2] and ``occluded`` bool [n, t]; x and y are
shares of width and height from the picture's corner, so that pixel (0, 0) has its center at half a
pixel, as here. Its readers multiply them by the size (``tapnet/tapvid/evaluation_datasets.py``,
``create_davis_dataset``). What is outside of the picture, or behind the camera, counts as occluded.
"""

from __future__ import annotations

import pickle
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenec.schemas.correspondence import VISIBLE
from scenec.schemas.csv_cells import csv_writer, guarded_line
from scenec.schemas.files import atomic
from scenec.schemas.point_tracks import CameraFrames, TrackPoints, TrackSights

#: Words of the table's column ``state``, by code.
_STATES = ("visible", "hidden", "outside", "gone")
#: Of the table, before those of the labels.
_COLUMNS = (
    *("track", "sample", "time_s", "x_px", "y_px", "depth_m", "x_m", "y_m", "z_m"),
    *("state", "undecided", "query_sample", "instance"),
)
#: x and y in TAP-Vid's file where the camera has no place for a point, which is occluded then.
_NOWHERE = -1.0


def write_arrays(
    path: Path, camera: CameraFrames, points: TrackPoints, sights: TrackSights
) -> None:
    """Writes all there is, as NumPy arrays by name.

    Args:
        path: The .npz.
        camera: Whose pictures.
        points: n of them.
        sights: [n, frames].
    """
    arrays: dict[str, NDArray[Any]] = {
        "points": sights.pixel,
        "occluded": sights.code != VISIBLE,
        "code": sights.code,
        "undecided": sights.undecided,
        "position": sights.position,
        "depth": sights.depth,
        "sample": np.array(camera.samples, np.int64),
        "time_s": np.array(camera.times_s, np.float64),
        "size": np.array(camera.size, np.int64),
        "query_sample": points.sample,
        "query_point": points.pixel,
        "instance": points.instance,
        **{f"label.{level}": ids for level, ids in points.labels.items()},
    }
    with atomic(path) as temporary, temporary.open("wb") as out:
        np.savez(out, allow_pickle=False, **arrays)


def write_table(
    path: Path,
    camera: CameraFrames,
    points: TrackPoints,
    sights: TrackSights,
    label_names: dict[str, dict[int, str]],
) -> None:
    """Writes a line for each point and frame, as CSV.

    Args:
        path: The .csv.
        camera, points, sights: As of ``write_arrays``.
        label_names: Level -> id -> name.
    """
    labels = [
        [label_names.get(level, {}).get(number, "") for number in ids.tolist()]
        for level, ids in points.labels.items()
    ]
    fixed = list(zip(points.sample.tolist(), points.instance.tolist(), *labels, strict=True))
    with atomic(path) as temporary, temporary.open("w", encoding="utf-8", newline="") as out:
        lines = csv_writer(out)
        lines.writerow([*_COLUMNS, *(f"label.{level}" for level in points.labels)])
        frames = list(zip(camera.samples, camera.times_s, strict=True))
        for track, of in enumerate(fixed):
            numbers = np.column_stack(
                [sights.pixel[track], sights.depth[track], sights.position[track]]
            ).tolist()
            codes, unsure = sights.code[track].tolist(), sights.undecided[track].tolist()
            for (sample, time), values, code, doubt in zip(
                frames, numbers, codes, unsure, strict=True
            ):
                told = ("" if value != value else value for value in values)
                line = (track, sample, time, *told, _STATES[code], int(doubt), *of)
                lines.writerow(guarded_line(line))


def write_pickle(
    path: Path, name: str, camera: CameraFrames, sights: TrackSights, video: NDArray[np.uint8]
) -> None:
    """Writes a video and its tracks as TAP-Vid has them.

    Args:
        path: The .pkl.
        name: Of the video.
        camera, sights: As of ``write_arrays``.
        video: uint8 [frames, h, w, 3].
    """
    with np.errstate(over="ignore"):
        # Beside the camera a place may be farther than float32 goes.
        shares = (sights.pixel / np.array(camera.size, np.float64)).astype(np.float32)
    example = {
        "video": video,
        "points": np.where(np.isfinite(shares), shares, np.float32(_NOWHERE)),
        "occluded": sights.code != VISIBLE,
    }
    with atomic(path) as temporary, temporary.open("wb") as out:
        pickle.dump({name: example}, out, protocol=4)
