"""Makes prototypes of models: vertices split along edges, parts with materials and labels."""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.assets.looks import ModelMaterial
from scenec.compiler.assets.model import MeshModel
from scenec.compiler.assets.parts import is_of
from scenec.compiler.geometry.rounding import rounding_of
from scenec.compiler.materials.plan import MaterialPlan
from scenec.compiler.objects.corners import corner_normals, split
from scenec.compiler.objects.models import PartRule
from scenec.compiler.objects.placed import PlacedPlan
from scenec.compiler.objects.plan import ModelSource, ScatterPlan
from scenec.compiler.scene.material import Material, MaterialMaps
from scenec.compiler.scene.objects import MeshPart, Prototype
from scenec.schemas.errors import SceneError

#: Faces that meet at a larger angle have an edge between them, where a file gives no normals.
CREASE_DEG = 40.0


@dataclass
class Looks:
    """Materials of the scene: those of the cfg, and those that come with models."""

    materials: dict[str, MaterialPlan]
    _owned: list[tuple[str, str]] = field(default_factory=list)

    def add(self, owner: str, wanted: str, material: Material) -> str:
        """The name of a model's material: ``<class>_<material>``, numbered if another has it."""
        made = MaterialPlan(material)
        for other, name in self._owned:
            if other == owner and self.materials[name] == made:
                return name
        base = re.sub(r"\W", "_", f"{owner}_{wanted or 'surface'}", flags=re.ASCII)
        name, number = base, 1
        while name in self.materials:
            number += 1
            name = f"{base}_{number}"
        self.materials[name] = made
        self._owned.append((owner, name))
        return name


def build_prototype(
    plan: ScatterPlan | PlacedPlan,
    source: ModelSource | PlacedPlan,
    name: str,
    model: MeshModel,
    looks: Looks | None,
) -> Prototype:
    """A model as a prototype, in meters, about the file's origin.

    Args:
        plan: Of the class; its material is that of all that no rule gives one, None the file's own.
        source: Rules for parts, of which the last that fits counts; how materials vary.
        name: Of the prim.
        model: What is made into one.
        looks: Receives the file's materials that are used; None where no color is asked for.

    Raises:
        SceneError: It cannot be held in float32.
    """
    rule_of_face = _rules_of_faces(model, source.rules)
    corners = model.normals
    if corners is None:
        corners = corner_normals(model.points, model.faces, CREASE_DEG).astype(np.float32)
    copies, faces, normals = split(model.faces, corners)
    points = model.points[copies].astype(np.float32)
    squares = (points.astype(np.float64) * points).sum(axis=1)
    radius = float(np.sqrt(squares.max()))
    if not np.isfinite(radius):
        raise SceneError(f"objects/{plan.name}: {name} is too large for float32")
    return Prototype(
        name=name,
        points=points,
        faces=faces,
        normals=normals,
        variation=np.zeros(len(points), np.float32),
        # Of the numbers' rounding, too.
        radius=radius * (1.0 + 1e-6),
        uv=model.uv if looks is not None else None,
        colors=_colors(plan, source, model, rule_of_face) if looks is not None else None,
        parts=_parts(plan, source, model, rule_of_face, looks),
        rounding=rounding_of(model.points),
    )


def _rules_of_faces(model: MeshModel, rules: tuple[PartRule, ...]) -> NDArray[np.int64]:
    """Index of the last rule that fits each face; -1: none."""
    found = np.full(len(model.faces), -1)
    for index, rule in enumerate(rules):
        parts = [i for i, path in enumerate(model.parts) if is_of(path, rule.name)]
        named = [i for i, m in enumerate(model.materials) if m.name == rule.name]
        found[np.isin(model.part_of_face, parts) | np.isin(model.material_of_face, named)] = index
    return found


def _colors(
    plan: ScatterPlan | PlacedPlan,
    source: ModelSource | PlacedPlan,
    model: MeshModel,
    rule_of_face: NDArray[np.int64],
) -> NDArray[np.float32] | None:
    """The file's colors, where its own materials are shown."""
    if model.colors is None or plan.material is not None:
        return None
    given = np.array([rule.material is not None for rule in source.rules] + [False])
    colors = model.colors.copy()
    colors[given[rule_of_face]] = 1.0
    return colors if (colors != 1.0).any() else None


def _parts(
    plan: ScatterPlan | PlacedPlan,
    source: ModelSource | PlacedPlan,
    model: MeshModel,
    rule_of_face: NDArray[np.int64],
    looks: Looks | None,
) -> tuple[MeshPart, ...]:
    """Runs of faces of the same material and labels, in order of their first faces."""
    own_material = model.material_of_face
    if plan.material is not None:
        own_material = np.full(len(model.faces), -1, np.int32)
    key = (rule_of_face + 1) * (len(model.materials) + 1) + own_material + 1
    _, first, of_face = np.unique(key, return_index=True, return_inverse=True)
    groups: dict[
        tuple[str | None, tuple[tuple[str, int], ...] | None], list[NDArray[np.int64]]
    ] = {}
    wanted: dict[tuple[str | None, Any], str] = {}
    for index in np.argsort(first, kind="stable"):
        face = int(first[index])
        rule = source.rules[rule_of_face[face]] if rule_of_face[face] >= 0 else None
        look = rule.material if rule is not None and looks is not None else None
        title = rule.name if rule is not None else ""
        if look is None and looks is not None and own_material[face] >= 0:
            made = model.materials[own_material[face]]
            material = as_material(made, source.variation, model.uv is not None)
            look = looks.add(plan.name, made.name, material)
            title = title or made.name
        own = {**plan.labels, **rule.labels} if rule is not None and rule.labels else None
        part = (look, None if own is None else tuple(sorted(own.items())))
        groups.setdefault(part, []).append(np.flatnonzero(of_face == index))
        wanted.setdefault(part, title)
    parts: list[MeshPart] = []
    for (look, changed), blocks in groups.items():
        if look is None and changed is None:
            # As the class is.
            continue
        title = re.sub(r"\W", "_", wanted[look, changed] or "part", flags=re.ASCII)
        title = f"_{title}" if title[0].isdigit() else title
        if any(part.name == title for part in parts):
            title = f"{title}_{len(parts)}"
        faces = np.sort(np.concatenate(blocks), kind="stable").astype(np.int32)
        parts.append(MeshPart(title, faces, look, None if changed is None else dict(changed)))
    return tuple(parts)


def as_material(source: ModelMaterial, variation: float, has_uv: bool) -> Material:
    """A file's material in the scene's terms; pictures need texture coordinates."""
    maps = None
    if source.pictures and has_uv:
        maps = MaterialMaps(
            1.0, dict(source.pictures), source.normal_convention, "uv", cutout=source.cutout
        )
    return Material(
        base_color=source.base_color,
        roughness=source.roughness,
        specular=source.specular,
        variation=variation,
        metallic=source.metallic,
        maps=maps,
        diffuse_transmission=source.diffuse_transmission,
    )
