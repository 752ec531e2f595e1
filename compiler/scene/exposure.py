"""Meters incident light."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.arithmetic import elementary


def incident_exposure(irradiance: NDArray[np.float64]) -> NDArray[np.float64]:
    """Exposure (log2 of the gain) that shows a level white Lambertian surface at 1.

    This is what an incident-light meter does: radiance E / pi of a perfect diffuser becomes 1, an
    18 % gray card 0.18, whatever the scene's own albedo. Rounded to 1/64 of a stop, so that the
    stage's float32 holds it exactly. Without light it is 0.
    """
    ev = np.zeros(irradiance.shape)
    lit = irradiance > 0.0
    stops = elementary.log_array(elementary.PI / irradiance[lit]) / elementary.log(2.0)
    ev[lit] = np.round(stops * 64.0) / 64.0
    return ev
