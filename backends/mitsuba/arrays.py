"""Dr.Jit's arrays as a kind of number that the surface model is computed in.

Import it once Mitsuba's variant is set.
"""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi

from scenec.backends.surface.algebra import Algebra, Number, Vector

#: Dr.Jit's names where they are not NumPy's.
_NAMES = {"absolute": "abs", "arccos": "acos", "arcsin": "asin"}


class Arrays(Algebra):
    """Numbers are ``mi.Float``, vectors ``mi.Vector3f``."""

    def call(self, name: str, *operands: Any) -> Any:
        return getattr(dr, _NAMES.get(name, name))(*operands)

    def dot(self, a: Vector, b: Vector) -> Number:
        return dr.dot(a, b)

    def cross(self, a: Vector, b: Vector) -> Vector:
        return dr.cross(a, b)

    def select(self, x: Number, above: Any, otherwise: Any) -> Any:
        return dr.select(x > 0.0, above, otherwise)

    def vector(self, x: Number, y: Number, z: Number) -> Vector:
        return mi.Vector3f(x, y, z)

    def parts(self, v: Vector) -> tuple[Number, Number, Number]:
        return v[0], v[1], v[2]

    def number(self, value: float) -> Number:
        # Opaque: another scene's numbers are no other kernel to compile.
        return dr.opaque(mi.Float, float(value))


ARRAYS = Arrays()
