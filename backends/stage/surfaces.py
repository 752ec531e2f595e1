"""Materials of meshes: scenec's layers and weights, else the bound preview surface."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pxr import Usd, UsdGeom, UsdShade

from scenec.backends.stage import values
from scenec.backends.stage.scene import Cells, Maps, Reflectance, Surface
from scenec.backends.stage.sources import Sources
from scenec.backends.stage.textures import (
    FIRST,
    connected,
    constant,
    opacity_threshold,
    texture_maps,
)
from scenec.schemas import stage as names
from scenec.schemas.errors import StageError

#: What UsdPreviewSurface shows without a color.
_GRAY = 0.18

#: Least and largest value, and whether these are in.
_RANGES = {
    names.ATTR_PHASE_B: (0.0, True, 1.0, False),
    names.ATTR_PHASE_C: (-1.0, True, 1.0, True),
    names.ATTR_OPPOSITION: (0.0, True, math.inf, False),
    names.ATTR_OPPOSITION_WIDTH: (0.0, False, math.inf, False),
    names.ATTR_MEAN_SLOPE: (0.0, True, 90.0, False),
    names.ATTR_DIFFUSE_TRANSMISSION: (0.0, True, 1.0, True),
    names.ATTR_MAP_LEAN: (0.0, True, 1.0, True),
    names.ATTR_OPACITY_THRESHOLD: (0.0, True, 1.0, True),
}


def read_layers(
    mesh: UsdGeom.Mesh, point_count: int, sources: Sources
) -> tuple[list[Surface], NDArray[np.float32]] | None:
    """Ordered ground materials and the weights of their merges, [layers - 1, point_count].

    Returns None for a mesh without ``scenec:layers``.

    Raises:
        StageError: A target is no material, or a weight is missing or of the wrong length.
    """
    prim = mesh.GetPrim()
    targets = values.targets(prim, names.REL_LAYERS)
    if not targets:
        return None
    surfaces = []
    for target in targets:
        material = UsdShade.Material(prim.GetStage().GetPrimAtPath(target))
        if not material:
            raise StageError(f"{prim.GetPath()}: {names.REL_LAYERS} names {target}: no material")
        surfaces.append(surface_of(material, sources))
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
    found = np.zeros(0, np.float32)
    if primvar:
        found = values.flattened(primvar, np.float32, values.DEFAULT)
    if len(found) != count or not np.isfinite(found).all():
        raise StageError(
            f"{prim.GetPath()}: primvar {name} must hold {count} finite floats, has {len(found)}"
        )
    return found


def bound_material(prim: Usd.Prim, sources: Sources) -> UsdShade.Material:
    """Returns the material bound for full renderings, or for all purposes; invalid without one.

    One of MDL's OmniPBR is returned as the UsdPreviewSurface that it is translated to.
    """
    bound = UsdShade.MaterialBindingAPI(prim).ComputeBoundMaterial(UsdShade.Tokens.full)[0]
    return sources.translated(bound) if bound else bound


def bound_surface(
    prim: Usd.Prim, sources: Sources, color: tuple[float, float, float] | None = None
) -> Surface:
    """The surface of the bound material; without one, a diffuse one of displayColor.

    Args:
        prim: A shape, or a subset of its faces.
        sources: Of the stage.
        color: In place of displayColor.
    """
    material = bound_material(prim, sources)
    color = display_color(prim) if color is None else color
    if material:
        return surface_of(material, sources, color)
    return Surface("", color, 0.0, 1.0, 0.0)


def shows_display_color(material: UsdShade.Material) -> bool:
    """Tells whether a material, which may be invalid, shows displayColor."""
    color = material.GetPrim().GetAttribute(names.ATTR_BASE_COLOR) if material else None
    if color and color.HasValue():
        return False
    shader = material.ComputeSurfaceSource()[0] if material else None
    if not shader or values.word(shader.GetIdAttr(), "") != "UsdPreviewSurface":
        return True
    if _color_input(shader, "diffuseColor") is not None:
        return False
    node, _ = connected(shader, "diffuseColor")
    return node is not None and values.word(node.GetIdAttr(), "") != "UsdUVTexture"


def is_absent(material: UsdShade.Material) -> bool:
    """Tells whether a preview surface's opacity is a constant below its threshold."""
    shader = _preview_surface(material)
    return shader is not None and _input(shader, "opacity", 1.0) < opacity_threshold(shader)[0]


def display_opacity_threshold(material: UsdShade.Material) -> float | None:
    """Returns the least displayOpacity that is shown, where that is the opacity; else None.

    Args:
        material: May be invalid: then it is.
    """
    if not material:
        return names.OPACITY_THRESHOLD
    shader = _preview_surface(material)
    node, _ = connected(shader, "opacity") if shader is not None else (None, "")
    if node is None or values.word(constant(node, "varname"), "", FIRST) != "displayOpacity":
        return None
    return opacity_threshold(shader)[0]


def _preview_surface(material: UsdShade.Material) -> UsdShade.Shader | None:
    """The UsdPreviewSurface of a material that has no surface of ours."""
    color = material.GetPrim().GetAttribute(names.ATTR_BASE_COLOR) if material else None
    shader = material.ComputeSurfaceSource()[0] if material else None
    if (color and color.HasValue()) or not shader:
        return None
    return shader if values.word(shader.GetIdAttr(), "") == "UsdPreviewSurface" else None


def display_color(prim: Usd.Prim) -> tuple[float, float, float]:
    """Mean of displayColor, its own or what it inherits; gray without."""
    primvar = UsdGeom.PrimvarsAPI(prim).FindPrimvarWithInheritance("displayColor")
    if not primvar or not primvar.HasValue():
        return (_GRAY, _GRAY, _GRAY)
    found = values.array(primvar.GetAttr(), np.float64, Usd.TimeCode.EarliestTime(), width=(3,))
    if not len(found):
        return (_GRAY, _GRAY, _GRAY)
    red, green, blue = found.mean(axis=0).tolist()
    return (red, green, blue)


def surface_of(
    material: UsdShade.Material,
    sources: Sources,
    fallback: tuple[float, float, float] = (_GRAY, _GRAY, _GRAY),
) -> Surface:
    """The shared surface model's numbers of a material.

    Ours stand in ``scenec:surface:*``. From a foreign UsdPreviewSurface diffuseColor, roughness,
    metallic and normal are taken, constants or textures (``texture_maps``), and the reflectance at
    normal incidence.

    Args:
        material: The material.
        sources: Of the stage. A map that is missing is left out.
        fallback: Color where diffuseColor is connected to something that is not read.

    Raises:
        StageError: One of its numbers is none, or not finite.
    """
    prim = material.GetPrim()
    path = str(prim.GetPath())
    color = prim.GetAttribute(names.ATTR_BASE_COLOR)
    if color and color.HasValue():
        red, green, blue = values.vector(color, 3) or fallback
        return Surface(
            path,
            (red, green, blue),
            values.number(prim.GetAttribute(names.ATTR_SPECULAR), 0.0),
            values.number(prim.GetAttribute(names.ATTR_ROUGHNESS), 0.0),
            values.number(prim.GetAttribute(names.ATTR_COLOR_VARIATION), 0.0),
            values.number(prim.GetAttribute(names.ATTR_METALLIC), 0.0),
            _maps(prim, sources),
            values.number(prim.GetAttribute(names.ATTR_ROUGHNESS_VARIATION), 0.0),
            reflectance=_reflectance_of(prim),
            emission=_emission_of(prim),
            diffuse_transmission=_number(prim, names.ATTR_DIFFUSE_TRANSMISSION),
        )
    shader, _, _ = material.ComputeSurfaceSource()
    if not shader or values.word(shader.GetIdAttr(), "") != "UsdPreviewSurface":
        return Surface(path, fallback, 0.0, 1.0, 0.0)
    diffuse = _color_input(shader, "diffuseColor")
    if diffuse is not None:
        red, green, blue = diffuse
        fallback = (red, green, blue)
    specular = _input(shader, "useSpecularWorkflow", 0) == 1
    maps = texture_maps(shader, specular, sources)
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
    red, green, blue = _color_input(shader, "emissiveColor") or (0.0, 0.0, 0.0)
    return (red, green, blue) if min(red, green, blue) >= 0.0 else (0.0, 0.0, 0.0)


def _maps(prim: Usd.Prim, sources: Sources) -> Maps | None:
    named = {k: sources.picture(prim.GetAttribute(name)) for k, name in names.ATTR_MAPS.items()}
    files: dict[str, Any] = {kind: file for kind, file in named.items() if file is not None}
    if not files:
        return None
    lie = names.MAP_PROJECTIONS
    projection = values.word(prim.GetAttribute(names.ATTR_MAP_PROJECTION), lie[0], known=lie)
    convention = values.word(prim.GetAttribute(names.ATTR_NORMAL_CONVENTION), "")
    return Maps(
        size_m=1.0 if projection == "uv" else _length(prim, names.ATTR_MAP_SIZE),
        flip_green=convention == "directx",
        projection=projection,
        cells=_cells_of(prim, projection),
        far=_far_of(prim, projection),
        lean=_number(prim, names.ATTR_MAP_LEAN) if "normal" in files else 0.0,
        opacity_threshold=_opacity_threshold(prim, projection) if "opacity" in files else 0.0,
        opacity_wrap=_opacity_wrap(prim),
        **files,
    )


def _opacity_threshold(prim: Usd.Prim, projection: str) -> float:
    threshold = _number(prim, names.ATTR_OPACITY_THRESHOLD)
    if threshold > 0.0 and projection != "uv":
        raise StageError(
            f"{prim.GetPath()}: {names.ATTR_MAPS['opacity']} lies by texture coordinates alone, "
            f"not by the projection {projection}"
        )
    return threshold


def _opacity_wrap(prim: Usd.Prim) -> tuple[str, str]:
    found = values.words(prim.GetAttribute(names.ATTR_OPACITY_WRAP)) or ["repeat", "repeat"]
    if len(found) != 2 or not set(found) <= set(names.WRAPS):
        raise StageError(
            f"{prim.GetPath()}: {names.ATTR_OPACITY_WRAP} is {found}, expected two of "
            f"{', '.join(names.WRAPS)}"
        )
    return found[0], found[1]


def _length(prim: Usd.Prim, name: str) -> float:
    meters = UsdGeom.GetStageMetersPerUnit(prim.GetStage())
    length_m = meters * values.number(prim.GetAttribute(name), 0.0)
    if not 0.0 < length_m < math.inf:
        raise StageError(f"{prim.GetPath()}: {name} must be above 0")
    return length_m


def _normal_reflectance(shader: UsdShade.Shader) -> float:
    if _input(shader, "useSpecularWorkflow", 0) == 1:
        color = _color_input(shader, "specularColor")
        return float(np.mean(color)) if color is not None else 0.0
    ior = _input(shader, "ior", 1.5)
    # None is 0 or less: as models from files are read.
    return ((ior - 1.0) / (ior + 1.0)) ** 2 if ior > 0.0 else 1.0


def _input(shader: UsdShade.Shader, name: str, default: float) -> float:
    return values.number(constant(shader, name), default, FIRST)


def _color_input(shader: UsdShade.Shader, name: str) -> tuple[float, ...] | None:
    return values.vector(constant(shader, name), 3, FIRST)


def _reflectance_of(prim: Usd.Prim) -> Reflectance | None:
    """The law of a material; None for Lambert's.

    Raises:
        StageError: A law that is not known, or a number outside of its range.
    """
    attribute = prim.GetAttribute(names.ATTR_REFLECTANCE)
    model = values.word(attribute, names.REFLECTANCES[0], known=names.REFLECTANCES)
    if model == names.REFLECTANCES[0]:
        return None
    opposition = _number(prim, names.ATTR_OPPOSITION)
    return Reflectance(
        model,
        _number(prim, names.ATTR_PHASE_B),
        _number(prim, names.ATTR_PHASE_C),
        opposition,
        # Of no meaning without a surge.
        _number(prim, names.ATTR_OPPOSITION_WIDTH) if opposition > 0.0 else 1.0,
        math.radians(_number(prim, names.ATTR_MEAN_SLOPE)) if model == "hapke" else 0.0,
    )


def _number(prim: Usd.Prim, name: str) -> float:
    """An attribute within its range; 0 where it is not authored."""
    value = values.number(prim.GetAttribute(name), 0.0, finite=False)
    low, with_low, high, with_high = _RANGES[name]
    above = value >= low if with_low else value > low
    below = value <= high if with_high else value < high
    if not (above and below):
        left, right = "[" if with_low else "(", "]" if with_high else ")"
        raise StageError(
            f"{prim.GetPath()}: {name} is {value}, expected a number in "
            f"{left}{low:g}, {high:g}{right}"
        )
    return value


def _cells_of(prim: Usd.Prim, projection: str) -> Cells | None:
    """A material's cells, or None; the seed is 0 where it is not authored.

    Raises:
        StageError: A size that is not above 0, or another projection than from above.
    """
    if values.value_of(prim.GetAttribute(names.ATTR_MAP_CELL_SIZE)) is None:
        return None
    size_m = _length(prim, names.ATTR_MAP_CELL_SIZE)
    _require_above(prim, names.ATTR_MAP_CELL_SIZE, projection)
    seed = values.whole(prim.GetAttribute(names.ATTR_MAP_CELL_SEED), 0)
    if not 0 <= seed < 2**32:
        raise StageError(
            f"{prim.GetPath()}: {names.ATTR_MAP_CELL_SEED} is {seed}, expected a whole number "
            "from 0 to 2**32 - 1"
        )
    return Cells(size_m, seed)


def _far_of(prim: Usd.Prim, projection: str) -> tuple[float, float] | None:
    """A material's (factor, share) of the colors' larger scale, or None.

    Raises:
        StageError: A factor below 1, a share outside of [0, 1], or another projection than from
            above.
    """
    found = values.vector(prim.GetAttribute(names.ATTR_MAP_FAR), 2)
    if found is None:
        return None
    factor, share = found
    if not (1.0 <= factor < math.inf and 0.0 <= share <= 1.0):
        raise StageError(
            f"{prim.GetPath()}: {names.ATTR_MAP_FAR} is ({factor:g}, {share:g}), expected a factor "
            "of at least 1 and a share in [0, 1]"
        )
    _require_above(prim, names.ATTR_MAP_FAR, projection)
    return (factor, share) if share > 0.0 else None


def _emission_of(prim: Usd.Prim) -> tuple[float, float, float]:
    """Radiance that a material gives off; black where none is authored.

    Raises:
        StageError: Not three finite numbers, none below 0.
    """
    found = values.vector(prim.GetAttribute(names.ATTR_EMISSION), 3)
    if found is None:
        return (0.0, 0.0, 0.0)
    red, green, blue = found
    if not all(0.0 <= value < math.inf for value in found):
        raise StageError(
            f"{prim.GetPath()}: {names.ATTR_EMISSION} is {found}, expected finite numbers, none "
            "below 0"
        )
    return (red, green, blue)


def read_height_blends(prim: Usd.Prim, merges: int) -> tuple[float, ...]:
    """Depths of a mesh's merges; empty where all are 0.

    Raises:
        StageError: Not one finite number, not below 0, for each merge.
    """
    name = names.ATTR_HEIGHT_BLENDS
    attribute = prim.GetAttribute(name)
    if values.value_of(attribute) is None:
        return ()
    found = tuple(values.array(attribute, np.float64).tolist())
    if len(found) != merges or not all(0.0 <= depth < math.inf for depth in found):
        raise StageError(
            f"{prim.GetPath()}: {name} must hold {merges} finite floats, one a merge and none "
            f"below 0, has {list(found)}"
        )
    return found if any(found) else ()


def _require_above(prim: Usd.Prim, name: str, projection: str) -> None:
    if projection != "above":
        raise StageError(
            f"{prim.GetPath()}: {name} is for maps of the projection above, not {projection}"
        )
