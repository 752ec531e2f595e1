"""``scenec scan``."""

from __future__ import annotations

import argparse
from contextlib import ExitStack

from scenec.backends.run.executors import make_executor
from scenec.backends.run.scan import ScanReport, scan_output
from scenec.cli.output import Progress, print_json, say, say_next
from scenec.schemas.units import Executor


def run(options: argparse.Namespace) -> int:
    """Scans with all lidars."""
    report = scan_now(options, lidars=options.lidars, ply=options.ply)
    if options.json:
        print_json(as_json(report))
    say_next(("check", options.out))
    return 1 if report.failed else 0


def scan_now(
    options: argparse.Namespace,
    lidars: list[str] | None = None,
    ply: bool = False,
    executor: Executor | None = None,
) -> ScanReport:
    """Scans, and says what came of it.

    Args:
        options: Of the command line.
        lidars, ply: As of ``scan_output``.
        executor: Who works; None: who the options say.
    """
    with ExitStack() as stack:
        executor = executor or stack.enter_context(make_executor(options.workers, options.cluster))
        report = scan_output(
            options.out,
            samples=options.samples,
            batches=options.batches,
            lidars=lidars,
            ply=ply,
            # Of ``run`` there is none: what it scans it has just compiled.
            allow_missing=getattr(options, "allow_missing", False),
            progress=Progress("scan", unit="scan"),
            executor=executor,
        )
    for line in report.warnings:
        say(f"warning: {line}")
    if report.failed:
        say(f"{len(report.failed)} scans were given up; run again to try them again")
    there = report.skipped
    rest = f", {there} were there already" if there else ""
    where = f": {report.scans[0].parent}/" if report.scans else ""
    spent = f" in {sum(report.seconds.values()):.1f} s" if options.verbose else ""
    say(f"{report.made} scans made{spent}{rest}{where}")
    return report


def as_json(report: ScanReport) -> dict[str, object]:
    """The report for scripts."""
    return {
        "scans": [f"{stem}.json" for stem in report.scans],
        "made": report.made,
        "failed": report.failed,
        "seconds": report.seconds,
        "warnings": report.warnings,
    }
