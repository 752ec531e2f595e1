"""``scenec explain --ladder``: error against cost of the compiler's own approximations."""

from __future__ import annotations

import argparse
import textwrap
from pathlib import Path

from scenec.api.measure import LadderOptions, ladder
from scenec.api.text import table
from scenec.cli.arguments import chosen
from scenec.cli.output import print_json
from scenec.cli.terminal import Terminal
from scenec.quality.ladder import Ladder, LadderReport
from scenec.quality.ladder.plots import draw
from scenec.quality.ladder.results import cells, units
from scenec.quality.ladder.slopes import slope_text
from scenec.schemas.files import atomic, check_output

#: Columns that the tables keep to.
_WIDTH = 100


def run(options: argparse.Namespace) -> int:
    """Climbs the ladders of one scene and prints them."""
    for file in (options.csv, options.plot):
        if file:
            check_output(Path(file))
    report = ladder(options.out, **chosen(LadderOptions, options), listener=Terminal())
    if options.csv:
        with atomic(Path(options.csv)) as temporary:
            temporary.write_text(report.as_csv(), encoding="utf-8")
    if options.plot:
        draw(Path(options.plot), report)
    if options.json:
        print_json(report.as_json())
    else:
        print_report(report)
    return 0


def print_report(report: LadderReport) -> None:
    """Tables of at most 100 columns: a rung a row, the cfg's own marked."""
    print(f"{report.scene}, seed {report.seed}, batch {report.batch}; * is the cfg's value")
    for one in report.ladders:
        print(f"\n{one.name}: {one.what}; errors in {units(one)}")
        header, rows = cells(one)
        print(table(rows, header))
        lines = [f"against: {one.reference}", f"claim: {one.claim}", *slope_lines(one)]
        for line in [*lines, *one.notes]:
            print(textwrap.fill(line, _WIDTH, initial_indent="  ", subsequent_indent="    "))
    for name, why in report.absent.items():
        print(f"\n{name}: no ladder: {why}")


def slope_lines(ladder: Ladder) -> list[str]:
    """Describes the cost of halving the error."""
    return [f"rms error {slope_text(over, found)}" for over, found in ladder.slopes.items()]
