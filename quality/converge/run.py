"""``scenec converge``: render ladders, measure them, write the report."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from scenec.backends.registry import require_name
from scenec.quality.converge import measure, report
from scenec.quality.converge.fits import band, fit
from scenec.quality.converge.ladder import Climbed, Ladder, climb
from scenec.quality.converge.measure import Row
from scenec.quality.converge.metrics import root
from scenec.quality.converge.series import BackendConvergence, ConvergeReport, Floor, Series, Step
from scenec.schemas.errors import BackendError
from scenec.schemas.files import check_writable
from scenec.schemas.manifest import find_batches
from scenec.schemas.passes import ANNOTATION_NAMES
from scenec.schemas.units import Say

#: In the output folder.
FOLDER = "converge"
#: Half of a 95 % interval, in standard errors.
NORMAL_95 = 1.96


def converge(
    out: Path | str,
    backends: Sequence[str],
    ladder: Ladder | None = None,
    *,
    batches: Collection[int] | None = (0,),
    say: Say = lambda _line: None,
) -> ConvergeReport:
    """Render a ladder of qualities per backend, and write ``OUT/converge/``.

    Args:
        out: Output folder of a compile, or a USD file (``converge`` then lies beside it).
        backends: Names.
        ladder: What to render.
        batches: Which; None takes all.
        say: Told what is done.

    Raises:
        BackendError: No such backend, one that has no light, or a ladder without rungs.
        StageError: A stage cannot be read, or has no such sample or camera.
        OutputError: No manifest, or a file cannot be written.
    """
    out, ladder = Path(out), ladder or Ladder()
    names = list(dict.fromkeys(backends))
    _check(names, ladder)
    folder = (out if out.is_dir() else out.parent) / FOLDER
    found = ConvergeReport()
    differences: dict[tuple[str, str], list[measure.ReferenceGap]] = defaultdict(list)
    check_writable(folder)
    for batch in find_batches(out, batches):
        aside = folder / "pictures" / batch.name
        climbed = [climb(batch, name, ladder, aside, say) for name in names]
        seen = measure.see(climbed)
        found.stages[batch.name] = climbed[0].digest
        found.rows += measure.rows(batch.name, climbed, seen)
        for pair in measure.differences(climbed, seen):
            differences[pair.backend, pair.against].append(pair)
        for one in climbed:
            _add(found, one, seen, ladder)
        found.files += report.pictures(folder / "differences", batch.name, climbed, seen)
    found.floors = [_floor(each) for each in differences.values()]
    found.series = _series(found.rows, found.backends)
    report.write(folder, found)
    for line in found.notes:
        say(line)
    return found


def _check(names: Sequence[str], ladder: Ladder) -> None:
    for name in names:
        require_name(name)
        if name in ANNOTATION_NAMES:
            raise BackendError(f"backend {name} draws no light: it has nothing that converges")
    if not names:
        raise BackendError("no backends to converge: name one or more")
    if not ladder.rungs:
        raise BackendError("a ladder without rungs: name samples per pixel or seconds")
    if any(not 0.0 < value < math.inf for value in (*ladder.spp, *ladder.seconds)):
        raise BackendError("samples per pixel and seconds of a ladder must be numbers above 0")
    if ladder.repeats < 1:
        raise BackendError(f"repeats must be at least 1, not {ladder.repeats}")


def _add(report: ConvergeReport, one: Climbed, truth: measure.References, ladder: Ladder) -> None:
    noises = [truth.references[one.backend, shown.place] for shown in one.references[0]]
    worst = max((noise.relative_rms for noise in noises), default=0.0)
    known = report.backends.get(one.backend) or BackendConvergence(
        version=one.version,
        device=one.device,
        denoiser=one.denoiser,
        stochastic=one.stochastic,
        losses=(),
        reference_spp=2 * ladder.reference if one.stochastic else None,
        reference_relative_rms=0.0,
        start_s=one.start_s,
        annotation_s=measure.annotation_seconds(one),
        pixels=measure.pixels(one),
    )
    report.backends[one.backend] = replace(
        known,
        losses=tuple(dict.fromkeys(known.losses + one.losses)),
        reference_relative_rms=max(known.reference_relative_rms, worst),
    )


def _floor(each: Sequence[measure.ReferenceGap]) -> Floor:
    """Over batches; squares are averaged, and then roots are drawn."""
    square = float(np.mean([one.relative_ms for one in each]))
    reach = NORMAL_95 * math.sqrt(sum(one.relative_ms_error**2 for one in each)) / len(each)
    flips = [one.flip for one in each if one.flip is not None]
    return Floor(
        backend=each[0].backend,
        against=each[0].against,
        relative_rms=root(square),
        relative_rms_low=root(square - reach) or 0.0,
        relative_rms_high=root(square + reach) or 0.0,
        relative_rms_of_the_noise=root(float(np.mean([one.noise_ms for one in each]))) or 0.0,
        relative_mse=float(np.mean([one.relative_mse for one in each])),
        bias=float(np.mean([one.bias for one in each])),
        flip=float(np.mean(flips)) if len(flips) == len(each) else None,
    )


def _series(rows: Sequence[Row], backends: Mapping[str, BackendConvergence]) -> list[Series]:
    groups: dict[tuple[str, bool, str], dict[str, list[Row]]] = defaultdict(
        lambda: defaultdict(list)
    )
    for row in rows:
        groups[row.backend, row.denoised, row.against][row.rung].append(row)
    found = []
    for (backend, denoised, against), rungs in groups.items():
        steps = tuple(_step(name, of_rung) for name, of_rung in rungs.items())
        stochastic = backends[backend].stochastic
        errors = [step.relative_rms for step in steps]
        costs = [step.spp for step in steps], [step.seconds for step in steps]
        own = stochastic and backend == against
        over = [fit(cost, errors, denoised) if own else None for cost in costs]
        found.append(Series(backend, denoised, against, stochastic, steps, over[0], over[1]))
    return found


def _step(name: str, rows: Sequence[Row]) -> Step:
    repeats: dict[int, list[Row]] = defaultdict(list)
    for row in rows:
        repeats[row.repeat].append(row)
    rms = tuple(root(float(np.mean([r.relative_ms for r in of]))) for of in repeats.values())
    biases = [float(np.mean([r.bias for r in of])) for of in repeats.values()]
    known = [value for value in rms if value is not None]
    mean, low, high = band(known) if len(known) == len(rms) else (None, None, None)
    flips = [row.flip for row in rows if row.flip is not None]
    estimates = [row.estimated for row in rows if row.estimated is not None]
    bounds = [row.bound for row in rows if row.bound is not None]
    # Each frame's reference is one for all repeats.
    own = {row.place: row.bias_of_reference for row in rows}
    reference = math.sqrt(sum(value**2 for value in own.values())) / len(own)
    return Step(
        name,
        float(np.median([np.mean([r.spp for r in of]) for of in repeats.values()])),
        float(np.median([np.mean([r.seconds for r in of]) for of in repeats.values()])),
        rows[0].seconds,
        rms,
        mean,
        low,
        high,
        float(np.mean([r.relative_mse for r in rows])),
        float(np.mean([r.relative_mse_trimmed for r in rows])),
        float(np.mean(biases)),
        math.hypot(float(np.std(biases, ddof=1)) / math.sqrt(len(biases)), reference)
        if len(biases) > 1
        else None,
        float(np.mean(flips)) if len(flips) == len(rows) else None,
        float(np.sqrt(np.mean(np.square(estimates)))) if len(estimates) == len(rows) else None,
        float(np.sqrt(np.mean(np.square(bounds)))) if len(bounds) == len(rows) else None,
    )
