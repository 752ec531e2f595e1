"""Arguments of commands, out of the records of ``scenec.api.options``."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from typing import Any

from scenec.api import forms
from scenec.api.declare import CallOptions, declared, flag_of
from scenec.api.options import (
    CompileOptions,
    PictureOptions,
    RenderOptions,
    StageOptions,
)
from scenec.schemas.errors import ScenecError


def read_by[T](form: Callable[[str], T]) -> Callable[[str], T]:
    """Returns an argparse type from a form, whose faults argparse reports."""

    def read(text: str) -> T:
        try:
            return form(text)
        except ScenecError as error:
            raise argparse.ArgumentTypeError(str(error)) from error

    return read


seed, positive, counted = map(read_by, (forms.seed, forms.positive, forms.counted))
span, amount, passes = read_by(forms.span), read_by(forms.amount), read_by(forms.passes)
names, positions, listed = forms.names, forms.positions, forms.listed


def add(parser: argparse._ActionsContainer, record: type[CallOptions], *only: str) -> None:
    """Adds options that a record declares.

    Args:
        parser: Of the command.
        record: The record.
        only: Names of its options, in this order; none: all that its own class declares.
    """
    there = declared(record, own=not only)
    for name in only or there:
        facts: dict[str, Any] = dict(there[name].metadata)
        help_ = facts.pop("help")
        flag = flag_of(name, there[name])
        facts.pop("flag", None)
        form, many, default = facts.pop("form", None), facts.pop("many", False), there[name].default
        if facts.pop("const", False) or (default is False and "metavar" not in facts):
            parser.add_argument(flag, dest=name, action="store_true", default=default, help=help_)
            continue
        if many:
            facts["action"] = "append"
        if form is not None:
            facts["type"] = read_by(form)
        parser.add_argument(
            flag, dest=name, default=[] if default == () else default, help=help_, **facts
        )


def given[T: CallOptions](record: type[T], options: argparse.Namespace, **further: Any) -> T:
    """The record of what a command line gives.

    Args:
        record: Its class.
        options: Of the command line.
        further: Fields that are no options.
    """
    return record(**{**chosen(record, options), **further})


def chosen(record: type[CallOptions], options: argparse.Namespace) -> dict[str, Any]:
    """The fields of a record that a command line gives, by name."""
    there = record.__dataclass_fields__
    return {name: value for name, value in vars(options).items() if name in there}


def add_cfg(parser: argparse.ArgumentParser, *only: str) -> None:
    """Adds the cfg, and what of ``CompileOptions`` is said of it."""
    parser.add_argument(
        "cfg", metavar="CFG", help="a file of JSON or YAML, or package:configs/NAME of ours"
    )
    for name in only:
        add(parser, CompileOptions, name)


def add_render_options(
    parser: argparse.ArgumentParser, kind: type[PictureOptions] = RenderOptions
) -> None:
    """Adds the options that ``run``, ``render`` and ``sweep`` share, with workers as one has."""
    parser.epilog = (
        "A camera that the renderer cannot draw costs its own frames and no other's. Exit status: "
        "0 all frames are there; 1 some were given up or refused, and said; 2 it cannot be done."
    )
    own = list(declared(PictureOptions, own=True))
    last = own.index("timeout")
    add(parser, PictureOptions, *own[:last])
    add(parser, kind, "workers", "cluster")
    add(parser, PictureOptions, *own[last:])


def add_keep(parser: argparse.ArgumentParser) -> None:
    """Adds options of pruning; values as in ``scenec.compiler.views.needed``."""
    group = parser.add_mutually_exclusive_group()
    add(group, StageOptions, "keep")
    group.add_argument(
        "--no-prune", dest="keep", action="store_const", const="unpruned", help="--keep unpruned"
    )


def add_cache(parser: argparse.ArgumentParser) -> None:
    """Adds options of the cache of earlier compilations' steps."""
    group = parser.add_mutually_exclusive_group()
    add(group, StageOptions, "cache")
    group.add_argument(
        "--no-cache",
        dest="cache",
        action="store_const",
        const=False,
        help="make all anew, and keep nothing",
    )


def add_verbose(parser: argparse.ArgumentParser, default: Any = argparse.SUPPRESS) -> None:
    """Adds the option of verbosity: before the command, and after it, where nothing is its default.

    A command's own default would be put over what was said before it.
    """
    parser.add_argument(
        "-v", "--verbose", action="store_true", default=default, help="say what took how long, too"
    )


def add_json(parser: argparse.ArgumentParser) -> None:
    """Machine-readable output."""
    parser.add_argument(
        "--json", action="store_true", help="print the result as JSON on standard output"
    )
