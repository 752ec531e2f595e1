"""``scenec explain``: errors, costs, and what was left out."""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

from scenec.cli.output import print_json, table
from scenec.schemas.errors import OutputError
from scenec.schemas.manifest import FRAMES, REPORT, TIMINGS, read_manifest


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
        try:
            text = _errors(report, timings.get(name, {}))
            size = report["bytes"] / 2**20
        except (KeyError, TypeError, AttributeError) as error:
            raise OutputError(f"{out / name / REPORT}: is no report of a compile") from error
        print(f"{name}: {size:.1f} MiB")
        print(text)
        frames = _frames(out / name)
        if frames:
            print(frames)
        left_out = [*report.get("left_out", []), *_left_out(report)]
        print("left out:" if left_out else "left out: nothing")
        for entry in left_out:
            size = f" ({entry['bytes']:,} bytes)" if entry.get("bytes") else ""
            print(f"  {entry['what']}: {entry['why']}{size}")
    return 0


def _left_out(report: dict[str, Any]) -> list[dict[str, str]]:
    """What of the models' files has no place in the stage."""
    return [
        {
            "what": note,
            "why": f"of a model of objects/{name}; the surface model has no place for it",
        }
        for name, entry in report.get("objects", {}).items()
        for note in entry.get("left_out", [])
    ]


def _frames(folder: Path) -> str:
    """Per backend: seconds of each step of a frame, and the estimated error of rgb."""
    rows = []
    for backend in sorted(path for path in (folder / FRAMES).glob("*") if path.is_dir()):
        sidecars = [_read(path) for path in sorted(backend.glob("*/*.json"))]
        if not sidecars:
            continue
        steps = {step for sidecar in sidecars for step in sidecar.get("seconds", {})}
        costs = [
            f"{step} {sum(s.get('seconds', {}).get(step, 0.0) for s in sidecars):.2f}"
            for step in sorted(steps)
        ]
        found = [s["estimated_error"]["relative_rms"] for s in sidecars if "estimated_error" in s]
        errors = [value for value in found if value is not None]
        error = f"{100 * sum(errors) / len(errors):.1f} %" if errors else ""
        rows.append([backend.name, str(len(sidecars)), error, ", ".join(costs)])
    header = ["frames of", "number", "mean error of rgb", "seconds in all"]
    return table(rows, header) if rows else ""


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
    """One row a pass: its error in meters (or what it counts) beside its run time."""

    def cost(name: str) -> str:
        return f"{seconds[name]:.3f}" if name in seconds else "?"

    rows = []
    for step in report["relief"]:
        rest = ", ".join(f"{key} {_short(value)}" for key, value in step.items() if key != "type")
        rows.append([f"relief: {step['type']}", rest, ""])
    rows.append(["relief, all steps", "", cost("relief")])
    for layer in report.get("cover", []):
        rest = f"covers {100 * layer['covers']:.3g} %, shows on {100 * layer['shows']:.3g} %"
        for condition in layer["conditions"]:
            rest += f"; {condition['type']} holds on {100 * condition['holds']:.3g} %"
            if condition.get("smoothed_over_m"):
                rest += f" (smoothed over {_short(condition['smoothed_over_m'])} m)"
        rows.append([f"ground layer {layer['layer']}", rest, ""])
    if "cover" in seconds:
        rows.append(["ground layers, all", "", cost("cover")])
    for i, cut in enumerate(report["ground"]["cuts"], start=1):
        chord = (
            f"{cut['chord_error_rms_m']:.2g} m rms, {cut['chord_error_max_m']:.2g} m worst, "
            f"snapped {cut['snap_max_m']:.2g} m"
        )
        rows.append([f"label line {i}", f"chord error {chord}", ""])
    ground = report["ground"]
    rows.append(
        [
            "ground mesh",
            f"{ground['faces']:,} faces, float32 error {ground['float32_error_max_m']:.2g} m",
            cost("ground"),
        ]
    )
    if "mesh" in ground:
        rows.extend([name, error, ""] for name, error in _mesh_errors(ground["mesh"]))
    for name, entry in report.get("objects", {}).items():
        rows.append([f"objects: {name}", _objects(entry), cost(f"objects/{name}")])
    budget = report.get("object_budget")
    if budget:
        text = f"{budget['max_triangles']:,} triangles at most: "
        factor = budget["error_factor"]
        text += "kept as it is" if factor == 1.0 else f"errors up to {factor:.3g} times lod_px"
        rows.append(["objects, all", text, ""])
    if "precision" in report:
        rows.append(["positions in float32", precision_text(report["precision"]), ""])
    for name, entry in report.get("sky", {}).get("set_to_zero", {}).items():
        part = f"{100 * entry['negative_fraction']:.2g} % below 0 set to 0"
        rows.append([f"sky: {name}", part, ""])
    others = ("load", "draw", "light", "cameras", "emit")
    rows.extend([name, "", cost(name)] for name in others)
    return table(rows, ["pass", "error", "seconds"])


def _objects(entry: dict[str, Any]) -> str:
    """One class: how many, how coarse, how well they sit."""
    text = f"{entry['count']:,} of {entry['triangles']:,} triangles, "
    if "asked_for" in entry:
        text = f"{entry['count']:,} placed of {entry['asked_for']:,} asked for; {text}"
    text += _levels(entry)
    if "gap_max_px" in entry:
        up, down = entry["float_max_m"], entry["sink_max_m"]
        text += f"seated within {up:.2g} m up, {down:.2g} m down ({entry['gap_max_px']:.2g} px), "
    elif "seating_error_max_m" in entry:
        text += f"seated within {entry['seating_error_max_m']:.2g} m, "
    if "moved_off_cameras" in entry:
        text += f"{entry['moved_off_cameras']} moved off cameras, "
    return f"{text}float32 error {entry['float32_error_max_m']:.2g} m"


def _levels(entry: dict[str, Any]) -> str:
    """What levels of detail left out, and how much of it shows."""
    if entry["triangles"] == entry.get("triangles_finest", entry["triangles"]):
        return ""
    return (
        f"{entry['triangles_finest']:,} at the finest level, "
        f"{entry['lod_error_max_px']:.2g} px worst; {entry['lod_px']:g} px asked, "
    )


def _mesh_errors(mesh: dict[str, Any]) -> list[tuple[str, str]]:
    """What the adaptive mesh left out, in pixels of the nearest view."""
    asked = f"{mesh['tolerance_px']:g} px asked"
    if mesh["budget_bound"]:
        asked += f", {mesh['tolerance_reached_px']:.2g} px within max_triangles"
    rows = [("ground mesh, at samples", f"{mesh['height_error_max_px']:.2g} px worst; {asked}")]
    finer = mesh.get("finer")
    if finer:
        error = f"{finer['surface_error_max_px']:.2g} px worst, "
        error += f"{finer['surface_error_rms_px']:.2g} px rms"
        rows.append(("ground mesh, between", f"{error}; legs from {finer['finest_leg_m']:.2g} m"))
    return rows


def precision_text(precision: dict[str, Any]) -> str:
    """Precision promised and error made, in meters and in pixels of the nearest view."""

    def part(meters: float, pixels: float | None) -> str:
        return f"{meters:.2g} m" + ("" if pixels is None else f" ({pixels:.2g} px)")

    promised = part(precision["promised_m"], precision["promised_px"])
    made = part(precision["float32_error_max_m"], precision["float32_error_max_px"])
    return f"promised {promised}, largest error {made}"


def _short(value: object) -> str:
    return f"{value:.3g}" if isinstance(value, float) else str(value)
