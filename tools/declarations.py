"""Writes what is made of the cfg's declarations: its JSON Schema, its reference page, its types.

python -m tools.declarations

``schemas/cfg.schema.json``, ``docs/cfg.md`` and the table of ``docs/presets.md`` are part of the
repository, and tests hold them against the declarations; ``compiler/cfg/builder.pyi`` is not.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from tools import cfg_stub

from scenec.compiler.kinds import schema
from scenec.compiler.kinds.generate import bundle
from scenec.compiler.kinds.table import CLASSES
from scenec.schemas import presets
from scenec.testing import cfg_reference

TARGET = Path(__file__).resolve().parents[1] / "schemas" / "cfg.schema.json"
PRESETS = TARGET.parents[1] / "docs" / "presets.md"
#: Below it stands the table.
PRESETS_MARK = "<!-- made by python -m tools.declarations -->"


def text() -> str:
    """Returns the schema's file: a line for each key of the cfg."""
    whole = bundle()
    definitions = whole.pop("$defs")
    lines = [f"  {_line(key)}: {_line(value)}," for key, value in whole.items()]
    made = [f"    {_line(name)}: {_definition(one)}" for name, one in definitions.items()]
    return "{\n" + "\n".join(lines) + '\n  "$defs": {\n' + ",\n".join(made) + "\n  }\n}\n"


def _definition(of: dict[str, Any]) -> str:
    parts = []
    for key, value in of.items():
        if key == "properties":
            below = ",\n".join(f"        {_line(k)}: {_line(v)}" for k, v in value.items())
            parts.append(f'      "properties": {{\n{below}\n      }}')
        else:
            parts.append(f"      {_line(key)}: {_line(value)}")
    return "{\n" + ",\n".join(parts) + "\n    }"


def _line(value: Any) -> str:
    return json.dumps(value, ensure_ascii=False)


def _missing() -> list[str]:
    """Returns what declarations do not say."""
    found = []
    for name, of in bundle()["$defs"].items():
        place = CLASSES.get(name, name)
        found += [] if of["description"] else [f"{place}: no docstring"]
        found += [
            f"{place}: {key}: no string below it that says what it is"
            for key, said in of.get("properties", {}).items()
            if not said.get("description")
        ]
    return found


def with_presets(page: str) -> str:
    """Returns the page of presets with their table."""
    head, mark, _ = page.partition(PRESETS_MARK)
    return f"{head}{mark}\n\n{presets.table()}"


def main() -> None:
    """Writes all.

    Raises:
        SystemExit: A class or a key is not described.
    """
    if missing := _missing():
        raise SystemExit("\n".join(missing))
    TARGET.write_text(text(), encoding="utf-8")
    for cached in (schema.load_bundle, schema.load_schemas):
        cached.cache_clear()
    cfg_reference.TARGET.write_text(cfg_reference.make(), encoding="utf-8")
    PRESETS.write_text(with_presets(PRESETS.read_text(encoding="utf-8")), encoding="utf-8")
    cfg_stub.TARGET.write_text(cfg_stub.make(), encoding="utf-8")


if __name__ == "__main__":
    main()
