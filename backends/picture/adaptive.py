"""Rendering until the noise is small enough, or the time is used: rounds of independent halves.

A round goes on where the one before it ended in each half's sequence of samples, if the backend can
(``Backend.continues``): together they are as well spread as those of one picture. Else it is a
picture of its own noise. Halves are summed, so memory does not grow with rounds. Rounds double
until the estimate can be trusted; then the law of independent samples, error ~ 1 / sqrt(samples),
says how many are left to draw, or of a sequence the slope that the last rounds had.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from scenec.backends.contract import Radiance
from scenec.backends.noise_seeds import round_seed
from scenec.backends.picture.compose import denoised_noise, noisy_pixels, through
from scenec.backends.picture.noise import UNKNOWN, estimate
from scenec.schemas.records import ErrorEstimate, Round, RoundsRecord

#: Most samples per pixel, where a user does not say.
MOST_SPP = 4096
#: Of the first round.
FIRST_SPP = 8
#: Fewer samples than this prove nothing, however alike the halves are.
LEAST_TRUSTED = 16
#: A bound farther above its estimate comes from few pixels; the estimate says little then.
TRUSTED_RATIO = 1.5
#: Steepest slope of error over samples that is counted on: smooth pictures have it.
STEEPEST = 0.75
#: No prediction makes the picture more than this many times as costly in one go.
_MOST_GROWTH = 8
#: A round that adds less than a part in this many of what is there is not worth its start.
_LEAST_PART = 8

#: ``draw(spp, seed)``: a picture of its own noise. ``draw(spp, seed, first=n)``: one that goes on
#: after so many samples per pixel of the same seed.
Draw = Callable[..., Radiance]
#: ``denoise(radiance, seed)``: the mean of all rounds so far, denoised.
Denoise = Callable[[Radiance, int], Radiance]
Clock = Callable[[], float]


@dataclass(frozen=True)
class Target:
    """Holds the error, time and samples at which rendering a picture ends.

    Attributes:
        error: Relative rms error that its 95 % bound must not exceed; None for any.
        seconds: What drawing its light may take; None for any.
        most: Samples per pixel that it ends at, whatever is reached.
    """

    error: float | None
    seconds: float | None
    most: int


@dataclass
class Rounds:
    """Rounds that were made.

    Attributes:
        target: What they were to reach.
        continued: Whether each goes on where the one before it ended, with one seed.
        denoised: Whether the picture was denoised last; its error then falls more slowly.
        made: In order.
        stopped: Why there are no more: "error" (met), "seconds" (used), "spp" (the most there may
            be), or "unknown" (no noise to estimate: more samples would not be known to help).
    """

    target: Target
    continued: bool = False
    denoised: bool = False
    made: list[Round] = field(default_factory=list)
    stopped: str = ""

    @property
    def spp(self) -> int:
        """Samples per pixel of all rounds."""
        return sum(one.spp for one in self.made)

    @property
    def seconds(self) -> float:
        """Returns the seconds of all rounds."""
        return sum(one.seconds for one in self.made)

    def record(self, bound: float | None) -> RoundsRecord:
        """Returns what sidecars hold.

        Args:
            bound: Of the finished picture, after denoising where that is known; haze comes after
                the rounds.
        """
        goal = self.target.error
        return RoundsRecord(
            target_relative_rms=goal,
            target_seconds=self.target.seconds,
            most_samples_per_pixel=self.target.most,
            target_met=None if goal is None or bound is None else bound <= goal,
            stopped_by=self.stopped,
            seconds=self.seconds,
            reproducible=self.target.seconds is None,
            rounds=tuple(self.made),
        )


def collect(
    draw: Draw,
    seed: int,
    target: Target,
    clock: Clock = time.perf_counter,
    continues: bool = False,
    denoise: Denoise | None = None,
) -> tuple[Radiance, Rounds]:
    """Draw rounds until the target is met, and sum them up.

    With a limit of time, how many rounds there are depends on the machine's speed, and so does the
    picture; without one it follows from the seed.

    Args:
        draw: Draws one round.
        seed: Of the frame; that of each round is derived from it and the round's number.
        target: What to reach.
        clock: Seconds from anywhere.
        continues: Whether ``draw`` can go on; all rounds then have the seed of the first.
        denoise: Denoises what ``draw`` does not, after each round, until the picture as it is has
            the lower bound; of two pictures the better one counts, and is returned. So it does
            where ``draw`` denoises the halves of each round.
    """
    total = _Sum()
    rounds = Rounds(target, continues)
    spp, lost = min(FIRST_SPP, target.most), False
    while True:
        name = round_seed(seed, 0 if continues else len(rounds.made))
        start = clock()
        total.add(draw(spp, name, first=rounds.spp) if continues else draw(spp, name))
        picture = total.radiance()
        clean = None
        if lost:
            picture = _undenoised(picture)
        elif denoise is not None:
            clean = denoise(picture, round_seed(seed, 0))
        elif picture.denoised_halves is not None:
            clean, picture = picture, _undenoised(picture)
        noise = _noise_of(picture)
        if clean is not None:
            after = _noise_of(clean)
            rounds.denoised = _below(after, noise)
            if rounds.denoised:
                picture, noise = clean, after
            else:
                # More samples only add to the lead of the picture as it is.
                lost = True
        rounds.made.append(
            Round(spp, name, clock() - start, noise.relative_rms, noise.relative_rms_bound_95)
        )
        spp, rounds.stopped = plan(rounds, noise)
        if rounds.stopped:
            return picture, rounds


def plan(rounds: Rounds, noise: ErrorEstimate) -> tuple[int, str]:
    """Samples per pixel of the next round, and "" or why there is none (``Rounds.stopped``)."""
    target, total = rounds.target, rounds.spp
    if noise.relative_rms is None:
        return 0, "unknown"
    bound = noise.relative_rms_bound_95 or 0.0
    enough = total >= min(LEAST_TRUSTED, target.most)
    if target.error is not None and enough and bound <= target.error:
        return 0, "error"
    left = target.most - total
    if left < 2:
        return 0, "spp"
    wanted = total
    if target.error is not None and enough and bound <= TRUSTED_RATIO * noise.relative_rms:
        needed = total * (bound / target.error) ** (1.0 / _slope(rounds)) - total
        least = total if rounds.denoised else total / _LEAST_PART
        wanted = round(min(max(needed, least), (_MOST_GROWTH - 1) * total))
    # Few sizes: a renderer may compile anew for each. Sequences are spread best where they end at
    # multiples of large powers of two.
    wanted = grid(total + wanted) - total if rounds.continued else grid(wanted)
    wanted = min(wanted, left - left % 2)
    if target.seconds is not None:
        last = rounds.made[-1]
        fits = (target.seconds - rounds.seconds) * last.spp / max(last.seconds, 1e-9)
        if fits < max(2.0, total / _LEAST_PART):
            return 0, "seconds"
        if fits < wanted:
            wanted = int(fits) // 2 * 2 if rounds.continued else grid(int(fits), up=False)
    return wanted, ""


def _slope(rounds: Rounds) -> float:
    """The s of error ~ samples**-s: 1/2 of independent samples, of a sequence as it was found."""
    if not rounds.continued or rounds.denoised or len(rounds.made) < 2:
        return 0.5
    before, last = rounds.made[-2:]
    if not before.relative_rms or not last.relative_rms:
        return 0.5
    fell = math.log(before.relative_rms / last.relative_rms)
    return min(max(0.5, fell / math.log(rounds.spp / (rounds.spp - last.spp))), STEEPEST)


def grid(spp: int, up: bool = True) -> int:
    """The next even number of the form {4, 5, 6, 7} * 2**k (or 2) that is not below, or above."""
    if spp <= 4:
        return 2 if spp < 3 or (spp < 4 and not up) else 4
    step = 2 ** max(1, int(math.log2(spp)) - 2)
    return -(-spp // step) * step if up else spp // step * step


def _noise_of(picture: Radiance) -> ErrorEstimate:
    """Error of a picture; of a denoised one that after denoising, where it is known."""
    if not picture.stochastic:
        return UNKNOWN
    if picture.denoised_halves is not None:
        return denoised_noise([(picture, None)])
    return estimate(through(picture, None), noisy_pixels(picture))


def _undenoised(picture: Radiance) -> Radiance:
    """A picture as it was before denoising."""
    return replace(picture, denoised=None, denoised_halves=None)


def _below(one: ErrorEstimate, other: ErrorEstimate) -> bool:
    """Whether an error has the lower bound."""
    a, b = one.relative_rms_bound_95, other.relative_rms_bound_95
    return a is not None and b is not None and a < b


#: What a picture may have beside its halves.
_OPTIONAL = ("denoised", "denoised_halves", "background")


class _Sum:
    """Running sums over rounds, each weighed by its samples."""

    def __init__(self) -> None:
        self._spp = 0
        self._dropped = 0
        self._sums: dict[str, NDArray[np.float64]] = {}
        self._stochastic = True

    def add(self, one: Radiance) -> None:
        """Counts a round."""
        for name in ("halves", "coverage", *_OPTIONAL):
            values = getattr(one, name)
            if values is None:
                continue
            if self._spp == 0:
                self._sums[name] = np.zeros(values.shape)
            # What overflowed counts as it is: infinity, and an error that is unknown.
            with np.errstate(invalid="ignore"):
                self._sums[name] += one.spp * values.astype(np.float64)
        self._spp += one.spp
        self._dropped += one.dropped
        self._stochastic &= one.stochastic

    def radiance(self) -> Radiance:
        """The mean of all rounds."""
        means = {name: total / self._spp for name, total in self._sums.items()}
        means["coverage"] = np.minimum(means["coverage"], 1.0)
        return Radiance(
            spp=self._spp,
            dropped=self._dropped,
            stochastic=self._stochastic,
            **{name: mean.astype(np.float32) for name, mean in means.items()},
        )
