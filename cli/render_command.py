"""``scenec render``."""

from __future__ import annotations

import argparse
from pathlib import Path

from scenec.backends.registry import require_name
from scenec.backends.render import RenderReport, render
from scenec.cli.output import Progress, print_json, say
from scenec.schemas.manifest import find_batches


def run(options: argparse.Namespace) -> int:
    """Renders."""
    report = render_now(options)
    if options.json:
        print_json(as_json(report))
    return 1 if report.failed else 0


def render_now(options: argparse.Namespace) -> RenderReport:
    """Renders, and says what came of it."""
    # What is not there should be all that is said.
    require_name(options.backend)
    find_batches(Path(options.out), options.batches)
    say(f"rendering with {options.backend} (rgb: {options.spp} samples per pixel)")
    report = render(
        options.out,
        options.backend,
        spp=options.spp,
        passes=options.passes,
        samples=options.samples,
        batches=options.batches,
        noise_seed=options.noise_seed,
        progress=Progress("frame"),
        warn=lambda line: say(f"warning: {line}"),
    )
    there = f", {report.skipped} were there already" if report.skipped else ""
    seconds = sum(report.seconds.values())
    if report.failed:
        say(f"{len(report.failed)} frames were given up; run again to try them again")
    say(f"{report.rendered} frames rendered in {seconds:.1f} s{there}: {report.frames[0].parent}/")
    return report


def as_json(report: RenderReport) -> dict[str, object]:
    """The report for scripts."""
    return {
        "frames": [f"{stem}.json" for stem in report.frames],
        "rendered": report.rendered,
        "skipped": report.skipped,
        "failed": report.failed,
        "worker_deaths": report.deaths,
        "seconds": report.seconds,
        "warnings": report.warnings,
    }
