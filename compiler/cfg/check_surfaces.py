"""What must hold between the keys of a material's pictures, and between them and their users.

Like ``check_scene``, these checks pass over what does not have the shape they look for.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from scenec.compiler.cfg.faults import Finding
from scenec.compiler.cfg.json_positions import Path
from scenec.schemas.spelling import shown

#: Keys of maps that are pictures, or are made into some.
_PICTURES = (
    "base_color", "roughness", "gloss", "metallic", "normal", "ambient_occlusion", "displacement",
    "emission", "folder", "procedural",
)  # fmt: skip

type _Spans = dict[Path, tuple[float, float]]


def check_surfaces(document: Any, spans: _Spans) -> list[Finding]:
    """Findings on materials and their pictures.

    Args:
        document: A cfg, perhaps with faults.
        spans: Least and largest value of the numbers that nothing is wrong with, by path.
    """
    cfg = _mapping(document)
    ground = [_mapping(layer) for layer in _items(_mapping(cfg.get("terrain")).get("ground"))]
    lies = {layer.get("material") for layer in ground if isinstance(layer.get("material"), str)}
    objects = {
        name: thing
        for name, thing in _mapping(cfg.get("objects")).items()
        if isinstance(thing, dict)
    }
    rocks = {_name(thing) for thing in objects.values() if thing.get("type") == "rocks"}
    worn = dict(_worn(objects))
    findings: list[Finding] = []
    displaced = {}
    for name, material in _mapping(cfg.get("materials")).items():
        if not isinstance(material, dict):
            continue
        path: Path = ("materials", name)
        maps = material.get("maps")
        if material.get("displacement"):
            displaced[name] = "a displacement"
        if isinstance(maps, dict):
            users = [user for user, names in (("ground", lies), ("rocks", rocks)) if name in names]
            findings.extend(_check_maps((*path, "maps"), maps, users))
            findings.extend(_check_above((*path, "maps"), maps, name in worn.values()))
            findings.extend(_check_sources((*path, "maps"), maps, material))
            if maps.get("displacement_m", 0) != 0 or _mapping(maps.get("procedural")).get(
                "displacement"
            ):
                displaced[name] = "pictures that become geometry"
        pictured = isinstance(maps, dict) and ("base_color" in maps or "folder" in maps)
        if "base_color" not in material and not pictured:
            findings.append(Finding(path, "expected the key base_color, or one in maps"))
    for place, used in worn.items():
        if used in displaced:
            findings.append(
                Finding(
                    place,
                    f"{shown(used)} has {displaced[used]}, for the ground only: expected one "
                    "without",
                )
            )
    findings.extend(_check_blends(cfg, ground, spans))
    return findings


def _mapping(value: Any) -> dict[str, Any]:
    return value if isinstance(value, dict) else {}


def _items(value: Any) -> list[Any]:
    return value if isinstance(value, list) else []


def _name(thing: dict[str, Any]) -> str | None:
    name = thing.get("material")
    return name if isinstance(name, str) else None


def _worn(objects: dict[str, dict[str, Any]]) -> Iterator[tuple[Path, str]]:
    """Materials that objects have, by the places that say so."""
    for name, thing in objects.items():
        users: list[tuple[Path, dict[str, Any]]] = [(("objects", name), thing)]
        users += [
            (("objects", name, "parts", part), node)
            for part, node in _mapping(thing.get("parts")).items()
            if isinstance(node, dict)
        ]
        for path, node in users:
            used = _name(node)
            if used is not None:
                yield (*path, "material"), used


def _check_maps(path: Path, maps: dict[str, Any], users: list[str]) -> Iterator[Finding]:
    made = "procedural" in maps
    if not any(key in maps for key in _PICTURES):
        yield Finding(path, f"expected one of {', '.join(_PICTURES)}, or more")
    by_uv = maps.get("projection") == "uv"
    if by_uv and made:
        yield Finding(
            (*path, "procedural"),
            "procedural pictures lie in the world: expected the projection triplanar or above",
            at_key=True,
        )
    if by_uv and "size_m" in maps:
        yield Finding(
            (*path, "size_m"),
            "with the projection uv the mesh says how large the pictures are: take it away",
            at_key=True,
        )
    if not by_uv and not made and "size_m" not in maps:
        yield Finding(path, "expected the key size_m")
    if by_uv and users:
        yield Finding(
            (*path, "projection"),
            f"{' and '.join(users)} of this material have no texture coordinates: expected "
            '"triplanar" or "above"',
        )


def _check_above(path: Path, maps: dict[str, Any], worn: bool) -> Iterator[Finding]:
    """Keys that only pictures projected from above know."""
    projection = maps.get("projection")
    if projection not in ("triplanar", "uv") and ("projection" in maps or not worn):
        return
    made = _mapping(maps.get("procedural"))
    keys: list[Path] = [
        (*path, key) for key in ("cells", "far", "displacement_m") if maps.get(key, 0) != 0
    ]
    if made.get("displacement") is True:
        keys.append((*path, "procedural", "displacement"))
    for key in keys:
        why = f"is {shown(projection)}" if projection else "of a material of objects is triplanar"
        yield Finding(
            key,
            f"{key[-1]} is for pictures that are projected from above, and the projection {why}: "
            'expected "projection": "above", or take it away',
            at_key=True,
        )


def _check_sources(path: Path, maps: dict[str, Any], material: dict[str, Any]) -> Iterator[Finding]:
    """Keys that need others, or that say the same."""
    folder = "folder" in maps
    if "gloss" in maps and "roughness" in maps:
        yield Finding(
            (*path, "gloss"),
            "gloss and roughness both say how rough it is: take one away",
            at_key=True,
        )
    if "displacement" in maps and "displacement_m" not in maps:
        yield Finding(
            path,
            "displacement without displacement_m: expected how high white lies above black, 0 for "
            "a flat ground whose layers blend by the picture",
        )
    needs = (
        ("displacement_m", "displacement"),
        ("ambient_occlusion_strength", "ambient_occlusion"),
    )
    for key, other in needs:
        if key in maps and other not in maps and not folder:
            yield Finding(
                (*path, key),
                f"{key} without a picture: expected the key {other} or folder, too",
                at_key=True,
            )
    if "emission" in maps and "emission" not in material:
        yield Finding(
            (*path, "emission"),
            "the picture multiplies the material's emission, which is left out: expected the key "
            "emission in the material, too",
            at_key=True,
        )


def _check_blends(
    cfg: dict[str, Any], ground: list[dict[str, Any]], spans: _Spans
) -> Iterator[Finding]:
    """Layers that blend by heights need heights, of their own or of what they lie on."""
    materials = _mapping(cfg.get("materials"))
    known = False
    for i, layer in enumerate(ground):
        name = _name(layer)
        maps = _mapping(_mapping(materials.get(name)).get("maps")) if name else {}
        # What a folder holds is not known here.
        known = known or any(key in maps for key in ("displacement", "procedural", "folder"))
        path: Path = ("terrain", "ground", i, "height_blend")
        span = spans.get(path)
        if span is not None and span[1] > 0.0 and not known:
            yield Finding(
                path,
                "neither the layer's material nor one below it has heights: expected maps with "
                "procedural, displacement or a folder that has one, or 0",
            )
