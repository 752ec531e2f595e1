"""Draws what a part of a cfg names by ``type``."""

from __future__ import annotations

import dataclasses
from typing import Any

from scenec.compiler.distributions.resolve import resolve
from scenec.compiler.kinds.context import Context
from scenec.compiler.kinds.declare import Form, keys_of, values_from_context
from scenec.compiler.kinds.forms import RAGGED, SAMPLING, file
from scenec.compiler.kinds.table import CHOICES, base_of, class_of, is_builtin, kind_of, lacking
from scenec.schemas.codec import JsonObject
from scenec.schemas.errors import ScenecError
from scenec.schemas.plugins import give_name, named

#: What a kind with a ``SCHEMA`` gets under these keys.
_FOREIGN = {"file": file(""), "ragged": RAGGED, "sampling": SAMPLING}


def draw_kind(choice: str, node: JsonObject, path: str, context: Context) -> Any:
    """Returns what a node's ``type`` names, with its numbers drawn.

    A kind's fields are its keys, and what it takes of the context (``declare.given``). What
    computes is the kind itself, or what its ``draw`` returns.

    Args:
        choice: Of which it is, see ``table.CHOICES``.
        node: Part of the cfg.
        path: Where it stands: "terrain/relief/0".

    Raises:
        ScenecError: What another package's kind draws is nothing of its group.
    """
    context = dataclasses.replace(context, choice=choice)
    name = node.get("type", CHOICES[choice].usual)
    kind = kind_of(choice, name)
    made = _instantiate(kind, {k: v for k, v in node.items() if k != "type"}, path, context)
    group = CHOICES[choice].group
    # What a class with a ``SCHEMA`` calls so is its own affair, unless its base says what it is.
    if hasattr(made, "draw") and (not hasattr(kind, "SCHEMA") or hasattr(base_of(group), "draw")):
        made = made.draw(context.at(path))
    if is_builtin(kind) or (made is None and choice == "sky"):
        return made
    if lacks := lacking(group, type(made)):
        who = named(group, name)
        raise ScenecError(f"{who}: draw returned {made!r:.60}: expected {lacks}")
    if not is_builtin(type(made)):
        give_name(group, type(made), name)
    return made


def draw_object(name: str, node: JsonObject, path: str, context: Context) -> Any:
    """Returns an object of a cfg, by its name in ``table.CLASSES``, with its numbers drawn."""
    return _instantiate(class_of(name), node, path, context)


def _instantiate(kind: type[Any], node: JsonObject, path: str, context: Context) -> Any:
    keys, drawn = keys_of(kind), resolve(node, context.streams, path)
    added = {}
    if "x-kinds" in vars(kind).get("KEYWORDS", {}):
        # What another package's kind, which one of the keys names, adds to them.
        added = {"added": {key: drawn.pop(key) for key in [*drawn] if key not in keys}}
    values = values_of(kind, drawn, path, context)
    return kind(**values, **added, **values_from_context(kind, context.at(path), values))


def values_of(kind: type[Any], drawn: JsonObject, path: str, context: Context) -> dict[str, Any]:
    """Returns what a class gets of its keys: tuples, paths of files, objects that have a class.

    Args:
        drawn: Keys with their numbers drawn.
        path: Where they stand.
    """
    keys = keys_of(kind)
    values: dict[str, Any] = {
        key: tuple(value) if isinstance(value, list) else value for key, value in drawn.items()
    }
    for key, value in values.items():
        form = keys[key].form if key in keys else _FOREIGN.get(key, Form({}))
        if value is not None and "x-file" in form.keywords:
            values[key] = context.files[f"{path}/{key}"].path
        elif value is not None and form.drawn:
            draw = draw_kind if form.drawn in CHOICES else draw_object
            values[key] = draw(form.drawn, value, f"{path}/{key}", context)
    return values
