"""Writes the files of ``scenec converge``: CSV, JSON, plots, pictures of differences."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, fields
from pathlib import Path
from typing import TYPE_CHECKING

from scenec.backends.check.radiance import flip, write_differences
from scenec.quality.converge.ladder import Climbed
from scenec.quality.converge.measure import References, Row
from scenec.schemas.csv_cells import csv_writer, guarded_line
from scenec.schemas.extras import install
from scenec.schemas.files import atomic, write_json
from scenec.schemas.frames import Frame

if TYPE_CHECKING:
    from scenec.quality.converge.series import ConvergeReport, Floor, Series

CSV, JSON = "converge.csv", "converge.json"
NO_PLOTS = "no plots without matplotlib; mend it with: pip install 'scenec[plots]'"
NO_FLIP = f"FLIP is not installed; mend it with: {install('flip')}"


def write(folder: Path, report: ConvergeReport) -> None:
    """Write tables and plots, and note what had to be left out.

    Raises:
        OutputError: A file cannot be written.
    """
    report.notes += [line for series in report.series for line in findings(series)]
    report.notes += against_plain(report.series)
    report.notes += unseen_floors(report.floors)
    if any(row.flip is None for row in report.rows):
        report.notes.append(NO_FLIP)
    table = folder / CSV
    with atomic(table) as temporary, temporary.open("w", newline="", encoding="utf-8") as file:
        names = [field.name for field in fields(Row)]
        writer = csv_writer(file)
        writer.writerow(names)
        writer.writerows(guarded_line(asdict(row).values()) for row in report.rows)
    report.files.append(table)
    try:
        from scenec.quality.converge import plots
    except ImportError:
        report.notes.append(NO_PLOTS)
    else:
        report.files += plots.draw(folder, report)
    write_json(folder / JSON, report.as_json())
    report.files.append(folder / JSON)


def findings(series: Series) -> list[str]:
    """Interprets a series' slope, and lists rungs that the reference cannot judge."""
    lines: list[str] = []
    if not series.own:
        return lines
    for name, fit in (("samples", series.over_spp), ("seconds", series.over_seconds)):
        if fit is None:
            continue
        sure = "" if fit.low is None else f" (95 %: {fit.low:.3f} to {fit.high:.3f})"
        # Seconds have a share that does not grow with samples: no law says what their slope is.
        verdict = f": {fit.verdict}" if name == "samples" else ""
        lines.append(f"{series.name}: error over {name} has slope {fit.slope:.3f}{sure}{verdict}")
    hidden = [step.rung for step in series.steps if step.mean is None]
    if hidden:
        lines.append(
            f"{series.name}: {', '.join(hidden)} cannot be told from the reference's own noise; "
            "give the reference more samples"
        )
    return lines


def against_plain(series: Sequence[Series]) -> list[str]:
    """Lists backends where denoising falls slower than the samples: it gains less and less."""
    plain = {one.backend: one.over_spp for one in series if one.own and not one.denoised}
    lines = []
    for one in series:
        fit, before = one.over_spp, plain.get(one.backend)
        if not (one.own and one.denoised) or fit is None or before is None:
            continue
        if fit.low is None or before.high is None or fit.low <= before.high:
            continue
        lines.append(
            f"{one.name}: FINDING: its slope {fit.slope:.3f} is flatter than {before.slope:.3f} "
            "without denoising: what it gains shrinks as samples grow"
        )
    return lines


def unseen_floors(floors: Sequence[Floor]) -> list[str]:
    """Floors that the references' noise hides."""
    return [
        f"{floor.backend} : {floor.against}: what differs cannot be told from the "
        f"references' noise; it is below {100 * floor.relative_rms_high:.2g} %"
        for floor in floors
        if floor.relative_rms_low == 0.0 and floor.relative_rms_high > 0.0
    ]


def pictures(folder: Path, batch: str, climbed: Sequence[Climbed], truth: References) -> list[Path]:
    """Pictures of differences, of the first frame.

    Each ladder's ends against its reference, and the references against each other;
    ``check.radiance.write_differences`` says what they show.

    Raises:
        OutputError: One cannot be written.
    """
    made = []
    for number, one in enumerate(climbed):
        place = one.references[0][0].place
        reference = truth.frames[one.backend, place]
        ends = [one.rungs[0], one.rungs[-1]] if one.rungs else []
        for rung, denoised, repeats in ends:
            kind = "_denoised" if denoised else ""
            path = folder / f"{batch}_{one.backend}{kind}_{rung.name}.png"
            made.append(_differences(path, reference, repeats[0][0].read()))
        for other in climbed[number + 1 :]:
            path = folder / f"{batch}_{one.backend}_{other.backend}.png"
            made.append(_differences(path, reference, truth.frames[other.backend, place]))
    return made


def _differences(path: Path, first: Frame, second: Frame) -> Path:
    write_differences(path, first, second, flip(first, second))
    return path
