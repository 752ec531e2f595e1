"""``scenec view``: one HTML page to look at all frames, or the same in the Rerun viewer."""

from __future__ import annotations

import argparse
import os
import time
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path

from scenec.backends.run.executors import make_executor
from scenec.cli.output import Progress, print_json, say, say_next
from scenec.datasets.view.ground import Ground
from scenec.datasets.view.page import ViewReport, write_view
from scenec.datasets.view.space import three
from scenec.datasets.view.watching import sign_of, state_of, write_sign
from scenec.schemas.errors import OutputError, ScenecError
from scenec.schemas.manifest import Batch, find_batches

#: Cells along the longer side of a batch's ground; the page keeps fewer where many batches are.
_CELLS = 512
#: Seconds between two looks at a watched output.
_LOOK_S = 1.0
#: Bytes of all batches in three dimensions at most, and the part of the page's budget.
_SPACE_BYTES = 8_000_000
_SPACE_PART = 0.3
#: Of these the library takes so many; a batch with fewer is not worth looking at.
_LIBRARY_BYTES = 650_000
_LEAST_SPACE_BYTES = 400_000
#: Stored bytes of a triangle of the ground, of one of a prototype, of an instance.
_GROUND_BYTES, _OBJECT_BYTES, _INSTANCE_BYTES = 18, 12, 36


def run(options: argparse.Namespace) -> int:
    """Writes the page, or logs the frames to Rerun."""
    out = Path(options.out)
    if options.rerun or options.rerun_save:
        return _log_to_rerun(options, out)
    folder = out if out.is_dir() else out.parent
    output = Path(options.output) if options.output else folder / "view.html"
    if output.suffix.lower() not in (".html", ".htm"):
        raise OutputError(f"{output}: the view is an HTML page; end its name in .html")
    if options.watch:
        _watch(options, out, output)
        return 0
    report = _page(options, out, output)
    if options.json:
        print_json(_as_json(report))
    else:
        for line in _lines(report):
            print(line)
    if options.open:
        _open(output)
    else:
        say_next(("view --open", out), ("export --format coco", out))
    return 0


def _page(options: argparse.Namespace, out: Path, output: Path, watched: str = "") -> ViewReport:
    ground = None
    if not options.no_ground:
        ground = partial(ground_of, rooms=_rooms(out, options.budget_mb))
    workers = options.workers or os.process_cpu_count() or 1
    with make_executor(workers if workers > 1 else 0) as executor:
        return write_view(
            out,
            output,
            backends=options.backend,
            budget_mb=options.budget_mb,
            faults=options.faults,
            ground=ground,
            watched=watched,
            executor=executor,
            progress=Progress("frame"),
            warn=lambda line: say(f"warning: {line}"),
        )


def _open(page: Path) -> None:
    import webbrowser

    if not webbrowser.open(page.resolve().as_uri()):
        say(f"no browser here that can be started; open {page} in one")


def _watch(
    options: argparse.Namespace,
    out: Path,
    output: Path,
    sleep: Callable[[float], None] = time.sleep,
) -> None:
    """Writes the page whenever the output has changed and is at rest, until it is interrupted."""
    shown, before, opened = "", "", False
    try:
        while True:
            state = state_of(out)
            # Changed since the page, and no more since the last look.
            if state != shown and state == before:
                shown = state
                try:
                    report = _page(options, out, output, state)
                except ScenecError as error:
                    say(f"waiting: {error}")
                else:
                    write_sign(output, state)
                    say(f"{_lines(report)[0]}, {report.frames} frames; watching, Ctrl-C ends")
                    if options.open and not opened:
                        _open(output)
                        opened = True
            before = state
            sleep(_LOOK_S)
    except KeyboardInterrupt:
        # A wish, not a failure.
        return
    finally:
        sign_of(output).unlink(missing_ok=True)


def _rooms(out: Path, budget_mb: float) -> dict[int, int]:
    """Bytes that batches may take in three dimensions, by their index; without the others."""
    if three() is None:
        say("no 3D view: three.js comes with trimesh (pip install 'scenec[meshes]')")
        return {}
    batches = [batch.index for batch in find_batches(out)]
    room = min(_SPACE_BYTES, _SPACE_PART * 1e6 * budget_mb) - _LIBRARY_BYTES
    shown = batches[: max(0, int(room / _LEAST_SPACE_BYTES))]
    if len(shown) < len(batches):
        say(f"3D view: of the first {len(shown)} of {len(batches)} batches, which fill its room")
    return {index: int(room / len(shown)) for index in shown}


def ground_of(batch: Batch, rooms: Mapping[int, int]) -> Ground | None:
    """A batch from above, and in three dimensions; None where its stage cannot be read.

    Args:
        batch: Of an output.
        rooms: Bytes that three dimensions may take, by the batch's index; others are without.
    """
    # Reading stages costs USD and numba: only where it is done.
    from scenec.backends.model.collect import coarse_model
    from scenec.backends.stage.ground import relief_of
    from scenec.backends.stage.read import read_stage

    try:
        scene = read_stage(batch.stage)
        relief = relief_of(scene, _CELLS)
        model = None
        if room := rooms.get(batch.index):
            model = coarse_model(
                scene,
                batch.name,
                ground_faces=int(0.4 * room / _GROUND_BYTES),
                object_faces=int(0.2 * room / _OBJECT_BYTES),
                instances=int(0.4 * room / _INSTANCE_BYTES),
            )
    except ScenecError as error:
        say(f"warning: no map of {batch.name}: {error}")
        return None
    return Ground(relief.corner, relief.step, relief.heights, relief.suns, model)


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
