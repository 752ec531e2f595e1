"""Keeps digests of arrays and bytes, so that each is hashed once in a compilation."""

from __future__ import annotations

import hashlib
import weakref
from typing import Any

import numpy as np
from numpy.typing import NDArray

#: Shorter ones are hashed each time: that is cheaper than to look them up.
LEAST_BYTES = 1024


def digest_of(data: bytes | memoryview) -> str:
    """BLAKE2b-256 of bytes, in hexadecimal: twice as fast as SHA-256 where no CPU helps."""
    return hashlib.blake2b(data, digest_size=32).hexdigest()


def order_of(array: NDArray[Any]) -> str:
    """Returns an array's memory order: "F" for column-major, "C" for all others."""
    return "F" if array.flags.f_contiguous and not array.flags.c_contiguous else "C"


def bytes_of(array: NDArray[Any]) -> memoryview:
    """An array's bytes in its order, copied only where there are gaps in it."""
    lying = array.T if order_of(array) == "F" else array
    return memoryview(np.ascontiguousarray(lying).reshape(-1).view(np.uint8))


class Digests:
    """Digests by identity: of what is still there, and of nothing else.

    Arrays are held weakly, so that what a step lets go of is freed. Their content must not change
    any more; ``changed`` finds those whose did.
    """

    def __init__(self, hold: bool = False) -> None:
        """Nothing is known.

        Args:
            hold: Holds arrays for good, so that ``changed`` misses none of them.
        """
        self._held: list[NDArray[Any]] | None = [] if hold else None
        self._arrays: dict[int, tuple[weakref.ref[NDArray[Any]], str]] = {}
        self._bytes: dict[int, tuple[bytes, str]] = {}

    def digest(self, value: NDArray[Any] | bytes) -> str:
        """The digest of an array's bytes in its order, or of bytes."""
        if isinstance(value, bytes):
            if id(value) in self._bytes:
                return self._bytes[id(value)][1]
            found = digest_of(value)
        else:
            held = self._arrays.get(id(value))
            if held is not None and held[0]() is value:
                return held[1]
            found = digest_of(bytes_of(value))
        self.learn(value, found)
        return found

    def learn(self, value: NDArray[Any] | bytes, digest: str) -> None:
        """Takes a digest that was computed, or checked, elsewhere."""
        if isinstance(value, bytes):
            if len(value) >= LEAST_BYTES:
                self._bytes[id(value)] = (value, digest)
        elif value.nbytes >= LEAST_BYTES:
            if self._held is not None:
                self._held.append(value)
            name, arrays = id(value), self._arrays
            arrays[name] = (weakref.ref(value, lambda _: arrays.pop(name, None)), digest)

    def changed(self) -> list[str]:
        """Arrays whose content is no longer what was hashed: "float64 (3, 4)" each."""
        found = []
        for reference, digest in list(self._arrays.values()):
            array = reference()
            if array is not None and digest_of(bytes_of(array)) != digest:
                found.append(f"{array.dtype} {array.shape}")
        return found
