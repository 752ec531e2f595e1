"""Rules of the source that the linter's banned imports cannot say, as a walk over the syntax tree.

Each rule guards byte-identical output.
"""

from __future__ import annotations

import ast
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

#: Kinds of sort that keep equal elements in order; numba's argsort knows the older name only.
STABLE_KINDS = ("stable", "mergesort")
#: What the module of streams may take from numpy.random: the one bit generator, nothing that draws.
ALLOWED_RANDOM = ("numpy.random.Philox",)
#: What goes on while others have the processor.
WALL_CLOCKS = tuple(
    f"time.{clock}{unit}" for clock in ("time", "monotonic", "perf_counter") for unit in ("", "_ns")
)
DIRECTORY_METHODS = ("iterdir", "glob", "rglob")
#: Functions whose result does not depend on the order of what they are given.
ORDER_FREE = ("sorted", "any", "all", "len", "min", "max", "set", "frozenset")
SET_METHODS = ("union", "intersection", "difference", "symmetric_difference")


@dataclass(frozen=True, order=True)
class Violation:
    """A place that breaks a rule."""

    file: str
    line: int
    message: str

    def __str__(self) -> str:
        return f"{self.file}:{self.line}: {self.message}"


def determinism_violations(source: str, file: str) -> list[Violation]:
    """Constructions whose result may depend on the CPU, the hash seed or the file system."""
    # Walked once: the walk is what takes time.
    nodes = list(ast.walk(ast.parse(source)))
    names = _imported_names(nodes)
    unordered = _where_order_is_lost(nodes, names)
    return [
        Violation(file, _line(node), message)
        for node in nodes
        if node not in unordered
        for message in _node_messages(node, names)
    ]


def random_violations(source: str, file: str) -> list[Violation]:
    """Uses of numpy.random or random other than the allowed bit generator."""
    tree = ast.parse(source)
    names = _imported_names(ast.walk(tree))
    found = []
    for node in ast.walk(tree):
        if not isinstance(node, ast.Attribute | ast.Name):
            continue
        name = _qualified(node, names)
        chance = name.startswith(("numpy.random.", "random."))
        if chance and not name.startswith(ALLOWED_RANDOM):
            found.append(Violation(file, node.lineno, f"{name} draws apart from the named streams"))
    return found


def wait_violations(source: str, file: str) -> list[Violation]:
    """What makes a test fail on a slow machine: deadlines, clocks on the wall, waits that end."""
    nodes = list(ast.walk(ast.parse(source)))
    names = _imported_names(nodes)
    found = []
    for node in nodes:
        if not isinstance(node, ast.Call):
            continue
        options = _keywords(node)
        name = _qualified(node.func, names)
        method = node.func.attr if isinstance(node.func, ast.Attribute) else ""
        if "deadline" in options:
            found.append(Violation(file, node.lineno, "tests/conftest.py takes deadlines away"))
        if name in WALL_CLOCKS:
            found.append(Violation(file, node.lineno, f"{name} says how busy the machine is"))
        limited = "timeout" in options or (method in ("wait", "join") and _is_number(node.args))
        if limited or method == "wait_for_timeout":
            found.append(Violation(file, node.lineno, "wait for what happens, as long as it takes"))
    return found


def _is_number(arguments: list[ast.expr]) -> bool:
    return any(_literal(argument) is not None for argument in arguments)


def python_files(folder: Path) -> Iterator[Path]:
    """Every module under a folder, in one order."""
    return iter(sorted(folder.rglob("*.py")))


def _where_order_is_lost(nodes: Iterable[ast.AST], names: dict[str, str]) -> set[ast.AST]:
    """Nodes whose order reaches nothing: what ``sorted`` and its like are given, or loop over."""
    found: set[ast.AST] = set()
    for node in nodes:
        arguments: list[ast.expr] = []
        if isinstance(node, ast.Call) and _qualified(node.func, names) in ORDER_FREE:
            arguments = node.args
        elif isinstance(node, ast.SetComp):
            arguments = [node]
        for argument in arguments:
            found.add(argument)
            if isinstance(argument, ast.GeneratorExp | ast.ListComp | ast.SetComp):
                found.update(argument.generators)
                found.update(clause.iter for clause in argument.generators)
    return found


def _line(node: ast.AST) -> int:
    # A comprehension's clause has no position of its own.
    return node.iter.lineno if isinstance(node, ast.comprehension) else getattr(node, "lineno", 1)


def _node_messages(node: ast.AST, names: dict[str, str]) -> Iterator[str]:
    if isinstance(node, ast.BinOp | ast.AugAssign):
        if isinstance(node.op, ast.MatMult):
            yield "@ calls BLAS, whose result depends on the CPU"
        if isinstance(node.op, ast.Pow):
            exact = isinstance(node, ast.BinOp) and _is_exact_power(node.left, node.right)
            if not exact:
                yield "** calls libm's pow, even for squares: write x * x, or elementary.pow"
    elif isinstance(node, ast.Call):
        yield from _call_messages(node, names)
    elif isinstance(node, ast.Starred):
        yield from _set_messages(node.value)
    elif isinstance(node, ast.For | ast.comprehension):
        yield from _set_messages(node.iter)


def _set_messages(node: ast.expr) -> Iterator[str]:
    if _is_set(node):
        yield "the order of a set depends on the hash seed: sort it"


def _call_messages(call: ast.Call, names: dict[str, str]) -> Iterator[str]:
    name = _qualified(call.func, names)
    method = call.func.attr if isinstance(call.func, ast.Attribute) else ""
    stable = _keywords(call).get("kind") in STABLE_KINDS
    if name in ("numpy.sort", "numpy.argsort") and not stable:
        yield f'{name} leaves the order of ties to the CPU: kind="stable"'
    elif name.startswith("numpy.sort") or name.startswith("numpy.argsort"):
        return
    elif method in ("sort", "argsort") and not stable:
        yield f'.{method}() on an array leaves ties to the CPU: kind="stable" (for a list: sorted)'
    elif method in ("argpartition", "partition") and not _is_text_partition(call):
        yield f".{method}() leaves the order of ties to the CPU"
    elif method == "dot":
        yield ".dot() calls BLAS, whose result depends on the CPU"
    elif name in ("os.listdir", "os.scandir", "glob.glob") or method in DIRECTORY_METHODS:
        yield "the order of a folder's files depends on the file system: sort them"
    elif name == "hash":
        yield "hash() of a string depends on the hash seed"
    elif name == "id":
        yield "id() depends on the memory layout"
    elif name in ("list", "tuple", "enumerate", "iter", "next", "zip", "map", "numpy.array"):
        if any(_is_set(argument) for argument in call.args):
            yield "the order of a set depends on the hash seed: sort it"
    elif method == "join" and any(_is_set(argument) for argument in call.args):
        yield "the order of a set depends on the hash seed: sort it"


def _is_text_partition(call: ast.Call) -> bool:
    return (
        bool(call.args)
        and isinstance(call.args[0], ast.Constant)
        and isinstance(call.args[0].value, str)
    )


def _is_exact_power(base: ast.expr, exponent: ast.expr) -> bool:
    """Whether a power is one of whole numbers, or of plus or minus 1.0 or 2.0."""
    number = _literal(base)
    power = _literal(exponent)
    if isinstance(power, float):
        return False
    return isinstance(number, int) or number in (-2.0, -1.0, 1.0, 2.0)


def _literal(node: ast.expr) -> int | float | None:
    sign = 1
    if isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub):
        sign, node = -1, node.operand
    if isinstance(node, ast.Constant) and isinstance(node.value, int | float):
        return sign * node.value
    return None


def _is_set(node: ast.expr) -> bool:
    if isinstance(node, ast.Set | ast.SetComp):
        return True
    if isinstance(node, ast.BinOp) and isinstance(node.op, ast.BitOr | ast.BitAnd | ast.Sub):
        return _is_set(node.left) or _is_set(node.right)
    if not isinstance(node, ast.Call):
        return False
    if isinstance(node.func, ast.Attribute):
        return node.func.attr in SET_METHODS
    return isinstance(node.func, ast.Name) and node.func.id in ("set", "frozenset")


def _keywords(call: ast.Call) -> dict[str, object]:
    return {
        k.arg: k.value.value if isinstance(k.value, ast.Constant) else None
        for k in call.keywords
        if k.arg is not None
    }


def _imported_names(nodes: Iterable[ast.AST]) -> dict[str, str]:
    names = {}
    for node in nodes:
        if isinstance(node, ast.Import):
            for alias in node.names:
                top = alias.name.split(".")[0]
                names[alias.asname or top] = alias.name if alias.asname else top
        elif isinstance(node, ast.ImportFrom):
            for alias in node.names:
                names[alias.asname or alias.name] = f"{node.module}.{alias.name}"
    return names


def _qualified(node: ast.expr, names: dict[str, str]) -> str:
    """Dotted name of an expression with imports resolved; "" for anything else."""
    if isinstance(node, ast.Name):
        return names.get(node.id, node.id)
    if isinstance(node, ast.Attribute):
        base = _qualified(node.value, names)
        return f"{base}.{node.attr}" if base else ""
    return ""
