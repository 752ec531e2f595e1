"""Defines what a kind of sky is, and the black one."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, ClassVar, Self

from scenec.compiler.kinds import Array, Context, Node, bounded, forms
from scenec.schemas.codec import Facts, JsonObject

if TYPE_CHECKING:
    # A cfg is checked without what shines.
    from scenec.compiler.scene.light import SkyLabelMaps, SkyLight, SunDisc

ROWS = bounded(forms.COUNT, at_least=8, at_most=4096, unit="px").but(
    default=128,
    description="Height of the lat-long picture in pixels, half its width.",
)


#: Pictures of a sky, None for black; its sun, None for none; facts for report.json.
type SkyAndSun = tuple[SkyLight | None, SunDisc | None, Facts]


class Sky(ABC):
    """Surrounds the scene. Numbers of each sample are arrays once they are drawn."""

    #: Albedo of the far ground, [s, 3]; clouds that are drawn before the sky are lit by it.
    ground_color: Array

    def draw(self, context: Context) -> Self | None:
        """Returns what is built: the sky at every sample, or None for black."""
        return replace(self, **context.sampled(self))  # type: ignore[type-var]

    @abstractmethod
    def build(self, sun: SunDisc | None, samples: int) -> SkyAndSun:
        """Returns pictures of the sky, the sun as it is seen in it, and facts for report.json.

        Args:
            sun: As the cfg has it, above the sky; None for none.
            samples: How many.
        """

    def build_label_maps(self) -> SkyLabelMaps | None:
        """Returns what is seen where in the pictures; None: the sky's one label everywhere."""
        return None

    @staticmethod
    def usual_sun(sky: JsonObject) -> JsonObject | None:
        """Returns keys of the sun where the cfg is silent; None: the sky gives the sun itself.

        Args:
            sky: The sky's keys in full.
        """
        return {}

    @staticmethod
    def takes_clouds(sky: Node) -> bool:
        """Returns whether clouds can be drawn before a sky: ``ground_color`` is one of its fields.

        Args:
            sky: As the cfg has it; asked is this before anything is drawn.
        """
        return False


class CloudLayer(ABC):
    """Clouds of another package. Numbers of each sample are arrays once they are drawn."""

    def draw(self, context: Context) -> Self:
        """Returns the layer at every sample."""
        return replace(self, **context.sampled(self))  # type: ignore[type-var]

    @abstractmethod
    def add(self, sky: SkyLight, sun: SunDisc | None, samples: int) -> SkyAndSun:
        """Returns the sky with the layer in its pictures, what is left of the sun, and facts.

        Args:
            sky: With all that is behind the layer, in pictures that were made.
            sun: As it comes to the layer; None for none.
            samples: How many.
        """


@dataclass(frozen=True, kw_only=True)
class BlackSky(Sky):
    """A black sky, which can have labels all the same."""

    EXAMPLE: ClassVar = {"type": "none"}

    def draw(self, context: Context) -> None:
        """Returns None."""

    def build(self, sun: SunDisc | None, samples: int) -> SkyAndSun:
        """Returns no pictures, and the sun."""
        return None, sun, {}
