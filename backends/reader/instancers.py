"""Expands prims into rows: single meshes, point instancers, and instancers within instancers."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from pxr import Usd, UsdGeom

from scenec.backends.reader.frame import columns, composed
from scenec.backends.reader.labels import prim_labels
from scenec.backends.reader.meshes import MeshTable
from scenec.backends.reader.surfaces import read_variation
from scenec.schemas import stage as names
from scenec.schemas.errors import StageError

_IDENTITY = np.eye(4)[:3]
#: A local id above this would leave no room for others.
_LARGEST_LOCAL_ID = 2**31


@dataclass(frozen=True)
class Expanded:
    """Rows to be: arrays as in ``render_scene.Rows``, matrices in stage units."""

    mesh: NDArray[np.int32]
    matrix: NDArray[np.float64]
    instance_id: NDArray[np.uint32]
    variation: NDArray[np.float32]

    @classmethod
    def empty(cls) -> Expanded:
        """No rows."""
        return cls(
            np.zeros(0, np.int32),
            np.zeros((0, 3, 4)),
            np.zeros(0, np.uint32),
            np.zeros(0, np.float32),
        )

    @classmethod
    def joined(cls, parts: list[Expanded]) -> Expanded:
        """All rows of all parts, in order."""
        parts = [cls.empty(), *parts]
        return cls(
            np.concatenate([p.mesh for p in parts]),
            np.concatenate([p.matrix for p in parts]),
            np.concatenate([p.instance_id for p in parts]),
            np.concatenate([p.variation for p in parts]),
        )


class Expander:
    """Walks a stage; remembers meshes and which ids are taken."""

    def __init__(self, meshes: MeshTable, time: Usd.TimeCode):
        self._meshes = meshes
        self._time = time
        self._next_id = 0
        #: Instancers being expanded, the outermost first.
        self._open: list[str] = []
        #: First frame id (less one) of each instancer, by path.
        self.bases: dict[str, int] = {}

    def expand(
        self,
        root: Usd.Prim,
        parent: NDArray[np.float64],
        inherited: dict[str, int],
        instance_id: int | None = None,
    ) -> Expanded:
        """Rows of everything visible at or below a prim.

        Args:
            root: Where to begin.
            parent: Matrix of the frame that ``root`` stands in, [3, 4].
            inherited: Labels of the instancer around it.
            instance_id: Id of the instance this is part of; None outside of instancers.
        """
        parts: list[Expanded] = []
        self._walk(root, parent, inherited, instance_id, parts)
        return Expanded.joined(parts)

    def _walk(
        self,
        prim: Usd.Prim,
        parent: NDArray[np.float64],
        inherited: dict[str, int],
        instance_id: int | None,
        parts: list[Expanded],
    ) -> None:
        if not _is_shown(prim, self._time):
            return
        matrix = self._local_to_world(prim, parent)
        if instance_id is None and not prim.IsPseudoRoot():
            own = prim.GetAttribute(names.ATTR_INSTANCE_ID)
            if own and own.HasValue():
                instance_id = int(own.Get())
        if prim.IsA(UsdGeom.PointInstancer):
            instancer = UsdGeom.PointInstancer(prim)
            path = str(prim.GetPath())
            if path in self._open:
                raise StageError(f"{path}: is a part of its own prototypes")
            self._open.append(path)
            parts.append(self._expand_instancer(instancer, matrix, inherited, instance_id))
            self._open.pop()
            return
        if prim.IsA(UsdGeom.Mesh):
            found = self._meshes.add(prim, inherited)
            parts.append(
                Expanded(
                    np.array(found, np.int32),
                    np.repeat(matrix[None], len(found), axis=0),
                    np.full(len(found), instance_id or 0, np.uint32),
                    np.zeros(len(found), np.float32),
                )
            )
        for child in prim.GetFilteredChildren(Usd.TraverseInstanceProxies()):
            self._walk(child, matrix, inherited, instance_id, parts)

    def _local_to_world(self, prim: Usd.Prim, parent: NDArray[np.float64]) -> NDArray[np.float64]:
        xformable = UsdGeom.Xformable(prim)
        if not xformable:
            return parent
        local = columns(xformable.GetLocalTransformation(self._time))
        return local if xformable.GetResetXformStack() else composed(parent, local)

    def _expand_instancer(
        self,
        instancer: UsdGeom.PointInstancer,
        matrix: NDArray[np.float64],
        inherited: dict[str, int],
        instance_id: int | None,
    ) -> Expanded:
        prim = instancer.GetPrim()
        prototype, local = self._instance_matrices(instancer)
        count = len(prototype)
        if instance_id is None:
            ids = self._frame_ids(instancer, count)
        else:
            # Inside another instancer: all of it is part of the outer instance.
            ids = np.full(count, instance_id, np.uint32)
        variation = read_variation(prim, count)
        if variation is None:
            variation = np.zeros(count, np.float32)
        shown = np.ones(count, bool)
        mask = instancer.ComputeMaskAtTime(self._time)
        if len(mask):
            shown = np.array(mask, bool)
        labels = {**inherited, **prim_labels(prim, self._meshes.labels)}
        targets = instancer.GetPrototypesRel().GetForwardedTargets()
        world = composed(matrix, local)
        parts = []
        order = []
        for index, target in enumerate(targets):
            chosen = np.flatnonzero((prototype == index) & shown)
            if not len(chosen):
                continue
            root = prim.GetStage().GetPrimAtPath(target)
            if not root:
                raise StageError(f"{prim.GetPath()}: prototype {target} does not exist")
            # Id 0 here only says "inside of an instance"; the true one is set below.
            content = self.expand(root, _IDENTITY, labels, instance_id=0)
            rows = len(content.mesh)
            each = composed(world[chosen][:, None], content.matrix[None, :])
            parts.append(
                Expanded(
                    np.tile(content.mesh, len(chosen)),
                    each.reshape(-1, 3, 4),
                    np.repeat(ids[chosen], rows),
                    np.repeat(variation[chosen], rows) + np.tile(content.variation, len(chosen)),
                )
            )
            order.append(np.repeat(chosen, rows))
        if not parts:
            return Expanded.empty()
        joined = Expanded.joined(parts)
        # Rows in the order of the instances, whatever prototype they have.
        by_instance = np.argsort(np.concatenate(order), kind="stable")
        return Expanded(
            joined.mesh[by_instance],
            joined.matrix[by_instance],
            joined.instance_id[by_instance],
            joined.variation[by_instance],
        )

    def _instance_matrices(
        self, instancer: UsdGeom.PointInstancer
    ) -> tuple[NDArray[np.int32], NDArray[np.float64]]:
        """Prototype and matrix (in the instancer's frame) of each instance."""
        path = instancer.GetPrim().GetPath()
        time = self._time
        prototype = np.array(instancer.GetProtoIndicesAttr().Get(time) or (), np.int32)
        count = len(prototype)
        positions = _array(path, "positions", instancer.GetPositionsAttr().Get(time), count, 3)
        scales = _array(path, "scales", instancer.GetScalesAttr().Get(time), count, 3)
        turns = instancer.GetOrientationsfAttr().Get(time) or instancer.GetOrientationsAttr().Get(
            time
        )
        quaternions = _array(path, "orientations", turns, count, 4)
        targets = len(instancer.GetPrototypesRel().GetForwardedTargets())
        if count and (prototype.min() < 0 or prototype.max() >= targets):
            raise StageError(
                f"{path}: protoIndices name a prototype beyond the {targets} there are"
            )
        if positions is None and count:
            raise StageError(f"{path}: has {count} protoIndices but no positions")
        matrix = np.zeros((count, 3, 4))
        matrix[:, :, :3] = np.eye(3) if quaternions is None else rotations(quaternions)
        if scales is not None:
            matrix[:, :, :3] *= scales[:, None, :]
        if positions is not None:
            matrix[:, :, 3] = positions
        return prototype, matrix

    def _frame_ids(self, instancer: UsdGeom.PointInstancer, count: int) -> NDArray[np.uint32]:
        prim = instancer.GetPrim()
        authored = prim.GetAttribute(names.ATTR_INSTANCE_ID_BASE)
        base = int(authored.Get()) if authored and authored.HasValue() else self._next_id
        local = np.array(instancer.GetIdsAttr().Get(self._time) or (), np.int64)
        usable = len(local) == count and (
            count == 0 or (local.min() >= 1 and local.max() < _LARGEST_LOCAL_ID)
        )
        if not usable:
            # Foreign ids may start at 0 or be missing: the place in the array then counts.
            local = np.arange(1, count + 1, dtype=np.int64)
        self._next_id = max(self._next_id, base + int(local.max(initial=0)))
        self.bases[str(prim.GetPath())] = base
        enabled = prim.GetAttribute(names.ATTR_INSTANCE_IDS_ENABLED)
        if enabled and enabled.Get() is False:
            return np.zeros(count, np.uint32)
        if base + int(local.max(initial=0)) >= 2**32:
            raise StageError(f"{prim.GetPath()}: instance ids do not fit into 32 bits")
        return (base + local).astype(np.uint32)


def rotations(quaternions: NDArray[np.float64]) -> NDArray[np.float64]:
    """Rotation matrices of quaternions (x, y, z, w), normalized here: float64 [n, 3, 3].

    A zero quaternion stands for no rotation.
    """
    length = np.sqrt((quaternions * quaternions).sum(axis=1))
    safe = np.where(length > 0.0, length, 1.0)
    x, y, z, w = (quaternions / safe[:, None]).T
    w = np.where(length > 0.0, w, 1.0)
    return np.stack(
        [
            np.stack([1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)], axis=1),
            np.stack([2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)], axis=1),
            np.stack([2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)], axis=1),
        ],
        axis=1,
    )


def _array(
    path: object, name: str, values: object, count: int, width: int
) -> NDArray[np.float64] | None:
    """An instancer's attribute as float64 [count, width]; None where it is not authored."""
    if values is None or len(values) == 0:  # type: ignore[arg-type]
        return None
    array = np.array(values, np.float64).reshape(-1, width)
    if len(array) != count:
        raise StageError(f"{path}: {count} protoIndices, but {len(array)} {name}")
    if not np.isfinite(array).all():
        raise StageError(f"{path}: {name} hold NaN or infinity")
    return array


def _is_shown(prim: Usd.Prim, time: Usd.TimeCode) -> bool:
    """Whether a prim (and what is below it) is rendered: visible, purpose default or render."""
    imageable = UsdGeom.Imageable(prim)
    if not imageable:
        return True
    if imageable.GetVisibilityAttr().Get(time) == UsdGeom.Tokens.invisible:
        return False
    purpose = imageable.ComputePurpose()
    return purpose in (UsdGeom.Tokens.default_, UsdGeom.Tokens.render)
