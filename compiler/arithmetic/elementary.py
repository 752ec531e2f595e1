"""Elementary functions with the same bits on every CPU.

glibc, NumPy and numba pick code by CPU (FMA or not, AVX-512 or not), and the last bit of their
``exp``, ``sin`` and ``pow`` changes with it. These are built from + - * /, sqrt, floor and exact
scaling by powers of two, all correctly rounded by IEEE 754 and never contracted (no fast-math), so
they are the only ones allowed in the compiler. They cost up to a few times the native ones; their
error against exact values is tested in ``tests/compiler/arithmetic/test_elementary.py``:
at most 1 ulp for log, 1.5 for exp, 2 for sin, cos and atan, 4 for acos and asin, and a relative
error of (1 + |y log x|) * 2e-16 for pow.

Scalar functions are numba-compiled; ``*_array`` maps them over a float64 array of any shape.

Method: argument reduction after Cody and Waite (1980), then plain Taylor series, whose coefficients
are rational numbers anyone can check. There are no branches, calls or loops in them, so that loops
around them have lanes: 2 to 5 ns a value.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike, NDArray

from scenec.schemas.intrinsics import bits_of, float_of, horner
from scenec.schemas.kernels import inlined, kernel

# ln 2 and pi/2 in parts: the leading parts end in zero bits, so that their product with the small
# integer of the reduction is exact.
_LN2_HIGH = float.fromhex("0x1.62e42fee00000p-1")
_LN2_LOW = float.fromhex("0x1.a39ef35793c76p-33")
_LOG2_E = float.fromhex("0x1.71547652b82fep+0")
_TWO_OVER_PI = float.fromhex("0x1.45f306dc9c883p-1")
_HALF_PI_1 = float.fromhex("0x1.921fb54400000p+0")
_HALF_PI_2 = float.fromhex("0x1.0b4611a600000p-34")
_HALF_PI_3 = float.fromhex("0x1.3198a2e037073p-69")
PI = float.fromhex("0x1.921fb54442d18p+1")
_HALF_PI = PI / 2
_QUARTER_PI = PI / 4
_SQRT_HALF = float.fromhex("0x1.6a09e667f3bcdp-1")
# Added to a small whole number, this leaves the number in the lowest bits.
_SHIFT = 1.5 * 2.0**52
_TAN_PI_8 = float.fromhex("0x1.a827999fcef32p-2")

_EXP = tuple(1.0 / math.factorial(n) for n in range(15))
_SIN = tuple((-1.0) ** n / math.factorial(2 * n + 1) for n in range(10))
_COS = tuple((-1.0) ** n / math.factorial(2 * n) for n in range(10))
_ATANH = tuple(1.0 / (2 * n + 1) for n in range(13))
_ATAN = tuple((-1.0) ** n / (2 * n + 1) for n in range(23))


@inlined
def _power_of_two(exponent: float) -> float:
    """2**exponent, of a whole number from -1022 to 1023."""
    # The sum has the biased exponent in its lowest bits.
    return float_of(bits_of(exponent + (_SHIFT + 1023.0)) << 52)


@inlined
def _mantissa_exponent(x: float) -> tuple[float, float]:
    """(m, e) with m * 2**e = x and m in [1/2, 1), for x > 0."""
    tiny = x < 2.0**-1022
    bits = bits_of(x * 2.0**54 if tiny else x)
    mantissa = float_of((bits & ((1 << 52) - 1)) | (1022 << 52))
    exponent = float_of((bits >> 52) | (1075 << 52)) - (2.0**52 + 1022.0)
    return mantissa, exponent - 54.0 if tiny else exponent


@inlined
def exp(x: float) -> float:
    """e**x; 0 below -745.2, inf above 709.8."""
    k = np.floor(x * _LOG2_E + 0.5)
    r = (x - k * _LN2_HIGH) - k * _LN2_LOW
    # 1 + (r + r^2/2 + ...): the small part is summed first to keep its bits.
    value = 1.0 + horner(_EXP[1:], r) * r
    # In two steps: neither factor is beyond float64, and only the last product rounds.
    half = np.floor(0.5 * k)
    value = value * _power_of_two(half) * _power_of_two(k - half)
    value = 0.0 if x < -745.2 else value
    value = np.inf if x > 709.8 else value
    return x if x != x else value


@inlined
def log(x: float) -> float:
    """Natural logarithm; -inf at 0, NaN below."""
    m, e = _mantissa_exponent(x)
    low = m < _SQRT_HALF
    m = m * 2.0 if low else m
    e = e - 1.0 if low else e
    f = m - 1.0
    s = f / (m + 1.0)
    # log(m) = f - s*(f - R) with R = log(m)/s - 2 ... the leading f carries no rounding error.
    z = s * s
    tail = 2.0 * z * horner(_ATANH[1:], z)
    value = e * _LN2_HIGH + (f - (s * (f - tail) - e * _LN2_LOW))
    value = x if x == np.inf else value
    value = -np.inf if x == 0.0 else value
    return value if x >= 0.0 else np.nan


@inlined
def pow(x: float, y: float) -> float:
    """x**y for x >= 0, as exp(y log x)."""
    value = exp(y * log(x))
    value = (0.0 if y > 0.0 else np.inf) if x == 0.0 else value
    return 1.0 if y == 0.0 else value


@inlined
def _sin_cos(x: float) -> tuple[float, float]:
    n = np.floor(x * _TWO_OVER_PI + 0.5)
    r = ((x - n * _HALF_PI_1) - n * _HALF_PI_2) - n * _HALF_PI_3
    z = r * r
    s = r + r * z * horner(_SIN[1:], z)
    c = 1.0 + z * horner(_COS[1:], z)
    quadrant = n - 4.0 * np.floor(0.25 * n)
    if quadrant == 0.0:
        return s, c
    if quadrant == 1.0:
        return c, -s
    if quadrant == 2.0:
        return -s, -c
    return -c, s


@inlined
def sin(x: float) -> float:
    """Sine of an angle in radians, |x| up to 1e6."""
    return _sin_cos(x)[0]


@inlined
def cos(x: float) -> float:
    """Cosine of an angle in radians, |x| up to 1e6."""
    return _sin_cos(x)[1]


@inlined
def atan(x: float) -> float:
    """Arctangent in [-pi/2, pi/2]."""
    a = abs(x)
    far = a > 1.0 / _TAN_PI_8
    middle = a > _TAN_PI_8
    above = -1.0 if far else (a - 1.0 if middle else a)
    r = above / (a if far else (a + 1.0 if middle else 1.0))
    offset = _HALF_PI if far else (_QUARTER_PI if middle else 0.0)
    z = r * r
    value = offset + (r + r * z * horner(_ATAN[1:], z))
    return -value if x < 0.0 else value


@inlined
def atan2(y: float, x: float) -> float:
    """Angle of the point (x, y) in (-pi, pi]; 0 at the origin."""
    angle = atan(y / x)
    angle = angle + (PI if y >= 0.0 else -PI) if x < 0.0 else angle
    upright = _HALF_PI if y > 0.0 else (-_HALF_PI if y < 0.0 else 0.0)
    return angle if x > 0.0 or x < 0.0 else upright


@inlined
def acos(x: float) -> float:
    """Arccosine in [0, pi], for x in [-1, 1]."""
    return atan2(np.sqrt((1.0 - x) * (1.0 + x)), x)


@inlined
def asin(x: float) -> float:
    """Arcsine in [-pi/2, pi/2], for x in [-1, 1]."""
    return atan2(x, np.sqrt((1.0 - x) * (1.0 + x)))


@inlined
def smoothstep(t: float) -> float:
    """Zero below 0, 1 above 1, 3 t^2 - 2 t^3 between: level at both."""
    t = 0.0 if t < 0.0 else t
    t = 1.0 if t > 1.0 else t
    return t * t * (3.0 - 2.0 * t)


def smoothstep_array(t: ArrayLike) -> NDArray[np.float64]:
    """Smoothstep, elementwise."""
    t = np.clip(t, 0.0, 1.0)
    return np.asarray(t * t * (3.0 - 2.0 * t))


def _mapped(function: Callable[[float], float]) -> Callable[[ArrayLike], NDArray[np.float64]]:
    """Maps a scalar function over every element of an array: float64 of the same shape."""

    @kernel
    def loop(x: NDArray, out: NDArray) -> None:
        for i in range(x.size):
            out[i] = function(x[i])

    def mapped(x: ArrayLike) -> NDArray[np.float64]:
        values = np.ascontiguousarray(x, dtype=np.float64)
        out = np.empty_like(values)
        loop(values.reshape(-1), out.reshape(-1))
        return out

    return mapped


exp_array, log_array = _mapped(exp), _mapped(log)
sin_array, cos_array = _mapped(sin), _mapped(cos)
atan_array, acos_array, asin_array = _mapped(atan), _mapped(acos), _mapped(asin)
