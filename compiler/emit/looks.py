"""Writes one layer a material: the shared surface model, and a preview surface for viewers."""

from __future__ import annotations

from pathlib import Path

from pxr import Gf, Sdf, Usd, UsdGeom, UsdShade

from scenec.compiler.cache.memo import memoized_file
from scenec.compiler.emit.layer import TYPES, custom, new_layer
from scenec.compiler.emit.preview import is_encoded, write_preview
from scenec.compiler.scene.material import Material, MaterialMaps, Reflectance
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
    """
    with new_layer(path) as stage:
        UsdGeom.Scope.Define(stage, LOOKS)
        look = UsdShade.Material.Define(stage, look_path(name))
        prim = look.GetPrim()
        custom(prim, names.ATTR_BASE_COLOR, TYPES.Color3f).Set(Gf.Vec3f(*material.base_color))
        for attribute, value in (
            (names.ATTR_SPECULAR, material.specular),
            (names.ATTR_ROUGHNESS, material.roughness),
            (names.ATTR_METALLIC, material.metallic),
            (names.ATTR_COLOR_VARIATION, material.variation),
        ):
            custom(prim, attribute, TYPES.Float).Set(value)
        if material.roughness_variation != 0.0:
            custom(prim, names.ATTR_ROUGHNESS_VARIATION, TYPES.Float).Set(
                material.roughness_variation
            )
        if material.diffuse_transmission > 0.0:
            custom(prim, names.ATTR_DIFFUSE_TRANSMISSION, TYPES.Float).Set(
                material.diffuse_transmission
            )
        if max(material.emission) > 0.0:
            custom(prim, names.ATTR_EMISSION, TYPES.Color3f).Set(Gf.Vec3f(*material.emission))
        if material.reflectance is not None:
            _write_reflectance(prim, material.reflectance)
        if material.maps is not None:
            _write_maps(prim, material.maps, maps)
        write_preview(look, material, {kind: f"../{file}" for kind, file in maps.items()})


def _write_reflectance(prim: Usd.Prim, law: Reflectance) -> None:
    """Viewers show Lambert's law: neither preview surfaces nor MaterialX have these."""
    custom(prim, names.ATTR_REFLECTANCE, TYPES.Token).Set(law.model)
    numbers = [
        (names.ATTR_PHASE_B, law.b),
        (names.ATTR_PHASE_C, law.c),
        (names.ATTR_OPPOSITION, law.opposition),
        (names.ATTR_OPPOSITION_WIDTH, law.opposition_width),
    ]
    if law.model == "hapke":
        numbers.append((names.ATTR_MEAN_SLOPE, law.roughness_deg))
    for attribute, value in numbers:
        custom(prim, attribute, TYPES.Float).Set(value)


def _write_maps(prim: Usd.Prim, maps: MaterialMaps, files: dict[str, str]) -> None:
    for kind, file in files.items():
        attribute = custom(prim, names.ATTR_MAPS[kind], TYPES.Asset)
        attribute.Set(Sdf.AssetPath(f"../{file}"))
        attribute.SetColorSpace(_color_space(kind, file))
    if maps.projection != names.MAP_PROJECTIONS[0]:
        custom(prim, names.ATTR_MAP_PROJECTION, TYPES.Token).Set(maps.projection)
    if maps.projection != "uv":
        custom(prim, names.ATTR_MAP_SIZE, TYPES.Double).Set(maps.size_m)
    if maps.cells is not None:
        for name, kind, value in (
            (names.ATTR_MAP_CELL_SIZE, TYPES.Double, maps.cells.size_m),
            (names.ATTR_MAP_CELL_SEED, TYPES.UInt, maps.cells.seed),
        ):
            custom(prim, name, kind).Set(value)
    if maps.far is not None and maps.far.share > 0.0 and "base_color" in files:
        custom(prim, names.ATTR_MAP_FAR, TYPES.Float2).Set(
            Gf.Vec2f(maps.far.factor, maps.far.share)
        )
    if maps.cutout is not None:
        custom(prim, names.ATTR_OPACITY_THRESHOLD, TYPES.Float).Set(maps.cutout.threshold)
        if maps.cutout.wrap != (names.WRAPS[0],) * 2:
            custom(prim, names.ATTR_OPACITY_WRAP, TYPES.TokenArray).Set(list(maps.cutout.wrap))
    if "normal" in files:
        custom(prim, names.ATTR_NORMAL_CONVENTION, TYPES.Token).Set(maps.normal_convention)
        if maps.lean > 0.0:
            custom(prim, names.ATTR_MAP_LEAN, TYPES.Float).Set(maps.lean)


def _color_space(kind: str, file: str) -> str:
    if kind not in COLORS:
        return "raw"
    return "srgb_rec709_scene" if is_encoded(kind, file) else "lin_rec709_scene"
