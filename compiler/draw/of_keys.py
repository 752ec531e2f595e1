"""Objects whose fields are the keys of a cfg's node."""

from __future__ import annotations

from typing import Any

from scenec.compiler.cfg.load import Spec
from scenec.compiler.distributions.streams import Streams


def of_keys(
    spec: Spec, kinds: dict[str, type[Any]], node: dict[str, Any], streams: Streams, path: str
) -> Any:
    """What a node's ``type`` names, with the node's other keys as its fields."""
    values = {k: tuple(v) if isinstance(v, list) else v for k, v in node.items() if k != "type"}
    kind = kinds[node["type"]]
    if "file" in values:
        values["file"] = spec.files[f"{path}/file"].path
    if "key" in kind.__dataclass_fields__:
        values["key"] = streams.key(path)
    return kind(**values)
