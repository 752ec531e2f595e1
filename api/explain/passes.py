"""Every pass of a compilation: the error of what it approximates, beside what it cost."""

from __future__ import annotations

import re
import textwrap
from collections.abc import Iterator, Mapping
from typing import NamedTuple

from scenec.api.explain.data import FrameTimes
from scenec.api.text import table
from scenec.schemas.codec import JSON
from scenec.schemas.report import (
    BatchReport,
    ClassFacts,
    CoverFacts,
    CutFacts,
    MeshFacts,
    PrecisionFacts,
    PrunedLight,
    PruneFacts,
    SkyFacts,
    SurfaceFacts,
)

#: Steps of a compilation that approximate nothing, after all others.
_PLAIN = ("load", "draw", "light", "cameras", "emit")
#: Units at the end of a fact's name.
_UNITS = {"m3": "m³", "m2": "m²", "m": "m", "px": "px", "deg": "°", "s": "s"}
#: The space between a number and its unit.
_BEFORE_UNIT = re.compile(r"(?<=\d) (?=(?:m³|m²|m|px|%|°|s|x|×)(?:\W|$))|(?<=×) ")


class Row(NamedTuple):
    """One line of the table.

    Attributes:
        name: Of the pass, or of a part of it.
        seconds: What it took; None: a part whose time is in another line, or not known.
        text: Its error, or what it did.
    """

    name: str
    seconds: float | None
    text: str


def rows_of(report: BatchReport, seconds: Mapping[str, float]) -> list[Row]:
    """All passes of a batch.

    Args:
        report: Of the batch.
        seconds: Of each pass, from timings.json.
    """
    left = dict(seconds)

    def row(name: str, text: str, step: str | None = None) -> Row:
        return Row(name, None if step is None else left.pop(step, None), text)

    rows = [row("relief, all steps", "", "relief")]
    rows += [row(f"  {step.type}", _facts(step.facts)) for step in report.relief]
    if "cover" in seconds:
        rows.append(row("ground layers, all", "", "cover"))
    rows += [row(f"  layer {layer.layer}", _cover(layer)) for layer in report.cover]
    ground = report.ground
    error = f"float32 error {_short(ground.float32_error_max_m)} m"
    rows.append(row("ground mesh", f"{ground.faces:,} faces, {error}", "ground"))
    rows += [row(name, text) for name, text in _mesh_errors(ground.mesh)]
    for i, cut in enumerate(ground.cuts, start=1):
        rows.append(row(f"  label line {i}", _cut(cut)))
    for name, entry in report.objects.items():
        rows.append(row(f"objects: {name}", _objects(entry), f"objects/{name}"))
    budget = report.object_budget
    if budget:
        text = f"{budget.max_triangles:,} triangles at most: "
        factor = budget.error_factor
        text += "kept as it is" if factor == 1.0 else f"errors up to {factor:.3g} times lod_px"
        rows.append(row("objects, all", text))
    if report.precision is not None:
        rows.append(row("positions in float32", precision_text(report.precision)))
    rows.append(row("light", "", "light"))
    rows += [row(f"  {name}", text) for name, text in _sky(report.sky)]
    if report.surfaces or "surfaces" in left:
        rows.append(row("materials, all", "", "surfaces"))
    for name, surface in report.surfaces.items():
        rows += [row(f"  {name}{part}", text) for part, text in _surface(surface)]
    for name, facts in report.motion.items():
        rows.append(row(f"motion: {name}", _facts(facts)))
    if report.prune is not None:
        rows += _prune(report.prune, left.pop("prune", None))
    rows += [row(name, "", name) for name in tuple(left) if name not in _PLAIN]
    return rows + [row(name, "", name) for name in _PLAIN if name != "light"]


def passes_text(rows: list[Row], width: int) -> str:
    """The table: passes, seconds, and errors broken into lines that fit.

    Args:
        rows: As ``rows_of`` returns them.
        width: Columns there are.
    """
    first = max(len("pass"), *(len(row.name) for row in rows))
    room = max(width - first - 12, 24)
    lines = [f"{'pass':<{first}}  {'seconds':>8}  error", f"{'-' * first}  {'-' * 8}  {'-' * room}"]
    for row in rows:
        cost = "" if row.seconds is None else f"{row.seconds:.3f}"
        if row.seconds is None and not row.text and not row.name.startswith(" "):
            cost = "?"
        parts = wrapped(row.text, room) or [""]
        lines.append(f"{row.name:<{first}}  {cost:>8}  {parts[0]}".rstrip())
        lines += [" " * (first + 12) + part for part in parts[1:]]
    return "\n".join(lines)


def wrapped(text: str, width: int) -> list[str]:
    """Lines of a text that keep numbers and their units together."""
    whole = _BEFORE_UNIT.sub("\0", text)
    lines = textwrap.wrap(whole, width, break_on_hyphens=False, break_long_words=False)
    return [line.replace("\0", " ") for line in lines]


def frames_text(frames: tuple[FrameTimes, ...]) -> str:
    """Per backend: seconds of each step of its frames, and the estimated error of rgb."""
    steps = sorted({step for one in frames for step in one.seconds})
    rows = []
    for one in frames:
        error = "" if one.error is None else f"{100 * one.error:.1f} %"
        costs = [f"{one.seconds[s]:.2f}" if s in one.seconds else "" for s in steps]
        rows.append([one.backend, str(one.frames), error, *costs])
    return table(rows, ["frames of", "number", "error of rgb", *steps])


def precision_text(precision: PrecisionFacts) -> str:
    """Precision promised and error made, in meters and in pixels of the nearest view."""

    def part(meters: float, pixels: float | None) -> str:
        return f"{meters:.2g} m" + ("" if pixels is None else f" ({pixels:.2g} px)")

    promised = part(precision.promised_m, precision.promised_px)
    made = part(precision.float32_error_max_m, precision.float32_error_max_px)
    return f"promised {promised}, largest error {made}"


def _cover(layer: CoverFacts) -> str:
    text = f"covers {100 * layer.covers:.3g} %, shows on {100 * layer.shows:.3g} %"
    for condition in layer.conditions:
        text += f"; {condition.type} holds on {100 * condition.holds:.3g} %"
        if condition.smoothed_over_m:
            text += f" (smoothed over {_short(condition.smoothed_over_m)} m)"
    return text


def _cut(cut: CutFacts) -> str:
    return (
        f"chord error {cut.chord_error_rms_m:.2g} m rms, {cut.chord_error_max_m:.2g} m "
        f"worst, snapped {cut.snap_max_m:.2g} m"
    )


def _mesh_errors(mesh: MeshFacts | None) -> Iterator[tuple[str, str]]:
    """Yields the adaptive mesh's errors, in pixels of the nearest view."""
    if mesh is None:
        return
    asked = f"{mesh.tolerance_px:g} px asked"
    if mesh.budget_bound:
        asked += f", {mesh.tolerance_reached_px:.2g} px within max_triangles"
    yield "  at samples", f"{mesh.height_error_max_px:.2g} px worst; {asked}"
    finer = mesh.finer
    if finer:
        error = f"{finer.surface_error_rms_px:.2g} px rms, "
        error += (
            f"{finer.surface_error_found_px:.2g} px at the worst of {finer.checked_points:,} points"
        )
        yield "  between samples", f"{error}; legs from {finer.finest_leg_m:.2g} m"
    if mesh.label_error_max_px is not None:
        yield "  label lines", f"{mesh.label_error_max_px:.2g} px worst at samples"


def _objects(entry: ClassFacts) -> str:
    """One class: how many, how coarse, how well they sit."""
    text = f"{entry.count:,} instance" + ("" if entry.count == 1 else "s")
    if entry.asked_for is not None:
        text += f" placed of {entry.asked_for:,} asked for"
    text += f", {entry.triangles:,} triangles, "
    if entry.triangles_spared:
        text += (
            f"{entry.triangles_finest:,} at the finest level: {entry.lod_error_max_px:.2g} "
            f"px worst, {entry.lod_px:g} px asked; "
        )
    if entry.gap_max_px is not None:
        up, down = entry.float_max_m, entry.sink_max_m
        text += f"seated within {up:.2g} m up, {down:.2g} m down ({entry.gap_max_px:.2g} px), "
    elif entry.seating_error_max_m is not None:
        text += f"seated within {entry.seating_error_max_m:.2g} m, "
    if entry.moved_off_cameras is not None:
        text += f"{entry.moved_off_cameras} moved off cameras, "
    return f"{text}float32 error {entry.float32_error_max_m:.2g} m"


def _prune(prune: PruneFacts, seconds: float | None) -> list[Row]:
    """Tabulates the light that pruning neglects, and how much of everything stays."""
    rows = [Row("pruning", seconds, _light(prune.light))]
    if prune.tiles is not None:
        rows.append(
            Row("  terrain", None, f"{prune.tiles.kept:,} of {prune.tiles.of:,} tiles kept")
        )
    for name, counts in prune.objects.items():
        rows.append(Row(f"  {name}", None, ", ".join(f"{why}: {n:,}" for why, n in counts.items())))
    return rows


def _light(light: PrunedLight | None) -> str:
    if light is None:
        return "annotation stays as it is, to the bit"
    if light.everywhere:
        return "nothing left out: a mirror, or a sun in the sky's picture, may show anything"
    if light.min_view_factor is None:
        return _facts(light.facts)
    least = 100 * light.min_view_factor
    text = (
        f"casts no shadow on what is seen, and fills less than {least:.2g} % of a hemisphere there"
    )
    return f"{text}; annotation as it is, to the bit"


def _sky(sky: SkyFacts) -> Iterator[tuple[str, str]]:
    """Yields errors of skies, baked or from pictures."""
    errors = {name: one.resolution_error for name, one in sky.pictures.items()}
    baked = [error for error in errors.values() if error is not None]
    if baked:
        which = f"{len(baked)} sky picture" + ("" if len(baked) == 1 else "s")
        yield which, f"resolution error up to {100 * max(baked):.2g} % rms of the sky's mean"
    for name, clipped in sky.set_to_zero.items():
        yield f"sky: {name}", f"{100 * clipped.negative_fraction:.2g} % below 0 set to 0"
    for name, one in sky.pictures.items():
        if errors[name] is None:
            yield f"sky: {name}", _facts(one.facts)


def _surface(entry: SurfaceFacts) -> Iterator[tuple[str, str]]:
    """One material: what was made for it, and what its pictures lost."""
    made = {k: v for k, v in entry.facts.items() if not isinstance(v, Mapping)}
    if made:
        yield "", _facts(made)
    for name, part in entry.facts.items():
        if isinstance(part, Mapping):
            yield f": {name.replace('_', ' ')}", _facts(part)
    for kind, picture in entry.pictures.items():
        wide, high = picture.texels
        text = f"{wide} × {high} texels, {picture.texels_per_pixel:.2g} a pixel"
        if picture.texels_kept is not None:
            wide, high = picture.texels_kept
            text += f"; kept {wide} × {high}, rms error {picture.rms_error:.2g}"
        if picture.slope_rms_kept is not None:
            text += f", slopes {picture.slope_rms:.2g} rms, kept {picture.slope_rms_kept:.2g}"
        yield f": {kind.replace('_', ' ')}", text


def _facts(entry: Mapping[str, JSON]) -> str:
    """Names and numbers in a line: ``change_rms_m: 0.0018`` is "change rms 0.0018 m"."""
    return ", ".join(_fact(k, v) for k, v in entry.items() if v is not None)


def _fact(key: str, value: JSON) -> str:
    name, _, unit = key.rpartition("_")
    if not name or unit not in _UNITS:
        name, unit = key, ""
    name = name.replace("_", " ")
    if isinstance(value, bool):
        return name if value else f"not {name}"
    if isinstance(value, Mapping):
        return f"{name}: {_facts(value)}"
    if isinstance(value, list):
        shown = [_short(one) for one in value[:4]] + (["…"] if len(value) > 4 else [])
        return f"{name} {' '.join(shown)}" + (f" {_UNITS[unit]}" if unit else "")
    return f"{name} {_short(value)}" + (f" {_UNITS[unit]}" if unit else "")


def _short(value: object) -> str:
    if isinstance(value, bool):
        return str(value)
    if isinstance(value, int):
        return f"{value:,}"
    return f"{value:.3g}" if isinstance(value, float) else str(value)
