"""Directions of a sky by elevation and bearing from the sun, and what lies between bearings."""

from __future__ import annotations

from numpy.typing import NDArray

from scenec.compiler.arithmetic import elementary
from scenec.schemas.kernels import kernel


@kernel
def angle_to_sun(sine: float, cosine: float, bearing: float, sun: NDArray) -> float:
    """Cosine of the angle to the sun.

    Args:
        sine, cosine: Of the direction's elevation.
        bearing: From the sun's, in half turns.
        sun: Cosine and sine of its elevation.
    """
    toward = cosine * sun[0] * elementary.cos(elementary.PI * bearing) + sine * sun[1]
    return min(max(toward, -1.0), 1.0)


@kernel
def cubic(x: float) -> tuple[float, float, float, float]:
    """Weights of four values at -1, 0, 1, 2 for the point x in [0, 1], after Catmull and Rom."""
    y = 1.0 - x
    return (
        -0.5 * x * y * y,
        1.0 + x * x * (1.5 * x - 2.5),
        1.0 + y * y * (1.5 * y - 2.5),
        -0.5 * y * x * x,
    )
