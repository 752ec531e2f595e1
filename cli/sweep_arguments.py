"""Arguments of ``scenec sweep``."""

from __future__ import annotations

import argparse

from scenec.cli.arguments import (
    add_batches,
    add_cache,
    add_cfg,
    add_json,
    add_keep,
    add_render_options,
    add_replace,
    add_verbose,
    span,
)


def add_sweep_options(parser: argparse.ArgumentParser) -> None:
    """What is varied, and where it goes; else as of ``run``."""
    add_cfg(parser)
    parser.add_argument(
        "--set",
        dest="lists",
        action="append",
        default=[],
        metavar="PATH=VALUE,…",
        help="values of a place of the cfg, as of run --set; several are all combined (repeatable)",
    )
    parser.add_argument(
        "--zip",
        dest="in_step",
        action="store_true",
        help="the first values of all lists together, then the second ones …, not each with each",
    )
    parser.add_argument(
        "--seeds", type=span, default=range(1), metavar="A:B", help="seeds A to B-1 (default: 0:1)"
    )
    parser.add_argument(
        "--compile-only", action="store_true", help="make the stages alone: render and scan nothing"
    )
    parser.add_argument("-o", "--out", metavar="OUT", required=True, help="a folder of outputs")
    add_render_options(parser)
    add_verbose(parser)
    add_keep(parser)
    add_cache(parser)
    add_replace(parser)
    add_batches(parser)
    add_json(parser)
    parser.epilog = (
        "Each combination has a folder of OUT, named for what differs; OUT/sweep.csv and "
        "OUT/sweep.json list them. What is there already is not made again. Example: scenec sweep "
        "cfg.json --set light.sun.elevation_deg=10,30,60 --set terrain.spacing_m=0.1,0.2 --seeds "
        "0:5 -o OUT. Exit status: 0 all is there; 1 some points could not be made; 2 a fault, "
        "and nothing was made."
    )
