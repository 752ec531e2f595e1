"""Computes the normal distribution and its inverse, from elementary functions of our own.

Kept to one half of the line by symmetry, where probabilities keep their relative precision, so that
a distribution truncated far out in a tail is drawn as well as any other.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.arithmetic.elementary import PI, exp, horner, log
from scenec.schemas.kernels import kernel

#: Truncation farther out than this many standard deviations underflows.
MAX_SIGMAS = 30.0

_SQRT_2PI = float(np.sqrt(2.0 * PI))

# Wichura 1988, algorithm AS 241 (PPND16), Applied Statistics 37 (3): relative error about 1e-16.
_A = (
    3.3871328727963666080e0, 1.3314166789178437745e2, 1.9715909503065514427e3,
    1.3731693765509461125e4, 4.5921953931549871457e4, 6.7265770927008700853e4,
    3.3430575583588128105e4, 2.5090809287301226727e3,
)  # fmt: skip
_B = (
    1.0, 4.2313330701600911252e1, 6.8718700749205790830e2, 5.3941960214247511077e3,
    2.1213794301586595867e4, 3.9307895800092710610e4, 2.8729085735721942674e4,
    5.2264952788528545610e3,
)  # fmt: skip
_C = (
    1.42343711074968357734e0, 4.63033784615654529590e0, 5.76949722146069140550e0,
    3.64784832476320460504e0, 1.27045825245236838258e0, 2.41780725177450611770e-1,
    2.27238449892691845833e-2, 7.74545014278341407640e-4,
)  # fmt: skip
_D = (
    1.0, 2.05319162663775882187e0, 1.67638483018380384940e0, 6.89767334985100004550e-1,
    1.48103976427480074590e-1, 1.51986665636164571966e-2, 5.47593808499534494600e-4,
    1.05075007164441684324e-9,
)  # fmt: skip
_E = (
    6.65790464350110377720e0, 5.46378491116411436990e0, 1.78482653991729133580e0,
    2.96560571828504891230e-1, 2.65321895265761230930e-2, 1.24266094738807843860e-3,
    2.71155556874348757815e-5, 2.01033439929228813265e-7,
)  # fmt: skip
_F = (
    1.0, 5.99832206555887937690e-1, 1.36929880922735805310e-1, 1.48753612908506148525e-2,
    7.86869131145613259100e-4, 1.84631831751005468180e-5, 1.42151175831644588870e-7,
    2.04426310338993978564e-15,
)  # fmt: skip


@kernel
def lower_tail(x: float) -> float:
    """Probability of a standard normal number below ``x``, for x <= 0 to relative 1e-13."""
    density = exp(-0.5 * x * x) / _SQRT_2PI
    if x > -3.0:
        # Phi(x) = 1/2 + phi(x) (x + x^3/3 + x^5/(3 5) + ...), by parts.
        term = x
        total = x
        k = 3.0
        while abs(term) > 1e-17 * abs(total):
            term = term * x * x / k
            total += term
            k += 2.0
        return 0.5 + density * total
    # Laplace's continued fraction of Mills' ratio: 1/(z + 1/(z + 2/(z + 3/...))).
    fraction = -x
    for k in range(300, 0, -1):
        fraction = -x + k / fraction
    return density / fraction


@kernel
def _quantile_below_half(p: float) -> float:
    q = p - 0.5
    if q > -0.425:
        r = 0.180625 - q * q
        return q * horner(_A, r) / horner(_B, r)
    r = np.sqrt(-log(p))
    if r <= 5.0:
        return -horner(_C, r - 1.6) / horner(_D, r - 1.6)
    return -horner(_E, r - 5.0) / horner(_F, r - 5.0)


@kernel
def quantile(p: float) -> float:
    """The x below which a standard normal number falls with probability ``p`` in (0, 1)."""
    if p <= 0.5:
        return _quantile_below_half(p)
    return -_quantile_below_half(1.0 - p)


@kernel
def _truncated_loop(uniforms: NDArray, low: float, high: float, out: NDArray) -> None:
    # Mirrored where the interval lies above 0, so that its lower end is never near p = 1.
    mirrored = low > 0.0
    if mirrored:
        low, high = -high, -low
    p_low = 0.0 if low < -38.0 else lower_tail(low)
    p_high = lower_tail(high) if high <= 0.0 else 1.0 - lower_tail(-high)
    for i in range(uniforms.size):
        u = 1.0 - uniforms[i] if mirrored else uniforms[i]
        p = p_low + u * (p_high - p_low)
        # A stream's 0 is half a step of it: the quantile is infinite at 0 and at 1.
        p = min(max(p, 2.0**-54 * (p_high - p_low)), 1.0 - 2.0**-53)
        x = min(max(quantile(p), low), high)
        out[i] = -x if mirrored else x


def truncated(
    uniforms: NDArray[np.float64], low: float = -np.inf, high: float = np.inf
) -> NDArray[np.float64]:
    """Standard normal numbers truncated to [low, high], by inversion: one for each uniform.

    Args:
        uniforms: In [0, 1), float64 [n].
        low: Lower bound, below ``MAX_SIGMAS``; may be -inf.
        high: Upper bound, above -``MAX_SIGMAS``; may be inf.

    Returns:
        float64 [n], rising with the uniforms.
    """
    out = np.empty_like(uniforms)
    _truncated_loop(uniforms, float(low), float(high), out)
    return out
