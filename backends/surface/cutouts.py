"""Cut-outs: where a surface's opacity is below its threshold nothing is there, for any ray.

The field is opacity minus threshold, bilinear between texel centers; what is there is where it is
above 0. A texel that is at the threshold is there (glTF 2.0, 3.9.4, and UsdPreviewSurface), and
none is nearer to it than ``LEAST``: else rounding would decide over whole regions of equal texels.

Beyond the unit square the picture repeats, or its coordinates are folded back into it first: kept
half a texel off its sides, which is what clamping and mirroring are between texel centers.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from scenec.backends.stage.scene import Maps
from scenec.backends.surface.algebra import Algebra, Number
from scenec.backends.surface.maps import map_values

#: Least distance of a texel from the threshold; a quarter of 1/1024, far above float32's rounding.
LEAST = 2.0**-12
#: How far below a threshold, as its file rounds it, a texel counts as at it.
_ROUNDED = 1e-6


def field(maps: Maps) -> NDArray[np.float32]:
    """Opacity minus threshold, float32 [h, w], row 0 at the bottom (v = 0).

    Raises:
        StageError: The map is missing, or cannot be read.
    """
    over = map_values(maps, "opacity")[::-1, :, 0].astype(np.float64) - maps.opacity_threshold
    over = np.where(over >= -_ROUNDED, np.maximum(over, LEAST), np.minimum(over, -LEAST))
    return np.ascontiguousarray(over, np.float32)


def folded(fn: Algebra, x: Number, wrap: str, texels: int) -> Number:
    """One texture coordinate as a repeating picture has it, by ``stage.WRAPS``."""
    if wrap == "repeat":
        return x
    if wrap == "mirror":
        x = 1.0 - fn.absolute(x - 2.0 * fn.floor(x * 0.5) - 1.0)
    half = 0.5 / texels
    return fn.clip(x, half, 1.0 - half)
