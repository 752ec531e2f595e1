"""Puts the comparisons of a check into words."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import TYPE_CHECKING

from scenec.api.text import table
from scenec.backends.check.compare import Agreement
from scenec.backends.check.radiance import RadianceComparison
from scenec.backends.check.witness import HAIR_PIXELS
from scenec.schemas.extras import install

if TYPE_CHECKING:
    from scenec.datasets.verify import Comparison

_LISTED = 20


def agreement_lines(agreement: Agreement) -> Iterator[str]:
    """Yields tables: annotation on disk, what renderers themselves see, radiance."""
    rows = [
        [c.backend, c.channel, f"{c.differing:,}", f"{c.pixels:,}"] for c in agreement.comparisons
    ]
    if rows:
        yield f"\nannotation of {agreement.frames} frames against the exact caster:"
        yield table(rows, ["backend", "channel", "differing", "pixels"])
    seen = [
        [name, f"{w.differing:,}", f"{w.farthest_px:.2g}", f"{w.beyond:,}", f"{w.pixels:,}"]
        for name, w in agreement.witnesses.items()
    ]
    if seen:
        yield "\nwhat renderers themselves see, against the exact caster:"
        header = ["backend", "other face", "farthest, px", f"beyond {HAIR_PIXELS:.3g} px", "pixels"]
        yield table(seen, header)
    for name, witness in agreement.witnesses.items():
        if witness.unseen:
            yield f"{name} does not tell what it sees of {witness.unseen} frames"
        if witness.dependent:
            yield (
                f"{name} has no independent witness of {witness.dependent} frames: it keeps their "
                "instances, and the exact caster casts its rays; another backend's picture has one"
            )
    if agreement.radiance:
        yield "\nradiance of surfaces (rgb):"
        header = ["backends", "mean ratio R", "G", "B", "relMSE", "of it noise", "FLIP", "floor"]
        yield table([_radiance_row(r) for r in agreement.radiance], header)
        if any(math.isnan(v) for r in agreement.radiance for v in r.flip):
            yield f"FLIP is not installed; mend it with: {install('flip')}"
    if agreement.pictures:
        yield (
            f"\nwhere they differ: {len(agreement.pictures)} pictures in "
            f"{agreement.pictures[0].parent}/"
        )


def _radiance_row(r: RadianceComparison) -> list[str]:
    ratios = ["-" if ratio is None else f"{ratio:.4f}" for ratio in r.mean_ratio]
    numbers = [_mean(r.relative_mse), _mean(r.noise), _mean(r.flip), _mean(r.floor)]
    return [f"{r.first} : {r.second}", *ratios, *numbers]


def _mean(values: list[float]) -> str:
    if not values:
        return "-"
    mean = sum(values) / len(values)
    return "unknown" if math.isnan(mean) else f"{mean:.3g}"


def comparison_lines(comparison: Comparison) -> Iterator[str]:
    """Yields what two datasets do not have in common, and whether they are the same."""
    for what, names in (
        ("annotation differs", comparison.differing),
        ("only in the first", comparison.only_first),
        ("only in the second", comparison.only_second),
        ("cannot be read", comparison.unreadable),
        ("holds other things", comparison.held),
    ):
        for name in names[:_LISTED]:
            yield f"error: {name} [{what}]"
        if len(names) > _LISTED:
            yield f"error: and {len(names) - _LISTED:,} more [{what}]"
    equal = comparison.frames - len(comparison.differing)
    yield f"annotation: the same in {equal:,} of {comparison.frames:,} common frames"
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
        yield text
    yield "the same dataset" if comparison.same else "not the same dataset"
