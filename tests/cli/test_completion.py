"""The shell's completion knows commands, options and their values, and starts nothing heavy."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from scenec.backends.registry import AUTO, BUILT_IN, GROUP
from scenec.cli import completion
from scenec.cli.main import parser
from scenec.testing.processes import python

PROGRAM = """
import os, sys
end = os._exit
def ended(status):
    print("LOADED", *sorted({name.partition(".")[0] for name in sys.modules}), flush=True)
    end(status)
os._exit = ended
sys.argv = ["scenec"]
from scenec.cli.main import main
main()
"""
HEAVY = {"numpy", "numba", "scipy", "pxr", "PIL", "OpenEXR", "jsonschema", "mitsuba", "bpy"}


def offered(line: str, folder: Path) -> tuple[set[str], set[str]]:
    """What the shell is offered for the last word of a line, and the packages this loaded."""
    answer = folder / "answer"
    environment = {
        **os.environ,
        "_ARGCOMPLETE": "1",
        "_ARGCOMPLETE_IFS": "\n",
        "_ARGCOMPLETE_SUPPRESS_SPACE": "1",
        "_ARGCOMPLETE_STDOUT_FILENAME": str(answer),
        # Words are not divided at commas, nor at = and :, as bash-completion has it.
        "_ARGCOMPLETE_COMP_WORDBREAKS": " \t\n",
        "COMP_LINE": line,
        "COMP_POINT": str(len(line.encode())),
        "COMP_TYPE": "9",
    }
    done = python("-c", PROGRAM, env=environment, cwd=folder)
    loaded = next(text for text in done.stdout.splitlines() if text.startswith("LOADED"))
    return {word.strip() for word in answer.read_text().split("\n")}, set(loaded.split()[1:])


@pytest.mark.parametrize(
    ("line", "expected"),
    [
        ("scenec comp", {"compile"}),
        ("scenec render out --den", {"--denoise"}),
        ("scenec render out --backend mi", {"mitsuba"}),
        ("scenec check out --backends mitsuba,py", {"mitsuba,pyrender"}),
        ("scenec render out --passes rgb,dep", {"rgb,depth", "rgb,depth_measured"}),
        ("scenec export out --format k", {"kitti"}),
        ("scenec compile c", {"cfg.json", "configs/"}),
    ],
)
def test_words_are_completed_without_a_heavy_package(tmp_path, line, expected):
    (tmp_path / "cfg.json").touch()
    (tmp_path / "cover.png").touch()
    (tmp_path / "configs").mkdir()
    words, loaded = offered(line, tmp_path)
    assert words == expected
    assert "argcomplete" in loaded
    assert loaded.isdisjoint(HEAVY)


def test_renderers_offered_are_those_there_are():
    assert set(completion.BACKENDS) == {AUTO, *BUILT_IN}
    assert completion._BACKENDS_GROUP == GROUP


def test_each_completer_belongs_to_an_argument():
    names = {
        name
        for action in completion._actions(parser())
        for name in (*action.option_strings, action.dest)
    }
    assert completion.COMPLETERS.keys() <= names
