"""Labels of faces, by our primvars or by UsdSemantics, and instances that these labels make."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from pxr import Kind, Usd, UsdGeom, UsdSemantics

from scenec.backends.stage import values
from scenec.backends.stage.implicit import is_shape
from scenec.schemas import stage as names
from scenec.schemas.errors import StageError

#: Of labels that change, those that hold.
_FIRST = Usd.TimeCode.EarliestTime()
#: A prim with one of these says itself what ids there are below it.
_OURS = (
    names.ATTR_INSTANCE_ID,
    names.ATTR_LOCAL_INSTANCE_ID,
    names.ATTR_INSTANCE_ID_BASE,
    names.ATTR_INSTANCE_IDS_ENABLED,
)


@dataclass(frozen=True)
class LabelTable:
    """Levels in order, and per level name -> id."""

    ids: dict[str, dict[str, int]]

    @property
    def levels(self) -> tuple[str, ...]:
        """Names of the levels."""
        return tuple(self.ids)


def read_table(stage: Usd.Stage) -> LabelTable:
    """The table on the root prim; without one, all UsdSemantics labels numbered by name.

    Raises:
        StageError: Names and ids do not match up.
    """
    root = stage.GetDefaultPrim()
    table: dict[str, dict[str, int]] = {}
    prefix, suffix = names.ATTR_LABEL_NAMES.split("{level}")
    for attribute in root.GetAuthoredAttributes() if root else ():
        name = attribute.GetName()
        if not (name.startswith(prefix) and name.endswith(suffix)):
            continue
        level = name[len(prefix) : -len(suffix)]
        ids = values.array(root.GetAttribute(names.ATTR_LABEL_IDS.format(level=level)), np.uint32)
        labels = values.words(attribute)
        if not labels or len(labels) != len(ids):
            raise StageError(
                f"{root.GetPath()}: label level {level!r}: names and ids differ in number"
            )
        table[level] = dict(zip(labels, ids.tolist(), strict=True))
    if table:
        # Attributes come in alphabetical order; the order of first labels' ids is no better.
        return LabelTable(table)
    return LabelTable(_from_semantics(stage))


def _from_semantics(stage: Usd.Stage) -> dict[str, dict[str, int]]:
    labels_of: dict[str, set[str]] = {}
    for prim in Usd.PrimRange(stage.GetPseudoRoot(), Usd.TraverseInstanceProxies()):
        for level in UsdSemantics.LabelsAPI.GetDirectTaxonomies(prim):
            labels = values.words(UsdSemantics.LabelsAPI(prim, level).GetLabelsAttr(), _FIRST)
            labels_of.setdefault(str(level), set()).update(labels)
    return {
        level: {name: number for number, name in enumerate(sorted(labels), start=1)}
        for level, labels in sorted(labels_of.items())
    }


def prim_labels(prim: Usd.Prim, table: LabelTable) -> dict[str, int]:
    """Label id per level that holds for a whole prim: its own, or the nearest ancestor's."""
    found = {}
    for level in table.levels:
        label_id = _constant_primvar(prim, level)
        if label_id is None:
            label_id = _semantic_label(prim, level, table)
        if label_id is not None:
            found[level] = label_id
    return found


def face_labels(
    mesh: UsdGeom.Mesh, table: LabelTable, inherited: dict[str, int], face_count: int
) -> dict[str, NDArray[np.uint32]]:
    """Label ids of a mesh's authored faces, per level: uint32 [face_count]; 0 is "no label".

    Args:
        mesh: The mesh.
        table: Levels and ids.
        inherited: What holds where the mesh's own namespace says nothing (its instancer's labels).
        face_count: Authored faces.

    Raises:
        StageError: A primvar's length fits no face count, or a label is negative.
    """
    prim = mesh.GetPrim()
    own = prim_labels(prim, table)
    labels = {}
    for level in table.levels:
        found = _uniform_primvar(prim, level, face_count)
        if found is None:
            found = np.full(face_count, own.get(level, inherited.get(level, 0)), np.uint32)
            _label_subsets(mesh, level, table, found)
        labels[level] = found
    return labels


def _uniform_primvar(prim: Usd.Prim, level: str, face_count: int) -> NDArray[np.uint32] | None:
    primvar = UsdGeom.PrimvarsAPI(prim).GetPrimvar(names.label_primvar(level))
    if not primvar or not primvar.HasValue():
        return None
    if primvar.GetInterpolation() == UsdGeom.Tokens.constant:
        return None
    found = values.flattened(primvar, np.int64, values.DEFAULT)
    if primvar.GetInterpolation() != UsdGeom.Tokens.uniform or len(found) != face_count:
        raise StageError(
            f"{prim.GetPath()}: primvar {primvar.GetPrimvarName()} must be uniform with "
            f"{face_count} values, one a face; it has {len(found)} ({primvar.GetInterpolation()})"
        )
    if found.size and not 0 <= found.min() <= found.max() < 2**32:
        raise StageError(
            f"{prim.GetPath()}: primvar {primvar.GetPrimvarName()}: a label below 0, or beyond 32 "
            "bits"
        )
    return found.astype(np.uint32)


def _constant_primvar(prim: Usd.Prim, level: str) -> int | None:
    primvar = UsdGeom.PrimvarsAPI(prim).FindPrimvarWithInheritance(names.label_primvar(level))
    if not primvar or not primvar.HasValue():
        return None
    if primvar.GetInterpolation() != UsdGeom.Tokens.constant:
        return None
    value = values.flattened(primvar, np.int64, values.DEFAULT)
    if value.size != 1 or not 0 <= value[0] < 2**32:
        raise StageError(
            f"{prim.GetPath()}: primvar {primvar.GetPrimvarName()} must be one id >= 0, of 32 bits"
        )
    return int(value[0])


def _semantic_label(prim: Usd.Prim, level: str, table: LabelTable) -> int | None:
    at = prim
    while at and not at.IsPseudoRoot():
        label_id = _direct_label(at, level, table)
        if label_id is not None:
            return label_id
        at = at.GetParent()
    return None


def _direct_label(prim: Usd.Prim, level: str, table: LabelTable) -> int | None:
    if not prim.HasAPI(UsdSemantics.LabelsAPI, level):
        return None
    labels = values.words(UsdSemantics.LabelsAPI(prim, level).GetLabelsAttr(), _FIRST)
    # USD allows several labels of a taxonomy; a face has one: the first that the table knows.
    known = [table.ids[level][name] for name in labels if name in table.ids[level]]
    return known[0] if known else None


def _label_subsets(
    mesh: UsdGeom.Mesh, level: str, table: LabelTable, labels: NDArray[np.uint32]
) -> None:
    for subset in UsdGeom.Subset.GetAllGeomSubsets(mesh):
        label_id = _direct_label(subset.GetPrim(), level, table)
        kind = values.word(subset.GetElementTypeAttr(), "")
        if label_id is None or kind != UsdGeom.Tokens.face:
            continue
        chosen = values.array(subset.GetIndicesAttr(), np.int64)
        if chosen.size and not 0 <= chosen.min() <= chosen.max() < len(labels):
            raise StageError(
                f"{subset.GetIndicesAttr().GetPath()}: holds indices from {chosen.min()} to "
                f"{chosen.max()}, of {len(labels)} faces"
            )
        labels[chosen] = label_id


def labeled_instances(stage: Usd.Stage, table: LabelTable) -> dict[str, int]:
    """Numbers, from 1, of the prims that are instances because UsdSemantics labels them, by path.

    The outermost labeled prim is one instance with all that is below it. Scopes and models of kind
    group or assembly are no things but collections: what is directly below them is one each. Point
    instancers count their own instances, and a prim that says something about ids is left to that.
    Numbers follow the order of the stage, whether a prim is visible or not.

    A stage of scenec's schema (with ``scenec:schemaVersion``) says all its ids: {}.
    """
    root = stage.GetDefaultPrim()
    if not table.levels or (root and root.HasAttribute(names.ATTR_SCHEMA_VERSION)):
        return {}
    found = (
        each
        for prim in stage.GetPseudoRoot().GetChildren()
        for each in _instances(prim, False, table)
    )
    return {str(prim.GetPath()): number for number, prim in enumerate(found, start=1)}


def _instances(prim: Usd.Prim, of_group: bool, table: LabelTable) -> Iterator[Usd.Prim]:
    """Yields instances at or below a prim; ``of_group``: whether a labeled group encloses it."""
    if prim.IsA(UsdGeom.PointInstancer) or any(prim.HasAttribute(name) for name in _OURS):
        return
    labeled = of_group or any(
        _direct_label(prim, level, table) is not None for level in table.levels
    )
    if labeled and not _is_group(prim):
        if _has_shape(prim):
            yield prim
        return
    for child in prim.GetFilteredChildren(Usd.TraverseInstanceProxies()):
        yield from _instances(child, labeled, table)


def _is_group(prim: Usd.Prim) -> bool:
    kind = Usd.ModelAPI(prim).GetKind()
    return prim.IsA(UsdGeom.Scope) or Kind.Registry.IsA(kind, Kind.Tokens.group)


def _has_shape(prim: Usd.Prim) -> bool:
    prims = iter(Usd.PrimRange(prim, Usd.TraverseInstanceProxies()))
    for each in prims:
        if each.IsA(UsdGeom.PointInstancer):
            prims.PruneChildren()
        elif is_shape(each):
            return True
    return False
