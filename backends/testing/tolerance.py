"""Bounds a renderer's deviation in a check, and judges it."""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scenec.backends.contract import Radiance

#: Standard errors that noise may take; for a mean, two-sided odds of a false alarm are 6e-7.
STANDARD_ERRORS = 5.0
#: Of the noise of single pixels, for their root mean square.
PIXEL_NOISE = 1.25
#: Noise of a picture's mean, and of its pixels, that hides what is checked.
LOUDEST_MEAN, LOUDEST_PIXEL = 5e-3, 0.2
#: What is darker counts as this share of the mean: clipping leaves some of it.
DARKEST = 0.1


@dataclass(frozen=True)
class Tolerance:
    """Holds a renderer's permitted deviation, noise aside, and its reason.

    Attributes:
        mean: Of mean radiance over a picture, relative; of first hits, the share of pixels that
            show another row.
        pixel: Root mean square over pixels, relative to what each should be; of first hits, the
            share of pixels that show another face.
        reason: Why no less.
    """

    mean: float
    pixel: float
    reason: str


@dataclass(frozen=True)
class Lacks:
    """A renderer does not do what is checked, and its ``losses`` say so, or it refuses.

    Attributes:
        reason: Why not.
    """

    reason: str


Table = Mapping[str, Tolerance | Lacks]

DEFAULT = Tolerance(1e-3, 5e-3, "float32 on the way")


def allowed(table: Table, check: str, case: str = "") -> Tolerance | Lacks:
    """The entry of a case, "check[case]", else of its check, else the default one."""
    return table.get(f"{check}[{case}]") or table.get(check) or DEFAULT


def require_valid(table: Table, checks: Iterable[str]) -> None:
    """Refuse entries of no check, and those without a reason.

    Raises:
        ValueError: Names the entry and the nearest check.
    """
    known = sorted(checks)
    for name, entry in table.items():
        if name.partition("[")[0] not in known:
            near = difflib.get_close_matches(name, known, n=1, cutoff=0.4)
            hint = f"; did you mean {near[0]!r}?" if near else ""
            raise ValueError(f"tolerances: there is no check {name!r}{hint}")
        if not entry.reason:
            raise ValueError(f"tolerances: {name!r} has no reason")


def judge(
    what: str,
    radiance: Radiance,
    expected: NDArray[np.float64],
    tolerance: Tolerance,
    sound: NDArray[np.bool_] | None = None,
    least: int = 100,
) -> None:
    """Hold a picture against what it is to be.

    Noise is what the halves differ by. It may explain a difference, but must not be so large that
    nothing could be seen.

    Args:
        what: Named where it fails.
        radiance: What a renderer drew.
        expected: Radiance [h, w, 3], or what fits that.
        tolerance: What is allowed.
        sound: Pixels that count, bool [h, w]; None: all.
        least: Pixels that there have to be.

    Raises:
        AssertionError: It is off by more, or too noisy to tell.
    """
    halves = radiance.halves.astype(np.float64)
    on = np.ones(halves.shape[1:3], bool) if sound is None else sound
    assert on.sum() >= least, f"{what}: only {on.sum()} pixels can be judged, of {least} at least"
    wanted = np.broadcast_to(expected, halves.shape[1:])[on]
    got, noise = halves.mean(axis=0)[on], (0.5 * (halves[0] - halves[1]))[on]
    broken = np.count_nonzero(~np.isfinite(got))
    assert not broken, f"{what}: {broken} values are not finite"
    brightness = np.maximum(wanted.mean(), 1e-30)
    scale = np.maximum(wanted, DARKEST * brightness)
    off, noise = (got - wanted) / scale, noise / scale
    count = int(on.sum())
    mean, mean_noise = off.mean(), np.sqrt((noise**2).mean() / count)
    pixel, pixel_noise = np.sqrt((off**2).mean()), np.sqrt((noise**2).mean())
    quiet = mean_noise < LOUDEST_MEAN and pixel_noise < LOUDEST_PIXEL
    assert quiet, (
        f"{what}: too noisy to be judged: {mean_noise:.2%} of the mean, {pixel_noise:.1%} of a "
        f"pixel; at most {LOUDEST_MEAN:.2%} and {LOUDEST_PIXEL:.0%}. Draw more samples (`effort`)"
    )
    faults = []
    if abs(mean) > tolerance.mean + STANDARD_ERRORS * mean_noise:
        faults.append(
            f"mean radiance is off by {mean:+.3%}; allowed are {tolerance.mean:.3%} "
            f"({tolerance.reason}) and {STANDARD_ERRORS * mean_noise:.3%} for noise"
        )
    if pixel > np.hypot(tolerance.pixel, PIXEL_NOISE * pixel_noise):
        worst = np.unravel_index(np.abs(off).argmax(), off.shape)
        row, column = np.argwhere(on)[worst[0]]
        faults.append(
            f"pixels are off by {pixel:.3%} (root mean square of {count}); allowed are "
            f"{tolerance.pixel:.3%} ({tolerance.reason}) and {PIXEL_NOISE * pixel_noise:.3%} for "
            f"noise; worst at column {column}, row {row}, channel {'RGB'[worst[1]]}: "
            f"{got[worst]:.6g} where {wanted[worst]:.6g} is right"
        )
    assert not faults, f"{what}: " + "; ".join(faults)
