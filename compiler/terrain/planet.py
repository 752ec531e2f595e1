"""Curves the ground as the sphere of a moon or a planet does."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import ClassVar, Literal

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.arithmetic import elementary
from scenec.compiler.kinds import Finding, Node, forms, key
from scenec.compiler.terrain.grid import Applied, Grid

#: Mean radii of the IAU's working group (Archinal et al. 2018, Celest. Mech. Dyn. Astr. 130:22).
RADII_M = {"moon": 1_737_400.0, "mars": 3_389_500.0, "earth": 6_371_008.4}


@dataclass(frozen=True, kw_only=True)
class TerrainPlanet:
    """The body that the terrain is part of: heights drop away from the center as on a sphere.

    Note: All that is placed has one vertical, the center's: a height h at a distance d is added
    along it, which is off by h * d / R sideways and h * d^2 / (2 R^2) in height, and what stands
    there leans d / R.
    """

    EXAMPLE: ClassVar = {"body": "moon"}

    body: Literal["moon", "mars", "earth"] | None = key(forms.CHOICE, sparse=True)
    """Sphere of a mean radius: 1,737.4 km, 3,389.5 km, 6,371.0084 km. Or give radius_m."""
    radius_m: float | None = key(
        forms.LENGTH_PER_BATCH, sparse=True, above=0, at_most=1_000_000_000_000
    )
    """Radius of the sphere."""

    KIND: ClassVar = "planet"
    #: Adds to the heights whatever they are (``program``).
    adds: ClassVar[bool] = True

    @staticmethod
    def check(node: Node) -> Iterator[Finding]:
        """Yields a radius too many or too few, and a terrain that reaches beyond the sphere."""
        yield from node.either("body", "radius_m", "how large the sphere is")
        span = node.span("radius_m")
        radius = span[0] if span else RADII_M.get(node["body"] or "")
        terrain = node.whole().at("terrain")
        sizes = [terrain.at("size_m").span(axis) for axis in (0, 1)]
        reach = terrain.at("horizon").span("reach_m") or (0.0, 0.0)
        if radius is None or not all(sizes):
            return
        x, y = (0.5 * size[1] + reach[1] for size in sizes if size)
        if x * x + y * y >= radius * radius:
            yield node.fault(
                f"the corners of the terrain and its horizon are up to {np.sqrt(x * x + y * y):g} "
                f"m from its center: expected less than the radius, {radius:g} m"
            )

    @property
    def sphere_m(self) -> float:
        """Radius of the sphere, meters."""
        return self.radius_m or RADII_M[self.body or "moon"]

    def drop_m(self, x: NDArray[np.float64], y: NDArray[np.float64]) -> NDArray[np.float64]:
        """Returns how far the sphere is below its tangent plane, R - sqrt(R^2 - d^2), meters.

        It is computed as d^2 / (R + sqrt(R^2 - d^2)), which keeps the bits of small ones.

        Args:
            x, y: Positions in the plane, meters, of any shapes that go together.
        """
        square = x * x + y * y
        radius = self.sphere_m
        out: NDArray[np.float64] = square / (radius + np.sqrt(radius * radius - square))
        return out

    def apply(self, grid: Grid, height: NDArray[np.float64]) -> Applied:
        """Heights less the drop."""
        return height - self.drop_m(grid.x()[None, :], grid.y()[:, None]), self.report(grid.size_m)

    def report(self, size_m: tuple[float, float]) -> dict[str, float]:
        """Returns what happens at the corners of a rectangle about the center: see the class."""
        x, y = 0.5 * size_m[0], 0.5 * size_m[1]
        lean = elementary.asin(np.sqrt(x * x + y * y) / self.sphere_m) * (180.0 / elementary.PI)
        drop = float(self.drop_m(np.array(x), np.array(y)))
        return {"radius_m": self.sphere_m, "drop_max_m": drop, "lean_max_deg": lean}
