"""Names the kinds of surfaces as cfgs do."""

from __future__ import annotations

from scenec.compiler.materials.grounds import Gravel, MudCracks, Regolith, Sand, Soil
from scenec.compiler.materials.pavement import Pavement
from scenec.compiler.materials.rocks import Basalt, Breccia, Granite, Sandstone, Weathered
from scenec.compiler.materials.surface import Surface
from scenec.compiler.materials.turf import Turf
from scenec.schemas.plugins import Kinds

SURFACES: Kinds[type[Surface]] = Kinds(
    "scenec.surfaces",
    {
        "granite": Granite,
        "basalt": Basalt,
        "sandstone": Sandstone,
        "breccia": Breccia,
        "weathered": Weathered,
        "sand": Sand,
        "gravel": Gravel,
        "mud_cracks": MudCracks,
        "regolith": Regolith,
        "soil": Soil,
        "pavement": Pavement,
        "turf": Turf,
    },
)
