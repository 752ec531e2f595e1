"""How far two renderings of the same radiance differ, and a picture of where."""

from __future__ import annotations

import importlib
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from scenec.schemas.errors import OutputError
from scenec.schemas.frames import Frame
from scenec.schemas.picture import develop, write_png
from scenec.schemas.records import FrameRecord

#: Weight of the mean in relMSE's denominator, so that black pixels do not decide it.
EPSILON = 0.01


@dataclass
class RadianceComparison:
    """``rgb`` of two backends, over all frames; of surfaces alone where frames have a depth.

    Attributes:
        first, second: Backends; the first is the reference of relMSE and FLIP.
        frames: Compared.
        sums: Radiance of all pixels of both, float64 [2, 3].
        relative_mse: mean((b - a)^2 / (a^2 + 0.01 mean(a)^2)), for each frame.
        noise: What of it the frames' own noise explains (the sum of both estimates), for each; NaN
            where a backend's error is unknown.
        flip: Mean LDR-FLIP (Andersson et al. 2020; 67 pixels a degree) between the pictures as
            developed by ``schemas.picture``, for each; NaN without the package.
        floor: FLIP between two noise seeds of the first backend, for each; empty if not asked for.
    """

    first: str
    second: str
    frames: int = 0
    sums: NDArray[np.float64] = field(default_factory=lambda: np.zeros((2, 3)))
    relative_mse: list[float] = field(default_factory=list)
    noise: list[float] = field(default_factory=list)
    flip: list[float] = field(default_factory=list)
    floor: list[float] = field(default_factory=list)

    @property
    def mean_ratio(self) -> list[float | None]:
        """Mean radiance of the second over that of the first, per channel; None for black."""
        return [float(b / a) if a > 0.0 else None for a, b in zip(*self.sums.tolist(), strict=True)]

    def add(self, first: Frame, second: Frame) -> NDArray[np.float32] | None:
        """Count one frame; returns its FLIP map, [h, w]."""
        a = first.passes["rgb"].astype(np.float64)
        b = second.passes["rgb"].astype(np.float64)
        depth = first.passes.get("depth")
        on = np.ones(a.shape[:2], bool) if depth is None else np.isfinite(depth)
        self.frames += 1
        self.sums += np.stack([a[on].sum(axis=0), b[on].sum(axis=0)])
        self.relative_mse.append(relative_mse(a[on], b[on]))
        estimates = [_noise(frame.sidecar) for frame in (first, second)]
        self.noise.append(float(np.sum(estimates)))
        found = flip(first, second)
        self.flip.append(np.nan if found is None else float(found.mean()))
        return found


def relative_mse(a: NDArray[np.float64], b: NDArray[np.float64]) -> float:
    """mean((b - a)^2 / (a^2 + 0.01 mean(a)^2)); 0 where there is nothing to compare."""
    if a.size == 0:
        return 0.0
    floor = EPSILON * float(a.mean()) ** 2
    denominator = a * a + floor
    return float(np.mean((b - a) ** 2 / np.where(denominator > 0.0, denominator, 1.0)))


def _noise(record: FrameRecord) -> float:
    value = record.error.relative_mse
    return np.nan if value is None else float(value)


def flip(first: Frame, second: Frame) -> NDArray[np.float32] | None:
    """LDR-FLIP per pixel in [0, 1], [h, w], at the first one's exposure; None if not installed."""
    try:
        evaluator = importlib.import_module("flip_evaluator")
    except ImportError:
        return None
    exposure = first.sidecar.exposure_ev
    pictures = [
        develop(frame.passes["rgb"], exposure).astype(np.float32) / 255.0
        for frame in (first, second)
    ]
    error, _, _ = evaluator.evaluate(*pictures, "LDR", applyMagma=False)
    values: NDArray[np.float32] = np.asarray(error, np.float32).reshape(pictures[0].shape[:2])
    return values


def write_differences(
    path: Path, first: Frame, second: Frame, flip_map: NDArray[np.float32] | None
) -> None:
    """Two pictures side by side, then FLIP from black (0) to white (0.5 and more).

    Raises:
        OutputError: It cannot be written.
    """
    exposure = first.sidecar.exposure_ev
    panels = [
        develop(frame.passes["rgb"], exposure) for frame in (first, second) if "rgb" in frame.passes
    ]
    if flip_map is not None:
        gray = np.rint(255.0 * np.clip(2.0 * flip_map, 0.0, 1.0)).astype(np.uint8)
        panels.append(np.repeat(gray[..., None], 3, axis=2))
    gap = np.full((len(panels[0]), 4, 3), 255, np.uint8)
    strips = [part for panel in panels for part in (panel, gap)][:-1]
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise OutputError(f"{path.parent}: cannot be made: {error.strerror or error}") from error
    write_png(path, np.concatenate(strips, axis=1))


def differing(a: NDArray, b: NDArray) -> NDArray[np.bool_]:
    """Pixels whose bits differ, bool [h, w]; NaN equals NaN."""
    same = a.view(np.uint32) == b.view(np.uint32)
    return ~(same.all(axis=2) if same.ndim == 3 else same)
