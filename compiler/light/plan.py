"""Draws the light of every sample."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, ClassVar

from scenec.compiler.kinds import Context, Finding, an, draw_kind, draw_object, key, kind_of, named
from scenec.compiler.kinds.node import Node
from scenec.compiler.light.suns import SunTrack
from scenec.schemas.codec import Facts, JsonObject
from scenec.schemas.spelling import shown

if TYPE_CHECKING:
    # A cfg's faults are told without them.
    from scenec.compiler.light.cloud_fields import Clouds
    from scenec.compiler.light.lamp import LampPlan
    from scenec.compiler.light.sky import Sky
    from scenec.compiler.scene.light import Haze, SunDisc

#: Keys of a sky that the plan has of its own (``Plan.sky_labels``): its pictures need none of them.
_LABELS = ("labels", "labels_below")


@dataclass(frozen=True, kw_only=True)
class Lights:
    """Sun, sky, clouds, lamps and haze."""

    EXAMPLE: ClassVar = {
        "sun": {"elevation_deg": 35},
        "sky": {"type": "atmosphere", "planet": "earth"},
        "haze": {"visibility_m": 4000},
    }

    sun: JsonObject | None = key(an("suns"), default={})
    """The sun; null for none."""
    sky: JsonObject = key(an("sky"), default={"type": "clear"})
    """The sky."""
    more: JsonObject = key(named(an("light_more"), "One disc.", by="disc"), default={})
    """Further distant discs by name: earthshine, a second sun."""
    lamps: JsonObject = key(named(an("light_lamp"), "One lamp.", by="lamp"), default={})
    """Spot lights by name. Metered exposures count their light where the middle of a picture shows
    it."""
    clouds: JsonObject | None = key(an("light_clouds"), sparse=True)
    """Clouds in the sky, which shade the scene; left out: none."""
    haze: JsonObject | None = key(an("light_haze"), optional=True)
    """Dust or mist before the cameras; left out or null: none."""

    @staticmethod
    def check(node: Node) -> Iterator[Finding]:
        """Yields names that stand twice: all lights stand beside each other in the stage."""
        taken = {"Sun": "the sun", "Dome": "the sky"}
        if node.at("sun")["earthshine"]:
            taken["Earth"] = "the earthshine of the sun"
        for group in ("more", "lamps"):
            for name in node.at(group).entries:
                if name in taken:
                    yield node.key_fault(
                        f"{shown(name)} is the name of {taken[name]} already: expected another one",
                        group,
                        name,
                    )
                taken.setdefault(name, f"light/{group}/{name}")

    @staticmethod
    def fill(light: JsonObject, keys: JsonObject) -> None:
        """Puts what the sky says of its sun where the cfg is silent."""
        usual = kind_of("sky", light["sky"]["type"]).usual_sun(light["sky"])
        if usual is None:
            light["sun"] = None
        elif light["sun"] is not None:
            given = keys.get("sun", {})
            # What the sun computes has no default.
            light["sun"] |= {
                name: value
                for name, value in usual.items()
                if name not in given and light["sun"].get(name) is not None
            }

    def draw(self, context: Context) -> LightPlan:
        """Returns the light of a batch."""

        def drawn(name: str, below: str, node: JsonObject | None, *given: str) -> Any:
            if node is None:
                return None
            path = f"{context.path}/{below}"
            return draw_object(name, node, path, context).draw(*given, context.at(path))

        sky = {name: value for name, value in self.sky.items() if name not in _LABELS}
        sun = None
        if self.sun is not None:
            sun = draw_kind("suns", self.sun, f"{context.path}/sun", context)
        track = sun if isinstance(sun, SunTrack) else SunTrack(sun, {}, {})
        return LightPlan(
            sun=track.disc,
            sky=draw_kind("sky", sky, f"{context.path}/sky", context),
            haze=drawn("light_haze", "haze", self.haze),
            clouds=drawn("light_clouds", "clouds", self.clouds),
            more_suns={
                name: draw_kind("light_more", node, f"{context.path}/more/{name}", context)
                for name, node in self.more.items()
            }
            | track.more,
            sun_facts=track.facts,
            lamps=tuple(
                drawn("light_lamp", f"lamps/{name}", node, name)
                for name, node in self.lamps.items()
            ),
        )


def draw_light(node: JsonObject, context: Context) -> LightPlan:
    """Returns the light of a batch, as the cfg's ``light`` says."""
    lights: Lights = draw_object("light", node, "light", context)
    return lights.draw(context.at("light"))


@dataclass(frozen=True)
class LightPlan:
    """All light of a batch.

    Attributes:
        sun: The sun; None for none. Above an atmosphere its color is a factor on that of sunlight;
            with an overcast sky it is the sun above the clouds.
        sky: What surrounds the scene; None for black.
        clouds: Before an atmosphere or a clear sky.
        more_suns: Further distant discs, by prim name.
        sun_facts: Of a sun that was computed, for report.json.
    """

    sun: SunDisc | None
    sky: Sky | None
    more_suns: dict[str, SunDisc] = field(default_factory=dict)
    haze: Haze | None = None
    clouds: Clouds | None = None
    lamps: tuple[LampPlan, ...] = ()
    sun_facts: Facts = field(default_factory=dict)

    @property
    def lit(self) -> bool:
        """Whether there is a sun, a sky or a lamp."""
        return self.sun is not None or self.sky is not None or bool(self.lamps)
