"""A terminal that hears of long work: lines on standard error, bars, what came of each step."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from scenec.api.listener import Listener
from scenec.cli.output import LINE_S, Progress, say
from scenec.schemas.codec import decode, encode
from scenec.schemas.errors import OutputError
from scenec.schemas.report import HeightFacts, IterationFacts

if TYPE_CHECKING:
    from scenec.backends.run.render import RenderReport
    from scenec.backends.run.scan import ScanReport
    from scenec.compiler.compile import CompileReport

#: Steps of a batch that are named with ``--verbose``.
_SLOWEST = 5


class Terminal(Listener):
    """Prints what it hears.

    Args:
        verbose: Whether to say what took how long, too.

    Attributes:
        made: What was done so far, for scripts, by command.
    """

    flags = True

    def __init__(self, verbose: bool = False) -> None:
        self._verbose = verbose
        self.made: dict[str, Any] = {}

    def say(self, line: str) -> None:
        """Prints a line."""
        say(line)

    def steps(self, what: str, unit: str = "frame", units: str | None = None) -> Progress:
        """Shows a bar; where there is no terminal a line now and then, or one a step if asked."""
        return Progress(what, unit, units, 0.0 if self._verbose else LINE_S)

    def compiled(self, report: CompileReport, cache: Path | None) -> None:
        """Says what each batch holds, what is improbable of it, and where the stages are."""
        self.made["compile"] = compile_json(report)
        for name in report.seconds:
            self._print_batch(name, report)
        for name, attempts in report.attempts.items():
            say(f"{name}: drawn again {attempts} times, since it could not be built")
        if report.failed:
            say(
                f"{len(report.failed)} of {len(report.failed) + len(report.batches)} batches "
                f"cannot be built: {', '.join(report.failed)}"
            )
        for line in report.strays:
            say(f"warning: {line}")
        if report.unchanged:
            say(
                f"{report.unchanged} of {len(report.batches)} batches were there already, byte "
                "for byte"
            )
        made, taken = (
            sum(sum(one.values()) for one in all_.values()) for all_ in (report.made, report.taken)
        )
        if taken:
            say(f"{taken} of {made + taken} steps were taken from the cache, {cache}")
        say(f"stages: {report.out}/batch_*/stage.usda")

    def _print_batch(self, name: str, report: CompileReport) -> None:
        from scenec.api.explain.passes import precision_text
        from scenec.compiler.kinds.table import CHOICES
        from scenec.compiler.mesh.precision import WARN_PX

        batch, seconds = report.reports[name], report.seconds[name]
        objects = sum(entry.count for entry in batch.objects.values())
        spared = sum(entry.instances for entry in batch.left_out)
        less = f" ({spared:,} left out)" if spared else ""
        say(
            f"{name}: {batch.ground.faces:,} terrain faces, {objects:,} objects{less}, "
            f"{batch.bytes / 2**20:.1f} MiB"
        )
        precision = batch.precision
        assert precision is not None
        if self._verbose:
            slowest = sorted(seconds.items(), key=lambda item: -item[1])[:_SLOWEST]
            steps = ", ".join(f"{step} {spent:.2g} s" for step, spent in slowest)
            say(
                f"{name}: {sum(seconds.values()):.1f} s ({steps}); positions in float32: "
                f"{precision_text(precision)}"
            )
        for left in batch.left_out:
            if left.what.startswith("light/"):
                say(f"{name}: warning: {left.what} is left out: {left.why}")
        off = precision.float32_error_max_px
        if off is not None and off > WARN_PX:
            say(
                f"{name}: warning: float32 moves vertices by up to {off:.2g} pixels of the nearest "
                f"view, over {precision.extent_m:g} m; make the terrain smaller, or "
                "keep cameras farther from it"
            )
        for place, entry in enumerate(batch.relief):
            if entry.type not in CHOICES["relief"].kinds:
                # Of another package: it reports what it likes.
                continue
            at = f"/terrain/relief/{place}"
            read = decode(entry.facts, HeightFacts, OutputError, at)
            if replace(read, band=None) != HeightFacts():
                say(
                    f"{name}: {at} (dem): heights are (sample * {read.scale:g} + "
                    f"{read.offset:g}) * {read.unit_m:.9g} m of band {read.band}"
                )
            went = decode(entry.facts, IterationFacts, OutputError, at)
            if went.error_rms_m is not None and went.error_rms_m > went.error_aim_m:
                say(
                    f"{name}: warning: {at} ({entry.type}) errs by about "
                    f"{went.error_rms_m:.2g} m rms after {went.steps:,} steps, its aim is "
                    f"{went.error_aim_m:.2g} m; raise steps, or error_m"
                )

    def scanned(self, report: ScanReport) -> None:
        """Says how many scans were made, and where they are."""
        self.made["scan"] = {
            "scans": [f"{stem}.json" for stem in report.scans],
            "made": report.made,
            "failed": report.failed,
            "seconds": report.seconds,
            "warnings": report.warnings,
        }
        if report.failed:
            say(f"{len(report.failed)} scans were given up; run again to try them again")
        rest = f", {report.skipped} were there already" if report.skipped else ""
        where = _folder_of(report.scans)
        say(f"{report.made} scans made{self._spent(report.seconds)}{rest}{where}")

    def rendered(self, report: RenderReport) -> None:
        """Says how many frames were made, given up and refused, and where they are."""
        self.made["render"] = render_json(report)
        there = f", {report.skipped} were there already" if report.skipped else ""
        if report.refused:
            say(f"{report.refused} frames were refused by {report.backend}: see the warnings")
        if lost := len(report.failed) - report.refused:
            say(f"{lost} frames were given up; run again to try them again")
        where = _folder_of(report.frames)
        say(f"{report.rendered} frames rendered{self._spent(report.seconds)}{there}{where}")

    def _spent(self, seconds: dict[str, float]) -> str:
        return f" in {sum(seconds.values()):.1f} s" if self._verbose else ""


def _folder_of(stems: Sequence[Path]) -> str:
    """Says in which folder files lie; where they are several, with * for what differs."""
    folders = [path for path in dict.fromkeys(stem.parent for stem in stems) if path.is_dir()]
    parts = [set(part) for part in zip(*(folder.parts for folder in folders), strict=False)]
    named = [*map(_common, parts)]
    return f": {Path(*named)}/" if named else ""


def _common(names: set[str]) -> str:
    """Returns a name of several folders, as batch_* of batches."""
    if len(names) == 1:
        return names.pop()
    begins = {name.rpartition("_")[0] for name in names}
    return f"{begins.pop()}_*" if len(begins) == 1 and "" not in begins else "*"


def compile_json(report: CompileReport) -> dict[str, object]:
    """The report for scripts."""
    return {
        "out": str(report.out),
        "batches": list(report.batches),
        "unchanged": report.unchanged,
        "failed": report.failed,
        "attempts": report.attempts,
        "seconds": report.seconds,
        "strays": list(report.strays),
        "steps": {"made": report.made, "taken": report.taken},
    }


def render_json(report: RenderReport) -> dict[str, object]:
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
