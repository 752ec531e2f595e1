"""What a relief operator is, and how one is found by its name in a cfg."""

from __future__ import annotations

from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.terrain.barchans import Barchans
from scenec.compiler.terrain.craters import Craters
from scenec.compiler.terrain.dem import Dem
from scenec.compiler.terrain.dunes import Dunes, Ripples
from scenec.compiler.terrain.grid import Grid
from scenec.compiler.terrain.mask import Masked
from scenec.compiler.terrain.mesh_base import MeshBase
from scenec.compiler.terrain.multifractal import Multifractal
from scenec.compiler.terrain.plane import Plane
from scenec.compiler.terrain.smooth import Diffusion, Smooth
from scenec.compiler.terrain.stream_power import StreamPower
from scenec.compiler.terrain.terraces import Terraces
from scenec.compiler.terrain.thermal import Thermal
from scenec.compiler.terrain.tracks import Tracks
from scenec.compiler.terrain.worley import Worley


class ReliefOperator(Protocol):
    """One step of the relief program: plain numbers, no randomness."""

    def apply(
        self, grid: Grid, height: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], dict[str, Any]]:
        """New heights, float64 [ny, nx], and what the step approximated (for report.json)."""
        ...


#: Cfg ``type`` -> operator.
OPERATORS: dict[str, type[Any]] = {
    "plane": Plane,
    "dem": Dem,
    "mesh": MeshBase,
    "multifractal": Multifractal,
    "worley": Worley,
    "craters": Craters,
    "dunes": Dunes,
    "barchans": Barchans,
    "ripples": Ripples,
    "terraces": Terraces,
    "stream_power": StreamPower,
    "thermal": Thermal,
    "diffusion": Diffusion,
    "smooth": Smooth,
    "tracks": Tracks,
}


def operator_type(operator: ReliefOperator) -> str:
    """The cfg's ``type`` of an operator, behind a mask or not."""
    if isinstance(operator, Masked):
        return operator_type(operator.operator)
    return next(name for name, kind in OPERATORS.items() if type(operator) is kind)
