"""Draws the pictures of a material: which files, which kinds, and how they lie."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from scenec.compiler.assets.texture_set import TextureSet, read_texture_set
from scenec.compiler.cfg.load import Spec
from scenec.compiler.distributions.streams import Streams
from scenec.compiler.draw.of_keys import of_keys
from scenec.compiler.materials.kinds import SURFACES
from scenec.compiler.scene.scene import Cells, Far, MaterialMaps
from scenec.compiler.scene.sources import Sources
from scenec.schemas.maps import MAP_CHANNELS

#: Further kinds of pictures that a cfg or a folder can name.
_SOURCES = ("gloss", "ambient_occlusion", "displacement")


def draw_maps(
    spec: Spec, path: str, node: dict[str, Any], worn: bool, glows: bool, streams: Streams
) -> MaterialMaps:
    """The maps of a material; pictures are not made yet.

    Args:
        spec: The cfg.
        path: Where the material stands in it: "materials/sand".
        node: Its maps, resolved.
        worn: Whether objects have the material.
        glows: Whether it gives off light that a picture could vary.
        streams: The batch's streams.
    """
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
        surface = of_keys(spec, SURFACES, node["procedural"], streams, f"{at}/procedural")
    size_m = node["size_m"] or (surface.SIZE_M if surface else 1.0)
    cells = far = None
    if node["cells"] is not None:
        cells = Cells(node["cells"]["size_m"] or size_m, streams.key(f"{at}/cells") >> 33)
    if node["far"] is not None:
        far = Far(node["far"]["factor"], node["far"]["share"])
    return MaterialMaps(
        size_m=size_m,
        files={kind: given[kind] for kind in MAP_CHANNELS if kind in given},
        normal_convention=convention,
        projection=node["projection"] or ("triplanar" if worn else "above"),
        procedural=surface,
        cells=cells,
        far=far,
        sources=_sources(node, given, found),
    )


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
