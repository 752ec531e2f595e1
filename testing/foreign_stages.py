"""Stages that another program might have written, for tests of the reader."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from pxr import Sdf, Usd, UsdGeom, UsdSemantics, UsdShade

from scenec.backends.stage.read import read_stage
from scenec.backends.stage.scene import RenderScene


def new_stage(
    path: Path, root: str = "/World", samples: int = 0, unit: float = 1.0, up: str = "Z"
) -> Usd.Stage:
    """Makes a stage in meters, Z up (or ``unit``, ``up``), whose default prim is ``root``.

    Args:
        path: Of its file.
        root: Of the default prim, an Xform.
        samples: The last time code is one less; 0 leaves the range out.
        unit: Meters per unit.
        up: Axis.
    """
    stage = Usd.Stage.CreateNew(str(path))
    UsdGeom.SetStageMetersPerUnit(stage, unit)
    UsdGeom.SetStageUpAxis(stage, up)
    if samples:
        stage.SetStartTimeCode(0)
        stage.SetEndTimeCode(samples - 1)
    stage.SetDefaultPrim(UsdGeom.Xform.Define(stage, root).GetPrim())
    return stage


def polygons(
    stage: Usd.Stage, path: str, points: Any, counts: Sequence[int], indices: Sequence[int]
) -> UsdGeom.Mesh:
    """Defines a mesh that is not to be subdivided."""
    mesh = UsdGeom.Mesh.Define(stage, path)
    mesh.CreatePointsAttr(points)
    mesh.CreateFaceVertexCountsAttr(counts)
    mesh.CreateFaceVertexIndicesAttr(indices)
    mesh.CreateSubdivisionSchemeAttr("none")
    return mesh


def written(folder: Path, build: Callable[[Usd.Stage], None], **layout: Any) -> Path:
    """Writes a stage of ``new_stage``'s arguments with what ``build`` puts below ``/Root``."""
    stage = new_stage(folder / "foreign.usda", "/Root", **layout)
    build(stage)
    stage.Save()
    return folder / "foreign.usda"


def opened(folder: Path, build: Callable[[Usd.Stage], None], **layout: Any) -> RenderScene:
    """Reads what ``written`` writes."""
    return read_stage(written(folder, build, **layout))


def square(stage: Usd.Stage, path: str) -> UsdGeom.Mesh:
    """Defines a polygon that nothing of is lost."""
    return polygons(stage, path, [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)], [4], [0, 1, 2, 3])


def label(prim: Usd.Prim, name: str, level: str = "class") -> None:
    """Gives a prim a UsdSemantics label."""
    UsdSemantics.LabelsAPI.Apply(prim, level).CreateLabelsAttr([name])


def bind(stage: Usd.Stage, prim: Usd.Prim, shader_id: str = "UsdPreviewSurface") -> UsdShade.Shader:
    """Binds a material of one shader, and gives that back."""
    material = UsdShade.Material.Define(stage, "/Root/Looks/material")
    shader = UsdShade.Shader.Define(stage, "/Root/Looks/material/shader")
    shader.CreateIdAttr(shader_id)
    output = shader.CreateOutput("surface", Sdf.ValueTypeNames.Token)
    material.CreateSurfaceOutput().ConnectToSource(output)
    UsdShade.MaterialBindingAPI.Apply(prim).Bind(material)
    return shader
