"""Computes gradient noise after Perlin (2002), in two and three dimensions, and its fractal sums.

One octave has zero mean, is C2, and lies in [-1, 1]; 2-D octaves have a root mean square of about
0.3. Successive 2-D octaves are turned by the rational rotation (4/5, 3/5) against each other, so
that no lattice direction adds up over octaves.

Only + - * / and floor are used (hashes are integer): the same bits on every CPU and for any number
of threads.
"""

from __future__ import annotations

import numpy as np

from scenec.compiler.noise.lattice import hash3, subkey
from scenec.schemas.kernels import inlined, kernel

_DIRECTIONS = 64
#: The bits of a lattice point's hash that are its gradient's direction in 2-D.
DIRECTION_MASK = np.uint64(_DIRECTIONS - 1)
# Cosine and sine of (i + 1/2) 2 pi / 64, as ``elementary`` has them: to compute them when this is
# imported would compile its kernels.
GRADIENT_X = np.array(
    [
        0.9987954562051724, 0.989176509964781, 0.970031253194544, 0.9415440651830208,
        0.9039892931234433, 0.8577286100002721, 0.8032075314806449, 0.7409511253549592,
        0.6715589548470184, 0.5956993044924335, 0.5141027441932218, 0.4275550934302822,
        0.33688985339222005, 0.24298017990326398, 0.14673047445536175, 0.04906767432741813,
        -0.04906767432741801, -0.14673047445536164, -0.24298017990326387, -0.33688985339221994,
        -0.42755509343028186, -0.5141027441932216, -0.5956993044924332, -0.6715589548470184,
        -0.7409511253549589, -0.8032075314806448, -0.8577286100002721, -0.9039892931234433,
        -0.9415440651830207, -0.970031253194544, -0.989176509964781, -0.9987954562051724,
        -0.9987954562051724, -0.989176509964781, -0.970031253194544, -0.9415440651830208,
        -0.9039892931234434, -0.8577286100002721, -0.8032075314806449, -0.740951125354959,
        -0.6715589548470187, -0.5956993044924332, -0.5141027441932219, -0.4275550934302825,
        -0.33688985339221994, -0.24298017990326412, -0.14673047445536233, -0.04906767432741803,
        0.04906767432741767, 0.14673047445536194, 0.24298017990326376, 0.3368898533922196,
        0.4275550934302822, 0.5141027441932214, 0.5956993044924328, 0.6715589548470183,
        0.7409511253549588, 0.803207531480645, 0.857728610000272, 0.9039892931234431,
        0.9415440651830208, 0.970031253194544, 0.9891765099647809, 0.9987954562051724,
    ]
)  # fmt: skip
GRADIENT_Y = np.array(
    [
        0.049067674327418015, 0.14673047445536175, 0.24298017990326387, 0.33688985339222005,
        0.4275550934302821, 0.5141027441932217, 0.5956993044924334, 0.6715589548470183,
        0.740951125354959, 0.8032075314806448, 0.8577286100002721, 0.9039892931234433,
        0.9415440651830208, 0.970031253194544, 0.989176509964781, 0.9987954562051724,
        0.9987954562051724, 0.989176509964781, 0.970031253194544, 0.9415440651830208,
        0.9039892931234434, 0.8577286100002721, 0.8032075314806449, 0.740951125354959,
        0.6715589548470186, 0.5956993044924335, 0.5141027441932218, 0.42755509343028203,
        0.3368898533922203, 0.24298017990326404, 0.1467304744553618, 0.04906767432741797,
        -0.049067674327417724, -0.14673047445536158, -0.24298017990326382, -0.3368898533922201,
        -0.4275550934302818, -0.5141027441932216, -0.5956993044924332, -0.6715589548470184,
        -0.7409511253549588, -0.803207531480645, -0.857728610000272, -0.9039892931234431,
        -0.9415440651830208, -0.970031253194544, -0.9891765099647809, -0.9987954562051724,
        -0.9987954562051724, -0.9891765099647809, -0.970031253194544, -0.9415440651830209,
        -0.9039892931234433, -0.8577286100002722, -0.8032075314806453, -0.7409511253549592,
        -0.6715589548470187, -0.5956993044924332, -0.5141027441932219, -0.42755509343028253,
        -0.33688985339222, -0.24298017990326418, -0.1467304744553624, -0.04906767432741809,
    ]
)  # fmt: skip
# With unit gradients the largest value is sqrt(2)/2 (all four gradients point at the cell center).
_NORMALIZE_2D = np.sqrt(2.0)
# Twelve edge directions of a cube in 3-D, as Perlin chose them, doubled up to sixteen.
_G3 = np.array(
    [
        [1, 1, 0], [-1, 1, 0], [1, -1, 0], [-1, -1, 0],
        [1, 0, 1], [-1, 0, 1], [1, 0, -1], [-1, 0, -1],
        [0, 1, 1], [0, -1, 1], [0, 1, -1], [0, -1, -1],
        [1, 1, 0], [-1, 1, 0], [0, -1, 1], [0, -1, -1],
    ],
    dtype=np.float64,
)  # fmt: skip


@inlined
def _fade(t: float) -> float:
    return t * t * t * (t * (t * 6.0 - 15.0) + 10.0)


@inlined
def perlin2_of_directions(g00: int, g10: int, g01: int, g11: int, u: float, v: float) -> float:
    """Value at (u, v) in [0, 1]^2 of a cell, from the gradient directions of its corners."""
    n00 = GRADIENT_X[g00] * u + GRADIENT_Y[g00] * v
    n10 = GRADIENT_X[g10] * (u - 1.0) + GRADIENT_Y[g10] * v
    n01 = GRADIENT_X[g01] * u + GRADIENT_Y[g01] * (v - 1.0)
    n11 = GRADIENT_X[g11] * (u - 1.0) + GRADIENT_Y[g11] * (v - 1.0)
    a = _fade(u)
    bottom = n00 + a * (n10 - n00)
    top = n01 + a * (n11 - n01)
    return (bottom + _fade(v) * (top - bottom)) * _NORMALIZE_2D


@kernel
def perlin3(key: np.uint64, x: float, y: float, z: float) -> float:
    """Value of one octave at (x, y, z), in lattice units, in [-1, 1]."""
    fi = np.floor(x)
    fj = np.floor(y)
    fk = np.floor(z)
    i = np.int64(fi)
    j = np.int64(fj)
    k = np.int64(fk)
    u = x - fi
    v = y - fj
    w = z - fk
    a = _fade(u)
    b = _fade(v)
    c = _fade(w)
    planes = (0.0, 0.0)
    for dk in range(2):
        rows = (0.0, 0.0)
        for dj in range(2):
            h0 = hash3(key, i, j + dj, k + dk) & np.uint64(15)
            h1 = hash3(key, i + 1, j + dj, k + dk) & np.uint64(15)
            n0 = _G3[h0, 0] * u + _G3[h0, 1] * (v - dj) + _G3[h0, 2] * (w - dk)
            n1 = _G3[h1, 0] * (u - 1.0) + _G3[h1, 1] * (v - dj) + _G3[h1, 2] * (w - dk)
            n = n0 + a * (n1 - n0)
            rows = (n, rows[1]) if dj == 0 else (rows[0], n)
        plane = rows[0] + b * (rows[1] - rows[0])
        planes = (plane, planes[1]) if dk == 0 else (planes[0], plane)
    # The extreme value of this gradient set is about 1.04 (Perlin 2002 leaves it unscaled).
    return (planes[0] + c * (planes[1] - planes[0])) * 0.96


@kernel
def fbm3(key: np.uint64, x: float, y: float, z: float, octaves: int, gain: float) -> float:
    """Sum of ``octaves`` octaves of 3-D noise, lacunarity 2, amplitudes gain**o."""
    total = 0.0
    amplitude = 1.0
    for octave in range(octaves):
        total += amplitude * perlin3(subkey(key, octave), x, y, z)
        amplitude *= gain
        # Offset as well as scaled: octaves must not share the lattice point at the origin.
        x = 2.0 * x + 17.31
        y = 2.0 * y + 5.77
        z = 2.0 * z + 11.13
    return total
