"""Draws objects whose fields are the keys of a cfg's node."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from scenec.compiler.kinds.context import Context
from scenec.compiler.terrain.operators.craters import craters_laid


def of_keys(
    kinds: Mapping[str, type[Any]], node: Mapping[str, Any], path: str, setting: Context
) -> Any:
    """What a node's ``type`` names, with the node's other keys as its fields."""
    values: dict[str, Any] = {key: value for key, value in node.items() if key != "type"}
    values = {k: tuple(v) if isinstance(v, list) else v for k, v in values.items()}
    kind = kinds[node["type"]]
    if "file" in values:
        values["file"] = setting.files[f"{path}/file"].path
    # What the cfg does not say: a noise key, and the craters that there are.
    fields = kind.__dataclass_fields__.keys() - values
    if "key" in fields:
        values["key"] = setting.streams.key(path)
    if "craters" in fields:
        values["craters"] = craters_laid(setting)
    return kind(**values)
