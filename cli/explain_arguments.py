"""Arguments of ``scenec explain``."""

from __future__ import annotations

import argparse

from scenec.api import forms
from scenec.cli.arguments import add_json, counted, names, read_by

_RUNGS = read_by(forms.whole(2, 12, "a whole number from 2 to 12"))


def add_explain_options(parser: argparse.ArgumentParser) -> None:
    """What is explained, of which batch; what ``--ladder`` measures anew, and where it goes."""
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
    group.add_argument(
        "--cfg", metavar="CFG", help="the cfg, where files that it names are not found beside OUT's"
    )
    group.add_argument(
        "--rungs", type=_RUNGS, default=5, metavar="K", help="of each ladder, 2 to 12 (default: 5)"
    )
    group.add_argument(
        "--only",
        type=names,
        metavar="A,B,…",
        help="of tessellation,lod,sky,smoothing,craters,textures",
    )
    group.add_argument("--csv", metavar="FILE", help="write the rungs as a table, too")
    group.add_argument("--plot", metavar="FILE.png", help="draw errors over seconds and bytes")
