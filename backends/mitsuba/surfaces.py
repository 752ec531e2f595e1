"""The shared surface model as Mitsuba BSDFs: (1-s)*Lambert + s*GGX(alpha = roughness**2)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenec.backends.mitsuba.geometry import FlatMesh, mix_colors
from scenec.backends.render_scene import Surface

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


def make_look(surfaces: Sequence[Surface], flat: FlatMesh) -> Look:
    """Choose the cheapest BSDF that equals the merge of the layers.

    Lambert's albedo enters the model linearly, so layers that share s and roughness are one BSDF
    with the merged color at the vertices. Others are blended BSDF by BSDF, in the order of merges.
    """
    lobes = {_lobe(s) for s in surfaces}
    attributes: dict[str, NDArray[np.float32]] = {}
    if len(lobes) == 1:
        colors = mix_colors(flat.colors, flat.weights) if len(surfaces) > 1 else flat.colors[0]
        bsdf = _layer(surfaces[0], colors, "vertex_color", attributes)
    else:
        bsdf = _layer(surfaces[0], flat.colors[0], "vertex_color_0", attributes)
        for i in range(1, len(surfaces)):
            weight = f"vertex_weight_{i}"
            attributes[weight] = flat.weights[i - 1][:, None]
            bsdf = {
                "type": "blendbsdf",
                "weight": {"type": "mesh_attribute", "name": weight},
                "below": bsdf,
                "over": _layer(surfaces[i], flat.colors[i], f"vertex_color_{i}", attributes),
            }
    return Look({"type": "twosided", "bsdf": bsdf}, attributes)


def _lobe(surface: Surface) -> tuple[float, float]:
    return (surface.specular, surface.roughness if surface.specular > 0.0 else 0.0)


def _layer(
    surface: Surface,
    colors: NDArray[np.float32],
    name: str,
    attributes: dict[str, NDArray[np.float32]],
) -> dict[str, Any]:
    if len(colors) == 1:
        reflectance: dict[str, Any] = {"type": "rgb", "value": colors[0].tolist()}
    else:
        attributes[name] = colors
        reflectance = {"type": "mesh_attribute", "name": name}
    diffuse = {"type": "diffuse", "reflectance": reflectance}
    if surface.specular <= 0.0:
        return diffuse
    alpha = max(surface.roughness**2, MIN_ALPHA)
    # "none" is a perfect mirror: the lobe is single-scatter GGX with a white tint, no Fresnel.
    gloss = {"type": "roughconductor", "material": "none", "distribution": "ggx", "alpha": alpha}
    # blendbsdf takes its children by name in alphabetical order: weight 0 is the first.
    return {"type": "blendbsdf", "weight": float(surface.specular), "a": diffuse, "b": gloss}
