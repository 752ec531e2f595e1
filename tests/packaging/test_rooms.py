"""Rooms of compiler and backends stand on floors: imports go down; no files import in a ring."""

from __future__ import annotations

import ast
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
#: From the ground up: a room imports those before it. Rooms side by side share nothing.
FLOORS = {
    "compiler": (
        ("arithmetic", "cache"),
        ("noise", "distributions", "scene", "geometry"),
        ("kinds",),
        ("assets",),
        ("cfg", "terrain"),
        ("views",),
        ("materials", "mesh"),
        ("objects", "cameras", "light"),
        ("draw", "emit"),
        ("build", "output", "estimate"),
        ("batch_unit",),
        ("compile",),
        ("sweep",),
    ),
    "backends": (
        ("stage",),
        ("contract", "registry"),
        ("camera",),
        ("surface",),
        ("model",),
        ("exact",),
        ("imaging",),
        ("annotation",),
        ("picture",),
        ("mitsuba", "cycles", "pyrender"),
        ("run",),
        ("check",),
        ("testing",),
    ),
}
#: What stands in no room.
LOOSE = {
    "compiler": {"build", "output", "estimate", "batch_unit", "compile", "sweep"},
    "backends": {"contract", "registry"},
}
#: Backends that are registered are imported by name, when they are asked for; this one by its text.
MAY = {("registry", "contract")}


def modules(layer: str) -> dict[str, Path]:
    """Files of a layer by dotted name within it."""
    folder = ROOT / layer
    found = {}
    for file in folder.rglob("*.py"):
        parts = file.relative_to(folder).with_suffix("").parts
        found[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = file
    return found


def imported(source: str, layer: str, names: set[str]) -> set[str]:
    """Modules of a layer that a source imports, within functions too, but for types alone."""
    prefix = f"scenec.{layer}."
    tree = ast.parse(source)
    found: set[str] = set()
    for node in _run(tree):
        if isinstance(node, ast.Import):
            found |= {a.name.removeprefix(prefix) for a in node.names if a.name.startswith(prefix)}
        elif isinstance(node, ast.ImportFrom) and f"{node.module}.".startswith(prefix):
            base = f"{node.module}.".removeprefix(prefix)
            for alias in node.names:
                whole = base + alias.name
                found.add(whole if whole in names else base.rstrip("."))
    return found


def _run(tree: ast.AST) -> list[ast.AST]:
    """Nodes but those for type checkers."""
    nodes: list[ast.AST] = []
    waiting = [tree]
    while waiting:
        node = waiting.pop()
        nodes.append(node)
        if isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test):
            continue
        waiting += ast.iter_child_nodes(node)
    return nodes


def room(name: str) -> str:
    return name.split(".")[0]


def refused(layer: str, of: str, other: str) -> bool:
    """Whether a room must not import another."""
    if of == other or (of, other) in MAY:
        return False
    floor = {name: number for number, names in enumerate(FLOORS[layer]) for name in names}
    return floor[other] >= floor[of]


@pytest.mark.parametrize("layer", FLOORS)
def test_every_room_has_its_floor_and_few_files_are_loose(layer: str) -> None:
    folder = ROOT / layer
    rooms = {path.name for path in folder.iterdir() if (path / "__init__.py").exists()}
    loose = {path.stem for path in folder.glob("*.py")} - {"__init__"}
    assert loose == LOOSE[layer]
    assert rooms | loose == {name for names in FLOORS[layer] for name in names}


@pytest.mark.parametrize("layer", FLOORS)
def test_imports_go_down(layer: str) -> None:
    found = modules(layer)
    up = [
        f"{name} imports {other}"
        for name, file in found.items()
        if name
        for other in imported(file.read_text(encoding="utf-8"), layer, set(found))
        if other and refused(layer, room(name), room(other))
    ]
    assert up == []


def test_importers_read_stages_by_the_backends_reader_and_know_nothing_else_of_them() -> None:
    names = set(modules("backends"))
    found = {
        room(other)
        for file in modules("importers").values()
        for other in imported(file.read_text(encoding="utf-8"), "backends", names)
    }
    assert found == {"stage"}


@pytest.mark.parametrize("layer", FLOORS)
def test_no_files_import_in_a_ring(layer: str) -> None:
    found = modules(layer)
    graph = {
        name: imported(file.read_text(encoding="utf-8"), layer, set(found)) - {name}
        for name, file in found.items()
    }
    try:
        TopologicalSorter(graph).prepare()
    except CycleError as error:
        pytest.fail(f"a ring: {' -> '.join(error.args[1])}")


@pytest.mark.parametrize(
    ("layer", "of", "line", "wrong"),
    [
        ("backends", "exact", "from scenec.backends.run import worker", True),
        ("backends", "exact", "import scenec.backends.picture.haze", True),
        ("backends", "mitsuba", "from scenec.backends.cycles.adapter import Cycles", True),
        ("backends", "exact", "def f():\n    from scenec.backends.check import stage", True),
        ("backends", "run", "from scenec.backends.exact import ExactCaster", False),
        ("backends", "registry", "from scenec.backends.contract import Backend", False),
        ("compiler", "mesh", "from scenec.compiler.materials import tile", True),
        ("compiler", "draw", "from scenec.compiler.light import latlong", False),
    ],
)
def test_a_wrong_import_is_seen(layer: str, of: str, line: str, wrong: bool) -> None:
    others = imported(line, layer, set(modules(layer)))
    assert len(others) == 1
    assert any(refused(layer, of, room(other)) for other in others) == wrong
