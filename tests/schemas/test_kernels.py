"""Kernels are found by their content, kept whole or not at all, and never change a result."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from scenec.schemas import kernels
from scenec.schemas.kernels import Kernel, inlined, kernel

TEXT = '''
@kernel
def called(x):
    return x * FACTOR

@kernel
def caller(x):
    """What it does."""
    return called(x) + 1.0
'''
PROGRAM = """
import sys
from pathlib import Path
from scenec.schemas import kernels
kernels.SHIPPED = Path("/dev/null/nowhere")
from scenec.compiler.arithmetic.elementary import exp
loaded = []
load = kernels._FileCache.load_overload
kernels._FileCache.load_overload = lambda *given: loaded.append(load(*given)) or loaded[-1]
assert "numba" not in sys.modules
print(float(exp(1.0)).hex(), [each is not None for each in loaded])
"""


def _twice(x: float) -> float:
    return 2.0 * x


def made(text: str, **names: Any) -> dict[str, Any]:
    """What a source makes."""
    known: dict[str, Any] = {"kernel": kernel, "inlined": inlined, "np": np, "FACTOR": 2.0, **names}
    known["__name__"] = "scenec.scratch"
    exec(compile(text, "scratch.py", "exec"), known)
    return known


def content(text: str, name: str = "caller", **names: Any) -> str:
    found: Kernel = made(text, **names)[name]
    return found.content


def test_what_it_says_and_where_it_stands_is_not_content() -> None:
    assert content(TEXT) == content("\n\n# A remark.\n" + TEXT.replace("What it does", "Another"))


@pytest.mark.parametrize(
    ("before", "after"),
    [
        ("+ 1.0", "+ 2.0"),
        ("+ 1.0", "+ 1"),
        ("called(x) +", "called(x) -"),
        ("x * FACTOR", "x / FACTOR"),
        ("x * FACTOR", "x * 2.0"),
        ("x * FACTOR", "np.floor(x) * FACTOR"),
    ],
)
def test_what_it_computes_is_content_and_what_it_calls_too(before: str, after: str) -> None:
    assert before in TEXT
    assert content(TEXT) != content(TEXT.replace(before, after))


@pytest.mark.parametrize(
    ("one", "other"),
    [
        (2.0, np.nextafter(2.0, 3.0)),
        (np.arange(3), np.arange(3.0)),
        (np.arange(6.0), np.arange(6.0).reshape(2, 3)),
        ((1, 2), (1, 3)),
    ],
)
def test_constants_are_content_to_the_bit(one: Any, other: Any) -> None:
    assert content(TEXT, FACTOR=one) == content(TEXT, FACTOR=one)
    assert content(TEXT, FACTOR=one) != content(TEXT, FACTOR=other)


def test_a_kernel_may_call_itself() -> None:
    text = "@kernel\ndef fall(n):\n    return 0 if n == 0 else fall(n - 1) + 1\n"
    assert content(text, "fall") == content(text, "fall")


def test_what_has_no_content_is_refused() -> None:
    with pytest.raises(TypeError, match="caller uses FACTOR"):
        content(TEXT.replace("return called(x)", "return x + FACTOR"), FACTOR=object())


def test_every_kernel_of_ours_has_a_content() -> None:
    import importlib

    root = Path(__file__).resolve().parents[2]
    count = 0
    for layer in ("schemas", "compiler", "backends/exact", "backends/annotation", "datasets"):
        for file in sorted((root / layer).rglob("*.py")):
            source = file.read_text(encoding="utf-8")
            if "@kernel" not in source and "@inlined" not in source:
                continue
            dotted = ".".join(file.relative_to(root).with_suffix("").parts)
            module = importlib.import_module(f"scenec.{dotted}")
            found = [each for each in vars(module).values() if isinstance(each, Kernel)]
            assert len({each.content for each in found}) >= 1
            count += len(found)
    assert count > 300


def run(folder: Path, **environment: str) -> str:
    done = subprocess.run(
        [sys.executable, "-c", PROGRAM],
        env={**os.environ, "NUMBA_CACHE_DIR": str(folder), **environment},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout.strip()


def test_kernels_are_kept_each_cpus_in_a_file_of_its_own(tmp_path: Path) -> None:
    e, made_now = run(tmp_path).split()
    assert made_now == "[False]"
    # Code for another CPU is another file, with the same bits.
    assert run(tmp_path, NUMBA_CPU_NAME="generic", NUMBA_CPU_FEATURES="") == f"{e} [False]"
    assert len(list((tmp_path / "scenec").iterdir())) == 2
    assert run(tmp_path) == f"{e} [True]"


def test_damaged_kernels_are_compiled_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    assert Kernel(_twice, inline=False)(1.5) == 3.0
    (file,) = (tmp_path / "scenec").iterdir()
    whole = file.read_bytes()
    for damaged in (whole[:-1], b"", whole[:4000] + b"?" + whole[4001:]):
        file.write_bytes(damaged)
        assert Kernel(_twice, inline=False)(1.5) == 3.0
        assert len(file.read_bytes()) == len(whole)
        assert file.read_bytes() != damaged


@pytest.mark.slow
def test_another_numba_compiles_as_it_does(tmp_path: Path) -> None:
    program = """
import sys
from scenec.schemas import kernels
kernels._KNOWN = tuple(sys.argv[1:])
import numpy as np
from scenec.compiler.noise.fractal import fbm2
print(fbm2(7, 3.0, 4, 0.5, 2.0, 0.0).at(np.arange(9.0), np.arange(9.0)).sum().hex())
print(kernels._compilers()[0].__name__)
"""
    bits = []
    for folder, versions in (("known", ["0."]), ("other", []), ("other", [])):
        done = subprocess.run(
            [sys.executable, "-c", program, *versions],
            env={**os.environ, "NUMBA_CACHE_DIR": str(tmp_path / folder)},
            capture_output=True,
            text=True,
            check=True,
        )
        found, compiler = done.stdout.split()
        assert compiler == ("EntryCompiler" if versions else "Compiler")
        bits.append(found)
    assert len(set(bits)) == 1


INTERRUPTED = """
import signal
from pathlib import Path
from scenec.schemas import kernels
kernels.SHIPPED = Path("/dev/null/nowhere")
from numba.core.codegen import CPUCodeLibrary
from scenec.compiler.arithmetic.elementary import exp
asked = CPUCodeLibrary._object_getbuffer_hook.__func__
# A shell starts what runs in its background with interrupts ignored.
signal.signal(signal.SIGINT, signal.default_int_handler)
signals = [signal.SIGINT]
def interrupted(library, module):
    while signals:
        signal.raise_signal(signals.pop())
    return asked(library, module)
CPUCodeLibrary._object_getbuffer_hook = classmethod(interrupted)
for _ in range(2):
    try:
        print(float(exp(1.0)).hex())
    except KeyboardInterrupt:
        print("interrupted")
"""


def test_an_interrupt_while_code_is_fetched_waits_until_it_is_there(tmp_path: Path) -> None:
    e, _ = run(tmp_path).split()
    done = subprocess.run(
        [sys.executable, "-c", INTERRUPTED],
        env={**os.environ, "NUMBA_CACHE_DIR": str(tmp_path)},
        capture_output=True,
        text=True,
        check=True,
    )
    assert done.stdout.split() == ["interrupted", e]
    assert done.stderr == ""


def test_where_nothing_can_be_written_kernels_compile_all_the_same(tmp_path: Path) -> None:
    (tmp_path / "scenec").write_text("not a folder")
    assert run(tmp_path).endswith(" [False]")


@pytest.mark.skipif(os.name == "nt", reason="modes say nothing there")
def test_a_folder_that_others_can_write_is_neither_read_nor_written_and_said_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    folder = tmp_path / "scenec"
    assert Kernel(_twice, inline=False)(1.5) == 3.0
    assert folder.stat().st_mode & 0o777 == 0o700
    (kept,) = folder.iterdir()
    # What is read from here would not be code.
    kept.write_bytes(b"planted")
    folder.chmod(0o777)
    for _ in range(2):
        assert Kernel(_twice, inline=False)(1.5) == 3.0
    assert kept.read_bytes() == b"planted"
    assert capfd.readouterr().err == (
        f"kernels {folder}: others can write to it (chmod go-w takes that away); "
        "they are compiled each time\n"
    )
    folder.chmod(0o700)
    assert Kernel(_twice, inline=False)(1.5) == 3.0
    assert kept.read_bytes() != b"planted"


def test_what_came_with_the_package_is_taken_first(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(kernels, "SHIPPED", tmp_path / "shipped")
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "user"))
    assert Kernel(_twice, inline=False)(1.5) == 3.0
    (tmp_path / "user" / "scenec").rename(tmp_path / "shipped")
    before = {file: file.read_bytes() for file in (tmp_path / "shipped").iterdir()}
    assert Kernel(_twice, inline=False)(1.5) == 3.0
    assert len(before) == 1
    assert not (tmp_path / "user").joinpath("scenec").exists()
    assert {file: file.read_bytes() for file in (tmp_path / "shipped").iterdir()} == before


def test_division_is_numpys_and_nothing_is_contracted() -> None:
    found = made(
        "@kernel\ndef divided(x):\n    return 1.0 / x\n"
        "@kernel\ndef caller(x, y, z):\n    return x * y + z\n"
    )
    assert found["divided"](0.0) == np.inf
    # (1 + e)^2 - (1 + 2 e): a fused multiply-add would leave e^2.
    e = 2.0**-30
    assert found["caller"](1.0 + e, 1.0 + e, -(1.0 + 2.0 * e)) == 0.0


PARTS = """
@kernel
def root(x, exponent):
    if x < 0.0:
        raise ValueError("below 0")
    return np.floor(x) ** exponent

@kernel
def sums(x):
    return root(x, 2) + root(x, 3)
"""


def test_what_calls_name_as_constants_makes_no_code_of_its_own() -> None:
    found = made(PARTS)
    assert found["sums"](2.5) == 12.0
    assert len(found["root"]._called.signatures) == 1


def test_what_is_part_of_others_can_be_called_by_itself_before_and_after() -> None:
    for order in (("root", "sums"), ("sums", "root")):
        found = made(PARTS)
        values = {name: found[name](*([2.5, 3] if name == "root" else [2.5])) for name in order}
        assert values == {"root": 8.0, "sums": 12.0}


def test_errors_of_what_is_part_of_others_reach_the_caller() -> None:
    for _ in ("compiled", "kept"):
        with pytest.raises(ValueError, match="below 0"):
            made(PARTS)["sums"](-1.0)


def test_a_kept_kernel_imports_nothing_that_its_parts_were_compiled_from(tmp_path: Path) -> None:
    # The extent of positions is numba's ``array.max``: of a module that imports SciPy's algebra.
    program = """
import sys
import numpy as np
from scenec.compiler.noise.fractal import fbm2
print(fbm2(7, 3.0, 4, 0.5, 2.0, 0.0).at(np.arange(9.0), np.arange(9.0)).sum().hex())
print(*{"numba.np.arraymath", "scipy.linalg"} & {*sys.modules})
"""
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path)}
    compiled, loaded = (
        subprocess.run(
            [sys.executable, "-c", program], env=environment, capture_output=True, check=True
        ).stdout.split()
        for _ in range(2)
    )
    assert len(compiled) == 3
    assert loaded == compiled[:1]


OWNERS = """
from typing import NamedTuple

class Pair(NamedTuple):
    a: object
    b: object

@kernel
def inner(pair, n):
    row = pair.a[n]
    total = 0.0
    for i in range(row.size):
        total += row[i] * pair.b[i]
    return total

@kernel
def borrows(pair):
    total = 0.0
    for n in range(pair.a.shape[0]):
        total += inner(Pair(pair.a, pair.b), n)
    return total

@kernel
def view(a, n):
    return a[n, 1:]

@kernel
def viewed(a):
    return view(a, 1)

@kernel
def owns(a, chosen):
    copy = a[0][chosen]
    made = np.zeros(copy.size)
    for i in range(copy.size):
        made[i] = 2.0 * copy[i]
    return made

@kernel
def fused(a):
    return (2.0 * a + 1.0) * a
"""


def test_arrays_live_as_long_as_any_name_of_them_and_no_longer() -> None:
    found = made(OWNERS)
    a, b = np.arange(6.0).reshape(2, 3), np.array([1.0, 10.0, 100.0])
    chosen = np.array([2, 0])
    before = [sys.getrefcount(each) for each in (a, b, chosen)]
    for _ in range(3):
        assert found["borrows"](found["Pair"](a, b)) == 210.0 + 543.0
        assert found["owns"](a, chosen).tolist() == [4.0, 0.0]
        assert found["fused"](b).tolist() == [3.0, 210.0, 20100.0]
        assert found["viewed"](a).tolist() == [4.0, 5.0]
    assert [sys.getrefcount(each) for each in (a, b, chosen)] == before
    kept = found["viewed"](np.arange(6.0).reshape(2, 3))
    # What it shows is not given to others.
    others = [np.full((2, 3), -1.0) for _ in range(100)]
    assert kept.tolist() == [4.0, 5.0]
    assert len(others) == 100


def test_a_kernel_whose_parts_are_called_by_a_function_of_numba_is_whole() -> None:
    import numba

    found = made(OWNERS)
    borrows = found["borrows"]

    @numba.njit  # type: ignore[untyped-decorator]
    def foreign(pair: Any) -> Any:
        return borrows(pair)

    pair = found["Pair"](np.ones((2, 3)), np.ones(3))
    assert foreign(pair) == 6.0


def test_an_array_put_into_another_is_copied_where_they_overlap() -> None:
    # That copy has an owner, though the kernel makes no array of its own.
    text = """
@kernel
def shifted(x, by):
    x[by:] = x[: x.shape[0] - by]
    x[0] = -1.0
"""
    values = np.arange(6.0)
    made(text)["shifted"](values, 2)
    assert values.tolist() == [-1.0, 1.0, 0.0, 1.0, 2.0, 3.0]
