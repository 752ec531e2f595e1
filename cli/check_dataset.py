"""``scenec check`` of datasets: are they as they were written, do two have the same annotation."""

from __future__ import annotations

import argparse
from dataclasses import asdict
from pathlib import Path

from scenec.cli.output import print_json, say
from scenec.datasets.models.verify import is_models, verify_models
from scenec.datasets.verify import Comparison, Flaw, compare, is_dataset, opened, verify
from scenec.schemas.errors import OutputError

_LISTED = 20


def run(options: argparse.Namespace) -> int:
    """Checks; 1 if something is wrong, or not the same."""
    folder = Path(options.out)
    flaws = []
    if is_models(folder):
        if options.against is not None:
            raise OutputError(f"--against: {folder} holds models of stages, and no annotation")
        flaws = verify_models(folder)
    elif is_dataset(folder):
        flaws = verify(folder) or _opened(folder)
    compared = None if options.against is None else compare(folder, Path(options.against), say)
    if options.json:
        print_json(
            {
                "flaws": [asdict(flaw) for flaw in flaws],
                "against": None
                if compared is None
                else {"same": compared.same, **asdict(compared)},
            }
        )
    else:
        for flaw in flaws:
            print(flaw)
        if is_dataset(folder):
            print(f"{len(flaws)} errors in the dataset")
        if compared is not None:
            _tell(compared)
    return 1 if flaws or (compared is not None and not compared.same) else 0


def _opened(folder: Path) -> list[Flaw]:
    """What the format's own reader finds, where it is installed."""
    try:
        return opened(folder)
    except OutputError as error:
        say(f"not opened by its own reader: {error}")
        return []


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
