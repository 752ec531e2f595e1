"""``scenec converge``: error against run time."""

from __future__ import annotations

import argparse
from pathlib import Path

from scenec.backends.converge import ConvergeReport, Ladder, converge
from scenec.cli.output import print_json, say, table


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
    return 0


def print_report(found: ConvergeReport) -> None:
    """Tables: convergence to oneself, differences between backends, annotation."""
    rows = [
        [
            series.name,
            series.against,
            step.rung,
            f"{step.spp:g}",
            f"{step.seconds:.3g}",
            _percent(step.mean),
            _percent(step.estimated),
            f"{step.relative_mse:.3g}",
            f"{step.relative_mse_trimmed:.3g}",
            "-" if step.flip is None else f"{step.flip:.4f}",
            f"{100 * step.bias:+.3f} %"
            + ("" if step.bias_error is None else f" ± {100 * step.bias_error:.3f}"),
        ]
        for series in sorted(found.series, key=lambda one: not one.own)
        for step in series.steps
    ]
    header = ["backend", "against", "rung", "spp", "s", "rel. rms", "estimated", "relMSE",
              "trimmed", "FLIP", "bias"]  # fmt: skip
    print(table(rows, header))
    floors = [
        [
            f"{floor['backend']} : {floor['against']}",
            _percent(floor["relative_rms"]),
            f"{_percent(floor['relative_rms_low'])} to {_percent(floor['relative_rms_high'])}",
            f"{floor['relative_mse']:.3g}",
            "-" if floor["flip"] is None else f"{floor['flip']:.4f}",
            f"{100 * floor['bias']:+.3f} %",
        ]
        for floor in found.floors
    ]
    if floors:
        print("\nbetween references, noise subtracted (not from FLIP):")
        print(table(floors, ["backends", "rel. rms", "95 %", "relMSE", "FLIP", "bias"]))
    for path in found.files:
        print(path)


def _percent(value: float | None) -> str:
    return "-" if value is None else f"{100 * value:.3g} %"
