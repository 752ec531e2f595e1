"""Prints what ``scenec check`` finds in datasets: are they as written, are two the same."""

from __future__ import annotations

from pathlib import Path

from scenec.api.check import CheckReport
from scenec.api.check_text import comparison_lines
from scenec.cli.output import print_json
from scenec.datasets.verify import is_dataset


def tell(folder: Path, report: CheckReport, *, as_json: bool) -> int:
    """Prints what was found; 1 if something is wrong, or not the same."""
    compared = report.compared
    if as_json:
        print_json(report.as_json())
        return 0 if report.sound else 1
    for flaw in report.flaws:
        print(flaw)
    if is_dataset(folder):
        print(f"{len(report.flaws)} errors in the dataset")
    if compared is not None:
        print(*comparison_lines(compared), sep="\n")
    return 0 if report.sound else 1
