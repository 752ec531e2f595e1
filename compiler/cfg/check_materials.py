"""What must hold between the keys of a material, and between its pictures and their users."""

from __future__ import annotations

from collections.abc import Iterator

from scenec.compiler.kinds.finding import Finding, Path
from scenec.compiler.kinds.node import Node
from scenec.schemas.spelling import shown

#: Keys of maps that are pictures, or are made into some.
_PICTURES = (
    "base_color", "roughness", "gloss", "metallic", "normal", "ambient_occlusion", "displacement",
    "emission", "folder", "procedural",
)  # fmt: skip


def check_materials(cfg: Node) -> Iterator[Finding]:
    """Findings on materials and their pictures."""
    objects = cfg.each("objects", "*")
    worn = {
        (*node.path, "material"): node["material"]
        for node in (
            *objects,
            *cfg.each("objects", "*", "parts", "*"),
            *cfg.each("objects", "*", "coatings", "*"),
        )
        if node["material"] is not None
    }
    ground = (*cfg.each("terrain", "ground", "*"), *cfg.each("terrain", "horizon"))
    users = {
        "ground": {layer["material"] for layer in ground},
        "rocks": {
            user["material"]
            for thing in objects
            if thing["type"] == "rocks"
            for user in (thing, *thing.each("coatings", "*"))
        },
    }
    displaced: dict[str, str] = {}
    for material in cfg.each("materials", "*"):
        name, maps = str(material.path[-1]), material.at("maps")
        if material.entries.get("displacement"):
            displaced[name] = "a displacement"
        if maps:
            yield from _check_maps(maps, [user for user in users if name in users[user]])
            yield from _check_above(maps, name in worn.values())
            yield from _check_sources(maps, material)
            if _is_high(maps):
                displaced[name] = "pictures that become geometry"
        if not ("base_color" in material or "base_color" in maps or "folder" in maps):
            yield material.fault("expected the key base_color, or one in maps")
    yield from _check_worn(worn, displaced)
    yield from _check_blends(cfg)


def _is_high(maps: Node) -> bool:
    return bool(maps["displacement_m"] or maps.at("procedural")["displacement"])


def _check_worn(worn: dict[Path, str], displaced: dict[str, str]) -> Iterator[Finding]:
    for path, name in worn.items():
        if name in displaced:
            yield Finding(
                path,
                f"{shown(name)} has {displaced[name]}, for the ground only: expected one without",
            )


def _check_maps(maps: Node, users: list[str]) -> Iterator[Finding]:
    if not any(key in maps for key in _PICTURES):
        yield maps.fault(f"expected one of {', '.join(_PICTURES)}, or more")
    if maps["projection"] != "uv":
        if "procedural" not in maps and "size_m" not in maps:
            yield maps.fault("expected the key size_m")
        return
    if "procedural" in maps:
        yield maps.key_fault(
            "procedural pictures lie in the world: expected the projection triplanar or above",
            "procedural",
        )
    if "size_m" in maps:
        yield maps.key_fault(
            "with the projection uv the mesh says how large the pictures are: take it away",
            "size_m",
        )
    if users:
        yield maps.fault(
            f"{' and '.join(users)} of this material have no texture coordinates: expected "
            '"triplanar" or "above"',
            "projection",
        )


def _check_above(maps: Node, worn: bool) -> Iterator[Finding]:
    """Keys that only pictures projected from above know."""
    given, projection = "projection" in maps, maps["projection"]
    if projection not in ("triplanar", "uv") if given else not worn:
        return
    keys: list[Path] = [(key,) for key in ("cells", "far") if key in maps]
    keys += [("displacement_m",)] if maps["displacement_m"] else []
    keys += [("procedural", "displacement")] if maps.at("procedural")["displacement"] else []
    why = f"is {shown(projection)}" if given else "of a material of objects is triplanar"
    for key in keys:
        yield maps.key_fault(
            f"{key[-1]} is for pictures that are projected from above, and the projection {why}: "
            'expected "projection": "above", or take it away',
            *key,
        )


def _check_sources(maps: Node, material: Node) -> Iterator[Finding]:
    """Keys that need others, or that say the same."""
    if "gloss" in maps and "roughness" in maps:
        yield maps.key_fault("gloss and roughness both say how rough it is: take one away", "gloss")
    if "displacement" in maps and "displacement_m" not in maps:
        yield maps.fault(
            "displacement without displacement_m: expected how high white lies above black, 0 for "
            "a flat ground whose layers blend by the picture"
        )
    for key, other in (
        ("displacement_m", "displacement"),
        ("ambient_occlusion_strength", "ambient_occlusion"),
    ):
        if key in maps and other not in maps and "folder" not in maps:
            yield maps.key_fault(
                f"{key} without a picture: expected the key {other} or folder, too", key
            )
    if "emission" in maps and "emission" not in material:
        yield maps.key_fault(
            "the picture multiplies the material's emission, which is left out: expected the key "
            "emission in the material, too",
            "emission",
        )


def _check_blends(cfg: Node) -> Iterator[Finding]:
    """Layers that blend by heights need heights, of their own or of what they lie on."""
    known = False
    for layer in cfg.each("terrain", "ground", "*"):
        maps = cfg.at("materials", layer["material"], "maps")
        # What a folder holds is not known here.
        known = known or any(key in maps for key in ("displacement", "procedural", "folder"))
        span = layer.span("height_blend")
        if span is not None and span[1] > 0.0 and not known:
            yield layer.fault(
                "neither the layer's material nor one below it has heights: expected maps with "
                "procedural, displacement or a folder that has one, or 0",
                "height_blend",
            )
