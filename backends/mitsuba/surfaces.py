"""The shared surface model as Mitsuba BSDFs: Lambert and GGX lobes, alpha = roughness**2."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenec.backends.mitsuba import ggx, heights, mix, planetary, product, projection, sided, stack
from scenec.backends.mitsuba.geometry import FlatMesh
from scenec.backends.mitsuba.mix import MIN_ALPHA
from scenec.backends.stage.scene import Maps, Surface
from scenec.backends.surface.heights import FLAT, needed


@dataclass(frozen=True)
class Look:
    """What a flattened mesh is made of.

    Attributes:
        bsdf: Mitsuba's.
        attributes: Vertex attributes the BSDF reads, name -> float32 [n, channels].
        emission: Dictionary of a texture of the radiance given off, or None.
    """

    bsdf: Any
    attributes: dict[str, NDArray[np.float32]]
    emission: dict[str, Any] | None = None


def make_look(
    mi: Any, surfaces: Sequence[Surface], flat: FlatMesh, center: NDArray[np.float64]
) -> Look:
    """The cheapest BSDF that equals the merge of the layers.

    Args:
        mi: Mitsuba.
        surfaces: The layers, base first.
        flat: The mesh; its texture coordinates are x and y relative to ``center``, unless a surface
            has maps by the mesh's own.
        center: Of the scene, meters.
    """
    # Textures of ours are compiled into the kernel, but call Python at each point in scalar_rgb.
    # And laws other than Lambert's are not linear in the color: such layers do not add up.
    nested = any(s.maps or s.reflectance or s.emits for s in surfaces) or flat.height_blends
    if mi.variant().startswith("scalar"):
        return _nested_look(mi, surfaces, flat, center)
    if nested:
        return _stacked_look(mi, surfaces, flat, center)
    return _merged_look(mi, surfaces, flat)


def _stacked_look(
    mi: Any, surfaces: Sequence[Surface], flat: FlatMesh, center: NDArray[np.float64]
) -> Look:
    """All layers, maps or not, as one BSDF; what they give off as textures of its own."""
    bsdf, attributes = stack.make(mi, surfaces, flat, center)
    return Look(bsdf, attributes, _glow(mi, surfaces, flat, center, attributes))


def _merged_look(mi: Any, surfaces: Sequence[Surface], flat: FlatMesh) -> Look:
    """Layers without maps: the model is linear in its lobes, so equal ones add up.

    With the share W_i of layer i, all Lambert lobes are one, of albedo
    sum W_i (1 - m_i) (1 - s_i) c_i, and all GGX lobes of one ``mix.Gloss`` are one, of weight
    sum W_i ((1 - m_i) s_i + m_i) and a color that is the mean of white and c_i in these parts: n
    layers take one diffuse BSDF and one per distinct gloss, not 3 n.
    """
    layers, attributes = mix.pack(surfaces, flat)
    glosses, lobes = mix.glosses_of(layers), mix.lobes_of(layers)

    def quantity(kind: str, lobe: int = 0) -> Any:
        made = mix.texture(mi, layers, kind, lobe)
        if not layers.constant:
            return made
        # The same everywhere: a number, which Mitsuba compiles better.
        point = mi.SurfaceInteraction3f()
        if kind in ("diffuse", "tint"):
            return {"type": "rgb", "value": np.array(made.eval(point)).ravel().tolist()}
        return float(np.array(made.eval_1(point)).ravel()[0])

    bsdf: dict[str, Any] = {"type": "diffuse", "reflectance": quantity("diffuse")}
    if lobes:
        glossy: dict[str, Any] = {}
        for number, gloss in enumerate(lobes):
            metal = any(
                surface.metallic > 0.0 and own == gloss
                for surface, own in zip(surfaces, glosses, strict=True)
            )
            alpha = gloss.alpha if gloss.variation == 0.0 else quantity("alpha", number)
            lobe = ggx.lobe(mi, alpha, quantity("tint", number) if metal else None)
            glossy = _blend(quantity("part", number), glossy, lobe) if glossy else lobe
        bsdf = _blend(quantity("gloss"), bsdf, glossy)
    return Look(mi.load_dict(sided.both_sides(mi, bsdf)), attributes)


def _nested_look(
    mi: Any, surfaces: Sequence[Surface], flat: FlatMesh, center: NDArray[np.float64]
) -> Look:
    """Each layer a BSDF of its own, mixed from the base up by their weights."""
    if any(surface.maps or surface.emits for surface in surfaces):
        product.register(mi)
    attributes: dict[str, NDArray[np.float32]] = {}
    bsdf: dict[str, Any] | None = None
    by_uv = _by_uv(surfaces)
    colors = vertex_colors(surfaces, flat)
    weights = _merge_weights(mi, surfaces, flat, center, by_uv, attributes)
    for number, (surface, values) in enumerate(zip(surfaces, colors, strict=True)):
        color = _texture(values, f"vertex_color_{number}", attributes)
        gloss = _gloss(mi, surface, flat, f"vertex_rough_{number}", attributes)
        layer = _layer(mi, surface, color, gloss, center, by_uv)
        bsdf = layer if bsdf is None else _blend(weights[number - 1], bsdf, layer)
    assert bsdf is not None
    # What surfaces give off is left out in ``scalar_rgb``.
    return Look(mi.load_dict(sided.both_sides(mi, bsdf)), attributes)


def _merge_weights(
    mi: Any,
    surfaces: Sequence[Surface],
    flat: FlatMesh,
    center: NDArray[np.float64],
    by_uv: bool,
    attributes: dict[str, NDArray[np.float32]],
) -> list[Any]:
    """Textures or numbers that layers are blended by; those of maps where heights count."""
    plain = [
        _texture(weight[:, None], f"vertex_weight_{number}", attributes)
        for number, weight in enumerate(flat.weights, 1)
    ]
    count = needed(flat.height_blends)
    if not count:
        return plain

    def height(surface: Surface) -> Any:
        if surface.maps is None or surface.maps.height is None:
            return FLAT
        return mi.load_dict(projection.texture(mi, surface.maps, "height", center, by_uv))

    # Loaded, so that what several merges heed stands once.
    levels = [height(surface) for surface in surfaces[:count]]
    shared = [mi.load_dict(w) if isinstance(w, dict) else w for w in plain[: count - 1]]
    found = list(plain)
    for merge, depth in enumerate(flat.height_blends[: count - 1], 1):
        found[merge - 1] = shared[merge - 1]
        if depth > 0.0:
            made = heights.weight_texture(
                mi, shared[:merge], flat.height_blends[:merge], levels[: merge + 1]
            )
            found[merge - 1] = mi.load_dict(made)
    return found


def _glow(
    mi: Any,
    surfaces: Sequence[Surface],
    flat: FlatMesh,
    center: NDArray[np.float64],
    attributes: dict[str, NDArray[np.float32]],
) -> dict[str, Any] | None:
    """Dictionary of a texture of what the layers give off; adds what it reads to ``attributes``."""
    if not any(surface.emits for surface in surfaces):
        return None
    product.register(mi)
    by_uv = _by_uv(surfaces)
    weights = _merge_weights(mi, surfaces, flat, center, by_uv, attributes)
    given = [_emission(mi, surface, center, by_uv) for surface in surfaces]
    return heights.mix_texture(mi, weights, given)


def _by_uv(surfaces: Sequence[Surface]) -> bool:
    """Whether the mesh's texture coordinates are the scene's."""
    return any(s.maps is not None and s.maps.projection == "uv" for s in surfaces)


def _emission(
    mi: Any, surface: Surface, center: NDArray[np.float64], by_uv: bool
) -> dict[str, Any]:
    maps = surface.maps
    if surface.emits and maps is not None and maps.emission is not None:
        picture = projection.texture(mi, maps, "emission", center, by_uv)
        return product.texture(mi, picture, {"type": "rgb", "value": list(surface.emission)})
    return product.constant(mi, surface.emission)


def vertex_colors(surfaces: Sequence[Surface], flat: FlatMesh) -> list[NDArray[np.float32]]:
    """Base color of each layer at the vertices, [n, 3] or [1, 3]."""
    colors = []
    for surface in surfaces:
        color = np.array(surface.base_color) * _vertex_factors(flat, surface.variation)[:, None]
        # Above 1 it is clipped, but after the map where there is one.
        upper = np.inf if surface.maps and surface.maps.base_color else 1.0
        colors.append(np.clip(color, 0.0, upper).astype(np.float32))
    return colors


def _vertex_factors(flat: FlatMesh, amount: float) -> NDArray[np.float64]:
    """(1 + amount * vertex's) * (1 + amount * row's) at the vertices, [n] or [1]."""
    factors = np.ones(1)
    for variation in (flat.variation, flat.row_variation):
        if variation is not None and amount != 0.0:
            factors = factors * (1.0 + amount * variation.astype(np.float64))
    return factors


def _gloss(
    mi: Any,
    surface: Surface,
    flat: FlatMesh,
    name: str,
    attributes: dict[str, NDArray[np.float32]],
) -> Any:
    """Alpha; of a surface with a map of roughness, the factor on that. A number or a texture."""
    values = _vertex_factors(flat, surface.roughness_variation if surface.glossy else 0.0)
    if surface.maps is not None and surface.maps.roughness is not None:
        return _texture(values[:, None], name, attributes)
    values = surface.roughness * values
    if mi.variant().startswith("scalar") or np.all(values == values[0]):
        alpha = np.maximum(np.clip(values, 0.0, 1.0) ** 2, MIN_ALPHA)
        return _texture(alpha[:, None], name, attributes)
    rough = _texture(values[:, None], name, attributes)
    # Squared after it was interpolated, as in every renderer.
    return product.texture(mi, rough, rough, lower=MIN_ALPHA, upper=1.0)


def _layer(
    mi: Any,
    surface: Surface,
    color: Any,
    gloss: Any,
    center: NDArray[np.float64],
    by_uv: bool,
) -> dict[str, Any]:
    """One surface, with its maps if it has any; ``gloss`` as ``_gloss`` gives it."""
    maps = surface.maps or Maps(1.0)

    def picture(kind: str) -> dict[str, Any]:
        return projection.texture(mi, maps, kind, center, by_uv)

    if maps.base_color is not None:
        color = product.texture(mi, picture("base_color"), color, upper=1.0)
    alpha: Any = gloss
    if maps.roughness is not None:
        rough = picture("roughness")
        if gloss != 1.0:
            rough = product.texture(mi, rough, gloss, upper=1.0)
        alpha = product.texture(mi, rough, rough, lower=MIN_ALPHA)
    metallic: Any = surface.metallic
    if maps.metallic is not None:
        metallic = picture("metallic")
    bsdf: dict[str, Any] = {"type": "diffuse", "reflectance": color}
    if surface.reflectance is not None:
        bsdf = planetary.lobe(mi, color, surface.reflectance)
    if surface.specular > 0.0:
        bsdf = _blend(surface.specular, bsdf, ggx.lobe(mi, alpha))
    if maps.metallic is not None or surface.metallic > 0.0:
        bsdf = _blend(metallic, bsdf, ggx.lobe(mi, alpha, color))
    if maps.normal is not None:
        bsdf = {
            "type": "normalmap",
            "normalmap": picture("normal"),
            # Cycles knows no such shadowing, and its like is off there.
            "use_shadowing_function": False,
            "bsdf": bsdf,
        }
    return bsdf


def _blend(weight: Any, below: dict[str, Any], above: dict[str, Any]) -> dict[str, Any]:
    # blendbsdf takes its children by name in alphabetical order: weight 0 is the first.
    return {"type": "blendbsdf", "weight": weight, "a": below, "b": above}


def _texture(
    values: NDArray[np.floating], name: str, attributes: dict[str, NDArray[np.float32]]
) -> Any:
    """A constant where all vertices agree, else an attribute of that name."""
    if len(values) == 1 or np.all(values == values[:1]):
        first = values[0].tolist()
        return float(first[0]) if len(first) == 1 else {"type": "rgb", "value": first}
    attributes[name] = np.ascontiguousarray(values, np.float32)
    return {"type": "mesh_attribute", "name": name}
