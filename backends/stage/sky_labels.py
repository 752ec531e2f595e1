"""Labels of the sky by panoramas: looked up at the nearest texel, the same for all backends."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from scenec.backends.stage.scene import SkyLabelMap
from scenec.schemas.errors import StageError
from scenec.schemas.files import once_per_file
from scenec.schemas.kernels import kernel
from scenec.schemas.maps import read_pixels
from scenec.schemas.threads import over_threads


def label_of_sky(
    label_map: SkyLabelMap, directions: NDArray[np.float64], misses: NDArray[np.int64]
) -> NDArray[np.uint32]:
    """Label ids that rays which meet nothing see.

    The picture lies as a dome's does (``scenec.backends.picture.sky``): u and v as there, of which
    the texel that they fall into counts, column floor(u * width), row floor(v * height).

    Args:
        label_map: The panorama.
        directions: World, any length, float64 [n, 3].
        misses: Which of them are asked for, int64 [k].

    Returns:
        uint32 [k].

    Raises:
        StageError: The picture cannot be read.
    """
    out = np.empty(len(misses), np.uint32)
    ids = load_label_map(label_map.file)
    over_threads(
        _lookup,
        len(misses),
        ids,
        np.ascontiguousarray(label_map.to_world.T),
        directions,
        misses,
        out,
    )
    return out


@once_per_file(most=8)
def load_label_map(path: Path) -> NDArray[np.uint32]:
    """A picture of label ids, uint32 [h, w].

    Raises:
        StageError: It is none of one channel of 8 or 16 bits.
    """
    try:
        pixels = read_pixels(path)
    except (ValueError, OSError) as error:
        raise StageError(f"{path}: {error}") from error
    if pixels.shape[2] != 1 or pixels.dtype.kind != "u":
        raise StageError(f"{path}: a label map has one channel of 8 or 16 bits")
    return pixels[..., 0].astype(np.uint32)


@kernel
def _lookup(first, last, ids, to_map, directions, misses, out):  # type: ignore[no-untyped-def]
    height, width = ids.shape
    for i in range(first, last):
        d = directions[misses[i]]
        x = (to_map[0, 0] * d[0] + to_map[0, 1] * d[1]) + to_map[0, 2] * d[2]
        y = (to_map[1, 0] * d[0] + to_map[1, 1] * d[1]) + to_map[1, 2] * d[2]
        z = (to_map[2, 0] * d[0] + to_map[2, 1] * d[1]) + to_map[2, 2] * d[2]
        u = (0.5 - np.arctan2(x, z) / (2 * np.pi)) * width
        v = np.arctan2(np.sqrt(x * x + z * z), y) / np.pi * height
        out[i] = ids[min(int(v), height - 1), int(np.floor(u)) % width]
