"""Interpolates poses over time on R3 x SO(3), or along screws of SE(3).

Positions and turns are interpolated apart from each other, unless a screw is asked for. A track
tells where a camera's center was: apart, the centers move in straight lines at an even speed
whatever the turn, and an error of a turn is no error of a position. A screw (a rotation about one
fixed axis with a shift along it) takes the center off its chord by up to
|translation| * tan(angle / 4) / 2, to the other side beyond a half turn; it is right where the key
poses were sampled from a screw, such as an arm's or a wheel's, and it alone does not depend on
which point of the body the poses speak of.

Turns are taken by the difference of neighbors, ``conj(a) * b``, of whose two signs the one with
w >= 0 is chosen: so the double cover does not matter, and each step goes the shorter way. At a half
turn both ways are as long; the rule there (|w| below ``HALF_TURN_W``): about the axis, in the
body's own frame, whose first component that is not 0 is above 0. A faster rotation than half a turn
from key to key cannot be told from a slower one the other way.

Cubic: positions by Hermite cubics, turns by cumulative Bezier curves of unit quaternions (Kim, Kim
and Shin 1995, "A general construction scheme for unit quaternion curves with simple high order
derivatives"), velocities at the keys from the parabola through three (Catmull and Rom 1974, for
uneven times). It goes through every key and its velocities are continuous (C1); constant
accelerations and constant angular velocities come back exactly.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.arithmetic import elementary
from scenec.schemas.kernels import inlined, kernel
from scenec.schemas.quaternions import quaternion_product_in_kernels as _times
from scenec.schemas.quaternions import rotation_entries

LINEAR: Final = 0
SCREW: Final = 1
CUBIC: Final = 2
METHODS: Final = {"linear": LINEAR, "screw": SCREW, "cubic": CUBIC}

#: Below this |w| of a difference (an angle of 2e-9 rad from a half turn) the rule for ties holds.
HALF_TURN_W: Final = 1e-9
_TINY: Final = 1e-8


def interpolate(
    time_s: NDArray[np.float64],
    position_m: NDArray[np.float64],
    quaternion: NDArray[np.float64],
    at_s: NDArray[np.float64],
    method: str = "linear",
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Positions [m, 3] and unit quaternions (w, x, y, z) [m, 4] at other times.

    Before the first key and after the last the pose is that key's.

    Args:
        time_s: Strictly rising, float64 [n], n >= 1.
        position_m: float64 [n, 3].
        quaternion: w, x, y, z, of unit length, either sign, float64 [n, 4].
        at_s: In any order, float64 [m].
        method: One of ``METHODS``.
    """
    out_p, out_q = np.empty((len(at_s), 3)), np.empty((len(at_s), 4))
    arrays = [np.ascontiguousarray(a, np.float64) for a in (time_s, position_m, quaternion, at_s)]
    _interpolate(*arrays, METHODS[method], out_p, out_q)
    return out_p, out_q


def matrices(
    position_m: NDArray[np.float64], quaternion: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Pose matrices, float64 [n, 4, 4], of positions [n, 3] and unit quaternions [n, 4]."""
    w, x, y, z = quaternion.T
    out = np.zeros((len(position_m), 4, 4))
    out[:, :3, :3] = np.stack(rotation_entries(x, y, z, w, 2.0), axis=1).reshape(-1, 3, 3)
    out[:, :3, 3] = position_m
    out[:, 3, 3] = 1.0
    return out


@inlined
def _turned(q, v):  # type: ignore[no-untyped-def]
    """The vector v turned by q."""
    p = _times(_times(q, (0.0, v[0], v[1], v[2])), (q[0], -q[1], -q[2], -q[3]))
    return p[1], p[2], p[3]


@kernel
def turn_between(a, b):  # type: ignore[no-untyped-def]
    """conj(a) * b, of the sign that turns the shorter way."""
    r = _times((a[0], -a[1], -a[2], -a[3]), (b[0], b[1], b[2], b[3]))
    flip = r[0] < 0.0
    if abs(r[0]) < HALF_TURN_W:
        flip = False
        for k in range(1, 4):
            if abs(r[k]) > HALF_TURN_W:
                flip = r[k] < 0.0
                break
    if flip:
        return -r[0], -r[1], -r[2], -r[3]
    return r


@kernel
def rotation_vector(r):  # type: ignore[no-untyped-def]
    """Rotation vector of a unit quaternion: axis times angle, radians."""
    s = np.sqrt(r[1] * r[1] + r[2] * r[2] + r[3] * r[3])
    # Near no turn, angle / s = 2 + O(s^2), which is 2 to the last bit.
    k = 2.0 * elementary.atan2(s, r[0]) / s if s > _TINY else 2.0
    return np.array([k * r[1], k * r[2], k * r[3]])


@inlined
def turn_by(x, y, z):  # type: ignore[no-untyped-def]
    """Unit quaternion of a rotation vector."""
    angle = np.sqrt(x * x + y * y + z * z)
    half = 0.5 * angle
    k = elementary.sin(half) / angle if angle > _TINY else 0.5
    return elementary.cos(half), k * x, k * y, k * z


@inlined
def cross(a, b):  # type: ignore[no-untyped-def]
    """Computes the cross product, a tuple."""
    return (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])


@kernel
def unscrewed(w, t):  # type: ignore[no-untyped-def]
    """V(w)^-1 t: what the translational part of the twist of a displacement (exp w, t) is."""
    square = w[0] * w[0] + w[1] * w[1] + w[2] * w[2]
    angle = np.sqrt(square)
    if angle < 1e-4:
        # 1 / 12 + angle^2 / 720: the next term is below the last bit.
        k = 1.0 / 12.0 + square / 720.0
    else:
        half = 0.5 * angle
        k = (1.0 - half * elementary.cos(half) / elementary.sin(half)) / square
    c = cross(w, t)
    d = cross(w, c)
    return (
        t[0] - 0.5 * c[0] + k * d[0],
        t[1] - 0.5 * c[1] + k * d[1],
        t[2] - 0.5 * c[2] + k * d[2],
    )


@kernel
def _screw_step(w, v):  # type: ignore[no-untyped-def]
    """V(w) v: the translation of a twist (w, v) over a unit of time."""
    square = w[0] * w[0] + w[1] * w[1] + w[2] * w[2]
    angle = np.sqrt(square)
    if angle < 1e-4:
        a = 0.5 - square / 24.0
        b = 1.0 / 6.0 - square / 120.0
    else:
        s = elementary.sin(0.5 * angle)
        # 1 - cos by the half angle, which does not cancel.
        a = 2.0 * s * s / square
        b = (1.0 - elementary.sin(angle) / angle) / square
    c = cross(w, v)
    d = cross(w, c)
    return v[0] + a * c[0] + b * d[0], v[1] + a * c[1] + b * d[1], v[2] + a * c[2] + b * d[2]


@kernel
def parabola_velocity(step, rate, i, out):  # type: ignore[no-untyped-def]
    """Velocity at key i from the mean ones of the steps around it: the parabola through three."""
    steps = len(step)
    for k in range(3):
        if steps == 1:
            out[k] = rate[0, k]
        elif i == 0:
            inner = (step[1] * rate[0, k] + step[0] * rate[1, k]) / (step[0] + step[1])
            out[k] = 2.0 * rate[0, k] - inner
        elif i == steps:
            h, g = step[steps - 2], step[steps - 1]
            inner = (g * rate[steps - 2, k] + h * rate[steps - 1, k]) / (h + g)
            out[k] = 2.0 * rate[steps - 1, k] - inner
        else:
            h, g = step[i - 1], step[i]
            out[k] = (g * rate[i - 1, k] + h * rate[i, k]) / (h + g)


@kernel
def _interpolate(time, p, q, at, method, out_p, out_q):  # type: ignore[no-untyped-def]
    n = len(time)
    step = np.empty(max(n - 1, 1))
    spin = np.zeros((max(n - 1, 1), 3))
    move = np.zeros((max(n - 1, 1), 3))
    for i in range(n - 1):
        step[i] = time[i + 1] - time[i]
        spin[i] = rotation_vector(turn_between(q[i], q[i + 1]))
        if method == CUBIC:
            spin[i] /= step[i]
            for k in range(3):
                move[i, k] = (p[i + 1, k] - p[i, k]) / step[i]
        elif method == SCREW:
            way = p[i + 1] - p[i]
            local = _turned((q[i, 0], -q[i, 1], -q[i, 2], -q[i, 3]), (way[0], way[1], way[2]))
            v = unscrewed((spin[i, 0], spin[i, 1], spin[i, 2]), local)
            for k in range(3):
                move[i, k] = v[k]
    v0, v1, w0, w1 = np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    for m in range(len(at)):
        i = min(max(np.searchsorted(time, at[m], side="right") - 1, 0), max(n - 2, 0))
        u = 0.0
        if n > 1:
            u = min(max((at[m] - time[i]) / step[i], 0.0), 1.0)
        if u == 0.0 or u == 1.0:
            # The key itself, to the last bit.
            key = i + 1 if u == 1.0 else i
            out_p[m] = p[key]
            out_q[m] = q[key]
            continue
        base = (q[i, 0], q[i, 1], q[i, 2], q[i, 3])
        if method == CUBIC:
            h = step[i]
            parabola_velocity(step, move, i, v0)
            parabola_velocity(step, move, i + 1, v1)
            parabola_velocity(step, spin, i, w0)
            parabola_velocity(step, spin, i + 1, w1)
            r = 1.0 - u
            for k in range(3):
                # From the chord: the cubic's departure from it is 0 where the velocity is even.
                rise = move[i, k]
                bend = r * (v0[k] - rise) - u * (v1[k] - rise)
                out_p[m, k] = r * p[i, k] + u * p[i + 1, k] + h * u * r * bend
            a = turn_by(w0[0] * h / 3.0, w0[1] * h / 3.0, w0[2] * h / 3.0)
            c = turn_by(w1[0] * h / 3.0, w1[1] * h / 3.0, w1[2] * h / 3.0)
            whole = turn_by(spin[i, 0] * h, spin[i, 1] * h, spin[i, 2] * h)
            middle = _times(_times((a[0], -a[1], -a[2], -a[3]), whole), (c[0], -c[1], -c[2], -c[3]))
            b = rotation_vector(turn_between((1.0, 0.0, 0.0, 0.0), middle))
            b1 = (1.0 - r * r * r) * h / 3.0
            b2 = u * u * (3.0 - 2.0 * u)
            b3 = u * u * u * h / 3.0
            turn = _times(
                _times(
                    turn_by(b1 * w0[0], b1 * w0[1], b1 * w0[2]),
                    turn_by(b2 * b[0], b2 * b[1], b2 * b[2]),
                ),
                turn_by(b3 * w1[0], b3 * w1[1], b3 * w1[2]),
            )
        else:
            w = (u * spin[i, 0], u * spin[i, 1], u * spin[i, 2])
            turn = turn_by(w[0], w[1], w[2])
            if method == SCREW:
                v = _screw_step(w, (u * move[i, 0], u * move[i, 1], u * move[i, 2]))
                way = _turned(base, v)
                for k in range(3):
                    out_p[m, k] = p[i, k] + way[k]
            else:
                for k in range(3):
                    out_p[m, k] = (1.0 - u) * p[i, k] + u * p[i + 1, k]
        d = _times(base, turn)
        length = np.sqrt(d[0] * d[0] + d[1] * d[1] + d[2] * d[2] + d[3] * d[3])
        for k in range(4):
            out_q[m, k] = d[k] / length
