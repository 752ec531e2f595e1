"""Finds the points that a picture is shaded at: one for all samples of a pixel that look alike.

Visibility is sampled finely and shading is not, as in hardware's multisampling and in surface
based anti-aliasing (Salvi and Vidimce 2012): samples of one row whose faces are nearly parallel
are shaded once, at their middle, and count by their number; half a pixel at most. What hides a sun
or a lamp is still looked up at each sample.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from scenec.backends.pyrender.geometry import Geometry, Selection
from scenec.backends.stage.scene import RenderScene
from scenec.schemas.kernels import inlined, kernel
from scenec.schemas.threads import over_threads

#: Faces whose normals lie closer than this angle are shaded as one where a pixel shows both.
ALIKE_RAD = np.radians(30.0)
#: ShadingPoints in a row of the picture that they are handed over as.
ROW = 1024


@dataclass(frozen=True)
class ShadingPoints:
    """Where a picture is shaded.

    Attributes:
        packed: (slot + 1; face; column and, from bit 16, row of the pixel; its samples, a bit
            each, row by row, then from bits 16 and 24 where their middle lies in the pixel, in
            256ths), uint32 [n, 4]; 0 in what fills the last row up.
        weight: Share of its pixel, float32 [n].
        pixel: The first point of each pixel, row by row, int64 [h w + 1].
        side: Samples on a side of a pixel.
    """

    packed: NDArray[np.uint32]
    weight: NDArray[np.float32]
    pixel: NDArray[np.int64]
    side: int


class DrawnView(NamedTuple):
    """Holds what ``draw_ids`` drew, and how rays go through it.

    Attributes:
        name: Of the target that was drawn into.
        near: Over depth it is the planar distance.
        points: What is to be shaded of it.
        selection: What was drawn.
        rays: From (u, v, 1) in pixels to directions.
        origin: The camera's position.
    """

    name: str
    near: float
    points: ShadingPoints
    selection: Selection
    rays: NDArray[np.float64]
    origin: NDArray[np.float64]


class _Samples(NamedTuple):
    """What tells which samples of a picture look alike.

    Attributes:
        ids, side, normals, firsts: As of ``find_points``.
        like: Cosine of ``ALIKE_RAD``.
    """

    ids: NDArray[np.uint32]
    side: int
    normals: NDArray[np.float32]
    firsts: NDArray[np.int64]
    like: np.float32


def face_normals(scene: RenderScene, geometry: Geometry) -> NDArray[np.float32]:
    """Returns unit normals of all drawn faces in their mesh's frame, float32 [f, 3]; or 0."""
    found = np.zeros((int(geometry.first_face[-1]), 3), np.float32)
    for drawn, first in zip(geometry.meshes, geometry.first_face.tolist(), strict=False):
        points, own = scene.meshes[drawn.mesh].points, found[first : first + len(drawn.faces)]
        over_threads(_normals, len(own), points, drawn.faces, own, least=1 << 14)
    return found


def find_points(
    ids: NDArray[np.uint32],
    side: int,
    normals: NDArray[np.float32],
    firsts: NDArray[np.int64],
) -> ShadingPoints:
    """Finds the points of a picture.

    Args:
        ids: Slots from 1 and faces of its samples, uint32 [h side, w side, 2].
        side: Samples on a side of a pixel.
        normals: ``face_normals``.
        firsts: First face of each slot's mesh among them, int64 [slots].
    """
    height, width = ids.shape[0] // side, ids.shape[1] // side
    counts = np.zeros(height * width + 1, np.int64)
    samples = _Samples(ids, side, normals, firsts, np.float32(np.cos(ALIKE_RAD)))
    over_threads(_count, height, samples, counts[1:])
    pixel = np.cumsum(counts)
    packed = np.zeros((-(-max(int(pixel[-1]), 1) // ROW) * ROW, 4), np.uint32)
    weight = np.zeros(len(packed), np.float32)
    over_threads(_fill, height, samples, pixel, packed, weight)
    return ShadingPoints(packed, weight, pixel, side)


def resolve(points: ShadingPoints, light: NDArray[np.float32]) -> NDArray[np.float32]:
    """Returns means over the samples of pixels: light and coverage, float32 [h w, 4].

    Args:
        points: Of a picture.
        light: Of each point, float32 [n, 4].
    """
    out = np.empty((len(points.pixel) - 1, 4), np.float32)
    over_threads(_resolve, len(out), points.weight, points.pixel, light, out, least=1 << 14)
    return out


@kernel
def _normals(first, last, points, faces, out):  # type: ignore[no-untyped-def]
    for k in range(first, last):
        a, b, c = points[faces[k, 0]], points[faces[k, 1]], points[faces[k, 2]]
        x, y, z = b[0] - a[0], b[1] - a[1], b[2] - a[2]
        u, v, w = c[0] - a[0], c[1] - a[1], c[2] - a[2]
        nx, ny, nz = y * w - z * v, z * u - x * w, x * v - y * u
        length = np.sqrt(nx * nx + ny * ny + nz * nz)
        if length > 0.0:
            out[k, 0], out[k, 1], out[k, 2] = nx / length, ny / length, nz / length


@inlined
def _cluster(samples, y, x, label, heads):  # type: ignore[no-untyped-def]
    """Puts the samples of a pixel together: labels from 0, -1 where nothing is; their number."""
    ids, side, normals = samples.ids, samples.side, samples.normals
    found = 0
    for k in range(side * side):
        row, column = y * side + k // side, x * side + k % side
        slot, face = ids[row, column, 0], ids[row, column, 1]
        label[k] = -1
        if slot == 0:
            continue
        first = samples.firsts[np.int64(slot) - 1]
        n = normals[first + np.int64(face)]
        for j in range(found):
            head_row, head_column = y * side + heads[j] // side, x * side + heads[j] % side
            # A half of a pixel each: ground is seen at a slant, and its pictures blur by the
            # longer side of what a point stands for.
            apart = 2 * (heads[j] // side) < side and 2 * (k // side) >= side
            if ids[head_row, head_column, 0] != slot or (apart and side > 1):
                continue
            other = ids[head_row, head_column, 1]
            m = normals[first + np.int64(other)]
            if other == face or n[0] * m[0] + n[1] * m[1] + n[2] * m[2] >= samples.like:
                label[k] = j
                break
        if label[k] < 0:
            label[k] = found
            heads[found] = k
            found += 1
    return found


@kernel
def _count(first, last, samples, counts):  # type: ignore[no-untyped-def]
    ids, side = samples.ids, samples.side
    label, heads = np.empty(side * side, np.int64), np.empty(side * side, np.int64)
    width = ids.shape[1] // side
    for y in range(first, last):
        for x in range(width):
            counts[y * width + x] = _cluster(samples, y, x, label, heads)


@kernel
def _fill(first, last, samples, pixel, packed, weight):  # type: ignore[no-untyped-def]
    ids, side = samples.ids, samples.side
    label, heads = np.empty(side * side, np.int64), np.empty(side * side, np.int64)
    width = ids.shape[1] // side
    for y in range(first, last):
        for x in range(width):
            found = _cluster(samples, y, x, label, heads)
            for j in range(found):
                count, row, column = 0, 0.0, 0.0
                mask = 0
                for k in range(side * side):
                    if label[k] == j:
                        count += 1
                        row += k // side
                        column += k % side
                        mask |= 1 << k
                row, column = row / count, column / count
                nearest, at = np.inf, 0
                for k in range(side * side):
                    off = (k // side - row) ** 2 + (k % side - column) ** 2
                    if label[k] == j and off < nearest:
                        nearest, at = off, k
                slot, face = ids[y * side + at // side, x * side + at % side]
                at = pixel[y * width + x] + j
                weight[at] = count / side**2
                out = packed[at]
                across, down = (column + 0.5) * 256.0 / side, (row + 0.5) * 256.0 / side
                out[0], out[1], out[2] = slot, face, x | y << 16
                out[3] = mask | int(across + 0.5) << 16 | int(down + 0.5) << 24


@kernel
def _resolve(first, last, weight, pixel, light, out):  # type: ignore[no-untyped-def]
    for k in range(first, last):
        out[k] = 0.0
        for p in range(pixel[k], pixel[k + 1]):
            for c in range(3):
                out[k, c] += weight[p] * light[p, c]
            out[k, 3] += weight[p]
