"""Pictures in UDIM tiles: which files they are, and one picture of them all.

Tile 1001 + u + 10 v holds the texture coordinates from (u, v) to (u + 1, v + 1), u from 0 to 9.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from scenec.schemas.maps import LARGEST
from scenec.schemas.packages import beside, is_packaged

#: What stands for the number of a tile in a path.
UDIM = "<UDIM>"
#: What a picture holds where there is no tile: black, dull, even, solid.
NO_TILE = {"normal": (0.5, 0.5, 1.0), "roughness": (1.0, 1.0, 1.0), "opacity": (1.0, 1.0, 1.0)}
_COLUMNS = 10
#: Where a tile lies: column and row, (0, 0) at the lower left.
type Place = tuple[int, int]


def is_tiled(path: Path | str) -> bool:
    """Whether a path names tiles."""
    return UDIM in str(path)


def tiles_of(path: Path) -> dict[Place, Path]:
    """The tiles that are there, by their places, in their order; empty where there are none."""
    before, _, after = str(path).partition(UDIM)
    pattern = re.compile(f"{re.escape(before)}(1[0-9]{{3}}){re.escape(after)}")
    numbers = {}
    for file in beside(path):
        match = pattern.fullmatch(str(file))
        if match and int(match[1]) > 1000 and (is_packaged(file) or file.is_file()):
            numbers[int(match[1]) - 1001] = file
    return {(n % _COLUMNS, n // _COLUMNS): numbers[n] for n in sorted(numbers)}


def grid_of(paths: Iterable[Path]) -> Place:
    """Columns and rows that hold the tiles of all paths; (1, 1) where none has any."""
    places = [place for path in paths if is_tiled(path) for place in tiles_of(path)]
    return (
        max((column for column, _ in places), default=0) + 1,
        max((row for _, row in places), default=0) + 1,
    )


def joined(tiles: Mapping[Place, NDArray], grid: Place, fill: tuple[float, ...]) -> NDArray:
    """One picture of tiles, [rows * h, columns * w, channels], row 0 at the top.

    Tiles of fewer texels than the largest one have each of theirs repeated, so an edge in them is
    off by half a texel of their own at most.

    Args:
        tiles: Of one type and as many channels.
        grid: Columns and rows.
        fill: What stands where there is no tile, for each channel, in the tiles' own numbers.

    Raises:
        ValueError: The picture would be too large.
    """
    columns, rows = grid
    high, wide = (max(tile.shape[axis] for tile in tiles.values()) for axis in (0, 1))
    if max(columns * wide, rows * high) > LARGEST:
        raise ValueError(
            f"{columns} x {rows} tiles of {wide} x {high} pixels are one picture of "
            f"{columns * wide} x {rows * high} here: at most {LARGEST}"
        )
    first = next(iter(tiles.values()))
    picture = np.empty((rows * high, columns * wide, first.shape[2]), first.dtype)
    picture[:] = np.array(fill[: first.shape[2]]).astype(first.dtype)
    for (column, row), tile in tiles.items():
        down = np.arange(high) * tile.shape[0] // high
        across = np.arange(wide) * tile.shape[1] // wide
        top, left = (rows - 1 - row) * high, column * wide
        picture[top : top + high, left : left + wide] = tile[down][:, across]
    return picture
