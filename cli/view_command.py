"""``scenec view``: one HTML page to look at all frames, or the same in the Rerun viewer."""

from __future__ import annotations

import argparse
import os
from pathlib import Path

from scenec.cli.output import Progress, print_json, say
from scenec.datasets.view.ground import Ground
from scenec.datasets.view.page import ViewReport, write_view
from scenec.schemas.errors import OutputError, ScenecError
from scenec.schemas.manifest import Batch

#: Cells along the longer side of a batch's ground; the page keeps fewer where many batches are.
_CELLS = 512


def run(options: argparse.Namespace) -> int:
    """Writes the page, or logs the frames to Rerun."""
    out = Path(options.out)
    if options.rerun or options.rerun_save:
        return _log_to_rerun(options, out)
    folder = out if out.is_dir() else out.parent
    output = Path(options.output) if options.output else folder / "view.html"
    if output.suffix.lower() not in (".html", ".htm"):
        raise OutputError(f"{output}: the view is an HTML page; end its name in .html")
    report = write_view(
        out,
        output,
        backends=options.backend,
        budget_mb=options.budget_mb,
        workers=options.workers or os.process_cpu_count() or 1,
        faults=options.faults,
        ground=None if options.no_ground else ground_of,
        progress=Progress("frame"),
        warn=lambda line: say(f"warning: {line}"),
    )
    if options.json:
        print_json(_as_json(report))
        return 0
    for line in _lines(report):
        print(line)
    return 0


def ground_of(batch: Batch) -> Ground | None:
    """The ground of a batch from above; None where its stage cannot be read."""
    # Reading stages costs USD and numba: only where it is done.
    from scenec.backends.stage.ground import read_relief

    try:
        relief = read_relief(batch.stage, _CELLS)
    except ScenecError as error:
        say(f"warning: no map of {batch.name}: {error}")
        return None
    return Ground(relief.corner, relief.step, relief.heights, relief.suns)


def _lines(report: ViewReport) -> list[str]:
    fineness = report.fineness
    size = "at full resolution"
    if report.reduced:
        size = f"at most {fineness.side} pixels long ({report.reduced} frames reduced; nearest)"
    lines = [
        f"view: {report.path} ({report.bytes / 1e6:.1f} MB)",
        f"{report.frames} frames, {size}; depth in {fineness.depth_bits} bits, "
        f"off by {100 * report.depth_error:.2g} % at most",
    ]
    if report.faults or report.missing:
        lines.append(
            f"{len(report.faults)} frames cannot be shown, {report.missing} are missing: "
            "the page names them"
        )
    return lines


def _as_json(report: ViewReport) -> dict[str, object]:
    return {
        "page": str(report.path),
        "bytes": report.bytes,
        "frames": report.frames,
        "faults": [
            {"frame": name, "kind": kind, "message": message}
            for name, kind, message in report.faults
        ],
        "missing": report.missing,
        "longest_side": report.fineness.side,
        "frames_reduced": report.reduced,
        "depth_bits": report.fineness.depth_bits,
        "depth_error_max": report.depth_error,
    }


def _log_to_rerun(options: argparse.Namespace, out: Path) -> int:
    from scenec.datasets.recording import log_frames

    save = Path(options.rerun_save) if options.rerun_save else None
    report = log_frames(
        out,
        backend=(options.backend or [None])[0],
        save=save,
        faults=options.faults,
        progress=Progress("frame"),
        warn=lambda line: say(f"warning: {line}"),
    )
    if options.json:
        print_json({"recording": None if save is None else str(save), "frames": report.frames,
                    "faults": report.faults})  # fmt: skip
        return 0
    where = "the Rerun viewer" if save is None else str(save)
    print(f"{report.frames} frames logged to {where}")
    if report.faults:
        print(f"{report.faults} frames could not be read")
    return 0
