"""``scenec compile``."""

from __future__ import annotations

import argparse

from scenec.api.options import CompileOptions
from scenec.api.work import compile
from scenec.cli.arguments import chosen
from scenec.cli.output import print_json, say_next, status
from scenec.cli.terminal import Terminal


def run(options: argparse.Namespace) -> int:
    """Compiles; 1 if a batch could not be built."""
    status(f"reading {options.cfg}")
    heard = Terminal(options.verbose)
    made = compile(options.cfg, options.out, **chosen(CompileOptions, options), listener=heard)
    if options.json:
        print_json(heard.made["compile"])
    say_next(("render", made.path), ("explain", made.path))
    return 1 if heard.made["compile"]["failed"] else 0
