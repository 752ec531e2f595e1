"""``scenec sweep``: a cfg with many values and seeds, each point an output of its own."""

from __future__ import annotations

import argparse

from scenec.api.options import SweepOptions
from scenec.api.sweep import TABLE, sweep
from scenec.cli.arguments import chosen
from scenec.cli.output import print_json, say, say_next, status
from scenec.cli.terminal import Terminal


def run(options: argparse.Namespace) -> int:
    """Makes all points; 1 if some could not be made."""
    status(f"reading {options.cfg}")
    asked = chosen(SweepOptions, options)
    table = sweep(options.cfg, options.out, **asked, listener=Terminal(options.verbose))
    if options.json:
        print_json(table.content())
    say(f"{len(table.points)} points in {table.out}/, listed in {table.out / TABLE}.csv")
    if table.made:
        say_next(("explain", table.made[0]) if options.compile_only else ("view", table.out))
    return 0 if len(table.made) == len(table.points) else 1
