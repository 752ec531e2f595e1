"""Arguments of ``scenec export``."""

from __future__ import annotations

import argparse

from scenec.cli.arguments import add_executor, add_frames, add_json, seed

EPILOG = """\
conditions of --keep: NAME OPERATOR VALUE, in quotes, all must hold
  area>=40                  pixels that show the instance
  occlusion<0.9             part that other things hide, 1 - area / amodal
  truncation<0.5            part beyond the picture's border
  truncated=0               does not touch the border
  depth_min, depth_mean, depth_max   meters: depth_max<=35
  width, height             of its bounding box, pixels
  size                      longest side of its bounding box, meters
  class=*/rocks             prim path of its class; * stands for any text, | divides alternatives
  label.surface!=mud        label that all its faces share

examples
  scenec export OUT --format coco --split train=0.8,val=0.1,test=0.1 --keep 'area>=40'
  scenec export OUT --format hdf5 --set compression=none -o /data/mars
  scenec export --list      formats and their options
"""


def add_export_options(parser: argparse.ArgumentParser) -> None:
    """All of them."""
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.epilog = EPILOG
    parser.add_argument(
        "out", metavar="OUT", nargs="?", help="output folder with frames, or a rendered USD file"
    )
    parser.add_argument("--format", metavar="NAME", help="see --list")
    parser.add_argument("--list", action="store_true", help="list formats and their options")
    parser.add_argument(
        "-o", "--output", metavar="FOLDER", help="the dataset (default: OUT/datasets/FORMAT)"
    )
    add_frames(parser)
    parser.add_argument(
        "--keep",
        action="append",
        default=[],
        metavar="CONDITION",
        help="only instances of which it holds, see below; may be given several times",
    )
    parser.add_argument(
        "--rejected",
        choices=("drop", "ignore"),
        default="drop",
        help="drop the other instances, or keep them marked as not to be judged (default: drop)",
    )
    parser.add_argument(
        "--remap", metavar="JSON", help="file of other label names and ids: {level: {old: new}}"
    )
    parser.add_argument(
        "--level", help="level whose labels are the categories (default: the first)"
    )
    parser.add_argument(
        "--split",
        metavar="A=X,B=Y,…",
        help="splits by whole batches: shares (train=0.8,val=0.2) or ranges (train=0:8,val=8:10)",
    )
    parser.add_argument(
        "--split-seed", type=seed, default=0, metavar="N", help="of the assignment (default: 0)"
    )
    parser.add_argument(
        "--set",
        action="append",
        default=[],
        metavar="NAME=VALUE",
        help="option of the format, see --list; may be given several times",
    )
    parser.add_argument(
        "--faults",
        choices=("stop", "skip"),
        default="stop",
        help="what to do about missing, foreign and damaged frames (default: stop)",
    )
    add_executor(parser, "one a core")
    parser.add_argument(
        "--replace", action="store_true", help="replace another dataset in the same folder"
    )
    add_json(parser)
