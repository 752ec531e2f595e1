"""Keys randomness by name: the only place in the compiler where a random generator lives.

Each stream is a function of (seed, batch, sample, the path of the thing it is drawn for), so adding
a thing to a cfg, or asking in another order, changes no other draw. A batch that is drawn again
because it could not be built has streams of its own for each attempt.
"""

from __future__ import annotations

import hashlib
import operator
import struct
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scenec.schemas.errors import ScenecError

_UNIFORMS = b"uniforms"
_KEY = b"key"


@dataclass(frozen=True)
class Streams:
    """The streams of one batch.

    Attributes:
        seed: 0 <= seed < 2**64; 0 is a seed like any other.
        attempt: How often the batch was drawn before.
    """

    seed: int
    batch: int
    attempt: int = 0

    def __post_init__(self) -> None:
        """Checks the ranges.

        Raises:
            ScenecError: The seed is not in [0, 2**64).
            ValueError: The batch is negative.
        """
        if not 0 <= operator.index(self.seed) < 2**64:
            raise ScenecError(f"seed {self.seed}: expected a whole number from 0 to {2**64 - 1}")
        if operator.index(self.batch) < 0:
            raise ValueError(f"batch {self.batch} is negative")

    def uniforms(self, path: str, n: int, sample: int | None = None) -> NDArray[np.float64]:
        """The first ``n`` numbers of a stream, uniform in [0, 1), multiples of 2**-53.

        Prefix-stable: a larger ``n`` gives the same numbers and more of them.

        Args:
            path: What it is drawn for, such as "objects/rocks/size_m".
            sample: Index of the sample, or None for what is drawn once a batch.

        Returns:
            float64 [n].
        """
        generator = np.random.Philox(key=self._digest(_UNIFORMS, path, sample, 16))
        bits = generator.random_raw(n)
        return (bits >> np.uint64(11)).astype(np.float64) * 2.0**-53

    def key(self, path: str, sample: int | None = None) -> int:
        """A 64-bit key for hash noise, independent of ``uniforms`` of the same path."""
        return self._digest(_KEY, path, sample, 8)

    def _digest(self, purpose: bytes, path: str, sample: int | None, size: int) -> int:
        if sample is not None and operator.index(sample) < 0:
            raise ValueError(f"sample {sample} is negative")
        # Fixed-width fields first and the path last: no two tuples share an encoding.
        numbers = struct.pack(
            "<QQ?Q",
            operator.index(self.seed),
            operator.index(self.batch),
            sample is not None,
            0 if sample is None else operator.index(sample),
        )
        message = numbers + path.encode("utf-8")
        # No salt and a salt of zeros are the same to BLAKE2: the first attempt's streams.
        salt = struct.pack("<Q", self.attempt)
        person = b"scenec/" + purpose
        digest = hashlib.blake2b(message, digest_size=size, person=person, salt=salt).digest()
        return int.from_bytes(digest, "little")
