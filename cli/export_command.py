"""``scenec export``: frames to a dataset."""

from __future__ import annotations

import argparse
import textwrap
from dataclasses import asdict

from scenec.api.export import export
from scenec.api.models import ModelsReport
from scenec.api.options import ExportOptions
from scenec.cli.arguments import chosen
from scenec.cli.output import print_json, say, say_next
from scenec.cli.terminal import Terminal
from scenec.datasets import maps, tracks
from scenec.datasets.export import ExportReport
from scenec.datasets.formats.registry import find_format, format_names
from scenec.datasets.maps import MAP
from scenec.datasets.models import MODEL_FORMATS, TEXELS
from scenec.datasets.tracks import TAPVID
from scenec.schemas.errors import OutputError

_TEXELS = {"texels": (str(TEXELS), "of all pictures of the ground of a batch together")}
#: Formats that hold stages -> what they are; option -> its default and help.
_OF_STAGES = {name: (summary, _TEXELS) for name, summary in MODEL_FORMATS.items()}
_OF_STAGES[MAP] = maps.SUMMARY, maps.SETTINGS
_OF_STAGES[TAPVID] = tracks.SUMMARY, tracks.SETTINGS


def run(options: argparse.Namespace) -> int:
    """Exports, or lists what there is to export to."""
    if options.list:
        _list(options.json)
        return 0
    if options.out is None:
        raise OutputError("say what to export: scenec export OUT --format NAME")
    if options.format is None:
        raise OutputError(
            f"say to which format: --format {'|'.join([*format_names(), *_OF_STAGES])} "
            "(scenec export --list)"
        )
    asked = chosen(ExportOptions, options)
    report = export(options.out, options.format, **asked, listener=Terminal())
    if isinstance(report, ModelsReport):
        if options.json:
            print_json({"folder": str(report.folder), **report.content})
        _print_models(report)
        say_next(("explain", options.out))
        return 0
    if options.json:
        print_json(as_json(report))
    _print_report(report)
    return 0


def _print_models(report: ModelsReport) -> None:
    for line in report.losses:
        say(f"not in it: {line}")
    for file in report.files if report.format in MODEL_FORMATS else ():
        say(f"{report.format}: {file} ({file.stat().st_size / 1e6:.1f} MB)")
    if report.format == MAP:
        size = sum(file.stat().st_size for file in report.files)
        say(f"{len(report.files)} files of maps and tables ({size / 1e6:.1f} MB)")
        say(f"maps: {report.folder}/ (a look at all: {report.folder}/BATCH/map.png)")
    if report.format == TAPVID:
        _print_tracks(report)


def _print_tracks(report: ModelsReport) -> None:
    cameras = [one for b in report.content["batches"].values() for one in b["cameras"].values()]
    tracks, visible, undecided = (
        sum(one[name] for one in cameras) for name in ("tracks", "visible", "undecided")
    )
    places = sum(one["tracks"] * one["frames"] for one in cameras)
    say(
        f"{tracks:,} points of {len(cameras):,} camera(s), {places:,} places, {visible:,} seen, "
        f"{undecided:,} of these within rounding alone"
    )
    say(f"point tracks: {report.folder}/")


def _print_report(report: ExportReport) -> None:
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
                name: {
                    "summary": summary,
                    "needs": [],
                    "options": {
                        option: {"default": default, "choices": [], "help": text}
                        for option, (default, text) in options.items()
                    },
                }
                for name, (summary, options) in _OF_STAGES.items()
            }
        )
        return
    for kind in formats:
        print(f"{kind.name:<12}{kind.summary}")
        for name, option in kind.options.items():
            value = "|".join(option.choices) if option.choices else "VALUE"
            _list_option(name, value, option.default, option.help)
    for name, (summary, options) in _OF_STAGES.items():
        print(f"{name:<12}{summary}")
        for option_name, (default, text) in options.items():
            _list_option(option_name, "VALUE", default, text)


def _list_option(name: str, value: str, default: str, text: str) -> None:
    print(f"    --set {name}={value}")
    text += f" (default: {default})" if default else ""
    print(textwrap.indent(textwrap.fill(text, 88), " " * 12))
