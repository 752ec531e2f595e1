"""Draws the materials of a batch."""

from __future__ import annotations

from typing import Any

from scenec.compiler.cfg.load import Spec
from scenec.compiler.distributions.resolve import resolve
from scenec.compiler.distributions.streams import Streams
from scenec.compiler.draw.maps import draw_maps
from scenec.compiler.scene.scene import Material, Reflectance


def draw_materials(spec: Spec, streams: Streams) -> dict[str, Material]:
    """All materials of a batch, in the cfg's order; pictures are not made yet."""
    worn = _worn(spec.cfg["objects"])
    return {
        name: _material(
            spec,
            f"materials/{name}",
            resolve(node, streams, f"materials/{name}"),
            name in worn,
            streams,
        )
        for name, node in spec.cfg["materials"].items()
    }


def _worn(objects: dict[str, Any]) -> set[str]:
    """Materials that the cfg gives to objects, or parts of them."""
    users = [
        *objects.values(),
        *(p for o in objects.values() for p in (o.get("parts") or {}).values()),
    ]
    return {user["material"] for user in users if user.get("material")}


def _material(
    spec: Spec, path: str, node: dict[str, Any], worn: bool, streams: Streams
) -> Material:
    # Left out, it is a factor of 1 on a map's colors.
    red, green, blue = node["base_color"] or (1.0, 1.0, 1.0)
    emission = tuple(node["emission"] or (0.0, 0.0, 0.0))
    maps = None
    if node["maps"] is not None:
        maps = draw_maps(spec, path, node["maps"], worn, max(emission) > 0.0, streams)
    return Material(
        (red, green, blue),
        node["roughness"],
        node["specular"],
        node["variation"],
        node["metallic"],
        maps,
        node["roughness_variation"],
        _reflectance(node["reflectance"]),
        emission,
    )


def _reflectance(node: dict[str, Any] | None) -> Reflectance | None:
    if node is None or node["type"] == "lambert":
        return None
    return Reflectance(
        node["type"],
        node["b"],
        node["c"],
        node["opposition"],
        node["opposition_width"],
        node.get("roughness_deg", 0.0),
    )
