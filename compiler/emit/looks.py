"""One layer a material: the shared surface model, and a preview surface for viewers."""

from __future__ import annotations

from pathlib import Path

from pxr import Gf, Sdf, UsdGeom, UsdShade

from scenec.compiler.emit.layer import new_layer
from scenec.compiler.scene import Material
from scenec.schemas import stage as names

LOOKS = f"{names.ROOT}/Looks"


def look_path(material: str) -> str:
    """Prim path of a material."""
    return f"{LOOKS}/{material}"


def write_look(path: Path, name: str, material: Material) -> None:
    """Writes ``looks/<material>.usda``.

    The numbers of the shared surface model stand as ``scenec:surface:*``, which backends read. The
    UsdPreviewSurface is derived from them: it shows displayColor, where the merges of the ground
    are already blended, with the GGX lobe as its specular color.
    """
    with new_layer(path) as stage:
        UsdGeom.Scope.Define(stage, LOOKS)
        look = UsdShade.Material.Define(stage, look_path(name))
        prim = look.GetPrim()
        prim.CreateAttribute(names.ATTR_BASE_COLOR, Sdf.ValueTypeNames.Color3f, custom=True).Set(
            Gf.Vec3f(*material.base_color)
        )
        for attribute, value in (
            (names.ATTR_SPECULAR, material.specular),
            (names.ATTR_ROUGHNESS, material.roughness),
            (names.ATTR_COLOR_VARIATION, material.variation),
        ):
            prim.CreateAttribute(attribute, Sdf.ValueTypeNames.Float, custom=True).Set(value)
        color = UsdShade.Shader.Define(stage, f"{look_path(name)}/Color")
        color.CreateIdAttr("UsdPrimvarReader_float3")
        color.CreateInput("varname", Sdf.ValueTypeNames.String).Set("displayColor")
        color.CreateInput("fallback", Sdf.ValueTypeNames.Float3).Set(Gf.Vec3f(*material.base_color))
        surface = UsdShade.Shader.Define(stage, f"{look_path(name)}/Surface")
        surface.CreateIdAttr("UsdPreviewSurface")
        surface.CreateInput("diffuseColor", Sdf.ValueTypeNames.Color3f).ConnectToSource(
            color.CreateOutput("result", Sdf.ValueTypeNames.Float3)
        )
        surface.CreateInput("useSpecularWorkflow", Sdf.ValueTypeNames.Int).Set(1)
        surface.CreateInput("specularColor", Sdf.ValueTypeNames.Color3f).Set(
            Gf.Vec3f(material.specular)
        )
        surface.CreateInput("roughness", Sdf.ValueTypeNames.Float).Set(material.roughness)
        look.CreateSurfaceOutput().ConnectToSource(
            surface.CreateOutput("surface", Sdf.ValueTypeNames.Token)
        )
