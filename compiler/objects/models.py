"""Declares models from files, and what a class says of their parts."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar, Literal

from scenec.compiler.kinds import Context, Finding, Form, InputFile, Node, bounded, draw_object, key
from scenec.compiler.kinds.forms import CHOICE, CONSTANT, TEXT, WORDS, an, file, list_of, word_or
from scenec.compiler.scene.labels import Labels
from scenec.schemas.codec import JsonObject
from scenec.schemas.errors import SceneError
from scenec.schemas.spelling import nearest, shown

MODELS = list_of(an("model"), "One model.", least=1, most=1000).but(
    description="The models; each instance is one of them."
)
MATERIAL = TEXT.but(
    description="Material for all of it. Left out, each file's own materials; what has none is "
    "gray."
)
PARTS = Form(
    {
        "type": "object",
        "additionalProperties": {"description": "One part.", **an("model_part").keywords},
        "x-name": "part",
        "description": "Parts that differ from the class, by the name of a mesh, of a node above "
        "it, or of a material in the file. The last that fits a face counts.",
    }
)

_COORDINATE = bounded(CONSTANT, at_least=-1_000_000_000, at_most=1_000_000_000)


@dataclass(frozen=True, kw_only=True)
class ModelKeys:
    """A mesh from a file, with its parts, materials and pictures."""

    EXAMPLE: ClassVar = {"file": "rock.obj", "unit_m": 0.01, "up": "y"}

    file: Path = key(file("model"))
    """A .glb, .gltf, .obj, .ply, .stl, .off, .usd, .usda, .usdc, .usdz or .blend file, relative to
    the cfg, or "package:NAME/path". What it refers to lies beside or below it. .ply and .stl need
    the extra meshes, .blend the extra cycles; no script in it is run."""
    part: str | None = key(WORDS, optional=True)
    """One of the file's meshes, by a name or a path, with what stands under it. Left out, all."""
    unit_m: float | None = key(CONSTANT, optional=True, above=0, at_most=1_000_000, unit="m")
    """Meters per unit. Left out, what the file says: 1 in glTF, metersPerUnit in USD, the scene's
    unit in .blend; OBJ, PLY, STL and OFF say nothing."""
    up: Literal["x", "y", "z", "-x", "-y", "-z"] | None = key(CHOICE, optional=True)
    """Upward axis. Left out, what the file says: y in glTF, upAxis in USD, z in .blend; OBJ, PLY,
    STL and OFF say nothing."""
    origin: str | tuple[float, float, float] | None = key(
        word_or("base", list_of(_COORDINATE, "Along one axis.", count=3)), optional=True, unit="m"
    )
    """The point that stands on the pose and that scales and turns keep. base: the middle of its
    extent in plan, at its lowest height. Or [x, y, z] in meters with z up; map coordinates need
    this. Left out, the file's origin."""
    weight: float = key(CONSTANT, default=1, at_least=0, at_most=1_000_000)
    """How often it is taken, beside the others."""


@dataclass(frozen=True, kw_only=True)
class ModelPart:
    """What one part of a class's models has of its own."""

    EXAMPLE: ClassVar = {"material": "rubber", "labels": {"surface": "wheel"}}

    TITLE: ClassVar = "Part of a model"
    material: str | None = key(TEXT, optional=True)
    """Name of a material, in place of the file's."""
    labels: JsonObject = key(an("label_choice"), default={})
    """Its label on the levels where it differs from the class's."""


@dataclass(frozen=True)
class PartRule:
    """Holds what is drawn of one part of a class's models.

    Attributes:
        name: Of a part, of what stands above it, or of a material of the file.
        material: The cfg's material that it gets, or None.
        labels: Label ids, on the levels where they differ from the class's.
    """

    name: str
    material: str | None
    labels: Labels


def draw_models(nodes: Sequence[JsonObject], context: Context) -> tuple[ModelKeys, ...]:
    """Returns the models of a class."""
    path = f"{context.path}/models"
    return tuple(draw_object("model", own, f"{path}/{i}", context) for i, own in enumerate(nodes))


def draw_rules(parts: JsonObject, context: Context) -> tuple[PartRule, ...]:
    """Returns what a class says of parts of its models."""
    table = context.label_table
    return tuple(
        PartRule(
            name,
            node["material"],
            {level: table[level][own] for level, own in node["labels"].items()},
        )
        for name, node in parts.items()
    )


def check_parts(node: Node, files: Mapping[str, InputFile]) -> Iterator[Finding]:
    """Yields findings on parts that no model of a class has.

    Args:
        files: The cfg's files that nothing is wrong with, by path.
    """
    parts = node.at("parts").entries
    models = [node.at("models", i) for i in node.at("models").entries]
    found = [files.get("/".join(map(str, (*model.path, "file")))) for model in models]
    if not parts or None in found:
        # Some of the names are not known.
        return
    from scenec.compiler.assets.parts import is_of

    known = [
        name
        for file, model in zip(found, models, strict=True)
        if file
        for name in _part_names(file.path, model)
    ]
    names = list(dict.fromkeys(path.rpartition("/")[2] for path in known if path))
    for part in parts:
        if not any(is_of(path, part) for path in known):
            yield node.key_fault(
                f"no model has a part {shown(part)}{nearest(part, names)}", "parts", part
            )


def _part_names(file: Path, node: Node) -> list[str]:
    from scenec.compiler.assets.model import cached_model, origin_of

    try:
        model = cached_model(
            file, node["unit_m"], node["up"], node["part"], origin_of(node["origin"])
        )
    except SceneError:
        # Told where it stands.
        return []
    return [*model.parts, *(material.name for material in model.materials)]
