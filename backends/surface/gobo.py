"""Pictures that suns shine through: shadows of clouds, looked up at places."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from scenec.backends.stage.scene import Sun
from scenec.schemas.errors import StageError
from scenec.schemas.files import once_per_file
from scenec.schemas.maps import require_size


@once_per_file(most=8)
def load_gobo(file: Path) -> NDArray[np.float32]:
    """Shares of light that come through, in [0, 1], float32 [h, w], top row first.

    Raises:
        StageError: The file is missing, or no picture of one channel of 8 or 16 bits.
    """
    from PIL import Image, UnidentifiedImageError

    try:
        with Image.open(file) as image:
            require_size(image)
            codes = np.asarray(image)
    except (UnidentifiedImageError, OSError, SyntaxError, Image.DecompressionBombError) as error:
        raise StageError(f"{file}: cannot read the light filter's picture: {error}") from error
    if codes.ndim != 2 or codes.dtype not in (np.uint8, np.uint16):
        raise StageError(f"{file}: a light filter's picture has one channel of 8 or 16 bits")
    shares = (codes / float(np.iinfo(codes.dtype).max)).astype(np.float32)
    shares.setflags(write=False)
    return shares


def passed(sun: Sun, places: NDArray[np.float64]) -> NDArray[np.float64]:
    """Share of a sun's light that comes through to places [n, 3], float64 [n]; 1 without a gobo.

    Raises:
        StageError: As of ``load_gobo``.
    """
    if sun.gobo is None:
        return np.ones(len(places))
    shares, rows = load_gobo(sun.gobo.file), sun.gobo.to_picture
    # Texel (i, j) has its center at (i + 0.5, j + 0.5); u and v fold at 0 and 1.
    place = places @ rows[:, :3].T + rows[:, 3]
    folded = 1.0 - np.abs(place % 2.0 - 1.0)
    size = np.array(shares.shape[::-1])
    at = np.clip(folded * size - 0.5, 0.0, size - 1.0)
    low = np.minimum(at.astype(np.int64), np.maximum(size - 2, 0))
    (a, b), (i, j) = (at - low).T, low.T
    k, m = np.minimum(i + 1, size[0] - 1), np.minimum(j + 1, size[1] - 1)
    top = (1.0 - a) * shares[j, i] + a * shares[j, k]
    bottom = (1.0 - a) * shares[m, i] + a * shares[m, k]
    return np.asarray((1.0 - b) * top + b * bottom)


def mean_passed(sun: Sun) -> float:
    """``passed`` over all of the picture.

    Raises:
        StageError: As of ``load_gobo``.
    """
    return 1.0 if sun.gobo is None else float(load_gobo(sun.gobo.file).mean(dtype=np.float64))
