"""``scenec check``: files, stages, frames, exactness, and whether backends agree."""

from __future__ import annotations

import argparse
import math
from pathlib import Path

from scenec.api.check import check
from scenec.api.options import CheckOptions
from scenec.api.text import table
from scenec.backends.check.compare import Agreement
from scenec.backends.check.radiance import RadianceComparison
from scenec.backends.check.witness import HAIR_PIXELS
from scenec.cli.arguments import chosen
from scenec.cli.output import print_json, say_next
from scenec.cli.terminal import Terminal


def run(options: argparse.Namespace) -> int:
    """Checks; 1 if something is wrong."""
    out = Path(options.out)
    found = check(out, **chosen(CheckOptions, options), listener=Terminal())
    if found.is_dataset:
        from scenec.cli import check_dataset

        return check_dataset.tell(out, found, as_json=options.json)
    if options.json:
        print_json(found.as_json())
        return 0 if found.sound else 1
    print(found)
    for agreement in (found.agreement, found.exact):
        if agreement:
            print_agreement(agreement)
    if not found.errors:
        say_next(("view", out), ("export --format coco", out))
    return 0 if found.sound else 1


def print_agreement(agreement: Agreement) -> None:
    """Tables: annotation on disk, what renderers themselves see, radiance."""
    rows = [
        [c.backend, c.channel, f"{c.differing:,}", f"{c.pixels:,}"] for c in agreement.comparisons
    ]
    if rows:
        print(f"\nannotation of {agreement.frames} frames against the exact caster:")
        print(table(rows, ["backend", "channel", "differing", "pixels"]))
    seen = [
        [name, f"{w.differing:,}", f"{w.farthest_px:.2g}", f"{w.beyond:,}", f"{w.pixels:,}"]
        for name, w in agreement.witnesses.items()
    ]
    if seen:
        print("\nwhat renderers themselves see, against the exact caster:")
        header = ["backend", "other face", "farthest, px", f"beyond {HAIR_PIXELS:.3g} px", "pixels"]
        print(table(seen, header))
    for name, witness in agreement.witnesses.items():
        if witness.unseen:
            print(f"{name} does not tell what it sees of {witness.unseen} frames")
        if witness.dependent:
            print(
                f"{name} has no independent witness of {witness.dependent} frames: it keeps their "
                "instances, and the exact caster casts its rays; another backend's picture has one"
            )
    if agreement.radiance:
        print("\nradiance of surfaces (rgb):")
        header = ["backends", "mean ratio R", "G", "B", "relMSE", "of it noise", "FLIP", "floor"]
        print(table([_radiance_row(r) for r in agreement.radiance], header))
        if any(math.isnan(v) for r in agreement.radiance for v in r.flip):
            print("FLIP is not installed; mend it with: pip install 'scenec[flip]'")
    if agreement.pictures:
        print(f"\nwhere they differ: {len(agreement.pictures)} pictures in "
              f"{agreement.pictures[0].parent}/")  # fmt: skip


def _radiance_row(r: RadianceComparison) -> list[str]:
    ratios = ["-" if ratio is None else f"{ratio:.4f}" for ratio in r.mean_ratio]
    numbers = [_mean(r.relative_mse), _mean(r.noise), _mean(r.flip), _mean(r.floor)]
    return [f"{r.first} : {r.second}", *ratios, *numbers]


def _mean(values: list[float]) -> str:
    if not values:
        return "-"
    mean = sum(values) / len(values)
    return "unknown" if math.isnan(mean) else f"{mean:.3g}"
