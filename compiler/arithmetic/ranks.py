"""Order statistics without sorting all there is."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

# Into which values are sorted roughly.
_BINS = 4096


def ranked(values: NDArray[np.float64], ranks: tuple[int, ...]) -> list[float]:
    """Returns the values at some ranks, ascending, of finite values in sorted order.

    Args:
        values: float64 of any shape, not empty.
        ranks: From 0 to the number of values less one.
    """
    values = values.ravel()
    low = values.min()
    width = values.max() - low
    if width == 0.0:
        return [float(low)] * len(ranks)
    # Bins rise with the values, whatever is rounded: only those of the ranks are sorted.
    bins = ((values - low) / width * _BINS).astype(np.int64)
    ends = np.cumsum(np.bincount(bins))
    first, last = np.searchsorted(ends, [ranks[0], ranks[-1]], side="right")
    among = np.sort(values[(bins >= first) & (bins <= last)], kind="stable")
    before = ends[first - 1] if first > 0 else 0
    return [float(among[rank - before]) for rank in ranks]
