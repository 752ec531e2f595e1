"""The layers and the determinism rules hold in the source, and each rule really fires."""

from __future__ import annotations

from itertools import chain
from pathlib import Path

import pytest
from hypothesis import settings
from source_rules import (
    determinism_violations,
    python_files,
    random_violations,
    wait_violations,
)
from test_rooms import HOUSE, above

from scenec.testing.processes import python

ROOT = Path(__file__).resolve().parents[2]
LAYERS = tuple(chain(*HOUSE))
STREAMS = ROOT / "compiler" / "distributions" / "streams.py"


def banned_lines(file: str, lines: list[str]) -> set[int]:
    """Lines, from 1, that ruff refuses as banned imports if they stood in ``file``."""
    options = ["--no-cache", "--select=TID", "--output-format=concise", "--stdin-filename"]
    text = "\n".join(lines) + "\n"
    done = python("-m", "ruff", "check", *options, file, "-", input=text, cwd=ROOT)
    assert done.returncode in (0, 1), done.stderr
    found = (line for line in done.stdout.splitlines() if ": TID" in line)
    return {int(line.split(":")[1]) for line in found}


@pytest.mark.parametrize("layer", LAYERS)
def test_ruff_lets_a_layer_import_only_the_layers_under_it(layer):
    others = [other for other in LAYERS if other != layer]
    lines = [f"import scenec.{other}.anything" for other in others]
    lines += [f"from scenec.{other} import anything" for other in others]
    lines += [f"from scenec import {other}" for other in others]
    wrong = [other in above(layer) for other in others] * 3
    expected = {n for n, refused in enumerate(wrong, 1) if refused}
    assert banned_lines(f"{layer}/scratch.py", lines) == expected
    assert banned_lines(f"{layer}/deeper/scratch.py", lines) == expected


def test_ruff_lets_an_importer_import_of_the_backends_the_reader_of_stages_alone():
    inside = [p for p in (ROOT / "backends").iterdir() if p.is_dir() or p.suffix == ".py"]
    others = sorted({p.stem for p in inside if p.name[0] not in "_."} - {"stage"})
    assert len(others) > 10
    lines = [f"import scenec.backends.{room}.anything" for room in others]
    lines += [f"from scenec.backends.{room} import anything" for room in others]
    lines += [f"from scenec.backends import {room}" for room in others]
    refused = set(range(1, len(lines) + 1))
    lines += ["from scenec.backends.stage.read import read_stage", "import scenec.compiler.compile"]
    assert banned_lines("importers/usd/scratch.py", lines) == refused


@pytest.mark.parametrize("folder", [*LAYERS, "tests"])
def test_ruff_refuses_a_second_copy_of_a_module(folder):
    lines = [f"import {layer}" for layer in LAYERS]
    lines += [f"from {layer}.anything import other" for layer in LAYERS]
    lines += ["from . import anything", "from ..schemas import errors"]
    assert banned_lines(f"{folder}/scratch.py", lines) == set(range(1, len(lines) + 1))


def test_ruff_refuses_machine_dependent_functions_in_the_compiler():
    lines = ["import math", "import time", "import numpy as np"]
    harmless = len(lines)
    lines += ["import random", "from datetime import datetime", "from math import sin"]
    lines += [
        "from numpy.random import default_rng",
        "import numpy.linalg",
        "from numpy import dot",
    ]
    lines += ["import scipy.special", "import mitsuba"]
    lines += [f"math.{name}(x)" for name in ("sin", "cos", "exp", "log", "pow", "atan2", "hypot")]
    lines += [f"np.{name}(x)" for name in ("sin", "cos", "exp", "log", "power", "arctan2", "hypot")]
    lines += [f"np.{name}(x, y)" for name in ("dot", "matmul", "einsum", "inner", "linalg.norm")]
    lines += ["np.random.default_rng(0)", "np.argpartition(x, 3)", "time.time()"]
    expected = set(range(harmless + 1, len(lines) + 1))
    lines += ["math.sqrt(x)", "math.floor(x)", "np.sqrt(x)", "time.perf_counter()"]
    assert banned_lines("compiler/terrain/scratch.py", lines) == expected
    assert banned_lines("backends/scratch.py", lines) == set()


def test_every_layer_has_its_bans():
    assert {layer for layer in LAYERS if (ROOT / layer / "ruff.toml").exists()} == set(LAYERS)


def test_ruff_refuses_the_lab_in_a_test():
    lines = ["import scenec.lab.runner", "from scenec.lab import runner", "from scenec import lab"]
    lines += ["import scenec.testing.small"]
    assert banned_lines("tests/scratch.py", lines) == {1, 2, 3}
    assert banned_lines("lab/tests/scratch.py", lines) == set()


@pytest.mark.parametrize(
    "line",
    [
        "a @ b", "a @= b", "x ** 2", "x ** 0.5", "2.5 ** x", "2 ** 0.5", "x **= 3", "np.sort(a)",
        "np.argsort(a, axis=1)", 'np.argsort(a, kind="quicksort")', "a.argsort()", "a.sort()",
        "a.partition(3)", "a.argpartition(3)", "a.dot(b)", "os.listdir(folder)",
        "list(folder.iterdir())", "hash(name)", "id(thing)", "[f(x) for x in {1, 2}]",
        "sorted(list(set(x)) for x in a)", "[f(x) for x in set(a) | set(b)]", "list(set(a))",
        "tuple({x for x in a})", "np.array(frozenset(a))", '", ".join(a.union(b))',
        "print(*set(a))",
    ],
)  # fmt: skip
def test_a_machine_dependent_construction_is_found(line):
    source = f"import numpy as np\n{line}\n"
    assert [v.line for v in determinism_violations(source, "scratch.py")] == [2]


@pytest.mark.parametrize(
    "line",
    [
        "2**n", "(-1.0) ** n", "2.0**-53", "f(**options)", 'np.sort(a, kind="stable")',
        'np.argsort(a, kind="mergesort")', 'a.argsort(kind="stable")', "sorted(set(a))",
        'sorted(folder.glob("*"))', "sorted(file.name for file in folder.iterdir() if file.name)",
        'any(folder.glob("*"))', "{f(x) for x in {1, 2}}", 'text.partition("=")', "x in {1, 2}",
        "elementary.pow(x, y)", "len(set(a))",
    ],
)  # fmt: skip
def test_a_harmless_construction_is_let_through(line):
    assert determinism_violations(f"import numpy as np\n{line}\n", "scratch.py") == []


def test_a_random_source_apart_from_philox_is_found():
    source = (
        "import numpy as np\nimport random\nfrom numpy.random import Philox, default_rng\n"
        "Philox(key=1)\nnp.random.Philox(key=1)\n"
        "default_rng(1)\nnp.random.Generator(b)\nrandom.random()\n"
    )
    assert sorted(v.line for v in random_violations(source, "scratch.py")) == [6, 7, 8]


#: A table of what was hashed already, looked up and never ordered or written.
_HARMLESS = {("compiler/cache/digests.py", "id() depends on the memory layout")}


def test_the_compiler_holds_no_machine_dependent_construction():
    files = list(python_files(ROOT / "compiler"))
    assert len(files) > 10
    found = [
        violation
        for path in files
        for violation in determinism_violations(path.read_text(), str(path.relative_to(ROOT)))
        if (violation.file, violation.message) not in _HARMLESS
    ]
    assert not found, "\n".join(str(violation) for violation in found)


@pytest.mark.parametrize("layer", LAYERS)
def test_only_the_module_of_kernels_imports_numba(layer):
    lines = ["import numba", "from numba import njit", "from numba.core import config"]
    expected = set() if layer in ("quality", "cli", "testing", "lab") else {1, 2, 3}
    assert banned_lines(f"{layer}/scratch.py", lines) == expected
    assert banned_lines("schemas/kernels.py", lines) == set()


@pytest.mark.parametrize(
    "line",
    [
        "@settings(deadline=200)\ndef test(): pass", "assert perf_counter() - start < 1.0",
        "end = time.monotonic() + 120", "process.communicate(timeout=60)",
        "subprocess.run(command, timeout=5)", "process.wait(10)", "page.wait_for_timeout(300)",
    ],
)  # fmt: skip
def test_what_a_slow_moment_would_fail_is_found(line):
    source = f"import subprocess, time\nfrom time import perf_counter\n{line}\n"
    assert [v.line for v in wait_violations(source, "scratch.py")] == [3]


def test_no_test_fails_for_a_slow_moment():
    files = [*python_files(ROOT / "tests"), *python_files(ROOT / "lab" / "tests")]
    assert len(files) > 200
    found = [
        violation
        for path in files
        if path != ROOT / "tests" / "conftest.py"
        for violation in wait_violations(path.read_text(), str(path.relative_to(ROOT)))
    ]
    assert not found, "\n".join(str(violation) for violation in found)
    assert settings().deadline is None


def test_streams_take_nothing_from_numpy_random_but_philox():
    found = random_violations(STREAMS.read_text(), "compiler/distributions/streams.py")
    assert not found, "\n".join(str(violation) for violation in found)
    assert "Philox" in STREAMS.read_text()
