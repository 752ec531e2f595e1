"""Finding surfaces that are there twice, where only the rule for ties says which one is hit.

A renderer answers either of two coincident faces, and consistently so: nothing in its picture
tells. The resolver therefore casts all rays that meet a repeated row or face.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray


@njit(cache=True, error_model="numpy")
def _mark_repeated(keys, table, repeated):  # type: ignore[no-untyped-def]
    mask = table.shape[0] - 1
    for i in range(keys.shape[0]):
        mixed = 0
        for k in range(keys.shape[1]):
            # Multiplicative hashing; the shift brings the high bits, which vary most, down.
            mixed = (mixed ^ keys[i, k]) * 0x9E3779B97F4A7C1
            mixed ^= mixed >> 29
        slot = mixed & mask
        while table[slot] >= 0:
            other = table[slot]
            same = True
            for k in range(keys.shape[1]):
                same = same and keys[i, k] == keys[other, k]
            if same:
                repeated[i] = True
                repeated[other] = True
                break
            slot = (slot + 1) & mask
        if table[slot] < 0:
            table[slot] = i


def repeated_rows(keys: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Which lines of a table stand in it more than once.

    Args:
        keys: Integers, int64 [n, k].

    Returns:
        bool [n].
    """
    repeated = np.zeros(len(keys), np.bool_)
    table = np.full(2 << max(len(keys), 1).bit_length(), -1, np.int32)
    _mark_repeated(keys, table, repeated)
    return repeated
