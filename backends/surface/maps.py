"""Surface maps for renderers: one loader and one definition, so that all see the same values.

The functions on positions and normals are the reference that renderers are held against: each does
the same arithmetic in its own language.

Triplanar normals: Golus 2017, Normal Mapping for a Triplanar Shader, the whiteout blend, summed
over the three planes by the weights of the colors. On a plane its tangent part is added to the
shading normal's, its z scales the rest; a flat map leaves the shading normal as it is, and bumps
stay bumps on both sides of the planes, on whose far side the picture is seen mirrored.
"""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from scenec.backends.stage.scene import Maps, Mesh, Reading
from scenec.schemas import maps
from scenec.schemas.errors import StageError

#: World axes that are u and v on the planes across x, y and z.
PLANES = ((1, 2), (0, 2), (0, 1))
_PLAIN = Reading()


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


def map_key(described: Maps, kind: str) -> tuple[object, ...]:
    """What tells the values of a map, and where they lie, from those of others."""
    place = (described.projection, described.size_m, described.cells)
    far = described.far if kind == "base_color" else None
    return (*map_source(described, kind), *place, far)


@lru_cache(maxsize=32)
def load_map(
    path: Path, kind: str, flip_green: bool = False, reading: Reading = _PLAIN
) -> NDArray[np.float32]:
    """A map's values, float32 [h, w, 1 or 3], row 0 at the top of the picture.

    Bilinear between texel centers and repeating, texel (row, column) of an h x w picture stands for
    u = (column + 0.5) / w, v = 1 - (row + 0.5) / h.

    Args:
        path: The picture.
        kind: "base_color", "emission" (linear Rec.709), "roughness", "metallic", "height" (raw, in
            [0, 1]) or "normal" (unit vectors, x along +u, y along +v).
        flip_green: See ``render_scene.Maps``.
        reading: How its numbers are meant.

    Raises:
        StageError: The file is missing, or no picture of the kinds that are taken.
    """
    if not path.is_file():
        raise StageError(f"{path}: the map is missing")
    try:
        pixels = maps.read_pixels(path)
        if reading == _PLAIN:
            values = maps.decode(pixels, kind, flip_green)
        else:
            values = _read(pixels, kind, flip_green, reading)
    except ValueError as error:
        raise StageError(f"{path}: {error}") from error
    values.setflags(write=False)
    return values


def _read(pixels: NDArray, kind: str, flip_green: bool, reading: Reading) -> NDArray[np.float32]:
    """As UsdUVTexture says, in floating point, which ``schemas.maps`` takes as it is."""
    floating = pixels.dtype.kind == "f"
    values = pixels.astype(np.float64) / (1.0 if floating else float(np.iinfo(pixels.dtype).max))
    if values.shape[2] == 1:
        values = np.repeat(values, 3, axis=2)
    srgb = reading.srgb
    if srgb is None:
        srgb = kind in maps.COLORS and not floating
    if srgb:
        above = ((np.maximum(values, 0.04045) + 0.055) / 1.055) ** 2.4
        values = np.where(values <= 0.04045, values / 12.92, above)
    values = values * np.array(reading.scale) + np.array(reading.bias)
    if maps.MAP_CHANNELS[kind] == 1:
        values = values[..., "rgb".index(reading.channel)][..., None]
    return maps.decode(values.astype(np.float32), kind, flip_green)


def sample(picture: NDArray[np.floating], u: NDArray, v: NDArray) -> NDArray[np.float64]:
    """A repeating picture [h, w, c] at coordinates, bilinear between texel centers: [..., c]."""
    height, width = picture.shape[:2]
    x = np.asarray(u, np.float64) * width - 0.5
    y = (1.0 - np.asarray(v, np.float64)) * height - 0.5
    column, row = np.floor(x), np.floor(y)
    across, down = (x - column)[..., None], (y - row)[..., None]
    i, j = column.astype(np.int64), row.astype(np.int64)

    def texel(below: int, right: int) -> NDArray[np.float64]:
        found: NDArray[np.float64] = picture[(j + below) % height, (i + right) % width].astype(
            np.float64
        )
        return found

    top = (1.0 - across) * texel(0, 0) + across * texel(0, 1)
    bottom = (1.0 - across) * texel(1, 0) + across * texel(1, 1)
    values: NDArray[np.float64] = (1.0 - down) * top + down * bottom
    return values


def triplanar_weights(normals: NDArray) -> NDArray[np.float64]:
    """Share of the planes across x, y and z where the unit shading normals are [..., 3].

    n**4 of each component, over their sum: equal on a vector and its opposite, and smooth.
    """
    squares = np.square(np.asarray(normals, np.float64))
    fourth = squares * squares
    shares: NDArray[np.float64] = fourth / fourth.sum(axis=-1, keepdims=True)
    return shares


def triplanar(
    picture: NDArray[np.floating], size_m: float, positions: NDArray, normals: NDArray
) -> NDArray[np.float64]:
    """A picture of numbers or colors [h, w, c] on a surface, [..., c].

    Args:
        picture: From ``map_values``.
        size_m: Side of one repeat.
        positions: World, [..., 3].
        normals: Unit shading normals, [..., 3].
    """
    shares = triplanar_weights(normals)
    at = np.asarray(positions, np.float64) / size_m
    total = np.zeros((*at.shape[:-1], picture.shape[2]))
    for axis, (u, v) in enumerate(PLANES):
        total += shares[..., axis, None] * sample(picture, at[..., u], at[..., v])
    return total


def triplanar_normal(
    picture: NDArray[np.floating], size_m: float, positions: NDArray, normals: NDArray
) -> NDArray[np.float64]:
    """The leaned normals of a map of normals; arguments as of ``triplanar``.

    Unit vectors [..., 3] on the side of ``normals``, which is where those point outward.
    """
    shares = triplanar_weights(normals)
    n = np.asarray(normals, np.float64)
    at = np.asarray(positions, np.float64) / size_m
    total = np.zeros(n.shape)
    for axis, (u, v) in enumerate(PLANES):
        mapped = sample(picture, at[..., u], at[..., v])
        part = n.copy()
        part[..., u] += mapped[..., 0]
        part[..., v] += mapped[..., 1]
        part[..., axis] *= mapped[..., 2]
        total += shares[..., axis, None] * part
    leaned: NDArray[np.float64] = total / np.sqrt((total * total).sum(axis=-1, keepdims=True))
    return leaned


def uv_normal(
    mapped: NDArray[np.floating], normals: NDArray, along_u: NDArray, along_v: NDArray
) -> NDArray[np.float64]:
    """Normals of a map in the frame of texture coordinates, unit vectors [..., 3].

    The tangent is dP/du of the triangle, less its part along the shading normal; the bitangent is
    across both, on the side of dP/dv. Unlike MikkTSpace's, they are not averaged over a vertex's
    triangles: the two agree where coordinates are smooth in space. Where a triangle has no area in
    the picture, normals stay as they are.

    Args:
        mapped: Values of the map, [..., 3].
        normals: Unit shading normals, [..., 3].
        along_u, along_v: Of ``face_tangents``, in the world, [..., 3].
    """
    n = np.asarray(normals, np.float64)
    lift = (n * along_u).sum(axis=-1, keepdims=True)
    tangent = along_u - lift * n
    length = np.sqrt((tangent * tangent).sum(axis=-1, keepdims=True))
    tangent = tangent / np.where(length > 0.0, length, 1.0)
    across = np.cross(n, tangent)
    side = np.sign((across * along_v).sum(axis=-1, keepdims=True))
    leaned = mapped[..., :1] * tangent + mapped[..., 1:2] * side * across + mapped[..., 2:3] * n
    size = np.sqrt((leaned * leaned).sum(axis=-1, keepdims=True))
    found: NDArray[np.float64] = np.where((length > 0.0) & (size > 0.0), leaned / size, n)
    return found


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
