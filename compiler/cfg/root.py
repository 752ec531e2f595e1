"""Declares the keys of a whole cfg, and labels."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, ClassVar

from scenec.compiler.kinds import Finding, Form, Node, an, forms, key, list_of, named, unknown
from scenec.schemas.codec import JsonObject
from scenec.schemas.spelling import shown


@dataclass(frozen=True, kw_only=True)
class Cfg:
    """One file, JSON or YAML, that with a seed says everything about a dataset.

    Lengths are meters, angles degrees; +X is east, +Y north, +Z up.
    """

    TITLE: ClassVar = "Configuration"
    schema: Any | None = key(
        Form({"type": "string", "x-ignored": True}), optional=True, name="$schema"
    )
    """Where an editor finds this schema; not read by scenec."""
    extends: Any | None = key(Form({"type": "string", "x-ignored": True}), optional=True)
    """Another cfg, of which this one says only what differs: relative to this file, or
    "package:configs/NAME"."""
    replaces: Any | None = key(
        Form({"type": "array", "items": {"type": "string"}, "x-ignored": True}), optional=True
    )
    """Paths of objects, as in "objects.rocks", that this cfg gives whole: nothing of what the other
    says there stays."""
    version: Any = key(Form({"const": 1}))
    """Version of the cfg format."""
    name: str = key(forms.NAME)
    """Name of the dataset: letters, digits, underscores; no digit first."""
    description: str = key(forms.TEXT, default="")
    """What the dataset is for; not read."""
    batches: int = key(forms.COUNT, default=1, at_least=1, at_most=1_000_000)
    """Number of batches; each is one terrain with its objects, one stage."""
    samples: int = key(forms.COUNT, default=1, at_least=1, at_most=1_000_000)
    """Samples of each batch. A sample is one picture of every sensor: cameras and light change,
    terrain and scattered objects do not."""
    outputs: Any = key(
        list_of(forms.OUTPUT, least=1, unique=True), default=["rgb", "label", "instance", "depth"]
    )
    """Channels that are rendered and written."""
    labels: JsonObject = key(an("labels"), default={})
    """The label levels, with the names and ids of each."""
    terrain: JsonObject = key(an("terrain"))
    """The ground: its shape and what covers it."""
    materials: JsonObject = key(named(an("material"), "One material.", by="material", least=1))
    """Surface materials by name. Each must be used."""
    objects: JsonObject = key(named(an("objects"), "One class of objects.", by="class"), default={})
    """Classes of objects by name, in the order of placement and of instance ids."""
    object_detail: JsonObject = key(an("object_detail"), default={})
    """How much geometry all objects have together."""
    light: JsonObject = key(an("light"), default={})
    """Sun and sky; left out, both are there with their defaults."""
    rigs: JsonObject = key(named(an("rig"), "One rig.", by="rig", least=1))
    """Camera rigs by name."""


@dataclass(frozen=True, kw_only=True)
class LabelChoice:
    """Label on each level; 0, no label, on those left out."""

    EXAMPLE: ClassVar = {"class": "rock", "surface": "basalt"}

    KEYWORDS: ClassVar = {
        "propertyNames": {**forms.NAME.keywords},
        "x-name": "level",
        "additionalProperties": {"description": "Name of a label of this level.", "type": "string"},
    }

    TITLE: ClassVar = "Choice of labels"

    @staticmethod
    def check(node: Node) -> Iterator[Finding]:
        """Finds levels and names that there are none of."""
        levels = node.whole().at("labels")
        if not levels and "labels" in node.whole():
            return
        for level in node.entries:
            name, names = node[level], levels.at(level)
            if level not in levels:
                yield node.key_fault(unknown("label level", level, levels.entries), level)
            elif name is not None and names and name not in names:
                where = f" on the level {shown(level)}"
                yield node.fault(unknown("label", name, names.entries, where), level)


@dataclass(frozen=True, kw_only=True)
class LabelKeys:
    """Label levels by name, one annotation channel each. Id 0 means "no label" and has no name.
    Every name must be used.
    """

    EXAMPLE: ClassVar = {
        "class": {"sky": 1, "ground": 2, "rock": 3},
        "surface": {"sky": 1, "sand": 2, "basalt": 3},
    }

    KEYWORDS: ClassVar = {
        "propertyNames": {**forms.NAME.keywords},
        "x-name": "level",
        "additionalProperties": {
            "description": "One level: its label names.",
            "type": "object",
            "propertyNames": {**forms.NAME.keywords},
            "additionalProperties": {
                "description": "Id of the label, unique in its level.",
                "type": "integer",
                "minimum": 1,
                "maximum": 2_147_483_647,
            },
            "minProperties": 1,
            "x-name": "name",
        },
    }

    @staticmethod
    def check(node: Node) -> Iterator[Finding]:
        """Finds ids that two names of a level have."""
        for level in node.each("*"):
            first: dict[int, str] = {}
            for name in level.entries:
                number = level[name]
                if number in first:
                    yield level.fault(
                        f"the id {shown(number)} is that of {shown(first[number])} already: ids "
                        "are unique within a level",
                        name,
                    )
                if number is not None:
                    first.setdefault(number, name)
