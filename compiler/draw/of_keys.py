"""Draws objects whose fields are the keys of a cfg's node."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from scenec.compiler.distributions.streams import Streams
from scenec.compiler.kinds.context import Context
from scenec.compiler.terrain.condition import Condition, Ragged
from scenec.compiler.terrain.mask import Masked
from scenec.compiler.terrain.operator import ReliefOperator
from scenec.compiler.terrain.operators.craters import Craters


def of_keys(
    kinds: Mapping[str, type[Any]], node: Mapping[str, Any], path: str, setting: Context
) -> Any:
    """What a node's ``type`` names, with the node's other keys as its fields."""
    values: dict[str, Any] = {key: value for key, value in node.items() if key != "type"}
    values = {k: tuple(v) if isinstance(v, list) else v for k, v in values.items()}
    kind = kinds[node["type"]]
    if "file" in values:
        values["file"] = setting.files[f"{path}/file"].path
    if "ragged" in values:
        values["ragged"] = ragged_of(values["ragged"], setting.streams, path)
    # What the cfg does not say: a noise key, and the craters that there are.
    fields = kind.__dataclass_fields__.keys() - values
    if "key" in fields:
        values["key"] = setting.streams.key(path)
    if "craters" in fields:
        values["craters"] = tuple(laid for one in setting.relief for laid in _craters_of(one))
    return kind(**values)


def ragged_of(node: Mapping[str, Any] | None, streams: Streams, path: str) -> Ragged | None:
    """What is added to the quantity of the condition at a path; None: nothing."""
    return None if node is None else Ragged(key=streams.key(f"{path}/ragged"), **node)


def _craters_of(operator: ReliefOperator) -> list[tuple[Craters, tuple[Condition, ...]]]:
    """The craters that an operator lays, with the conditions of its mask; most lay none."""
    if isinstance(operator, Craters):
        return [(operator, ())]
    if isinstance(operator, Masked) and isinstance(operator.operator, Craters):
        return [(operator.operator, operator.conditions)]
    return []
