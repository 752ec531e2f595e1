"""Arguments of ``scenec settle``."""

from __future__ import annotations

import argparse

from scenec.cli.arguments import counted, names, positive


def add_settle_options(parser: argparse.ArgumentParser) -> None:
    """What falls in ``settle``, and how."""
    parser.add_argument(
        "--objects",
        type=names,
        metavar="CLASS,…",
        required=True,
        help="classes to drop, of type placed or meshes",
    )
    parser.add_argument(
        "--among",
        type=names,
        metavar="CLASS,…",
        help="classes that they may fall onto (default: all of type placed and rocks)",
    )
    parser.add_argument(
        "--batch", type=counted, default=0, metavar="B", help="on whose ground (default: 0)"
    )
    parser.add_argument(
        "--attempt",
        type=counted,
        default=0,
        metavar="N",
        help="how often --faults redraw drew it again: attempt in the manifest (default: 0)",
    )
    parser.add_argument(
        "--drop",
        type=float,
        metavar="METERS",
        help="least height over the ground to fall from (default: a tenth of the object)",
    )
    parser.add_argument("--friction", type=float, default=0.6, help="default: 0.6")
    parser.add_argument(
        "--restitution", type=float, default=0.1, help="speed kept in a bounce (default: 0.1)"
    )
    parser.add_argument(
        "--cells",
        type=positive,
        default=8,
        help="cells of the ground across an object: finer and slower with more (default: 8)",
    )
    parser.add_argument(
        "--max-steps", type=counted, default=20000, help="give up waiting for rest (default: 20000)"
    )
