"""Draws craters: a Poisson process over area and size, and each crater's age."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.arithmetic import elementary
from scenec.compiler.distributions.laws import arrivals
from scenec.compiler.distributions.numbers import draw_number
from scenec.compiler.distributions.resolve import resolve
from scenec.compiler.distributions.streams import Streams
from scenec.compiler.noise.lattice import subkeys
from scenec.compiler.terrain.operators.crater_profile import REACH
from scenec.compiler.terrain.operators.craters import Craters
from scenec.schemas.errors import SceneError

#: Craters of one operator at most.
MAX_CRATERS = 4_000_000


def draw_craters(
    cfg: dict[str, Any], streams: Streams, path: str, size_m: tuple[float, float]
) -> Craters:
    """The craters of one operator.

    Craters are a Poisson process with N(>D) = density * (D / reference)**-exponent per m^2: counts
    have that mean over seeds, exactly, and scatter by their square root, as nature's do. Diameters
    are drawn in octaves [2^k, 2^(k+1)) m, each with streams of its own and from its largest crater
    down, over the terrain and as far around it as such craters reach. So a smaller
    ``min_diameter_m`` or a larger ``max_diameter_m`` adds craters and leaves the others as they
    were.

    Ages are uniform between now and when the surface was new; the oldest are the most worn.

    Raises:
        SceneError: There would be too many.
    """
    node = resolve(cfg, streams, path)
    low, high = node["min_diameter_m"], node["max_diameter_m"]
    law = _Law(node["density_per_m2"], node["reference_diameter_m"], node["exponent"])
    first = math.frexp(low)[1] - 1
    octaves = range(first, max(math.frexp(math.nextafter(high, 0.0))[1], first + 1))
    expected = sum(
        _area(size_m, k) * law.between(max(low, 2.0**k), 2.0 ** (k + 1)) for k in octaves
    )
    if not expected <= MAX_CRATERS:
        raise SceneError(
            f"{path}: {f'{expected:.3g}' if math.isfinite(expected) else 'countless'} craters are "
            f"expected, at most {MAX_CRATERS:,} are taken; "
            "raise min_diameter_m or lower density_per_m2"
        )
    parts = [_octave(cfg, node, streams, f"{path}/octave/{k}", size_m, law, k) for k in octaves]
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
        state=node["degradation"] * age[order],
        outline=outline,
        irregularity=node["irregularity"],
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
    """Of the rectangle that craters below 2**(octave + 1) m reach the terrain from, m^2."""
    margin = 2.0 * _margin(octave)
    return (size_m[0] + margin) * (size_m[1] + margin)


def _margin(octave: int) -> float:
    return REACH * 2.0**octave


def _octave(
    cfg: dict[str, Any],
    node: dict[str, Any],
    streams: Streams,
    path: str,
    size_m: tuple[float, float],
    law: _Law,
    octave: int,
) -> tuple[NDArray[Any], ...]:
    """The craters of one octave of diameters: x, y, diameter, two ratios, outline, age."""
    low = max(node["min_diameter_m"], 2.0**octave)
    diameter = _poisson(streams, f"{path}/diameter", law, _area(size_m, octave), low, octave)
    n = len(diameter)
    margin = _margin(octave)
    at = streams.uniforms(f"{path}/position", 2 * n).reshape(n, 2) - 0.5
    columns = (
        at[:, 0] * (size_m[0] + 2.0 * margin),
        at[:, 1] * (size_m[1] + 2.0 * margin),
        diameter,
        draw_number(cfg["depth_ratio"], streams, f"{path}/depth_ratio", n),
        draw_number(cfg["rim_ratio"], streams, f"{path}/rim_ratio", n),
        subkeys(np.uint64(streams.key(path)), n),
        streams.uniforms(f"{path}/age", n),
    )
    kept = diameter <= node["max_diameter_m"]
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
