"""Which prims of a foreign stage are instances: those that are labeled."""

from __future__ import annotations

from collections.abc import Iterator

from pxr import Kind, Usd, UsdGeom

from scenec.backends.stage.implicit import kind_of
from scenec.backends.stage.labels import LabelTable, has_label
from scenec.schemas import stage as names

#: A prim with one of these says itself what ids there are below it.
_OURS = (
    names.ATTR_INSTANCE_ID,
    names.ATTR_LOCAL_INSTANCE_ID,
    names.ATTR_INSTANCE_ID_BASE,
    names.ATTR_INSTANCE_IDS_ENABLED,
)


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
    """Those at or below a prim; ``of_group``: whether a labeled group is around it."""
    if prim.IsA(UsdGeom.PointInstancer) or any(prim.HasAttribute(name) for name in _OURS):
        return
    labeled = of_group or has_label(prim, table)
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
        elif each.IsA(UsdGeom.Mesh) or kind_of(each):
            return True
    return False
