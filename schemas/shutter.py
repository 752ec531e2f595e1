"""Computes when rows of a picture are exposed, and poses between given ones.

Time counts from the sample's, at which the middle of the picture is in the middle of its exposure.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scenec.schemas.lens import NUMPY, Functions

#: Below this |w| of a quaternion (an angle of 2e-9 rad from half a turn) the rule for ties holds.
HALF_TURN_W = 1e-9
#: Below this angle, radians, sines are their arguments to the last bit.
_TINY = 1e-8


@dataclass(frozen=True)
class Shutter:
    """A camera's shutter.

    Attributes:
        exposure_s: How long each row is exposed, seconds; 0: an instant.
        readout_s: How much later the last row's border is exposed than the first row's, seconds; 0:
            all rows at once (a global shutter).
        upward: Whether the lowest row comes first.
    """

    exposure_s: float = 0.0
    readout_s: float = 0.0
    upward: bool = False

    def middles(self, v: NDArray[np.float64], height: int) -> NDArray[np.float64]:
        """Middle of the exposure at heights in the picture, seconds from the sample's time.

        Args:
            v: Rows, pixels: row r's center is at r + 0.5; any shape.
            height: Of the picture, pixels.
        """
        way = -self.readout_s if self.upward else self.readout_s
        return way * (v / height - 0.5)

    @property
    def half_span(self) -> float:
        """Half of the time from the first light on any row to the last, seconds."""
        return 0.5 * (self.exposure_s + self.readout_s)


def between(
    times: NDArray[np.float64],
    poses: NDArray[np.float64],
    at: NDArray[np.float64],
    functions: Functions = NUMPY,
) -> NDArray[np.float64]:
    """Poses at times between given ones, float64 [n, 4, 4].

    Positions go straight at an even speed, turns about one axis at an even rate the shorter way
    (slerp); at half a turn about the axis, in the body's own frame, whose first component that is
    not 0 is above 0. At a given time the pose is that one to the last bit, before the first and
    after the last that one's.

    Args:
        times: Strictly rising, float64 [k], k >= 1.
        poses: Rigid, float64 [k, 4, 4].
        at: In any order, float64 [n].
        functions: What sines and the like are computed with.
    """
    if len(times) == 1:
        return np.repeat(poses, len(at), axis=0)
    i = np.clip(np.searchsorted(times, at, side="right") - 1, 0, len(times) - 2)
    u = np.clip((at - times[i]) / (times[i + 1] - times[i]), 0.0, 1.0)
    first, second = poses[i], poses[i + 1]
    turn = turn_vectors(poses[:-1, :3, :3], poses[1:, :3, :3], functions)[i]
    out = first.copy()
    out[:, :3, :3] = _product(first[:, :3, :3], _turned_by(u[:, None] * turn, functions))
    out[:, :3, 3] = (1.0 - u)[:, None] * first[:, :3, 3] + u[:, None] * second[:, :3, 3]
    # The given ones themselves, to the last bit.
    out[u == 0.0] = first[u == 0.0]
    out[u == 1.0] = second[u == 1.0]
    return out


def turn_vectors(
    a: NDArray[np.float64], b: NDArray[np.float64], functions: Functions = NUMPY
) -> NDArray[np.float64]:
    """Axis times angle (radians, at most pi) from turns a to turns b, in a's frame, [n, 3].

    Args:
        a, b: Rotation matrices, float64 [n, 3, 3].
        functions: As in ``between``.
    """
    m = _product(a.transpose(0, 2, 1), b)
    # Four times the outer product of the quaternion (w, x, y, z) with itself: any of its rows is
    # the quaternion but for its length, and the one of the largest component the exactest.
    q = np.empty((len(m), 4, 4))
    for k, signs in enumerate(((1, 1, 1), (1, -1, -1), (-1, 1, -1), (-1, -1, 1))):
        q[:, k, k] = 1.0 + signs[0] * m[:, 0, 0] + signs[1] * m[:, 1, 1] + signs[2] * m[:, 2, 2]
    for k, i, j in ((1, 2, 1), (2, 0, 2), (3, 1, 0)):
        q[:, 0, k] = q[:, k, 0] = m[:, i, j] - m[:, j, i]
    for k, n in ((1, 2), (1, 3), (2, 3)):
        q[:, k, n] = q[:, n, k] = m[:, k - 1, n - 1] + m[:, n - 1, k - 1]
    largest = np.argmax(q[:, range(4), range(4)], axis=1)
    unit = q[np.arange(len(q)), largest]
    unit /= np.sqrt((unit * unit).sum(axis=1))[:, None]
    sign = np.where(unit[:, 0] < 0.0, -1.0, 1.0)
    half = np.flatnonzero(np.abs(unit[:, 0]) < HALF_TURN_W)
    for k in half.tolist():
        leading = next((x for x in unit[k, 1:].tolist() if abs(x) > HALF_TURN_W), 1.0)
        sign[k] = -1.0 if leading < 0.0 else 1.0
    unit *= sign[:, None]
    sine = np.sqrt((unit[:, 1:] * unit[:, 1:]).sum(axis=1))
    some = sine > _TINY
    angle = 2.0 * functions.atan2(sine, unit[:, 0])
    scale = np.where(some, angle / np.where(some, sine, 1.0), 2.0)
    return np.asarray(scale[:, None] * unit[:, 1:])


def _turned_by(vector: NDArray[np.float64], functions: Functions) -> NDArray[np.float64]:
    """Rotation matrices of axes times angles [n, 3], by Rodrigues' formula: [n, 3, 3]."""
    x, y, z = vector.T
    angle = np.sqrt(x * x + y * y + z * z)
    some = angle > _TINY
    safe = np.where(some, angle, 1.0)
    a = np.where(some, functions.sin(safe) / safe, 1.0)
    # 1 - cos by the half angle, which does not cancel.
    s = functions.sin(0.5 * safe) / safe
    b = np.where(some, 2.0 * s * s, 0.5)
    out = np.empty((len(vector), 3, 3))
    rows = (
        (1.0 - b * (y * y + z * z), b * x * y - a * z, b * x * z + a * y),
        (b * x * y + a * z, 1.0 - b * (x * x + z * z), b * y * z - a * x),
        (b * x * z - a * y, b * y * z + a * x, 1.0 - b * (x * x + y * y)),
    )
    for i, row in enumerate(rows):
        for j, values in enumerate(row):
            out[:, i, j] = values
    return out


def _product(a: NDArray[np.float64], b: NDArray[np.float64]) -> NDArray[np.float64]:
    """Products of matrices [n, 3, 3]; sums written out: BLAS' last bits depend on the CPU."""
    terms = [a[:, :, k, None] * b[:, k, None, :] for k in range(3)]
    return np.asarray(terms[0] + terms[1] + terms[2])
