"""Names the kinds of surfaces as cfgs do."""

from __future__ import annotations

from scenec.compiler.materials.grounds import Gravel, MudCracks, Regolith, Sand, Soil
from scenec.compiler.materials.rocks import Basalt, Breccia, Granite, Sandstone, Weathered
from scenec.compiler.materials.surface import Surface

SURFACES: dict[str, type[Surface]] = {
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
}
