"""Rooms of the backends stand on floors: imports go down; no files import in a ring."""

from __future__ import annotations

import ast
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
#: From the ground up: a room imports those before it. Adapters, side by side, share nothing.
FLOORS = (
    ("stage",),
    ("contract", "registry"),
    ("camera",),
    ("surface",),
    ("exact",),
    ("imaging",),
    ("annotation",),
    ("picture",),
    ("mitsuba", "cycles", "pyrender"),
    ("run",),
    ("check",),
)
#: Backends that are registered are imported by name, when they are asked for; this one by its text.
MAY = {("registry", "contract")}
PREFIX = "scenec.backends."


def modules() -> dict[str, Path]:
    """Files of the backends by dotted name within them."""
    folder = ROOT / "backends"
    found = {}
    for file in folder.rglob("*.py"):
        parts = file.relative_to(folder).with_suffix("").parts
        found[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = file
    return found


def imported(source: str, names: set[str], late: bool) -> set[str]:
    """Modules of the backends that a source imports; with ``late`` also within functions."""
    tree = ast.parse(source)
    found: set[str] = set()
    for node in ast.walk(tree) if late else _eager(tree):
        if isinstance(node, ast.Import):
            found |= {a.name.removeprefix(PREFIX) for a in node.names if a.name.startswith(PREFIX)}
        elif isinstance(node, ast.ImportFrom) and f"{node.module}.".startswith(PREFIX):
            base = f"{node.module}.".removeprefix(PREFIX)
            for alias in node.names:
                whole = base + alias.name
                found.add(whole if whole in names else base.rstrip("."))
    return found


def _eager(tree: ast.AST) -> list[ast.AST]:
    """Nodes that run when a module is imported: not in functions, not for type checkers."""
    nodes: list[ast.AST] = []
    waiting = [tree]
    while waiting:
        node = waiting.pop()
        nodes.append(node)
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.Lambda):
            continue
        if isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test):
            continue
        waiting += ast.iter_child_nodes(node)
    return nodes


def room(name: str) -> str:
    return name.split(".")[0]


def refused(of: str, other: str) -> bool:
    """Whether a room must not import another."""
    if of == other or (of, other) in MAY:
        return False
    floor = {name: number for number, names in enumerate(FLOORS) for name in names}
    return floor[other] >= floor[of]


def test_every_room_has_its_floor_and_only_the_contract_and_the_registry_are_loose() -> None:
    folder = ROOT / "backends"
    rooms = {path.name for path in folder.iterdir() if (path / "__init__.py").exists()}
    loose = {path.stem for path in folder.glob("*.py")} - {"__init__"}
    assert loose == {"contract", "registry"}
    assert rooms | loose == {name for names in FLOORS for name in names}


def test_imports_go_down() -> None:
    found = modules()
    up = [
        f"{name} imports {other}"
        for name, file in found.items()
        if name
        for other in imported(file.read_text(encoding="utf-8"), set(found), late=True)
        if refused(room(name), room(other))
    ]
    assert up == []


def test_no_files_import_in_a_ring() -> None:
    found = modules()
    graph = {
        name: imported(file.read_text(encoding="utf-8"), set(found), late=True) - {name}
        for name, file in found.items()
    }
    try:
        TopologicalSorter(graph).prepare()
    except CycleError as error:
        pytest.fail(f"a ring: {' -> '.join(error.args[1])}")


@pytest.mark.parametrize(
    ("of", "line", "wrong"),
    [
        ("exact", "from scenec.backends.run import worker", True),
        ("exact", "import scenec.backends.picture.haze", True),
        ("mitsuba", "from scenec.backends.cycles.adapter import Cycles", True),
        ("exact", "def f():\n    from scenec.backends.check import stage", True),
        ("run", "from scenec.backends.exact import ExactCaster", False),
        ("registry", "from scenec.backends.contract import Backend", False),
    ],
)
def test_a_wrong_import_is_seen(of: str, line: str, wrong: bool) -> None:
    others = imported(line, set(modules()), late=True)
    assert len(others) == 1
    assert any(refused(of, room(other)) for other in others) == wrong
