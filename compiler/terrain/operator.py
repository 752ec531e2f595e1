"""Names relief operators as a cfg does."""

from __future__ import annotations

from typing import Any

from scenec.compiler.kinds.table import name_of
from scenec.compiler.terrain.mask import Masked
from scenec.compiler.terrain.mask import ReliefOperator as ReliefOperator
from scenec.compiler.terrain.operators.barchans import Barchans
from scenec.compiler.terrain.operators.craters import Craters
from scenec.compiler.terrain.operators.crust import Crust
from scenec.compiler.terrain.operators.dunes import Dunes, Ripples
from scenec.compiler.terrain.operators.footprints import Footprints
from scenec.compiler.terrain.operators.multifractal import Multifractal
from scenec.compiler.terrain.operators.polygons import Polygons
from scenec.compiler.terrain.operators.smooth import Diffusion, Smooth
from scenec.compiler.terrain.operators.stream_power import StreamPower
from scenec.compiler.terrain.operators.terraces import Terraces
from scenec.compiler.terrain.operators.thermal import Thermal
from scenec.compiler.terrain.operators.tracks import Tracks
from scenec.compiler.terrain.operators.worley import Worley
from scenec.compiler.terrain.sources.dem import Dem
from scenec.compiler.terrain.sources.mesh_base import MeshBase
from scenec.compiler.terrain.sources.plane import Plane
from scenec.schemas.plugins import Kinds

#: Cfg ``type`` -> operator.
OPERATORS: Kinds[type[Any]] = Kinds(
    "scenec.relief",
    {
        "plane": Plane,
        "dem": Dem,
        "mesh": MeshBase,
        "multifractal": Multifractal,
        "worley": Worley,
        "polygons": Polygons,
        "crust": Crust,
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
        "footprints": Footprints,
    },
)


def operator_type(operator: ReliefOperator) -> str:
    """The cfg's ``type`` of an operator, behind a mask or not."""
    if isinstance(operator, Masked):
        return operator_type(operator.operator)
    own = (name for name, kind in OPERATORS.items() if kind is type(operator))
    return next(own, "") or name_of("relief", type(operator))
