"""A stage while it becomes a cfg."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pxr import Usd, UsdGeom

from scenec.importers.output import Imported
from scenec.importers.scene import Taxonomy

#: What may stay as it is.
KEEP = ("cameras", "light")


@dataclass
class Scene:
    """A stage under way.

    Attributes:
        stage: The stage.
        imported: The cfg and its report.
        to_world: From the stage's coordinates to the cfg's, [4, 4]: meters, z up.
        keep: Of ``KEEP``, what stays as it is.
        taxonomy: Its labels.
        model: What the cfg says of the file beside its parts.
        groups: Meshes of each class: path of the prim, and its meshes.
        extent_m: Size of the terrain.
    """

    stage: Usd.Stage
    imported: Imported
    to_world: NDArray[np.float64]
    keep: Sequence[str]
    taxonomy: Taxonomy = field(default_factory=Taxonomy)
    model: dict[str, Any] = field(default_factory=dict)
    extent_m: tuple[float, float] = (10.0, 10.0)

    def placed(self, prim: Usd.Prim, time: Usd.TimeCode) -> NDArray[np.float64]:
        """From a prim's own coordinates to the cfg's."""
        local = UsdGeom.Xformable(prim).ComputeLocalToWorldTransform(time)
        return self.to_world @ np.array(local, float).T


def shown_prims(stage: Usd.Stage, kind: type) -> list[Usd.Prim]:
    """Prims of a kind that a renderer would show."""
    return [
        prim
        for prim in stage.Traverse(Usd.TraverseInstanceProxies())
        if prim.IsA(kind)
        and UsdGeom.Imageable(prim).ComputeVisibility() != UsdGeom.Tokens.invisible
        and UsdGeom.Imageable(prim).ComputePurpose() not in ("proxy", "guide")
    ]


def is_prototype(prim: Usd.Prim) -> bool:
    """Whether a prim stands below a point instancer: it is shown where that says."""
    above = prim.GetParent()
    while above:
        if above.IsA(UsdGeom.PointInstancer):
            return True
        above = above.GetParent()
    return False
