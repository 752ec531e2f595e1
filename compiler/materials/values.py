"""Converts pictures to values and back with the same bits on every CPU.

As ``schemas.maps.decode`` means them, but decoded by tables, where that uses libm.
"""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.arithmetic.srgb import linear_codes
from scenec.compiler.assets.parts import MeshFileError
from scenec.compiler.assets.pictures import pixels_of, png
from scenec.compiler.materials.heights import stamp
from scenec.compiler.materials.periodic import Plane, moments
from scenec.compiler.scene.material import ImageFile
from scenec.schemas.errors import SceneError
from scenec.schemas.files import Stamp
from scenec.schemas.kernels import kernel
from scenec.schemas.threads import over_threads

type Source = Path | ImageFile
#: float32 [h, w, 3].
type Planes = NDArray[np.float32]
#: Pixels of pictures made here, for as long as these are there: they need not be decoded.
_codes_of: WeakKeyDictionary[ImageFile, NDArray] = WeakKeyDictionary()


def picture_of(codes: NDArray) -> ImageFile:
    """A picture with pixels as ``stored`` gives them."""
    picture = ImageFile(".png", png(codes))
    codes.setflags(write=False)
    _codes_of[picture] = codes
    return picture


def stored(source: Source) -> NDArray:
    """Pixels as ``schemas.maps.read_pixels`` gives them.

    Raises:
        SceneError: They cannot be read.
    """
    if isinstance(source, ImageFile):
        known = _codes_of.get(source)
        return _stored(source, None) if known is None else known
    return _stored(source, stamp(source))


@lru_cache(maxsize=8)
def _stored(source: Source, _stamp: Stamp | None) -> NDArray:
    name = source.name if isinstance(source, Path) else "of a model"
    try:
        pixels = pixels_of(source, name)
    except MeshFileError as error:
        raise SceneError(str(error)) from error
    pixels.setflags(write=False)
    return pixels


def forget_pixels() -> None:
    """Frees what ``stored`` keeps."""
    _stored.cache_clear()
    _codes_of.clear()


def size_of(source: Source) -> int:
    """Bytes of a picture's file."""
    return len(source.data) if isinstance(source, ImageFile) else source.stat().st_size


def colors(source: Source) -> Planes:
    """Linear Rec.709; of floating pictures what is below 0 is 0."""
    pixels = stored(source)
    if pixels.dtype.kind == "f":
        values = np.maximum(pixels, np.float32(0.0))
    else:
        values = linear_codes(int(np.iinfo(pixels.dtype).max)).astype(np.float32)[pixels]
    return np.repeat(values, 3, axis=2) if values.shape[2] == 1 else values


def raw(source: Source, channel: int = 0) -> Plane:
    """One channel in [0, 1]."""
    pixels = stored(source)
    plane = pixels[..., min(channel, pixels.shape[2] - 1)]
    if plane.dtype.kind == "f":
        return np.clip(plane, np.float32(0.0), np.float32(1.0))
    return (plane.astype(np.float64) / float(np.iinfo(plane.dtype).max)).astype(np.float32)


def normals(source: Source, step: int = 1) -> Planes:
    """Unit vectors as they are stored, y in the picture's own convention; every ``step``-th."""
    pixels = stored(source)[::step, ::step]
    if pixels.dtype.kind == "f":
        found = 2.0 * pixels.astype(np.float64) - 1.0
    else:
        found = 2.0 * (pixels.astype(np.float64) / float(np.iinfo(pixels.dtype).max)) - 1.0
    if found.shape[2] == 1:
        found = np.repeat(found, 3, axis=2)
    return unit(found)


def unit(vectors: NDArray[np.floating]) -> Planes:
    """Vectors brought to length 1; (0, 0, 1) where they have none."""
    out = np.empty(vectors.shape, np.float32)
    over_threads(_unit_part, len(vectors), vectors, out)
    return out


@kernel
def _unit_part(first, last, vectors, out):  # type: ignore[no-untyped-def]
    for line in range(first, last):
        row = np.int64(line)
        for column in range(vectors.shape[1]):
            x = np.float64(vectors[row, column, 0])
            y = np.float64(vectors[row, column, 1])
            z = np.float64(vectors[row, column, 2])
            length = np.sqrt(x * x + y * y + z * z)
            if length > 0.0:
                out[row, column, 0] = x / length
                out[row, column, 1] = y / length
                out[row, column, 2] = z / length
            else:
                out[row, column] = 0.0
                out[row, column, 2] = 1.0


def encoded(plane: Plane, factor: float) -> NDArray[np.uint8]:
    """Linear values times a factor as 8-bit sRGB, the nearest code of each; clipped to [0, 1]."""
    linear = linear_codes(255)
    borders = 0.5 * (linear[1:] + linear[:-1])
    table = np.searchsorted(borders, np.arange(65536) / 65535.0, side="right").astype(np.uint8)
    codes = np.empty(plane.shape, np.uint8)
    over_threads(_encode_part, len(plane), plane, factor, table, borders, codes)
    return codes


@kernel
def _encode_part(first, last, plane, factor, table, borders, codes):  # type: ignore[no-untyped-def]
    for line in range(first, last):
        row = np.int64(line)
        for column in range(plane.shape[1]):
            value = min(max(np.float64(plane[row, column]) * factor, 0.0), 1.0)
            code = table[np.int64(value * 65535.0)]
            # The table's steps are finer than codes: at most the next one is nearer.
            while code < 255 and value > borders[code]:
                code += np.uint8(1)
            codes[row, column] = code


def color_picture(planes: Planes) -> ImageFile:
    """Linear colors as sRGB codes; gray where all three are equal."""
    codes = np.stack([encoded(np.ascontiguousarray(planes[..., i]), 1.0) for i in range(3)], -1)
    if np.array_equal(codes[..., 0], codes[..., 1]) and np.array_equal(
        codes[..., 1], codes[..., 2]
    ):
        codes = codes[..., :1]
    return picture_of(codes)


def gray_picture(plane: Plane, fine: bool = False) -> ImageFile:
    """Values in [0, 1] as 8 bits, or 16."""
    largest = 65535 if fine else 255
    codes = np.floor(np.clip(plane.astype(np.float64), 0.0, 1.0) * largest + 0.5)
    return picture_of(codes.astype(np.uint16 if fine else np.uint8)[..., None])


def normal_picture(vectors: Planes, fine: bool = False) -> ImageFile:
    """Unit vectors as 8 bits, or 16."""
    largest = 65535 if fine else 255
    codes = np.floor(0.5 * largest * (vectors.astype(np.float64) + 1.0) + 0.5)
    return picture_of(np.clip(codes, 0.0, largest).astype(np.uint16 if fine else np.uint8))


def is_fine(source: Source) -> bool:
    """Whether a picture has more than 8 bits."""
    return stored(source).dtype != np.uint8


def mean_color(planes: Planes) -> tuple[float, float, float]:
    """Mean of each channel."""
    red, green, blue = (moments(np.ascontiguousarray(planes[..., i]))[0] for i in range(3))
    return (red, green, blue)
