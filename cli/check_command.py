"""``scenec check``: files, stages, frames, exactness, and whether backends agree."""

from __future__ import annotations

import argparse
from pathlib import Path

from scenec.api.check import check
from scenec.api.options import CheckOptions
from scenec.cli.arguments import chosen
from scenec.cli.output import print_json, say_next
from scenec.cli.terminal import Terminal


def run(options: argparse.Namespace) -> int:
    """Checks; 1 if something is wrong."""
    out = Path(options.out)
    found = check(out, **chosen(CheckOptions, options), listener=Terminal())
    if found.is_dataset:
        from scenec.cli import check_dataset

        return check_dataset.tell(out, found, as_json=options.json)
    if options.json:
        print_json(found.as_json())
        return 0 if found.sound else 1
    print(found)
    if not found.errors:
        say_next(("view", out), ("export --format coco", out))
    return 0 if found.sound else 1
