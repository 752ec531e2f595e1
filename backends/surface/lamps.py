"""Defines a lamp's light over its cone: 1 - smoothstep of the angle to the axis."""

from __future__ import annotations

import numpy as np

from scenec.backends.stage.scene import Lamp
from scenec.backends.surface.algebra import Algebra, Number, Vector

#: Narrowest ramp of the falloff, radians: what float32 angles resolve.
_HARD = 1e-6


def cone(lamp: Lamp) -> tuple[float, float, float]:
    """Angles at which a lamp begins to fade and ends, and one over what lies between, radians."""
    # No angle is beyond 4: a lamp that shines everywhere has no border.
    outer = lamp.cone if lamp.cone < np.pi else 4.0
    inner = lamp.cone * (1.0 - lamp.softness)
    return inner, outer, 1.0 / max(lamp.cone * lamp.softness, _HARD)


def falloff(
    fn: Algebra, away: Vector, axis: Vector, numbers: tuple[Number, Number, Number]
) -> Number:
    """Share of a lamp's intensity.

    Args:
        fn: The algebra.
        away: Unit vector from the lamp.
        axis: The lamp's, a unit vector.
        numbers: From ``cone``.
    """
    inner, outer, ramp = numbers
    # By the chord: an arc cosine has no digits left near the axis.
    angle = 2.0 * fn.arcsin(fn.minimum(0.5 * fn.length(away - axis), 1.0))
    x = fn.clip((angle - inner) * ramp, 0.0, 1.0)
    return fn.select(outer - angle, 1.0 - x * x * (3.0 - 2.0 * x), 0.0)
