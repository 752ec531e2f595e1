"""Motion and raw numbers as the page stores them: two more codes beside those of ``layers``.

``halves`` ``planes`` planes of IEEE binary16, as whole numbers that ascend with the values (the
          bits with the sign turned, all bits turned where it is set), each plane as ``layers`` has
          ``steps``: differences to the plane through the neighbors. Off by 1/2048 at most, and by
          half of 2^-24 near 0; what is beyond 65504 is that. Not a number in any plane: in all
``whole`` one plane of uint16, as it is, stored alike
"""

from __future__ import annotations

import zlib

import numpy as np
from numpy.typing import NDArray

from scenec.datasets.view.layers import Layer, differences

#: Most that a stored value is off, relative to it.
HALF_ERROR = 2.0**-11
_LARGEST = 65504.0
_EFFORT = 6


def store_field(name: str, values: NDArray[np.floating]) -> Layer:
    """Values [h, w] or [h, w, planes]; infinity counts as not a number."""
    planes = values[..., None] if values.ndim == 2 else values
    known = np.isfinite(planes).all(axis=2, keepdims=True)
    halves = np.where(known, np.clip(planes, -_LARGEST, _LARGEST), np.nan).astype(np.float16)
    bits = halves.view(np.uint16)
    codes = np.where(bits & 0x8000, ~bits, bits | 0x8000)
    # One pattern for all that is not a number.
    codes = np.where(known, codes, np.uint16(0xFFFF))
    data = b"".join(differences(codes[..., k]) for k in range(planes.shape[2]))
    facts = {"name": name, "code": "halves", "planes": planes.shape[2]}
    return Layer(facts, zlib.compress(data, _EFFORT))


def store_integers(name: str, values: NDArray[np.uint16]) -> Layer:
    """Whole numbers of 16 bits [h, w], exactly."""
    facts = {"name": name, "code": "whole", "top": int(values.max(initial=1))}
    return Layer(facts, zlib.compress(differences(values), _EFFORT))
