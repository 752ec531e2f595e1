"""``scenec export``: frames to a dataset."""

from __future__ import annotations

import argparse
import os
import textwrap
from dataclasses import asdict

from scenec.backends.run.executors import make_executor
from scenec.cli.output import Progress, print_json, say, say_next
from scenec.datasets.export import Choice, ExportReport, export
from scenec.datasets.filters import make_filters
from scenec.datasets.formats.registry import find_format, format_names
from scenec.datasets.models import MODEL_FORMATS, TEXELS
from scenec.datasets.remap import Remap, read_remap
from scenec.datasets.splits import parse_splits
from scenec.schemas.errors import OutputError

#: Of the formats that hold stages.
_TEXELS_OPTION = {
    "default": str(TEXELS),
    "choices": [],
    "help": "of all pictures of the ground of a batch together",
}


def run(options: argparse.Namespace) -> int:
    """Exports, or lists what there is to export to."""
    if options.list:
        _list(options.json)
        return 0
    if options.out is None:
        raise OutputError("say what to export: scenec export OUT --format NAME")
    if options.format is None:
        raise OutputError(
            f"say to which format: --format {'|'.join([*format_names(), *MODEL_FORMATS])} "
            "(scenec export --list)"
        )
    if options.format in MODEL_FORMATS:
        from scenec.cli import export_models

        return export_models.run(options)
    workers = options.workers if options.workers is not None else os.process_cpu_count()
    with make_executor(workers, options.cluster) as executor:
        report = export(
            options.out,
            options.format,
            options.output,
            _choice(options),
            executor=executor,
            replace=options.replace,
            progress=Progress("exported", unit="step", every_s=2.0),
            say=say,
        )
    if options.json:
        print_json(as_json(report))
    _tell(report)
    return 0


def _choice(options: argparse.Namespace) -> Choice:
    settings: dict[str, str] = {}
    for text in options.set:
        name, equals, value = text.partition("=")
        if not equals:
            raise OutputError(f"--set {text!r}: expected NAME=VALUE")
        settings[name.strip()] = value.strip()
    return Choice(
        backend=options.backend,
        batches=options.batches,
        cameras=options.cameras,
        samples=options.samples,
        filters=make_filters(options.keep, options.rejected),
        remap=read_remap(options.remap) if options.remap else Remap(),
        splits=parse_splits(options.split) if options.split else {},
        split_seed=options.split_seed,
        level=options.level,
        options=settings,
        faults=options.faults,
    )


def _tell(report: ExportReport) -> None:
    if report.there:
        say("the dataset is there already, made of the same frames in the same way")
    splits = ", ".join(f"{name} {count:,}" for name, count in report.splits.items())
    tally = report.tally
    text = f"{report.frames:,} frames ({splits})"
    if tally.seen:
        text += f", {tally.kept:,} instances"
        rejected = [f"{name}: {count:,}" for name, count in tally.rejected.items()]
        if rejected:
            text += f" of {tally.seen:,} (rejected by {', '.join(rejected)})"
    for what, number in report.held.items():
        text += f", {number:,} {what}"
    say(text)
    if report.there:
        # A new export says so where it happens.
        for what, number in report.left_out.items():
            say(f"left out: {number:,} {what}")
    if report.passes_left_out:
        say(
            f"format {report.format} has no place for the passes "
            f"{', '.join(report.passes_left_out)} of these frames"
        )
    if report.faults:
        say(f"{len(report.faults)} frames were left out, see {report.folder}/export.json")
    say(f"dataset: {report.folder}/ (what it is: {report.folder}/README.md)")
    say_next(("check", report.folder))


def as_json(report: ExportReport) -> dict[str, object]:
    """The report for scripts."""
    return {
        "folder": str(report.folder),
        "format": report.format,
        "frames": report.frames,
        "splits": report.splits,
        "instances": {
            "seen": report.tally.seen,
            "kept": report.tally.kept,
            "rejected": report.tally.rejected,
        },
        "faults": [
            {"frame": fault.name, "kind": fault.kind, "message": fault.message}
            for fault in report.faults
        ],
        "held": report.held,
        "left_out": report.left_out,
        "passes_left_out": report.passes_left_out,
        "narrowed": {what: asdict(one) for what, one in report.narrowed.items()},
        "steps_resumed": report.resumed,
        "there_already": report.there,
        "annotation_sha256": report.digest,
    }


def _list(as_json: bool) -> None:
    formats = [find_format(name) for name in format_names()]
    if as_json:
        print_json(
            {
                kind.name: {
                    "summary": kind.summary,
                    "needs": list(kind.needs),
                    "options": {
                        name: {"default": o.default, "choices": list(o.choices), "help": o.help}
                        for name, o in kind.options.items()
                    },
                }
                for kind in formats
            }
            | {
                name: {"summary": summary, "needs": [], "options": {"texels": _TEXELS_OPTION}}
                for name, summary in MODEL_FORMATS.items()
            }
        )
        return
    for kind in formats:
        print(f"{kind.name:<12}{kind.summary}")
        for name, option in kind.options.items():
            value = "|".join(option.choices) if option.choices else "VALUE"
            default = f" (default: {option.default})" if option.default else ""
            head = f"    --set {name}={value}"
            print(head)
            print(textwrap.indent(textwrap.fill(option.help + default, 88), " " * 12))
    for name, summary in MODEL_FORMATS.items():
        print(f"{name:<12}{summary}")
        print("    --set texels=VALUE")
        print(f"            {_TEXELS_OPTION['help']} (default: {TEXELS})")
