"""Label maps of panoramas: pictures whose pixels say what is seen there.

A pixel's value is a whole number (gray pictures as they are stored, up to 16 bits; pictures with a
palette by the index in it) or a color (RGB; alpha does not count). Gray of fewer than 8 bits counts
as scaled to 8, black 0 and white 255.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from scenec.schemas.errors import SceneError
from scenec.schemas.spelling import shown

#: Label ids that fit the pictures that stages hold.
LARGEST_ID = 65535
_LARGEST_SIDE = 16384
_COLOR = re.compile(r"#[0-9A-Fa-f]{6}")
_NUMBER = re.compile(r"0|[1-9][0-9]{0,4}")


def code_of(value: str) -> int | None:
    """The number that stands for a pixel value: itself, or of ``#RRGGBB`` 0xRRGGBB; None if bad."""
    if _COLOR.fullmatch(value):
        return int(value[1:], 16)
    if _NUMBER.fullmatch(value) and int(value) <= LARGEST_ID:
        return int(value)
    return None


def read_codes(file: Path) -> tuple[NDArray[np.int32], bool]:
    """Pixel values of a picture, int32 [h, w], and whether they are colors (0xRRGGBB).

    Raises:
        SceneError: It is no picture of the kinds that are taken.
    """
    from PIL import Image, UnidentifiedImageError

    try:
        with Image.open(file) as image:
            if max(image.size) > _LARGEST_SIDE:
                raise SceneError(
                    f"{file.name}: {image.size[0]} x {image.size[1]} pixels: at most "
                    f"{_LARGEST_SIDE} a side are taken"
                )
            if image.format != "PNG":
                # What compresses with loss invents values at every border.
                raise SceneError(f"{file.name}: a picture of the format {image.format}; use PNG")
            if image.mode.startswith("I"):
                return np.asarray(image).astype(np.int32), False
            if image.mode in ("1", "L", "LA"):
                return np.asarray(image.convert("L")).astype(np.int32), False
            if image.mode == "P":
                return np.asarray(image).astype(np.int32), False
            if image.mode in ("RGB", "RGBA"):
                rgb = np.asarray(image)[..., :3].astype(np.int32)
                return (rgb[..., 0] << 16) | (rgb[..., 1] << 8) | rgb[..., 2], True
            raise SceneError(f"{file.name}: pixels of the kind {image.mode} are not taken")
    except (UnidentifiedImageError, OSError, SyntaxError, ValueError) as error:
        raise SceneError(f"{file.name}: not a readable PNG file: {error}") from error
    except Image.DecompressionBombError as error:
        raise SceneError(f"{file.name}: too large a picture: {error}") from error


def decode(file: Path, ids: Mapping[str, int]) -> NDArray[np.uint16]:
    """Label ids of a picture's pixels, uint16 [h, w], by their values as the cfg writes them.

    Raises:
        SceneError: It cannot be read, has a value that is not among them, or they are of the other
            kind than its pixels.
    """
    codes, colors = read_codes(file)
    number_of: dict[int, int] = {}
    for value, number in ids.items():
        code = code_of(value)
        if code is None or value.startswith("#") != colors:
            raise SceneError(
                f"{file.name}: its pixels are {'colors' if colors else 'numbers'}, and values has "
                f"{shown(value)}: expected {'#RRGGBB' if colors else 'a whole number up to 65535'}"
            )
        number_of[code] = number
    table = np.array(sorted(number_of), np.int32)
    at = np.minimum(np.searchsorted(table, codes), len(table) - 1)
    unknown = np.flatnonzero((table[at] != codes).ravel())
    if unknown.size:
        row, column = divmod(int(unknown[0]), codes.shape[1])
        code = int(codes[row, column])
        value = f"#{code:06X}" if colors else str(code)
        raise SceneError(
            f"{file.name}: the value {value}, at column {column} and row {row} first, is not in "
            f'"values": {unknown.size} of {codes.size} pixels have values that are not'
        )
    return np.array([number_of[code] for code in table.tolist()], np.uint16)[at]
