"""What comes out of a sensor; apart from what makes it, which is slow to import."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scenec.schemas.records import ImagingRecord

#: What sidecars say of the picture beside them.
TONE_CURVE = (
    "a sensor's picture (imaging): x = value shown, brightest = 2**headroom or what a full pixel "
    "shows; t(x) / t(brightest), t = x up to 0.6, 0.6 + 0.4 * (1 - exp(-(x - 0.6) / 0.4)) above; "
    "sRGB transfer function (IEC 61966-2-1); rounded to 8 bits; exposure_ev = log2(x / value)"
)


@dataclass(frozen=True)
class Taken:
    """What a sensor made of a frame.

    Attributes:
        picture: uint8 [h, w, 3].
        clean: The same without noise, pattern, defects, mosaic, rounding and JPEG; None if it is
            not asked for.
        raw: The converter's numbers, uint16 [h, w]; None likewise.
        exposure_ev: A value of 1 shows as 2**this.
        record: For the sidecar; what vouches for the two files comes later.
    """

    picture: NDArray[np.uint8]
    clean: NDArray[np.uint8] | None
    raw: NDArray[np.uint16] | None
    exposure_ev: float
    record: ImagingRecord
