"""Stages that another program might have written, for tests of the reader."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

from pxr import Sdf, Usd, UsdGeom, UsdSemantics, UsdShade

from scenec.backends.stage.read import read_stage
from scenec.backends.stage.scene import RenderScene


def written(folder: Path, build: Callable[[Usd.Stage], None], **layout: Any) -> Path:
    """A stage in meters, Z up (or ``unit``, ``up``, ``samples``), with what ``build`` puts in."""
    path = folder / "foreign.usda"
    stage = Usd.Stage.CreateNew(str(path))
    UsdGeom.SetStageMetersPerUnit(stage, layout.get("unit", 1.0))
    UsdGeom.SetStageUpAxis(stage, layout.get("up", UsdGeom.Tokens.z))
    if "samples" in layout:
        stage.SetStartTimeCode(0)
        stage.SetEndTimeCode(layout["samples"] - 1)
    stage.SetDefaultPrim(UsdGeom.Xform.Define(stage, "/Root").GetPrim())
    build(stage)
    stage.Save()
    return path


def opened(folder: Path, build: Callable[[Usd.Stage], None], **layout: Any) -> RenderScene:
    """What the reader makes of it."""
    return read_stage(written(folder, build, **layout))


def square(stage: Usd.Stage, path: str) -> UsdGeom.Mesh:
    """A polygon that nothing of is lost."""
    mesh = UsdGeom.Mesh.Define(stage, path)
    mesh.CreatePointsAttr([(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)])
    mesh.CreateFaceVertexCountsAttr([4])
    mesh.CreateFaceVertexIndicesAttr([0, 1, 2, 3])
    mesh.CreateSubdivisionSchemeAttr("none")
    return mesh


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
