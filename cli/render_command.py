"""``scenec render``."""

from __future__ import annotations

import argparse
from contextlib import ExitStack
from dataclasses import fields

from scenec.backends.run.executors import make_executor
from scenec.backends.run.limits import Limits
from scenec.backends.run.plan import RenderPlan
from scenec.backends.run.render import RenderReport, render
from scenec.cli.output import Progress, print_json, say, say_next
from scenec.schemas.codec import encode
from scenec.schemas.memory import GB
from scenec.schemas.units import Executor


def run(options: argparse.Namespace) -> int:
    """Renders."""
    report = render_now(options)
    if options.json:
        print_json(as_json(report))
    say_next(("view", options.out), ("export --format coco", options.out))
    return 1 if report.failed else 0


def render_now(options: argparse.Namespace, executor: Executor | None = None) -> RenderReport:
    """Renders, and says what came of it.

    Args:
        options: Of the command line.
        executor: Who works; None: who the options say.
    """
    with ExitStack() as stack:
        executor = executor or stack.enter_context(executor_of(options))
        report = render(
            options.out,
            plan_of(options),
            executor=executor,
            progress=Progress("frame"),
            warn=lambda line: say(f"warning: {line}"),
            say=say,
        )
    there = f", {report.skipped} were there already" if report.skipped else ""
    seconds = sum(report.seconds.values())
    if report.refused:
        say(f"{report.refused} frames were refused by {report.backend}: see the warnings")
    if lost := len(report.failed) - report.refused:
        say(f"{lost} frames were given up; run again to try them again")
    made = next((stem for stem in report.frames if stem.with_suffix(".exr").exists()), None)
    where = "" if made is None else f": {made.parent}/"
    spent = f" in {seconds:.1f} s" if options.verbose else ""
    say(f"{report.rendered} frames rendered{spent}{there}{where}")
    return report


def executor_of(options: argparse.Namespace) -> Executor:
    """Who renders, as a command line has it."""
    return make_executor(options.workers, options.cluster, limits_of(options))


def plan_of(options: argparse.Namespace) -> RenderPlan:
    """What a command line asks to be rendered.

    Raises:
        BackendError: It cannot be.
    """
    names = {field.name for field in fields(RenderPlan)}
    return RenderPlan(**{name: value for name, value in vars(options).items() if name in names})


def limits_of(options: argparse.Namespace) -> Limits:
    """What a command line lets workers take."""
    memory = options.memory_limit
    return Limits(options.timeout, memory_bytes=None if memory is None else round(memory * GB))


def as_json(report: RenderReport) -> dict[str, object]:
    """The report for scripts."""
    return {
        "backend": report.backend,
        "choice": encode(report.choice),
        "backend_version": report.backend_version,
        "device": report.device,
        "denoiser": report.denoiser,
        "frames": [f"{stem}.json" for stem in report.frames],
        "rendered": report.rendered,
        "skipped": report.skipped,
        "failed": report.failed,
        "refused": report.refused,
        "worker_deaths": report.deaths,
        "workers_replaced": report.replaced,
        "peak_memory_gb": report.peak_memory_gb,
        "seconds": report.seconds,
        "losses": report.losses,
        "warnings": report.warnings,
    }
