"""When the rows of a picture are exposed.

Time counts from the sample's, at which the middle of the picture is in the middle of its exposure.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class Shutter:
    """A camera's shutter.

    Attributes:
        exposure_s: How long each row is exposed, seconds; 0: an instant.
        readout_s: How much later the last row's border is exposed than the first row's, seconds; 0:
            all rows at once (a global shutter).
        upward: Whether the lowest row comes first.
    """

    exposure_s: float = 0.0
    readout_s: float = 0.0
    upward: bool = False

    def middles(self, v: NDArray[np.float64], height: int) -> NDArray[np.float64]:
        """Middle of the exposure at heights in the picture, seconds from the sample's time.

        Args:
            v: Rows, pixels: row r's center is at r + 0.5; any shape.
            height: Of the picture, pixels.
        """
        way = -self.readout_s if self.upward else self.readout_s
        return way * (v / height - 0.5)

    @property
    def half_span(self) -> float:
        """Half of the time from the first light on any row to the last, seconds."""
        return 0.5 * (self.exposure_s + self.readout_s)
