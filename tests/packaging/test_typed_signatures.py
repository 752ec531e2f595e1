"""What rooms tell each other has a type: no public signature has a mapping of anything."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator

from tests.packaging.test_rooms import HOUSE, ROOT

#: Those of the wheel.
ROOMS = [room for floor in HOUSE for room in floor if room not in ("testing", "lab")]
ANYTHING = re.compile(r"\b(dict|Mapping|MutableMapping)\[[^\[\]]*, Any\]")
#: Whose values have no common type, and why.
EXCEPTIONS = {
    # What JSON has no schema for here, and the one alias of a document that has its own.
    "schemas/codec.py": {"JsonObject", "omitted"},
    # Values of a step's parameters, of a call's arguments and of a class's fields, by name: each
    # has the type that the function or the class declares.
    "compiler/build.py": {"State", "run", "build_to"},
    "compiler/cache/memo.py": {"call", "key"},
    "compiler/kinds/context.py": {"sampled"},
    "compiler/kinds/declare.py": {
        "keywords", "but", "bounded", "values_from_context", "declared_keys",
    },
    "compiler/kinds/draw.py": {"values_of"},
    "backends/annotation/contract.py": {"built_in"},
    "backends/run/render.py": {"render"},
    "api/declare.py": {"option", "held"},
    "api/outputs.py": {"render"},
    "api/preview.py": {"set"},
    "api/torch_stream.py": {"__init__"},
    "cli/arguments.py": {"given", "chosen"},
    # What libraries without types take: trimesh, Blender, Mitsuba, Pillow, PyTorch.
    "compiler/assets/trimesh_file.py": {"loader"},
    "backends/cycles/geometry.py": {"build"},
    "backends/cycles/materials.py": {"make_materials"},
    "backends/cycles/pictures.py": {"look_up"},
    "backends/mitsuba/emitter.py": {"dome_dict"},
    "backends/mitsuba/pictures.py": {"look_up"},
    "backends/surface/lobes.py": {"lobes_of"},
    "backends/surface/pictures.py": {"Values"},
    "datasets/formats/encode.py": {"encoded"},
    "datasets/torch_dataset.py": {"Sample", "remap"},
}  # fmt: skip


def untyped(body: list[ast.stmt]) -> Iterator[str]:
    """Names of what is public and has a mapping of anything, or keywords of any type."""
    for node in body:
        name = getattr(node, "name", "")
        types: list[ast.expr | None] = []
        if isinstance(node, ast.FunctionDef):
            of = node.args
            every = [
                *of.posonlyargs,
                *of.args,
                *of.kwonlyargs,
                *filter(None, [of.vararg, of.kwarg]),
            ]
            types = [*(one.annotation for one in every), node.returns]
            if of.kwarg and ast.unparse(of.kwarg).endswith(": Any"):
                types.append(ast.parse("dict[str, Any]", mode="eval").body)
        elif isinstance(node, ast.ClassDef) and name[0] != "_":
            yield from untyped(node.body)
        elif isinstance(node, ast.AnnAssign):
            name, types = ast.unparse(node.target), [node.annotation]
        elif isinstance(node, ast.Assign):
            name, types = ast.unparse(node.targets[0]), [node.value]
        elif isinstance(node, ast.TypeAlias):
            name, types = ast.unparse(node.name), [node.value]
        public = name[:1] != "_" or name in ("__init__", "__call__")
        if public and any(ANYTHING.search(ast.unparse(one)) for one in types if one):
            yield name


def test_no_public_signature_has_a_mapping_of_anything_but_those_with_a_reason():
    found = {
        file.relative_to(ROOT).as_posix(): names
        for room in ROOMS
        for file in sorted((ROOT / room).rglob("*.py"))
        if (names := set(untyped(ast.parse(file.read_text(encoding="utf-8")).body)))
    }
    assert found == EXCEPTIONS


def test_each_way_of_having_one_is_found():
    text = """
class Open:
    facts: dict[str, Any]
    def tell(self, **details: Any): ...
    def _own(self) -> dict[str, Any]: ...
def read(cfg: Sequence[Mapping[str, Any]]): ...
def made() -> tuple[int, dict[str, Any]]: ...
type Free = dict[str, Any]
Facts = Mapping[str, Any]
class _Closed:
    facts: dict[str, Any]
def typed(facts: Mapping[str, JSON]) -> dict[str, int]: ...
"""
    assert [*untyped(ast.parse(text).body)] == ["facts", "tell", "read", "made", "Free", "Facts"]
