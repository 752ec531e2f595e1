"""Computes one octave of Perlin noise at one point: the oracle of what computes many."""

from __future__ import annotations

import numpy as np

from scenec.compiler.noise.lattice import hash2
from scenec.compiler.noise.perlin import DIRECTION_MASK, perlin2_of_directions
from scenec.schemas.kernels import kernel


@kernel
def perlin2(key: np.uint64, x: float, y: float) -> float:
    """Value of one octave at (x, y), in lattice units; shape-free scalar, in [-1, 1]."""
    fi = np.floor(x)
    fj = np.floor(y)
    i = np.int64(fi)
    j = np.int64(fj)
    u = x - fi
    v = y - fj
    return perlin2_of_directions(
        hash2(key, i, j) & DIRECTION_MASK,
        hash2(key, i + 1, j) & DIRECTION_MASK,
        hash2(key, i, j + 1) & DIRECTION_MASK,
        hash2(key, i + 1, j + 1) & DIRECTION_MASK,
        u,
        v,
    )
