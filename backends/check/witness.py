"""Does a renderer see what the annotation says: its own first hits against the exact ones.

A renderer works in float32, and a rasterizer rounds vertices to fractions of a pixel: its ray is
the exact one moved by a hair. So where the two disagree, exact rays are cast in a ring around the
pixel's center, in wider and wider ones, until one of them answers as the renderer did: the least
radius that explains the disagreement, in pixels. One that takes more than a hair is a mistake of
the renderer's scene: a face that is missing, moved, extra or numbered wrongly.

The hair is 1/64 of a pixel, or what float32 can do wrong where that is more: ``16 * 2**-24`` of the
coordinates involved (vertices and origin are rounded once, the intersection takes a handful of
operations). Faces that are smaller than a ring's step are met by no ray of it: there it is enough
that the renderer's face lies within the radius, at a depth between those of the ring on its row, or
within a hair and nearer than what the exact ray meets.

Renderers that are not watertight (Embree's fast traversal, in Mitsuba) let a ray slip between two
faces now and then, and see what lies behind: that is as far off as the nearest edge of the face
that is missed.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from operator import methodcaller

import numpy as np
from numpy.typing import NDArray

from scenec.backends.contract import NO_ROW, Rays, Visibility
from scenec.backends.exact.caster import ExactCaster, Hits
from scenec.backends.exact.cutouts import face_is_opaque
from scenec.backends.exact.intersect import distance_from_face, ray_frame, row_matrix
from scenec.backends.run.executors import one_worker
from scenec.backends.run.frames import opening_of
from scenec.backends.run.plan import RenderPlan
from scenec.backends.run.units import OfSession
from scenec.schemas.errors import BackendError
from scenec.schemas.kernels import kernel
from scenec.schemas.manifest import Batch
from scenec.schemas.threads import over_threads
from scenec.schemas.units import run_all

HAIR_FLOAT32 = 16.0 * 2.0**-24
HAIR_PIXELS = 1.0 / 64.0
#: Radii of the rings, pixels.
RADII = (1.0 / 1024.0, 1.0 / 256.0, HAIR_PIXELS, 1.0 / 16.0, 1.0 / 4.0, 1.0)
_RAYS = 8


@dataclass
class Witness:
    """Accumulates how far a renderer's own first hits are from the exact ones, over all frames.

    Attributes:
        pixels: Compared.
        differing: With another face, or a hit instead of none.
        farthest_px: The largest radius that explains one of these: 0 or one of ``RADII``, more
            where float32 is coarser; inf if none does.
        beyond: Those that take more than a hair.
        unseen: Frames whose rays the renderer cannot follow, or that it does not tell.
        dependent: Frames whose first hits the exact caster found for the renderer.
    """

    pixels: int = 0
    differing: int = 0
    farthest_px: float = 0.0
    beyond: int = 0
    unseen: int = 0
    dependent: int = 0

    def add(self, caster: ExactCaster, rays: Rays, visibility: Visibility) -> None:
        """Count a picture.

        Args:
            caster: Posed as at the sample.
            rays: Of the whole picture.
            visibility: What the renderer met along them.

        Raises:
            BackendError: Arrays that do not fit the rays.
        """
        n = len(rays.origins)
        if visibility.row.shape != (n,) or visibility.face.shape != (n,):
            raise BackendError(
                f"the witness has {visibility.row.shape} rows and {visibility.face.shape} faces; "
                f"expected ({n},) of each, one per ray"
            )
        self.dependent += not visibility.independent
        hits = caster.hits(rays)
        apart = (visibility.row != hits.row) | (
            (visibility.face != hits.face) & (hits.row != NO_ROW)
        )
        if rays.known is not None:
            apart &= rays.known
        index = np.flatnonzero(apart)
        radius, hair = _explain(caster, rays, hits, visibility, index)
        self.pixels += n if rays.known is None else int(np.count_nonzero(rays.known))
        self.differing += len(index)
        self.beyond += int(np.count_nonzero(radius > hair))
        self.farthest_px = max(self.farthest_px, float(radius.max(initial=0.0)))


def ask(
    batch: Batch, plan: RenderPlan, places: Sequence[tuple[int, int]]
) -> Iterator[Visibility | None]:
    """Yields a renderer's own first hits of a batch's frames, from a process of its own.

    Args:
        batch: The batch.
        plan: Names the backend; its ``passes`` hold ``rgb``, or no renderer starts.
        places: Samples and numbers of cameras.

    Yields:
        For each place, what it sees; None if it does not tell.

    Raises:
        ScenecError: The stage cannot be read, or the backend does not start.
    """
    holds = opening_of(batch, plan)
    units = (
        OfSession(
            holds,
            f"{plan.backend}: {batch.name}/{sample:06d}",
            methodcaller("witness", camera, sample),
        )
        for sample, camera in places
    )
    # One: what it sees comes in order.
    with one_worker() as executor:
        for _, outcome in run_all(executor, units):
            yield outcome.result()


def _explain(
    caster: ExactCaster, rays: Rays, hits: Hits, visibility: Visibility, index: NDArray[np.int64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Least radii that explain some pixels' answers, and the hair there; float64 [k], pixels."""
    row, face = visibility.row[index].astype(np.int32), visibility.face[index].astype(np.int32)
    origins, directions = rays.origins[index], rays.directions[index]
    t, reach = np.empty(len(index)), np.empty(len(index))
    over_threads(
        _nearest, len(index), hits.geometry, (origins, directions), (row, face), (t, reach)
    )
    across, down = _steps(rays)
    across, down = across[index], down[index]
    near = np.minimum(t, hits.t[index])
    # A face that is not there, where nothing is: no radius explains it.
    near = np.where(np.isfinite(near), near, 0.0)
    pixel = near * np.sqrt(np.maximum((across * across).sum(axis=1), (down * down).sum(axis=1)))
    magnitude = np.abs(origins).max(axis=1) + near * np.abs(directions).max(axis=1)
    float32 = 2.0 * HAIR_FLOAT32 * magnitude
    scale = np.maximum(1.0, float32 / np.where(pixel > 0.0, pixel, np.inf) / HAIR_PIXELS)
    none = row == NO_ROW
    # As near as float32 tells apart along the ray: either one is a fair answer.
    length = np.abs(directions).max(axis=1)
    with np.errstate(invalid="ignore"):
        tie = (reach <= float32) & (np.abs(t - hits.t[index]) * length <= float32)
    radius = np.where(tie, 0.0, np.inf)
    on_row = (hits.row[index] == row) & ~none
    low = np.where(on_row, hits.t[index], np.inf)
    high = np.where(on_row, hits.t[index], -np.inf)
    edge = np.full(len(index), np.inf)
    for ring in RADII:
        left = np.flatnonzero(np.isinf(radius))
        if not len(left):
            break
        for turn in np.arange(_RAYS) * (2.0 * np.pi / _RAYS):
            move = np.cos(turn) * across[left] + np.sin(turn) * down[left]
            moved = directions[left] + (ring * scale[left])[:, None] * move
            around = replace(
                rays, origins=origins[left], directions=moved, shape=(1, len(left)),
                depth=None, known=None,
            )  # fmt: skip
            row_there, face_there, t_there = caster.cast(around)
            own = index[left]
            other = left[(row_there != hits.row[own]) | (face_there != hits.face[own])]
            edge[other] = np.minimum(edge[other], ring * scale[other])
            same = row_there == row[left]
            found = same & (none[left] | (face_there == face[left]))
            radius[left[found]] = np.minimum(radius[left[found]], ring * scale[left[found]])
            on = left[same & ~none[left]]
            low[on] = np.minimum(low[on], t_there[same & ~none[left]])
            high[on] = np.maximum(high[on], t_there[same & ~none[left]])
        slack = (high - low) + float32 / length
        within = (t >= low - slack) & (t <= high + slack) & (reach <= ring * scale * pixel)
        radius[within] = np.minimum(radius[within], (ring * scale)[within])
    # The tip of a leaf or of a needle that the ray passes: no ray of a ring need meet it.
    ahead = ~none & (t < hits.t[index]) & (reach <= HAIR_PIXELS * scale * pixel)
    radius[ahead] = np.minimum(radius[ahead], HAIR_PIXELS * scale[ahead])
    left = np.flatnonzero((radius > edge) & (hits.row[index] != NO_ROW))
    if len(left):
        beyond = (hits.t[index] + float32 / length)[left, None] * directions[left]
        behind = replace(
            rays, origins=origins[left] + beyond, directions=directions[left],
            shape=(1, len(left)), depth=None, known=None,
        )  # fmt: skip
        row_there, face_there, _ = caster.cast(behind)
        slipped = left[(row_there == row[left]) & (none[left] | (face_there == face[left]))]
        radius[slipped] = edge[slipped]
    return radius, HAIR_PIXELS * scale


def _steps(rays: Rays) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """From each ray's direction to those of the next column and row, float64 [n, 3] each."""
    d = rays.directions.reshape(*rays.shape, 3)
    across, down = np.zeros_like(d), np.zeros_like(d)
    if d.shape[1] > 1:
        across[:, :-1] = d[:, 1:] - d[:, :-1]
        across[:, -1] = across[:, -2]
    if d.shape[0] > 1:
        down[:-1] = d[1:] - d[:-1]
        down[-1] = down[-2]
    return across.reshape(-1, 3), down.reshape(-1, 3)


@kernel
def _nearest(first, last, g, rays, reported, nearest):  # type: ignore[no-untyped-def]
    """Computes the distance of a ray from the face that a renderer reports for it.

    Args:
        first, last: Range of the rays.
        g: ``bvh.Geometry``.
        rays: (origins float64 [k, 3], directions float64 [k, 3]).
        reported: (row int32 [k], face int32 [k]).
        nearest: (t, distance), float64 [k]; inf for a face that is not there, or is cut out there.
    """
    for k in range(first, last):
        row, face = reported[0][k], reported[1][k]
        nearest[0][k] = np.inf
        nearest[1][k] = np.inf
        if 0 <= row < g.row_face.shape[0] and 0 <= face < g.row_faces[row]:
            frame = ray_frame(rays[0][k], rays[1][k])
            matrix = row_matrix(g.to_world, row, frame[0], frame[1], frame[2])
            at = g.row_face[row] + face
            t, away = distance_from_face(g.points, g.faces[at], matrix, frame)
            # What is cut out is not there; where its contour is near, rays of a ring meet it.
            if away > 0.0 or face_is_opaque(g.cutouts, g, row, at, matrix, frame):
                nearest[0][k], nearest[1][k] = t, away
