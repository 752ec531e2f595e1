"""Does a renderer see what the annotation says: its own first hits against the exact ones.

A renderer works in float32, and a rasterizer rounds vertices to fractions of a pixel, so that its
ray is the exact one moved by a hair. Where the two disagree, what that would take is measured, in
pixels: the exact face can only be passed by over one of its edges (``skip``: how far the nearest
one is from the ray; nothing, for a face whose picture is thinner than a pixel), and the face that
is seen instead has to be reached (``reach``: how far it is from the ray). A disagreement that takes
more than a hair is a mistake of the renderer's scene: a face that is missing, moved or extra.

The hair is what float32 can do wrong: ``16 * 2**-24`` of the coordinates involved (vertices and
origin are rounded once, the intersection takes a handful of operations), and at least 1/64 of a
pixel. Two faces nearer to each other than that along the ray are as good as one.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numba import njit

from scenec.backends.contract import NO_ROW, Rays, Visibility
from scenec.backends.exact.caster import Hits
from scenec.backends.exact.intersect import (
    distance_from_face,
    hit_details,
    ray_frame,
    row_matrix,
)
from scenec.schemas.errors import BackendError
from scenec.schemas.threads import over_threads

HAIR_FLOAT32 = 16.0 * 2.0**-24
HAIR_PIXELS = 1.0 / 64.0
#: Nothing less than a face of this thickness has to be met.
_THIN_PIXELS = 1.0


@dataclass
class Witness:
    """How far a renderer's own first hits are from the exact ones, over all frames.

    Attributes:
        pixels: Compared.
        differing: With another face, or a hit instead of none.
        farthest_px: What the worst of these takes, pixels.
        beyond: Those that take more than a hair.
        unseen: Frames whose rays the renderer cannot follow, or that it does not tell.
    """

    pixels: int = 0
    differing: int = 0
    farthest_px: float = 0.0
    beyond: int = 0
    unseen: int = 0

    def add(self, rays: Rays, hits: Hits, seen: Visibility) -> None:
        """Count a picture.

        Args:
            rays: Of the whole picture.
            hits: The exact ones.
            seen: The renderer's.

        Raises:
            BackendError: Arrays that do not fit the rays.
        """
        n = len(rays.origins)
        if seen.row.shape != (n,) or seen.face.shape != (n,):
            raise BackendError(
                f"the witness has {seen.row.shape} rows and {seen.face.shape} faces; expected "
                f"({n},) of each, one per ray"
            )
        apart = (seen.row != hits.row) | ((seen.face != hits.face) & (hits.row != NO_ROW))
        if rays.known is not None:
            apart &= rays.known
        index = np.flatnonzero(apart)
        takes = np.empty(len(index))
        over_threads(
            _take,
            len(index),
            hits.geometry,
            (rays.origins, rays.directions, rays.shape),
            index,
            (hits.row, hits.face, hits.t),
            (seen.row.astype(np.int32), seen.face.astype(np.int32)),
            takes,
        )
        self.pixels += n if rays.known is None else int(np.count_nonzero(rays.known))
        self.differing += len(index)
        self.beyond += int(np.count_nonzero(takes > HAIR_PIXELS))
        self.farthest_px = max(self.farthest_px, float(takes.max(initial=0.0)))


@njit(cache=True, error_model="numpy")
def _footprint(directions, shape, k):  # type: ignore[no-untyped-def]
    """Distance between the rays of neighboring pixels at ray parameter 1; inf for one pixel."""
    height, width = shape
    x, y = k % width, k // width
    size = 0.0
    for axis in range(2):
        other = k
        if axis == 0 and width > 1:
            other = k + 1 if x + 1 < width else k - 1
        if axis == 1 and height > 1:
            other = k + width if y + 1 < height else k - width
        dx = directions[other, 0] - directions[k, 0]
        dy = directions[other, 1] - directions[k, 1]
        dz = directions[other, 2] - directions[k, 2]
        size = max(size, math.sqrt(dx * dx + dy * dy + dz * dz))
    return size if size > 0.0 else math.inf


@njit(cache=True, error_model="numpy")
def _largest(v):  # type: ignore[no-untyped-def]
    return max(abs(v[0]), max(abs(v[1]), abs(v[2])))


@njit(cache=True, error_model="numpy", nogil=True)
def _take(first, last, g, rays, index, exact, seen, out):  # type: ignore[no-untyped-def]
    """Pixels by which each ray would have to move for the renderer's answer, beyond float32's.

    Args:
        first, last: Range of ``index``.
        g: ``bvh.Geometry``.
        rays: (origins float64 [n, 3], directions float64 [n, 3], (height, width)).
        index: Pixels that differ, int64 [k].
        exact: (row int32 [n], face int32 [n], t float64 [n]).
        seen: (row int32 [n], face int32 [n]).
        out: float64 [k]; inf for a face that is not there at all.
    """
    origins, directions, shape = rays
    for i in range(first, last):
        k = index[i]
        frame = ray_frame(origins[k], directions[k])
        footprint = _footprint(directions, shape, k)
        row, face = seen[0][k], seen[1][k]
        there = row != NO_ROW
        reach, t = 0.0, math.inf
        if there:
            if not (0 <= row < g.row_face.shape[0] and 0 <= face < g.row_faces[row]):
                out[i] = math.inf
                continue
            matrix = row_matrix(g.to_world, row, frame[0], frame[1], frame[2])
            t, reach = distance_from_face(g.points, g.faces[g.row_face[row] + face], matrix, frame)
        pixel = min(exact[2][k], t) * footprint
        float32 = (
            HAIR_FLOAT32
            * 2.0
            * (_largest(origins[k]) + min(exact[2][k], t) * _largest(directions[k]))
        )
        skip = 0.0
        # As near as float32 tells apart along the ray: either one is a fair answer.
        if exact[0][k] != NO_ROW and t - exact[2][k] > float32 / _largest(directions[k]):
            matrix = row_matrix(g.to_world, exact[0][k], frame[0], frame[1], frame[2])
            _, margin, size = hit_details(
                g.points, g.faces[g.row_face[exact[0][k]] + exact[1][k]], matrix, frame
            )
            if size > _THIN_PIXELS * pixel:
                skip = margin
        out[i] = max(0.0, max(skip, reach) - float32) / pixel


__all__ = ["HAIR_FLOAT32", "HAIR_PIXELS", "Witness"]
