"""Arguments of ``scenec view``."""

from __future__ import annotations

import argparse

from scenec.api.options import ViewOptions
from scenec.cli.arguments import add, add_json


def add_view_options(parser: argparse.ArgumentParser) -> None:
    """What is shown, how large the page may be, and Rerun in its place."""
    parser.add_argument("out", metavar="OUT", help="output folder with frames, or a USD file")
    parser.add_argument(
        "-o", "--output", dest="page", metavar="HTML", help="default: OUT/view.html"
    )
    add(parser, ViewOptions)
    parser.add_argument(
        "--open", action="store_true", help="show the page in this machine's browser"
    )
    parser.add_argument(
        "--watch",
        action="store_true",
        help="write the page anew whenever the output has changed, until Ctrl-C; pages that are "
        "open load themselves again",
    )
    parser.add_argument(
        "--rerun",
        action="store_true",
        help="no page: log the frames to the Rerun viewer (needs the extra 'rerun')",
    )
    parser.add_argument(
        "--rerun-save", metavar="RRD", help="no page: write them as a recording for Rerun"
    )
    add_json(parser)
