"""Passes as the page stores them: ids exact, the rest with a stated error.

A stored picture has at most as many pixels as the frame. Where it has fewer, each stored pixel is
*one* pixel of the frame: column floor((2 x + 1) W / (2 w)) of stored column x, rows alike. Nothing
is blended but pictures. All but those are zlib streams, which browsers can unpack themselves:

``ids``   n ids (uint32, little-endian), then one index into them a pixel, of 1, 2 or 4 bytes
``steps`` codes of 16 bits: each row as zigzag differences to the plane through its left and upper
          neighbors, low bytes first, then high ones. 0: no hit; ``top``: not a number; others:
          near (far / near)^((code - 1) / (top - 2)), or evenly from near to far if ``even``
``turns`` normals, octahedral (Cigolle et al. 2014), two planes of bytes, differences to the left
          neighbor; (0, 0): none
"""

from __future__ import annotations

import base64
import io
import math
import zlib
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenec.schemas.codec import JsonObject

_ID_EFFORT = 9
_STEP_EFFORT = 6
#: Widest picture that a JPEG holds: libjpeg's JPEG_MAX_DIMENSION.
WIDEST = 65_500
#: What a normal can be off by, degrees; a test measures 0.95.
NORMAL_ERROR_DEG = 1.0


@dataclass(frozen=True)
class Fineness:
    """Sets the resolution and quality at which the page stores pictures.

    Attributes:
        side: Most pixels along the longer side; None: as many as the frame has, if a JPEG holds
            them.
        depth_bits: Of a depth's code, at most 16.
        quality: Of the JPEG of pictures.
    """

    side: int | None = None
    depth_bits: int = 16
    quality: int = 88

    def size(self, width: int, height: int) -> tuple[int, int]:
        """Width and height of the stored picture of a frame."""
        longer = max(width, height)
        side = WIDEST if self.side is None else min(self.side, WIDEST)
        if longer <= side:
            return width, height
        return max(1, width * side // longer), max(1, height * side // longer)


@dataclass(frozen=True)
class Layer:
    """A pass as it is stored.

    Attributes:
        facts: How to read it: ``name``, ``code``, and what the code needs.
        data: The bytes.
    """

    facts: JsonObject
    data: bytes

    def text(self) -> bytes:
        """The bytes in base64."""
        return base64.b64encode(self.data)


def stored_columns(size: int, stored: int) -> NDArray[np.int64]:
    """Returns the column (or row) of a frame that each stored one shows: int64 [stored]."""
    return (2 * np.arange(stored, dtype=np.int64) + 1) * size // (2 * stored)


def thinned(array: NDArray[Any], size: tuple[int, int]) -> NDArray[Any]:
    """A pass [h, w, ...] at a stored (width, height): every pixel is one of the frame's."""
    height, width = array.shape[:2]
    if (width, height) == size:
        return array
    return array[stored_columns(height, size[1])][:, stored_columns(width, size[0])]


def store_picture(
    name: str, pixels: NDArray[np.uint8], size: tuple[int, int], quality: int
) -> Layer:
    """A picture, uint8 [h, w, 3], as a JPEG of this (width, height)."""
    from PIL import Image

    picture = Image.fromarray(pixels)
    if picture.size != size:
        picture = picture.resize(size, Image.Resampling.LANCZOS)
    file = io.BytesIO()
    picture.save(file, "JPEG", quality=quality, optimize=True)
    return Layer({"name": name, "code": "jpeg"}, file.getvalue())


def store_ids(name: str, ids: NDArray[np.unsignedinteger]) -> tuple[Layer, NDArray[np.uint32]]:
    """Ids [h, w], and those that are there, ascending."""
    found, index = np.unique(ids.astype(np.uint32), return_inverse=True)
    width = 1 if len(found) <= 2**8 else 2 if len(found) <= 2**16 else 4
    data = found.astype("<u4").tobytes() + index.astype(f"<u{width}").tobytes()
    facts = {"name": name, "code": "ids", "count": len(found), "bytes": width}
    return Layer(facts, zlib.compress(data, _ID_EFFORT)), found


def store_depth(name: str, depth: NDArray[np.floating], bits: int) -> Layer:
    """Meters [h, w] in ``2**bits - 3`` steps from the nearest to the farthest hit of the frame."""
    top = 2**bits - 1
    hit = np.isfinite(depth)
    values = depth[hit].astype(np.float64)
    near, far = (float(values.min()), float(values.max())) if values.size else (1.0, 1.0)
    even = near <= 0.0
    codes = np.zeros(depth.shape, np.uint16)
    if far > near:
        part = (
            (values - near) / (far - near) if even else np.log(values / near) / math.log(far / near)
        )
        codes[hit] = 1 + np.rint((top - 2) * np.clip(part, 0.0, 1.0)).astype(np.uint16)
    else:
        codes[hit] = 1
    codes[np.isnan(depth) | (depth == -np.inf)] = top
    facts: dict[str, Any] = {"name": name, "code": "steps", "top": top, "near": near, "far": far}
    if even:
        facts["even"] = 1
    return Layer(facts, zlib.compress(differences(codes), _STEP_EFFORT))


def depth_error(facts: JsonObject) -> float:
    """Most that a stored depth is off: relative to it, or in meters where it is ``even``."""
    steps = 2.0 * (facts["top"] - 2)
    if facts.get("even"):
        return float((facts["far"] - facts["near"]) / steps)
    return math.expm1(math.log(facts["far"] / facts["near"]) / steps)


def differences(codes: NDArray[np.uint16]) -> bytes:
    """Zigzag differences to left + upper - upper left, [h, w], as low bytes, then high bytes."""
    whole = np.zeros((codes.shape[0] + 1, codes.shape[1] + 1), np.uint16)
    whole[1:, 1:] = codes
    rest = (whole[1:, 1:] - (whole[1:, :-1] + whole[:-1, 1:] - whole[:-1, :-1])).view(np.int16)
    folded = ((rest << 1) ^ (rest >> 15)).view(np.uint16)
    return (folded & 255).astype(np.uint8).tobytes() + (folded >> 8).astype(np.uint8).tobytes()


def store_normal(normal: NDArray[np.floating]) -> Layer:
    """Unit vectors [h, w, 3]; zero vectors are none."""
    n = normal.astype(np.float64)
    length = np.abs(n).sum(axis=2)
    there = np.isfinite(length) & (length > 0.0)
    n = np.where(there[..., None], n, 1.0) / np.where(there, length, 3.0)[..., None]
    sign = np.where(n[..., :2] >= 0.0, 1.0, -1.0)
    flat = np.where(n[..., 2:] >= 0.0, n[..., :2], (1.0 - np.abs(n[..., 1::-1])) * sign)
    codes = (1 + np.rint(127.0 * (flat + 1.0))).astype(np.uint8)
    codes[~there] = 0
    planes = codes.transpose(2, 0, 1).copy()
    planes[..., 1:] -= codes.transpose(2, 0, 1)[..., :-1]
    return Layer({"name": "normal", "code": "turns"}, zlib.compress(planes.tobytes(), 6))
