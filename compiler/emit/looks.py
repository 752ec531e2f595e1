"""Writes one layer a material: the shared surface model, and a preview surface for viewers."""

from __future__ import annotations

from pathlib import Path

from pxr import Gf, Sdf, Usd, UsdGeom, UsdShade

from scenec.compiler.cache.memo import memoized_file
from scenec.compiler.emit.layer import new_layer
from scenec.compiler.emit.preview import is_encoded, write_preview
from scenec.compiler.scene.scene import Material, MaterialMaps, Reflectance
from scenec.schemas import stage as names
from scenec.schemas.maps import COLORS

LOOKS = f"{names.ROOT}/Looks"


def look_path(material: str) -> str:
    """Prim path of a material."""
    return f"{LOOKS}/{material}"


@memoized_file("emit")
def write_look(path: Path, name: str, material: Material, maps: dict[str, str]) -> None:
    """Writes ``looks/<material>.usda``.

    The numbers of the shared surface model stand as ``scenec:surface:*``, which backends read. The
    UsdPreviewSurface is derived from them (``write_preview``).

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
        if max(material.emission) > 0.0:
            prim.CreateAttribute(names.ATTR_EMISSION, Sdf.ValueTypeNames.Color3f, custom=True).Set(
                Gf.Vec3f(*material.emission)
            )
        if material.reflectance is not None:
            _write_reflectance(prim, material.reflectance)
        if material.maps is not None:
            _write_maps(prim, material.maps, maps)
        write_preview(look, material, {kind: f"../{file}" for kind, file in maps.items()})


def _write_reflectance(prim: Usd.Prim, law: Reflectance) -> None:
    """Viewers show Lambert's law: neither preview surfaces nor MaterialX have these."""
    prim.CreateAttribute(names.ATTR_REFLECTANCE, Sdf.ValueTypeNames.Token, custom=True).Set(
        law.model
    )
    numbers = [
        (names.ATTR_PHASE_B, law.b),
        (names.ATTR_PHASE_C, law.c),
        (names.ATTR_OPPOSITION, law.opposition),
        (names.ATTR_OPPOSITION_WIDTH, law.opposition_width),
    ]
    if law.model == "hapke":
        numbers.append((names.ATTR_MEAN_SLOPE, law.roughness_deg))
    for attribute, value in numbers:
        prim.CreateAttribute(attribute, Sdf.ValueTypeNames.Float, custom=True).Set(value)


def _write_maps(prim: Usd.Prim, maps: MaterialMaps, files: dict[str, str]) -> None:
    for kind, file in files.items():
        attribute = prim.CreateAttribute(
            names.ATTR_MAPS[kind], Sdf.ValueTypeNames.Asset, custom=True
        )
        attribute.Set(Sdf.AssetPath(f"../{file}"))
        attribute.SetColorSpace(_color_space(kind, file))
    if maps.projection != names.MAP_PROJECTIONS[0]:
        prim.CreateAttribute(names.ATTR_MAP_PROJECTION, Sdf.ValueTypeNames.Token, custom=True).Set(
            maps.projection
        )
    if maps.projection != "uv":
        prim.CreateAttribute(names.ATTR_MAP_SIZE, Sdf.ValueTypeNames.Double, custom=True).Set(
            maps.size_m
        )
    if maps.cells is not None:
        for name, kind, value in (
            (names.ATTR_MAP_CELL_SIZE, Sdf.ValueTypeNames.Double, maps.cells.size_m),
            (names.ATTR_MAP_CELL_SEED, Sdf.ValueTypeNames.UInt, maps.cells.seed),
        ):
            prim.CreateAttribute(name, kind, custom=True).Set(value)
    if maps.far is not None and maps.far.share > 0.0 and "base_color" in files:
        prim.CreateAttribute(names.ATTR_MAP_FAR, Sdf.ValueTypeNames.Float2, custom=True).Set(
            Gf.Vec2f(maps.far.factor, maps.far.share)
        )
    if "normal" in files:
        prim.CreateAttribute(
            names.ATTR_NORMAL_CONVENTION, Sdf.ValueTypeNames.Token, custom=True
        ).Set(maps.normal_convention)


def _color_space(kind: str, file: str) -> str:
    """Name of UsdColorSpace for a map's values."""
    if kind not in COLORS:
        return "raw"
    return "srgb_rec709_scene" if is_encoded(kind, file) else "lin_rec709_scene"
