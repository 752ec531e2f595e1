"""Declares the pictures of a material: which files, which kinds, how they lie."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar, Literal

from scenec.compiler.kinds import Context, Finding, Node, an, draw_kind, file, forms, key
from scenec.compiler.kinds.finding import Path as Place
from scenec.schemas.codec import JsonObject
from scenec.schemas.maps import MAP_CHANNELS
from scenec.schemas.spelling import shown
from scenec.schemas.stage import OPACITY_THRESHOLD

if TYPE_CHECKING:
    # A cfg is checked without what paints.
    from scenec.compiler.materials.plan import MapSources
    from scenec.compiler.materials.surface import Surface
    from scenec.compiler.scene.material import MaterialMaps

#: Keys that are files of pictures.
_FILES = (
    "base_color", "roughness", "gloss", "metallic", "packed", "normal", "ambient_occlusion",
    "displacement", "emission", "opacity",
)  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class CellsKeys:
    """Lays pictures in a square lattice of cells, each randomly turned and shifted and blended into
    the next, so that they do not repeat.
    """

    EXAMPLE: ClassVar = {"size_m": 1.5}

    size_m: float | None = key(forms.LENGTH_PER_BATCH, optional=True, above=0, at_most=1_000_000)
    """Side of the lattice; left out, size_m of the maps, so that hardly a cell repeats a place.
    Larger cells keep larger forms whole."""


@dataclass(frozen=True, kw_only=True)
class FarKeys:
    """Adds the picture of colors once more, larger: c becomes c (1 + share (c_far / mean - 1)), so
    that colors vary over several scales.
    """

    EXAMPLE: ClassVar = {"factor": 7, "share": 0.5}

    factor: float = key(forms.PER_BATCH, default=7.3, at_least=1, at_most=1000)
    """How much larger; not a whole number, or the two repeat together."""
    share: float = key(forms.FRACTION_PER_BATCH, default=0.5)
    """How much of it shows."""


@dataclass(frozen=True, kw_only=True)
class MapsKeys:
    """Pictures that vary a surface, projected in the world or by a mesh's texture coordinates:
    procedural, or from PNG, JPEG, TIFF (8 bits, or 16 bits gray) or OpenEXR files, relative to the
    cfg, or "package:NAME/path".
    """

    EXAMPLE: ClassVar = {"folder": "textures/gravel", "size_m": 1.2, "cells": {}}

    projection: Literal["above", "triplanar", "uv"] | None = key(forms.CHOICE, optional=True)
    """above: along the vertical; triplanar: along the world's three axes, mixed by the normal; uv:
    by a mesh's texture coordinates. Left out: triplanar for a material of objects, else above."""
    size_m: float | None = key(forms.LENGTH_PER_BATCH, optional=True, above=0, at_most=1_000_000)
    """Side of one repeat, of above and triplanar; required of files."""
    folder: Path | None = key(file("texture_set"), optional=True)
    """Folder of pictures, relative to the cfg or "package:NAME/path", told apart by their names as
    ambientCG, Poly Haven, cgbookcase, 3dtextures, Quixel, textures.com and OAISYS have them (Color,
    diff, albedo; rough, gloss; nor_gl, NormalDX; AO, disp, height, metal, arm, emission ...). A key
    beside it replaces its file. What is not understood is reported."""
    resolution: Literal["seen", "as_is"] = key(forms.CHOICE, default="seen")
    """seen: pictures with more texels than any camera has pixels for are halved until they fit;
    unseen ones become their mean. as_is: files stay as they are."""
    procedural: JsonObject | None = key(an("surface"), optional=True)
    """Pictures that the compiler makes, another pattern in each batch. A file beside it replaces
    one of them. Not with projection uv."""
    base_color: Path | None = key(file("map"), optional=True)
    """Albedo: sRGB, or linear Rec.709 in OpenEXR."""
    roughness: Path | None = key(file("map"), optional=True)
    """Roughness, raw, in place of the number."""
    gloss: Path | None = key(file("map"), optional=True)
    """Gloss, raw: the roughness is 1 less it. Not together with roughness."""
    metallic: Path | None = key(file("map"), optional=True)
    """Metallic part, raw, in place of the number."""
    packed: Path | None = key(file("map"), optional=True)
    """Occlusion, roughness and metallic part in one picture's channels, raw, in the order
    packed_order. A key of its own for one of them wins."""
    packed_order: Literal["orm", "omr", "rom", "rmo", "mor", "mro"] = key(
        forms.CHOICE, default="orm"
    )
    """What red, green and blue of packed are: o for occlusion, r for roughness, m for metallic."""
    normal: Path | None = key(file("map"), optional=True)
    """Normals n = 2 rgb - 1, raw, x to the right."""
    normal_convention: Literal["opengl", "directx"] = key(forms.CHOICE, default="opengl")
    """Where the normals' y points: up in the picture (opengl) or down (directx)."""
    ambient_occlusion: Path | None = key(file("map"), optional=True)
    """Ambient occlusion, raw: multiplies the albedo at compile time."""
    ambient_occlusion_strength: float = key(forms.FRACTION_PER_BATCH, default=1)
    """Its strength: albedo (1 - strength (1 - picture))."""
    displacement: Path | None = key(file("heights"), optional=True)
    """Heights, raw, about their mean. With displacement_m they become geometry near cameras;
    height_blend of ground layers uses them. For materials of the ground, projected from above."""
    displacement_m: float | None = key(
        forms.LENGTH_PER_BATCH, optional=True, at_least=0, at_most=1_000_000
    )
    """Height of white above black in the picture of displacement; left out, it stays flat."""
    emission: Path | None = key(file("map"), optional=True)
    """Colors that multiply the material's emission: sRGB, or linear Rec.709 in OpenEXR."""
    opacity: Path | None = key(file("map"), optional=True)
    """Opacity, raw: nothing is there below opacity_threshold, for annotation and all renderers.
    With projection uv."""
    opacity_threshold: float | None = key(forms.FRACTION_PER_BATCH, optional=True)
    """Least opacity of what is there; left out, 0.5."""
    cells: JsonObject | None = key(an("material_cells"), optional=True)
    """Keeps pictures projected from above from repeating; {} takes the usual size."""
    far: JsonObject | None = key(an("material_far"), optional=True)
    """Varies colors projected from above over a larger scale, too."""

    @staticmethod
    def check(node: Node) -> Iterator[Finding]:
        """Findings between its keys, on its material and on who has that."""
        pictures = (*_FILES, "folder", "procedural")
        if not any(key in node for key in pictures):
            yield node.fault(f"expected one of {', '.join(pictures)}, or more")
        if node["projection"] == "uv":
            yield from _check_uv(node)
        elif "procedural" not in node and "size_m" not in node:
            yield node.fault("expected the key size_m")
        yield from _check_above(node)
        yield from _check_sources(node)

    def draw(
        self, context: Context, *, worn: bool, glows: bool
    ) -> tuple[MaterialMaps, Surface | None, MapSources | None]:
        """Returns how pictures are mapped, what paints further ones, and their sources.

        Args:
            worn: Whether objects have the material.
            glows: Whether it gives off light, which a picture can vary.
        """
        # Imported here: a cfg without files is checked without what reads them.
        from scenec.compiler.assets.texture_set import TextureSet, read_texture_set, unpacked
        from scenec.compiler.materials.plan import MapSources
        from scenec.compiler.scene.material import Cutout, Far, MaterialMaps, TilingCells

        given = {kind: getattr(self, kind) for kind in _FILES if getattr(self, kind) is not None}
        own, found, convention = frozenset(given), TextureSet({}, None, (), ()), None
        unused: list[str] = []
        if self.folder is not None:
            found = read_texture_set(self.folder, own)
            given |= {kind: self.folder / name for kind, name in found.files.items()}
            convention = found.normal_convention if "normal" in found.files else None
            unused += found.unused
            if not glows and "emission" in found.files:
                del given["emission"]
                unused.append(found.files["emission"])
        surface = None
        if self.procedural is not None:
            surface = draw_kind("surface", self.procedural, f"{context.path}/procedural", context)
        size_m = self.size_m or (surface.SIZE_M if surface else 1.0)
        cells = None
        if self.cells is not None:
            cells = TilingCells(self.cells["size_m"] or size_m, context.key("cells") >> 33)
        threshold = self.opacity_threshold
        threshold = OPACITY_THRESHOLD if threshold is None else threshold
        maps = MaterialMaps(
            size_m=size_m,
            files={kind: given[kind] for kind in MAP_CHANNELS if kind in given},
            normal_convention=convention or self.normal_convention,
            projection=self.projection or ("triplanar" if worn else "above"),
            cells=cells,
            far=None if self.far is None else Far(**self.far),
            cutout=None if self.opacity is None else Cutout(threshold),
        )
        sources = MapSources(
            gloss=given.get("gloss"),
            occlusion=given.get("ambient_occlusion"),
            occlusion_strength=self.ambient_occlusion_strength,
            packed=given.get("packed"),
            packed_order=self.packed_order,
            unpacked=unpacked(given),
            heights=given.get("displacement"),
            heights_m=self.displacement_m,
            as_is=self.resolution == "as_is",
            unused=tuple(unused),
            unknown=found.unknown,
        )
        nothing = sources == MapSources(occlusion_strength=sources.occlusion_strength)
        return maps, surface, None if nothing else sources


def users(cfg: Node, material: str) -> list[Node]:
    """Returns the objects, and parts and coatings of them, that a cfg gives a material."""
    objects = cfg.each("objects", "*")
    more = (*cfg.each("objects", "*", "parts", "*"), *cfg.each("objects", "*", "coatings", "*"))
    return [user for user in (*objects, *more) if user["material"] == material]


def becomes_geometry(maps: Node) -> bool:
    """Whether the relief of pictures is more than normals."""
    return bool(maps["displacement_m"] or maps.at("procedural")["displacement"])


def _check_uv(maps: Node) -> Iterator[Finding]:
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
    cfg, name = maps.whole(), str(maps.path[-2])
    ground = (*cfg.each("terrain", "ground", "*"), *cfg.each("terrain", "horizon"))
    flat = ["ground"] if any(layer["material"] == name for layer in ground) else []
    if any(cfg.at(*user.path[:2])["type"] == "rocks" for user in users(cfg, name)):
        flat.append("rocks")
    if flat:
        yield maps.fault(
            f"{' and '.join(flat)} of this material have no texture coordinates: expected "
            '"triplanar" or "above"',
            "projection",
        )


def _check_above(maps: Node) -> Iterator[Finding]:
    """Keys that only pictures projected from above know."""
    given, projection = "projection" in maps, maps["projection"]
    worn = bool(users(maps.whole(), str(maps.path[-2])))
    if projection not in ("triplanar", "uv") if given else not worn:
        return
    keys: list[Place] = [(own,) for own in ("cells", "far") if own in maps]
    keys += [("displacement_m",)] if maps["displacement_m"] else []
    keys += [("procedural", "displacement")] if maps.at("procedural")["displacement"] else []
    why = f"is {shown(projection)}" if given else "of a material of objects is triplanar"
    for place in keys:
        yield maps.key_fault(
            f"{place[-1]} is for pictures that are projected from above, and the projection {why}: "
            'expected "projection": "above", or take it away',
            *place,
        )


def _check_sources(maps: Node) -> Iterator[Finding]:
    """Keys that need others, or that say the same."""
    if "gloss" in maps and "roughness" in maps:
        yield maps.key_fault("gloss and roughness both say how rough it is: take one away", "gloss")
    if "displacement" in maps and "displacement_m" not in maps:
        yield maps.fault(
            "displacement without displacement_m: expected how high white lies above black, 0 for "
            "a flat ground whose layers blend by the picture"
        )
    if "opacity" in maps and maps["projection"] != "uv":
        yield maps.key_fault(
            'a mask lies by texture coordinates: expected "projection": "uv"', "opacity"
        )
    for own, other in (
        ("opacity_threshold", "opacity"),
        ("displacement_m", "displacement"),
        ("ambient_occlusion_strength", "ambient_occlusion"),
        ("packed_order", "packed"),
    ):
        others = {other, "folder"} | ({"packed"} if other == "ambient_occlusion" else set())
        if own in maps and not any(key in maps for key in others):
            yield maps.key_fault(
                f"{own} without a picture: expected the key {other} or folder, too", own
            )
    if "emission" in maps and "emission" not in maps.whole().at(*maps.path[:-1]):
        yield maps.key_fault(
            "the picture multiplies the material's emission, which is left out: expected the key "
            "emission in the material, too",
            "emission",
        )
