"""The shared surface model as Mitsuba BSDFs: Lambert and GGX lobes, alpha = roughness**2."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenec.backends.maps import load_map
from scenec.backends.mitsuba import product
from scenec.backends.mitsuba.geometry import FlatMesh
from scenec.backends.render_scene import Maps, Surface

#: GGX in float32 loses its digits below this; roughness under 0.032 is drawn as 0.032.
MIN_ALPHA = 1e-3


@dataclass(frozen=True)
class Look:
    """What a flattened mesh is made of.

    Attributes:
        bsdf: Dictionary for ``mi.load_dict``.
        attributes: Vertex attributes the BSDF reads, name -> float32 [n, channels].
    """

    bsdf: dict[str, Any]
    attributes: dict[str, NDArray[np.float32]]


def make_look(
    mi: Any, surfaces: Sequence[Surface], flat: FlatMesh, center: NDArray[np.float64]
) -> Look:
    """The cheapest BSDF that equals the merge of the layers.

    Args:
        mi: Mitsuba.
        surfaces: The layers, base first.
        flat: The mesh; its texture coordinates are x and y relative to ``center``.
        center: Of the scene, meters.
    """
    if any(surface.maps for surface in surfaces):
        return _mapped_look(mi, surfaces, flat, center)
    return _plain_look(surfaces, flat)


def _plain_look(surfaces: Sequence[Surface], flat: FlatMesh) -> Look:
    """Layers without maps: the model is linear in its lobes, so equal ones add up.

    With the share W_i of layer i at a vertex, all Lambert lobes are one, of albedo
    sum W_i (1 - m_i) (1 - s_i) c_i, and all GGX lobes of one roughness are one, of weight
    sum W_i ((1 - m_i) s_i + m_i) and a color that is the mean of white and c_i in these parts: n
    layers take one diffuse BSDF and one per distinct roughness, not 3 n. Shares and colors stand on
    the vertices and are linear between them; where layers differ in gloss, products of the two are
    not, an error of second order in the change of weight across a triangle (a tenth of one albedo
    against another's if it goes from 0 to 1 in one step, nothing where all are equally glossy).
    """
    shares = layer_shares(flat.weights, len(surfaces))
    lobes: dict[float, tuple[NDArray[np.float32], NDArray[np.float32]]] = {}
    dull = np.zeros((1, 3), np.float32)
    for surface, share, color in zip(surfaces, shares, flat.colors, strict=True):
        white = np.float32((1.0 - surface.metallic) * surface.specular)
        metal = np.float32(surface.metallic)
        dull = dull + (np.float32(1.0) - metal - white) * share[:, None] * color
        if white + metal > 0.0:
            alpha = max(surface.roughness**2, MIN_ALPHA)
            weight, tinted = lobes.get(alpha, (np.zeros(1, "f4"), np.zeros((1, 3), "f4")))
            # A lobe without metal is white: no color a vertex for it.
            tint = white + metal * color if metal > 0.0 else np.full((1, 3), white)
            lobes[alpha] = (weight + (white + metal) * share, tinted + share[:, None] * tint)
    gloss = sum((weight for weight, _ in lobes.values()), np.zeros(1, np.float32))
    left = np.maximum(1.0 - gloss, 1e-6)[:, None]
    attributes: dict[str, NDArray[np.float32]] = {}
    bsdf: dict[str, Any] = {
        "type": "diffuse",
        "reflectance": _texture(np.clip(dull / left, 0.0, 1.0), "vertex_color", attributes),
    }
    if lobes:
        bsdf = _blend(_texture(gloss[:, None], "vertex_gloss", attributes), bsdf,
                      _glossy(lobes, attributes))  # fmt: skip
    return Look({"type": "twosided", "bsdf": bsdf}, attributes)


def _mapped_look(
    mi: Any, surfaces: Sequence[Surface], flat: FlatMesh, center: NDArray[np.float64]
) -> Look:
    """Layers with maps: each a BSDF of its own, mixed from the base up by their weights."""
    product.register(mi)
    attributes: dict[str, NDArray[np.float32]] = {}
    bsdf: dict[str, Any] | None = None
    for number, (surface, color) in enumerate(zip(surfaces, flat.colors, strict=True)):
        layer = _layer(mi, surface, _texture(color, f"vertex_color_{number}", attributes), center)
        if bsdf is None:
            bsdf = layer
        else:
            weight = flat.weights[number - 1][:, None]
            bsdf = _blend(_texture(weight, f"vertex_weight_{number}", attributes), bsdf, layer)
    assert bsdf is not None
    return Look({"type": "twosided", "bsdf": bsdf}, attributes)


def _layer(mi: Any, surface: Surface, color: Any, center: NDArray[np.float64]) -> dict[str, Any]:
    """One surface, with its maps if it has any."""
    maps = surface.maps or Maps(1.0)

    def bitmap(path: Any, kind: str, flip_green: bool = False) -> dict[str, Any]:
        values = load_map(path, kind, flip_green)
        if kind == "normal":
            # As the plugin decodes it.
            values = 0.5 * (values + np.float32(1.0))
        size = maps.size_m
        to_uv = np.eye(3)
        to_uv[0, 0] = to_uv[1, 1] = 1.0 / size
        # The whole repeats between the stage's origin and the scene's center leave no trace.
        to_uv[:2, 2] = np.mod(center[:2] / size, 1.0)
        return {
            "type": "bitmap",
            # Mitsuba's v runs down the picture. A copy: it takes no read-only arrays.
            "bitmap": mi.Bitmap(np.array(values[::-1], np.float32)),
            "raw": True,
            "to_uv": mi.ScalarTransform3f(to_uv),
        }

    if maps.base_color is not None:
        color = product.texture(mi, bitmap(maps.base_color, "base_color"), color, upper=1.0)
    alpha: Any = max(surface.roughness**2, MIN_ALPHA)
    if maps.roughness is not None:
        rough = bitmap(maps.roughness, "roughness")
        # Squared after it was interpolated, as in every renderer.
        alpha = product.texture(mi, rough, rough, lower=MIN_ALPHA)
    metallic: Any = surface.metallic
    if maps.metallic is not None:
        metallic = bitmap(maps.metallic, "metallic")
    bsdf: dict[str, Any] = {"type": "diffuse", "reflectance": color}
    if surface.specular > 0.0:
        bsdf = _blend(surface.specular, bsdf, _ggx(alpha))
    if maps.metallic is not None or surface.metallic > 0.0:
        bsdf = _blend(metallic, bsdf, _ggx(alpha, color))
    if maps.normal is not None:
        bsdf = {
            "type": "normalmap",
            "normalmap": bitmap(maps.normal, "normal", maps.flip_green),
            # Cycles knows no such shadowing, and its like is off there.
            "use_shadowing_function": False,
            "bsdf": bsdf,
        }
    return bsdf


def _blend(weight: Any, below: dict[str, Any], above: dict[str, Any]) -> dict[str, Any]:
    # blendbsdf takes its children by name in alphabetical order: weight 0 is the first.
    return {"type": "blendbsdf", "weight": weight, "a": below, "b": above}


def _ggx(alpha: Any, color: Any = None) -> dict[str, Any]:
    # "none" is a perfect mirror: the lobe is single-scatter GGX, no Fresnel.
    lobe = {"type": "roughconductor", "material": "none", "distribution": "ggx", "alpha": alpha}
    return lobe if color is None else {**lobe, "specular_reflectance": color}


def layer_shares(weights: NDArray[np.float32], layers: int) -> list[NDArray[np.float32]]:
    """Share of each layer: w_i times all (1 - w_j) of later merges; [n] or [1] each."""
    shares: list[NDArray[np.float32]] = []
    rest = np.ones(1, np.float32)
    for merge in range(layers - 2, -1, -1):
        shares.append(weights[merge] * rest)
        rest = (np.float32(1.0) - weights[merge]) * rest
    return [rest, *reversed(shares)]


def _glossy(
    lobes: dict[float, tuple[NDArray[np.float32], NDArray[np.float32]]],
    attributes: dict[str, NDArray[np.float32]],
) -> dict[str, Any]:
    """All GGX lobes, each by its part of their sum, each with its color."""
    bsdf: dict[str, Any] = {}
    total = np.zeros(1, np.float32)
    for number, (alpha, (weight, tinted)) in enumerate(lobes.items()):
        # White where there is nothing to tint.
        of = weight[:, None]
        tint = np.where(of > 0.0, tinted / np.maximum(of, np.float32(1e-30)), np.float32(1.0))
        tint = np.clip(tint, 0.0, 1.0)
        white = bool(np.all(tint > 1.0 - 1e-6))
        lobe = _ggx(alpha, None if white else _texture(tint, f"vertex_tint_{number}", attributes))
        total = total + weight
        part = np.divide(weight, total, out=np.zeros_like(total), where=total > 0.0)
        bsdf = (
            _blend(_texture(part[:, None], f"vertex_gloss_{number}", attributes), bsdf, lobe)
            if bsdf
            else lobe
        )
    return bsdf


def _texture(
    values: NDArray[np.float32], name: str, attributes: dict[str, NDArray[np.float32]]
) -> Any:
    """A constant where all vertices agree, else an attribute of that name."""
    if len(values) == 1 or np.all(values == values[:1]):
        first = values[0].tolist()
        return float(first[0]) if len(first) == 1 else {"type": "rgb", "value": first}
    attributes[name] = np.ascontiguousarray(values, np.float32)
    return {"type": "mesh_attribute", "name": name}
