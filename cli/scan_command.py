"""``scenec scan``."""

from __future__ import annotations

import argparse

from scenec.api.options import ScanOptions
from scenec.api.steps import scan_output
from scenec.cli.arguments import given
from scenec.cli.output import print_json, say_next
from scenec.cli.terminal import Terminal


def run(options: argparse.Namespace) -> int:
    """Scans with all lidars."""
    heard = Terminal(options.verbose)
    report = scan_output(options.out, given(ScanOptions, options, listener=heard))
    if options.json:
        print_json(heard.made["scan"])
    say_next(("check", options.out))
    return 1 if report.failed else 0
