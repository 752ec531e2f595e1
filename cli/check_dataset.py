"""What ``scenec check`` says of datasets: are they as they were written, are two the same."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path

from scenec.api.check import CheckReport
from scenec.cli.output import print_json
from scenec.datasets.verify import Comparison, is_dataset

_LISTED = 20


def tell(folder: Path, found: CheckReport, *, as_json: bool) -> int:
    """Prints what was found; 1 if something is wrong, or not the same."""
    compared = found.compared
    if as_json:
        print_json(
            {
                "flaws": [asdict(flaw) for flaw in found.flaws],
                "against": None
                if compared is None
                else {"same": compared.same, **asdict(compared)},
            }
        )
        return 0 if found.sound else 1
    for flaw in found.flaws:
        print(flaw)
    if is_dataset(folder):
        print(f"{len(found.flaws)} errors in the dataset")
    if compared is not None:
        _tell(compared)
    return 0 if found.sound else 1


def _tell(found: Comparison) -> None:
    for what, names in (
        ("annotation differs", found.differing),
        ("only in the first", found.only_first),
        ("only in the second", found.only_second),
        ("cannot be read", found.unreadable),
        ("holds other things", found.held),
    ):
        for name in names[:_LISTED]:
            print(f"error: {name} [{what}]")
        if len(names) > _LISTED:
            print(f"error: and {len(names) - _LISTED:,} more [{what}]")
    equal = found.frames - len(found.differing)
    print(f"annotation: the same in {equal:,} of {found.frames:,} common frames")
    if found.pictures_same or found.pictures_differing:
        text = f"pictures: {found.pictures_same:,} with the same bytes"
        if found.pictures_differing:
            text += f", {found.pictures_differing:,} with others"
        if found.mean_difference:
            mean = sum(found.mean_difference) / len(found.mean_difference)
            error = sum(found.relative_mse) / len(found.relative_mse)
            text += (
                f" (8-bit values differ by {mean:.3g} in the mean, at most "
                f"{max(found.mean_difference):.3g} in one picture; relMSE {error:.3g})"
            )
        print(text)
    print("the same dataset" if found.same else "not the same dataset")
