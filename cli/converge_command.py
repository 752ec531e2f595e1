"""``scenec converge``: error against run time."""

from __future__ import annotations

import argparse
from pathlib import Path

from scenec.api.text import table
from scenec.cli.output import print_json, say, say_next
from scenec.quality.converge import ConvergeReport, Ladder, converge
from scenec.quality.converge.series import FLOOR_HEADER, STEP_HEADER, floor_cells, step_cells


def run(options: argparse.Namespace) -> int:
    """Renders ladders, and says how they converge."""
    spp = options.spp
    if spp is None:
        spp = () if options.seconds else Ladder().spp
    ladder = Ladder(
        spp=spp,
        seconds=options.seconds or (),
        repeats=options.repeats,
        reference_spp=options.reference,
        denoise=options.denoise,
        samples=options.samples,
        cameras=None if options.cameras is None else tuple(options.cameras),
        device=options.device,
        allow_missing=options.allow_missing,
    )
    found = converge(Path(options.out), options.backends, ladder, batches=options.batches, say=say)
    if options.json:
        print_json({**found.as_json(), "files": [path.as_posix() for path in found.files]})
    else:
        print_report(found)
        say_next(("render --error 0.05", options.out))
    return 0


def print_report(report: ConvergeReport) -> None:
    """Tables: convergence to oneself, differences between backends, annotation."""
    rows = [
        [series.name, series.against, step.rung, *step_cells(step)]
        for series in sorted(report.series, key=lambda one: not one.own)
        for step in series.steps
    ]
    print(table(rows, ["backend", "against", "rung", *STEP_HEADER]))
    if report.floors:
        print("\nbetween references, noise subtracted (not from FLIP):")
        print(table([floor_cells(floor) for floor in report.floors], FLOOR_HEADER))
    for path in report.files:
        print(path)
