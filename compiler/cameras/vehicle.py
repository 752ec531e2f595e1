"""Declares vehicles, whom the output ``traversable`` is for."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from scenec.compiler.kinds import forms, key
from scenec.schemas.vehicle import Vehicle


@dataclass(frozen=True, kw_only=True)
class VehicleKeys:
    """A vehicle for the output traversable: what the ground under it must be like, measured from
    the plane that fits it best (docs/datasets.md).
    """

    EXAMPLE: ClassVar = {"wheel_base_m": 2.2, "wheel_m": 0.5, "clearance_m": 0.6, "step_m": 0.5}

    wheel_base_m: float = key(
        forms.LENGTH_PER_BATCH, default=Vehicle.wheel_base_m, above=0, at_most=1000
    )
    """Diameter of the disc that its wheels stand on in any heading."""
    wheel_m: float = key(forms.LENGTH_PER_BATCH, default=Vehicle.wheel_m, above=0, at_most=1000)
    """Diameter of its wheels."""
    clearance_m: float = key(
        forms.LENGTH_PER_BATCH, default=Vehicle.clearance_m, above=0, at_most=1000
    )
    """Height of its belly over the plane that it stands on."""
    step_m: float = key(forms.LENGTH_PER_BATCH, default=Vehicle.step_m, above=0, at_most=1000)
    """Highest step that a wheel climbs."""
    slope_deg: float = key(forms.ANGLE_PER_BATCH, default=Vehicle.slope_deg, above=0, at_most=90)
    """Steepest plane that it drives on."""
    caution: float = key(forms.PER_BATCH, default=Vehicle.caution, above=0, at_most=1)
    """Share of these three from which on a place asks for caution."""
