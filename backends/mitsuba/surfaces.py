"""The shared surface model as Mitsuba BSDFs: (1-s)*Lambert + s*GGX(alpha = roughness**2)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenec.backends.mitsuba.geometry import FlatMesh
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
    """The cheapest BSDF that equals the merge of the layers.

    The model is linear in its lobes. With the share W_i of layer i at a vertex, all Lambert lobes
    are one, of albedo sum W_i (1 - s_i) c_i, and all GGX lobes of one roughness are one, of weight
    sum W_i s_i: n layers take one diffuse BSDF and one per distinct roughness, not 2 n. Shares and
    albedo stand on the vertices and are linear between them.
    """
    shares = layer_shares(flat.weights, len(surfaces))
    lobes: dict[float, NDArray[np.float32]] = {}
    for surface, share in zip(surfaces, shares, strict=True):
        if surface.specular > 0.0:
            alpha = max(surface.roughness**2, MIN_ALPHA)
            lobes[alpha] = lobes.get(alpha, np.float32(0.0)) + np.float32(surface.specular) * share
    gloss = sum(lobes.values(), np.zeros(1, np.float32))
    dull = [np.float32(1.0 - surface.specular) * share[:, None] for surface, share in zip(
        surfaces, shares, strict=True)]  # fmt: skip
    color = sum((w * c for w, c in zip(dull, flat.colors, strict=True)), np.zeros((1, 3), "f4"))
    left = np.maximum(1.0 - gloss, 1e-6)[:, None]
    attributes: dict[str, NDArray[np.float32]] = {}
    bsdf: dict[str, Any] = {
        "type": "diffuse",
        "reflectance": _texture(np.clip(color / left, 0.0, 1.0), "vertex_color", attributes),
    }
    if lobes:
        # blendbsdf takes its children by name in alphabetical order: weight 0 is the first.
        bsdf = {
            "type": "blendbsdf",
            "weight": _texture(gloss[:, None], "vertex_gloss", attributes),
            "a": bsdf,
            "b": _glossy(lobes, attributes),
        }
    return Look({"type": "twosided", "bsdf": bsdf}, attributes)


def layer_shares(weights: NDArray[np.float32], layers: int) -> list[NDArray[np.float32]]:
    """Share of each layer: w_i times all (1 - w_j) of later merges; [n] or [1] each."""
    shares: list[NDArray[np.float32]] = []
    rest = np.ones(1, np.float32)
    for merge in range(layers - 2, -1, -1):
        shares.append(weights[merge] * rest)
        rest = (np.float32(1.0) - weights[merge]) * rest
    return [rest, *reversed(shares)]


def _glossy(
    lobes: dict[float, NDArray[np.float32]], attributes: dict[str, NDArray[np.float32]]
) -> dict[str, Any]:
    """All GGX lobes, each by its part of their sum."""
    bsdf: dict[str, Any] = {}
    total = np.zeros(1, np.float32)
    for number, (alpha, weight) in enumerate(lobes.items()):
        # "none" is a perfect mirror: the lobe is single-scatter GGX with a white tint, no Fresnel.
        lobe = {
            "type": "roughconductor",
            "material": "none",
            "distribution": "ggx",
            "alpha": alpha,
        }
        total = total + weight
        part = np.divide(weight, total, out=np.zeros_like(total), where=total > 0.0)
        bsdf = lobe if not bsdf else {
            "type": "blendbsdf",
            "weight": _texture(part[:, None], f"vertex_gloss_{number}", attributes),
            "a": bsdf,
            "b": lobe,
        }  # fmt: skip
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
