"""Drives straight lines, arcs, and turns on the spot at a limited rate."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.arithmetic import elementary

#: Corners that turn by less are none, radians.
_STRAIGHT = 1e-9


@dataclass(frozen=True)
class Legs:
    """Legs one after another; headings are angles from +x (east), counter-clockwise.

    Attributes:
        start: Where each begins, float64 [n, 2].
        heading: There, radians, [n].
        length: meters, [n]; 0 for turns on the spot.
        turn: How far each turns, radians, signed, [n].
        seconds: How long each takes, [n].
    """

    start: NDArray[np.float64]
    heading: NDArray[np.float64]
    length: NDArray[np.float64]
    turn: NDArray[np.float64]
    seconds: NDArray[np.float64]

    @property
    def duration_s(self) -> float:
        """Returns the duration of all legs together."""
        return float(np.cumsum(np.append(0.0, self.seconds))[-1])

    def at(self, time_s: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Positions [m, 2] and level directions [m, 2] at times after the beginning."""
        begins = np.cumsum(np.append(0.0, self.seconds))[:-1]
        i = np.clip(np.searchsorted(begins, time_s, side="right") - 1, 0, len(begins) - 1)
        seconds = np.where(self.seconds[i] > 0.0, self.seconds[i], 1.0)
        part = np.clip((time_s - begins[i]) / seconds, 0.0, 1.0)
        half = 0.5 * part * self.turn[i]
        # A chord of an arc: the length times sin(half) / half, along the middle heading.
        bent = np.abs(half) > 1e-9
        ratio = np.where(bent, elementary.sin_array(half) / np.where(bent, half, 1.0), 1.0)
        chord = part * self.length[i] * ratio
        middle = self.heading[i] + half
        xy = self.start[i] + chord[:, None] * _direction(middle)
        return xy, _direction(middle + half)


def _direction(angle: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.stack([elementary.cos_array(angle), elementary.sin_array(angle)], axis=1)


class Pen:
    """Lays legs from a point on."""

    def __init__(self, x: float, y: float, heading: float, speed: float, turn_rate: float) -> None:
        """A pen at a point.

        Args:
            heading: Radians from +x, counter-clockwise.
            speed: Of all legs, m/s; less in arcs that would turn faster than allowed.
            turn_rate: At most, rad/s.
        """
        self.at = np.array([x, y], np.float64)
        self.heading = heading
        self._speed, self._turn_rate = speed, turn_rate
        self._rows: list[tuple[float, ...]] = []

    def go(self, length: float, turn: float = 0.0) -> None:
        """A leg of a length, turning by an angle (counter-clockwise above 0) evenly."""
        if length <= 0.0 and turn == 0.0:
            return
        seconds = max(length / self._speed, abs(turn) / self._turn_rate)
        row = (float(self.at[0]), float(self.at[1]), self.heading, max(length, 0.0), turn, seconds)
        self._rows.append(row)
        one = self._legs([row])
        self.at = one.at(np.array([seconds]))[0][0]
        self.heading += turn

    def done(self) -> Legs:
        """Returns the legs; a path without length has one leg that takes no time."""
        rows = self._rows or [(float(self.at[0]), float(self.at[1]), self.heading, 0.0, 0.0, 0.0)]
        return self._legs(rows)

    @staticmethod
    def _legs(rows: list[tuple[float, ...]]) -> Legs:
        table = np.array(rows, np.float64)
        return Legs(table[:, :2], *(table[:, k].copy() for k in range(2, 6)))


def rounded(points: NDArray[np.float64], speed: float, turn_rate: float) -> Legs:
    """A way through points whose corners are arcs, as wide as the turn rate asks for at full speed.

    Where the lines beside a corner are too short for such an arc (each gives half of itself at
    most), the arc is narrower and driven slower; where one turns back, the turn is on the spot.

    Args:
        points: float64 [n, 2], n >= 1; equal neighbors count once.
        speed: m/s.
        turn_rate: rad/s.
    """
    moves = np.append(True, (points[1:] != points[:-1]).any(axis=1))
    points = points[moves]
    if len(points) == 1:
        return Pen(points[0, 0], points[0, 1], 0.5 * elementary.PI, speed, turn_rate).done()
    way = points[1:] - points[:-1]
    length = np.sqrt((way * way).sum(axis=1))
    headings = [float(elementary.atan2(dy, dx)) for dx, dy in way.tolist()]
    pen = Pen(points[0, 0], points[0, 1], headings[0], speed, turn_rate)
    spent = 0.0
    for i in range(len(way)):
        if i + 1 == len(way):
            pen.go(float(length[i]) - spent)
            break
        turn = _smallest(headings[i + 1] - headings[i])
        quarter = 0.5 * abs(turn)
        room = 0.5 * float(min(length[i], length[i + 1]))
        if abs(turn) < _STRAIGHT:
            radius, cut = 0.0, 0.0
        else:
            tangent = elementary.sin(quarter) / max(elementary.cos(quarter), 1e-12)
            radius = min(speed / turn_rate, room / tangent)
            cut = radius * tangent
            if quarter > 0.4999 * elementary.PI:
                # Turning back, an arc would be of no width.
                radius, cut = 0.0, 0.0
        pen.go(float(length[i]) - spent - cut)
        if turn != 0.0:
            pen.go(radius * abs(turn), turn)
        # Rounding must not add up over thousands of corners.
        pen.at = points[i + 1] + cut * way[i + 1] / length[i + 1]
        pen.heading = headings[i + 1]
        spent = cut
    return pen.done()


def _smallest(angle: float) -> float:
    """The same angle in (-pi, pi]; exactly half a turn is to the left."""
    whole = 2.0 * elementary.PI
    angle = angle - whole * float(np.floor(angle / whole + 0.5))
    return elementary.PI if angle <= -elementary.PI * (1.0 - 1e-12) else angle
