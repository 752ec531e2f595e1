# PYTHON_ARGCOMPLETE_OK
"""The ``scenec`` command. Heavy packages are imported by the commands that need them."""

from __future__ import annotations

import argparse
import errno
import gc
import importlib
import io
import math
import os
import re
import resource
import sys
import time
from collections.abc import Sequence
from typing import Any, NoReturn

from scenec.api import forms
from scenec.api.make import SettleOptions
from scenec.api.measure import ConvergeOptions
from scenec.api.options import (
    CheckOptions,
    CompileOptions,
    PreviewOptions,
    RenderOptions,
    ScanOptions,
)
from scenec.cli import interrupt
from scenec.cli.arguments import (
    add,
    add_cache,
    add_cfg,
    add_json,
    add_keep,
    add_render_options,
    add_verbose,
    positive,
    read_by,
)
from scenec.cli.completion import complete
from scenec.cli.evaluate_arguments import add_evaluate_options
from scenec.cli.explain_arguments import add_explain_options
from scenec.cli.export_arguments import add_export_options
from scenec.cli.import_arguments import add_import_options
from scenec.cli.output import clear_bar, tell
from scenec.cli.supervise import supervised
from scenec.cli.sweep_arguments import add_sweep_options
from scenec.cli.view_arguments import add_view_options
from scenec.schemas import notice
from scenec.schemas.errors import CfgError, ScenecError
from scenec.schemas.plugins import blaming
from scenec.schemas.spelling import closest
from scenec.schemas.versions import version_of

EXIT_FAILED = 1
EXIT_BAD_INPUT = 2
EXIT_INTERRUPTED = 130
#: Where the options that were given are noted while they are read.
_GIVEN = "_given"
#: Files that a command opens at a time, at least: below that, even imports fail, some silently.
_LEAST_FILES = 32


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs one command.

    Args:
        arguments: Words of the command line; None takes the process's own.

    Returns:
        Exit status: 0 done, 1 a check failed, 2 bad input (said in one clear message), 130 Ctrl-C.
    """
    if arguments is None:
        _speak_utf8()
        complete(parser())
    for word in sys.argv[1:] if arguments is None else arguments:
        fault = _fault_of(word)
        if fault:
            print(f"scenec: {fault}", file=sys.stderr)
            return EXIT_BAD_INPUT
    options = parser().parse_args(arguments)
    if (most := _most_files()) < _LEAST_FILES:
        print(
            f"scenec: this process may open {most} files at a time; expected {_LEAST_FILES} or "
            f"more (ulimit -n {_LEAST_FILES})",
            file=sys.stderr,
        )
        return EXIT_BAD_INPUT
    if arguments is None and (ended := supervised(EXIT_BAD_INPUT)) is not None:
        return ended
    interrupt.watch()
    notice.listen(tell)
    started = time.perf_counter()
    try:
        command = importlib.import_module(f"scenec.cli.{options.module}")
        with blaming():
            status: int = command.run(options)
        sys.stdout.flush()
        if options.verbose:
            _tell_spent(time.perf_counter() - started)
        if arguments is None:
            # The interpreter's end would look at every object for cycles, twice: 0.3 CPU s.
            gc.freeze()
    except ScenecError as error:
        text = str(error)
        clear_bar()
        if interrupt.happened():
            # Amid a step that was left: what it lacks is no fault of the user's.
            print("scenec: interrupted", file=sys.stderr)
            return EXIT_INTERRUPTED
        print(text if isinstance(error, CfgError) else f"scenec: {text}", file=sys.stderr)
        return EXIT_BAD_INPUT
    except MemoryError as error:
        print(f"scenec: not enough memory: {error}; ask for less", file=sys.stderr)
        return EXIT_BAD_INPUT
    except KeyboardInterrupt:
        print("scenec: interrupted", file=sys.stderr)
        return EXIT_INTERRUPTED
    except BrokenPipeError:
        # The reader of our output has gone (| head): nothing is wrong, and nobody listens.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return EXIT_FAILED
    except OSError as error:
        # What no module foresaw of the file system: names too long, a disk that went away.
        where = f"{error.filename}: " if error.filename else ""
        text = f"{where}{error.strerror or error}"
        if error.errno == errno.EMFILE:
            text += f" (this process may open {_most_files()})"
        print(f"scenec: {text}", file=sys.stderr)
        return EXIT_BAD_INPUT
    except Exception:
        # Compiled code turns an interrupt inside of its callbacks into errors of its own.
        if not interrupt.happened():
            raise
        print("scenec: interrupted", file=sys.stderr)
        return EXIT_INTERRUPTED
    return status


def _tell_spent(seconds: float) -> None:
    """Says what the command took: of time, of processors, and of memory."""
    own, others = map(resource.getrusage, (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    busy = sum(used.ru_utime + used.ru_stime for used in (own, others))
    most = max(own.ru_maxrss, others.ru_maxrss) / 2**20
    tell(f"{seconds:.2f} s, {busy:.2f} CPU s, {most:.2f} GiB at most in one process")


def _most_files() -> float:
    most = resource.getrlimit(resource.RLIMIT_NOFILE)[0]
    return math.inf if most == resource.RLIM_INFINITY else most


def _speak_utf8() -> None:
    """Begins again in UTF-8 mode where the locale has another encoding: USD's paths are UTF-8.

    What standard output cannot show, as where PYTHONIOENCODING says so, is escaped.
    """
    if sys.getfilesystemencoding() != "utf-8":
        # The mode is the environment's: processes that this one starts have it, too.
        environment = {**os.environ, "PYTHONUTF8": "1"}
        os.execve(sys.executable, [sys.executable, *sys.orig_argv[1:]], environment)  # noqa: S606 (itself)
    if isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout.reconfigure(errors="backslashreplace")


def _fault_of(word: str) -> str:
    """Why a word cannot be a path of USD's, nor anything else here; "" where it can."""
    try:
        word.encode("utf-8")
    except UnicodeEncodeError:
        shown = os.fsencode(word).decode("utf-8", "backslashreplace")
        return f"{shown}: is not UTF-8, as names of files must be here"
    control = next((letter for letter in word if ord(letter) < 32 or letter == "\x7f"), "")
    if control:
        return f"{word!r}: holds the control character {control!r}, which USD's paths cannot"
    return ""


def parser() -> argparse.ArgumentParser:
    """The parser of all commands."""
    top = _Parser(
        prog="scenec",
        description="A deterministic procedural scene compiler: a cfg and a seed become USD "
        "stages, and renderers turn those into pictures with exact annotation.",
        epilog="'scenec COMMAND --help' tells more. Documentation: docs/ and README.md.",
    )
    top.add_argument("--version", action=_Version, help="print the version and leave")
    add_verbose(top, default=False)
    commands = top.add_subparsers(metavar="COMMAND", required=True)

    run = _command(commands, "run", "compile a cfg and render it: the main job")
    add_cfg(run, "settings", "seed")
    run.add_argument("-o", "--out", metavar="OUT", required=True, help="output folder")
    add_render_options(run)
    add_keep(run)
    add_cache(run)
    add(run, CompileOptions, "replace", "faults", "batches")
    add_json(run)

    compile_ = _command(commands, "compile", "compile a cfg into USD stages, one per batch")
    add_cfg(compile_, "settings", "seed")
    compile_.add_argument("-o", "--out", metavar="OUT", required=True, help="output folder")
    add_keep(compile_)
    add_cache(compile_)
    add(compile_, CompileOptions, "replace", "faults", "batches", "workers", "cluster")
    compile_.epilog = "Example: scenec compile cfg.json --set terrain.spacing_m=0.2 --seed 3 -o OUT"
    add_json(compile_)

    validate = _command(commands, "validate", "is a cfg without faults; compiles nothing")
    validate.epilog = "Example: scenec validate cfg.yaml --set light.sun.elevation_deg=10"
    add_cfg(validate, "settings")
    add_json(validate)

    preview = _command(commands, "preview", "show what a cfg makes in the browser, as it is edited")
    add_cfg(preview, "settings", "seed")
    add(preview, PreviewOptions)
    preview.add_argument(
        "--port",
        type=read_by(forms.port),
        default=0,
        metavar="N",
        help="of the page (default: a free one)",
    )
    preview.add_argument("--no-browser", action="store_true", help="only print the address")
    preview.add_argument("--once", metavar="HTML", help="write the page to a file, and end")
    add_cache(preview)

    init = _command(commands, "init", "write a small cfg to begin with")
    init.epilog = "Without TEMPLATE it lists them. Example: scenec init mars -o mine.jsonc"
    init.add_argument("template", metavar="TEMPLATE", nargs="?", help="forest, mars, moon …")
    init.add_argument(
        "-o", "--output", metavar="FILE", help="- for standard output (default: TEMPLATE.jsonc)"
    )
    add_json(init)

    add_import_options(
        _command(commands, "import", "a scene of another program, as a cfg: OAISYS, USD")
    )

    schema = _command(commands, "schema", "the cfg's JSON Schema in one piece, for editors")
    schema.epilog = "Example: scenec schema -o scenec.schema.json (docs/writing.md)"
    schema.add_argument("-o", "--output", metavar="FILE", help="default: standard output")
    schema.add_argument(
        "--partial", action="store_true", help="for cfgs that extend others: no key is required"
    )

    add_sweep_options(_command(commands, "sweep", "run a cfg with many values and seeds"))

    settle = _command(commands, "settle", "drop chosen objects by physics, into a table of poses")
    add_cfg(settle, "settings", "seed")
    settle.add_argument("-o", "--out", metavar="CSV", required=True, help="table of poses")
    add(settle, SettleOptions)
    add_json(settle)

    render = _command(commands, "render", "render what was compiled, or any USD stage")
    render.add_argument("out", metavar="OUT", help="output folder of compile, or a USD file")
    add_render_options(render)
    add(render, RenderOptions, "replace", "allow_missing", "batches")
    add_json(render)

    scan = _command(commands, "scan", "scan with the lidars of an output; needs no renderer")
    scan.add_argument("out", metavar="OUT", help="output folder of compile, or a USD file")
    works = ("workers", "cluster", "allow_missing", "batches")
    add(scan, ScanOptions, "samples", "lidars", "ply", "pcd", "las", *works)
    add_json(scan)

    check = _command(commands, "check", "is the output sound, and do backends agree on it")
    check.add_argument(
        "out", metavar="OUT", help="output folder of compile, a USD file, or a dataset of export"
    )
    add(check, CheckOptions)
    add_json(check)

    sheet = _command(commands, "sheet", "one picture of all passes of some frames")
    sheet.add_argument("out", metavar="OUT", help="output folder with frames")
    sheet.add_argument("--backend", help="whose frames; default: the first there is")
    sheet.add_argument(
        "--frames", type=positive, default=4, metavar="N", help="how many (default 4)"
    )
    sheet.add_argument("-o", "--output", metavar="PNG", help="default: OUT/contact_sheet.png")
    sheet.add_argument(
        "--terminal",
        nargs="?",
        const="auto",
        choices=("auto", "kitty", "iterm2", "blocks", "none"),
        help="show it in the terminal, too: by its graphics protocol or as colored half blocks "
        "(default: where the terminal is known to show pictures)",
    )

    add_view_options(
        _command(commands, "view", "one page to look at all frames, in any browser, offline")
    )

    add_export_options(
        _command(commands, "export", "frames to a dataset: COCO, HDF5, TUM, KITTI, BOP, ...")
    )

    add_evaluate_options(
        _command(commands, "evaluate", "how good predictions are: AP, IoU, depth, tracks")
    )

    converge = _command(commands, "converge", "error against run time, for each renderer")
    converge.add_argument("out", metavar="OUT", help="output folder of compile, or a USD file")
    add(converge, ConvergeOptions)
    add_json(converge)

    add_explain_options(
        _command(commands, "explain", "what each pass cost and erred, what was left out, and why")
    )

    assets = _command(commands, "assets", "models and cameras that come with scenec, for a cfg")
    assets.add_argument("name", nargs="?", metavar="NAME", help="one of them; left out, all models")
    assets.add_argument(
        "--cameras", action="store_true", help="list the presets of cameras instead"
    )
    add_json(assets)

    doctor = _command(commands, "doctor", "which backends work here, and what to install if not")
    add_json(doctor)
    return top


def _command(
    commands: argparse._SubParsersAction[_Parser], name: str, text: str
) -> argparse.ArgumentParser:
    command: argparse.ArgumentParser = commands.add_parser(
        name, help=text, description=f"{text[0].upper()}{text[1:]}."
    )
    command.set_defaults(module=f"{name}_command")
    add_verbose(command)
    return command


class _Parser(argparse.ArgumentParser):
    """Names the nearest command, value or option to one that there is not."""

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        for name in (None, "store"):
            self.register("action", name, _Once)
        self.register("action", "append", _Each)

    def parse_known_args(  # type: ignore[override]
        self, args: Sequence[str] | None = None, namespace: argparse.Namespace | None = None
    ) -> tuple[argparse.Namespace, list[str]]:
        """Parses as the base class does."""
        found, rest = super().parse_known_args(args, namespace)
        vars(found).pop(_GIVEN, None)
        return found, rest

    def error(self, message: str) -> NoReturn:
        """Reports an error as the base class does, with a suggestion after it."""
        if choice := re.search(r"invalid choice: '(.*?)' \(choose from (.*)\)", message):
            near = closest(choice[1], re.findall(r"[\w.-]+", choice[2]))
        elif option := re.search(r"unrecognized arguments: (-[^\s=]+)", message):
            known = self._options()
            if option[1] in known:
                message = f"{message}, of other commands: {', '.join(self._with(option[1]))}"
            near = None if option[1] in known else closest(option[1], known)
        else:
            near = None
        super().error(message if near is None else f"{message}; did you mean {near}?")

    def _with(self, option: str) -> list[str]:
        """Returns the commands that have an option."""
        parts = (a for a in self._actions if isinstance(a, argparse._SubParsersAction))
        return [n for part in parts for n, of in part.choices.items() if option in of._options()]

    def _options(self) -> set[str]:
        """Returns the options of this parser and of its commands."""
        found = {option for action in self._actions for option in action.option_strings}
        for action in self._actions:
            if isinstance(action, argparse._SubParsersAction):
                found.update(*(of._options() for of in action.choices.values()))
        return found


class _Once(argparse._StoreAction):
    """Stores an option's value: lists of several add up, a second value of another is refused."""

    def __call__(
        self,
        parser: argparse.ArgumentParser,
        namespace: argparse.Namespace,
        values: Any,
        option_string: str | None = None,
    ) -> None:
        given = vars(namespace).setdefault(_GIVEN, set())
        if option_string is not None and self.dest in given:
            if not isinstance(values, list | tuple) or not callable(self.type):
                raise argparse.ArgumentError(self, "is given twice: expected one value")
            # Read again as one text, in which its type brings order.
            values = self.type(",".join(map(str, [*getattr(namespace, self.dest), *values])))
        given.add(self.dest)
        super().__call__(parser, namespace, values, option_string)


class _Each(argparse._AppendAction):
    """Adds an option's value to those before; of NAME=VALUE, each name has one."""

    def __call__(
        self,
        parser: argparse.ArgumentParser,
        namespace: argparse.Namespace,
        values: Any,
        option_string: str | None = None,
    ) -> None:
        name, equals, _ = str(values).partition("=")
        held = [one.partition("=")[0] for one in map(str, getattr(namespace, self.dest) or ())]
        if equals and "=" in str(self.metavar) and name in held:
            raise argparse.ArgumentError(self, f"{name} is set twice: expected one value")
        super().__call__(parser, namespace, values, option_string)


class _Version(argparse.Action):
    """Looks the version up only when it is asked for."""

    def __init__(self, option_strings: Sequence[str], dest: str, **options: str):
        super().__init__(option_strings, dest, nargs=0, help=options.get("help"))

    def __call__(self, parser: argparse.ArgumentParser, *_: object) -> None:
        print(f"scenec {version_of()}")
        parser.exit()


if __name__ == "__main__":
    sys.exit(main())
