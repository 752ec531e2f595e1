"""Compresses a picture as a JPEG and reads it back (Pillow's libjpeg).

A JPEG's blocks are coded one by one; only averaged colors, when they are spread over pixels again,
look at the next line of blocks. So bands of a picture, each with one line of blocks more than is
taken of it, give the very pixels that the picture as a whole does, and are coded side by side.
"""

from __future__ import annotations

import io
import os
from concurrent.futures import ThreadPoolExecutor
from typing import IO

import numpy as np
from numpy.typing import NDArray

#: Pixels down a block of colors.
_BLOCKS = {"4:4:4": 8, "4:2:2": 8, "4:2:0": 16}
#: Lines of blocks below which it is not worth a thread.
_FEW = 8


def compressed(picture: NDArray[np.uint8], quality: int, subsampling: str) -> NDArray[np.uint8]:
    """The picture that decoding a baseline JPEG of a picture returns.

    Args:
        picture: sRGB, [h, w, 3].
        quality: 1 to 100, as libjpeg has it.
        subsampling: "4:4:4", "4:2:2" or "4:2:0".

    Returns:
        uint8 [h, w, 3].
    """
    block = _BLOCKS[subsampling]
    seam = picture.shape[0] // (2 * block) * block
    if seam < _FEW * block:
        return _coded(picture, quality, subsampling)
    with ThreadPoolExecutor(2) as threads:
        top = threads.submit(_coded, picture[: seam + block], quality, subsampling)
        bottom = threads.submit(_coded, picture[seam - block :], quality, subsampling)
        return np.concatenate([top.result()[:seam], bottom.result()[block:]])


def _coded(picture: NDArray[np.uint8], quality: int, subsampling: str) -> NDArray[np.uint8]:
    from PIL import Image

    with _memory() as file:
        Image.fromarray(picture).save(file, "JPEG", quality=quality, subsampling=subsampling)
        file.seek(0)
        with Image.open(file) as image:
            return np.asarray(image)


def _memory() -> IO[bytes]:
    """A file in memory; a real one where there are such: only then Pillow writes beside others."""
    create = getattr(os, "memfd_create", None)
    return io.BytesIO() if create is None else open(create("jpeg"), "w+b")
