"""Surface maps for renderers: one loader, so that all see the same values."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from scenec.backends.stage.scene import Maps, Mesh, Reading
from scenec.schemas import maps, udim
from scenec.schemas.errors import StageError
from scenec.schemas.files import Stamp, once_per_file, stamp
from scenec.schemas.packages import file_around

_PLAIN = Reading()
#: What a map is where UDIM has no tile: black, dull, even, solid.
_NO_TILE = {"normal": (0.0, 0.0, 1.0), "roughness": (1.0,), "opacity": (1.0,)}


def map_file(described: Maps, kind: str) -> Path | None:
    """File of one kind of map (``schemas.maps.MAP_CHANNELS``), if any."""
    file: Path | None = getattr(described, kind)
    return file


def map_source(described: Maps, kind: str) -> tuple[Path, str, bool, Reading]:
    """Arguments of ``load_map`` for one kind of map.

    Raises:
        StageError: There is none.
    """
    file = map_file(described, kind)
    if file is None:
        raise StageError(f"there is no map of {kind}")
    reading = dict(described.readings).get(kind, _PLAIN)
    return file, kind, described.flip_green and kind == "normal", reading


def map_values(described: Maps, kind: str) -> NDArray[np.float32]:
    """Values of one kind of map, float32 [h, w, 1 or 3], row 0 at the top; see ``load_map``.

    Raises:
        StageError: There is no such file, or it is no picture of the kinds that are taken.
    """
    return load_map(*map_source(described, kind))


def map_mean(described: Maps, kind: str) -> NDArray[np.float64]:
    """Mean of a map over its picture, [1 or 3]."""
    path, kind, flip_green, reading = map_source(described, kind)
    if reading.tiles == (1, 1):
        return _mean(path, kind, flip_green, reading)
    mean: NDArray[np.float64] = map_values(described, kind).mean(axis=(0, 1), dtype=np.float64)
    return mean


@once_per_file(most=64)
def _mean(path: Path, kind: str, flip_green: bool, reading: Reading) -> NDArray[np.float64]:
    values = load_map(path, kind, flip_green, reading)
    mean: NDArray[np.float64] = values.mean(axis=(0, 1), dtype=np.float64)
    mean.setflags(write=False)
    return mean


def load_map(
    path: Path, kind: str, flip_green: bool = False, reading: Reading = _PLAIN
) -> NDArray[np.float32]:
    """A map's values, float32 [h, w, 1 or 3], row 0 at the top of the picture.

    Bilinear between texel centers and repeating, texel (row, column) of an h x w picture stands for
    u = (column + 0.5) / w, v = 1 - (row + 0.5) / h.

    Args:
        path: The picture.
        kind: "base_color", "emission" (linear Rec.709), "roughness", "metallic", "height",
            "opacity" (raw, in [0, 1]) or "normal" (unit vectors, x along +u, y along +v).
        flip_green: See ``stage.scene.Maps``.
        reading: How its numbers are meant.

    Raises:
        StageError: The file is missing, or no picture of the kinds that are taken.
    """
    if reading.tiles == (1, 1):
        return _loaded(path, kind, flip_green, reading)
    one = replace(reading, tiles=(1, 1))
    if not udim.is_tiled(path):
        return np.tile(_loaded(path, kind, flip_green, one), (*reading.tiles[::-1], 1))
    found = udim.tiles_of(path)
    if not found:
        raise StageError(f"{path}: no tile of the map is there")
    stamps = tuple(stamp(file_around(file)) for file in found.values())
    return _atlas(path, kind, flip_green, reading, stamps)


@lru_cache(maxsize=8)
def _atlas(
    path: Path, kind: str, flip_green: bool, reading: Reading, _stamps: tuple[Stamp, ...]
) -> NDArray[np.float32]:
    one = replace(reading, tiles=(1, 1))
    tiles = {
        place: _loaded(file, kind, flip_green, one) for place, file in udim.tiles_of(path).items()
    }
    try:
        values = udim.joined(tiles, reading.tiles, _NO_TILE.get(kind, (0.0, 0.0, 0.0)))
    except ValueError as error:
        raise StageError(f"{path}: {error}") from error
    values.setflags(write=False)
    return values


@once_per_file(most=32)
def _loaded(path: Path, kind: str, flip_green: bool, reading: Reading) -> NDArray[np.float32]:
    if not file_around(path).is_file():
        raise StageError(f"{path}: the map is missing")
    try:
        pixels = maps.read_pixels(path, alpha=reading.channel == "a")
        if reading == _PLAIN:
            values = maps.decode(pixels, kind, flip_green)
        else:
            values = maps.meant(
                pixels, kind, reading.srgb, reading.scale, reading.bias, reading.channel
            )
            values = maps.decode(values, kind, flip_green)
    except ValueError as error:
        raise StageError(f"{path}: {error}") from error
    values.setflags(write=False)
    return values


def sample(picture: NDArray[np.floating], u: NDArray, v: NDArray) -> NDArray[np.float64]:
    """A repeating picture [h, w, c] at coordinates, bilinear between texel centers: [..., c]."""
    height, width = picture.shape[:2]
    x = np.asarray(u, np.float64) * width - 0.5
    y = (1.0 - np.asarray(v, np.float64)) * height - 0.5
    column, row = np.floor(x), np.floor(y)
    across, down = (x - column)[..., None], (y - row)[..., None]
    i, j = column.astype(np.int64), row.astype(np.int64)

    def texel(below: int, right: int) -> NDArray[np.float64]:
        value: NDArray[np.float64] = picture[(j + below) % height, (i + right) % width].astype(
            np.float64
        )
        return value

    top = (1.0 - across) * texel(0, 0) + across * texel(0, 1)
    bottom = (1.0 - across) * texel(1, 0) + across * texel(1, 1)
    values: NDArray[np.float64] = (1.0 - down) * top + down * bottom
    return values


def face_tangents(mesh: Mesh) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Directions of dP/du and dP/dv of each triangle in the mesh's frame, float32 [m, 3] each.

    They have the length of an edge of the triangle or so; zero where it has no area in the picture.
    """
    if mesh.uv is None:
        zero = np.zeros((len(mesh.faces), 3), np.float32)
        return zero, zero
    corners = mesh.points[mesh.faces].astype(np.float64)
    uv = mesh.uv.astype(np.float64)
    ab, ac = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    first, second = uv[:, 1] - uv[:, 0], uv[:, 2] - uv[:, 0]
    turn = np.sign(first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0])[:, None]
    reach = np.abs(np.concatenate([first, second], axis=1)).max(axis=1, initial=0.0)[:, None]
    scale = turn / np.where(reach > 0.0, reach, 1.0)
    along_u = (second[:, 1:] * ab - first[:, 1:] * ac) * scale
    along_v = (first[:, :1] * ac - second[:, :1] * ab) * scale
    return along_u.astype(np.float32), along_v.astype(np.float32)
