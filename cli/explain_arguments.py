"""Arguments of ``scenec explain``."""

from __future__ import annotations

import argparse

from scenec.cli.arguments import add_json, counted
from scenec.cli.ladder_arguments import add_ladder_options


def add_explain_options(parser: argparse.ArgumentParser) -> None:
    """What is explained, and of which batch."""
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
    add_ladder_options(parser)
