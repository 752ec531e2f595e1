"""What other packages add by entry points: passes, and kinds of things that a cfg names.

A cfg's kind is a class whose ``SCHEMA`` says which keys it has, as JSON Schema, and whose fields
are those keys. Which kinds there are: ``KINDS``. Nothing is imported to know that one is there.
"""

from __future__ import annotations

import dataclasses
import sys
import traceback
from collections.abc import Iterable, Mapping
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

from scenec.schemas.errors import ScenecError
from scenec.schemas.spelling import nearest, shown

if TYPE_CHECKING:
    from importlib.metadata import EntryPoint

#: Groups of entry points whose names a cfg can give, and what one of each is called.
KINDS = {
    "scenec.relief": "relief operator",
    "scenec.conditions": "condition",
    "scenec.densities": "density",
    "scenec.rocks": "family of rocks",
    "scenec.surfaces": "surface",
    "scenec.poses": "pose",
    "scenec.effects": "effect",
}


def entry_points_of(group: str, name: str) -> tuple[EntryPoint, ...]:
    """What other packages offer under a name."""
    return tuple(point for point in _offered(group, tuple(sys.path)) if point.name == name)


def names_of(group: str) -> tuple[str, ...]:
    """All names in a group, sorted."""
    return tuple(sorted({point.name for point in _offered(group, tuple(sys.path))}))


def origin(group: str, name: str) -> str:
    """Package and version that something comes from."""
    return ", ".join(
        f"{point.dist.name} {point.dist.version}" if point.dist else point.value
        for point in entry_points_of(group, name)
    )


def origins(group: str, names: Iterable[str]) -> dict[str, str]:
    """The same by name, of those that packages offer."""
    return {name: origin(group, name) for name in names if entry_points_of(group, name)}


def place(point: EntryPoint) -> str:
    """Where an entry point leads, for messages."""
    return point.value + (f" of {point.dist.name}" if point.dist else "")


def told(error: Exception) -> str:
    """An error of another package's code, and where it was raised, in a line."""
    at = traceback.extract_tb(error.__traceback__)[-1]
    return f"{type(error).__name__}: {error} ({Path(at.filename).name}, line {at.lineno})"


@cache
def load_kind(group: str, name: str) -> type[Any]:
    """The class of a kind that a cfg names.

    Raises:
        ScenecError: There is none, or several; or it is not what it should be.
    """
    points = entry_points_of(group, name)
    what = KINDS[group]
    if not points:
        raise ScenecError(f"no {what} {shown(name)}{nearest(name, names_of(group))}")
    if len(points) > 1:
        listed = ", ".join(map(place, points))
        raise ScenecError(f"several packages offer the {what} {shown(name)}: {listed}; remove one")
    who = f"{what} {shown(name)} ({place(points[0])})"
    try:
        made = points[0].load()
    except Exception as error:
        raise ScenecError(f"{who}: cannot be imported: {told(error)}") from error
    schema = getattr(made, "SCHEMA", None)
    if not dataclasses.is_dataclass(made) or not isinstance(schema, Mapping):
        raise ScenecError(f"{who}: expected a dataclass with a SCHEMA, a JSON Schema of its keys")
    keys = schema.get("properties", {})
    if not isinstance(keys, Mapping):
        raise ScenecError(f"{who}: SCHEMA: expected its keys under properties")
    lacks = sorted(set(keys) - {field.name for field in dataclasses.fields(made)})
    if lacks:
        raise ScenecError(f"{who}: SCHEMA: the class has no field {shown(lacks[0])}")
    return made  # type: ignore[return-value]


class Kinds[T](dict[str, T]):
    """Classes by the name that a cfg gives; other packages' are loaded when they are asked for."""

    def __init__(self, group: str, ours: Mapping[str, T]) -> None:
        """Takes a group of entry points, and scenec's own classes, which go first."""
        super().__init__(ours)
        self.group = group

    def __missing__(self, name: str) -> T:
        made: T = load_kind(self.group, name)  # type: ignore[assignment]
        return made

    def name_of(self, kind: T) -> str:
        """The name that a class goes by."""
        others = ((name, self[name]) for name in names_of(self.group))
        return next(name for name, found in (*self.items(), *others) if found is kind)


@cache
def _offered(group: str, _path: tuple[str, ...]) -> tuple[EntryPoint, ...]:
    """All entry points of a group; searching other packages' metadata takes milliseconds."""
    from importlib.metadata import entry_points

    return tuple(entry_points(group=group))
