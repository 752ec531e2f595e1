"""Heaps fines about the feet of stones: ramps that the ground rises by toward what stands in it.

A stone has an outline where the ground meets it, and about that a ramp of height h and reach w,
which differ from side to side: at a distance d from the outline the ground is higher by
h (1 - d / w)^2. Under the stone the ramp goes on as steep as it arrives, bends level within half of
its reach, and turns into one height toward the middle: nobody sees it, and the mesh has no edge to
follow. Where ramps overlap the highest counts.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.terrain.bins import BinIndex, any_within, bin_at, binned, bins_between
from scenec.compiler.terrain.detail import Spectrum
from scenec.schemas.kernels import inlined, kernel
from scenec.schemas.threads import POINTS, over_threads

#: Directions in which an outline is known, four times a whole number.
SIDES = 24
#: Part of its reach within which a ramp bends level under its stone; how high it then is, in
#: heights at the outline.
_LEVEL, _CORE = 0.5, 1.5


class Feet(NamedTuple):
    """Holds the outlines of stones in the ground, and the fillets around them.

    Attributes:
        x, y: Middles of outlines, meters, float64 [n].
        height: At the outline, meters, float64 [n].
        reach: From there outward, meters, above 0, float64 [n].
        outline: Radii of it in ``directions()``, meters, float64 [n, SIDES].
        share: Of height and reach in each direction, above 0, float64 [n, SIDES].
    """

    x: NDArray[np.float64]
    y: NDArray[np.float64]
    height: NDArray[np.float64]
    reach: NDArray[np.float64]
    outline: NDArray[np.float64]
    share: NDArray[np.float64]


def directions() -> NDArray[np.float64]:
    """Unit vectors, evenly along a square on its corner, counter-clockwise: float64 [SIDES, 2]."""
    t = np.arange(SIDES) * (4.0 / SIDES)
    x = np.abs(t - 2.0) - 1.0
    y = np.where(t <= 2.0, 1.0, -1.0) * (1.0 - np.abs(x))
    return np.stack([x, y], axis=1) / np.sqrt(x * x + y * y)[:, None]


@dataclass(frozen=True, eq=False)
class Fillets:
    """The ramps of one class of stones, as detail: see ``terrain.detail.Detail`` and ``Local``.

    Attributes:
        feet: Of each stone.
        far: How far from its middle each ramp ends at most, meters, float64 [n].
        bins: Where they are.
    """

    feet: Feet
    far: NDArray[np.float64]
    bins: BinIndex

    @classmethod
    def of(cls, feet: Feet) -> Fillets:
        """Ramps of one stone or more."""
        far = feet.outline.max(axis=1) + feet.reach * feet.share.max(axis=1)
        corner = float((feet.x - far).min()), float((feet.y - far).min())
        sizes = (float((feet.x + far).max()) - corner[0], float((feet.y + far).max()) - corner[1])
        # So wide that a stone is in about four bins, however many are large.
        width = 2.0 * float(np.sqrt((far * far).mean()))
        bins = binned(feet.x, feet.y, far, (corner, sizes), width)
        return cls(feet, far, bins)

    def at(self, x: NDArray[np.float64], y: NDArray[np.float64]) -> NDArray[np.float64]:
        """Meters to add at points, float64 [n]."""
        out = np.empty(x.size)
        over_threads(_heights_part, x.size, self.feet, self.far, self.bins, x, y, out, least=POINTS)
        return out

    def finer_at(
        self,
        x: NDArray[np.float64],
        y: NDArray[np.float64],
        radius_m: NDArray[np.float64],
        length_m: NDArray[np.float64],
    ) -> NDArray[np.float64]:
        """About how large what is finer than lengths is in disks, meters, float64 [n].

        A ramp counts as a wave of twice its reach, where it ends in the disk, and as high as it is
        at the outline.
        """
        out = np.empty(x.size)
        over_threads(
            _finer_part, x.size, (self.feet, self.far, self.bins), x, y,
             radius_m, length_m, out, least=POINTS,
        )  # fmt: skip
        return out

    def spectrum(self) -> Spectrum:
        """Returns the spectrum of the highest fillet, under its stone: see ``_ramp``."""
        highest = float(
            (_CORE * self.feet.height * np.maximum(self.feet.share.max(axis=1), 1.0)).max()
        )
        return Spectrum(np.array([2.0 * float(self.feet.reach.min())]), np.array([highest]))


@inlined
def _side(dx: float, dy: float) -> float:
    """Returns the place of a direction among ``directions()``, in [0, SIDES]."""
    around = abs(dx) + abs(dy)
    if dy >= 0.0:
        turn = dy / around if dx >= 0.0 else 1.0 - dx / around
    else:
        turn = 2.0 - dy / around if dx < 0.0 else 3.0 + dx / around
    return turn * (SIDES / 4.0)


@inlined
def _ramp(feet: Feet, n: int, dx: float, dy: float) -> float:
    """Height of a stone's ramp so far from its middle, meters."""
    r = np.sqrt(dx * dx + dy * dy)
    core = _CORE * feet.height[n]
    if r == 0.0:
        return core
    side = _side(dx, dy)
    k = int(side)
    t = side - k
    k, after = k % SIDES, (k + 1) % SIDES
    outline = feet.outline[n, k] + t * (feet.outline[n, after] - feet.outline[n, k])
    share = feet.share[n, k] + t * (feet.share[n, after] - feet.share[n, k])
    height, reach = share * feet.height[n], share * feet.reach[n]
    outward = (r - outline) / reach
    if outward >= 1.0:
        return 0.0
    if outward >= 0.0:
        return height * (1.0 - outward) * (1.0 - outward)
    inward = min(-outward, _LEVEL)
    there = height * (1.0 + 2.0 * inward - inward * inward / _LEVEL)
    part = r / outline
    return core + (there - core) * part * part * (3.0 - 2.0 * part)


@kernel
def _heights_part(first, last, feet, far, bins, x, y, out):  # type: ignore[no-untyped-def]
    for n in range(first, last):
        at = bin_at(bins, x[n], y[n])
        highest = 0.0
        for m in range(bins.start[at], bins.start[at + 1]):
            k = bins.member[m]
            dx, dy = x[n] - feet.x[k], y[n] - feet.y[k]
            if dx * dx + dy * dy < far[k] * far[k]:
                highest = max(highest, _ramp(feet, k, dx, dy))
        out[n] = highest


@kernel
def _finer_part(first, last, fillets, x, y, radius, length, out):  # type: ignore[no-untyped-def]
    feet, far, bins = fillets
    ny, nx = bins.before.shape[0] - 1, bins.before.shape[1] - 1
    for n in range(first, last):
        out[n] = 0.0
        r = radius[n]
        if not any_within(bins, x[n], y[n], r):
            continue
        i0, i1 = bins_between(x[n] - r, x[n] + r, bins.x0, bins.size, nx)
        j0, j1 = bins_between(y[n] - r, y[n] + r, bins.y0, bins.size, ny)
        for j in range(j0, j1 + 1):
            for m in range(bins.start[j * nx + i0], bins.start[j * nx + i1 + 1]):
                k = bins.member[m]
                if feet.height[k] <= out[n] or 2.0 * feet.reach[k] >= length[n]:
                    continue
                dx, dy = x[n] - feet.x[k], y[n] - feet.y[k]
                if dx * dx + dy * dy < (far[k] + r) * (far[k] + r):
                    out[n] = feet.height[k]
