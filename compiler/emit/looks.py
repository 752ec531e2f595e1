"""One layer a material: the shared surface model, and a preview surface for viewers."""

from __future__ import annotations

from pathlib import Path

from pxr import Gf, Sdf, Usd, UsdGeom, UsdShade

from scenec.compiler.emit.layer import new_layer
from scenec.compiler.emit.maps import average_color
from scenec.compiler.scene import Material, MaterialMaps
from scenec.schemas import stage as names

#: Color space names of UsdColorSpace for what is not sRGB.
_RAW = {"base_color": "lin_rec709_scene", "roughness": "raw", "metallic": "raw", "normal": "raw"}

LOOKS = f"{names.ROOT}/Looks"


def look_path(material: str) -> str:
    """Prim path of a material."""
    return f"{LOOKS}/{material}"


def write_look(path: Path, name: str, material: Material, maps: dict[str, str]) -> None:
    """Writes ``looks/<material>.usda``.

    The numbers of the shared surface model stand as ``scenec:surface:*``, which backends read. The
    UsdPreviewSurface is derived from them: it shows displayColor, where the merges of the ground
    are already blended, with the GGX lobe as its specular color (of a metal: its metallic part).
    Its roughness is the material's number, without maps and variation.

    Args:
        path: The layer, in a folder of the batch's folder.
        name: Of the material.
        material: What to write.
        maps: Its maps by kind, relative to the batch's folder.
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
            (names.ATTR_METALLIC, material.metallic),
            (names.ATTR_COLOR_VARIATION, material.variation),
        ):
            prim.CreateAttribute(attribute, Sdf.ValueTypeNames.Float, custom=True).Set(value)
        if material.roughness_variation != 0.0:
            prim.CreateAttribute(
                names.ATTR_ROUGHNESS_VARIATION, Sdf.ValueTypeNames.Float, custom=True
            ).Set(material.roughness_variation)
        if material.maps is not None:
            _write_maps(prim, material.maps, maps)
        color = UsdShade.Shader.Define(stage, f"{look_path(name)}/Color")
        color.CreateIdAttr("UsdPrimvarReader_float3")
        color.CreateInput("varname", Sdf.ValueTypeNames.String).Set("displayColor")
        color.CreateInput("fallback", Sdf.ValueTypeNames.Float3).Set(
            Gf.Vec3f(*average_color(material))
        )
        surface = UsdShade.Shader.Define(stage, f"{look_path(name)}/Surface")
        surface.CreateIdAttr("UsdPreviewSurface")
        surface.CreateInput("diffuseColor", Sdf.ValueTypeNames.Color3f).ConnectToSource(
            color.CreateOutput("result", Sdf.ValueTypeNames.Float3)
        )
        if material.metallic > 0.0:
            surface.CreateInput("metallic", Sdf.ValueTypeNames.Float).Set(material.metallic)
        else:
            surface.CreateInput("useSpecularWorkflow", Sdf.ValueTypeNames.Int).Set(1)
            surface.CreateInput("specularColor", Sdf.ValueTypeNames.Color3f).Set(
                Gf.Vec3f(material.specular)
            )
        surface.CreateInput("roughness", Sdf.ValueTypeNames.Float).Set(material.roughness)
        look.CreateSurfaceOutput().ConnectToSource(
            surface.CreateOutput("surface", Sdf.ValueTypeNames.Token)
        )


def is_encoded(kind: str, file: str) -> bool:
    """Whether a map's values are colors in sRGB's transfer function."""
    return kind == "base_color" and not file.endswith(".exr")


def _write_maps(prim: Usd.Prim, maps: MaterialMaps, files: dict[str, str]) -> None:
    for kind, file in files.items():
        attribute = prim.CreateAttribute(
            names.ATTR_MAPS[kind], Sdf.ValueTypeNames.Asset, custom=True
        )
        attribute.Set(Sdf.AssetPath(f"../{file}"))
        attribute.SetColorSpace("srgb_rec709_scene" if is_encoded(kind, file) else _RAW[kind])
    prim.CreateAttribute(names.ATTR_MAP_SIZE, Sdf.ValueTypeNames.Double, custom=True).Set(
        maps.size_m
    )
    if "normal" in files:
        prim.CreateAttribute(
            names.ATTR_NORMAL_CONVENTION, Sdf.ValueTypeNames.Token, custom=True
        ).Set(maps.normal_convention)
