"""Paths of any letters: they work, or are refused in one line with exit status 2."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from scenec.backends.run.render import render
from scenec.cli.main import main
from scenec.compiler.compile import compile_cfg
from scenec.datasets.export import export
from scenec.schemas.files import sha256
from scenec.schemas.units import LocalExecutor
from scenec.testing.processes import output_of
from scenec.testing.small import small_cfg, write_cfg

COMMANDS = ("run", "compile", "settle", "import", "render", "scan", "check", "sheet", "view",
            "export", "converge", "explain", "doctor")  # fmt: skip
pytestmark = pytest.mark.usefixtures("workers_here")
NOT_UTF8 = os.fsdecode(b"a\xff")
#: Locales without UTF-8, as an old container has them.
C_LOCALE = {"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"}
ODD = ["50% #1?[2]", 'it\'s "q"', "file:", "a@b", " lead", "höhle", "-o", "~"]


@pytest.fixture(scope="module")
def cfg(tmp_path_factory):
    made = small_cfg(samples=1, outputs=["depth", "instance"])
    made["terrain"]["spacing_m"] = 1.0
    made["objects"]["rocks"]["count"] = 10
    return write_cfg(tmp_path_factory.mktemp("cfg"), made)


def scenec(*words: str, folder: Path, **environment: str) -> subprocess.CompletedProcess[bytes]:
    return subprocess.run(
        [sys.executable, "-m", "scenec.cli.main", *words],
        cwd=folder,
        env={**os.environ, **environment},
        capture_output=True,
        check=False,
    )


@pytest.mark.parametrize("command", COMMANDS)
@pytest.mark.parametrize("letter", ["\n", "\t", "\x1b", "\x7f", "\udcff"])
def test_a_path_with_letters_that_none_may_have_is_refused_in_one_line(
    command, letter, tmp_path, monkeypatch, capsys
):
    monkeypatch.chdir(tmp_path)
    said = f"{f'a{letter}'!r}: holds the control character {letter!r}, which USD's paths cannot"
    if f"a{letter}" == NOT_UTF8:
        said = "a\\xff: is not UTF-8, as names of files must be here"
    assert output_of(capsys, [command, f"a{letter}"], 2).err == f"scenec: {said}\n"
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("environment", [{}, C_LOCALE])
def test_an_output_that_is_not_utf8_is_refused_in_any_locale(cfg, tmp_path, environment):
    done = scenec(
        "compile", str(cfg), "--seed", "1", "-o", NOT_UTF8, folder=tmp_path, **environment
    )
    assert (done.returncode, done.stdout) == (2, b"")
    assert done.stderr == b"scenec: a\\xff: is not UTF-8, as names of files must be here\n"
    assert list(tmp_path.iterdir()) == []


def test_letters_beyond_ascii_work_where_the_locale_has_none(cfg, tmp_path):
    done = scenec("compile", str(cfg), "--seed", "1", "-o", "höhle", folder=tmp_path, **C_LOCALE)
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "höhle/batch_0000/stage.usda").is_file()
    done = scenec(
        "render", "höhle", "--backend", "reference", "--json", folder=tmp_path, **C_LOCALE
    )
    assert done.returncode == 0, done.stderr
    told = json.loads(done.stdout)
    assert "höhle" in json.dumps(told, ensure_ascii=False)
    # And where output has none, whatever the locale.
    words = "view", "höhle", "--json"
    done = scenec(*words, folder=tmp_path, PYTHONIOENCODING="ascii")
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["page"] == "höhle/view.html"
    for command in COMMANDS:
        done = scenec(command, "--help", folder=tmp_path, PYTHONIOENCODING="ascii")
        assert (done.returncode, done.stderr) == (0, b"")


@pytest.fixture(scope="module")
def called(cfg, tmp_path_factory):
    """Digests of what Python calls make in a folder with a plain name."""
    out = compile_cfg(cfg, seed=1, out=tmp_path_factory.mktemp("called") / "out").out
    render(out, "reference", executor=LocalExecutor())
    export(out, "coco", out / "set")
    return digests(out)


def digests(out: Path) -> dict[str, str]:
    """Of every file but those that say how long it took: timings, and sidecars of frames."""
    return {
        path.relative_to(out).as_posix(): sha256(path)
        for path in sorted(out.rglob("*"))
        if path.is_file() and path.name not in ("timings.json", "000000.json", "view.html")
    }


@pytest.mark.parametrize("name", ODD)
def test_odd_names_of_folders_work_and_commands_make_the_bytes_of_calls(
    cfg, called, tmp_path, monkeypatch, capsys, name
):
    monkeypatch.chdir(tmp_path)
    out = f"./{name}" if name.startswith("-") else name
    assert main(["compile", str(cfg), "--seed", "1", "-o", out]) == 0
    assert main(["render", out, "--backend", "reference"]) == 0
    assert main(["check", out]) == 0
    assert main(["export", out, "--format", "coco", "-o", f"{out}/set"]) == 0
    assert main(["view", out]) == 0
    assert (tmp_path / name / "view.html").is_file()
    assert "Traceback" not in capsys.readouterr().err
    assert digests(tmp_path / name) == called


#: Runs commands one after another in one process.
_COMMANDS = """
import json, sys
from scenec.cli.main import main
from scenec.testing.processes import output_of
raise SystemExit(any(main(words) for words in json.loads(sys.argv[1])))
"""


def test_commands_make_the_bytes_of_calls_in_another_locale_and_zone_with_one_thread(
    cfg, called, tmp_path
):
    elsewhere = {"LC_ALL": "tr_TR.UTF-8", "TZ": "Asia/Kathmandu", "PYTHONHASHSEED": "4711"}
    threads = ("NUMBA_NUM_THREADS", "OMP_NUM_THREADS", "PXR_WORK_THREAD_LIMIT")
    words = [
        ["compile", str(cfg), "--seed", "1", "-o", "out"],
        ["render", "out", "--backend", "reference"],
        ["export", "out", "--format", "coco", "-o", "out/set"],
    ]
    subprocess.run(
        [sys.executable, "-c", _COMMANDS, json.dumps(words)],
        cwd=tmp_path,
        env=os.environ | elsewhere | dict.fromkeys(threads, "1"),
        check=True,
        capture_output=True,
    )
    assert digests(tmp_path / "out") == called


def test_a_name_that_is_too_long_is_refused_in_one_line(cfg, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    for out in ("x" * 300, "/".join(["d" * 50] * 100)):
        said = output_of(capsys, ["compile", str(cfg), "--seed", "1", "-o", out], 2).err
        assert said.endswith("File name too long\n")
        assert said.count("\n") == 1
    assert list(tmp_path.iterdir()) == []
