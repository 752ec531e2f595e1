"""Reads lidar scans (``scenec scan``) that belong to frames, for formats that hold both."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenec.datasets.formats.contract import Info
from scenec.datasets.source import FrameRef
from scenec.schemas.scans import SCANS, read_scan


@dataclass(frozen=True)
class Cloud:
    """Holds the answers of a scan; arrays have a row an answer.

    Attributes:
        points: float32 [n, 3], lidar's frame (x ahead, y left, z up), meters.
        intensity: float32 [n]; 0 where the lidar tells none.
        ring: int64 [n], the beam.
        labels: uint32 [n], of the dataset's level, after remapping; 0: none.
        instances: uint32 [n]; 0: none.
        to_world: [4, 4].
    """

    points: NDArray[np.float32]
    intensity: NDArray[np.float32]
    ring: NDArray[np.int64]
    labels: NDArray[np.uint32]
    instances: NDArray[np.uint32]
    to_world: NDArray[np.float64]


def scans_of(ref: FrameRef, rig: str) -> list[Path]:
    """Returns the sidecars of the scans of a rig at a frame's sample, by name of lidar."""
    # Of batch_0000/frames/<backend>/<camera>/000000.
    folder = ref.stem.parents[3] / SCANS
    return sorted(folder.glob(f"{rig}_*/{ref.sample:06d}.json"))


def read_cloud(path: Path, info: Info, stage_digest: str) -> Cloud | None:
    """Reads a scan; None if it is of another stage than the frames.

    Raises:
        FrameError: It is damaged.
    """
    scan = read_scan(path)
    if scan.sidecar.stage_digest != stage_digest:
        return None
    arrays = scan.arrays
    there = np.isfinite(arrays["range"])
    none: NDArray[Any] = np.zeros(there.shape, np.uint32)
    labels = arrays.get(f"label.{info.level}", none)[there]
    numbers = info.renumbered.get(info.level, {})
    if numbers:
        known, inverse = np.unique(labels, return_inverse=True)
        new = [numbers.get(old, old) for old in known.tolist()]
        labels = np.array(new, np.uint32)[inverse]
    return Cloud(
        arrays["points"][there],
        arrays.get("intensity", none)[there].astype(np.float32),
        np.nonzero(there)[0],
        labels,
        arrays.get("instance", none)[there],
        np.array(scan.sidecar.lidar_to_world),
    )
