"""What must hold between keys, as the kinds that a cfg names say it themselves."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

from scenec.compiler.kinds.finding import Finding
from scenec.compiler.kinds.node import Node
from scenec.compiler.kinds.schema import Field
from scenec.compiler.kinds.table import loaded
from scenec.schemas.plugins import load_kind


def check_kinds(fields: Iterable[Field], cfg: Node) -> Iterator[Finding]:
    """Yields what the ``check`` of each declared object finds; only their modules are imported.

    Args:
        fields: All places of the cfg; the keyword "x-check" says which class has a check,
            "x-offered" which one of another package.
        cfg: The whole.
    """
    for field in fields:
        if "x-check" in field.keywords and (node := cfg.at(*field.path)):
            yield from loaded(field.keywords["x-check"]).check(node)
        if "x-offered" in field.keywords and (node := cfg.at(*field.path)):
            yield from load_kind(*field.keywords["x-offered"]).check(node)
