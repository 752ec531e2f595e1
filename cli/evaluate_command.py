"""``scenec evaluate``: how good predictions are."""

from __future__ import annotations

import argparse
import math
from pathlib import Path

from scenec.api.evaluate import evaluate
from scenec.api.options import EvaluateOptions
from scenec.api.text import table
from scenec.cli.arguments import chosen
from scenec.cli.output import print_json, say
from scenec.cli.terminal import Terminal
from scenec.datasets.evaluate import report
from scenec.datasets.evaluate.evaluation import Cell, Evaluation

#: Rows of a table that are printed; files hold all.
_ROWS = 24
#: Tables with a row a frame or pose: for files.
_LONG = ("frame", "pose")


def run(options: argparse.Namespace) -> int:
    """Judges, prints, and writes what was asked for."""
    asked = chosen(EvaluateOptions, options)
    found = evaluate(options.predictions, options.against, **asked, listener=Terminal())
    if options.out:
        report.write(Path(options.out), found)
    if options.json:
        print_json({**found.as_json(), "files": [one.as_posix() for one in found.files]})
    else:
        print_report(found)
    return 0


def print_report(found: Evaluation) -> None:
    """The measures, then a table a part."""
    rows = [
        [name, _text(value), found.units.get(name, "")] for name, value in found.measures.items()
    ]
    print(table(rows, [found.task, "value", "unit"]))
    for one in found.tables:
        if one.name not in _LONG and one.rows:
            print(f"\n{one.title}")
            print(table([list(map(_text, row)) for row in one.rows[:_ROWS]], list(one.columns)))
            if len(one.rows) > _ROWS:
                print(f"and {len(one.rows) - _ROWS} more rows (-o FOLDER or --json)")
    for note in found.notes:
        say(f"note: {note}")
    for path in found.files:
        print(path)


def _text(value: Cell) -> str:
    if value is None:
        return "-"
    if isinstance(value, str):
        return value
    whole = math.isfinite(value) and value == int(value)
    return f"{value:,}" if whole and abs(value) >= 2 else f"{value:.4g}"
