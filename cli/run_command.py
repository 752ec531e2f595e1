"""``scenec run``: compile, render, and scan where there are lidars."""

from __future__ import annotations

import argparse

from scenec.api.options import RunOptions
from scenec.api.work import run as run_all
from scenec.cli.arguments import chosen
from scenec.cli.output import print_json, say_next, status
from scenec.cli.terminal import Terminal
from scenec.schemas.errors import SceneError


def run(options: argparse.Namespace) -> int:
    """Compiles, renders, and scans; 1 if a batch or a frame could not be made.

    Raises:
        SceneError: A batch cannot be built; those before it are rendered.
    """
    status(f"reading {options.cfg}")
    heard = Terminal(options.verbose)
    try:
        run_all(options.cfg, options.out, **chosen(RunOptions, options), listener=heard)
    except SceneError:
        if options.json and "render" in heard.made:
            print_json(heard.made)
        raise
    if options.json:
        print_json(heard.made)
    say_next(("view", options.out), ("export --format coco", options.out))
    return 1 if any(made["failed"] for made in heard.made.values()) else 0
