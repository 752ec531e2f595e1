"""Flow and disparity as 16-bit PNG, as the development kits of KITTI's benchmarks have them.

Flow (``io_flow.h``): red and green are 64 u + 2^15 and 64 v + 2^15, blue is 1 where there is any;
so it is off by 1/128 px at most, and reaches from -512 to just below 512 px. Disparity
(``io_disparity.h``): 256 d, at least 1, and 0 where there is none; to just below 256 px.
"""

from __future__ import annotations

import struct
import zlib
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenec.schemas.files import atomic

_LARGEST = 65535
#: Pixels: what rounding makes of the disparity of what is infinitely far away.
_ROUNDING = 1e-6


def encode_flow(
    flow: NDArray[np.floating], valid: NDArray[np.bool_] | None = None
) -> tuple[NDArray[np.uint16], int]:
    """Flow in KITTI's code.

    Args:
        flow: Right and down, pixels, [h, w, 2]; NaN where there is none.
        valid: Pixels that may have any; None: all.

    Returns:
        uint16 [h, w, 3], and how many pixels go farther than the code reaches: those have none.
    """
    known = np.isfinite(flow).all(axis=2)
    known = known if valid is None else known & valid
    steps = np.rint(64.0 * np.where(known[..., None], flow, 0.0).astype(np.float64)) + 2.0**15
    inside = ((steps >= 0.0) & (steps <= _LARGEST)).all(axis=2)
    held = known & inside
    channels = np.concatenate([steps, np.ones((*held.shape, 1))], axis=2)
    coded = np.where(held[..., None], channels, 0.0).astype(np.uint16)
    return coded, int((known & ~inside).sum())


def encode_disparity(
    disparity: NDArray[np.floating], valid: NDArray[np.bool_] | None = None
) -> tuple[NDArray[np.uint16], int]:
    """Disparity in KITTI's code.

    Args:
        disparity: Pixels to the left in the right camera's picture, [h, w]; NaN where none.
        valid: Pixels that may have any; None: all.

    Returns:
        uint16 [h, w], and how many pixels have a disparity that the code does not hold.
    """
    known = np.isfinite(disparity)
    known = known if valid is None else known & valid
    steps = np.rint(256.0 * np.where(known, disparity, 0.0).astype(np.float64))
    inside = ~(disparity < -_ROUNDING) & (steps <= _LARGEST)
    coded = np.where(known & inside, np.maximum(steps, 1.0), 0.0).astype(np.uint16)
    return coded, int((known & ~inside).sum())


def write_rgb16(path: Path, pixels: NDArray[np.uint16]) -> None:
    """Write uint16 [h, w, 3] as PNG (Pillow cannot), by atomic rename.

    Raises:
        OutputError: The file cannot be written.
    """
    height, width = pixels.shape[:2]
    rows = np.ascontiguousarray(pixels, ">u2").view(np.uint8).reshape(height, -1)
    above = np.zeros_like(rows)
    above[1:] = rows[:-1]
    # Filter 2, the difference to the row above, a byte before each row.
    lines = np.concatenate([np.full((height, 1), 2, np.uint8), rows - above], axis=1)
    with atomic(path) as temporary:
        temporary.write_bytes(
            b"\x89PNG\r\n\x1a\n"
            + _chunk(b"IHDR", struct.pack(">IIBBBBB", width, height, 16, 2, 0, 0, 0))
            + _chunk(b"IDAT", zlib.compress(lines.tobytes(), 6))
            + _chunk(b"IEND", b"")
        )


def _chunk(kind: bytes, data: Any) -> bytes:
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
