"""The laws of ``scenec.backends.surface.reflectance`` as a BSDF, exact for all light.

Directions are drawn as for Lambert's, whose shape both are near but for the opposition surge.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any

from scenec.backends.mitsuba.functions import drjit_functions
from scenec.backends.stage.scene import Reflectance
from scenec.backends.surface.reflectance import Numbers, numbers_of, terms, value

PLUGIN = "scenec_planetary"


def lobe(mi: Any, color: Any, law: Reflectance) -> dict[str, Any]:
    """Dictionary of the lobe.

    In ``scalar_rgb``, where our own BSDF would call Python at each hit, it is Lambert's.

    Args:
        mi: Mitsuba.
        color: Texture of r0, or a color.
        law: The law.
    """
    if mi.variant().startswith("scalar"):
        return {"type": "diffuse", "reflectance": color}
    found = numbers_of(law)
    return {
        "type": register(mi),
        "reflectance": color,
        "multiple": found.multiple,
        "b": float(found.b),
        "c": float(found.c),
        "opposition": float(found.opposition),
        "opposition_width": float(found.opposition_width),
        # Negative: smooth, which is another kernel.
        "slope": -1.0 if found.slope is None else float(found.slope),
    }


@lru_cache(maxsize=1)
def register(mi: Any) -> str:
    """Define the BSDF for the variant that is set, and register it; returns its name."""
    import drjit as dr

    functions = drjit_functions()

    class Planetary(mi.BSDF):
        """See the module."""

        def __init__(self, props: Any) -> None:
            super().__init__(props)
            self.color = props["reflectance"]
            if not hasattr(self.color, "eval"):
                self.color = mi.Color3f(*(dr.opaque(mi.Float, float(v)) for v in self.color))

            def number(name: str) -> Any:
                # Opaque: another law's numbers are no other kernel to compile.
                return dr.opaque(mi.Float, float(props[name]))

            self.law = Numbers(
                bool(props["multiple"]),
                number("b"),
                number("c"),
                number("opposition"),
                number("opposition_width"),
                None if props["slope"] < 0.0 else number("slope"),
            )
            flags = mi.BSDFFlags.DiffuseReflection | mi.BSDFFlags.FrontSide
            if not isinstance(self.color, mi.Color3f):
                flags |= mi.BSDFFlags.SpatiallyVarying
            self.m_components = [flags]
            self.m_flags = flags

        def _above(self, si: Any, wo: Any, active: Any) -> Any:
            return active & (mi.Frame3f.cos_theta(si.wi) > 0.0) & (mi.Frame3f.cos_theta(wo) > 0.0)

        def _value(self, si: Any, wo: Any, active: Any) -> Any:
            """The BRDF times the cosine of ``wo``."""
            active = self._above(si, wo, active)
            color = self.color
            if not isinstance(color, mi.Color3f):
                color = color.eval(si, active)
            cosine = mi.Frame3f.cos_theta(wo)
            both = dr.norm(si.wi + wo)
            half = dr.norm(si.wi - wo) / dr.maximum(both, 1e-6)
            law = terms(functions, self.law, cosine, mi.Frame3f.cos_theta(si.wi), half)
            return (value(law, dr.clip(color, 0.0, 1.0)) * cosine) & active

        def sample(
            self, ctx: Any, si: Any, sample1: Any, sample2: Any, active: Any = True
        ) -> tuple[Any, Any]:
            bs = dr.zeros(mi.BSDFSample3f)
            bs.wo = mi.warp.square_to_cosine_hemisphere(sample2)
            bs.pdf = mi.warp.square_to_cosine_hemisphere_pdf(bs.wo)
            bs.eta = 1.0
            bs.sampled_type = +mi.BSDFFlags.DiffuseReflection
            bs.sampled_component = 0
            active = active & (bs.pdf > 0.0)
            light = self._value(si, bs.wo, active) / dr.maximum(bs.pdf, 1e-12)
            return bs, light & active

        def eval(self, ctx: Any, si: Any, wo: Any, active: Any = True) -> Any:
            return self._value(si, wo, active)

        def pdf(self, ctx: Any, si: Any, wo: Any, active: Any = True) -> Any:
            density = mi.warp.square_to_cosine_hemisphere_pdf(wo)
            return dr.select(self._above(si, wo, active), density, 0.0)

        def eval_pdf(self, ctx: Any, si: Any, wo: Any, active: Any = True) -> tuple[Any, Any]:
            return self._value(si, wo, active), self.pdf(ctx, si, wo, active)

        def to_string(self) -> str:
            return "Planetary[]"

    mi.register_bsdf(PLUGIN, Planetary)
    return PLUGIN
