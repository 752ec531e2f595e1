"""Writes compiler/cfg/builder.pyi, the types of ``scenec.compiler.cfg.builder``.

It is no part of the repository: ``make setup`` and ``make wheel`` write it.

python -m tools.cfg_stub
"""

from __future__ import annotations

import textwrap
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from scenec.compiler.cfg import builder
from scenec.compiler.kinds import schema

TARGET = Path(__file__).resolve().parents[1] / "compiler" / "cfg" / "builder.pyi"

HEAD = """\
# Made by tools/cfg_stub.py out of the cfg's schema.
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from scenec.compiler.cfg.load import Spec

LEFT_OUT: Any

class Part:
    def as_json(self) -> dict[str, Any]: ...

class CompleteCfg(Part):
    def text(self) -> str: ...
    def save(self, path: Path | str) -> Path: ...
    def check(self, folder: Path | str = ".") -> Spec: ...

def read(path: Path | str) -> Cfg: ...
def names() -> Mapping[str, str]: ...
def keys(reference: str) -> dict[str, Any]: ...
def part_class(reference: str) -> type[Part]: ...
"""

_PLAIN = {
    "string": "str", "number": "float", "integer": "int", "boolean": "bool", "null": "None"
}  # fmt: skip


def make() -> str:
    """The file."""
    return HEAD + "\n" + "\n".join([*_unions(), "", *map(_class, builder.names())])


def _unions() -> list[str]:
    """What is one of several kinds; other packages' kinds are mappings."""
    found = [f"type Number = float | {' | '.join(_distributions())}"]
    for file, content in schema.load_schemas().items():
        if "allOf" in content and file != schema.NUMBER:
            kinds = [_name(branch["then"]["$ref"]) for branch in content["allOf"]]
            found.append(f"type {_union(file)} = {' | '.join([*kinds, 'Mapping[str, Any]'])}")
    return found


def _class(name: str) -> str:
    reference = builder.names()[name]
    described = schema.describe({"$ref": reference}, {})
    required = described.keywords.get("required", ())
    base = "CompleteCfg" if reference == schema.ROOT else "Part"
    about = described.keywords.get("description", "")
    lines = ["@dataclass(kw_only=True)", f"class {name}({base}):", *_docstring(about, reference)]
    for key, entry in builder.keys(reference).items():
        if "const" not in entry:
            lines.append(f"    {key}: {_type(entry)}" + ("" if key in required else " = ..."))
    return "\n".join(lines) + "\n"


def _docstring(about: str, reference: str) -> list[str]:
    lines = [about] if about else []
    for key, entry in builder.keys(reference).items():
        text = entry.get("description", "")
        if "const" not in entry and text:
            unit = f" [{entry['x-unit']}]" if "x-unit" in entry else ""
            lines.append(f"{key}{unit}: {text}")
    wrapped = [
        part for line in lines for part in textwrap.wrap(line, 92, subsequent_indent="    ")
    ]  # fmt: skip
    quoted = [part.replace("\\", "\\\\") for part in wrapped]
    return ['    """' + quoted[0], *("    " + part for part in quoted[1:]), '    """']


def _type(entry: Mapping[str, Any]) -> str:
    """Of a key's schema, as Python's annotations say it."""
    described = schema.describe(entry, None)
    keywords = described.keywords
    if described.is_number:
        return "Number"
    if "enum" in keywords:
        named = ", ".join(map(_literal, keywords["enum"]))
        kinds = [f"Literal[{named}]"] if keywords["enum"] else []
        return " | ".join(kinds + (["str"] if "x-open" in keywords else []))
    if "$ref" in entry:
        file = entry["$ref"]
        if file in builder.names().values():
            return _name(file) + _null(keywords)
        if "allOf" in schema.load_schemas()[file]:
            return _union(file) + _null(keywords)
    if "number" in keywords["type"] and "object" in keywords["type"]:
        return "Number" + _null(keywords)
    types = keywords["type"] if isinstance(keywords["type"], list) else [keywords["type"]]
    return " | ".join(_plain(name, keywords) for name in types)


def _plain(name: str, keywords: Mapping[str, Any]) -> str:
    if name == "array":
        kinds = [*keywords.get("prefixItems", ())]
        kinds += [keywords["items"]] if isinstance(keywords.get("items"), Mapping) else []
        return f"Sequence[{' | '.join(dict.fromkeys(map(_type, kinds)))}]"
    if name == "object" and not keywords.get("additionalProperties"):
        return "Mapping[str, Any]"
    if name == "object":
        return f"Mapping[str, {_type(keywords['additionalProperties'])}]"
    return _PLAIN[name]


def _null(keywords: Mapping[str, Any]) -> str:
    return " | None" if "null" in keywords.get("type", ()) else ""


def _literal(value: Any) -> str:
    return f'"{value}"' if isinstance(value, str) else repr(value)


def _name(reference: str) -> str:
    return next(name for name, own in builder.names().items() if own == reference)


def _union(file: str) -> str:
    # The classes of its kinds begin with this name.
    return "Any" + "".join(part.capitalize() for part in file.rpartition("/")[2].split("_"))


def _distributions() -> list[str]:
    return [name for name, own in builder.names().items() if own.startswith(f"{schema.NUMBER}/")]


if __name__ == "__main__":
    TARGET.write_text(make(), encoding="utf-8")
    print(TARGET)
