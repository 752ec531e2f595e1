"""Completion of the command line by the shell, through argcomplete.

Each press of the key starts this process, so nothing heavy may be imported here.
"""

from __future__ import annotations

import argparse
import os
from collections.abc import Callable, Iterable, Iterator
from importlib.metadata import entry_points

from scenec.schemas.passes import pass_names

#: Names of renderers, as in ``scenec.backends.registry``, which would cost the import of NumPy; a
#: test compares them.
BACKENDS = ("auto", "mitsuba", "cycles", "pyrender")
_BACKENDS_GROUP = "scenec.backends"

type Completer = Callable[..., Iterable[str]]


def complete(parser: argparse.ArgumentParser) -> None:
    """Answers the shell and ends the process, if it is the shell that asks."""
    if "_ARGCOMPLETE" not in os.environ:
        return
    import argcomplete

    for action in _actions(parser):
        for name in (*action.option_strings, action.dest):
            if completer := COMPLETERS.get(name):
                # Where argcomplete looks for it.
                action.completer = completer  # type: ignore[attr-defined]
    argcomplete.autocomplete(parser)


def _actions(parser: argparse.ArgumentParser) -> Iterator[argparse.Action]:
    for action in parser._actions:
        yield action
        if isinstance(action, argparse._SubParsersAction):
            for command in action.choices.values():
                yield from _actions(command)


def _backends(**_: object) -> list[str]:
    return [*BACKENDS, *(entry.name for entry in entry_points(group=_BACKENDS_GROUP))]


def _formats(**_: object) -> list[str]:
    from scenec.datasets.formats.registry import format_names
    from scenec.datasets.maps import MAP
    from scenec.datasets.models import MODEL_FORMATS
    from scenec.datasets.tracks import TAPVID

    return sorted([*format_names(), MAP, TAPVID, *MODEL_FORMATS])


def _passes(**_: object) -> Iterable[str]:
    return pass_names()


def _listed(names: Completer) -> Completer:
    """Completes the last name of a list divided by commas; earlier ones are not offered again."""

    def completer(prefix: str, **_: object) -> list[str]:
        head, comma, _last = prefix.rpartition(",")
        given = head.split(",")
        return [head + comma + name for name in names() if name not in given]

    return completer


def _cfgs(prefix: str, **_: object) -> Iterable[str]:
    from argcomplete.completers import FilesCompleter

    names: Iterable[str] = FilesCompleter(("json",))(prefix)
    return names


#: Option, or name of a positional argument, to what completes it; paths are the shell's own.
COMPLETERS: dict[str, Completer] = {
    "cfg": _cfgs,
    "--backend": _listed(_backends),
    "--backends": _listed(_backends),
    "--format": _formats,
    "--passes": _listed(_passes),
}
