"""What each backend would take and reach, and which of them is to render: pure functions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from scenec.backends.auto.curves import Curve, Light
from scenec.backends.noise import Noise
from scenec.backends.registry import BUILT_IN
from scenec.backends.rounds import FIRST_SPP, Round, Rounds, Target, plan
from scenec.schemas.errors import BackendError

#: An error this much larger is no larger, as far as curves tell.
TOLERANCE = 1.02
#: Seconds a frame are kept to, as well as they can be foreseen.
LATE = 1.05


@dataclass(frozen=True)
class Ask:
    """What is to be rendered.

    Attributes:
        frames: How many, of all batches.
        pixels: Of a frame, on average.
        rgb, annotated: Whether frames have light, and anything else.
        spp: Samples per pixel; with ``error`` or ``seconds`` the most.
        error, seconds: See ``render``.
    """

    frames: int
    pixels: float
    rgb: bool
    annotated: bool
    spp: int
    error: float | None = None
    seconds: float | None = None

    @property
    def text(self) -> str:
        """In words."""
        frames = f"{self.frames} frame{'s' if self.frames != 1 else ''}"
        if not self.rgb:
            return f"{frames} of annotation"
        if self.error is None and self.seconds is None:
            return f"{frames} of {self.spp} samples per pixel"
        goals = [] if self.error is None else [f"to {100 * self.error:.3g} % error"]
        goals += [] if self.seconds is None else [f"in {self.seconds:g} s each"]
        return f"{frames} {' or '.join(goals)}"


@dataclass(frozen=True)
class Prediction:
    """One backend, as its curve has it.

    Attributes:
        backend: Name.
        seconds: Of all frames, its start included.
        start_s: Of these, its start, and what sizes of rounds cost once.
        light_s, annotation_s: Of these, a frame's light and annotation.
        spp: Samples per pixel; 0 without light.
        error: Relative rms error to expect: noise and floor; None where it is not known, or there
            is no light.
        floor: See ``Curve``.
        stochastic: Whether it has noise.
        unfit: Why it does not qualify; "" if it does.
    """

    backend: str
    seconds: float
    start_s: float
    light_s: float
    annotation_s: float
    spp: int
    error: float | None
    floor: float | None
    stochastic: bool
    unfit: str = ""

    @property
    def text(self) -> str:
        """In words."""
        parts = [f"start {self.start_s:.2g}"]
        parts += [f"light {self.light_s:.2g} a frame"] if self.light_s else []
        parts += [f"annotation {self.annotation_s:.2g} a frame"] if self.annotation_s else []
        words = [f"{self.seconds:.3g} s ({', '.join(parts)})"]
        if self.error is not None:
            words.append(f"error {100 * self.error:.2g} %")
        if not self.stochastic and self.spp:
            words.append("no noise, but off by that whatever the samples")
        elif self.spp:
            words.append(f"{self.spp} samples per pixel")
        if self.unfit:
            words.append(f"does not qualify: {self.unfit}")
        return ", ".join(words)


def rounds_of(light: Light, target: Target) -> tuple[Rounds, float]:
    """The rounds that a backend would make (``rounds.collect``), and the error they end with.

    A round is a picture of its own; the variance of their mean is the sum of theirs, each weighed
    by the square of its share of the samples.
    """
    made = Rounds(target)
    spp, weighed = min(FIRST_SPP, target.most), 0.0
    while True:
        weighed += (spp * light.noise(spp)) ** 2
        total = made.spp + spp
        noise = weighed**0.5 / total
        bound = noise * light.widening
        made.made.append(Round(spp, 0, light.seconds(spp), noise, bound))
        spp, made.stopped = plan(made, Noise(noise, bound, None))
        if made.stopped:
            return made, noise


def predict(curve: Curve, ask: Ask) -> Prediction:
    """What a backend would take and reach."""
    larger = ask.pixels / curve.pixels if curve.pixels else 1.0
    annotation = curve.annotation_s * larger if ask.annotated else 0.0
    lit, error, start_s = _Lit(0.0, 0, 0.0), None, curve.start_s
    if ask.rgb:
        if curve.light is None:
            raise BackendError(f"backend {curve.backend}: nothing is known of its light")
        light = _resized(curve.light, larger)
        lit = _light(light, curve, ask)
        error = None if curve.floor is None else (lit.noise**2 + curve.floor**2) ** 0.5
        start_s += lit.sizes * light.size_s
    return Prediction(
        curve.backend,
        start_s + ask.frames * (lit.seconds + annotation),
        start_s,
        lit.seconds,
        annotation,
        lit.spp,
        error,
        curve.floor,
        curve.stochastic,
        lit.unfit,
    )


@dataclass(frozen=True)
class _Lit:
    """A frame's light: seconds, samples, noise; sizes of rounds; what speaks against it."""

    seconds: float
    spp: int
    noise: float
    sizes: int = 1
    unfit: str = ""


def _resized(light: Light, larger: float) -> Light:
    return Light(
        light.fixed_s * (1.0 if light.sample_s else larger),
        light.sample_s * larger,
        light.error,
        light.slope,
        light.widening,
        light.size_s,
    )


def _light(light: Light, curve: Curve, ask: Ask) -> _Lit:
    if not curve.stochastic:
        seconds, unfit = light.fixed_s, ""
        if curve.floor is None:
            unfit = "it has no noise and an error that is not known"
        elif ask.error is not None and curve.floor > ask.error:
            unfit = f"its floor of {100 * curve.floor:.2g} % is above the target"
        elif ask.seconds is not None and seconds > ask.seconds:
            unfit = f"its one picture takes {seconds:.2g} s"
        return _Lit(seconds, ask.spp, 0.0, 0, unfit)
    if ask.error is None and ask.seconds is None:
        return _Lit(light.seconds(ask.spp), ask.spp, light.noise(ask.spp))
    made, noise = rounds_of(light, Target(ask.error, ask.seconds, ask.spp))
    unfit = ""
    if ask.seconds is not None and made.seconds > LATE * ask.seconds:
        unfit = f"its first round takes {made.seconds:.2g} s"
    elif ask.error is not None and made.stopped != "error":
        what = "the samples" if made.stopped == "spp" else "the seconds"
        unfit = f"{what} end at {100 * noise:.2g} %"
    return _Lit(made.seconds, made.spp, noise, len({one.spp for one in made.made}), unfit)


def decide(curves: Sequence[Curve], ask: Ask) -> tuple[Prediction, list[Prediction], str]:
    """Which backend is to render.

    - Without light: the one with the least seconds.
    - To an error: of those that reach it by their bound, the least seconds; one without noise
      qualifies if its floor is not above the error.
    - In seconds a frame: of those that keep to them, the least error; then the least seconds.
    - For a number of samples: of those whose error at so many is no larger than the default
      backend's (Mitsuba's, or the first with noise) would be, the least seconds.

    Equal ones go by name. Where none qualifies, one with noise and the least error is taken to an
    error, the least seconds otherwise.

    Returns:
        (the chosen one, all, why).

    Raises:
        BackendError: None comes near: no backend with noise for an error.
    """
    found = sorted((predict(curve, ask) for curve in curves), key=lambda one: one.backend)
    if not found:
        raise BackendError("no backend to choose from")
    if not ask.rgb:
        return _least(found), found, "the least seconds: annotation is the same whichever it is"
    if ask.error is None and ask.seconds is None:
        return _for_samples(found, ask)
    able = found
    if ask.error is not None:
        fit = [one for one in found if not one.unfit]
        if fit:
            return _least(fit), found, "reaches the error in the least seconds"
        able = [one for one in found if one.stochastic]
        if not able:
            reasons = "; ".join(f"{one.backend}: {one.unfit}" for one in found)
            raise BackendError(f"no backend comes within {100 * ask.error:.3g} %: {reasons}")
    if ask.seconds is None:
        best = min(able, key=lambda one: (_error(one), one.backend))
        return best, found, "none reaches the error; this comes nearest"
    keep = [one for one in able if one.light_s <= LATE * ask.seconds]
    known = [one for one in keep if one.error is not None]
    if known:
        best = min(known, key=lambda one: (_error(one), one.seconds, one.backend))
        return best, found, "the least error in that time"
    if keep:
        return _least(keep), found, "no error is known; the least seconds"
    best = min(able, key=lambda one: (one.light_s, one.backend))
    return best, found, "none can keep the time; this exceeds it least"


def _for_samples(found: list[Prediction], ask: Ask) -> tuple[Prediction, list[Prediction], str]:
    noisy = {one.backend: one for one in found if one.stochastic and one.error is not None}
    if not noisy:
        return _least(found), found, "no error is known; the least seconds"
    usual = noisy[next(name for name in (*BUILT_IN, *sorted(noisy)) if name in noisy)]
    most = TOLERANCE * _error(usual)
    fit = [one for one in found if _error(one) <= most]
    return (
        _least(fit),
        found,
        f"the least seconds at an error no larger than {100 * _error(usual):.2g} %, that of "
        f"{usual.backend} with {ask.spp} samples per pixel",
    )


def _error(one: Prediction) -> float:
    return float("inf") if one.error is None else one.error


def _least(some: Sequence[Prediction]) -> Prediction:
    return min(some, key=lambda one: (one.seconds, one.backend))
