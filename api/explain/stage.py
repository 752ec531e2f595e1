"""Reads a stage's content, of the terrain and of each class of objects, by prim."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenec.schemas import stage as names
from scenec.schemas.errors import StageError

_TERRAIN = f"{names.ROOT}/Terrain"
_OBJECTS = f"{names.ROOT}/Objects"
#: Single objects are named by their local ids.
_SINGLE = "instance_"


@dataclass(frozen=True)
class ClassContents:
    """One class of objects.

    Attributes:
        path: Of its prim.
        base: What is added to a local id to get the frame id; None: it has no ids.
        ids: Local ids, ascending, int64 [n]; None where the stage has none.
        single: Whether each object is a prim of its own.
        meshes: Names of the prototypes.
        triangles: Of each prototype, int64 [p].
        which: Prototype of each instance, int64 [n].
        positions: World, at the first sample, float64 [n, 3].
        scales: Largest factor of an instance, float64 [n].
    """

    path: str
    base: int | None
    ids: NDArray[np.int64] | None
    single: bool
    meshes: tuple[str, ...]
    triangles: NDArray[np.int64]
    which: NDArray[np.int64]
    positions: NDArray[np.float64]
    scales: NDArray[np.float64]

    @property
    def count(self) -> int:
        """Number of instances."""
        return len(self.which)

    @property
    def drawn_triangles(self) -> int:
        """Triangles of all instances, each counted."""
        return int(self.triangles[self.which].sum())


@dataclass(frozen=True)
class StageContents:
    """A stage's geometry.

    Attributes:
        tiles: Triangles of each tile of the terrain, by prim name.
        classes: By name, in the stage's order.
        needs_ids: Whether a camera asks for instances.
    """

    tiles: dict[str, int]
    classes: dict[str, ClassContents]
    needs_ids: bool

    @property
    def instances(self) -> int:
        """Number of all objects."""
        return sum(one.count for one in self.classes.values())

    @property
    def triangles(self) -> int:
        """Counts triangles of the terrain and of all objects, each instance counted."""
        objects = sum(one.drawn_triangles for one in self.classes.values())
        return sum(self.tiles.values()) + objects


def read_contents(path: Path) -> StageContents:
    """Reads what a stage of ours holds.

    Args:
        path: Its root layer.

    Raises:
        StageError: It cannot be read, or is not whole.
    """
    from scenec.backends.stage.sources import open_stage

    with open_stage(path) as stage:
        try:
            return _contents(stage)
        except (TypeError, ValueError, IndexError, AttributeError, OverflowError) as error:
            raise StageError(f"{path}: is no stage that scenec compiled: {error}") from error


def _contents(stage: Any) -> StageContents:
    from pxr import UsdGeom

    terrain, objects = stage.GetPrimAtPath(_TERRAIN), stage.GetPrimAtPath(_OBJECTS)
    tiles = {}
    for prim in terrain.GetChildren() if terrain else ():
        if prim.IsA(UsdGeom.Mesh):
            tiles[prim.GetName()] = _faces(prim)
    classes = {}
    for prim in objects.GetChildren() if objects else ():
        read = _scattered if prim.IsA(UsdGeom.PointInstancer) else _single
        classes[prim.GetName()] = read(prim)
    asked = (stage.GetPrimAtPath(f"{names.RENDER_SCOPE}/Vars/{n}") for n in ("instance", "amodal"))
    return StageContents(tiles, classes, any(map(bool, asked)))


def _faces(root: object) -> int:
    """Triangles of all meshes at or below a prim."""
    from pxr import Usd, UsdGeom

    return sum(
        len(UsdGeom.Mesh(prim).GetFaceVertexCountsAttr().Get() or ())
        for prim in Usd.PrimRange(root, Usd.TraverseInstanceProxies(Usd.PrimAllPrimsPredicate))
        if prim.IsA(UsdGeom.Mesh)
    )


def _base(prim: object) -> int | None:
    value = prim.GetAttribute(names.ATTR_INSTANCE_ID_BASE).Get()  # type: ignore[attr-defined]
    enabled = prim.GetAttribute(names.ATTR_INSTANCE_IDS_ENABLED).Get()  # type: ignore[attr-defined]
    return None if value is None or enabled is False else int(value)


def _scattered(prim: object) -> ClassContents:
    from pxr import UsdGeom

    instancer = UsdGeom.PointInstancer(prim)
    targets = instancer.GetPrototypesRel().GetForwardedTargets()
    stage = prim.GetStage()  # type: ignore[attr-defined]
    ids = instancer.GetIdsAttr().Get()
    scales = np.array(instancer.GetScalesAttr().Get(), np.float64).reshape(-1, 3)
    return ClassContents(
        path=str(prim.GetPath()),  # type: ignore[attr-defined]
        base=_base(prim),
        ids=None if ids is None else np.array(ids, np.int64),
        single=False,
        meshes=tuple(target.name for target in targets),
        triangles=np.array([_faces(stage.GetPrimAtPath(t)) for t in targets], np.int64),
        which=np.array(instancer.GetProtoIndicesAttr().Get(), np.int64),
        positions=np.array(instancer.GetPositionsAttr().Get(), np.float64).reshape(-1, 3),
        scales=scales.max(axis=1, initial=0.0),
    )


def _single(prim: object) -> ClassContents:
    from pxr import Usd, UsdGeom

    found = [
        child
        for child in prim.GetChildren()  # type: ignore[attr-defined]
        if child.GetName().startswith(_SINGLE)
    ]
    numbers = [int(child.GetName().removeprefix(_SINGLE)) for child in found]
    order = np.argsort(numbers, kind="stable")
    meshes: dict[str, int] = {}
    which, positions, scales = [], [], []
    for index in order.tolist():
        child = found[index]
        items = child.GetMetadata("references").GetAddedOrExplicitItems()
        name = items[0].primPath.name if items else child.GetName()
        if name not in meshes:
            meshes[name] = _faces(child)
        which.append(list(meshes).index(name))
        matrix = UsdGeom.Xformable(child).ComputeLocalToWorldTransform(Usd.TimeCode.EarliestTime())
        rows = np.array(matrix)
        positions.append(rows[3, :3])
        scales.append(np.sqrt((rows[:3, :3] ** 2).sum(axis=1)).max())
    return ClassContents(
        path=str(prim.GetPath()),  # type: ignore[attr-defined]
        base=_base(prim),
        ids=np.array(numbers, np.int64)[order],
        single=True,
        meshes=tuple(meshes),
        triangles=np.array(list(meshes.values()), np.int64),
        which=np.array(which, np.int64),
        positions=np.array(positions, np.float64).reshape(-1, 3),
        scales=np.array(scales, np.float64),
    )
