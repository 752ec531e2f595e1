"""Arguments of ``scenec evaluate``."""

from __future__ import annotations

import argparse

from scenec.api.declare import declared
from scenec.api.options import EvaluateOptions, FrameOptions
from scenec.cli.arguments import add, add_json


def add_evaluate_options(parser: argparse.ArgumentParser) -> None:
    """Adds the options of ``evaluate``."""
    parser.epilog = "Example: scenec evaluate detections.json --against DATASET (docs/evaluate.md)"
    parser.add_argument(
        "predictions",
        metavar="PREDICTIONS",
        help="COCO results (.json), a trajectory (.txt, as TUM has it), or a folder of label or "
        "depth maps named as frames",
    )
    parser.add_argument(
        "--against",
        metavar="TRUTH",
        required=True,
        help="output folder with frames, a dataset of export coco or tum, or a file of either",
    )
    add(parser, EvaluateOptions, "task")
    parser.add_argument(
        "-o", "--out", metavar="FOLDER", help="write tables and plots there (JSON, CSV, PNG)"
    )
    add(parser, FrameOptions)
    add(parser, EvaluateOptions, *list(declared(EvaluateOptions, own=True))[1:])
    add_json(parser)
