"""Arguments of ``scenec view``."""

from __future__ import annotations

import argparse

from scenec.cli.arguments import add_json, amount, names, positive


def add_view_options(parser: argparse.ArgumentParser) -> None:
    """What is shown, how large the page may be, and Rerun in its place."""
    parser.add_argument("out", metavar="OUT", help="output folder with frames, or a USD file")
    parser.add_argument("-o", "--output", metavar="HTML", help="default: OUT/view.html")
    parser.add_argument(
        "--backend",
        type=names,
        metavar="A,B,…",
        help="whose frames (default: all there are; with --rerun the first)",
    )
    parser.add_argument(
        "--budget-mb",
        type=amount,
        default=200.0,
        metavar="MB",
        help="size of the page at most; frames are stored as finely as that allows (default: 200)",
    )
    parser.add_argument(
        "--no-ground",
        action="store_true",
        help="do not read the stages: no ground on the map, no sun in the statistics",
    )
    parser.add_argument(
        "--faults",
        choices=("skip", "stop"),
        default="skip",
        help="frames that are damaged or foreign: name them on the page, or stop (default: skip)",
    )
    parser.add_argument(
        "--workers", type=positive, metavar="N", help="processes (default: one a core)"
    )
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
