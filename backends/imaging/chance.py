"""Random numbers of pictures: counted, not drawn in an order, and the same on every CPU.

Philox4x32-10 (Salmon et al. 2011, SC11) makes four 32-bit words of a key and a counter, and a
counter names a pixel: what a pixel gets depends on no other, nor on threads. Words become numbers
by inverting distributions, so that the same words on nearly the same light, as of two renderers,
make nearly the same noise. All of it is + - * /, sqrt and integers, which IEEE 754 rounds one way:
no libm, whose last bit depends on the CPU.
"""

from __future__ import annotations

import math
from functools import cache

import numpy as np
from numpy.typing import NDArray

from scenec.schemas.kernels import kernel

_M0, _M1 = np.uint64(0xD2511F53), np.uint64(0xCD9E8D57)
_W0, _W1 = np.uint64(0x9E3779B9), np.uint64(0xBB67AE85)
_LOW, _HALF = np.uint64(0xFFFFFFFF), np.uint64(32)
_LN2 = float.fromhex("0x1.62e42fefa39efp-1")
_SQRT_HALF = float.fromhex("0x1.6a09e667f3bcdp-1")
_TO_UNIT = 2.0**-32
_ODD = 1.0 / np.arange(1.0, 21.0, 2.0)

#: Poisson numbers of smaller means are inverted exactly, of larger ones nearly (``poissons``).
EXACT_BELOW = 10.0
_INVERSE = 1.0 / np.maximum(np.arange(128), 1)


@kernel
def _philox_round(c0, c1, c2, c3, k0, k1):  # type: ignore[no-untyped-def]
    p0, p1 = _M0 * c0, _M1 * c2
    return (
        (p1 >> _HALF) ^ c1 ^ k0, p1 & _LOW, (p0 >> _HALF) ^ c3 ^ k1, p0 & _LOW,
        (k0 + _W0) & _LOW, (k1 + _W1) & _LOW,
    )  # fmt: skip


@kernel
def philox(key, c0, c1, c2, c3):  # type: ignore[no-untyped-def]
    """Four 32-bit words, as uint64, of a 64-bit key and a counter of four 32-bit words (uint64)."""
    k0, k1 = key & _LOW, key >> _HALF
    for _ in range(10):
        c0, c1, c2, c3, k0, k1 = _philox_round(c0, c1, c2, c3, k0, k1)
    return c0, c1, c2, c3


@kernel
def philoxes(key, first, c1, c2, c3, words):  # type: ignore[no-untyped-def]
    """``philox`` of counters whose first words are one after the other, faster.

    Args:
        key, c1, c2, c3: As for ``philox``.
        first: The first counter's first word; uint64, below 2**32.
        words: Receives them, uint64 [4, n].
    """
    for i in range(words.shape[1]):
        # Written out: only then do compilers make wide instructions of the loop around it.
        w = first + np.uint64(i), c1, c2, c3, key & _LOW, key >> _HALF
        w = _philox_round(w[0] & _LOW, w[1] & _LOW, w[2] & _LOW, w[3] & _LOW, w[4], w[5])
        w = _philox_round(w[0], w[1], w[2], w[3], w[4], w[5])
        w = _philox_round(w[0], w[1], w[2], w[3], w[4], w[5])
        w = _philox_round(w[0], w[1], w[2], w[3], w[4], w[5])
        w = _philox_round(w[0], w[1], w[2], w[3], w[4], w[5])
        w = _philox_round(w[0], w[1], w[2], w[3], w[4], w[5])
        w = _philox_round(w[0], w[1], w[2], w[3], w[4], w[5])
        w = _philox_round(w[0], w[1], w[2], w[3], w[4], w[5])
        w = _philox_round(w[0], w[1], w[2], w[3], w[4], w[5])
        w = _philox_round(w[0], w[1], w[2], w[3], w[4], w[5])
        words[0, i], words[1, i], words[2, i], words[3, i] = w[0], w[1], w[2], w[3]


@kernel
def unit(word: int) -> float:
    """A 32-bit word as a number in (0, 1): the middle of one of 2**32 intervals."""
    return (np.float64(word) + 0.5) * _TO_UNIT


@kernel
def log(x: float) -> float:
    """Natural logarithm of a positive number, to 1e-15 of 1 + abs(log x)."""
    m, e = math.frexp(x)
    if m < _SQRT_HALF:
        m, e = 2.0 * m, e - 1
    s = (m - 1.0) / (m + 1.0)
    t = s * s
    rest = _ODD[9]
    for i in range(8, -1, -1):
        rest = rest * t + _ODD[i]
    return e * _LN2 + 2.0 * s * rest


@kernel
def quantile(u: float) -> float:
    """The number that a standard normal one is below with probability u, to 1e-7.

    Wichura 1988 (Applied Statistics 37, algorithm AS 241), PPND7. Of 32-bit words it reaches 6.3.
    """
    q = u - 0.5
    if abs(q) <= 0.425:
        r = 0.180625 - q * q
        above = ((59.109374720 * r + 159.29113202) * r + 50.434271938) * r + 3.3871327179
        below = ((67.187563600 * r + 78.757757664) * r + 17.895169469) * r + 1.0
        return q * above / below
    r = math.sqrt(-log(min(u, 1.0 - u)))
    if r <= 5.0:
        r -= 1.6
        z = ((0.17023821103 * r + 1.3067284816) * r + 2.7568153900) * r + 1.4234372777
        z /= (0.12021132975 * r + 0.73700164250) * r + 1.0
    else:
        r -= 5.0
        z = ((0.017337203997 * r + 0.42868294337) * r + 3.0812263860) * r + 6.6579051150
        z /= (0.012258202635 * r + 0.24197894225) * r + 1.0
    return z if q > 0.0 else -z


@kernel
def _quantiles(count: int) -> NDArray[np.float64]:
    out = np.empty(count + 1)
    for i in range(count + 1):
        out[i] = quantile(max(min(i / count, 1.0 - _TO_UNIT), _TO_UNIT))
    return out


@cache
def quantiles() -> NDArray[np.float64]:
    """The table that ``normal`` looks into: quantiles of 4096 equal steps, float64 [4097]."""
    return _quantiles(4096)


@kernel
def normal(word: int, table: NDArray[np.float64]) -> float:
    """The standard normal number of a 32-bit word.

    Between the steps of a table it is linear, off by less than 1.5e-4; in the outermost 16 steps of
    either side it is ``quantile``.

    Args:
        word: As ``philox`` makes them.
        table: ``quantiles()``.
    """
    step = np.int64(word) >> 20
    if step < 16 or step >= 4080:
        return quantile(unit(word))
    low = table[step]
    return low + (table[step + 1] - low) * ((np.int64(word) & 0xFFFFF) + 0.5) * 2.0**-20


@kernel
def normals(words, table, out):  # type: ignore[no-untyped-def]
    """``normal`` of many words: the same numbers, faster."""
    for i in range(len(words)):
        word = np.int64(words[i])
        step = min(max(word >> 20, 16), 4079)
        low = table[step]
        high = table[step + 1]  # type: ignore[operator]
        out[i] = low + (high - low) * ((word & 0xFFFFF) + 0.5) * 2.0**-20
    for i in range(len(words)):
        step = np.int64(words[i]) >> 20
        if step < 16 or step >= 4080:
            out[i] = quantile(unit(words[i]))


@kernel
def poissons(means, words, table):  # type: ignore[no-untyped-def]
    """Poisson numbers of means, in their place, that belong to 32-bit words.

    Below ``EXACT_BELOW`` the cumulative sum is inverted (to 2**-32). From there on it is the
    rounded Cornish-Fisher expansion of the quantile, mean + s z + (z^2 - 1)/6 + (z - z^3)/(72 s)
    with s^2 = mean - 1/12, for what rounding adds. Its distribution function is off by at most
    3e-4 at a mean of 10 and 1e-5 at 100; mean and variance by less than 2e-5 of themselves.

    Args:
        means: 0 or more, float64 [n].
        words: As ``philox`` makes them, [n].
        table: ``quantiles()``.
    """
    z = np.empty(len(means))
    normals(words, table, z)
    for i in range(len(means)):
        z[i] = _many(max(means[i], EXACT_BELOW), z[i])
    for i in range(len(means)):
        means[i] = _few(means[i], unit(words[i])) if means[i] < EXACT_BELOW else z[i]


@kernel
def _many(mean: float, z: float) -> float:
    s = math.sqrt(mean - 1.0 / 12.0)
    z2 = z * z
    n = mean + s * z + (z2 - 1.0) * (1.0 / 6.0) + (z - z2 * z) * (1.0 / 72.0) / s
    return max(np.floor(n + 0.5), 0.0)


@kernel
def _few(mean: float, u: float) -> float:
    # exp(-mean), by its series at a sixteenth of it, which is at most 0.625.
    t = -0.0625 * mean
    p = 1.0
    for i in range(12, 0, -1):
        p = 1.0 + p * t * _INVERSE[i]
    p *= p
    p *= p
    p *= p
    p *= p
    total, k = p, 0
    while u > total and k < len(_INVERSE) - 1:
        k += 1
        p *= mean * _INVERSE[k]
        total += p
    return float(k)
