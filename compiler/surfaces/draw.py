"""Draws the materials of a batch."""

from __future__ import annotations

from typing import Any

from scenec.compiler.frontend.load import Spec
from scenec.compiler.frontend.of_keys import of_keys
from scenec.compiler.frontend.resolve import resolve
from scenec.compiler.frontend.streams import Streams
from scenec.compiler.scene import Material, MaterialMaps
from scenec.compiler.surfaces.kinds import SURFACES
from scenec.schemas.maps import MAP_CHANNELS


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
    maps = None
    if node["maps"] is not None:
        surface = None
        if node["maps"]["procedural"] is not None:
            at = f"{path}/maps/procedural"
            surface = of_keys(spec, SURFACES, node["maps"]["procedural"], streams, at)
        maps = MaterialMaps(
            size_m=node["maps"]["size_m"] or (surface.SIZE_M if surface else 1.0),
            files={
                kind: spec.files[f"{path}/maps/{kind}"].path
                for kind in MAP_CHANNELS
                if node["maps"].get(kind) is not None
            },
            normal_convention=node["maps"]["normal_convention"],
            projection=node["maps"]["projection"] or ("triplanar" if worn else "above"),
            procedural=surface,
        )
    return Material(
        (red, green, blue),
        node["roughness"],
        node["specular"],
        node["variation"],
        node["metallic"],
        maps,
        node["roughness_variation"],
    )
