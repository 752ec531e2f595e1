"""Rows that a stage is expanded to: parts of them joined, placed and put between one another."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from scenec.backends.stage.frame import composed

_IDENTITY = np.eye(4)[:3]


@dataclass(frozen=True)
class Expanded:
    """Rows to be: arrays as in ``stage.scene.Rows``, matrices in stage units.

    Attributes:
        instance_id: Frame ids; of labeled prims (``labeled_instances``) the number below 0, until
            ``Expander.expand`` gives it an id.
        moving: Rows that (may) move, ascending, int64 [k].
        path: Their matrices, float64 [samples, k, 3, 4]; None where there are none.
    """

    mesh: NDArray[np.int32]
    matrix: NDArray[np.float64]
    instance_id: NDArray[np.int64]
    variation: NDArray[np.float32]
    part: NDArray[np.int32]
    moving: NDArray[np.int64] = field(default_factory=lambda: np.zeros(0, np.int64))
    path: NDArray[np.float64] | None = None

    @classmethod
    def of(
        cls,
        mesh: NDArray[np.int32],
        poses: NDArray[np.float64],
        instance_id: NDArray[np.int64],
        variation: NDArray[np.float32],
        part: NDArray[np.int32],
    ) -> Expanded:
        """Rows that stand (poses [r, 3, 4]) or that all may move ([samples, r, 3, 4])."""
        if poses.ndim == 3:
            return cls(mesh, poses, instance_id, variation, part)
        return cls(mesh, poses[0], instance_id, variation, part, np.arange(len(mesh)), poses)

    @classmethod
    def joined(cls, parts: Sequence[Expanded]) -> Expanded:
        """All rows of all parts, in order."""
        if len(parts) == 1:
            return parts[0]
        starts = np.cumsum([0, *(len(p.mesh) for p in parts)])
        paths = [p.path for p in parts if p.path is not None]
        return cls(
            np.concatenate([np.zeros(0, np.int32), *(p.mesh for p in parts)]),
            np.concatenate([np.zeros((0, 3, 4)), *(p.matrix for p in parts)]),
            np.concatenate([np.zeros(0, np.int64), *(p.instance_id for p in parts)]),
            np.concatenate([np.zeros(0, np.float32), *(p.variation for p in parts)]),
            np.concatenate([np.zeros(0, np.int32), *(p.part for p in parts)]),
            np.concatenate(
                [
                    np.zeros(0, np.int64),
                    *(p.moving + s for p, s in zip(parts, starts, strict=False)),
                ]
            ),
            np.concatenate(paths, axis=1) if paths else None,
        )

    @property
    def poses(self) -> NDArray[np.float64]:
        """All matrices: [r, 3, 4] where nothing moves, else [samples, r, 3, 4]."""
        if self.path is None:
            return self.matrix
        poses = np.repeat(self.matrix[None], len(self.path), axis=0)
        poses[:, self.moving] = self.path
        return poses

    def settled(self) -> Expanded:
        """The same; what does not move after all is no longer said to."""
        if self.path is None:
            return self
        moves = (self.path != self.path[:1]).any(axis=(0, 2, 3))
        path = self.path[:, moves] if moves.any() else None
        return replace(self, moving=self.moving[moves], path=path)


def placed(world: NDArray[np.float64], content: NDArray[np.float64]) -> NDArray[np.float64]:
    """Every row of some content at every instance: [..., n, 3, 4] and [..., m, 3, 4], n * m."""
    if content.shape == (1, 3, 4) and (content[0] == _IDENTITY).all():
        return world
    if world.shape == (1, 3, 4) and (world[0] == _IDENTITY).all():
        return content
    each = composed(world[..., :, None, :, :], content[..., None, :, :, :])
    return each.reshape(*each.shape[:-4], -1, 3, 4)


def interleaved(total: int, parts: list[tuple[NDArray[np.int64], Expanded]]) -> Expanded:
    """Rows from several parts, each at its places: all of ``range(total)``."""
    if len(parts) == 1:
        return parts[0][1]
    mesh = np.empty(total, np.int32)
    matrix = np.empty((total, 3, 4))
    ids = np.empty(total, np.int64)
    variation = np.empty(total, np.float32)
    part = np.empty(total, np.int32)
    moving, paths = [np.zeros(0, np.int64)], []
    for at, rows in parts:
        mesh[at], matrix[at], ids[at] = rows.mesh, rows.matrix, rows.instance_id
        variation[at], part[at] = rows.variation, rows.part
        if rows.path is not None:
            moving.append(at[rows.moving])
            paths.append(rows.path)
    which = np.concatenate(moving)
    order = np.argsort(which, kind="stable")
    path = np.concatenate(paths, axis=1)[:, order] if paths else None
    return Expanded(mesh, matrix, ids, variation, part, which[order], path)
