"""Heaps barchans: single crescent dunes whose horns point downwind."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.arithmetic import elementary
from scenec.compiler.distributions.numbers import Number, draw_number
from scenec.compiler.kinds import Context, forms, key
from scenec.compiler.terrain.grid import Applied, Grid
from scenec.schemas.kernels import kernel

# In dune heights, about those of barchans on Earth (Sauermann et al. 2000): from the crest upwind
# to the foot, across, and downwind to where the shortest and the longest horns end.
_STOSS = 5.5
_HALF_WIDTH = 5.0
_HORNS = (7.0, 12.0)
# The bay between the horns over the half width.
_BAY = 0.6
_FINEST = 4.0


@dataclass(frozen=True, kw_only=True)
class BarchanField:
    """Single crescent dunes with horns downwind."""

    EXAMPLE: ClassVar = {
        "type": "barchans",
        "count": 12,
        "height_m": {"type": "uniform", "min": 0.5, "max": 2},
        "wind_deg": 45,
    }

    count: int = key(forms.WHOLE_PER_BATCH, at_least=0, at_most=100_000)
    """Number of dunes."""
    height_m: Number = key(forms.LENGTH_PER_INSTANCE, above=0, at_most=1_000_000)
    """Height of a dune; it is ten heights wide."""
    wind_deg: float = key(forms.WIND_DEG)
    repose_deg: float = key(forms.ANGLE_PER_BATCH, default=33, at_least=15, at_most=60)
    """Slope of the slip faces: the angle of repose."""

    def draw(self, context: Context) -> Barchans:
        """The dunes, spread evenly over the terrain.

        Places are Roberts' two-dimensional low-discrepancy sequence with a drawn start: more dunes
        leave the first where they were.
        """
        n = self.count
        # 1 / rho and 1 / rho^2 with rho^3 = rho + 1.
        steps = (0.7548776662466927, 0.5698402909980532)
        start = context.uniforms("start", 1, 2)[0]
        x, y = (
            ((start[axis] + steps[axis] * np.arange(n)) % 1.0 - 0.5) * context.size_m[axis]
            for axis in (0, 1)
        )
        return Barchans(
            x_m=x,
            y_m=y,
            height_m=draw_number(self.height_m, context.streams, f"{context.path}/height_m", n),
            horns=_HORNS[0] + (_HORNS[1] - _HORNS[0]) * context.uniforms("horns", n, 2),
            wind_deg=self.wind_deg,
            repose_deg=self.repose_deg,
        )


@dataclass(frozen=True, eq=False)
class Barchans:
    """Adds barchans.

    Each is a dome, H (1 - rho^2)^2 with rho an elliptic distance from its crest, cut by a bay that
    is open downwind: within the bay's reach the surface falls at the angle of repose to the bay's
    floor. So the slip face is steep and curved, its brink passes the crest, and the horns are what
    is left of the dome beside the bay. Where dunes meet the higher one counts. Only samples under
    a dune are touched; dunes narrower than four grid spacings are left out (reported).

    Attributes:
        x_m, y_m: Crests, float64 [n].
        height_m: H, float64 [n].
        horns: Length of the left and the right horn, in heights, float64 [n, 2].
        wind_deg: Where the wind blows to: 0 is east (+x), 90 north (+y).
        repose_deg: Slope of the slip face.
    """

    KIND: ClassVar = "barchans"

    x_m: NDArray[np.float64]
    y_m: NDArray[np.float64]
    height_m: NDArray[np.float64]
    horns: NDArray[np.float64]
    wind_deg: float
    repose_deg: float

    #: Adds to the heights whatever they are (``program``).
    adds: ClassVar[bool] = True

    def apply(self, grid: Grid, height: NDArray[np.float64]) -> Applied:
        """Heights plus dunes."""
        wind = self.wind_deg * (elementary.PI / 180.0)
        repose = self.repose_deg * (elementary.PI / 180.0)
        shown = 2.0 * _HALF_WIDTH * self.height_m >= _FINEST * max(grid.spacing_m)
        sand = np.zeros(grid.shape)
        _add_dunes(
            sand,
            grid.x(),
            grid.y(),
            np.stack([self.x_m, self.y_m, self.height_m], axis=1)[shown],
            self.horns[shown],
            (elementary.cos(wind), elementary.sin(wind)),
            elementary.sin(repose) / elementary.cos(repose),
        )
        dx, dy = grid.spacing_m
        return height + sand, {
            "dunes": int(shown.sum()),
            "dunes_below_grid": int(len(shown) - shown.sum()),
            "covered_fraction": float((sand > 0.0).mean()),
            "volume_m3": float(sand.sum() * dx * dy),
        }


@kernel
def _add_dunes(
    sand: NDArray,
    x: NDArray,
    y: NDArray,
    dunes: NDArray,
    horns: NDArray,
    wind: tuple[float, float],
    slope: float,
) -> None:
    """Raises sand, float64 [ny, nx], to dunes: x, y and height, float64 [n, 3]."""
    along, across = wind
    for n in range(len(dunes)):
        center_x, center_y, h = dunes[n]
        reach = h * max(max(horns[n, 0], horns[n, 1]), max(_STOSS, _HALF_WIDTH))
        i0 = np.searchsorted(x, center_x - reach)
        i1 = np.searchsorted(x, center_x + reach)
        j0 = np.searchsorted(y, center_y - reach)
        j1 = np.searchsorted(y, center_y + reach)
        for j in range(j0, j1):
            for i in range(i0, i1):
                dx = (x[i] - center_x) / h
                dy = (y[j] - center_y) / h
                side = along * dy - across * dx
                horn = horns[n, 0] if side > 0.0 else horns[n, 1]
                z = h * _barchan(along * dx + across * dy, side, horn, slope)
                sand[j, i] = max(sand[j, i], z)


@kernel
def _barchan(down: float, side: float, horn: float, slope: float) -> float:
    """Height of a unit dune, ``down`` heights downwind of its crest and ``side`` beside it."""
    a = down / (horn if down > 0.0 else _STOSS)
    b = side / _HALF_WIDTH
    rest = max(1.0 - a * a - b * b, 0.0)
    # The bay's floor begins where the slip face from the crest ends; it is half a disk, then open.
    radius = _BAY * _HALF_WIDTH
    before = max(1.0 / slope + radius - down, 0.0)
    away = np.sqrt(before * before + side * side) - radius
    return min(rest * rest, max(slope * away, 0.0))
