"""Interpolates poses by a curve that is twice continuously differentiable, with its derivatives.

It goes through every key. Positions are the cubic spline (de Boor 1978, ch. IV). Turns are the
rotation spline of D. Mayorov (Smooth attitude interpolation, 2019; SciPy's ``RotationSpline``):
from key to key a rotation vector that is a cubic of time, such that angular velocities and angular
accelerations are continuous. Velocities at both ends are those of the parabola through three keys,
as ``se3``'s cubic has them; so constant accelerations and constant angular velocities come back
exactly. Of a smooth motion the error falls with the fourth power of the keys' distance, and that
of accelerations with its square; near the ends, where those velocities decide, each one power less.

Velocities at the inner keys solve a block-tridiagonal system that is linear but for a term which
is of second order in the turns; it is dominated by its diagonal, so sweeps through it (Gauss and
Seidel) converge. They fail to only where neighboring keys are nearly half a turn apart.
"""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.geometry.se3 import (
    cross,
    parabola_velocity,
    rotation_vector,
    turn_between,
    turn_by,
    unscrewed,
)
from scenec.schemas.kernels import inlined, kernel
from scenec.schemas.quaternions import quaternion_product_in_kernels as _times

#: Terms of the series of ``_jacobian``: the next is below the last bit up to 6 rad.
_TERMS: Final = 22
#: Sweeps, and the change, in parts of the largest velocity, at which they have converged.
_SWEEPS: Final = 300
_CONVERGED: Final = 4e-16


class SplinePoses(NamedTuple):
    """Holds poses of a spline and their derivatives.

    Attributes:
        position: Meters, float64 [m, 3].
        quaternion: w, x, y, z, of unit length, float64 [m, 4].
        velocity, acceleration: Of the position, m/s and m/s², float64 [m, 3].
        spin, spin_rate: Angular velocity and acceleration, in the body's own axes, rad/s and
            rad/s², float64 [m, 3].
    """

    position: NDArray[np.float64]
    quaternion: NDArray[np.float64]
    velocity: NDArray[np.float64]
    acceleration: NDArray[np.float64]
    spin: NDArray[np.float64]
    spin_rate: NDArray[np.float64]


def spline_poses(
    time_s: NDArray[np.float64],
    position_m: NDArray[np.float64],
    quaternion: NDArray[np.float64],
    at_s: NDArray[np.float64],
) -> SplinePoses | None:
    """The curve through keys at other times; before the first and after the last, that of the key.

    Args:
        time_s: Strictly rising, float64 [n], n >= 1.
        position_m: float64 [n, 3].
        quaternion: w, x, y, z, of unit length, either sign, float64 [n, 4].
        at_s: In any order, float64 [m].

    Returns:
        None where the turns from key to key are too large for a curve to be found.
    """
    arrays = [np.ascontiguousarray(a, np.float64) for a in (time_s, position_m, quaternion, at_s)]
    rate = np.zeros((2, len(time_s), 3))
    if len(time_s) > 1 and not _solve(*arrays[:3], rate):
        return None
    out = np.zeros((len(at_s), 19))
    _evaluate(*arrays, rate, out)
    parts = np.split(out, (3, 7, 10, 13, 16), axis=1)
    return SplinePoses(*map(np.ascontiguousarray, parts))


@inlined
def _jacobian(r, v, a):  # type: ignore[no-untyped-def]
    """Angular velocity and acceleration, in the body's axes, of the rotation vector r(t).

    With v = r', a = r'': the right Jacobian's J v and J a + J' v (G. Chirikjian, Stochastic
    models, information theory, and Lie groups 2, 2012, 10.8). The functions (1 - cos)/x^2 and
    (x - sin)/x^3, and their derivatives over x, are summed as series: no cancellation anywhere.
    """
    square = r[0] * r[0] + r[1] * r[1] + r[2] * r[2]
    f, g, df, dg = 0.5, 1.0 / 6.0, 0.0, 0.0
    power, factorial = 1.0, 6.0
    for k in range(1, _TERMS):
        # (-1)^k x^(2k-2) / (2k + 1)!, of which all four are made.
        term = -power / factorial if k % 2 else power / factorial
        a_k = term / (2.0 * k + 2.0)
        b_k = a_k / (2.0 * k + 3.0)
        f += a_k * square
        g += b_k * square
        df += 2.0 * k * a_k
        dg += 2.0 * k * b_k
        power *= square
        factorial *= (2.0 * k + 2.0) * (2.0 * k + 3.0)
    along = r[0] * v[0] + r[1] * v[1] + r[2] * v[2]
    rv, ra = cross(r, v), cross(r, a)
    rrv, rra, vrv = cross(r, rv), cross(r, ra), cross(v, rv)
    spin = (
        v[0] - f * rv[0] + g * rrv[0],
        v[1] - f * rv[1] + g * rrv[1],
        v[2] - f * rv[2] + g * rrv[2],
    )
    df, dg = df * along, dg * along
    rate = (
        a[0] - f * ra[0] + g * (rra[0] + vrv[0]) - df * rv[0] + dg * rrv[0],
        a[1] - f * ra[1] + g * (rra[1] + vrv[1]) - df * rv[1] + dg * rrv[1],
        a[2] - f * ra[2] + g * (rra[2] + vrv[2]) - df * rv[2] + dg * rrv[2],
    )
    return spin, rate


@inlined
def _end_rate(r, w):  # type: ignore[no-untyped-def]
    """Rate of the rotation vector at a step's end, r, where the angular velocity is w."""
    return unscrewed((-r[0], -r[1], -r[2]), w)


@kernel
def _solve(time, p, q, rate):  # type: ignore[no-untyped-def]
    """Velocities (0) and angular velocities (1) at the keys; whether they have converged."""
    n = len(time)
    step, mean = np.empty(n - 1), np.empty((2, n - 1, 3))
    for i in range(n - 1):
        step[i] = time[i + 1] - time[i]
        turn = rotation_vector(turn_between(q[i], q[i + 1]))
        for k in range(3):
            mean[0, i, k] = (p[i + 1, k] - p[i, k]) / step[i]
            mean[1, i, k] = turn[k] / step[i]
    largest = np.zeros(2)
    for of in range(2):
        for i in range(n):
            # To begin with all of them; those of the ends stay.
            parabola_velocity(step, mean[of], i, rate[of, i])
            for k in range(3):
                largest[of] = max(largest[of], abs(rate[of, i, k]))
    for _ in range(_SWEEPS):
        change = np.zeros(2)
        for i in range(1, n - 1):
            h, g = step[i - 1], step[i]
            r, s = mean[1, i - 1] * h, mean[1, i] * g
            here, before, after = rate[1, i], rate[1, i - 1], rate[1, i + 1]
            e = _end_rate((r[0], r[1], r[2]), (here[0], here[1], here[2]))
            # What of the acceleration at the step's end does not come from r'' alone.
            _, bent = _jacobian((r[0], r[1], r[2]), e, (0.0, 0.0, 0.0))
            _, came = _jacobian(
                (r[0], r[1], r[2]), (0.0, 0.0, 0.0), (before[0], before[1], before[2])
            )
            next_ = _end_rate((s[0], s[1], s[2]), (after[0], after[1], after[2]))
            for k in range(3):
                rise = 3.0 * (mean[0, i - 1, k] / h + mean[0, i, k] / g)
                sides = rate[0, i - 1, k] / h + rate[0, i + 1, k] / g
                new = (rise - sides) / (2.0 * (1.0 / h + 1.0 / g))
                change[0] = max(change[0], abs(new - rate[0, i, k]))
                rate[0, i, k] = new
                rise = 3.0 * (mean[1, i - 1, k] / h + mean[1, i, k] / g)
                sides = came[k] / h + next_[k] / g + 0.5 * bent[k]
                new = (rise - sides) / (2.0 * (1.0 / h + 1.0 / g))
                change[1] = max(change[1], abs(new - here[k]))
                here[k] = new
        if not np.isfinite(change[1]):
            return False
        if change[0] <= _CONVERGED * largest[0] and change[1] <= _CONVERGED * largest[1]:
            return True
    # What is left is rounding, where it is so small; else the sweeps go round and round.
    return change[0] <= 1e-12 * largest[0] and change[1] <= 1e-12 * largest[1]


@kernel
def _evaluate(time, p, q, at, rate, out):  # type: ignore[no-untyped-def]
    n = len(time)
    for m in range(len(at)):
        if n == 1:
            out[m, :3], out[m, 3:7] = p[0], q[0]
            continue
        i = min(max(np.searchsorted(time, at[m], side="right") - 1, 0), n - 2)
        h = time[i + 1] - time[i]
        u = min(max((at[m] - time[i]) / h, 0.0), 1.0)
        r = 1.0 - u
        turn = rotation_vector(turn_between(q[i], q[i + 1]))
        w0, w1 = rate[1, i], rate[1, i + 1]
        end = _end_rate((turn[0], turn[1], turn[2]), (w1[0], w1[1], w1[2]))
        value, first, second = np.empty(3), np.empty(3), np.empty(3)
        for of in range(2):
            for k in range(3):
                begin = p[i, k] if of == 0 else 0.0
                rise = p[i + 1, k] - p[i, k] if of == 0 else turn[k]
                v0 = h * (rate[0, i, k] if of == 0 else w0[k])
                v1 = h * (rate[0, i + 1, k] if of == 0 else end[k])
                # From the chord, as ``se3``'s cubic.
                a, b = v0 - rise, v1 - rise
                value[k] = begin + u * rise + u * r * (r * a - u * b)
                first[k] = (rise + (1.0 - 4.0 * u + 3.0 * u * u) * a + u * (3.0 * u - 2.0) * b) / h
                second[k] = ((6.0 * u - 4.0) * a + (6.0 * u - 2.0) * b) / (h * h)
            if of == 0:
                out[m, :3], out[m, 7:10], out[m, 10:13] = value, first, second
        spin, bent = _jacobian(
            (value[0], value[1], value[2]),
            (first[0], first[1], first[2]),
            (second[0], second[1], second[2]),
        )
        for k in range(3):
            out[m, 13 + k], out[m, 16 + k] = spin[k], bent[k]
        if u == 0.0 or u == 1.0:
            # The key itself, to the last bit.
            key = i + 1 if u == 1.0 else i
            out[m, :3], out[m, 3:7] = p[key], q[key]
            continue
        d = _times((q[i, 0], q[i, 1], q[i, 2], q[i, 3]), turn_by(value[0], value[1], value[2]))
        length = np.sqrt(d[0] * d[0] + d[1] * d[1] + d[2] * d[2] + d[3] * d[3])
        for k in range(4):
            out[m, 3 + k] = d[k] / length
