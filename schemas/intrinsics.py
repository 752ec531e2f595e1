"""Small things that kernels do and Python has no words for."""

from __future__ import annotations

from typing import Any

from scenec.schemas.kernels import intrinsic


@intrinsic
def horner(context, coefficients, x):  # type: ignore[no-untyped-def]
    """A polynomial at x, its coefficients, a tuple of float64, from the constant one up.

    There is no loop in its code, so that loops around it have lanes.
    """
    from numba.core import types

    def terms(_context: Any, builder: Any, signature: Any, values: Any) -> Any:
        given, x = values
        count = len(signature.args[0])
        value = builder.extract_value(given, count - 1)
        for i in range(count - 2, -1, -1):
            value = builder.fadd(builder.fmul(value, x), builder.extract_value(given, i))
        return value

    return types.float64(coefficients, types.float64), terms


@intrinsic
def bits_of(context, x):  # type: ignore[no-untyped-def]
    """The bits of a float64 as an int64."""
    from llvmlite import ir
    from numba.core import types

    def cast(_context: Any, builder: Any, _signature: Any, values: Any) -> Any:
        return builder.bitcast(values[0], ir.IntType(64))

    return types.int64(types.float64), cast


@intrinsic
def float_of(context, bits):  # type: ignore[no-untyped-def]
    """The float64 of an int64's bits."""
    from llvmlite import ir
    from numba.core import types

    def cast(_context: Any, builder: Any, _signature: Any, values: Any) -> Any:
        return builder.bitcast(values[0], ir.DoubleType())

    return types.float64(types.int64), cast
