"""``scenec render``."""

from __future__ import annotations

import argparse

from scenec.api.options import RenderOptions
from scenec.api.steps import render_output
from scenec.cli.arguments import given
from scenec.cli.output import print_json, say_next
from scenec.cli.terminal import Terminal


def run(options: argparse.Namespace) -> int:
    """Renders; 1 if a frame was given up."""
    heard = Terminal(options.verbose)
    report = render_output(options.out, given(RenderOptions, options, listener=heard))
    if options.json:
        print_json(heard.made["render"])
    say_next(("view", options.out), ("export --format coco", options.out))
    return 1 if report.failed else 0
