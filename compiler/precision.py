"""What float32 positions cost in a batch, against what is promised and what a pixel shows."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

#: Precision promised of a position: this part of the extent, the step of float32 (2**-24).
FLOAT32_STEP = 6e-8
#: From here on the compiler warns: a tenth of the tolerance that meshes have by default.
WARN_PX = 0.05


def precision(
    bounds: NDArray[np.float64],
    facts: dict[str, Any],
    pixels_per_m: NDArray[np.float64] | None,
) -> dict[str, Any]:
    """The precision of positions, for report.json.

    Args:
        bounds: Of all geometry, float64 [2, 3].
        facts: What building measured so far: the ``float32_error_max_m`` of ground and objects.
        pixels_per_m: See ``cameras.sight``; None without cameras.

    Returns:
        The extent (the longest side of the bounds), the precision promised for it and the largest
        error made, in meters, and in pixels where the ground is seen largest (None without
        cameras). Vertices are held in tiles, which keeps the error far below the promise where
        there are many.
    """
    extent = float((bounds[1] - bounds[0]).max())
    parts = [facts["ground"], *facts.get("objects", {}).values()]
    error = max(float(part["float32_error_max_m"]) for part in parts)
    nearest = None if pixels_per_m is None else float(pixels_per_m.max(initial=0.0))
    return {
        "extent_m": extent,
        "promised_m": FLOAT32_STEP * extent,
        "float32_error_max_m": error,
        "pixels_per_m_max": nearest,
        "promised_px": None if nearest is None else FLOAT32_STEP * extent * nearest,
        "float32_error_max_px": None if nearest is None else error * nearest,
    }
