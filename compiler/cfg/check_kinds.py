"""What must hold between keys, as the kinds that a cfg names say it themselves."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping

from scenec.compiler.kinds import Finding, InputFile, Node
from scenec.compiler.kinds.schema import Field
from scenec.compiler.kinds.table import loaded
from scenec.schemas.plugins import load_kind


def check_kinds(
    fields: Iterable[Field], cfg: Node, files: Mapping[str, InputFile] | None = None
) -> Iterator[Finding]:
    """Yields what the ``check`` of each declared object finds; only their modules are imported.

    Args:
        fields: All places of the cfg; the keyword "x-check" says which class has a check,
            "x-offered" which one of another package.
        cfg: The whole.
        files: Those that nothing is wrong with, by path: asked is then ``check_files``, of classes
            that have it.
    """
    for field in fields:
        if "x-check" in field.keywords and (node := cfg.at(*field.path)):
            kind = loaded(field.keywords["x-check"])
            if files is None:
                yield from kind.check(node)
            elif hasattr(kind, "check_files"):
                yield from kind.check_files(node, files)
        if files is None and "x-offered" in field.keywords and (node := cfg.at(*field.path)):
            yield from load_kind(*field.keywords["x-offered"]).check(node)
