"""Writes what an evaluation found as JSON, CSV and plots."""

from __future__ import annotations

from pathlib import Path

from scenec.datasets.evaluate.evaluation import Evaluation
from scenec.schemas.csv_cells import csv_writer, guarded_line
from scenec.schemas.files import atomic, write_json

JSON, CSV = "evaluation.json", "evaluation.csv"
NO_PLOTS = "no plots without matplotlib; mend it with: pip install 'scenec[plots]'"


def write(folder: Path, evaluation: Evaluation) -> None:
    """Write JSON, CSV and, where matplotlib is installed, plots; they are noted in ``evaluation``.

    Raises:
        OutputError: A file cannot be written.
    """
    try:
        from scenec.datasets.evaluate import plots
    except ImportError:
        evaluation.notes.append(NO_PLOTS)
    else:
        evaluation.files += plots.draw(folder, evaluation)
    with atomic(folder / CSV) as temporary, temporary.open("w", newline="", encoding="utf-8") as f:
        writer = csv_writer(f)
        writer.writerow(("table", "row", "measure", "value"))
        writer.writerows(map(guarded_line, evaluation.lines()))
    write_json(folder / JSON, evaluation.as_json())
    evaluation.files += [folder / CSV, folder / JSON]
