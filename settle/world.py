"""One neighborhood in MuJoCo: ground as height fields, objects as convex bodies.

Everything is in units of the smallest body's diameter, with gravity 9.81: what happens is then the
same at every size, and so are the errors, in diameters. Where all rest does not depend on gravity.
"""

from __future__ import annotations

import importlib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.arithmetic import elementary
from scenec.compiler.mesh.surface import GroundSurface
from scenec.schemas.errors import SceneError
from scenec.settle.bodies import Body
from scenec.settle.ground import SHELL, tiles_under
from scenec.settle.shapes import Shape

#: Seconds of a step, for a body of 1 m.
STEP_S = 0.002
#: Time constant of contacts: with less than five steps objects creep down slopes.
_CONTACT_S = 6.0 * STEP_S
#: How far around a body the ground is there, in its radii.
_REACH = 4.0
#: Rolling and torsional friction, in diameters.
_ROLLING, _TORSION = 0.01, 0.005
#: What counts as at rest, diameters a second; how many steps it must last.
_STILL, _STILL_STEPS = 0.01, 250
_BLOCK = 25
#: Slower than this, diameters a second, nothing bounces: what bounces a little never rests.
_CALM = 0.2
_GRAVITY = 9.81
#: Falling from higher, in diameters of the smallest body near, a body is deep in the ground before
#: a step ends.
_HIGHEST = 300.0
#: Obstacles smaller than this part of the smallest body, or beyond so many, are not met.
_SMALLEST, _MOST = 0.02, 4000
_MEETS = 1 << 20


@dataclass(frozen=True)
class Options:
    """How things fall.

    Attributes:
        drop_m: Least height over the ground to fall from; None: a tenth of the own diameter.
        friction: Coulomb's coefficient.
        restitution: Speed after a bounce over that before; approximate.
        cells: Of the ground across a body, at least.
        max_steps: After so many steps what still moves is left where it is.
    """

    drop_m: float | None = None
    friction: float = 0.6
    restitution: float = 0.1
    cells: int = 8
    max_steps: int = 20000


@dataclass(frozen=True)
class Fallen:
    """Bodies where they came to rest.

    Attributes:
        bodies: As given, with their new poses.
        speed: Largest of any of a body's points at the end, m/s at Earth's gravity, [n].
        rested: Whether all were at rest when it ended.
        steps: How many were taken.
        overlap_m: How deep bodies are in each other or in obstacles at most.
        ignored: Obstacles too small to be met, or too many.
    """

    bodies: tuple[Body, ...]
    speed: NDArray[np.float64]
    rested: bool
    steps: int
    overlap_m: float
    ignored: int


def physics() -> Any:
    """The library.

    Raises:
        SceneError: It is not installed.
    """
    try:
        return importlib.import_module("mujoco")
    except ImportError as error:
        raise SceneError(
            f"settling needs the extra 'physics': pip install 'scenec[physics]' ({error})"
        ) from error


def fall(
    bodies: Sequence[Body], obstacles: Sequence[Body], surface: GroundSurface, options: Options
) -> Fallen:
    """Lets bodies fall until all rest.

    Args:
        bodies: What falls.
        obstacles: What it may fall onto, and does not move.
        surface: The ground.
        options: How.

    Raises:
        SceneError: The library is not installed, or cannot go on.
    """
    highest_m = _HIGHEST * 2.0 * min(body.radius for body in bodies)
    bodies = tuple(_over_ground(body, surface, options, highest_m) for body in bodies)
    velocity = np.zeros(6 * len(bodies))
    steps, still = 0, 0
    world = _World(bodies, obstacles, surface, options, velocity)
    bodies = world.part()
    while True:
        steps += _BLOCK
        world.advance(_BLOCK)
        still = still + _BLOCK if world.still() else 0
        done = still >= _STILL_STEPS
        if done or steps >= options.max_steps:
            overlap = world.overlap_m()
            return Fallen(world.bodies(), world.speed(), done, steps, overlap, world.ignored)
        if world.leaves():
            velocity = world.velocity()
            world = _World(world.bodies(), obstacles, surface, options, velocity)


def clearance_m(body: Body, surface: GroundSurface) -> float:
    """Height of the mesh's vertex that is nearest to the ground below it, meters."""
    points = body.at(body.shape.points)
    x, y = np.ascontiguousarray(points[:, 0]), np.ascontiguousarray(points[:, 1])
    return float((points[:, 2] - surface.height_at(x, y)).min())


def _over_ground(body: Body, surface: GroundSurface, options: Options, highest_m: float) -> Body:
    drop = 0.2 * body.radius if options.drop_m is None else options.drop_m
    clearance = clearance_m(body, surface)
    if max(clearance, drop) > highest_m:
        raise SceneError(
            f"objects/{body.owner}: object {body.id} would fall {max(clearance, drop):.4g} m, "
            f"expected at most {highest_m:.4g} m, {_HIGHEST:g} times the size of the smallest "
            "object that falls with it"
        )
    return body.raised(max(0.0, drop - clearance))


class _World:
    """A MuJoCo model and its state."""

    def __init__(
        self,
        bodies: Sequence[Body],
        obstacles: Sequence[Body],
        surface: GroundSurface,
        options: Options,
        velocity: NDArray[np.float64],
    ):
        """Builds it; ``velocity`` is MuJoCo's, [6 n]."""
        self._mj = physics()
        self._given = tuple(bodies)
        centers = np.array([body.center for body in bodies])
        self._radius = np.array([body.radius for body in bodies])
        #: Meters to a unit.
        self._unit = 2.0 * float(self._radius.min())
        self._origin = 0.5 * (centers.min(axis=0) + centers.max(axis=0))
        self._radius = self._radius / self._unit
        self._center = (centers - self._origin) / self._unit
        self._size = _size_classes(2.0 * self._radius)
        self._meshes: dict[tuple[Shape, float], list[str]] = {}
        spec = self._mj.MjSpec()
        self._set(spec, options)
        surfaces = {"friction": [options.friction, _TORSION, _ROLLING], "condim": 6}
        self._restitution = options.restitution
        self._ground = self._add_ground(spec, surface, options.cells, surfaces)
        met, self.ignored = self._near(obstacles)
        for body in met:
            frame = {"pos": self._local(body.position), "quat": body.quaternion.tolist()}
            self._add_hulls(spec, spec.worldbody, body, contype=_MEETS, conaffinity=0,
                            **frame, **surfaces)  # fmt: skip
        for n, body in enumerate(bodies):
            one = spec.worldbody.add_body(
                pos=self._local(body.position), quat=body.quaternion.tolist()
            )
            one.add_freejoint()
            affinity = _MEETS | (1 << int(self._size[n]))
            self._add_hulls(spec, one, body, contype=_MEETS, conaffinity=affinity,
                            density=1000.0, **surfaces)  # fmt: skip
        try:
            self._model = spec.compile()
        except (ValueError, self._mj.FatalError) as error:
            raise SceneError(f"MuJoCo cannot take the objects: {error}") from error
        self._data = self._mj.MjData(self._model)
        self._data.qvel[:] = velocity

    def part(self) -> tuple[Body, ...]:
        """Raises bodies that stand in others or in obstacles until they are free."""
        diameter = 2.0 * self._radius
        for _ in range(400):
            self._mj.mj_forward(self._model, self._data)
            by = np.zeros(len(self._given))
            for first, second, depth in self._overlaps():
                pair = [n for n in (first, second) if n >= 0]
                upper = max(pair, key=lambda n: (self._data.xpos[n + 1, 2], n))
                by[upper] = max(by[upper], depth, 0.02 * diameter[upper])
            if not by.any():
                break
            self._data.qpos.reshape(-1, 7)[:, 2] += by
        return self.bodies()

    def advance(self, steps: int) -> None:
        """Goes on by some steps.

        Raises:
            SceneError: The state is no longer finite.
        """
        calm = (self._speed() < _CALM * np.sqrt(2.0 * self._radius)).all()
        self._model.geom_solref[:] = _contact(0.0 if calm else self._restitution)
        try:
            self._mj.mj_step(self._model, self._data, steps)
        except self._mj.FatalError as error:
            raise SceneError(f"MuJoCo gave up: {error}") from error
        if not (np.isfinite(self._data.qpos).all() and np.isfinite(self._data.qvel).all()):
            raise SceneError(
                "the simulation became unstable: objects that differ less in size, or fall from "
                "less high, help"
            )

    def still(self) -> bool:
        """Whether nothing moves to speak of."""
        return bool((self._speed() < _STILL * np.sqrt(2.0 * self._radius)).all())

    def leaves(self) -> bool:
        """Whether a body nears the border of the ground that was laid for it."""
        away = np.abs(self._centers_now()[:, :2] - self._center[:, :2]).max(axis=1)
        return bool((away > (_REACH - 2.0) * self._radius).any())

    def bodies(self) -> tuple[Body, ...]:
        """The bodies as they stand now."""
        found = []
        for body, pose in zip(self._given, self._data.qpos.reshape(-1, 7), strict=True):
            quaternion = pose[3:] / np.sqrt((pose[3:] * pose[3:]).sum())
            position = pose[:3] * self._unit + self._origin
            found.append(replace(body, position=position, quaternion=quaternion))
        return tuple(found)

    def velocity(self) -> NDArray[np.float64]:
        """MuJoCo's, [6 n]."""
        out: NDArray[np.float64] = self._data.qvel.copy()
        return out

    def speed(self) -> NDArray[np.float64]:
        """Of the fastest point of each body, m/s, [n]."""
        out: NDArray[np.float64] = self._speed() * np.sqrt(self._unit)
        return out

    def overlap_m(self) -> float:
        """How deep bodies are in each other or in obstacles at most."""
        self._mj.mj_forward(self._model, self._data)
        return self._unit * max((depth for _, _, depth in self._overlaps()), default=0.0)

    def _overlaps(self) -> list[tuple[int, int, float]]:
        """Indices of two bodies (-1: an obstacle), and how deep they are in each other."""
        contact = self._data.contact
        owner = self._model.geom_bodyid - 1
        found = []
        for (a, b), dist in zip(contact.geom, contact.dist, strict=True):
            if dist < 0.0 and a >= self._ground and b >= self._ground:
                found.append((int(owner[a]), int(owner[b]), -float(dist)))
        return found

    def _speed(self) -> NDArray[np.float64]:
        moving = self._data.qvel.reshape(-1, 6)
        squares = moving * moving
        # The frame's origin may lie outside of the body: its own turn moves it, too.
        middle = self._data.cvel.reshape(-1, 6)[1:, 3:]
        along = np.sqrt((middle * middle).sum(axis=1))
        turn = np.sqrt(squares[:, 3:].sum(axis=1))
        out: NDArray[np.float64] = along + turn * self._radius
        return out

    def _centers_now(self) -> NDArray[np.float64]:
        centers = np.array([body.center for body in self.bodies()])
        return (centers - self._origin) / self._unit

    def _local(self, position: NDArray[np.float64]) -> list[float]:
        local: list[float] = ((position - self._origin) / self._unit).tolist()
        return local

    def _set(self, spec: Any, options: Options) -> None:
        spec.compiler.balanceinertia = True
        spec.option.timestep = STEP_S
        spec.option.gravity = [0.0, 0.0, -_GRAVITY]
        spec.option.cone = self._mj.mjtCone.mjCONE_ELLIPTIC
        spec.option.impratio = 10.0
        # A state that is not finite shall be seen, not begun anew.
        spec.option.disableflags |= self._mj.mjtDisableBit.mjDSBL_AUTORESET
        spec.memory = 1 << 28

    def _near(self, obstacles: Sequence[Body]) -> tuple[list[Body], int]:
        """Obstacles that bodies can reach on the ground laid for them, and how many are not met."""
        met: list[tuple[float, Body]] = []
        reach = _REACH * self._radius
        for body in obstacles:
            center = (body.center - self._origin) / self._unit
            radius = body.radius / self._unit
            away = np.abs(self._center[:, :2] - center[:2]).max(axis=1)
            if (away < reach + radius).any():
                met.append((radius, body))
        largest = sorted(met, key=lambda entry: -entry[0])[:_MOST]
        kept = [body for radius, body in largest if radius >= 0.5 * _SMALLEST]
        return kept, len(met) - len(kept)

    def _add_hulls(self, spec: Any, parent: Any, body: Body, **kwargs: Any) -> None:
        key = (body.shape, body.scale)
        if key not in self._meshes:
            names: list[str] = []
            for hull in body.shape.hulls:
                names.append(f"hull_{len(self._meshes)}_{len(names)}")
                spec.add_mesh(
                    name=names[-1],
                    uservert=(hull * (body.scale / self._unit)).ravel().tolist(),
                    inertia=self._mj.mjtMeshInertia.mjMESH_INERTIA_CONVEX,
                )
            self._meshes[key] = names
        for name in self._meshes[key]:
            parent.add_geom(type=self._mj.mjtGeom.mjGEOM_MESH, meshname=name, **kwargs)

    def _add_ground(
        self, spec: Any, surface: GroundSurface, cells: int, surfaces: dict[str, Any]
    ) -> int:
        """Height fields under all bodies, a grid for each class of sizes: how many."""
        half = _REACH * self._radius
        tiles = tiles_under(
            surface, self._center, half, self._size, cells, self._unit, self._origin
        )
        for n, tile in enumerate(tiles):
            spec.add_hfield(
                name=f"ground_{n}",
                nrow=tile.part.shape[0],
                ncol=tile.part.shape[1],
                # As deep as makes what is fast turn back.
                size=[0.5 * tile.side, 0.5 * tile.side, tile.rise, 4.0 * float(1 << tile.size)],
                userdata=tile.part.ravel().tolist(),
            )
            spec.worldbody.add_geom(
                type=self._mj.mjtGeom.mjGEOM_HFIELD,
                hfieldname=f"ground_{n}",
                pos=list(tile.middle),
                contype=1 << tile.size,
                conaffinity=0,
                margin=SHELL * float(1 << tile.size),
                **surfaces,
            )
        return len(tiles)


def _size_classes(diameter: NDArray[np.float64]) -> NDArray[np.int64]:
    """Whole part of the binary logarithm of numbers from 1 up."""
    _, exponent = np.frexp(diameter * (1.0 + 1e-9))
    return np.maximum(exponent.astype(np.int64) - 1, 0)


def _contact(restitution: float) -> list[float]:
    """MuJoCo's ``solref``: a damped oscillator of one stiffness that gives back so much speed."""
    if restitution <= 0.0:
        return [_CONTACT_S, 1.0]
    log = -float(elementary.log(restitution))
    damping = log / float(np.sqrt(elementary.PI * elementary.PI + log * log))
    return [_CONTACT_S / damping, damping]
