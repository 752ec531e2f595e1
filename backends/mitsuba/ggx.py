"""The GGX lobe of the shared surface model, with height-correlated masking and shadowing.

Mitsuba's ``roughconductor`` multiplies the masking of both directions as if they were independent;
Cycles, and this lobe, take them as they are on a surface of heights (Heitz 2014, Understanding the
Masking-Shadowing Function, eq. 99): G2 = 1 / (1 + L(wi) + L(wo)). At roughness 0.9 under an even
sky the former is 10 % darker (measured).
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any

from scenec.backends.mitsuba.sided import GRAZING

PLUGIN = "scenec_ggx"
#: Viewers at a lower cosine are those whom the normal leans away from: no gloss, as in Cycles.
SEEN = 1.01 * GRAZING


def lobe(mi: Any, alpha: Any, color: Any = None) -> dict[str, Any]:
    """Dictionary of the lobe.

    In ``scalar_rgb``, where our own BSDF would call Python at each hit, it is ``roughconductor``.

    Args:
        mi: Mitsuba.
        alpha: Number or texture.
        color: Texture of its tint; None is white.
    """
    tint = {} if color is None else {"specular_reflectance": color}
    if mi.variant().startswith("scalar"):
        # "none" is a perfect mirror: no Fresnel.
        return {"type": "roughconductor", "material": "none", "distribution": "ggx",
                "alpha": alpha, **tint}  # fmt: skip
    return {"type": register(mi), "alpha": alpha, **tint}


@lru_cache(maxsize=1)
def register(mi: Any) -> str:
    """Define the BSDF for the variant that is set, and register it; returns its name."""
    import drjit as dr

    class Ggx(mi.BSDF):
        """See the module."""

        def __init__(self, props: Any) -> None:
            super().__init__(props)
            alpha = props["alpha"]
            # Opaque: another roughness is no other kernel to compile.
            self.alpha = dr.opaque(mi.Float, alpha) if isinstance(alpha, float) else alpha
            self.tint = props.get("specular_reflectance", None)
            if self.tint is not None and not hasattr(self.tint, "eval"):
                self.tint = mi.Color3f(*(dr.opaque(mi.Float, float(v)) for v in self.tint))
            flags = mi.BSDFFlags.GlossyReflection | mi.BSDFFlags.FrontSide
            if self.tint is not None:
                flags |= mi.BSDFFlags.SpatiallyVarying
            self.m_components = [flags]
            self.m_flags = flags

        def _distribution(self, si: Any, active: Any) -> Any:
            alpha = self.alpha
            if not isinstance(alpha, mi.Float):
                alpha = alpha.eval_1(si, active)
            return mi.MicrofacetDistribution(mi.MicrofacetType.GGX, alpha, True)

        def _color(self, si: Any, active: Any) -> Any:
            if self.tint is None or isinstance(self.tint, mi.Color3f):
                return mi.Color3f(1.0) if self.tint is None else self.tint
            return self.tint.eval(si, active)

        def _correlated(self, distribution: Any, wi: Any, wo: Any, m: Any) -> tuple[Any, Any]:
            """G1 of wi, and G2 of both."""
            first = distribution.smith_g1(wi, m)
            second = distribution.smith_g1(wo, m)
            both = (first > 0.0) & (second > 0.0)
            # L = 1 / G1 - 1.
            return first, dr.select(both, 1.0 / (1.0 / first + 1.0 / second - 1.0), 0.0)

        def sample(
            self, ctx: Any, si: Any, sample1: Any, sample2: Any, active: Any = True
        ) -> tuple[Any, Any]:
            distribution = self._distribution(si, active)
            m, density = distribution.sample(si.wi, sample2)
            bs = dr.zeros(mi.BSDFSample3f)
            bs.wo = mi.reflect(si.wi, m)
            bs.eta = 1.0
            bs.sampled_type = +mi.BSDFFlags.GlossyReflection
            bs.sampled_component = 0
            bs.pdf = density / (4.0 * dr.dot(bs.wo, m))
            active &= mi.Frame3f.cos_theta(si.wi) > SEEN
            active &= mi.Frame3f.cos_theta(bs.wo) > 0.0
            active &= (density > 0.0) & (bs.pdf > 0.0)
            first, both = self._correlated(distribution, si.wi, bs.wo, m)
            active &= first > 0.0
            weight = both / dr.select(first > 0.0, first, 1.0)
            return bs, (weight * self._color(si, active)) & active

        def _terms(self, si: Any, wo: Any, active: Any) -> tuple[Any, Any, Any]:
            cos_i = mi.Frame3f.cos_theta(si.wi)
            active &= (cos_i > SEEN) & (mi.Frame3f.cos_theta(wo) > 0.0)
            m = dr.normalize(si.wi + wo)
            distribution = self._distribution(si, active)
            first, both = self._correlated(distribution, si.wi, wo, m)
            scale = distribution.eval(m) / (4.0 * dr.select(active, cos_i, 1.0))
            return (
                dr.select(active, scale * both, 0.0),
                dr.select(active, scale * first, 0.0),
                active,
            )

        def eval(self, ctx: Any, si: Any, wo: Any, active: Any = True) -> Any:
            value, _, active = self._terms(si, wo, active)
            return (value * self._color(si, active)) & active

        def pdf(self, ctx: Any, si: Any, wo: Any, active: Any = True) -> Any:
            return self._terms(si, wo, active)[1]

        def eval_pdf(self, ctx: Any, si: Any, wo: Any, active: Any = True) -> tuple[Any, Any]:
            value, density, active = self._terms(si, wo, active)
            return (value * self._color(si, active)) & active, density

        def to_string(self) -> str:
            return "Ggx[]"

    mi.register_bsdf(PLUGIN, Ggx)
    return PLUGIN
