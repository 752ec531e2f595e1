"""Arguments of ``scenec explain``."""

from __future__ import annotations

import argparse

from scenec.api.measure import LadderOptions
from scenec.cli.arguments import add, add_json, counted


def add_explain_options(parser: argparse.ArgumentParser) -> None:
    """Adds the options of ``explain``, and those of ``--ladder``."""
    parser.add_argument("out", metavar="OUT", help="output folder of compile")
    parser.add_argument(
        "--why",
        metavar="ID",
        help="why something is in the stage or is not: a class and a number in it (rocks/4711), "
        "an instance id as frames have it (4711), or a prim path (/World/Terrain/tile_000_000)",
    )
    parser.add_argument(
        "--batch",
        type=counted,
        metavar="N",
        help="only this batch (--why: default the first)",
    )
    add_json(parser)
    parser.add_argument(
        "--ladder",
        action="store_true",
        help="vary each approximation of one scene (--batch) alone: error measured and claimed, "
        "seconds, bytes; builds the scene again and writes nothing to OUT",
    )
    group = parser.add_argument_group("with --ladder")
    add(group, LadderOptions)
    group.add_argument("--csv", metavar="FILE", help="write the rungs as a table, too")
    group.add_argument("--plot", metavar="FILE.png", help="draw errors over seconds and bytes")
