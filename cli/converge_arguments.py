"""Arguments of ``scenec converge``."""

from __future__ import annotations

import argparse

from scenec.api.options import RenderOptions
from scenec.cli.arguments import add, add_json, amount, names, positive, span


def rungs(text: str) -> tuple[int, ...]:
    """Samples per pixel, such as ``4,16,64``; ascending, each once."""
    return tuple(sorted({positive(part) for part in names(text)} or {positive("")}))


def budgets(text: str) -> tuple[float, ...]:
    """Seconds, such as ``1,4,16``; ascending, each once."""
    return tuple(sorted({amount(part) for part in names(text)} or {amount("")}))


def add_converge_options(parser: argparse.ArgumentParser) -> None:
    """Adds the options of ``converge``."""
    parser.add_argument("out", metavar="OUT", help="output folder of compile, or a USD file")
    parser.add_argument(
        "--backends", metavar="A,B,…", type=names, default=["mitsuba"], help="default: mitsuba"
    )
    parser.add_argument(
        "--spp", type=rungs, metavar="N,N,…", help="samples per pixel of the rungs (default: "
        "4,16,64,256; none with --seconds)",
    )  # fmt: skip
    parser.add_argument(
        "--seconds", type=budgets, metavar="S,S,…", help="rungs by seconds a frame instead, or too"
    )
    parser.add_argument(
        "--repeats", type=positive, default=4, metavar="N", help="seeds of each rung (default: 4)"
    )
    parser.add_argument(
        "--reference", type=positive, metavar="N", help="samples per pixel of each backend's "
        "reference (default: 8 times the highest rung)",
    )  # fmt: skip
    parser.add_argument(
        "--samples", type=span, default=range(1), metavar="A:B", help="default: the first"
    )
    parser.add_argument(
        "--batches", type=span, default=range(1), metavar="A:B", help="default: the first"
    )
    parser.add_argument("--cameras", type=names, metavar="A,B,…", help="only these")
    parser.add_argument(
        "--denoise", action="store_true", help="climb again with denoising, where there is one"
    )
    parser.add_argument("--device", metavar="NAME", default="auto", help="default: auto")
    add(parser, RenderOptions, "allow_missing")
    add_json(parser)
