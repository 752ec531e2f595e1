"""Surface maps for renderers: one loader, so that all see the same values."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from scenec.schemas import maps
from scenec.schemas.errors import StageError


@lru_cache(maxsize=32)
def load_map(path: Path, kind: str, flip_green: bool = False) -> NDArray[np.float32]:
    """A map's values, float32 [h, w, 1 or 3], row 0 at the top of the picture.

    Bilinear between texel centers and repeating, texel (row, column) of an h x w picture stands for
    u = (column + 0.5) / w, v = 1 - (row + 0.5) / h.

    Args:
        path: The picture.
        kind: "base_color" (linear Rec.709), "roughness", "metallic" (raw, in [0, 1]) or "normal"
            (unit vectors, x along +u, y along +v).
        flip_green: See ``render_scene.Maps``.

    Raises:
        StageError: The file is missing, or no picture of the kinds that are taken.
    """
    if not path.is_file():
        raise StageError(f"{path}: the map is missing")
    try:
        values = maps.decode(maps.read_pixels(path), kind, flip_green)
    except ValueError as error:
        raise StageError(f"{path}: {error}") from error
    values.setflags(write=False)
    return values
