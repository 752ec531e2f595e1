"""Arguments of ``scenec sweep``."""

from __future__ import annotations

import argparse

from scenec.api.options import StageOptions, SweepOptions
from scenec.cli.arguments import (
    add,
    add_cache,
    add_cfg,
    add_json,
    add_keep,
    add_render_options,
)


def add_sweep_options(parser: argparse.ArgumentParser) -> None:
    """Adds the options of ``sweep``; the others are those of ``run``."""
    add_cfg(parser)
    add(parser, SweepOptions)
    parser.add_argument("-o", "--out", metavar="OUT", required=True, help="a folder of outputs")
    add_render_options(parser, SweepOptions)
    add_keep(parser)
    add_cache(parser)
    add(parser, StageOptions, "replace", "faults", "batches")
    add_json(parser)
    parser.epilog = (
        "Each combination has a folder of OUT, named for what differs; OUT/sweep.csv and "
        "OUT/sweep.json list them. What is there already is not made again. Example: scenec sweep "
        "cfg.json --set light.sun.elevation_deg=10,30,60 --set terrain.spacing_m=0.1,0.2 --seeds "
        "0:5 -o OUT. Exit status: 0 all is there; 1 some points could not be made; 2 a fault, "
        "and nothing was made."
    )
