"""What the page of troubleshooting quotes is what scenec says."""

from __future__ import annotations

import ast
import re
from functools import cache

import pytest
from blocks import ROOT

PAGE = (ROOT / "docs" / "troubleshooting.md").read_text(encoding="utf-8")
ROOMS = ("api", "backends", "compiler", "datasets", "schemas")


@cache
def said() -> str:
    """All texts of the code, what is put into them as "…"."""
    texts = []
    for path in (path for room in ROOMS for path in sorted((ROOT / room).rglob("*.py"))):
        for node in ast.walk(ast.parse(path.read_bytes())):
            if isinstance(node, ast.JoinedStr):
                parts = [p.value if isinstance(p, ast.Constant) else "…" for p in node.values]
                texts.append("".join(map(str, parts)))
            elif isinstance(node, ast.Constant) and isinstance(node.value, str):
                texts.append(node.value)
    return "\n".join(texts)


@pytest.mark.parametrize("message", re.findall(r"(?m)^\| `([^`]+)` \|", PAGE))
def test_each_part_of_a_quoted_message_stands_in_the_code(message):
    for part in filter(None, (part.strip() for part in message.split("…"))):
        assert part in said()
