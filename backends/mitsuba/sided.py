"""Both sides of a face alike, and no light through it.

Mitsuba's ``twosided`` goes by the shading normal alone: at smooth normals, directions that lie
above it but below the face itself pass through the ground and meet the sky under it (up to a
quarter of the sky's light on coarse drawn relief, measured). Here they carry nothing.

Which side is seen is the face's matter too: at the rim of a smooth thing of few faces the shading
normal leans away from the viewer, who sees the face all the same. To the nested BSDF the viewer is
then at the horizon, where dull lobes are as bright as ever; ``twosided`` draws a black rim.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any

PLUGIN = "scenec_sided"
#: Cosine at which viewers stand whom the shading normal leans away from; lobes may tell them by it.
GRAZING = 1e-5


def both_sides(mi: Any, bsdf: dict[str, Any]) -> dict[str, Any]:
    """Dictionary of a one-sided BSDF on both sides; in ``scalar_rgb`` it is ``twosided``."""
    name = "twosided" if mi.variant().startswith("scalar") else register(mi)
    return {"type": name, "bsdf": bsdf}


@lru_cache(maxsize=1)
def register(mi: Any) -> str:
    """Define the BSDF for the variant that is set, and register it; returns its name."""
    import drjit as dr

    class Sided(mi.BSDF):
        """See the module."""

        def __init__(self, props: Any) -> None:
            super().__init__(props)
            self.nested = props["bsdf"]
            both = mi.BSDFFlags.FrontSide | mi.BSDFFlags.BackSide
            self.m_components = [
                self.nested.flags(i) | both for i in range(self.nested.component_count())
            ]
            self.m_flags = self.nested.flags() | both

        def _turned(self, si: Any) -> tuple[Any, Any]:
            """The interaction as seen from the front, and whether it was from behind."""
            frame = si.sh_frame
            behind = dr.dot(si.n, frame.to_world(si.wi)) * dr.dot(si.n, frame.n) < 0.0
            height = dr.maximum(dr.select(behind, -si.wi.z, si.wi.z), GRAZING)
            turned = mi.SurfaceInteraction3f(si)
            turned.wi = dr.normalize(mi.Vector3f(si.wi.x, si.wi.y, height))
            return turned, behind

        def _same_side(self, si: Any, wo: Any) -> Any:
            """Whether both directions, in the local frame, lie on one side of the face."""
            to_world = si.sh_frame.to_world
            return dr.dot(si.n, to_world(si.wi)) * dr.dot(si.n, to_world(wo)) > 0.0

        def sample(
            self, ctx: Any, si: Any, sample1: Any, sample2: Any, active: Any = True
        ) -> tuple[Any, Any]:
            turned, behind = self._turned(si)
            bs, weight = self.nested.sample(ctx, turned, sample1, sample2, active)
            bs.wo.z = dr.select(behind, -bs.wo.z, bs.wo.z)
            return bs, weight & self._same_side(si, bs.wo) & active

        def _facing(self, behind: Any, wo: Any) -> Any:
            return mi.Vector3f(wo.x, wo.y, dr.select(behind, -wo.z, wo.z))

        def eval(self, ctx: Any, si: Any, wo: Any, active: Any = True) -> Any:
            turned, behind = self._turned(si)
            active = active & self._same_side(si, wo)
            return self.nested.eval(ctx, turned, self._facing(behind, wo), active) & active

        def pdf(self, ctx: Any, si: Any, wo: Any, active: Any = True) -> Any:
            turned, behind = self._turned(si)
            return self.nested.pdf(ctx, turned, self._facing(behind, wo), active)

        def eval_pdf(self, ctx: Any, si: Any, wo: Any, active: Any = True) -> tuple[Any, Any]:
            turned, behind = self._turned(si)
            facing = self._facing(behind, wo)
            value, density = self.nested.eval_pdf(ctx, turned, facing, active)
            return value & self._same_side(si, wo) & active, density

        def eval_diffuse_reflectance(self, si: Any, active: Any = True) -> Any:
            return self.nested.eval_diffuse_reflectance(self._turned(si)[0], active)

        def to_string(self) -> str:
            return f"Sided[{self.nested}]"

    mi.register_bsdf(PLUGIN, Sided)
    return PLUGIN
