"""An option that is given twice adds up, where it is a list, or is refused."""

from __future__ import annotations

import argparse

import pytest

from scenec.cli.main import parser

#: What each takes, where it takes no number.
WORDS = {
    "--cameras": "a", "--backends": "a", "--lidars": "a", "--passes": "depth", "--objects": "a",
    "--among": "a", "--only": "lod", "--classes": "a", "--bins": "size=1,2", "--set": "a.b=1",
    "--remap": "a", "--split": "a=1",
}  # fmt: skip


def commands() -> dict[str, argparse.ArgumentParser]:
    top = parser()
    (found,) = (a for a in top._actions if isinstance(a, argparse._SubParsersAction))
    return dict(found.choices)


def option_actions(command: argparse.ArgumentParser) -> list[argparse.Action]:
    return [a for a in command._actions if a.option_strings and a.nargs is None]


def value(action: argparse.Action, second: bool = False) -> str:
    name = action.option_strings[-1]
    if action.choices:
        return str(list(action.choices)[-1 if second else 0])
    if name == "--backend" or action.type is None:
        return WORDS.get(name, "a")
    if name in WORDS:
        return WORDS[name]
    for text in ("cameras", "2", "a"):
        try:
            action.type(text)
        except (argparse.ArgumentTypeError, ValueError):
            continue
        return text
    raise AssertionError(name)


CASES = [
    pytest.param(name, action, id=f"{name} {action.option_strings[-1]}")
    for name, command in commands().items()
    for action in option_actions(command)
]


@pytest.mark.parametrize(("name", "action"), CASES)
def test_no_option_takes_its_last_value_without_a_word(name, action, capsys):
    command = commands()[name]
    needed = [word for a in command._actions if not a.option_strings and a.nargs is None
              for word in [str(next(iter(a.choices or ["x"])))]]  # fmt: skip
    option = action.option_strings[-1]
    for a in command._actions:
        if a.required and a.option_strings and a.option_strings != action.option_strings:
            needed += [a.option_strings[-1], value(a)]
    words = [option, value(action), option, value(action, True)]
    try:
        twice = vars(command.parse_args([*needed, *words]))[action.dest]
    except SystemExit:
        twice = None
    said = capsys.readouterr().err
    once = vars(command.parse_args([*needed, *words[:2]]))[action.dest]
    if isinstance(once, list | tuple) and option not in ("--set", "--bins"):
        assert set(once) <= set(twice)
    else:
        assert twice is None
        assert "twice: expected one value" in said


def test_lists_add_up_in_their_own_order():
    read = parser().parse_args
    assert read(["render", "o", "--passes", "rgb", "--passes", "depth,rgb"]).passes == (
        "rgb", "depth",
    )  # fmt: skip
    assert read(["converge", "o", "--spp", "64,16", "--spp", "4"]).spp == (4, 16, 64)
    assert read(["check", "o", "--backends", "a", "--backends", "b"]).backends == ["a", "b"]
    assert read(["compile", "c", "-o", "x", "--set", "a=1", "--set", "b=1"]).settings == [
        "a=1", "b=1",
    ]  # fmt: skip
    # Each command line is read for itself.
    assert read(["check", "o", "--backends", "c"]).backends == ["c"]


@pytest.mark.parametrize(
    "words",
    [
        ["compile", "c", "-o", "x", "--keep", "all", "--keep", "seen"],
        ["compile", "c", "-o", "x", "--set", "a.b=1", "--set", "a.b=2"],
        ["export", "o", "--format", "coco", "--format", "tum"],
        ["export", "o", "--format", "coco", "--set", "a=1", "--set", "a=2"],
        ["evaluate", "p", "--against", "t", "--bins", "size=1,2", "--bins", "size=1,3"],
        ["render", "o", "--samples", "0:1", "--samples", "2:3"],
    ],
)
def test_a_second_value_is_refused(words, capsys):
    with pytest.raises(SystemExit) as left:
        parser().parse_args(words)
    assert left.value.code == 2
    assert "twice: expected one value" in capsys.readouterr().err
