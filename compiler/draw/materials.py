"""Draws the materials of a batch and their pictures: which files, which kinds, how they lie."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from scenec.compiler.assets.texture_set import TextureSet, read_texture_set
from scenec.compiler.cfg.load import Spec
from scenec.compiler.distributions.resolve import resolve
from scenec.compiler.distributions.streams import Streams
from scenec.compiler.draw.of_keys import of_keys
from scenec.compiler.kinds.context import Context
from scenec.compiler.materials.kinds import SURFACES
from scenec.compiler.materials.plan import MaterialPlan, Sources
from scenec.compiler.materials.surface import Surface
from scenec.compiler.scene.material import Cells, Far, Material, MaterialMaps, Reflectance
from scenec.schemas.maps import MAP_CHANNELS

#: Further kinds of pictures that a cfg or a folder can name.
_SOURCES = ("gloss", "ambient_occlusion", "displacement")


def draw_materials(spec: Spec, streams: Streams) -> dict[str, MaterialPlan]:
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
        *(coating for o in objects.values() for coating in o.get("coatings") or ()),
    ]
    return {user["material"] for user in users if user.get("material")}


def _material(
    spec: Spec, path: str, node: dict[str, Any], worn: bool, streams: Streams
) -> MaterialPlan:
    # Left out, it is a factor of 1 on a map's colors.
    red, green, blue = node["base_color"] or (1.0, 1.0, 1.0)
    emission = tuple(node["emission"] or (0.0, 0.0, 0.0))
    maps = surface = sources = None
    if node["maps"] is not None:
        maps, surface, sources = _maps(spec, path, node["maps"], worn, max(emission) > 0.0, streams)
    numbers = (
        "roughness", "specular", "variation", "metallic", "roughness_variation",
        "diffuse_transmission",
    )  # fmt: skip
    material = Material(
        base_color=(red, green, blue),
        maps=maps,
        reflectance=_reflectance(node["reflectance"]),
        emission=emission,
        **{key: node[key] for key in numbers},
    )
    return MaterialPlan(material, surface, sources)


def _reflectance(node: dict[str, Any] | None) -> Reflectance | None:
    if node is None or node["type"] == "lambert":
        return None
    numbers = {key: value for key, value in node.items() if key != "type"}
    return Reflectance(model=node["type"], **{"roughness_deg": 0.0, **numbers})


def _maps(
    spec: Spec, path: str, node: dict[str, Any], worn: bool, glows: bool, streams: Streams
) -> tuple[MaterialMaps, Surface | None, Sources | None]:
    """Which files, which kinds, and how they lie; ``glows``: a picture could vary its emission."""
    at = f"{path}/maps"
    given = {
        kind: spec.files[f"{at}/{kind}"].path
        for kind in (*MAP_CHANNELS, *_SOURCES)
        if node.get(kind) is not None
    }
    convention = node["normal_convention"]
    found = TextureSet({}, None, (), ())
    if node["folder"] is not None:
        folder = spec.files[f"{at}/folder"].path
        keys = frozenset(key for key, value in node.items() if value is not None)
        found = read_texture_set(folder, keys)
        given |= {kind: folder / name for kind, name in found.files.items()}
        if "normal" in found.files:
            convention = found.normal_convention or convention
        if not glows and "emission" in found.files:
            del given["emission"]
    surface = None
    if node["procedural"] is not None:
        setting = Context(streams, files=spec.files)
        surface = of_keys(SURFACES, node["procedural"], f"{at}/procedural", setting)
    size_m = node["size_m"] or (surface.SIZE_M if surface else 1.0)
    cells = far = None
    if node["cells"] is not None:
        cells = Cells(node["cells"]["size_m"] or size_m, streams.key(f"{at}/cells") >> 33)
    if node["far"] is not None:
        far = Far(node["far"]["factor"], node["far"]["share"])
    maps = MaterialMaps(
        size_m=size_m,
        files={kind: given[kind] for kind in MAP_CHANNELS if kind in given},
        normal_convention=convention,
        projection=node["projection"] or ("triplanar" if worn else "above"),
        cells=cells,
        far=far,
    )
    return maps, surface, _sources(node, given, found)


def _sources(node: dict[str, Any], given: dict[str, Path], found: TextureSet) -> Sources | None:
    unused = list(found.unused)
    if "emission" in found.files and "emission" not in given:
        unused.append(found.files["emission"])
    made = Sources(
        gloss=given.get("gloss"),
        occlusion=given.get("ambient_occlusion"),
        occlusion_strength=node["ambient_occlusion_strength"],
        packed=given.get("packed"),
        unpacked=found.unpacked(frozenset(key for key, value in node.items() if value is not None)),
        heights=given.get("displacement"),
        heights_m=node["displacement_m"],
        as_is=node["resolution"] == "as_is",
        unused=tuple(unused),
        unknown=found.unknown,
    )
    return made if made != Sources(occlusion_strength=made.occlusion_strength) else None
