"""Rooms stand on floors: imports go down, those for types too; no files import in a ring."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from functools import cache
from graphlib import CycleError, TopologicalSorter
from itertools import chain
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
#: The house, from the ground up: a folder imports those before it. Folders side by side share
#: nothing. ``test_layers.py`` holds each folder's ``ruff.toml`` to it.
HOUSE = (
    ("schemas",),
    ("compiler", "backends", "datasets"),
    ("importers", "settle", "quality"),
    ("api",),
    ("cli",),
    ("testing",),
    ("lab",),
)
#: The same within a folder, of its rooms and of what stands in no room.
FLOORS = {
    "compiler": (
        ("arithmetic", "cache"),
        ("noise", "distributions", "scene", "geometry"),
        ("kinds",),
        ("assets",),
        ("cfg", "terrain"),
        ("views",),
        ("materials", "mesh"),
        ("objects", "cameras"),
        ("light",),
        ("plan",),
        ("draw", "emit"),
        ("build", "output", "estimate"),
        ("batch_unit",),
        ("compile",),
        ("sweep",),
    ),
    "backends": (
        ("stage",),
        ("contract", "noise_seeds", "registry"),
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
    "datasets": (
        ("outputs",),
        ("bins", "card_tables", "colors", "idset", "outlines", "source"),
        ("splits", "sums", "tracks"),
        ("filters", "motion_colors", "pictures", "remap", "statistics"),
        ("contact_sheet", "formats", "view", "terminal"),
        ("evaluate", "export_plan", "recording", "sheet", "torch_dataset", "card"),
        ("export_records",),
        ("export_part", "holdings"),
        ("export",),
        ("verify", "maps"),
        ("models",),
    ),
    "importers": (
        ("numbers", "poses", "report"),
        ("scene", "source", "writers"),
        ("assets", "output"),
        ("blenderproc", "oaisys", "usd"),
    ),
    "api": (
        ("forms", "listener", "text"),
        ("check_text", "declare"),
        ("options",),
        ("explain", "shown", "steps"),
        ("outputs", "models"),
        ("stage_export",),
        ("maps", "rectify", "site", "tracks"),
        (
            "check",
            "evaluate",
            "export",
            "make",
            "measure",
            "preview",
            "stream",
            "sweep",
            "view",
            "work",
        ),
        ("torch_stream",),
    ),
    "quality": (("converge", "ladder"),),
    "lab": (
        ("runner", "models"),
        ("pictures",),
        ("benchmarks",),
        ("experiments", "pages"),
        ("robustness",),
        ("tests",),
    ),
}
#: They have files alone, which must not import in a ring.
FLAT = {"schemas", "settle", "cli", "testing"}
#: Folders that further ones are closed to, above what ``HOUSE`` says.
CLOSED = {
    "settle": {"backends", "datasets"},
    "importers": {"datasets"},
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
    """Modules of a layer that a source imports, within functions and for types alone, too."""
    prefix = f"scenec.{layer}."
    found: set[str] = set()
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            found |= {a.name.removeprefix(prefix) for a in node.names if a.name.startswith(prefix)}
        elif isinstance(node, ast.ImportFrom) and f"{node.module}.".startswith(prefix):
            base = f"{node.module}.".removeprefix(prefix)
            for alias in node.names:
                whole = base + alias.name
                found.add(whole if whole in names else base.rstrip("."))
    return found


@cache
def imports(layer: str) -> dict[str, set[str]]:
    """What each module of a layer imports of the others."""
    found = modules(layer)
    return {
        name: imported(file.read_text(encoding="utf-8"), layer, set(found)) - {name}
        for name, file in found.items()
    }


def room(name: str) -> str:
    return name.split(".")[0]


def refused(layer: str, of: str, other: str) -> bool:
    """Whether a room must not import another."""
    if of == other or (of, other) in MAY:
        return False
    floor = {name: number for number, names in enumerate(FLOORS[layer]) for name in names}
    return floor[other] >= floor[of]


def above(folder: str) -> set[str]:
    """The folders of the house that one must not import."""
    (own,) = (number for number, names in enumerate(HOUSE) if folder in names)
    return set(chain(*HOUSE[own:])) - {folder} | CLOSED.get(folder, set())


def test_every_folder_with_modules_of_the_package_has_its_floor():
    folders = {path.parent.name for path in ROOT.glob("*/__init__.py")}
    assert folders - {"tests"} == set(chain(*HOUSE)) == FLOORS.keys() | FLAT


@pytest.mark.parametrize("layer", FLOORS)
def test_every_room_has_its_floor(layer):
    folder = ROOT / layer
    rooms = {path.parent.name for path in folder.glob("*/*.py")}
    loose = {path.stem for path in folder.glob("*.py")} - {"__init__"}
    assert rooms | loose == {name for names in FLOORS[layer] for name in names}


@pytest.mark.parametrize("layer", FLOORS)
def test_imports_go_down(layer):
    up = [
        f"{name} imports {other}"
        for name, others in imports(layer).items()
        if name
        for other in others
        if other and refused(layer, room(name), room(other))
    ]
    assert up == []


def test_importers_read_stages_by_the_backends_reader_and_know_nothing_else_of_them():
    names = set(modules("backends"))
    found = {
        room(other)
        for file in modules("importers").values()
        for other in imported(file.read_text(encoding="utf-8"), "backends", names)
    }
    assert found == {"stage"}


def test_tests_and_the_lab_import_nothing_of_each_other():
    tests = {file.stem for file in (ROOT / "tests").rglob("*.py")}
    names = set(modules("lab"))
    wrong = []
    for file in (file for layer in ("testing", "lab") for file in modules(layer).values()):
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Import):
                found = {alias.name for alias in node.names} & tests
            else:
                found = {node.module} & tests if isinstance(node, ast.ImportFrom) else set()
            wrong += [f"{file.relative_to(ROOT)} imports {name}" for name in sorted(found)]
    for file in (ROOT / "tests").rglob("*.py"):
        of_lab = imported(file.read_text(encoding="utf-8"), "lab", names)
        wrong += [f"{file.relative_to(ROOT)} imports lab.{name}" for name in sorted(of_lab)]
    assert wrong == []


@pytest.mark.parametrize("layer", sorted([*FLOORS, *FLAT]))
def test_no_files_import_in_a_ring(layer):
    try:
        TopologicalSorter(imports(layer)).prepare()
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
        ("compiler", "scene", "if TYPE_CHECKING:\n    from scenec.compiler.plan import Plan", True),
    ],
)
def test_a_wrong_import_is_seen(layer, of, line, wrong):
    others = imported(line, layer, set(modules(layer)))
    assert len(others) == 1
    assert any(refused(layer, of, room(other)) for other in others) == wrong


#: Arguments of a function and of a kernel; what travels together is a named tuple.
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
        for room in chain(*HOUSE)
        for path in sorted((ROOT / room).rglob("*.py"))
        for name, count in too_many(path.read_text(encoding="utf-8"))
    }
    assert not found
