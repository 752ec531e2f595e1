"""Grows an array by rows without copying it each time."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray


class Growing:
    """Rows of an array that others are added to.

    Where there is no room for them the rows move, into three times what is needed, of which the
    system gives what is written to: views of ``rows`` from before are then of the past.
    """

    def __init__(self, rows: NDArray[Any]) -> None:
        self._buffer, self._count = rows, len(rows)

    @property
    def rows(self) -> NDArray[Any]:
        """All so far."""
        return self._buffer[: self._count]

    def add(self, count: int) -> NDArray[Any]:
        """Adds rows, and returns them to be written."""
        before, self._count = self._count, self._count + count
        if self._count > len(self._buffer):
            shape = 3 * self._count, *self._buffer.shape[1:]
            wider = np.empty(shape, self._buffer.dtype)
            wider[:before] = self._buffer[:before]
            self._buffer = wider
        return self._buffer[before : self._count]

    def append(self, rows: NDArray[Any]) -> None:
        """Adds rows."""
        self.add(len(rows))[:] = rows
