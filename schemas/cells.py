"""Cells that pictures are laid in so that they do not repeat: how each is turned and shifted.

What compiler and renderers must agree on, so that relief that is geometry lies where the picture of
its colors does. ``scenec.backends.surface.cells`` says what is done with it.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

#: Corners on a side of the table; beyond, it repeats.
SIDE = 64
#: Turns and shifts are multiples of one part in so many: half precision holds them all.
STEPS = 1024


@lru_cache(maxsize=8)
def table(seed: int) -> NDArray[np.float64]:
    """Shift and turn of each corner, [SIDE, SIDE, 3]: repeats along u and along v, and turns.

    Entry [j, i] is that of the corners (i, j) modulo SIDE: the upper ten bits of ``pcg3d`` of
    (i, j, seed), over STEPS.
    """
    j, i = np.meshgrid(np.arange(SIDE), np.arange(SIDE), indexing="ij")
    hashed = pcg3d(i, j, np.full_like(i, seed))
    result: NDArray[np.float64] = (hashed >> np.uint32(22)).astype(np.float64) / STEPS
    result.setflags(write=False)
    return result


def pcg3d(x: NDArray, y: NDArray, z: NDArray) -> NDArray[np.uint32]:
    """Three hashes of three whole numbers, [..., 3] (Jarzynski and Olano 2020).

    Hash Functions for GPU Rendering, Journal of Computer Graphics Techniques 9(3).
    """
    x, y, z = (np.asarray(c).astype(np.uint32) * np.uint32(1664525) + np.uint32(1013904223)
               for c in (x, y, z))  # fmt: skip
    for last in (False, True):
        x = x + y * z
        y = y + z * x
        z = z + x * y
        if not last:
            x, y, z = (c ^ (c >> np.uint32(16)) for c in (x, y, z))
    return np.stack([x, y, z], axis=-1)
