"""Error of a picture against a reference that has noise of its own.

The reference R is the mean of two independent pictures R1 and R2. ((R1 - R2) / 2)**2 is an
unbiased estimate of its variance, so for a picture X of other noise (X - R)**2 - ((R1 - R2) / 2)**2
is, pixel by pixel, an unbiased estimate of X's squared error against what R converges to.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scenec.backends.check.radiance import EPSILON

#: Share of pixels, those of the largest error, that the trimmed relMSE leaves out.
TRIMMED = 0.001

#: What reports say of the numbers.
FORMULAS = {
    "relative_rms": "sqrt(mean((X - R)^2 - V)) / mean(R); V = ((R1 - R2) / 2)^2 is the variance of "
    "the reference R = (R1 + R2) / 2",
    "relative_mse": f"mean(((X - R)^2 - V) / (R^2 + {EPSILON} mean(R)^2))",
    "relative_mse_trimmed": f"the same without the {100 * TRIMMED:g} % of pixels where it is "
    "largest: bright outliers do not decide it",
    "bias": "mean(X) / mean(R) - 1; beside it its standard error, of repeats and of R",
    "floor": "relative_rms of one backend's reference against another's, the noise of both "
    "subtracted; its 95 % interval from how pixels differ, which are independent",
    "flip": "mean LDR-FLIP (67 pixels a degree) of the developed pictures; R's noise is not "
    "subtracted",
    "pixels": "those whose center a surface covers, all channels",
}


@dataclass(frozen=True)
class Reference:
    """A picture to compare with.

    Attributes:
        mean: R at the pixels that count, float64 [n, 3].
        variance: Of R, float64 [n, 3]; 0 where it is known to have none.
        level_error: Standard error of R's mean over pixels and channels; 0 likewise.
    """

    mean: NDArray[np.float64]
    variance: NDArray[np.float64]
    level_error: float = 0.0

    @classmethod
    def of_two(cls, first: NDArray[np.floating], second: NDArray[np.floating]) -> Reference:
        """From two independent pictures of equal quality."""
        a, b = first.astype(np.float64), second.astype(np.float64)
        off = 0.5 * (a - b)
        # Channels of a pixel share its paths: summed before they are squared.
        level_error = float(np.sqrt((off.sum(axis=1) ** 2).sum())) / max(off.size, 1)
        return cls(0.5 * (a + b), off**2, level_error)

    @property
    def level(self) -> float:
        """Mean radiance."""
        return float(self.mean.mean()) if self.mean.size else 0.0

    @property
    def relative_rms(self) -> float:
        """Returns the relative rms of the reference's own noise."""
        if self.level <= 0.0:
            return 0.0
        return float(np.sqrt(self.variance.mean())) / self.level


@dataclass(frozen=True)
class Errors:
    """Holds the errors of one picture; formulas: ``FORMULAS``.

    A squared error that comes out negative is lost in the reference's noise; it stays negative
    here, so that means over pictures are unbiased.
    """

    relative_ms: float
    relative_mse: float
    relative_mse_trimmed: float
    bias: float

    @property
    def relative_rms(self) -> float | None:
        """None where the reference is too noisy to tell."""
        return root(self.relative_ms)


def root(value: float) -> float | None:
    """Square root; None of what is not above 0."""
    return float(np.sqrt(value)) if value > 0.0 else None


def errors(picture: NDArray[np.floating], reference: Reference) -> Errors:
    """Compare a picture with a reference of other noise.

    Args:
        picture: At the pixels that count, [n, 3].
        reference: At the same.
    """
    level = reference.level
    if level <= 0.0:
        return Errors(0.0, 0.0, 0.0, 0.0)
    x = picture.astype(np.float64)
    squared = (x - reference.mean) ** 2 - reference.variance
    weighed = squared / (reference.mean**2 + EPSILON * level**2)
    return Errors(
        float(squared.mean()) / level**2,
        float(weighed.mean()),
        trimmed_mean(weighed.mean(axis=1)),
        float(x.mean()) / level - 1.0,
    )


def square_and_error(picture: NDArray[np.floating], reference: Reference) -> tuple[float, float]:
    """``relative_ms`` and its standard error, from how pixels scatter about their mean."""
    level, pixels = reference.level, len(reference.mean)
    if level <= 0.0 or pixels < 2:
        return 0.0, 0.0
    squared = (picture.astype(np.float64) - reference.mean) ** 2 - reference.variance
    each = squared.mean(axis=1) / level**2
    return float(each.mean()), float(each.std(ddof=1)) / float(np.sqrt(pixels))


def trimmed_mean(values: NDArray[np.float64], share: float = TRIMMED) -> float:
    """Mean without the given share of the largest; at least one value stays."""
    keep = max(1, len(values) - int(np.ceil(share * len(values))))
    return float(np.sort(values, kind="stable")[:keep].mean())
