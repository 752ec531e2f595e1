"""Prints what ``scenec check`` finds in datasets: are they as written, are two the same."""

from __future__ import annotations

from pathlib import Path

from scenec.api.check import CheckReport
from scenec.cli.output import print_json
from scenec.datasets.verify import Comparison, is_dataset

_LISTED = 20


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
        _print_comparison(compared)
    return 0 if report.sound else 1


def _print_comparison(comparison: Comparison) -> None:
    for what, names in (
        ("annotation differs", comparison.differing),
        ("only in the first", comparison.only_first),
        ("only in the second", comparison.only_second),
        ("cannot be read", comparison.unreadable),
        ("holds other things", comparison.held),
    ):
        for name in names[:_LISTED]:
            print(f"error: {name} [{what}]")
        if len(names) > _LISTED:
            print(f"error: and {len(names) - _LISTED:,} more [{what}]")
    equal = comparison.frames - len(comparison.differing)
    print(f"annotation: the same in {equal:,} of {comparison.frames:,} common frames")
    if comparison.pictures_same or comparison.pictures_differing:
        text = f"pictures: {comparison.pictures_same:,} with the same bytes"
        if comparison.pictures_differing:
            text += f", {comparison.pictures_differing:,} with others"
        if comparison.mean_difference:
            mean = sum(comparison.mean_difference) / len(comparison.mean_difference)
            error = sum(comparison.relative_mse) / len(comparison.relative_mse)
            text += (
                f" (8-bit values differ by {mean:.3g} in the mean, at most "
                f"{max(comparison.mean_difference):.3g} in one picture; relMSE {error:.3g})"
            )
        print(text)
    print("the same dataset" if comparison.same else "not the same dataset")
