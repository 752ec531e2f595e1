"""Owen-scrambled Sobol' points as a sampler of Mitsuba. Import it once the variant is set.

Mitsuba's own structured samplers are biased in indirect light, since their dimensions depend on
each other (stratified: -2 % in a white box). Here each call gives the first one or two dimensions
of the Sobol' sequence anew: their order shuffled and each coordinate scrambled, both by nested
uniform scrambling (Owen 1995), keyed by a hash of seed, pixel and call. So each point alone is
uniform, calls do not know of each other, and of each call every 2**k samples of a pixel, from a
multiple of 2**k on, have one in each elementary interval: [i / 2**a, (i + 1) / 2**a) x [j / 2**b,
(j + 1) / 2**b), a + b = k.

After Burley 2020, "Practical Hash-based Owen Scrambling", with Vegdahl's constants for the hash of
Laine and Karras 2011.
"""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi

#: 2**32 over the golden ratio, made odd: no call's key comes twice.
_STEP = 0x9E3779B9


class Sobol(mi.Sampler):
    """The numbers of a wavefront of samples, what Mitsuba's integrators ask of them.

    Args:
        seed: Of the picture, 32 bits, ``mi.UInt32``.
        pixel: Of each sample; its own in the picture, ``mi.UInt32``.
        index: Of each sample in its pixel's sequence, ``mi.UInt32``.
    """

    def __init__(self, seed: Any, pixel: Any, index: Any) -> None:
        super().__init__(mi.Properties())
        # State of loops: Mitsuba finds it by itself.
        self.key = _hash(_hash(pixel) + seed)
        self.reversed_index = dr.brev(index)

    def next_1d(self, active: Any = True) -> Any:
        """A number in [0, 1) for each sample."""
        order, x = self._keys()
        return _unit(_scramble(dr.brev(_scramble(self.reversed_index, order)), x))

    def next_2d(self, active: Any = True) -> Any:
        """A point in the unit square for each sample."""
        order, x = self._keys()
        index = dr.brev(_scramble(self.reversed_index, order))
        return mi.Point2f(
            _unit(_scramble(index, x)), _unit(_scramble(_second(index), _hash(x + _STEP)))
        )

    def _keys(self) -> tuple[Any, Any]:
        self.key = self.key + _STEP
        order = _hash(self.key)
        return order, _hash(order + _STEP)

    def schedule_state(self) -> None:
        """Marks the state for evaluation."""
        dr.schedule(self.key, self.reversed_index)


def _hash(x: Any) -> Any:
    """A bijection of 32 bits in which each depends on all ("lowbias32", Wellons 2018)."""
    x = (x ^ (x >> 16)) * 0x21F0AAAD
    x = (x ^ (x >> 15)) * 0xD35A2D97
    return x ^ (x >> 15)


def _scramble(x: Any, key: Any) -> Any:
    """Nested uniform scrambling of a fraction's bits, the first of them lowest.

    Whether a bit flips depends on the key and on the bits below it.
    """
    x = x ^ (x * 0x3D20ADEA)
    x = (x + key) * ((key >> 16) | 1)
    x = x ^ (x * 0x05526C56)
    return x ^ (x * 0x53A22864)


def _second(x: Any) -> Any:
    """The second dimension of the Sobol' point of an index, its first bit lowest.

    The product with Pascal's matrix modulo 2: bit i is the sum of the bits j that have all of i's
    ones. The first dimension is the index itself.
    """
    for shift, mask in (
        (16, 0xFFFF0000), (8, 0xFF00FF00), (4, 0xF0F0F0F0), (2, 0xCCCCCCCC), (1, 0xAAAAAAAA),
    ):  # fmt: skip
        x = x ^ ((x & mask) >> shift)
    return x


def _unit(x: Any) -> Any:
    """The fraction whose bits these are, the first lowest: 24 of them, so that it is below 1."""
    return mi.Float(dr.brev(x) >> 8) * 2.0**-24
