"""``scenec import``."""

from __future__ import annotations

import argparse
from pathlib import Path

from scenec.api.make import ImportOptions, import_scene
from scenec.cli.arguments import chosen
from scenec.cli.output import print_json, say, say_next
from scenec.cli.terminal import Terminal
from scenec.importers.report import Report
from scenec.schemas.errors import OutputError
from scenec.schemas.files import atomic, write_json


def run(options: argparse.Namespace) -> int:
    """Imports, writes the cfg, and says what became of what was read.

    Raises:
        CfgError: All that is wrong with the source; nothing is written.
        OutputError: The cfg is there already, or cannot be written.
    """
    out, report = Path(options.output), Path(options.report) if options.report else None
    if report is not None and report.exists():
        raise OutputError(f"{report}: is there already; choose another name by --report")
    imported = import_scene(
        options.format, options.source, out, **chosen(ImportOptions, options), listener=Terminal()
    )
    if report is not None:
        _write_report(report, imported.report)
    if options.json:
        print_json({"cfg": str(out), **imported.report.as_json()})
    elif report is None:
        print(imported.report.text())
    counts = ", ".join(f"{n} {fate}" for fate, n in imported.report.counts().items())
    say(f"{out} written: {counts}")
    words = " ".join(["run", *imported.options, "-o OUT"])
    say_next((words, out))
    return 0


def _write_report(file: Path, report: Report) -> None:
    if file.suffix.lower() == ".json":
        write_json(file, report.as_json())
        return
    with atomic(file) as temporary:
        temporary.write_text(report.text() + "\n", encoding="utf-8")
