"""Derives bearing, distance and pitch of a view from a uniform box of targets.

OAISYS draws a target in a box about the camera. A cfg draws bearing and distance; each has the
distribution that it has in the box, as a histogram.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from scenec.importers.numbers import Number, tidy

#: Points along the sides of the box, and intervals of a histogram.
_POINTS = (120, 120, 9)
_BINS = 12


def offsets(low: Sequence[float], high: Sequence[float]) -> np.ndarray:
    """Points spread evenly over a box, [n, 3], none of them right above or below the camera."""
    sides = [
        a + (b - a) * (np.arange(count) + 0.5) / count
        for a, b, count in zip(low, high, _POINTS, strict=True)
    ]
    points = np.stack(np.meshgrid(*sides, indexing="ij"), axis=-1).reshape(-1, 3)
    return points[np.hypot(points[:, 0], points[:, 1]) > 1e-6]


def distances(points: np.ndarray) -> Number:
    """Level distances, m."""
    return _histogram(np.hypot(points[:, 0], points[:, 1]))


def bearings(points: np.ndarray) -> Number:
    """Compass bearings, clockwise from +y."""
    found = np.degrees(np.arctan2(points[:, 0], points[:, 1])) % 360.0
    # All around: from north to north.
    is_around = len(found) and found.max() - found.min() > 350.0
    return _histogram(found, (0.0, 360.0) if is_around else None)


def pitches(points: np.ndarray) -> Number:
    """Elevations of the view."""
    return _histogram(np.degrees(np.arctan2(points[:, 2], np.hypot(points[:, 0], points[:, 1]))))


def _histogram(values: np.ndarray, ends: tuple[float, float] | None = None) -> Number:
    if len(values) == 0:
        return 1
    low, high = float(values.min()), float(values.max())
    if high - low < 1e-6:
        return tidy(low)
    counts, edges = np.histogram(values, bins=_BINS, range=ends)
    histogram: dict[str, Any] = {"type": "histogram"}
    histogram["edges"] = [float(f"{edge:.6g}") for edge in edges]
    histogram["weights"] = [float(f"{count / len(values):.4g}") for count in counts]
    return histogram
