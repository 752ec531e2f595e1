"""``scenec settle``."""

from __future__ import annotations

import argparse
from dataclasses import asdict

from scenec.api.make import SettleOptions, settle_objects
from scenec.cli.arguments import chosen
from scenec.cli.output import print_json, say
from scenec.cli.terminal import Terminal
from scenec.settle.settle import SettleReport


def run(options: argparse.Namespace) -> int:
    """Settles, and says what came of it."""
    report = settle_objects(
        options.cfg, options.out, **chosen(SettleOptions, options), listener=Terminal()
    )
    if options.json:
        print_json({**asdict(report), "files": {n: str(f) for n, f in report.files.items()}})
    else:
        _print_report(report)
    return 0


def _print_report(report: SettleReport) -> None:
    say(
        f"settled {report.objects:,} objects in {report.groups:,} groups: {report.steps:,} steps, "
        f"{report.seconds:.1f} s (building the batch: {report.build_seconds:.1f} s)"
    )
    say(
        f"errors, at most: a vertex {report.below_ground_m * 1e3:.2g} mm below the ground, the "
        f"lowest vertex of an object {report.above_ground_m * 1e3:.2g} mm above it, collision "
        f"shapes {report.overlap_m * 1e3:.2g} mm in each other and {report.hull_gap_m * 1e3:.2g} "
        f"mm off their meshes; {report.speed_m_s * 1e3:.2g} mm/s left"
    )
    if report.unsettled:
        say(
            f"warning: {report.unsettled} objects stand in groups that were not at rest after "
            "--max-steps; more of them, or more --friction, helps"
        )
    if report.off_terrain:
        say(f"warning: {report.off_terrain} objects ended beyond the terrain's border")
    if report.ignored:
        say(f"{report.ignored} objects near were too small or too many to be fallen onto")
    for name, file in report.files.items():
        say(f'{name}: {file}; a class of type "placed" takes it with "heights": "world"')
