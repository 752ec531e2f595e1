"""Arguments of ``scenec export``."""

from __future__ import annotations

import argparse

from scenec.api.declare import declared
from scenec.api.options import ExportOptions, FrameOptions
from scenec.cli.arguments import add, add_json

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
        "-o",
        "--output",
        dest="folder",
        metavar="FOLDER",
        help="the dataset (default: OUT/datasets/FORMAT)",
    )
    add(parser, FrameOptions)
    own = [name for name in declared(ExportOptions, own=True) if name != "workers"]
    add(parser, ExportOptions, *own[:-1], "workers", "cluster", own[-1])
    add_json(parser)
