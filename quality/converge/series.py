"""Holds the results of convergence: steps of series, and all of them."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from pathlib import Path

from scenec.quality.converge.fits import Fit
from scenec.quality.converge.measure import Row
from scenec.quality.converge.metrics import FORMULAS
from scenec.schemas.codec import Facts, encode

STEP_HEADER = ["spp", "s", "rel. rms", "estimated", "relMSE", "trimmed", "FLIP", "bias"]
FLOOR_HEADER = ["backends", "rel. rms", "95 %", "relMSE", "FLIP", "bias"]


@dataclass(frozen=True)
class Step:
    """One rung of one series, over all frames: means over repeats, geometric for the error.

    Attributes:
        rung: Name.
        spp, seconds: Mean over frames, median over repeats.
        first_s: Seconds of the first picture, for which a renderer may have compiled kernels.
        relative_rms: Of each repeat, over all frames; None where the reference hides it.
        mean, low, high: Geometric mean of these and its 95 % interval; None where one is unknown.
        relative_mse, relative_mse_trimmed, bias, flip: Means.
        bias_error: Standard error of the bias, from repeats and reference; None for one repeat.
        estimated: relative_rms as the pictures' own halves tell it.
        bound: Its 95 % bound, as they tell it.
    """

    rung: str
    spp: float
    seconds: float
    first_s: float
    relative_rms: tuple[float | None, ...]
    mean: float | None
    low: float | None
    high: float | None
    relative_mse: float
    relative_mse_trimmed: float
    bias: float
    bias_error: float | None
    flip: float | None
    estimated: float | None
    bound: float | None


@dataclass(frozen=True)
class Series:
    """One backend, with or without denoising, against one reference."""

    backend: str
    denoised: bool
    against: str
    stochastic: bool
    steps: tuple[Step, ...]
    over_spp: Fit | None
    over_seconds: Fit | None

    @property
    def own(self) -> bool:
        """Whether it is compared with its own reference."""
        return self.backend == self.against

    @property
    def name(self) -> str:
        """In tables and plots."""
        return f"{self.backend} denoised" if self.denoised else self.backend


@dataclass(frozen=True, kw_only=True)
class Floor:
    """Records what differs between two backends however many samples they take, over batches.

    Attributes:
        relative_rms: The noise of both subtracted; None where that leaves nothing.
        relative_rms_low, relative_rms_high: Its 95 % interval.
        relative_rms_of_the_noise: What was subtracted.
        relative_mse, bias, flip: Means; FLIP with the noise, None where it is not installed.
    """

    backend: str
    against: str
    relative_rms: float | None
    relative_rms_low: float
    relative_rms_high: float
    relative_rms_of_the_noise: float
    relative_mse: float
    bias: float
    flip: float | None


@dataclass(frozen=True, kw_only=True)
class BackendConvergence:
    """Records what is known of a backend beside its series.

    Attributes:
        denoiser: What denoised, or None.
        losses: What it leaves out of the stages.
        reference_spp, reference_relative_rms: Samples of its references, and the noisiest's noise;
            samples are None where there is no noise.
        start_s: Seconds until its first picture; None where nothing was drawn anew.
        annotation_s: Seconds of a frame's annotation.
        pixels: Of a picture.
    """

    version: str
    device: str
    denoiser: str | None
    stochastic: bool
    losses: tuple[str, ...]
    reference_spp: int | None
    reference_relative_rms: float
    start_s: float | None
    annotation_s: float
    pixels: float


@dataclass
class ConvergeReport:
    """Reports the convergence of backends.

    Attributes:
        series: Errors over samples and seconds.
        floors: What differs between backends' references, pair by pair.
        backends: What is known of each, by name.
        stages: By batch: ``RenderScene.digest``.
        rows: One a picture and reference.
        files: What was written.
        notes: Lines that a user should see.
    """

    series: list[Series] = field(default_factory=list)
    floors: list[Floor] = field(default_factory=list)
    backends: dict[str, BackendConvergence] = field(default_factory=dict)
    stages: dict[str, str] = field(default_factory=dict)
    rows: list[Row] = field(default_factory=list)
    files: list[Path] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)

    def as_json(self) -> Facts:
        """The numbers, for scripts; every picture's are in the CSV."""
        return {
            "formulas": FORMULAS,
            "stages": self.stages,
            "backends": encode(self.backends),
            "series": [{**asdict(one), "own": one.own, "name": one.name} for one in self.series],
            "floors": [asdict(one) for one in self.floors],
            "notes": self.notes,
        }


def step_cells(step: Step) -> list[str]:
    """A rung's numbers as text, under ``STEP_HEADER``."""
    unsure = "" if step.bias_error is None else f" ± {100 * step.bias_error:.3f}"
    return [
        f"{step.spp:g}",
        f"{step.seconds:.3g}",
        percent(step.mean),
        percent(step.estimated),
        f"{step.relative_mse:.3g}",
        f"{step.relative_mse_trimmed:.3g}",
        "-" if step.flip is None else f"{step.flip:.4f}",
        f"{100 * step.bias:+.3f} %{unsure}",
    ]


def floor_cells(floor: Floor) -> list[str]:
    """Formats the difference of two backends as text, under ``FLOOR_HEADER``."""
    return [
        f"{floor.backend} : {floor.against}",
        percent(floor.relative_rms),
        f"{percent(floor.relative_rms_low)} to {percent(floor.relative_rms_high)}",
        f"{floor.relative_mse:.3g}",
        "-" if floor.flip is None else f"{floor.flip:.4f}",
        f"{100 * floor.bias:+.3f} %",
    ]


def percent(value: float | None) -> str:
    """A share as text; None as a dash."""
    return "-" if value is None else f"{100 * value:.3g} %"
