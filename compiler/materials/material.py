"""Declares materials, and draws those of a batch."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

from scenec.compiler.kinds import Context, Finding, Form, Node, bounded, draw_kind, draw_object, key
from scenec.compiler.kinds.forms import FRACTION_PER_BATCH, PER_BATCH, an, list_of
from scenec.compiler.materials.maps import MapsKeys, becomes_geometry, users
from scenec.schemas.codec import JsonObject
from scenec.schemas.spelling import shown

if TYPE_CHECKING:
    # A cfg is checked without what is drawn of it.
    from scenec.compiler.materials.plan import MaterialPlan


def _color(form: Form) -> Form:
    return list_of(form, "Linear Rec.709 red, green or blue.", least=3, most=3)


@dataclass(frozen=True, kw_only=True)
class MaterialKeys:
    """A surface: (1 - m) ((1 - s) Lambert + s GGX) + m GGX tinted by the color; m is metallic, s
    specular, alpha the roughness squared.
    """

    EXAMPLE: ClassVar = {
        "base_color": [0.42, 0.29, 0.18],
        "roughness": 0.9,
        "variation": 0.25,
        "maps": {"procedural": {"type": "sand"}, "cells": {}},
    }

    base_color: tuple[float, float, float] | None = key(
        _color(FRACTION_PER_BATCH).but(x_color=True), optional=True
    )
    """Albedo, linear Rec.709; required unless maps give one, which it multiplies (left out: 1)."""
    roughness: float = key(FRACTION_PER_BATCH, default=0.9)
    """Roughness of the specular part. Facets light each other, so a white metal reflects all light
    at any roughness."""
    specular: float = key(FRACTION_PER_BATCH, default=0.02)
    """Share of the specular part."""
    metallic: float = key(FRACTION_PER_BATCH, default=0)
    """Share of the metallic part."""
    variation: float = key(FRACTION_PER_BATCH, default=0)
    """How much the albedo varies by place: base_color (1 + variation v), v in [-1, 1]."""
    roughness_variation: float = key(PER_BATCH, default=0, at_least=-1, at_most=1)
    """How much the roughness varies: roughness (1 + roughness_variation v), within [0, 1], also of
    a map's roughness. v is that of variation, so color and roughness change together, as on damp
    ground; below 0, lighter places are smoother."""
    reflectance: JsonObject | None = key(an("reflectance"), optional=True)
    """How the diffuse part scatters, if not by Lambert's law, as on moons and dusty planets."""
    emission: tuple[float, float, float] | None = key(
        _color(bounded(PER_BATCH, at_least=0, at_most=1_000_000_000, unit="W/(m² sr)")),
        optional=True,
    )
    """Radiance that it gives off, linear Rec.709; left out: none."""
    diffuse_transmission: float = key(FRACTION_PER_BATCH, default=0)
    """For leaves and cloth: share of the diffuse light that leaves on the far side, of the same
    color; the rest is reflected."""
    maps: MapsKeys | None = key(an("material_maps", drawn=True), optional=True)
    """Pictures that vary the surface."""
    displacement: Any | None = key(list_of(an("displacement"), "One small relief."), optional=True)
    """Small reliefs, added up, that become geometry near cameras; for materials of the ground."""

    @staticmethod
    def check(node: Node) -> Iterator[Finding]:
        """Findings between its keys, and on objects that have it."""
        maps, name = node.at("maps"), str(node.path[-1])
        if not ("base_color" in node or "base_color" in maps or "folder" in maps):
            yield node.fault("expected the key base_color, or one in maps")
        high = "a displacement" if node.entries.get("displacement") else ""
        if becomes_geometry(maps):
            high = "pictures that become geometry"
        for user in users(node.whole(), name) if high else ():
            yield user.fault(
                f"{shown(name)} has {high}, for the ground only: expected one without", "material"
            )

    def draw(self, context: Context, *, worn: bool) -> MaterialPlan:
        """The material and its pictures, which are not made yet; ``worn``: objects have it."""
        from scenec.compiler.materials.plan import MaterialPlan
        from scenec.compiler.scene.material import Material

        emission = self.emission or (0.0, 0.0, 0.0)
        maps = surface = sources = reflectance = None
        if self.maps is not None:
            maps, surface, sources = self.maps.draw(
                context.at(f"{context.path}/maps"), worn=worn, glows=max(emission) > 0.0
            )
        if self.reflectance is not None:
            reflectance = draw_kind(
                "reflectance", self.reflectance, f"{context.path}/reflectance", context
            )
        material = Material(
            # Left out, it is a factor of 1 on a map's colors.
            base_color=self.base_color or (1.0, 1.0, 1.0),
            roughness=self.roughness,
            specular=self.specular,
            variation=self.variation,
            metallic=self.metallic,
            maps=maps,
            roughness_variation=self.roughness_variation,
            reflectance=reflectance,
            emission=emission,
            diffuse_transmission=self.diffuse_transmission,
        )
        return MaterialPlan(material, surface, sources)


def draw_materials(cfg: JsonObject, context: Context) -> dict[str, MaterialPlan]:
    """All materials of a batch, in the cfg's order."""
    things = list(cfg["objects"].values())
    parts = [part for thing in things for part in (thing.get("parts") or {}).values()]
    coatings = [coating for thing in things for coating in thing.get("coatings") or ()]
    worn = {user["material"] for user in (*things, *parts, *coatings)}
    found = {}
    for name, node in cfg["materials"].items():
        at = context.at(f"materials/{name}")
        found[name] = draw_object("material", node, at.path, at).draw(at, worn=name in worn)
    return found
