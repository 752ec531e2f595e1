"""Declares classes of scattered models, and draws them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar, Literal

from scenec.compiler.distributions.numbers import Number
from scenec.compiler.kinds import Context, Finding, Node, forms, key
from scenec.compiler.objects.models import (
    MATERIAL,
    MODELS,
    PARTS,
    check_parts,
    draw_models,
    draw_rules,
)
from scenec.compiler.objects.scattered import Scattered
from scenec.schemas.codec import JsonObject

if TYPE_CHECKING:
    from scenec.compiler.objects.plan import ScatterPlan


@dataclass(frozen=True, kw_only=True)
class Meshes(Scattered):
    """Models from files, scattered over the terrain: plants, boulders, debris."""

    EXAMPLE: ClassVar = {
        "type": "meshes",
        "models": [{"file": "birch.glb"}],
        "labels": {"class": "tree"},
        "per_m2": 0.005,
        "apart": {"gap_m": 1},
    }

    models: tuple[JsonObject, ...] = key(MODELS)
    material: str | None = key(MATERIAL, optional=True)
    parts: JsonObject = key(PARTS, default={})
    scale: Number = key(forms.PER_INSTANCE, default=1, above=0, at_most=1_000_000)
    """Factor on a model's size."""
    variation: float = key(forms.FRACTION_PER_BATCH, default=0)
    """How much the albedo of files' materials varies by instance: base_color (1 + variation v), v
    in [-1, 1]."""
    seat: Literal["origin", "touch"] = key(forms.CHOICE, default="origin")
    """What stands on the ground: origin, the file's, as for plants and made things; or touch, the
    vertex that meets it first, as for rocks."""
    embed: Number = key(forms.FRACTION_PER_INSTANCE, default=0)
    """Fraction of an object's own height that is below the surface."""

    check_files = staticmethod(check_parts)

    @staticmethod
    def check(node: Node, hint: str | None = "") -> Iterator[Finding]:
        """Yields findings between its keys, as of ``Scattered``."""
        yield from Scattered.check(node, hint)
        weights = [model["weight"] for model in node.each("models", "*")]
        if weights and not any(weight != 0 for weight in weights):
            yield node.fault("no model has a weight above 0: expected one or more", "models")

    def draw(self, context: Context) -> ScatterPlan:
        """Returns what is drawn of the class.

        Raises:
            SceneError: There would be too many objects.
        """
        # Imported here: cfgs are checked without.
        from scenec.compiler.objects.drawing import draw_scattered
        from scenec.compiler.objects.plan import ModelSource

        models, rules = draw_models(self.models, context), draw_rules(self.parts, context)
        return draw_scattered(
            self,
            context,
            material=self.material,
            source=ModelSource(models, rules, float(self.variation), self.seat == "touch"),
            weights=[float(model.weight) for model in models],
            orientation="upright",
            size_key="scale",
        )
