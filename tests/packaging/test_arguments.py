"""What travels together is a named tuple: functions take ten arguments at most, kernels eight."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from itertools import chain
from pathlib import Path

from test_rooms import HOUSE

ROOT = Path(__file__).resolve().parents[2]
ROOMS = tuple(chain(*HOUSE))
MOST, MOST_OF_KERNELS = 10, 8


def too_many(source: str) -> Iterator[tuple[str, int]]:
    """Names of functions with more arguments than they should have, and how many."""
    for node in ast.walk(ast.parse(source)):
        if not isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            continue
        own = node.args
        names = [a.arg for a in (*own.posonlyargs, *own.args, *own.kwonlyargs)]
        count = len(names) - (names[:1] in (["self"], ["cls"]))
        count += (own.vararg is not None) + (own.kwarg is not None)
        marks = {d.id for d in node.decorator_list if isinstance(d, ast.Name)}
        if count > (MOST_OF_KERNELS if marks & {"kernel", "inlined"} else MOST):
            yield node.name, count


def test_functions_take_ten_arguments_at_most_and_kernels_eight():
    found = {
        f"{path.relative_to(ROOT)}:{name}": count
        for room in ROOMS
        for path in sorted((ROOT / room).rglob("*.py"))
        for name, count in too_many(path.read_text(encoding="utf-8"))
    }
    assert not found
