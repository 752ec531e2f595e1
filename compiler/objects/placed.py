"""Single objects: their poses over time, and where they then stand."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.arithmetic import elementary
from scenec.compiler.geometry.poses import compose, from_quaternion
from scenec.compiler.geometry.rotations import upright_to
from scenec.compiler.mesh.surface import GroundSurface
from scenec.compiler.objects.models import ModelKeys, PartRule
from scenec.compiler.scene.labels import Labels
from scenec.compiler.scene.objects import Placed, Prototype
from scenec.schemas.errors import SceneError


@dataclass(frozen=True)
class PoseKeys:
    """One object's poses at some times.

    Attributes:
        time_s: Rising, float64 [k].
        position_m: float64 [k, 3]; z is a height over the ground, or of the world.
        quaternion: w, x, y, z, unit, float64 [k, 4].
        scale: float64 [k].
    """

    time_s: NDArray[np.float64]
    position_m: NDArray[np.float64]
    quaternion: NDArray[np.float64]
    scale: NDArray[np.float64]

    def at(self, time_s: float) -> tuple[NDArray[np.float64], NDArray[np.float64], float]:
        """Position [3], quaternion [4] and scale between the keys; before and after, as at the end.

        Positions and scales are linear in time, turns go the shorter way at an even rate (Shoemake
        1985).
        """
        times = self.time_s
        if len(times) == 1:
            return self.position_m[0], self.quaternion[0], float(self.scale[0])
        i = min(max(int(np.searchsorted(times, time_s, side="right")) - 1, 0), len(times) - 2)
        part = float(np.clip((time_s - times[i]) / (times[i + 1] - times[i]), 0.0, 1.0))
        return (
            (1.0 - part) * self.position_m[i] + part * self.position_m[i + 1],
            slerp(self.quaternion[i], self.quaternion[i + 1], part),
            float((1.0 - part) * self.scale[i] + part * self.scale[i + 1]),
        )


def slerp(a: NDArray[np.float64], b: NDArray[np.float64], part: float) -> NDArray[np.float64]:
    """The unit quaternion a part of the way from one to another, the shorter way round: [4]."""
    cosine = float((a * b).sum())
    if cosine < 0.0:
        a, cosine = -a, -cosine
    # The sine of the angle between them, from their difference: exact where they are close.
    across = b - cosine * a
    sine = float(np.sqrt((across * across).sum()))
    if sine < 1e-9:
        mixed = (1.0 - part) * a + part * b
    else:
        angle = float(elementary.atan2(sine, cosine))
        mixed = (elementary.sin((1.0 - part) * angle) * a + elementary.sin(part * angle) * b) / sine
    return mixed / np.sqrt((mixed * mixed).sum())


@dataclass(frozen=True)
class PlacedPlan:
    """One class of single objects.

    Attributes:
        name, material, labels, instances: As in ``Placed``.
        model: Index of each object's, int32 [n].
        ids: Local instance ids, ascending, int64 [n].
        on_ground: Whether heights are over the ground below the object's origin.
        along_normal: Whether objects stand along the ground's normal under them.
        variation: How much the models' own materials vary.
    """

    name: str
    material: str | None
    labels: Labels
    instances: bool
    models: tuple[ModelKeys, ...]
    rules: tuple[PartRule, ...]
    model: NDArray[np.int32]
    ids: NDArray[np.int64]
    keys: tuple[PoseKeys, ...]
    on_ground: bool
    along_normal: bool
    variation: float


def place_objects(
    plan: PlacedPlan,
    prototypes: tuple[Prototype, ...],
    surface: GroundSurface,
    times: NDArray[np.float64],
) -> Placed:
    """The objects at every sample.

    Raises:
        SceneError: An object on the ground leaves the terrain.
    """
    moves = any(len(keys.time_s) > 1 for keys in plan.keys)
    samples = times if moves else times[:1]
    poses = [keys.at(time) for keys in plan.keys for time in samples.tolist()]
    numbers = np.repeat(plan.ids, len(samples))
    at = np.array([position for position, _, _ in poses]).reshape(-1, 3)
    radius = np.array([p.radius for p in prototypes])[np.repeat(plan.model, len(samples))]
    radius = radius * np.array([scale for _, _, scale in poses])
    frames = _frames(plan, surface, at, radius, numbers)
    to_world = np.empty((len(poses), 3, 4))
    for i, (_, quaternion, scale) in enumerate(poses):
        matrix = from_quaternion(np.zeros(3), quaternion)
        matrix[:3, :3] *= scale
        to_world[i] = compose(frames[i], matrix)[:3]
    return Placed(
        name=plan.name,
        material=plan.material,
        labels=plan.labels,
        instances=plan.instances,
        prototypes=prototypes,
        prototype=plan.model,
        to_world=to_world.reshape(len(plan.keys), len(samples), 3, 4),
        ids=plan.ids,
        drawn=int(plan.ids.max(initial=0)),
    )


def _frames(
    plan: PlacedPlan,
    surface: GroundSurface,
    at: NDArray[np.float64],
    radius: NDArray[np.float64],
    numbers: NDArray[np.int64],
) -> NDArray[np.float64]:
    """The frames in which turns are given: moved, and tilted with the ground: [n, 4, 4].

    Args:
        at, radius: Where objects are, and the balls around them, [n, 3] and [n].
        numbers: Their ids, for messages.
    """
    out = np.tile(np.eye(4), (len(at), 1, 1))
    out[:, :3, 3] = at
    if not plan.on_ground and not plan.along_normal:
        return out
    half = 0.5 * np.array(surface.field.grid.size_m)
    off = np.flatnonzero(~(np.abs(at[:, :2]) <= half).all(axis=1))
    if len(off):
        position, number = at[off[0]], int(numbers[off[0]])
        raise SceneError(
            f"objects/{plan.name}: object {number} at x {position[0]:g} m, y {position[1]:g} m is "
            f"off the terrain, which ends at {half[0]:g} m and {half[1]:g} m from its middle: its "
            'height over the ground is not known; say "heights": "world"'
        )
    x, y = (np.ascontiguousarray(at[:, axis]) for axis in (0, 1))
    if plan.on_ground:
        out[:, 2, 3] += surface.height_at(x, y)
    if plan.along_normal:
        out[:, :3, :3] = upright_to(_normals_under(surface, x, y, radius))
    return out


def _normals_under(
    surface: GroundSurface,
    x: NDArray[np.float64],
    y: NDArray[np.float64],
    radius: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Normals of the planes through the ground at objects' rims: [n, 3]."""
    step = np.maximum(radius, max(surface.field.grid.spacing_m))[:, None]
    half = 0.5 * np.array(surface.field.grid.size_m)
    rim_x = np.clip(x[:, None] + step * np.array([1.0, -1.0, 0.0, 0.0]), -half[0], half[0])
    rim_y = np.clip(y[:, None] + step * np.array([0.0, 0.0, 1.0, -1.0]), -half[1], half[1])
    z = surface.height_at(rim_x.ravel(), rim_y.ravel()).reshape(-1, 4)
    gx = (z[:, 0] - z[:, 1]) / (rim_x[:, 0] - rim_x[:, 1])
    gy = (z[:, 2] - z[:, 3]) / (rim_y[:, 2] - rim_y[:, 3])
    normal = np.stack([-gx, -gy, np.ones(len(x))], axis=1)
    return normal / np.sqrt((normal * normal).sum(axis=1))[:, None]
