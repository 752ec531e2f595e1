"""``scenec compile``."""

from __future__ import annotations

import argparse
import math
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING

from scenec.cli.output import Progress, print_json, say, say_next, status, warn

if TYPE_CHECKING:
    from scenec.compiler.cfg.load import Spec
    from scenec.compiler.compile import CompileReport

#: What a file of heights says of its numbers where they are meters.
_HEIGHTS = {"scale": 1.0, "offset": 0.0, "unit_m": 1.0}
#: Steps of a batch that are named with ``--verbose``.
_SLOWEST = 5


def run(options: argparse.Namespace) -> int:
    """Compiles."""
    status(f"reading {options.cfg}")
    report = compile_now(options)
    if options.json:
        print_json(as_json(report))
    say_next(("render", report.out), ("explain", report.out))
    return 1 if report.failed else 0


def compile_now(options: argparse.Namespace, spec: Spec | None = None) -> CompileReport:
    """Compiles and prints the report; a cfg that has been read is not read again."""
    # Here: importing these takes time, in which a line is read already. What is wrong with a cfg is
    # told before the rest is imported.
    from scenec.compiler.cfg.load import load

    spec = warn(spec or load(options.cfg, options.settings))
    from scenec.compiler.compile import compile_cfg
    from scenec.compiler.kinds.table import CHOICES
    from scenec.compiler.views.needed import Keep

    cache = cache_of(options)
    bar = Progress("compiled", unit="batch", units="batches")

    def tell(text: str, place: tuple[int, int] | None) -> None:
        if place is None:
            say(text)
        else:
            bar.now(*place, text)

    with ExitStack() as stack:
        executor = None
        if options.workers or options.cluster:
            from scenec.backends.run.executors import make_executor

            executor = stack.enter_context(make_executor(options.workers, options.cluster))
        report = compile_cfg(
            spec,
            seed=options.seed,
            out=options.out,
            batches=options.batches,
            keep=Keep(options.keep),
            progress=tell,
            cache=cache,
            replace=options.replace,
            faults=options.faults,
            executor=executor,
        )
    from scenec.api.explain.passes import precision_text
    from scenec.compiler.mesh.precision import WARN_PX

    for name, seconds in report.seconds.items():
        facts = report.facts[name]
        objects = sum(entry["count"] for entry in facts.get("objects", {}).values())
        spared = sum(entry["instances"] for entry in facts.get("left_out", []))
        less = f" ({spared:,} left out)" if spared else ""
        say(
            f"{name}: {facts['ground']['faces']:,} terrain faces, {objects:,} objects{less}, "
            f"{facts['bytes'] / 2**20:.1f} MiB"
        )
        if options.verbose:
            slowest = sorted(seconds.items(), key=lambda item: -item[1])[:_SLOWEST]
            steps = ", ".join(f"{step} {spent:.2g} s" for step, spent in slowest)
            say(
                f"{name}: {sum(seconds.values()):.1f} s ({steps}); positions in float32: "
                f"{precision_text(facts['precision'])}"
            )
        off = facts["precision"]["float32_error_max_px"]
        if off is not None and off > WARN_PX:
            say(
                f"{name}: warning: float32 moves vertices by up to {off:.2g} pixels of the nearest "
                f"view, over {facts['precision']['extent_m']:g} m; make the terrain smaller, or "
                "keep cameras farther from it"
            )
        for place, entry in enumerate(facts["relief"]):
            if entry["type"] not in CHOICES["relief"].kinds:
                # Of another package: it reports what it likes.
                continue
            read = tuple(entry.get(key, rest) for key, rest in _HEIGHTS.items())
            if read != tuple(_HEIGHTS.values()):
                say(
                    f"{name}: /terrain/relief/{place} (dem): heights are (sample * {read[0]:g} + "
                    f"{read[1]:g}) * {read[2]:.9g} m of band {entry['band']}"
                )
            if entry.get("error_rms_m", 0.0) > entry.get("error_aim_m", math.inf):
                say(
                    f"{name}: warning: /terrain/relief/{place} ({entry['type']}) errs by about "
                    f"{entry['error_rms_m']:.2g} m rms after {entry['steps']:,} steps, its aim is "
                    f"{entry['error_aim_m']:.2g} m; raise steps, or error_m"
                )
    for name, attempts in report.attempts.items():
        say(f"{name}: drawn again {attempts} times, since it could not be built")
    if report.failed:
        say(
            f"{len(report.failed)} of {len(report.failed) + len(report.batches)} batches cannot be "
            f"built: {', '.join(report.failed)}"
        )
    for line in report.strays:
        say(f"warning: {line}")
    if report.unchanged:
        say(
            f"{report.unchanged} of {len(report.batches)} batches were there already, byte for byte"
        )
    made, taken = (
        sum(sum(one.values()) for one in all_.values()) for all_ in (report.made, report.taken)
    )
    if taken:
        say(f"{taken} of {made + taken} steps were taken from the cache, {cache}")
    say(f"stages: {report.out}/batch_*/stage.usda")
    return report


def cache_of(options: argparse.Namespace) -> Path | None:
    """The folder that the options and the environment name; None: there shall be none."""
    from scenec.compiler.cache.store import default_folder

    if options.no_cache:
        return None
    return default_folder() if options.cache is None else Path(options.cache)


def as_json(report: CompileReport) -> dict[str, object]:
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
