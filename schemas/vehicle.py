"""Vehicles, as far as the ground under them decides where they can drive.

The tests are those of GESTALT, which drove the Mars Exploration Rovers (Goldberg, Maimone and
Matthies, "Stereo Vision and Rover Navigation Software for Planetary Exploration", IEEE Aerospace
2002; Biesiadecki and Maimone, "The Mars Exploration Rover Surface Mobility Flight Software", IEEE
Aerospace 2006): a plane is fitted to the ground under a disc that holds the vehicle in any heading,
and the plane's tilt, steps between places a wheel apart and what stands above the plane are each
held against what the vehicle can take. ``backends.annotation.terrain`` has them in full.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields

from scenec.schemas.errors import OutputError

#: What a place is to a vehicle; the number of each is its place here.
TRAVERSABILITY = ("unknown", "traversable", "caution", "hazard")
#: Cells across the wheelbase, where nobody says how large they are.
_ACROSS = 14
#: Fewer across the wheelbase do not show a plane.
_LEAST_ACROSS = 4


@dataclass(frozen=True, kw_only=True)
class Vehicle:
    """Describes a vehicle; the defaults are about a Mars Exploration Rover's.

    Of these ``step_m`` is JPL's ("rocks up to ten inches high", Wheels in the Sky, 2004), and 30
    degrees are what drivers of its successors stay below; the other three are not checked: see
    Lindemann and Voorhees, "Mars Exploration Rover mobility assembly design, test and performance",
    IEEE SMC 2005.

    Attributes:
        wheel_base_m: Diameter of the disc that its wheels stand on in any heading.
        wheel_m: Diameter of its wheels.
        clearance_m: Height of its belly over the plane that its wheels stand on.
        step_m: Highest step that a wheel climbs.
        slope_deg: Steepest plane that it drives on.
        caution: Share of these three from which on a place asks for caution, above 0, at most 1.
    """

    wheel_base_m: float = 1.4
    wheel_m: float = 0.25
    clearance_m: float = 0.29
    step_m: float = 0.25
    slope_deg: float = 30.0
    caution: float = 0.5

    def __post_init__(self) -> None:
        """Checks its numbers.

        Raises:
            OutputError: One cannot be a vehicle's; says which.
        """
        most = {"slope_deg": 90.0, "caution": 1.0}
        for one in fields(self):
            value, limit = getattr(self, one.name), most.get(one.name, 1000.0)
            if not 0.0 < value <= limit:
                raise OutputError(
                    f"{one.name}={value:g}: expected a number above 0, up to {limit:g}"
                )

    def __str__(self) -> str:
        """As a line on the screen has it."""
        return (
            f"a vehicle of {self.wheel_base_m:g} m that climbs steps of {self.step_m:g} m and "
            f"slopes of {self.slope_deg:g}°"
        )

    @property
    def cell_m(self) -> float:
        """Side of the cells that the ground under it is looked at in, if nobody says another."""
        return self.wheel_base_m / _ACROSS

    def disc(self, cell_m: float) -> float:
        """Radius of its disc, in cells.

        Raises:
            OutputError: Cells are too large for its wheelbase.
        """
        if not 0.0 < cell_m * _LEAST_ACROSS <= self.wheel_base_m:
            most = self.wheel_base_m / _LEAST_ACROSS
            raise OutputError(
                f"cell_m={cell_m:g}: expected above 0 and at most {most:g}, a quarter of "
                f"wheel_base_m={self.wheel_base_m:g}"
            )
        # What rounding makes of a whole number of cells is one.
        return round(0.5 * self.wheel_base_m / cell_m, 9)

    def reach(self, cell_m: float) -> int:
        """Cells beyond a place that its class depends on: the disc, and a wheel at its border."""
        return math.floor(self.disc(cell_m)) + self.wheel_cells(cell_m)

    def wheel_cells(self, cell_m: float) -> int:
        """Radius of a wheel, in cells; at least one."""
        return max(1, round(0.5 * self.wheel_m / cell_m))
