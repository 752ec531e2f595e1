"""Arguments of ``scenec evaluate``."""

from __future__ import annotations

import argparse

from scenec.cli.arguments import add_frames, add_json, amount, positions, positive

TASKS = ("instances", "labels", "depth", "track")
#: Option -> the tasks that it says something about.
BELONGS = {
    "split": ("instances",),
    "max_detections": ("instances",),
    "level": ("instances", "labels"),
    "classes": ("labels",),
    "missing": ("labels", "depth"),
    "depth_scale": ("depth",),
    "median_scaling": ("depth",),
    "min_depth": ("depth",),
    "max_depth": ("depth",),
    "align": ("track",),
    "delta": ("track",),
    "delta_unit": ("track",),
    "max_time_difference": ("track",),
}


def add_evaluate_options(parser: argparse.ArgumentParser) -> None:
    """What is judged, against what, and how."""
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
    parser.add_argument(
        "--task", choices=TASKS, help="what the predictions are (default: by their files)"
    )
    parser.add_argument(
        "-o", "--out", metavar="FOLDER", help="write tables and plots there (JSON, CSV, PNG)"
    )
    add_frames(parser)
    parser.add_argument(
        "--bins",
        action="append",
        default=[],
        metavar="NAME=A,B,…",
        help="other edges for distance, size, area, occlusion, truncation or sun",
    )
    parser.add_argument("--split", metavar="NAME", help="instances: of a dataset with several")
    parser.add_argument(
        "--max-detections",
        type=positive,
        metavar="N",
        help="instances: of a picture and class (default: 100, as COCO has it)",
    )
    parser.add_argument(
        "--level", metavar="NAME", help="instances, labels: which labels (default: the first)"
    )
    parser.add_argument(
        "--classes",
        type=positions,
        metavar="A,B,…",
        help="labels: what the values 0, 1, 2 … are, by position; names may repeat, (none) or "
        "nothing between two commas is no class (default: values are label ids)",
    )
    parser.add_argument(
        "--missing",
        choices=("stop", "skip"),
        help="labels, depth: frames without a prediction (default: stop)",
    )
    parser.add_argument(
        "--depth-scale", type=amount, metavar="N", help="depth: steps of a PNG a meter"
    )
    parser.add_argument(
        "--median-scaling",
        action="store_true",
        default=None,
        help="depth: scale each frame's prediction to the true median",
    )
    parser.add_argument(
        "--min-depth", type=amount, metavar="M", help="depth: nearer truth is not judged"
    )
    parser.add_argument(
        "--max-depth", type=amount, metavar="M", help="depth: farther truth is not judged"
    )
    parser.add_argument(
        "--align",
        choices=("se3", "sim3", "origin", "none"),
        help="track: how positions are laid on the truth (default: se3)",
    )
    parser.add_argument(
        "--delta", type=amount, metavar="N", help="track: step of the relative error (default: 1)"
    )
    parser.add_argument(
        "--delta-unit", choices=("frames", "m"), help="track: of that step (default: frames)"
    )
    parser.add_argument(
        "--max-time-difference",
        type=amount,
        metavar="S",
        help="track: of poses that are compared (default: 0.01)",
    )
    add_json(parser)
