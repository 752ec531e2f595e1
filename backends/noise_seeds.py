"""Derives the seeds of pictures' noise: of frames, and of the parts that a frame is drawn in.

A frame's seed is one of 32 bits. What is drawn of it in several pictures (rounds, halves, shares of
bounces, sub-frames, views through a lens, tiles) gives each a seed of its own.
"""

from __future__ import annotations

import hashlib

import numpy as np

_METERING = 0x5CE9EC


def frame_seed(noise_seed: int, batch: str, camera: str, sample: int) -> int:
    """Returns the seed of one frame, 32 bits: no two frames share their noise."""
    return _digest(f"{noise_seed}/{batch}/{camera}/{sample}", 4)


def round_seed(seed: int, number: int) -> int:
    """Returns the seed of one adaptive round of a frame, 32 bits."""
    return _digest(f"{seed}/round/{number}", 4)


def half_seed(seed: int, half: int) -> int:
    """Returns the seed of one half, 32 bits; 2 is a denoiser's guides or halves of more shares."""
    return _digest(f"{seed}/{half}", 4)


def sub_frame_seed(seed: int, half: int, index: int) -> int:
    """Returns the seed of one sub-frame of a half, 32 bits."""
    return _digest(f"{seed}/{half}/{index}", 8) >> 32


def sub_frame_number(seed: int, half: int, name: str) -> float:
    """Returns a number in [0, 1) for each name: where a half's sub-frames are in time or space."""
    return (_digest(f"{seed}/{half}/{name}", 8) >> 11) * 2.0**-53


def view_seed(seed: int, number: int) -> int:
    """Returns the seed of one view of a lens, 32 bits; the odd step is none of ``tile_seed``'s."""
    return (seed + 0x85EBCA6B * number) & 0xFFFFFFFF


def tile_seed(seed: int, number: int) -> int:
    """Returns the seed of one tile, 32 bits: steps of an odd number near 2**32 / golden ratio."""
    return (seed + 0x9E3779B1 * number) & 0xFFFFFFFF


def metering_places(sample: int) -> np.random.Generator:
    """Returns the generator of the places in a picture where its exposure is metered."""
    return np.random.Generator(np.random.Philox(key=(_METERING << 64) + sample))


def metering_paths(sample: int) -> np.random.Generator:
    """Returns the generator of the metered paths' directions."""
    return np.random.Generator(np.random.Philox(key=_METERING + sample))


def _digest(text: str, size: int) -> int:
    return int.from_bytes(hashlib.blake2b(text.encode(), digest_size=size).digest(), "little")
