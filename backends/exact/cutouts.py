"""Cut-outs in the caster: at a hit it asks the mask, in float64, and goes on where that is cut.

``surface.cutouts`` says what is cut. Texture coordinates are those of the face's corners by the
barycentric coordinates of the hit, which ``intersect`` has to 44 bits.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from scenec.backends.exact.intersect import barycentric, projected
from scenec.backends.stage.scene import RenderScene
from scenec.backends.surface.cutouts import field
from scenec.schemas.kernels import inlined, kernel
from scenec.schemas.stage import WRAPS


class Cutouts(NamedTuple):
    """Holds the masks of a scene.

    Attributes:
        of_row: Index of each row's mask, -1 for none, int32 [r].
        first: Where the faces of each row's mesh begin in ``uv``, int64 [r].
        uv: Texture coordinates of corners, of all meshes with a mask, float32 [k, 3, 2].
        fields: ``surface.cutouts.field`` of all masks, one after the other, float32 [t].
        places: Of each mask: first value in ``fields``, height, width, and along u and v the
            number of its way to wrap in ``WRAPS``, int64 [m, 5].
    """

    of_row: NDArray[np.int32]
    first: NDArray[np.int64]
    uv: NDArray[np.float32]
    fields: NDArray[np.float32]
    places: NDArray[np.int64]


def cutouts_of(scene: RenderScene) -> Cutouts | None:
    """The masks of a scene; None without any, for which kernels are compiled apart.

    Raises:
        StageError: A picture is missing, or cannot be read.
    """
    if not scene.has_cutouts:
        return None
    number: dict[tuple[object, ...], int] = {}
    places: list[tuple[int, ...]] = []
    fields, uv = [], []
    of_mesh = np.full(len(scene.meshes), -1, np.int32)
    first = np.zeros(len(scene.meshes), np.int64)
    texels = corners = 0
    for index, mesh in enumerate(scene.meshes):
        maps = scene.cutout_of(mesh)
        if maps is None:
            continue
        key = (maps.opacity, maps.opacity_threshold, maps.opacity_wrap, maps.readings)
        if key not in number:
            number[key] = len(number)
            made = field(maps)
            places.append((texels, *made.shape, *map(WRAPS.index, maps.opacity_wrap)))
            fields.append(made.ravel())
            texels += made.size
        of_mesh[index], first[index] = number[key], corners
        uv.append(np.zeros((len(mesh.faces), 3, 2), np.float32) if mesh.uv is None else mesh.uv)
        corners += len(mesh.faces)
    rows = scene.rows.mesh
    return Cutouts(
        of_mesh[rows],
        first[rows],
        np.concatenate(uv),
        np.concatenate(fields),
        np.array(places, np.int64),
    )


@kernel
def _folded(x, wrap, texels):  # type: ignore[no-untyped-def]
    """``surface.cutouts.folded`` of a number."""
    if wrap == 0:
        return x
    if wrap == 2:
        x = 1.0 - abs(x - 2.0 * math.floor(x * 0.5) - 1.0)
    half = 0.5 / texels
    return min(max(x, half), 1.0 - half)


@kernel
def _value(cutouts, place, u, v):  # type: ignore[no-untyped-def]
    """A mask's field at texture coordinates."""
    start, height, width = place[0], place[1], place[2]
    x = _folded(u, place[3], width) * width - 0.5
    y = _folded(v, place[4], height) * height - 0.5
    left, low = math.floor(x), math.floor(y)
    across, up = x - left, y - low
    left, low = int(left) % width, int(low) % height
    right, high = (left + 1) % width, (low + 1) % height
    below, above = start + low * width, start + high * width
    fields = cutouts.fields
    bottom = (1.0 - across) * fields[below + left] + across * fields[below + right]
    top = (1.0 - across) * fields[above + left] + across * fields[above + right]
    return (1.0 - up) * bottom + up * top


@kernel
def _is_opaque(cutouts, row, local, a, b, c):  # type: ignore[no-untyped-def]
    p, q, r = barycentric(a, b, c)
    uv = cutouts.uv[cutouts.first[row] + local]
    u = p * uv[0, 0] + q * uv[1, 0] + r * uv[2, 0]
    v = p * uv[0, 1] + q * uv[1, 1] + r * uv[2, 1]
    return _value(cutouts, cutouts.places[cutouts.of_row[row]], u, v) > 0.0


@inlined
def is_opaque(cutouts, row, local, a, b, c):  # type: ignore[no-untyped-def]
    """Whether a triangle is there where a ray meets it.

    Args:
        cutouts: ``Cutouts``, or None: then this is no code at all.
        row, local: The triangle: its row, and its face in the row's mesh.
        a, b, c: Its corners in the ray's sheared frame, as of ``intersect.parameter_of``.
    """
    if cutouts is None:
        return True
    return cutouts.of_row[row] < 0 or _is_opaque(cutouts, row, local, a, b, c)


@kernel
def _face_is_opaque(g, row, face, matrix, frame):  # type: ignore[no-untyped-def]
    corners = g.faces[face]
    a = projected(g.points[corners[0]], matrix, frame)
    b = projected(g.points[corners[1]], matrix, frame)
    c = projected(g.points[corners[2]], matrix, frame)
    return _is_opaque(g.cutouts, row, face - g.row_face[row], a, b, c)


@inlined
def face_is_opaque(cutouts, g, row, face, matrix, frame):  # type: ignore[no-untyped-def]
    """``is_opaque`` of a triangle by its index in ``g.faces``; ``cutouts`` is ``g.cutouts``."""
    if cutouts is None:
        return True
    return cutouts.of_row[row] < 0 or _face_is_opaque(g, row, face, matrix, frame)
