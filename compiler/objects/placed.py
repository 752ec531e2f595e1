"""Single objects at given poses: where each is at every sample."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.cameras.poses import compose, from_quaternion
from scenec.compiler.ground.surface import Surface
from scenec.compiler.objects.poses import PlacedPlan
from scenec.compiler.scene import Placed, Prototype
from scenec.schemas.errors import SceneError


def place_objects(
    plan: PlacedPlan,
    prototypes: tuple[Prototype, ...],
    surface: Surface,
    times: NDArray[np.float64],
) -> Placed:
    """The objects at every sample.

    Args:
        plan: What was drawn.
        prototypes: One for each of the plan's models.
        surface: What they stand on.
        times: Of the samples, seconds.

    Raises:
        SceneError: An object on the ground leaves the terrain.
    """
    moves = any(len(keys.time_s) > 1 for keys in plan.keys)
    samples = times if moves else times[:1]
    to_world = np.empty((len(plan.keys), len(samples), 3, 4))
    for n, keys in enumerate(plan.keys):
        for s, time in enumerate(samples.tolist()):
            position, quaternion, scale = keys.at(time)
            matrix = from_quaternion(np.zeros(3), quaternion)
            matrix[:3, :3] *= scale
            radius = scale * prototypes[plan.model[n]].radius
            matrix = compose(_stand(plan, surface, position, radius, int(plan.ids[n])), matrix)
            to_world[n, s] = matrix[:3]
    return Placed(
        name=plan.name,
        material=plan.material,
        labels=plan.labels,
        instances=plan.instances,
        prototypes=prototypes,
        prototype=plan.model,
        to_world=to_world,
        ids=plan.ids,
        drawn=int(plan.ids.max(initial=0)),
    )


def _stand(
    plan: PlacedPlan, surface: Surface, position: NDArray[np.float64], radius: float, number: int
) -> NDArray[np.float64]:
    """The frame in which an object's turn is given: moved, and tilted with the ground: [4, 4]."""
    out = np.eye(4)
    out[:3, 3] = position
    if not plan.on_ground and not plan.along_normal:
        return out
    half = 0.5 * np.array(surface.field.grid.size_m)
    if not (np.abs(position[:2]) <= half).all():
        raise SceneError(
            f"objects/{plan.name}: object {number} at x {position[0]:g} m, y {position[1]:g} m is "
            f"off the terrain, which ends at {half[0]:g} m and {half[1]:g} m from its middle: its "
            'height over the ground is not known; say "heights": "world"'
        )
    if plan.on_ground:
        x, y = position[:1].copy(), position[1:2].copy()
        out[2, 3] += float(surface.height_at(x, y)[0])
    if plan.along_normal:
        out[:3, :3] = upright_to(_normal_under(surface, position, radius))
    return out


def _normal_under(
    surface: Surface, position: NDArray[np.float64], radius: float
) -> NDArray[np.float64]:
    """Normal of the plane through the ground at an object's rim: [3]."""
    step = max(radius, *surface.field.grid.spacing_m)
    x = position[0] + step * np.array([1.0, -1.0, 0.0, 0.0])
    y = position[1] + step * np.array([0.0, 0.0, 1.0, -1.0])
    half = 0.5 * np.array(surface.field.grid.size_m)
    x, y = np.clip(x, -half[0], half[0]), np.clip(y, -half[1], half[1])
    z = surface.height_at(x, y)
    normal = np.array([-(z[0] - z[1]) / (x[0] - x[1]), -(z[2] - z[3]) / (y[2] - y[3]), 1.0])
    unit: NDArray[np.float64] = normal / np.sqrt((normal * normal).sum())
    return unit


def upright_to(normal: NDArray[np.float64]) -> NDArray[np.float64]:
    """The shortest turn from +z to a unit vector with z > -1, as a matrix: [3, 3]."""
    x, y, z = normal
    f = 1.0 / (1.0 + z)
    return np.array(
        [
            [1.0 - f * x * x, -f * x * y, x],
            [-f * x * y, 1.0 - f * y * y, y],
            [-x, -y, z],
        ]
    )
