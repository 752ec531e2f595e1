"""Objects of a batch as bodies: what is dropped, and what it may meet."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.geometry.poses import from_quaternion
from scenec.compiler.objects.placed import PlacedPlan
from scenec.compiler.objects.plan import ScatterPlan
from scenec.compiler.scene.objects import Placed, Scatter
from scenec.schemas.quaternions import quaternion as quaternion_of
from scenec.settle.shapes import Shape, shape_of


@dataclass(frozen=True)
class Body:
    """One object.

    Attributes:
        owner: Name of its class.
        id: Its local id.
        model: Index of its model in the cfg; -1 for a rock.
        shape: What physics sees of it.
        position: Of the model's origin in the world, meters, [3].
        quaternion: w, x, y, z, [4].
        scale: Factor on the model.
    """

    owner: str
    id: int
    model: int
    shape: Shape
    position: NDArray[np.float64]
    quaternion: NDArray[np.float64]
    scale: float

    @property
    def radius(self) -> float:
        """Returns the radius of the ball around ``center`` that holds it, meters."""
        return self.scale * self.shape.radius

    @property
    def center(self) -> NDArray[np.float64]:
        """Returns the center of the bounding ball, world, [3]."""
        return self.at(self.shape.center[None])[0]

    def at(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Points of the model in the world, [n, 3]."""
        turn = self.scale * from_quaternion(np.zeros(3), self.quaternion)[:3, :3]
        return (points[:, None, :] * turn[None]).sum(axis=2) + self.position

    def raised(self, by: float) -> Body:
        """The body higher up, meters."""
        return replace(self, position=self.position + np.array([0.0, 0.0, by]))


def bodies_of(
    plan: ScatterPlan | PlacedPlan, placed: Scatter | Placed, *, measure: bool
) -> list[Body]:
    """The objects of a class, at the first sample.

    Args:
        plan: What was drawn of the class.
        placed: Where its objects stand.
        measure: Whether the gap between hulls and meshes is measured.
    """
    shapes: dict[int, Shape] = {}
    found = []
    for n in range(placed.count):
        which = int(placed.prototype[n])
        if which not in shapes:
            shapes[which] = shape_of(placed.prototypes[which], measure)
        number = int(placed.ids[n])
        if isinstance(placed, Placed):
            matrix = placed.to_world[n, 0]
            columns = matrix[:, :3]
            scale = float(np.sqrt((columns * columns).sum() / 3.0))
            quaternion, position = np.roll(quaternion_of(columns / scale), 1), matrix[:, 3]
            model = which
        else:
            x, y, z, w = placed.orientations[n].astype(np.float64)
            quaternion = np.array([w, x, y, z])
            quaternion = quaternion / np.sqrt((quaternion * quaternion).sum())
            position = placed.positions[n].astype(np.float64)
            scale = float(placed.scales[n].max())
            # Prototypes that no instance shows are left out of a class: the plan counts all.
            model = -1 if isinstance(plan, PlacedPlan) else int(plan.prototype[number - 1])
        found.append(Body(placed.name, number, model, shapes[which], position, quaternion, scale))
    return found
