"""A texture that is the product of two, which Mitsuba lacks: a map times what varies."""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import numpy as np

PLUGIN = "scenec_product"


def texture(
    mi: Any, first: Any, second: Any, lower: float = 0.0, upper: float = 1e9
) -> dict[str, Any]:
    """Dictionary of first * second, clamped; each a texture's dictionary, or second a number."""
    return {
        "type": PLUGIN,
        "first": first,
        "second": _nested(mi, second),
        "lower": lower,
        "upper": upper,
    }


def _nested(mi: Any, value: dict[str, Any] | float) -> dict[str, Any]:
    if isinstance(value, dict) and value["type"] != "rgb":
        return value
    return constant(mi, value["value"] if isinstance(value, dict) else value)


def constant(mi: Any, value: Any) -> dict[str, Any]:
    """Dictionary of a color or number beyond the range of reflectances, which "rgb" refuses."""
    pixel = mi.Bitmap(np.array(value, np.float32).reshape(1, 1, -1))
    return {"type": "bitmap", "bitmap": pixel, "raw": True, "filter_type": "nearest"}


@lru_cache(maxsize=1)
def register(mi: Any) -> None:
    """Define the texture for the variant that is set, and register it."""
    import drjit as dr

    class Product(mi.Texture):
        """See the module."""

        def __init__(self, props: Any) -> None:
            super().__init__(props)
            self.first = props["first"]
            self.second = props["second"]
            self.lower = float(props["lower"])
            self.upper = float(props["upper"])

        def eval(self, si: Any, active: Any = True) -> Any:
            value = self.first.eval(si, active) * self.second.eval(si, active)
            return dr.clip(value, self.lower, self.upper)

        def eval_1(self, si: Any, active: Any = True) -> Any:
            value = self.first.eval_1(si, active) * self.second.eval_1(si, active)
            return dr.clip(value, self.lower, self.upper)

        def eval_3(self, si: Any, active: Any = True) -> Any:
            value = self.first.eval_3(si, active) * self.second.eval_3(si, active)
            return dr.clip(value, self.lower, self.upper)

        def mean(self) -> Any:
            return self.first.mean() * self.second.mean()

        def is_spatially_varying(self) -> bool:
            return True

        def to_string(self) -> str:
            return "Product[]"

    mi.register_texture(PLUGIN, Product)
