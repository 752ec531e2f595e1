"""Scatters a class of objects: from a plan to instances that are seated on the ground."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.geometry.rotations import turned
from scenec.compiler.geometry.voxels import Cubes
from scenec.compiler.objects.candidates import Candidates, numbers
from scenec.compiler.objects.height_candidates import candidates_on
from scenec.compiler.objects.mesh_candidates import MeshCandidates
from scenec.compiler.objects.placement import ClassPlacement, seating_report
from scenec.compiler.objects.placement_context import PlacementContext, footprint_radii
from scenec.compiler.objects.plan import ObjectCount, ScatterPlan
from scenec.compiler.objects.rocks import Chain
from scenec.compiler.objects.scattered import Spacing
from scenec.compiler.objects.spacing import MOST_TRIES, Disks
from scenec.compiler.scene.objects import Prototype, Scatter
from scenec.compiler.terrain.sources.mesh_surface import MeshSurface
from scenec.schemas.codec import JSON
from scenec.schemas.errors import SceneError
from scenec.schemas.kernels import kernel
from scenec.schemas.threads import POINTS, over_threads


def scatter(
    plan: ScatterPlan, chains: Sequence[Chain], context: PlacementContext, facts: dict[str, JSON]
) -> Scatter:
    """The instances of one class, all at their finest level.

    Each takes the first of its candidate places that keeps what the plan asks: the ``spacing`` in
    plan, then the clearance of cameras once it is seated. Candidates are distributed by density, so
    what is kept shows in it only where something is in the way.

    Args:
        chains: The levels of each prototype; seated is the finest, so that none moves with another.
        context: Ground, cameras, and the classes placed before.
        facts: Receives what was done, for report.json.

    Raises:
        SceneError: The density is zero everywhere, or there is no place for all.
    """
    work = _Scattering(plan, tuple(chain[0] for chain in chains), context)
    n, placement = work.n, work.placement
    work.place_all()
    without_room = int((work.tries < 0).sum())
    work.require_all(n - without_room, "keep apart from each other")
    moved = work.clear_cameras()
    kept = np.flatnonzero(work.tries >= 0)
    clearance = f"keep {plan.clearance_m:g} m from every camera"
    inside = "have no camera inside of them"
    work.require_all(len(kept) + without_room, clearance if plan.clearance_m > 0.0 else inside)
    facts.update(
        {
            "count": len(kept),
            "float32_error_max_m": placement.rounding_m(kept),
            **({"asked_for": n} if len(kept) < n else {}),
            **({"moved_off_cameras": len(moved)} if len(moved) else {}),
            **({"tries_max": int(work.tries.max()) + 1} if work.spacing is not None and n else {}),
        }
    )
    instances = Scatter(
        name=plan.name,
        material=plan.material,
        labels=plan.labels,
        instances=plan.instances,
        prototypes=work.prototypes,
        prototype=plan.prototype[kept],
        positions=placement.positions(kept),
        orientations=placement.orientations[kept],
        scales=_scales(plan, kept),
        variation=plan.variation[kept].astype(np.float32),
        ids=kept + 1,
        drawn=n,
    )
    as_seated = replace(instances, prototypes=work.seated)
    facts.update(seating_report(as_seated, plan.embed[kept], placement, kept))
    return instances


def _stem(prototype: Prototype) -> Prototype:
    """Reduces a prototype to what meets the ground at its origin: that point, and its height."""
    height = max(float(prototype.points[:, 2].max()), 0.0)
    points = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, height]], np.float32)
    return replace(prototype, points=points)


def _scales(plan: ScatterPlan, which: NDArray[np.int64]) -> NDArray[np.float32]:
    """Returns the scales of some instances as the stage will have them, [m, 3]."""
    return np.repeat(plan.scale[which].astype(np.float32)[:, None], 3, axis=1)


def _candidates(
    plan: ScatterPlan, context: PlacementContext
) -> tuple[Candidates | None, MeshCandidates | None]:
    """Candidates; None where there is nothing to place."""
    if plan.count.exact == 0 or plan.count.per_m2 == 0.0:
        return None, None
    field = context.surface.field
    if isinstance(field, MeshSurface):
        mesh = MeshCandidates(field, plan.density, plan.where, context, plan.name)
        return mesh.candidates, mesh
    return candidates_on(field, plan.density, plan.where, context, plan.name), None


def _count(count: ObjectCount, candidates: Candidates | None, context: PlacementContext) -> int:
    if count.exact is not None:
        return count.exact
    if candidates is None or count.per_m2 is None:
        return 0
    size = context.surface.field.grid.size_m
    return int(count.per_m2 * size[0] * size[1] * min(candidates.share, 1.0) + count.rounding_u)


class _Scattering:
    """The instances of a class on their way to their places.

    Attributes:
        n: How many are asked for.
        seated: What of each prototype is held against the ground.
        spacing: What is kept in plan, or None.
        tries: The candidate that each takes, -1 where there is no place, int64 [n].
    """

    def __init__(
        self, plan: ScatterPlan, prototypes: tuple[Prototype, ...], context: PlacementContext
    ) -> None:
        self.plan, self.prototypes, self._context = plan, prototypes, context
        self._candidates, mesh = _candidates(plan, context)
        self.n = n = _count(plan.count, self._candidates, context)
        self._u = plan.position_u[:n]
        radius = np.array([p.radius for p in prototypes], np.float64)[plan.prototype[:n]]
        self._radius = radius * plan.scale[:n].astype(np.float32).astype(np.float64)
        self.seated = prototypes if plan.source.touch else tuple(map(_stem, prototypes))
        self.placement = ClassPlacement(plan, self.seated, context, mesh)
        self.tries: NDArray[np.int64] = np.zeros(n, np.int64)
        #: Radius of each circle in plan, half of the gap included, float64 [n].
        self._reach = self._radius
        self.spacing = None if self._candidates is None else plan.spacing
        if self.spacing is not None:
            self._reach = self._circles(self.spacing) + 0.5 * self.spacing.gap_m

    def _circles(self, spacing: Spacing) -> NDArray[np.float64]:
        """Radii of the objects' circles in plan, float64 [n]."""
        if spacing.radius is not None:
            return spacing.radius * self._radius
        if self.plan.align:
            # Seen from above, they are as wide as the ground turns them: at most this.
            return self._radius
        which = np.arange(self.n)
        turns = turned(self.plan.orientations[which].astype(np.float16), _scales(self.plan, which))
        return footprint_radii(self.prototypes, self.plan.prototype[which], turns)

    def place_all(self) -> None:
        """Gives each the first candidate that keeps its distance in plan."""
        if self.spacing is not None:
            self.tries = self._packed(self.spacing, self.tries)
        self._place(np.flatnonzero(self.tries >= 0))

    def _place(self, which: NDArray[np.int64]) -> None:
        if self._candidates is None:
            return
        at, tries = self._u, self.tries[which]
        if tries.any() or len(which) < len(at):
            at = numbers(at, self.plan.place_key, which, tries)
        self.placement.place(which, at, *self._candidates.at(at)[:2])

    def _packed(self, spacing: Spacing, first: NDArray[np.int64]) -> NDArray[np.int64]:
        """The try that each takes, none before its first; -1 where there is no place."""
        assert self._candidates is not None
        context, times = self._context, spacing.radius
        laid, times = (context.footprints, 1.0) if times is None else (context.objects, times)
        of = spacing.of or (self.plan.name,)
        others = [laid[name] for name in of if name in laid]
        disks = Disks(len(first) + sum(len(other.x) for other in others))
        for other in others:
            disks.add(other.x, other.y, times * other.radius + 0.5 * spacing.gap_m)
        order = np.argsort(-self._reach, kind="stable")
        own, key = self.plan.name in of, self.plan.place_key
        tries = np.empty(len(first), np.int64)
        tries[order] = disks.scatter(self._candidates, self._u, key, order, self._reach, first, own)
        return tries

    def clear_cameras(self) -> NDArray[np.int64]:
        """Moves what is too near to a camera to its next candidates until nothing is; which.

        Where disks keep apart, all are put anew, the largest first: what was moved does not have to
        do with the room that smaller ones left.
        """
        cameras = self._context.cameras
        cameras = np.ascontiguousarray(cameras[np.argsort(cameras[:, 0], kind="stable")])
        first = np.zeros(self.n, np.int64)
        looked_at = np.flatnonzero(self.tries >= 0) if len(cameras) else first[:0]
        cubes = Cubes([p.mesh for p in self.prototypes])
        moved = [first[:0]]
        while len(looked_at):
            near = self._near(looked_at, cameras, cubes)
            if not len(near):
                break
            moved.append(near)
            before = self.tries
            first[near] = before[near] + 1
            if self.spacing is not None:
                self.tries = self._packed(self.spacing, np.minimum(first, MOST_TRIES))
            else:
                self.tries = before.copy()
                self.tries[near] += 1
            self.tries[first >= MOST_TRIES] = -1
            looked_at = np.flatnonzero((self.tries != before) & (self.tries >= 0))
            self._place(looked_at)
        return np.unique(np.concatenate(moved))

    def _near(
        self, which: NDArray[np.int64], cameras: NDArray[np.float64], cubes: Cubes
    ) -> NDArray[np.int64]:
        """Selects the instances that contain a camera, or are nearer to one than the clearance."""
        plan, clearance = self.plan, self.plan.clearance_m
        at = self.placement.positions(which).astype(np.float64)
        reach = np.maximum(self._radius[which] + clearance, 0.0)
        too_near = np.zeros(len(at), np.bool_)
        over_threads(_too_near_part, len(at), at, reach, cameras, too_near, least=POINTS)
        # Of those whose ball a camera is in, the ones that have geometry there.
        some = np.flatnonzero(too_near)
        near = which[some]
        turns = turned(self.placement.orientations[near], _scales(plan, near))
        return near[
            cubes.near(
                plan.prototype[near], at[some], turns, reach[some], max(clearance, 0.0), cameras
            )
        ]

    def require_all(self, placed: int, what: str) -> None:
        """Refuses instances that found no place, unless the plan lets fewer be.

        Raises:
            SceneError: There are some.
        """
        if placed == self.n or self.plan.fewer:
            return
        size, reach = self._context.surface.field.grid.size_m, self._reach
        allowed = 1.0 if self._candidates is None else self._candidates.allowed()
        part = np.pi * float((reach * reach).sum()) / (size[0] * size[1] * allowed)
        where = "the terrain"
        if allowed != 1.0:
            where = f"the {100 * allowed:.3g} % of it they may be on"
        covered = f" (side by side their circles would cover {100 * part:.3g} % of {where})"
        raise SceneError(
            f"objects/{self.plan.name}: only {placed:,} of {self.n:,} found a place where they "
            f"{what}, in at most {MOST_TRIES} tries each{covered if self.plan.spacing else ''}; "
            'ask for fewer or smaller ones, allow them more room, or say "shortfall": "fewer"'
        )


@kernel
def _too_near_part(first, last, at, reach, cameras, out):  # type: ignore[no-untyped-def]
    """Whether a camera is nearer than its reach to each point; cameras are sorted by x."""
    for n in range(first, last):
        x, y, z = at[n]
        k = np.searchsorted(cameras[:, 0], x - reach[n])
        while k < len(cameras) and cameras[k, 0] <= x + reach[n]:
            dx, dy, dz = cameras[k, 0] - x, cameras[k, 1] - y, cameras[k, 2] - z
            if dx * dx + dy * dy + dz * dz < reach[n] * reach[n]:
                out[n] = True
                break
            k += 1
