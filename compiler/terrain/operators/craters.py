"""Lays impact craters over each other in the order of their ages."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.arithmetic import elementary
from scenec.compiler.distributions.laws import arrivals
from scenec.compiler.distributions.numbers import Number, draw_number
from scenec.compiler.distributions.streams import Streams
from scenec.compiler.kinds import Context, Finding, Node, forms, key
from scenec.compiler.noise.lattice import hash2, subkeys, to_integer
from scenec.compiler.noise.perlin import DIRECTION_MASK, perlin2_of_directions
from scenec.compiler.terrain.grid import Applied, Grid
from scenec.compiler.terrain.operators.crater_profile import (
    REACH,
    blend_row,
    height_at,
    profile_table,
)
from scenec.schemas.errors import SceneError
from scenec.schemas.kernels import kernel

#: Craters of one operator at most.
MAX_CRATERS = 4_000_000
#: Craters narrower than this many grid spacings are not shown.
_FINEST = 3.0
# Within the first radius the old surface is gone, beyond the second it is as it was.
_BURIED = 0.8
_UNTOUCHED = 1.5
# Lattice units of the circle on which the outline's noise is read: about nine lobes. The cells that
# it passes through have the points from -2 to 2 in both axes.
_OUTLINE = 1.5
_FIRST, _WIDTH = -2, 5
# Samples that all craters together may reach: some minutes' work.
_MOST_SAMPLES = 1e10


@dataclass(frozen=True, kw_only=True)
class CraterLaw:
    """Impact craters, fresh and worn, of a size-frequency law, in the order of their ages. A
    younger one replaces what lies within it.
    """

    EXAMPLE: ClassVar = {
        "type": "craters",
        "min_diameter_m": 2,
        "max_diameter_m": 12,
        "density_per_m2": 0.02,
        "degradation": 0.5,
    }

    min_diameter_m: float = key(forms.LENGTH_PER_BATCH, above=0, at_most=1_000_000)
    """Smallest diameter from rim to rim; craters narrower than three spacings are left out."""
    max_diameter_m: float = key(forms.LENGTH_PER_BATCH, above=0, at_most=1_000_000)
    """Largest diameter."""
    density_per_m2: float = key(
        forms.PER_BATCH, default=0.033572, at_least=0, at_most=1_000_000_000
    )
    """Craters above reference_diameter_m in a square meter. The default is the equilibrium of small
    lunar craters: 0.0218 · 1.54 above 1 m."""
    reference_diameter_m: float = key(forms.LENGTH_PER_BATCH, default=1, above=0, at_most=1_000_000)
    """Diameter that density_per_m2 is given for."""
    exponent: float = key(forms.PER_BATCH, default=2, above=0, at_most=10)
    """b in N(>D) ∝ D^-b: 2 in equilibrium, about 3 where craters have not yet destroyed each
    other."""
    depth_ratio: Number = key(forms.FRACTION_PER_INSTANCE, default=0.2)
    """Depth below the rim over diameter, fresh: about 0.2 above 400 m, down to 0.1 for the smallest
    lunar ones."""
    rim_ratio: Number = key(forms.PER_INSTANCE, default=0.04, at_least=0, at_most=0.5)
    """Height of a fresh crater's rim over its diameter."""
    degradation: float = key(forms.PER_BATCH, default=0.4, at_least=0, at_most=2)
    """Wear of the oldest craters, κt/R² of diffusion: 0 leaves all fresh, 0.1 leaves 55 % of the
    depth, 0.5 16 %. Ages are uniform."""
    irregularity: float = key(forms.PER_BATCH, default=0.08, at_least=0, at_most=0.5)
    """How far outlines are from circles, as a part of the radius."""

    @staticmethod
    def check(node: Node) -> Iterator[Finding]:
        """Findings between its keys."""
        low, high = node.span("min_diameter_m"), node.span("max_diameter_m")
        if low and high and low[1] > high[0]:
            yield node.fault(
                f"{low[1]:g} m can be above max_diameter_m ({high[0]:g} m): expected it below",
                "min_diameter_m",
            )

    def draw(self, context: Context) -> Craters:
        """The craters.

        They are a Poisson process with N(>D) = density * (D / reference)**-exponent per m^2: counts
        have that mean over seeds, exactly, and scatter by their square root, as nature's do.
        Diameters are drawn in octaves [2^k, 2^(k+1)) m, each with streams of its own and from its
        largest crater down, over the terrain and as far around it as such craters reach. So a
        smaller ``min_diameter_m`` or a larger ``max_diameter_m`` adds craters and leaves the others
        as they were.

        Ages are uniform between now and when the surface was new; the oldest are the most worn.

        Raises:
            SceneError: There would be too many.
        """
        low, high = self.min_diameter_m, self.max_diameter_m
        path, size_m = context.path, context.size_m
        law = _Law(self.density_per_m2, self.reference_diameter_m, self.exponent)
        first = math.frexp(low)[1] - 1
        octaves = range(first, max(math.frexp(math.nextafter(high, 0.0))[1], first + 1))
        expected = sum(
            _area(size_m, k) * law.between(max(low, 2.0**k), 2.0 ** (k + 1)) for k in octaves
        )
        if not expected <= MAX_CRATERS:
            raise SceneError(
                f"{path}: {f'{expected:.3g}' if math.isfinite(expected) else 'countless'} craters "
                f"are expected, at most {MAX_CRATERS:,} are taken; "
                "raise min_diameter_m or lower density_per_m2"
            )
        parts = [
            _octave(self, context.streams, f"{path}/octave/{k}", size_m, law, k) for k in octaves
        ]
        columns = [np.concatenate(column) for column in zip(*parts, strict=True)]
        age = columns.pop()
        # The oldest first.
        order = np.argsort(-age, kind="stable")
        x, y, diameter, depth_ratio, rim_ratio, outline = (column[order] for column in columns)
        return Craters(
            x_m=x,
            y_m=y,
            diameter_m=diameter,
            depth_ratio=depth_ratio,
            rim_ratio=rim_ratio,
            state=self.degradation * age[order],
            outline=outline,
            irregularity=self.irregularity,
            age=age[order],
        )


@dataclass(frozen=True, eq=False)
class Craters:
    """Simple craters, oldest first.

    Each replaces what lies within it by its own bowl, on the plane that fits the old surface there
    best, and its blanket fades into what lies around it: older craters vanish under younger ones.
    A worn crater replaces as much of the old surface as is left of its own depth. The shape and its
    wear are those of ``crater_profile``. Only samples within five radii are touched. Craters
    narrower than three grid spacings are left out (reported), and so is the blanket beyond five
    radii, a fifth of its volume.

    Attributes:
        x_m, y_m: Centers, float64 [n]; they may lie outside of the terrain.
        diameter_m: From rim to rim, float64 [n].
        depth_ratio: Depth below the rim over diameter when fresh, float64 [n].
        rim_ratio: Height of the rim over diameter when fresh, float64 [n].
        state: Wear, kappa * t / R**2, float64 [n].
        outline: Noise key of each outline, uint64 [n].
        irregularity: How far outlines are from circles: part of the radius.
        age: From 0 to 1, when the surface was new, float64 [n]; None: nobody knows.
    """

    KIND: ClassVar = "craters"

    x_m: NDArray[np.float64]
    y_m: NDArray[np.float64]
    diameter_m: NDArray[np.float64]
    depth_ratio: NDArray[np.float64]
    rim_ratio: NDArray[np.float64]
    state: NDArray[np.float64]
    outline: NDArray[np.uint64]
    irregularity: float
    age: NDArray[np.float64] | None = None

    def apply(self, grid: Grid, height: NDArray[np.float64]) -> Applied:
        """Heights with craters.

        Raises:
            SceneError: They reach over too many samples to be done in minutes.
        """
        shown = resolved_on(self, grid)
        _require_doable(self.diameter_m[shown], grid)
        out = height.copy()
        touched = 0
        if shown.any():
            table = profile_table(float(self.state[shown].max()))
            touched = _excavate(
                out,
                grid.x(),
                grid.y(),
                self.bowls(shown),
                self.depth_ratio[shown],
                self.rim_ratio[shown],
                (table.states, table.rim, table.depth),
            )
        change = out - height
        dx, dy = grid.spacing_m
        return out, {
            "craters": int(shown.sum()),
            "craters_below_grid": int(len(shown) - shown.sum()),
            "largest_m": float(self.diameter_m.max(initial=0.0)),
            "samples_touched": int(touched),
            "volume_change_m3": float(change.sum() * dx * dy),
            "change_max_m": float(np.abs(change).max()),
        }

    def bowls(self, which: NDArray[np.bool_]) -> Bowls:
        """Returns the bowls of some of them."""
        return Bowls(
            self.x_m[which],
            self.y_m[which],
            0.5 * self.diameter_m[which],
            self.state[which],
            self.outline[which],
            self.irregularity,
        )


class Bowls(NamedTuple):
    """Holds places of craters, meters, and their wear and outlines: see ``Craters``."""

    x: NDArray[np.float64]
    y: NDArray[np.float64]
    radius: NDArray[np.float64]
    state: NDArray[np.float64]
    outline: NDArray[np.uint64]
    irregularity: float


def _require_doable(diameter_m: NDArray[np.float64], grid: Grid) -> None:
    """Few craters can be as much work as many: what counts is the samples that each reaches."""
    reached = np.ones(len(diameter_m))
    for count, spacing in zip(grid.shape[::-1], grid.spacing_m, strict=True):
        reached *= np.minimum(5.0 * diameter_m / spacing, count)
    if reached.sum() > _MOST_SAMPLES:
        raise SceneError(
            f"{len(diameter_m):,} craters reach over {reached.sum():.2g} samples in all, at most "
            f"{_MOST_SAMPLES:g} are taken; lower density_per_m2 or max_diameter_m"
        )


def resolved_on(craters: Craters, grid: Grid) -> NDArray[np.bool_]:
    """Selects the craters that are wide enough for a grid to show: bool [n]."""
    return craters.diameter_m >= _FINEST * max(grid.spacing_m)


@kernel
def window(bowls: Bowls, n: int, x: NDArray, y: NDArray) -> tuple[int, int, int, int]:
    """Columns [i0, i1) and rows [j0, j1) of the samples that a crater can reach."""
    # An outline reaches out by its irregularity.
    reach = REACH * bowls.radius[n] * (1.0 + bowls.irregularity)
    return (*span(x, bowls.x[n], reach), *span(y, bowls.y[n], reach))


@kernel
def outline_directions(key: np.uint64) -> NDArray:
    """Gradient directions of the lattice points that an outline's noise is made of: uint64 [25]."""
    out = np.empty(_WIDTH * _WIDTH, np.uint64)
    for j in range(_WIDTH):
        for i in range(_WIDTH):
            out[j * _WIDTH + i] = hash2(key, i + _FIRST, j + _FIRST) & DIRECTION_MASK
    return out


@kernel
def uneven_distances(
    bowls: Bowls, n: int, directions: NDArray, x: NDArray, y: float, out: NDArray
) -> None:
    """Distances of a row's samples from a crater's center, in its radii: 1 on its outline.

    Args:
        directions: ``outline_directions`` of the n-th crater's key.
        x: Columns of the samples, meters, float64 [k].
        y: Their row.
        out: Where distances go, float64 [k].
    """
    radius = bowls.radius[n]
    center = bowls.x[n]
    dy = (y - bowls.y[n]) / radius
    # Wear rounds outlines off.
    uneven = bowls.irregularity / (1.0 + 8.0 * bowls.state[n])
    for k in range(x.size):
        dx = (x[k] - center) / radius
        out[k] = np.sqrt(dx * dx + dy * dy)
    if not uneven > 0.0:
        return
    first = np.float64(_FIRST)
    north = np.uint64(_WIDTH)
    for k in range(x.size):
        dx = (x[k] - center) / radius
        away = out[k]
        there = away if away > 0.0 else 1.0
        u = _OUTLINE * dx / there
        v = _OUTLINE * dy / there
        fu = np.floor(u)
        fv = np.floor(v)
        at = to_integer((fv - first) * _WIDTH + (fu - first))
        lobe = perlin2_of_directions(
            directions[at],
            directions[at + np.uint64(1)],
            directions[at + north],
            directions[at + north + np.uint64(1)],
            u - fu,
            v - fv,
        )
        # A floor has no outline: its middle stays smooth.
        lobe *= away * away / (away * away + 0.5)
        out[k] = away / (1.0 + uneven * lobe)


@kernel
def _excavate(
    height: NDArray,
    x: NDArray,
    y: NDArray,
    bowls: Bowls,
    depth_ratio: NDArray,
    rim_ratio: NDArray,
    profiles: tuple[NDArray, NDArray, NDArray],
) -> int:
    """Lays craters over heights, in place; returns how many samples were touched."""
    touched = 0
    row = np.empty(x.size)
    for n in range(bowls.radius.size):
        r = bowls.radius[n]
        i0, i1, j0, j1 = window(bowls, n, x, y)
        if i0 >= i1 or j0 >= j1:
            continue
        level, slope_x, slope_y = _plane(height, x, y, bowls.x[n], bowls.y[n], r)
        profile, left = blend_row(
            *profiles, bowls.state[n], 2.0 * r * rim_ratio[n], 2.0 * r * depth_ratio[n]
        )
        directions = outline_directions(bowls.outline[n])
        for j in range(j0, j1):
            uneven_distances(bowls, n, directions, x[i0:i1], y[j], row)
            for i in range(i0, i1):
                away = row[i - i0]
                if away >= REACH:
                    continue
                touched += 1
                if away < _UNTOUCHED and level == level:
                    dx = (x[i] - bowls.x[n]) / r
                    dy = (y[j] - bowls.y[n]) / r
                    t = min(max((_UNTOUCHED - away) / (_UNTOUCHED - _BURIED), 0.0), 1.0)
                    plane = level + r * (slope_x * dx + slope_y * dy)
                    height[j, i] += left * t * t * (3.0 - 2.0 * t) * (plane - height[j, i])
                height[j, i] += height_at(profile, away)
    return touched


@kernel
def span(at: NDArray, center: float, reach: float) -> tuple[int, int]:
    """Indices [first, last) of the samples within reach of a center."""
    first = int(np.searchsorted(at, center - reach, side="left"))
    return first, int(np.searchsorted(at, center + reach, side="right"))


@kernel
def _plane(
    height: NDArray, x: NDArray, y: NDArray, center_x: float, center_y: float, radius: float
) -> tuple[float, float, float]:
    """Least-squares plane over the samples of a disk: height at its center, dz/dx and dz/dy.

    The height is NaN where the disk holds no sample; slopes are 0 where it holds too few.
    """
    i0, i1 = span(x, center_x, radius)
    j0, j1 = span(y, center_y, radius)
    count = 0
    sx = sy = sz = 0.0
    for j in range(j0, j1):
        for i in range(i0, i1):
            dx = x[i] - center_x
            dy = y[j] - center_y
            if dx * dx + dy * dy <= radius * radius:
                count += 1
                sx += dx
                sy += dy
                sz += height[j, i]
    if count == 0:
        return np.nan, 0.0, 0.0
    sx /= count
    sy /= count
    sz /= count
    xx = xy = yy = xz = yz = 0.0
    for j in range(j0, j1):
        for i in range(i0, i1):
            dx = x[i] - center_x
            dy = y[j] - center_y
            if dx * dx + dy * dy <= radius * radius:
                dz = height[j, i] - sz
                dx -= sx
                dy -= sy
                xx += dx * dx
                xy += dx * dy
                yy += dy * dy
                xz += dx * dz
                yz += dy * dz
    determinant = xx * yy - xy * xy
    # Samples on one line leave the slope across it open.
    if determinant <= 1e-6 * xx * yy or determinant <= 0.0:
        return sz, 0.0, 0.0
    slope_x = (xz * yy - yz * xy) / determinant
    slope_y = (yz * xx - xz * xy) / determinant
    return sz - slope_x * sx - slope_y * sy, slope_x, slope_y


def craters_of(context: Context) -> tuple[tuple[Craters, tuple[Any, ...]], ...]:
    """Returns the craters that the relief lays, each with the conditions of its mask."""
    found = []
    for one in context.relief:
        operator, conditions = getattr(one, "operator", one), getattr(one, "conditions", ())
        if isinstance(operator, Craters):
            found.append((operator, conditions))
    return tuple(found)


def require_craters(node: Node, relief: list[Node], where: str = "") -> Iterator[Finding]:
    """Finds fault with what needs craters, where a relief has none."""
    if "craters" not in [operator.entries.get("type") for operator in relief]:
        yield node.fault(
            f'no craters in the relief{where}: expected an operator of the type "craters"', "type"
        )


class _Law:
    """N(>D) = density * (D / reference)**-exponent."""

    def __init__(self, density: float, reference: float, exponent: float):
        self.density, self.reference, self.exponent = density, reference, exponent

    def above(self, diameter: float) -> float:
        """Craters per m^2 larger than a diameter."""
        return self.density * elementary.pow(self.reference / diameter, self.exponent)

    def between(self, low: float, high: float) -> float:
        """Craters per m^2 of diameters from low to high."""
        return self.above(low) - self.above(high)

    def diameters(self, above: NDArray[np.float64]) -> NDArray[np.float64]:
        """The diameter that so many craters per m^2 are larger than."""
        logs = elementary.log_array(above / self.density)
        return self.reference * elementary.exp_array(-logs / self.exponent)


def _area(size_m: tuple[float, float], octave: int) -> float:
    """Returns the area that craters below 2**(octave + 1) m reach the terrain from, m^2."""
    margin = 2.0 * _margin(octave)
    return (size_m[0] + margin) * (size_m[1] + margin)


def _margin(octave: int) -> float:
    return REACH * 2.0**octave


def _octave(
    of: CraterLaw,
    streams: Streams,
    path: str,
    size_m: tuple[float, float],
    law: _Law,
    octave: int,
) -> tuple[NDArray[Any], ...]:
    """The craters of one octave of diameters: x, y, diameter, two ratios, outline, age."""
    low = max(of.min_diameter_m, 2.0**octave)
    diameter = _poisson(streams, f"{path}/diameter", law, _area(size_m, octave), low, octave)
    n = len(diameter)
    margin = _margin(octave)
    at = streams.uniforms(f"{path}/position", 2 * n).reshape(n, 2) - 0.5
    columns = (
        at[:, 0] * (size_m[0] + 2.0 * margin),
        at[:, 1] * (size_m[1] + 2.0 * margin),
        diameter,
        draw_number(of.depth_ratio, streams, f"{path}/depth_ratio", n),
        draw_number(of.rim_ratio, streams, f"{path}/rim_ratio", n),
        subkeys(np.uint64(streams.key(path)), n),
        streams.uniforms(f"{path}/age", n),
    )
    kept = diameter <= of.max_diameter_m
    return tuple(column[kept] for column in columns)


def _poisson(
    streams: Streams, path: str, law: _Law, area: float, low: float, octave: int
) -> NDArray[np.float64]:
    """Diameters of one octave down to ``low``, falling: a Poisson process in N(>D) * area."""
    start, end = law.above(2.0 ** (octave + 1)), law.above(low)
    above = start + arrivals(streams, path, area * (end - start)) / area
    diameter = law.diameters(above[above <= end])
    # Rounding must not carry one over the octave's border.
    return np.clip(diameter, low, np.nextafter(2.0 ** (octave + 1), 0.0))
