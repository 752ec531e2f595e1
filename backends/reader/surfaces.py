"""Materials of meshes: scenec's layers and weights, else the bound preview surface."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from pxr import Usd, UsdGeom, UsdShade

from scenec.backends.reader.mapped import read_cells, read_emission, read_far
from scenec.backends.reader.reflectance import read_reflectance
from scenec.backends.reader.textures import constant, texture_maps
from scenec.backends.render_scene import Maps, Surface
from scenec.schemas import stage as names
from scenec.schemas.errors import StageError

#: What UsdPreviewSurface shows without a color.
_GRAY = 0.18


class SurfaceTable:
    """Surfaces in the order in which they were first met."""

    def __init__(self) -> None:
        self._index: dict[Surface, int] = {}

    def add(self, surface: Surface) -> int:
        """Index of a surface."""
        return self._index.setdefault(surface, len(self._index))

    def surfaces(self) -> tuple[Surface, ...]:
        """All of them."""
        return tuple(self._index)


def read_layers(
    mesh: UsdGeom.Mesh, point_count: int
) -> tuple[list[Surface], NDArray[np.float32]] | None:
    """Ordered ground materials and the weights of their merges, [layers - 1, point_count].

    Returns None for a mesh without ``scenec:layers``.

    Raises:
        StageError: A target is no material, or a weight is missing or of the wrong length.
    """
    prim = mesh.GetPrim()
    relationship = prim.GetRelationship(names.REL_LAYERS)
    targets = relationship.GetTargets() if relationship else []
    if not targets:
        return None
    surfaces = []
    for target in targets:
        material = UsdShade.Material(prim.GetStage().GetPrimAtPath(target))
        if not material:
            raise StageError(f"{prim.GetPath()}: {names.REL_LAYERS} names {target}: no material")
        surfaces.append(surface_of(material))
    weights = np.zeros((len(targets) - 1, point_count), np.float32)
    for merge in range(1, len(targets)):
        weights[merge - 1] = _vertex_floats(prim, names.weight_primvar(merge), point_count)
    return surfaces, weights


def read_variation(prim: Usd.Prim, count: int) -> NDArray[np.float32] | None:
    """The variation's values, float32 [count], or None where none are authored."""
    primvar = UsdGeom.PrimvarsAPI(prim).GetPrimvar(names.PRIMVAR_VARIATION)
    if not primvar or not primvar.HasValue():
        return None
    return _vertex_floats(prim, names.PRIMVAR_VARIATION, count)


def _vertex_floats(prim: Usd.Prim, name: str, count: int) -> NDArray[np.float32]:
    primvar = UsdGeom.PrimvarsAPI(prim).GetPrimvar(name)
    values = (
        np.array(primvar.ComputeFlattened(), np.float32) if primvar else np.zeros(0, np.float32)
    )
    if values.shape != (count,) or not np.isfinite(values).all():
        raise StageError(
            f"{prim.GetPath()}: primvar {name} must hold {count} finite floats, has {values.size}"
        )
    return values


def bound_material(prim: Usd.Prim) -> UsdShade.Material:
    """What is bound for full renderings, or for all purposes; invalid where nothing is."""
    return UsdShade.MaterialBindingAPI(prim).ComputeBoundMaterial(UsdShade.Tokens.full)[0]


def bound_surface(prim: Usd.Prim) -> Surface:
    """The surface of the bound material; without one, a diffuse one of displayColor."""
    material = bound_material(prim)
    if material:
        return surface_of(material, display_color(prim))
    return Surface("", display_color(prim), 0.0, 1.0, 0.0)


def display_color(prim: Usd.Prim) -> tuple[float, float, float]:
    """Mean of displayColor, its own or what it inherits; gray without."""
    primvar = UsdGeom.PrimvarsAPI(prim).FindPrimvarWithInheritance("displayColor")
    value = primvar.Get(Usd.TimeCode.EarliestTime()) if primvar and primvar.HasValue() else None
    values = np.array(() if value is None else value, np.float64)
    if not values.size:
        return (_GRAY, _GRAY, _GRAY)
    red, green, blue = values.reshape(-1, 3).mean(axis=0).tolist()
    return (red, green, blue)


def surface_of(
    material: UsdShade.Material, fallback: tuple[float, float, float] = (_GRAY, _GRAY, _GRAY)
) -> Surface:
    """The shared surface model's numbers of a material.

    Ours stand in ``scenec:surface:*``. From a foreign UsdPreviewSurface diffuseColor, roughness,
    metallic and normal are taken, constants or textures (``texture_maps``), and the reflectance at
    normal incidence.

    Args:
        material: The material.
        fallback: Color where diffuseColor is connected to something that is not read.

    Raises:
        StageError: One of our numbers is none, or not finite; or a map does not exist.
    """
    prim = material.GetPrim()
    path = str(prim.GetPath())
    color = prim.GetAttribute(names.ATTR_BASE_COLOR)
    if color and color.HasValue():
        red, green, blue = (float(v) for v in color.Get())
        return Surface(
            path,
            (red, green, blue),
            _number(prim, names.ATTR_SPECULAR),
            _number(prim, names.ATTR_ROUGHNESS),
            _number(prim, names.ATTR_COLOR_VARIATION),
            _number(prim, names.ATTR_METALLIC),
            _maps(prim),
            _number(prim, names.ATTR_ROUGHNESS_VARIATION),
            reflectance=read_reflectance(prim),
            emission=read_emission(prim),
        )
    shader, _, _ = material.ComputeSurfaceSource()
    if not shader or shader.GetIdAttr().Get() != "UsdPreviewSurface":
        return Surface(path, fallback, 0.0, 1.0, 0.0)
    diffuse = constant(shader, "diffuseColor")
    if diffuse is not None:
        red, green, blue = (float(v) for v in diffuse)
        fallback = (red, green, blue)
    specular = _input(shader, "useSpecularWorkflow", 0) == 1
    maps = texture_maps(shader, specular)
    return Surface(
        path,
        (1.0, 1.0, 1.0) if maps is not None and maps.base_color is not None else fallback,
        _normal_reflectance(shader),
        _input(shader, "roughness", 0.5),
        0.0,
        0.0 if specular else min(max(_input(shader, "metallic", 0.0), 0.0), 1.0),
        maps,
        emission=_emission(shader, maps),
    )


def _emission(shader: UsdShade.Shader, maps: Maps | None) -> tuple[float, float, float]:
    if maps is not None and maps.emission is not None:
        return (1.0, 1.0, 1.0)
    value = constant(shader, "emissiveColor")
    if value is None or not all(0.0 <= float(v) < math.inf for v in value):
        return (0.0, 0.0, 0.0)
    red, green, blue = (float(v) for v in value)
    return (red, green, blue)


def _number(prim: Usd.Prim, name: str) -> float:
    """An attribute of the surface model, 0 where it is not authored."""
    value = prim.GetAttribute(name).Get()
    try:
        number = float(value or 0.0)
    except (TypeError, ValueError):
        number = math.nan
    if not math.isfinite(number):
        raise StageError(f"{prim.GetPath()}: {name} is {value}, expected a finite number")
    return number


def _maps(prim: Usd.Prim) -> Maps | None:
    files: dict[str, Path] = {}
    for kind, name in names.ATTR_MAPS.items():
        attribute = prim.GetAttribute(name)
        asset = attribute.Get() if attribute else None
        if asset is not None and asset.path:
            files[kind] = Path(asset.resolvedPath or asset.path)
            if not files[kind].is_file():
                raise StageError(f"{prim.GetPath()}: its map {asset.path} does not exist")
    if not files:
        return None
    asked = prim.GetAttribute(names.ATTR_MAP_PROJECTION)
    projection = (asked.Get() if asked else None) or names.MAP_PROJECTIONS[0]
    if projection not in names.MAP_PROJECTIONS:
        expected = ", ".join(names.MAP_PROJECTIONS)
        raise StageError(
            f'{prim.GetPath()}: {names.ATTR_MAP_PROJECTION} is "{projection}", expected {expected}'
        )
    convention = prim.GetAttribute(names.ATTR_NORMAL_CONVENTION)
    return Maps(
        size_m=1.0 if projection == "uv" else _map_size(prim),
        base_color=files.get("base_color"),
        roughness=files.get("roughness"),
        metallic=files.get("metallic"),
        normal=files.get("normal"),
        flip_green=bool(convention and convention.Get() == "directx"),
        projection=projection,
        emission=files.get("emission"),
        height=files.get("height"),
        cells=read_cells(prim, projection),
        far=read_far(prim, projection),
    )


def _map_size(prim: Usd.Prim) -> float:
    size = prim.GetAttribute(names.ATTR_MAP_SIZE)
    meters = UsdGeom.GetStageMetersPerUnit(prim.GetStage())
    size_m = meters * float(size.Get() or 0.0) if size else 0.0
    if not 0.0 < size_m < math.inf:
        raise StageError(f"{prim.GetPath()}: {names.ATTR_MAP_SIZE} must be above 0")
    return size_m


def _normal_reflectance(shader: UsdShade.Shader) -> float:
    if _input(shader, "useSpecularWorkflow", 0) == 1:
        color = constant(shader, "specularColor")
        return float(np.mean(color)) if color is not None else 0.0
    ior = _input(shader, "ior", 1.5)
    return ((ior - 1.0) / (ior + 1.0)) ** 2


def _input(shader: UsdShade.Shader, name: str, default: float) -> float:
    value = constant(shader, name)
    return default if value is None else float(value)
