"""``scenec explain``: errors, costs, and what was left out."""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

from scenec.cli.output import print_json, table
from scenec.schemas.errors import OutputError
from scenec.schemas.manifest import REPORT, TIMINGS, read_manifest


def run(options: argparse.Namespace) -> int:
    """Prints the reports of all batches."""
    out = Path(options.out)
    manifest = read_manifest(out)
    timings = _read(out / TIMINGS).get("compile", {}) if _has(out, TIMINGS) else {}
    reports = {b["path"]: _read(out / b["path"] / REPORT) for b in manifest["batches"]}
    if options.json:
        print_json({"reports": reports, "seconds": timings})
        return 0
    for name, report in reports.items():
        print(f"{name}: {report['bytes'] / 2**20:.1f} MiB")
        print(_errors(report, timings.get(name, {})))
        left_out = report.get("left_out", [])
        print("left out:" if left_out else "left out: nothing")
        for entry in left_out:
            print(f"  {entry['what']}: {entry['why']}")
    return 0


def _has(out: Path, name: str) -> bool:
    return (out / name).is_file()


def _read(path: Path) -> dict[str, Any]:
    try:
        value = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise OutputError(f"{path}: cannot be read: {error}") from error
    if not isinstance(value, dict):
        raise OutputError(f"{path}: expected a JSON object")
    return value


def _errors(report: dict[str, Any], seconds: dict[str, float]) -> str:
    """One row a pass: its error in metres (or what it counts) beside its run time."""

    def cost(name: str) -> str:
        return f"{seconds[name]:.3f}" if name in seconds else "?"

    rows = []
    for step in report["relief"]:
        rest = ", ".join(f"{key} {_short(value)}" for key, value in step.items() if key != "type")
        rows.append([f"relief: {step['type']}", rest, ""])
    rows.append(["relief, all steps", "", cost("relief")])
    for i, cut in enumerate(report["ground"]["cuts"], start=1):
        chord = f"{cut['chord_error_rms_m']:.2g} m rms, {cut['chord_error_max_m']:.2g} m worst"
        rows.append([f"label line {i}", f"chord error {chord}", ""])
    ground = report["ground"]
    rows.append(
        [
            "ground mesh",
            f"{ground['faces']:,} faces, float32 error {ground['float32_error_max_m']:.2g} m",
            cost("ground"),
        ]
    )
    for name, entry in report.get("objects", {}).items():
        rows.append(
            [
                f"objects: {name}",
                f"{entry['count']:,} of {entry['triangles']:,} triangles, "
                f"float32 error {entry['float32_error_max_m']:.2g} m",
                cost(f"objects/{name}"),
            ]
        )
    rows.extend([name, "", cost(name)] for name in ("light", "cameras", "emit"))
    return table(rows, ["pass", "error", "seconds"])


def _short(value: object) -> str:
    return f"{value:.3g}" if isinstance(value, float) else str(value)
