"""The exact ray caster: nearest hit of rays with a RenderScene, in float64."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scenec.backends.contract import NO_ROW, Rays
from scenec.backends.exact.bvh import Geometry, build_geometry
from scenec.backends.exact.cutouts import face_is_opaque
from scenec.backends.exact.intersect import hit_parameter, ray_frame, row_matrix
from scenec.backends.exact.moving import MovingRows
from scenec.backends.exact.packets import trace_picture
from scenec.backends.exact.trace import Beams, BestHits, trace_all
from scenec.backends.stage.scene import RenderScene
from scenec.schemas.kernels import kernel
from scenec.schemas.threads import over_threads


@kernel
def _test_all(first, last, g, beams, index, hits):  # type: ignore[no-untyped-def]
    for k in range(first, last):
        row, face = hits.row[k], hits.face[k]
        hits.t[k] = np.inf
        if 0 <= row < g.row_face.shape[0] and 0 <= face < g.row_faces[row]:
            frame = ray_frame(beams.origins[index[k]], beams.directions[index[k]])
            matrix = row_matrix(g.to_world, row, frame[0], frame[1], frame[2])
            at = g.row_face[row] + face
            if face_is_opaque(g.cutouts, g, row, at, matrix, frame):
                hits.t[k] = hit_parameter(g.points, g.faces[at], matrix, frame)


def _nothing(count: int) -> BestHits:
    return BestHits(
        np.full(count, NO_ROW, np.int32), np.zeros(count, np.int32), np.full(count, np.inf)
    )


@dataclass(frozen=True)
class Hits:
    """First hits of a table of rays, exact.

    Attributes:
        row: int32 [n], NO_ROW where nothing is hit.
        face: int32 [n], 0 where nothing is hit.
        t: Ray parameter (planar depth for a pinhole camera), float64 [n], +inf without a hit.
        geometry: What ``row`` and ``face`` refer to.
    """

    row: NDArray[np.int32]
    face: NDArray[np.int32]
    t: NDArray[np.float64]
    geometry: Geometry


class ExactCaster:
    """Casts rays at a scene; what it answers is what annotation is defined to be.

    Results do not depend on the number of threads. Holds no state but the scene's geometry, posed
    as at one sample: the first, until ``pose`` is told another.

    Args:
        scene: The scene; ``meshes`` and ``rows`` are read and copied.

    Attributes:
        geometry: Flat arrays and hierarchies.

    Raises:
        BackendError: The scene's arrays are broken (see ``bvh.build_geometry``).
    """

    def __init__(self, scene: RenderScene):
        self.geometry: Geometry = build_geometry(scene)
        self._moving = None
        self._sample = 0
        motion = scene.rows.motion
        if motion is not None and len(motion.rows):
            self._moving = MovingRows(scene, motion, self.geometry)
            self.geometry = self._moving.pose(self.geometry, 0)

    def pose(self, sample: int) -> None:
        """Take everything as it is at a sample. Earlier hits can no longer be annotated.

        Costs nothing where nothing moves, and else what the rows that move cost.
        """
        if self._moving is not None and sample != self._sample:
            self.geometry = self._moving.pose(self.geometry, sample)
            self._sample = sample

    def cast(
        self, rays: Rays, index: NDArray[np.int64] | None = None
    ) -> tuple[NDArray[np.int32], NDArray[np.int32], NDArray[np.float64]]:
        """First hit of each ray; of equal parameters the lowest (row, face).

        Args:
            rays: The table of rays.
            index: Which rays to cast, int64 [k]; None: all.

        Returns:
            (row int32 [k], face int32 [k], t float64 [k]): NO_ROW, 0 and +inf where nothing is hit;
            t is in units of the direction's length.
        """
        beams = Beams(rays.origins, rays.directions)
        found = _nothing(len(rays.origins) if index is None else len(index))
        if index is None:
            trace_picture(self.geometry, beams, rays.shape, None, found)
        else:
            trace_all(self.geometry, beams, index.astype(np.int64), found)
        return found

    def hits(self, rays: Rays) -> Hits:
        """First hits of all rays; pixels without a ray (``Rays.known``) hit nothing."""
        found = _nothing(len(rays.origins))
        beams = Beams(rays.origins, rays.directions)
        trace_picture(self.geometry, beams, rays.shape, rays.known, found)
        return Hits(*found, self.geometry)

    def test(
        self,
        rays: Rays,
        index: NDArray[np.int64],
        row: NDArray[np.int32],
        face: NDArray[np.int32],
    ) -> NDArray[np.float64]:
        """Parameter at which each ray meets one given triangle.

        Args:
            rays: The table of rays.
            index: Which rays, int64 [k].
            row: Row of the triangle for each, int32 [k]; a row that is not there is not hit.
            face: Its face, int32 [k]; likewise.

        Returns:
            t, float64 [k]; +inf where the triangle is missed, or cut out.
        """
        found = BestHits(row, face, np.empty(len(index)))
        beams = Beams(rays.origins, rays.directions)
        over_threads(_test_all, len(index), self.geometry, beams, index, found)
        return found.t
