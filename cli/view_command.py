"""``scenec view``: one HTML page to look at all frames, or the same in the Rerun viewer."""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from pathlib import Path

from scenec.api.options import ViewOptions
from scenec.api.view import page_of, write_page
from scenec.cli.arguments import given
from scenec.cli.output import print_json, say, say_next
from scenec.cli.terminal import Terminal
from scenec.datasets.view.page import ViewReport
from scenec.datasets.view.watching import sign_of, state_of, write_sign
from scenec.schemas.errors import ScenecError

#: Seconds between two looks at a watched output.
_LOOK_S = 1.0


def run(options: argparse.Namespace) -> int:
    """Writes the page, or logs the frames to Rerun."""
    out = Path(options.out)
    if options.rerun or options.rerun_save:
        return _log_to_rerun(options, out)
    asked = given(ViewOptions, options, listener=Terminal())
    page = page_of(out, asked)
    if options.watch:
        watch(out, asked, opened=not options.open)
        return 0
    report = write_page(out, asked)
    if options.json:
        print_json(_as_json(report))
    else:
        for line in _lines(report):
            print(line)
    if options.open:
        _open(page)
    else:
        say_next(("view --open", out), ("export --format coco", out))
    return 0


def _open(page: Path) -> None:
    import webbrowser

    if not webbrowser.open(page.resolve().as_uri()):
        say(f"no browser here that can be started; open {page} in one")


def watch(
    out: Path,
    asked: ViewOptions,
    opened: bool = True,
    sleep: Callable[[float], None] = time.sleep,
) -> None:
    """Writes the page whenever the output has changed and is at rest, until it is interrupted.

    Args:
        out: The output.
        asked: What is shown.
        opened: Whether a browser shows the page already, or shall not.
        sleep: Waits for so many seconds.
    """
    page = page_of(out, asked)
    shown, before = "", ""
    try:
        while True:
            state = state_of(out)
            # Changed since the page, and no more since the last look.
            if state != shown and state == before:
                shown = state
                try:
                    report = write_page(out, asked, state)
                except ScenecError as error:
                    say(f"waiting: {error}")
                else:
                    write_sign(page, state)
                    say(f"{_lines(report)[0]}, {report.frames} frames; watching, Ctrl-C ends")
                    if not opened:
                        _open(page)
                        opened = True
            before = state
            sleep(_LOOK_S)
    except KeyboardInterrupt:
        # A wish, not a failure.
        return
    finally:
        sign_of(page).unlink(missing_ok=True)


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

    heard = Terminal()
    save = Path(options.rerun_save) if options.rerun_save else None
    report = log_frames(
        out,
        backend=(options.backend or [None])[0],
        save=save,
        faults=options.faults,
        progress=heard.steps("frame"),
        warn=heard.warn,
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
