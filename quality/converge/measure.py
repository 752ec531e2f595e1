"""From a ladder's pictures to numbers."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenec.backends.check.radiance import flip
from scenec.quality.converge.ladder import Climbed, LadderFrame, Rung
from scenec.quality.converge.metrics import Errors, Reference, errors, square_and_error
from scenec.schemas.frames import Frame


@dataclass(frozen=True)
class Row:
    """One picture against one reference: a line of the CSV.

    Attributes:
        batch: Folder name.
        place: Batch, camera and sample.
        backend: Who drew the picture.
        denoised: Whether it was denoised.
        against: Whose reference it is compared with.
        rung: Name of the quality.
        repeat: Number of the noise seed.
        spp: Samples per pixel.
        seconds: Of its light; loading, annotation and writing do not count.
        relative_ms: Square of relative_rms; may be negative where the reference's noise hides it.
        relative_mse, relative_mse_trimmed, bias, flip: See ``metrics.FORMULAS``; flip is None
            without the package.
        bias_of_reference: Standard error that the reference's own noise leaves in the bias.
        estimated: relative_rms as the picture's own halves tell it; None where unknown.
        bound: What they say it is below in 95 % of pictures (``noise.estimate``); likewise.
    """

    batch: str
    place: str
    backend: str
    denoised: bool
    against: str
    rung: str
    repeat: int
    spp: int
    seconds: float
    relative_ms: float
    relative_mse: float
    relative_mse_trimmed: float
    bias: float
    flip: float | None
    bias_of_reference: float
    estimated: float | None
    bound: float | None


@dataclass
class References:
    """A batch's references, read once: per place the pixels that count, and each backend's R."""

    masks: dict[str, NDArray[np.bool_]] = field(default_factory=dict)
    references: dict[tuple[str, str], Reference] = field(default_factory=dict)
    frames: dict[tuple[str, str], Frame] = field(default_factory=dict)


def see(climbed: Sequence[Climbed]) -> References:
    """Read all references of a batch.

    Pixels that count are those whose center a surface covers: the same for all backends, since
    annotation is.
    """
    seen = References()
    for one in climbed:
        for number, shown in enumerate(one.references[0]):
            first = shown.read()
            mask = np.isfinite(first.passes["depth"])
            seen.masks.setdefault(shown.place, mask)
            a = first.passes["rgb"][mask]
            if len(one.references) == 2:
                second = one.references[1][number].read()
                reference = Reference.of_two(a, second.passes["rgb"][mask])
                mean = 0.5 * (first.passes["rgb"] + second.passes["rgb"])
            else:
                mean = first.passes["rgb"]
                reference = Reference(a.astype(np.float64), np.zeros(a.shape))
            key = (one.backend, shown.place)
            seen.references[key] = reference
            seen.frames[key] = replace(first, passes={**first.passes, "rgb": mean})
    return seen


def rows(batch: str, climbed: Sequence[Climbed], truth: References) -> list[Row]:
    """Every picture against its own backend's reference and those of all others with noise."""
    found = []
    for one in climbed:
        pictures = [
            (rung, denoised, repeat, shown)
            for rung, denoised, repeats in one.rungs
            for repeat, of_repeat in enumerate(repeats)
            for shown in of_repeat
        ]
        if not one.stochastic:
            pictures = [(Rung(1), False, 0, shown) for shown in one.references[0]]
        for rung, denoised, repeat, shown in pictures:
            frame = shown.read()
            which = batch, shown.place, one.backend, denoised
            quality = rung.name if one.stochastic else "only", repeat
            found += [
                Row(*which, other.backend, *quality, *_measured(frame, truth, other.backend, shown))
                for other in climbed
                if other.stochastic
            ]
    return found


def _measured(frame: Frame, truth: References, against: str, shown: LadderFrame) -> tuple[Any, ...]:
    """Returns the cells of a ``Row`` about the picture itself."""
    key = (against, shown.place)
    result: Errors = errors(frame.passes["rgb"][truth.masks[shown.place]], truth.references[key])
    map_ = flip(truth.frames[key], frame)
    record = frame.sidecar
    seconds = record.seconds or {}
    return (
        record.samples_per_pixel or 0,
        float(seconds["radiance"]) + float(seconds.get("haze", 0.0)),
        result.relative_ms,
        result.relative_mse,
        result.relative_mse_trimmed,
        result.bias,
        None if map_ is None else float(map_.mean()),
        truth.references[key].level_error / max(truth.references[key].level, 1e-30),
        record.error.relative_rms,
        record.error.relative_rms_bound_95,
    )


@dataclass(frozen=True)
class ReferenceGap:
    """Records what differs between two backends' references of a batch, means over its frames.

    Attributes:
        relative_ms, relative_ms_error: As of ``metrics.square_and_error``.
        noise_ms: Relative variance that was subtracted.
        relative_mse, bias, flip: As of ``Row``.
    """

    backend: str
    against: str
    relative_ms: float
    relative_ms_error: float
    noise_ms: float
    relative_mse: float
    bias: float
    flip: float | None


def differences(climbed: Sequence[Climbed], references: References) -> list[ReferenceGap]:
    """Compares backends' references, pair by pair: differences that more samples leave.

    The noise of both is subtracted.
    """
    found = []
    for i, one in enumerate(climbed):
        for other in climbed[i + 1 :]:
            truth, judged = (one, other) if one.stochastic or not other.stochastic else (other, one)
            squares, scatter, weighed, biases, flips, own = [], [], [], [], [], []
            for shown in truth.references[0]:
                r = references.references[truth.backend, shown.place]
                x = references.references[judged.backend, shown.place]
                both = Reference(r.mean, r.variance + x.variance)
                of = errors(x.mean, both)
                squares.append(of.relative_ms)
                scatter.append(square_and_error(x.mean, both)[1])
                weighed.append(of.relative_mse)
                biases.append(of.bias)
                own.append(float((r.variance + x.variance).mean()) / max(r.level, 1e-30) ** 2)
                map_ = flip(
                    references.frames[truth.backend, shown.place],
                    references.frames[judged.backend, shown.place],
                )
                flips += [] if map_ is None else [float(map_.mean())]
            found.append(
                ReferenceGap(
                    backend=judged.backend,
                    against=truth.backend,
                    relative_ms=float(np.mean(squares)),
                    relative_ms_error=float(np.sqrt(np.square(scatter).sum())) / len(scatter),
                    noise_ms=float(np.mean(own)),
                    relative_mse=float(np.mean(weighed)),
                    bias=float(np.mean(biases)),
                    flip=float(np.mean(flips)) if flips else None,
                )
            )
    return found


#: Steps of a frame that light has to do with, or that a backend does once.
NOT_ANNOTATION = ("load", "radiance", "haze", "compose", "write")


def annotation_seconds(one: Climbed) -> float:
    """Seconds of a frame's annotation: median over a backend's first references."""
    seconds = [shown.read().sidecar.seconds or {} for shown in one.references[0]]
    return float(
        np.median([sum(v for k, v in each.items() if k not in NOT_ANNOTATION) for each in seconds])
    )


def pixels(one: Climbed) -> float:
    """Pixels of a picture, the mean over a backend's references."""
    sizes = [shown.read().sidecar.resolution for shown in one.references[0]]
    return float(np.mean([width * height for width, height in sizes]))
