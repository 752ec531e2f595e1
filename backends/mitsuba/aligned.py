"""Memory as Dr.Jit likes it.

Dr.Jit takes NumPy's memory as it lies. What begins anywhere but at a multiple of 64 bytes it reads
number by number, not in packets, with another kernel: whether one that was kept will do, would be
left to where memory happened to be free.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

_BYTES = 64


def aligned(values: ArrayLike, kind: Any = np.float32) -> NDArray[Any]:
    """A copy of an array, of the same shape, that begins at such a place."""
    values = np.asarray(values)
    found = _room(values.size, kind).reshape(values.shape)
    found[...] = values
    return found


def aligned_columns(columns: Any, kind: Any = np.float32) -> NDArray[Any]:
    """A copy of columns of one length, [n, length], each of which begins at such a place."""
    count, length = len(columns), len(columns[0])
    each = _BYTES // np.dtype(kind).itemsize
    width = -(-length // each) * each
    found = _room(count * width, kind).reshape(count, width)[:, :length]
    found[:] = columns
    return found


def _room(count: int, kind: Any) -> NDArray[Any]:
    size = np.dtype(kind).itemsize
    room = np.empty(count + _BYTES // size, kind)
    first = -room.ctypes.data % _BYTES // size
    return room[first : first + count]
