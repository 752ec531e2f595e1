"""Labels of faces: scenec's primvars, else standard UsdSemantics labels."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from pxr import Usd, UsdGeom, UsdSemantics

from scenec.schemas import stage as names
from scenec.schemas.errors import StageError


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
        ids = root.GetAttribute(names.ATTR_LABEL_IDS.format(level=level)).Get()
        labels = attribute.Get()
        if labels is None or ids is None or len(labels) != len(ids):
            raise StageError(
                f"{root.GetPath()}: label level {level!r}: names and ids differ in number"
            )
        table[level] = dict(zip(map(str, labels), map(int, ids), strict=True))
    if table:
        # Attributes come in alphabetical order; the order of first labels' ids is no better.
        return LabelTable(table)
    return LabelTable(_from_semantics(stage))


def _from_semantics(stage: Usd.Stage) -> dict[str, dict[str, int]]:
    found: dict[str, set[str]] = {}
    for prim in Usd.PrimRange(stage.GetPseudoRoot(), Usd.TraverseInstanceProxies()):
        for level in UsdSemantics.LabelsAPI.GetDirectTaxonomies(prim):
            labels = UsdSemantics.LabelsAPI(prim, level).GetLabelsAttr().Get() or ()
            found.setdefault(str(level), set()).update(map(str, labels))
    return {
        level: {name: number for number, name in enumerate(sorted(labels), start=1)}
        for level, labels in sorted(found.items())
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


def has_label(prim: Usd.Prim, table: LabelTable) -> bool:
    """Whether UsdSemantics labels this very prim, at any level."""
    return any(_direct_label(prim, level, table) is not None for level in table.levels)


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
        values = _uniform_primvar(prim, level, face_count)
        if values is None:
            values = np.full(face_count, own.get(level, inherited.get(level, 0)), np.uint32)
            _label_subsets(mesh, level, table, values)
        labels[level] = values
    return labels


def _uniform_primvar(prim: Usd.Prim, level: str, face_count: int) -> NDArray[np.uint32] | None:
    primvar = UsdGeom.PrimvarsAPI(prim).GetPrimvar(names.label_primvar(level))
    if not primvar or not primvar.HasValue():
        return None
    if primvar.GetInterpolation() == UsdGeom.Tokens.constant:
        return None
    values = np.array(primvar.ComputeFlattened())
    if primvar.GetInterpolation() != UsdGeom.Tokens.uniform or values.shape != (face_count,):
        raise StageError(
            f"{prim.GetPath()}: primvar {primvar.GetPrimvarName()} must be uniform with "
            f"{face_count} values, one a face; it has {values.size} ({primvar.GetInterpolation()})"
        )
    if values.size and values.min() < 0:
        raise StageError(f"{prim.GetPath()}: primvar {primvar.GetPrimvarName()}: a label below 0")
    return values.astype(np.uint32)


def _constant_primvar(prim: Usd.Prim, level: str) -> int | None:
    primvar = UsdGeom.PrimvarsAPI(prim).FindPrimvarWithInheritance(names.label_primvar(level))
    if not primvar or not primvar.HasValue():
        return None
    if primvar.GetInterpolation() != UsdGeom.Tokens.constant:
        return None
    value = np.ravel(primvar.Get())
    if value.size != 1 or value[0] < 0:
        raise StageError(
            f"{prim.GetPath()}: primvar {primvar.GetPrimvarName()} must be one id >= 0"
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
    labels = UsdSemantics.LabelsAPI(prim, level).GetLabelsAttr().Get()
    # USD allows several labels of a taxonomy; a face has one: the first that the table knows.
    known = [table.ids[level][str(name)] for name in labels or () if str(name) in table.ids[level]]
    return known[0] if known else None


def _label_subsets(
    mesh: UsdGeom.Mesh, level: str, table: LabelTable, values: NDArray[np.uint32]
) -> None:
    for subset in UsdGeom.Subset.GetAllGeomSubsets(mesh):
        label_id = _direct_label(subset.GetPrim(), level, table)
        if label_id is not None and subset.GetElementTypeAttr().Get() == UsdGeom.Tokens.face:
            values[np.array(subset.GetIndicesAttr().Get() or (), dtype=np.int64)] = label_id
