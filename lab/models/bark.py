"""Pictures of bark, which tile: gray factors of a base color, from noises on lattices.

Only sums and products enter, so the pictures are the same on every machine.
"""

from __future__ import annotations

import io
import zlib
from functools import cache

import numpy as np
from PIL import Image

from scenec.lab.models.surfaces import Floats

_WIDE, _HIGH = 96, 192


def _noise(name: str, columns: int, rows: int) -> Floats:
    """Smooth noise from 0 to 1 with so many cells across and down, periodic: [high, wide]."""
    random = np.random.Generator(np.random.Philox(key=zlib.crc32(name.encode())))
    lattice = random.random((rows, columns))

    def cells(count: int, size: int) -> tuple[np.ndarray, np.ndarray]:
        x = (np.arange(size) + 0.5) * count / size
        i = x.astype(np.int64)
        f = x - i
        return i % count, f * f * (3.0 - 2.0 * f)

    (i, u), (j, v) = cells(columns, _WIDE), cells(rows, _HIGH)
    upper = lattice[j][:, i] * (1 - u) + lattice[j][:, (i + 1) % columns] * u
    below = (j + 1) % rows
    lower = lattice[below][:, i] * (1 - u) + lattice[below][:, (i + 1) % columns] * u
    return upper * (1 - v[:, None]) + lower * v[:, None]


def _png(values: Floats) -> bytes:
    """A gray picture of values from 0 to 1, in 32 steps: steps pack well."""
    stream = io.BytesIO()
    gray = (np.round(np.clip(values, 0.0, 1.0) * 31.0) * (255.0 / 31.0)).astype(np.uint8)
    Image.fromarray(gray).save(stream, "PNG", optimize=True)
    return stream.getvalue()


@cache
def furrowed(name: str, columns: int, rows: int, depth: float = 0.62) -> bytes:
    """Ridges along the trunk that part and meet, as of an oak; few cells make plates."""
    ridge = 1.0 - abs(2.0 * _noise(name, columns, rows) - 1.0)
    second = 1.0 - abs(2.0 * _noise(name + "+", 2 * columns, 2 * rows) - 1.0)
    furrow = np.clip(1.6 * (0.65 * ridge * ridge + 0.35 * second), 0.0, 1.0)
    fine = _noise(name + "fine", 48, 64)
    return _png(1.0 - depth * furrow - 0.22 * (fine - 0.3))


@cache
def birch() -> bytes:
    """White bark with short level dashes and some dark rhombs."""
    dashes = _noise("dashes", 7, 70) > 0.80
    thin = (_noise("thin", 12, 110) > 0.84) & (_noise("patch", 3, 6) > 0.45)
    scars = _noise("scars", 4, 9) * 0.75 + 0.25 * _noise("rough", 24, 40) > 0.77
    tone = 0.97 - 0.16 * _noise("tone", 5, 14) - 0.08 * _noise("grain", 32, 20)
    return _png(np.where(scars, 0.30, np.where(dashes | thin, 0.42, tone)))


@cache
def scaly(name: str) -> bytes:
    """Thin scales, as of a spruce or of a pine's upper trunk."""
    scales = abs(2.0 * _noise(name, 14, 22) - 1.0) * 0.6 + 0.4 * _noise(name + "fine", 40, 60)
    return _png(1.0 - 0.5 * scales)
