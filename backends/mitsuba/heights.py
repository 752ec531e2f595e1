"""Weights of merges that heed height maps, and mixtures by them, as Mitsuba textures.

The formula is ``backends.heights``'s.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from typing import Any

from scenec.backends.surface.heights import LEAST_DEPTH

WEIGHT_PLUGIN, MIX_PLUGIN = "scenec_heeded_weight", "scenec_glow_mix"
#: A texture, or a number that is the same everywhere.
type Value = Any


def weight_texture(
    mi: Any, weights: Sequence[Value], depths: Sequence[float], heights: Sequence[Value]
) -> dict[str, Any]:
    """Dictionary of the last merge's weight.

    Args:
        mi: Mitsuba.
        weights: Of the merges up to it: textures, loaded so that they are shared, or numbers.
        depths: Of these.
        heights: Of the layers up to it, likewise; one more.
    """
    register(mi)
    found: dict[str, Any] = {"type": WEIGHT_PLUGIN, "merges": len(weights)}
    for number, (weight, depth) in enumerate(zip(weights, depths, strict=True)):
        found[f"weight_{number}"] = weight
        found[f"depth_{number}"] = float(depth)
    return found | {f"height_{number}": height for number, height in enumerate(heights)}


def mix_texture(mi: Any, weights: Sequence[Value], layers: Sequence[Any]) -> dict[str, Any]:
    """Dictionary of the merge of colors, textures all, by weights as they are."""
    register(mi)
    found: dict[str, Any] = {"type": MIX_PLUGIN, "merges": len(weights)}
    found |= {f"weight_{number}": weight for number, weight in enumerate(weights)}
    return found | {f"layer_{number}": layer for number, layer in enumerate(layers)}


@lru_cache(maxsize=1)
def register(mi: Any) -> None:
    """Define the textures for the variant that is set, and register them."""
    import drjit as dr

    scalar = mi.variant().startswith("scalar")

    def number(value: float) -> Any:
        # Opaque: another scene's numbers are no other kernel to compile.
        return float(value) if scalar else dr.opaque(mi.Float, float(value))

    def value(props: Any, name: str) -> Any:
        found = props[name]
        return number(found) if isinstance(found, int | float) else found

    def at(what: Any, si: Any, active: Any) -> Any:
        return what.eval_1(si, active) if isinstance(what, mi.Texture) else what

    class HeededWeight(mi.Texture):
        """See ``weight_texture``."""

        def __init__(self, props: Any) -> None:
            super().__init__(props)
            merges = int(props["merges"])
            self.weights = [value(props, f"weight_{i}") for i in range(merges)]
            self.heights = [value(props, f"height_{i}") for i in range(merges + 1)]
            self.depths = [float(props[f"depth_{i}"]) for i in range(merges)]
            # Factor of the weight, and of the heights.
            deep = [max(depth, LEAST_DEPTH) for depth in self.depths]
            self.slopes = [(number((1.0 + d) / d), number(0.5 / d)) for d in deep]

        def eval_1(self, si: Any, active: Any = True) -> Any:
            below = at(self.heights[0], si, active)
            weight = mi.Float(0.0)
            for i, (steep, half) in enumerate(self.slopes):
                weight = dr.clip(at(self.weights[i], si, active), 0.0, 1.0)
                above = at(self.heights[i + 1], si, active)
                if self.depths[i] > 0.0:
                    weight = dr.clip(weight * steep + (above - below - 1.0) * half, 0.0, 1.0)
                below = below + weight * (above - below)
            return weight

        def eval(self, si: Any, active: Any = True) -> Any:
            return mi.Color3f(self.eval_1(si, active))

        def eval_3(self, si: Any, active: Any = True) -> Any:
            return mi.Color3f(self.eval_1(si, active))

        def mean(self) -> Any:
            return mi.Float(0.5)

        def is_spatially_varying(self) -> bool:
            return True

        def to_string(self) -> str:
            return "HeededWeight[]"

    class GlowMix(mi.Texture):
        """See ``mix_texture``."""

        def __init__(self, props: Any) -> None:
            super().__init__(props)
            merges = int(props["merges"])
            self.weights = [value(props, f"weight_{i}") for i in range(merges)]
            self.layers = [props[f"layer_{i}"] for i in range(merges + 1)]

        def eval(self, si: Any, active: Any = True) -> Any:
            found = self.layers[0].eval(si, active)
            for weight, layer in zip(self.weights, self.layers[1:], strict=True):
                share = dr.clip(at(weight, si, active), 0.0, 1.0)
                found = found + share * (layer.eval(si, active) - found)
            return found

        def eval_1(self, si: Any, active: Any = True) -> Any:
            return mi.luminance(self.eval(si, active))

        def eval_3(self, si: Any, active: Any = True) -> Any:
            return self.eval(si, active)

        def mean(self) -> Any:
            return mi.Float(1.0)

        def is_spatially_varying(self) -> bool:
            return True

        def to_string(self) -> str:
            return "GlowMix[]"

    mi.register_texture(WEIGHT_PLUGIN, HeededWeight)
    mi.register_texture(MIX_PLUGIN, GlowMix)
