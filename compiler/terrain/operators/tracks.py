"""Presses rover tracks: two ruts along a given path."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.arithmetic import elementary
from scenec.compiler.assets.polyline import read_polyline
from scenec.compiler.kinds import file, forms, key
from scenec.compiler.terrain.grid import Applied, Grid
from scenec.compiler.terrain.operators.smooth import diffuse
from scenec.compiler.terrain.polyline import project
from scenec.schemas.kernels import kernel
from scenec.schemas.threads import over_threads

# Across a rut, in half widths: where its walls begin, and how wide the berm beside it is.
_FLOOR = 0.8
_BERM = 1.0
# Part of the rut's cross-section that stands in its two berms; the rest is compacted.
_DISPLACED = 0.5
# Half the width of a grouser's imprint, in spacings of grousers.
_BAR = 0.22
_FINEST = 3.0


class Wheels(NamedTuple):
    """Describes the wheels that press, in meters.

    Attributes:
        middle: Half the distance between the wheels' middles.
        half: Half a wheel's width.
        depth: Sinkage.
        spacing, grousers: Of grousers along the track, and how much deeper they press.
        chevrons: Whether they point ahead.
    """

    middle: float
    half: float
    depth: float
    spacing: float
    grousers: float
    chevrons: bool


@dataclass(frozen=True)
class Tracks:
    """Wheel tracks of a rover along a given path.

    Note: The floor of a rut is the ground smoothed over half a wheel's width, ``depth_m`` lower;
    its walls rise over a tenth of the width; beside it stand berms with half of what was displaced.
    Grousers press bars or chevrons into the floor. Only samples under tracks are changed. Wheels
    narrower than three grid spacings leave none, grousers closer than three none of their own
    (reported).
    """

    EXAMPLE: ClassVar = {
        "type": "tracks",
        "file": "track.csv",
        "wheel_distance_m": 1.7,
        "wheel_width_m": 0.4,
        "depth_m": 0.03,
    }

    file: Path = key(file("polyline"))
    """CSV of the rover's middle, columns x_m and y_m, relative to the cfg, or
    "package:NAME/path"."""
    wheel_distance_m: float = key(forms.LENGTH_PER_BATCH, default=2, above=0, at_most=1000)
    """Between the middles of the left and the right wheels."""
    wheel_width_m: float = key(forms.LENGTH_PER_BATCH, default=0.4, above=0, at_most=1000)
    """Width of a wheel; below three spacings it leaves no track."""
    depth_m: float = key(forms.LENGTH_PER_BATCH, default=0.04, at_least=0, at_most=1000)
    """How deep wheels sink."""
    grouser_spacing_m: float = key(forms.LENGTH_PER_BATCH, default=0.12, above=0, at_most=1000)
    """Distance of grousers along the track; below three spacings they do not show."""
    grouser_depth_m: float = key(forms.LENGTH_PER_BATCH, default=0.012, at_least=0, at_most=1000)
    """How much deeper grousers press; 0 for smooth wheels."""
    pattern: Literal["bars", "chevrons"] = key(forms.CHOICE, default="bars")
    """Straight bars across the track, or chevrons."""

    def apply(self, grid: Grid, height: NDArray[np.float64]) -> Applied:
        """Heights with tracks.

        Raises:
            SceneError: The file is no path.
        """
        path = read_polyline(self.file)
        finest = _FINEST * max(grid.spacing_m)
        if self.wheel_width_m < finest:
            return height, {"below_grid": True}
        reach = 0.5 * (self.wheel_distance_m + (1.0 + _BERM) * self.wheel_width_m)
        offset, along = project(grid, path, reach, round_ends=False)
        grousers = self.grouser_depth_m if self.grouser_spacing_m >= finest else 0.0
        wheels = Wheels(
            0.5 * self.wheel_distance_m,
            0.5 * self.wheel_width_m,
            self.depth_m,
            self.grouser_spacing_m,
            grousers,
            self.pattern == "chevrons",
        )
        smooth = diffuse(grid, height, wheels.half)
        out = height.copy()
        over_threads(_press_part, len(height), height, smooth, offset, along, wheels, out)
        dx, dy = grid.spacing_m
        return out, {
            "below_grid": False,
            "grousers_below_grid": self.grouser_depth_m > 0.0 and grousers == 0.0,
            "samples_changed": int((out != height).sum()),
            "volume_change_m3": float((out - height).sum() * dx * dy),
        }


@kernel
def _press_part(
    first: int,
    last: int,
    height: NDArray,
    smooth: NDArray,
    offset: NDArray,
    along: NDArray,
    wheels: Wheels,
    out: NDArray,
) -> None:
    _ny, nx = height.shape
    middle, half, depth, spacing, grousers, chevrons = wheels
    # Cross-sections over depth * half: of the rut, and of both berms for a height of 1.
    rut = 2.0 * (0.5 * (1.0 + _FLOOR))
    berm = 2.0 * _BERM * (8.0 / 15.0)
    raised = _DISPLACED * depth * rut / berm
    for j in range(first, last):
        for i in range(nx):
            if not abs(offset[j, i]) < np.inf:
                continue
            s = abs(abs(offset[j, i]) - middle) / half
            if s < 1.0:
                pressed = elementary.smoothstep((1.0 - s) / (1.0 - _FLOOR))
                phase = along[j, i]
                if chevrons:
                    phase += s * half
                bar = (phase / spacing - np.floor(phase / spacing) - 0.5) / _BAR
                bar = max(1.0 - bar * bar, 0.0)
                floor = smooth[j, i] - depth - grousers * bar * bar
                out[j, i] += pressed * (floor - height[j, i])
            elif s < 1.0 + _BERM:
                t = (s - 1.0) / _BERM
                out[j, i] += raised * 16.0 * t * t * (1.0 - t) * (1.0 - t)
