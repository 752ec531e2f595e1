"""The sRGB transfer function (IEC 61966-2-1), the same bits on every CPU."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.arithmetic import elementary


@lru_cache(maxsize=2)
def linear_codes(largest: int) -> NDArray[np.float64]:
    """Linear value of each code from 0 to the largest: float64 [largest + 1]."""
    codes = np.arange(largest + 1) / largest
    # As exp(2.4 log x): the same bits on every CPU.
    power = elementary.exp_array(2.4 * elementary.log_array((codes + 0.055) / 1.055))
    linear: NDArray[np.float64] = np.where(codes <= 0.04045, codes / 12.92, power)
    linear.setflags(write=False)
    return linear
