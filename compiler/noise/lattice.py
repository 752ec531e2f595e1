"""Hashes integer lattice points: the only source of variety in the noises."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from scenec.schemas.intrinsics import bits_of
from scenec.schemas.kernels import inlined, kernel

_C1 = np.uint64(0x9E3779B97F4A7C15)
_C2 = np.uint64(0xBF58476D1CE4E5B9)
_C3 = np.uint64(0x94D049BB133111EB)
_S11 = np.uint64(11)
_S27 = np.uint64(27)
_S30 = np.uint64(30)
_S31 = np.uint64(31)

# Added to a whole number below 2**51, this leaves the number in the lowest bits.
_SHIFT = 1.5 * 2.0**52
_BITS = np.float64(_SHIFT).view(np.uint64)


@inlined
def to_integer(x: float) -> np.uint64:
    """A whole number below 2**51, modulo 2**64: a conversion that has lanes on every CPU."""
    return np.uint64(bits_of(x + _SHIFT)) - _BITS


@inlined
def mix(x: np.uint64) -> np.uint64:
    """Finalizer of SplitMix64 (Steele, Lea and Flood 2014): a bijection that avalanches."""
    x = np.uint64(x) + _C1
    x = (x ^ (x >> _S30)) * _C2
    x = (x ^ (x >> _S27)) * _C3
    return x ^ (x >> _S31)


@kernel
def subkey(key: np.uint64, index: int) -> np.uint64:
    """Key of part ``index`` (an octave, a component) of the thing that ``key`` stands for."""
    return mix(np.uint64(key) ^ mix(np.uint64(index)))


@kernel
def subkeys(key: np.uint64, n: int) -> NDArray[np.uint64]:
    """Keys of the parts 0 to n - 1: uint64 [n]."""
    out = np.empty(n, np.uint64)
    for index in range(n):
        out[index] = subkey(key, index)
    return out


@inlined
def hash2(key: np.uint64, i: int, j: int) -> np.uint64:
    """Hash of the lattice point (i, j)."""
    return mix(mix(key ^ np.uint64(i)) ^ np.uint64(j))


@inlined
def hash3(key: np.uint64, i: int, j: int, k: int) -> np.uint64:
    """Hash of the lattice point (i, j, k)."""
    return mix(mix(mix(key ^ np.uint64(i)) ^ np.uint64(j)) ^ np.uint64(k))


@inlined
def unit(bits: np.uint64) -> float:
    """The highest 53 bits of a hash as a number in [0, 1)."""
    return np.float64(bits >> _S11) * 2.0**-53
