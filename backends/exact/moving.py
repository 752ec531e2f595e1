"""Rows that move: a second, small tree over them, built anew for the sample that is asked for.

The trees over the meshes' triangles and the tree over the rows that stand are those of all samples.
Only the entries of moving rows in ``bvh.Geometry``'s tables change, in place.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from scenec.backends.exact.build import build_forest, empty_nodes, forest_room
from scenec.backends.exact.bvh import (
    LEAF_ROWS,
    ROW_COST,
    Balls,
    Geometry,
    mesh_balls,
    place_rows,
)
from scenec.backends.stage.scene import Motion, RenderScene
from scenec.schemas.errors import BackendError

#: Widens boxes beyond any ray, yet leaves room below the largest float64.
_WITHOUT_END = 1e200


class MovingRows:
    """Poses a scene's moving rows.

    Args:
        scene: The scene.
        motion: Of its rows.
        geometry: Its own; its tables of nodes and entries are copied, with room for a tree over
            the rows that move.

    Raises:
        BackendError: A matrix is not finite.
    """

    def __init__(self, scene: RenderScene, motion: Motion, geometry: Geometry) -> None:
        finite = np.isfinite(motion.to_world).all(axis=(2, 3))
        if not finite.all():
            sample, at = np.argwhere(~finite)[0].tolist()
            raise BackendError(
                f"row {motion.rows[at]}: the local-to-world matrix of sample {sample} holds values "
                "that are not finite"
            )
        self._rows: NDArray[np.int64] = motion.rows.astype(np.int64)
        self._path = motion.to_world
        self._mesh = scene.rows.mesh[motion.rows].astype(np.int64)
        self._balls: Balls = mesh_balls(scene)
        self._extent = geometry.extent
        self._first_node, self._first_entry = len(geometry.row_nodes), len(geometry.row_order)
        self._nodes, self._links = empty_nodes(self._first_node + forest_room(len(self._rows)))
        self._nodes[: self._first_node] = geometry.row_nodes
        self._entries = np.zeros(self._first_entry + len(self._rows), np.int32)
        self._entries[: self._first_entry] = geometry.row_order

    def pose(self, g: Geometry, sample: int) -> Geometry:
        """The geometry as it is at a sample; tables of rows are changed in place.

        Args:
            g: The scene's geometry, posed as at any sample.
            sample: Time code.
        """
        rows, to_world = self._rows, np.ascontiguousarray(self._path[sample])
        placed = place_rows(to_world, self._mesh, self._balls)
        odd = placed.used & ~placed.regular
        # A tree in the world frame for each sample would cost more than it spares: such a row is
        # tested face by face.
        placed.to_local[odd] = 0.0
        placed.pad[odd] = [[_WITHOUT_END] * 3, [0.0] * 3]
        g.to_world[rows] = to_world
        g.to_local[rows] = placed.to_local
        g.pad[rows] = placed.pad
        g.row_spheres[rows] = placed.spheres
        present = np.flatnonzero(placed.used)
        reach = float(placed.reach[present].max(initial=0.0))
        return self._with_tree(g, placed.boxes[present], rows[present])._replace(
            extent=max(self._extent, reach)
        )

    def _with_tree(
        self, g: Geometry, boxes: NDArray[np.float32], rows: NDArray[np.int64]
    ) -> Geometry:
        """With a tree over these rows, in the room that is kept behind the tree of the others."""
        if not len(rows):
            return g._replace(moving_tree=-1)
        ranges = np.array([[0, len(rows)]], np.int64)
        nodes, links, order, roots = build_forest(boxes, ranges, LEAF_ROWS, ROW_COST)
        # Children that are nodes are numbered by node, leaves by entry.
        leaf = links[:, 14:16] > 0
        links[:, 12:14] += np.where(leaf, self._first_entry, self._first_node).astype(np.int32)
        self._nodes[self._first_node : self._first_node + len(nodes)] = nodes
        self._entries[self._first_entry : self._first_entry + len(rows)] = rows[order]
        return g._replace(
            row_nodes=self._nodes,
            row_links=self._links,
            row_order=self._entries,
            moving_tree=self._first_node + int(roots[0]),
        )
