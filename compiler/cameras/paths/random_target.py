"""Places cameras at drawn places that look at drawn targets."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.cameras.paths.motion import MotionContext, RigPoses
from scenec.compiler.distributions.numbers import Number
from scenec.compiler.distributions.resolve import per_sample
from scenec.compiler.geometry.poses import bearing_vector, look_at
from scenec.compiler.kinds import Context, Finding, Form, Node, bounded, key, off_terrain
from scenec.compiler.kinds.forms import COORDINATE_PER_SAMPLE, LENGTH_PER_SAMPLE, TURN_PER_SAMPLE


def _object(needed: Sequence[str], **keys: Form) -> Form:
    """Returns the form of an object with such keys."""
    properties = {name: form.keywords for name, form in keys.items()}
    return Form({
        "type": "object", "required": list(needed), "properties": properties,
        "additionalProperties": False,
    })  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class RandomTarget:
    """A position above the terrain, looking at a target."""

    EXAMPLE: ClassVar = {
        "type": "random_target",
        "position": {
            "x_m": {"type": "uniform", "min": -15, "max": 15},
            "y_m": {"type": "uniform", "min": -15, "max": 15},
            "height_m": 1.5,
        },
        "target": {
            "distance_m": 8,
            "bearing_deg": {"type": "uniform", "min": 0, "max": 360},
            "height_m": 0,
        },
    }

    position: Mapping[str, Number] = key(
        _object(
            ("x_m", "y_m", "height_m"),
            x_m=LENGTH_PER_SAMPLE.but(description="Position to the east; must lie on the terrain."),
            y_m=LENGTH_PER_SAMPLE.but(
                description="Position to the north; must lie on the terrain."
            ),
            height_m=bounded(LENGTH_PER_SAMPLE, above=0, at_most=10_000_000).but(
                description="Height above the ground."
            ),
        )
    )
    """Where the rig is."""
    target: Mapping[str, Number] = key(
        _object(
            ("distance_m",),
            distance_m=bounded(LENGTH_PER_SAMPLE, above=0, at_most=10_000_000).but(
                description="Horizontal distance from the rig."
            ),
            bearing_deg=TURN_PER_SAMPLE.but(
                description="Compass bearing from the rig, clockwise from +Y (north).",
                default={"type": "uniform", "min": 0, "max": 360},
            ),
            height_m=COORDINATE_PER_SAMPLE.but(
                description="Height of the target above the ground there.", default=0
            ),
        )
    )
    """What the rig looks at."""
    roll_deg: Number = key(TURN_PER_SAMPLE, default=0)
    """Turn about the line of sight, clockwise as the rig sees it."""

    @staticmethod
    def check(node: Node) -> Iterator[Finding]:
        """Yields findings on positions off the terrain."""
        position = node.at("position")
        for name, how in off_terrain(node.whole(), position):
            unbounded = any(map(math.isinf, position.span(name) or ()))
            hint = " (give the distribution min and max)" if unbounded else ""
            yield position.fault(f"{how}: expected a position on it{hint}", name)

    def draw(self, context: Context) -> RandomTargetPlan:
        """Returns the places and targets of every sample."""

        def drawn(number: Number, below: str) -> NDArray[np.float64]:
            return per_sample(number, context.streams, f"{context.path}/{below}", context.samples)

        at, target = (
            {name: drawn(number, f"{of}/{name}") for name, number in numbers.items()}
            for of, numbers in (("position", self.position), ("target", self.target))
        )
        return RandomTargetPlan(
            xy=np.stack([at["x_m"], at["y_m"]], axis=1),
            height_m=at["height_m"],
            distance_m=target["distance_m"],
            bearing_deg=target["bearing_deg"],
            target_height_m=target["height_m"],
            roll_deg=drawn(self.roll_deg, "roll_deg"),
        )


@dataclass(frozen=True)
class RandomTargetPlan:
    """Places and targets; all arrays over the samples.

    Attributes:
        xy: Position in plan, [s, 2].
        height_m: Above the surface.
        distance_m, bearing_deg: Of the target, in plan.
        target_height_m: Of the target above the surface.
        roll_deg: About the viewing axis.
    """

    xy: NDArray[np.float64]
    height_m: NDArray[np.float64]
    distance_m: NDArray[np.float64]
    bearing_deg: NDArray[np.float64]
    target_height_m: NDArray[np.float64]
    roll_deg: NDArray[np.float64]
    needs_objects: ClassVar = False

    def built(self, context: MotionContext) -> RigPoses:
        """The poses; see ``Motion``."""
        position = np.column_stack([self.xy, context.ground(self.xy) + self.height_m])
        offset = np.array([bearing_vector(float(b)) for b in self.bearing_deg])
        target = position + self.distance_m[:, None] * offset
        target[:, 2] = context.ground(target) + self.target_height_m
        looks = zip(position, target, self.roll_deg.tolist(), strict=True)
        return RigPoses(np.stack([look_at(eye, at, roll) for eye, at, roll in looks]))
