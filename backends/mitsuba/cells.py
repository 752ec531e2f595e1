"""Where the cells are that pictures lie in, for Mitsuba; ``surface.cells`` defines them."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from scenec.backends.stage.scene import Maps
from scenec.backends.surface import cells


class Corner(NamedTuple):
    """One of the three cells at a point.

    Attributes:
        u, v: Where the picture is looked up.
        share, gain: Of what is mixed by the shares alone, and so that variance stays.
        cosine, sine: Of its turn.
    """

    u: Any
    v: Any
    share: Any
    gain: Any
    cosine: Any
    sine: Any


class Lattice:
    """Where the cells are that a picture lies in."""

    def __init__(self, mi: Any, maps: Maps, center: NDArray[np.float64], factor: float) -> None:
        """The cells of maps.

        Args:
            mi: Mitsuba.
            maps: With cells.
            center: Of the scene, meters.
            factor: How much larger pictures and cells are.
        """
        import drjit as dr

        assert maps.cells is not None
        self._mi, self._dr = mi, dr
        side = maps.cells.size_m * factor
        start = np.mod(np.array(cells.TO_LATTICE) @ center[:2] / side, cells.SIDE)
        # Opaque: another scene's numbers are no other kernel to compile.
        self._step, self._repeats, self._start_s, self._start_t = (
            dr.opaque(mi.Float, float(value))
            for value in (1.0 / side, side / (maps.size_m * factor), *start)
        )
        self._table = _table(mi, maps.cells.seed)

    def corners(self, p: Any, active: Any) -> list[Corner]:
        """The three cells at a point."""
        dr = self._dr
        (_, skew), (_, rise) = cells.TO_LATTICE
        (_, lean), (_, high) = cells.TO_WORLD
        s = (p.x + skew * p.y) * self._step + self._start_s
        t = rise * p.y * self._step + self._start_t
        column, row = dr.floor(s), dr.floor(t)
        x, y = s - column, t - row
        rest = 1.0 - x - y
        upper = dr.select(rest <= 0.0, 1.0, 0.0)
        both = upper * rest
        fourth = [dr.square(dr.square(n)) for n in (rest, x + both, y + both)]
        total = fourth[0] + fourth[1] + fourth[2]
        spread = dr.rsqrt(dr.square(fourth[0]) + dr.square(fourth[1]) + dr.square(fourth[2]))
        found = []
        for power, i, j in zip(fourth, (upper, 1.0, 0.0), (upper, 0.0, 1.0), strict=True):
            dx, dy = (x - i), (y - j)
            dx, dy = (dx + lean * dy) * self._repeats, high * dy * self._repeats
            shift_u, shift_v, cosine, sine = self._entry(column + i, row + j, active)
            u = cosine * dx - sine * dy + shift_u
            v = sine * dx + cosine * dy + shift_v
            found.append(Corner(u, v, power / total, power * spread, cosine, sine))
        return found

    def _entry(self, i: Any, j: Any, active: Any) -> Any:
        """Shifts, cosine and sine of the turn, of a corner."""
        mi = self._mi
        last = cells.SIDE - 1
        index = (mi.Int32(j) & last) * cells.SIDE + (mi.Int32(i) & last)
        return self._dr.gather(mi.Vector4f, self._table, mi.UInt32(index), active)


@lru_cache(maxsize=8)
def _table(mi: Any, seed: int) -> Any:
    """Shifts, cosine and sine of the turn, of each corner."""
    entry = cells.table(seed).reshape(-1, 3)
    turn = 2.0 * np.pi * entry[:, 2]
    rows = np.stack([entry[:, 0], entry[:, 1], np.cos(turn), np.sin(turn)], axis=1)
    return mi.Float(rows.astype(np.float32).ravel())


def turned_back(mapped: Iterable[tuple[Corner, Sequence[Any]]]) -> list[Any]:
    """x, y and z of the mixture of normals of the three cells, before it is made a unit vector."""
    x = y = z = 0.0
    for corner, (u, v, w) in mapped:
        x = x + corner.gain * (corner.cosine * u + corner.sine * v)
        y = y + corner.gain * (corner.cosine * v - corner.sine * u)
        z = z + corner.share * w
    return [x, y, z]
