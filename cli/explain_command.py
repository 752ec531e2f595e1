"""``scenec explain``: errors, costs, what was left out, and why one thing is there or not."""

from __future__ import annotations

import argparse
import shutil
from pathlib import Path
from typing import Any

from scenec.api.explain.data import BatchData, read_batches
from scenec.api.explain.left_out import as_json, kept_of, left_out_of, left_out_text, rates_of
from scenec.api.explain.passes import frames_text, passes_text, rows_of
from scenec.api.explain.stage import read_contents
from scenec.cli.output import print_json, say_next

#: Columns of what is printed, where a terminal does not say otherwise.
_WIDTH, _NARROWEST = 100, 80


def run(options: argparse.Namespace) -> int:
    """Prints the reports of all batches, or one answer, or what a scene's ladders measure."""
    if options.ladder:
        from scenec.cli.explain_ladder import run as run_ladder

        return run_ladder(options)
    if options.why is not None:
        from scenec.api.explain.why import why

        answer = why(Path(options.out), options.why, options.batch)
        if options.json:
            print_json(answer.as_json())
        else:
            print(answer.text)
        return 0
    batches = read_batches(Path(options.out), None if options.batch is None else [options.batch])
    if options.json:
        print_json(
            {
                "reports": {batch.name: batch.report for batch in batches},
                "seconds": {batch.name: batch.seconds for batch in batches if batch.seconds},
                "batches": {batch.name: _as_json(batch) for batch in batches},
            }
        )
        return 0
    width = max(min(shutil.get_terminal_size((_WIDTH, 24)).columns, _WIDTH), _NARROWEST)
    print("\n\n".join(explained(batch, width) for batch in batches))
    say_next(("explain --why CLASS/NUMBER", options.out))
    return 0


def explained(batch: BatchData, width: int = _WIDTH) -> str:
    """All there is to say of a batch.

    Args:
        batch: The batch.
        width: Columns that lines may have.

    Raises:
        StageError: Its stage cannot be read.
    """
    contents = read_contents(batch.stage)
    rates = rates_of(batch, contents)
    left = left_out_of(batch.report, rates)
    parts = [
        f"{batch.name}: {kept_of(batch.report, contents, left).text}",
        left_out_text(left, rates, width),
        passes_text(rows_of(batch.report, batch.seconds), width),
        frames_text(batch.frames) if batch.frames else "",
    ]
    return "\n\n".join(part for part in parts if part)


def _as_json(batch: BatchData) -> dict[str, Any]:
    """What is kept and left out, for scripts."""
    contents = read_contents(batch.stage)
    left = left_out_of(batch.report, rates_of(batch, contents))
    kept = kept_of(batch.report, contents, left)
    return {
        "kept": {name: {"kept": part, "of": whole} for name, (part, whole) in vars(kept).items()},
        "left_out": as_json(left),
    }
