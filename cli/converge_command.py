"""``scenec converge``: error against run time."""

from __future__ import annotations

import argparse

from scenec.api.measure import ConvergeOptions, converge
from scenec.api.text import table
from scenec.cli.arguments import chosen
from scenec.cli.output import print_json, say_next
from scenec.cli.terminal import Terminal
from scenec.quality.converge import ConvergeReport
from scenec.quality.converge.series import FLOOR_HEADER, STEP_HEADER, floor_cells, step_cells


def run(options: argparse.Namespace) -> int:
    """Renders ladders, and says how they converge."""
    found = converge(options.out, **chosen(ConvergeOptions, options), listener=Terminal())
    if options.json:
        print_json({**found.as_json(), "files": [path.as_posix() for path in found.files]})
    else:
        print_report(found)
        say_next(("render --error 0.05", options.out))
    return 0


def print_report(report: ConvergeReport) -> None:
    """Tables: convergence to oneself, differences between backends, annotation."""
    rows = [
        [series.name, series.against, step.rung, *step_cells(step)]
        for series in sorted(report.series, key=lambda one: not one.own)
        for step in series.steps
    ]
    print(table(rows, ["backend", "against", "rung", *STEP_HEADER]))
    if report.floors:
        print("\nbetween references, noise subtracted (not from FLIP):")
        print(table([floor_cells(floor) for floor in report.floors], FLOOR_HEADER))
    for path in report.files:
        print(path)
