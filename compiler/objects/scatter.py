"""Scatters a class of objects: from a plan to instances that are seated on the ground."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.geometry.rotations import turned
from scenec.compiler.geometry.voxels import Cubes
from scenec.compiler.objects.candidates import Candidates, numbers
from scenec.compiler.objects.height_candidates import candidates_on
from scenec.compiler.objects.lod import finest
from scenec.compiler.objects.mesh_candidates import MeshCandidates
from scenec.compiler.objects.placement import Placement, seating_report
from scenec.compiler.objects.rocks import Chain
from scenec.compiler.objects.spacing import MOST_TRIES, Disks
from scenec.compiler.objects.surroundings import Surroundings
from scenec.compiler.scene.plan import Count, ScatterPlan, Spacing
from scenec.compiler.scene.scene import Prototype, Scatter
from scenec.compiler.terrain.sources.mesh_surface import MeshSurface
from scenec.schemas.errors import SceneError
from scenec.schemas.kernels import kernel
from scenec.schemas.threads import POINTS, over_threads


def scatter(
    plan: ScatterPlan, chains: Sequence[Chain], around: Surroundings, facts: dict[str, Any]
) -> Scatter:
    """The instances of one class, all at their finest level.

    Each takes the first of its candidate places that keeps what the plan asks: the ``spacing`` in
    plan, then the clearance of cameras once it is seated. Candidates are distributed by density, so
    what is kept shows in it only where something is in the way.

    Args:
        chains: The levels of each prototype; seated is the finest, so that none moves with another.
        around: Ground, cameras, and the classes placed before.
        facts: Receives what was done, for report.json.

    Raises:
        SceneError: The density is zero everywhere, or there is no place for all.
    """
    prototypes = finest(chains)
    candidates, mesh = _candidates(plan, around)
    n = _count(plan.count, candidates, around)
    u = plan.position_u[:n]
    radius = np.array([p.radius for p in prototypes], np.float64)[plan.prototype[:n]]
    radius = radius * plan.scale[:n].astype(np.float32).astype(np.float64)
    seated = prototypes if plan.source.touch else tuple(stem(p) for p in prototypes)
    placement = Placement(plan, seated, around, mesh)
    tries = np.zeros(n, np.int64)
    packing = None
    if plan.spacing is not None and candidates is not None:
        packing = _Packing(plan, plan.spacing, radius, candidates, u, around)
        tries = packing.tries(tries)
    reach = radius if packing is None else packing.reach
    placed = np.flatnonzero(tries >= 0)
    if candidates is not None:
        at = _numbers_of(plan, u, placed, tries[placed])
        placement.place(placed, at, *candidates.at(at)[:2])
    _require_all(plan, n, len(placed), "keep apart from each other", reach, candidates, around)
    without_room = n - len(placed)
    moved = np.zeros(0, np.int64)
    if candidates is not None and len(around.cameras):
        moved, tries = _clear(
            plan, prototypes, placement, packing, radius, candidates, u, tries, around.cameras
        )
    kept = np.flatnonzero(tries >= 0)
    _require_all(
        plan, n, len(kept) + without_room, _clear_of(plan.clearance_m),
        reach, candidates, around,
    )  # fmt: skip
    facts.update(
        {
            "count": len(kept),
            "float32_error_max_m": placement.rounding_m(kept),
            **({"asked_for": n} if len(kept) < n else {}),
            **({"moved_off_cameras": len(moved)} if len(moved) else {}),
            **({"tries_max": int(tries.max()) + 1} if packing is not None and n else {}),
        }
    )
    instances = Scatter(
        name=plan.name,
        material=plan.material,
        labels=plan.labels,
        instances=plan.instances,
        prototypes=prototypes,
        prototype=plan.prototype[kept],
        positions=placement.positions(kept),
        orientations=placement.orientations[kept],
        scales=_scales(plan, kept),
        variation=plan.variation[kept].astype(np.float32),
        ids=kept + 1,
        drawn=n,
    )
    as_seated = replace(instances, prototypes=seated)
    facts.update(seating_report(as_seated, plan.embed[kept], placement, kept))
    return instances


def stem(prototype: Prototype) -> Prototype:
    """What stands on the ground where the origin does: that point, and how high the model is."""
    height = max(float(prototype.points[:, 2].max()), 0.0)
    points = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, height]], np.float32)
    return replace(prototype, points=points)


def _scales(plan: ScatterPlan, which: NDArray[np.int64]) -> NDArray[np.float32]:
    """Of some instances as the stage will have them, [m, 3]."""
    return np.repeat(plan.scale[which].astype(np.float32)[:, None], 3, axis=1)


def _candidates(
    plan: ScatterPlan, around: Surroundings
) -> tuple[Candidates | None, MeshCandidates | None]:
    """Candidates; None where there is nothing to place."""
    if plan.count.exact == 0 or plan.count.per_m2 == 0.0:
        return None, None
    field = around.surface.field
    if isinstance(field, MeshSurface):
        mesh = MeshCandidates(field, plan.density, plan.where, around, plan.name)
        return mesh.candidates, mesh
    return candidates_on(field, plan.density, plan.where, around, plan.name), None


def _count(count: Count, candidates: Candidates | None, around: Surroundings) -> int:
    if count.exact is not None:
        return count.exact
    if candidates is None or count.per_m2 is None:
        return 0
    size = around.surface.field.grid.size_m
    return int(count.per_m2 * size[0] * size[1] * min(candidates.share, 1.0) + count.rounding_u)


def _numbers_of(
    plan: ScatterPlan, u: NDArray[np.float64], which: NDArray[np.int64], tries: NDArray[np.int64]
) -> NDArray[np.float64]:
    if not tries.any() and len(which) == len(u):
        return u
    return numbers(u, plan.place_key, which, tries)


class _Packing:
    """Puts a class' disks among those that are there before."""

    def __init__(
        self,
        plan: ScatterPlan,
        distances: Spacing,
        radius: NDArray[np.float64],
        candidates: Candidates,
        u: NDArray[np.float64],
        around: Surroundings,
    ):
        """Takes the plan's distances; ``radius`` is that of the balls, float64 [n]."""
        self._plan, self._distances, self._candidates, self._u = plan, distances, candidates, u
        self._others = list(around.among(distances.of))
        #: Radius of each circle, half of the gap included, float64 [n].
        self.reach: NDArray[np.float64] = distances.radius * radius + 0.5 * distances.gap_m
        self._order = np.argsort(-self.reach, kind="stable")

    def tries(self, first: NDArray[np.int64]) -> NDArray[np.int64]:
        """The try that each takes, none before its first; -1 where there is no place."""
        distances = self._distances
        disks = Disks(len(first) + sum(len(other.x) for other in self._others))
        for other in self._others:
            disks.add(other.x, other.y, distances.radius * other.radius + 0.5 * distances.gap_m)
        tries = np.empty(len(first), np.int64)
        tries[self._order] = disks.scatter(
            self._candidates,
            self._u,
            self._plan.place_key,
            self._order,
            self.reach,
            first,
            self._plan.name in distances.of,
        )
        return tries


def _require_all(
    plan: ScatterPlan,
    n: int,
    found: int,
    what: str,
    reach: NDArray[np.float64],
    candidates: Candidates | None,
    around: Surroundings,
) -> None:
    if found == n or plan.fewer:
        return
    size = around.surface.field.grid.size_m
    allowed = 1.0 if candidates is None else candidates.allowed()
    part = np.pi * float((reach * reach).sum()) / (size[0] * size[1] * allowed)
    where = "the terrain" if allowed == 1.0 else f"the {100 * allowed:.3g} % of it they may be on"
    covered = f" (side by side their circles would cover {100 * part:.3g} % of {where})"
    raise SceneError(
        f"objects/{plan.name}: only {found:,} of {n:,} found a place where they {what}, in at "
        f"most {MOST_TRIES} tries each{covered if plan.spacing else ''}; ask for fewer or smaller "
        'ones, allow them more room, or say "shortfall": "fewer"'
    )


def _clear_of(clearance_m: float) -> str:
    if clearance_m > 0.0:
        return f"keep {clearance_m:g} m from every camera"
    return "have no camera inside of them"


def _clear(
    plan: ScatterPlan,
    prototypes: tuple[Prototype, ...],
    placement: Placement,
    packing: _Packing | None,
    radius: NDArray[np.float64],
    candidates: Candidates,
    u: NDArray[np.float64],
    tries: NDArray[np.int64],
    cameras: NDArray[np.float64],
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Moves what is too near to a camera to its next candidates until nothing is.

    Where disks keep apart, all are put anew, the largest first: what was moved does not have to
    do with the room that smaller ones left.

    Args:
        tries: Of each instance; -1 where there is no place.

    Returns:
        Which instances were moved off a camera, and the tries of all.
    """
    sorted_cameras = np.ascontiguousarray(cameras[np.argsort(cameras[:, 0], kind="stable")])
    first = np.zeros(len(tries), np.int64)
    looked_at = np.flatnonzero(tries >= 0)
    cubes = Cubes(prototypes)
    moved = []
    while len(looked_at):
        at = placement.positions(looked_at).astype(np.float64)
        reach = np.maximum(radius[looked_at] + plan.clearance_m, 0.0)
        # Of those whose ball a camera is in, the ones that have geometry there.
        some = np.flatnonzero(_too_near(at, reach, sorted_cameras))
        near = looked_at[some]
        near = near[
            cubes.near(
                plan.prototype[near], at[some],
                turned(placement.orientations[near], _scales(plan, near)), reach[some],
                max(plan.clearance_m, 0.0), sorted_cameras,
            )
        ]  # fmt: skip
        if not len(near):
            break
        moved.append(near)
        first[near] = tries[near] + 1
        before = tries
        if packing is not None:
            tries = packing.tries(np.minimum(first, MOST_TRIES))
        else:
            tries = tries.copy()
            tries[near] += 1
        tries[first >= MOST_TRIES] = -1
        looked_at = np.flatnonzero((tries != before) & (tries >= 0))
        numbers_at = numbers(u, plan.place_key, looked_at, tries[looked_at])
        placement.place(looked_at, numbers_at, *candidates.at(numbers_at)[:2])
    return np.unique(np.concatenate(moved)) if moved else np.zeros(0, np.int64), tries


@kernel
def _too_near_part(first, last, at, reach, cameras, out):  # type: ignore[no-untyped-def]
    for n in range(first, last):
        x, y, z = at[n]
        k = np.searchsorted(cameras[:, 0], x - reach[n])
        while k < len(cameras) and cameras[k, 0] <= x + reach[n]:
            dx, dy, dz = cameras[k, 0] - x, cameras[k, 1] - y, cameras[k, 2] - z
            if dx * dx + dy * dy + dz * dz < reach[n] * reach[n]:
                out[n] = True
                break
            k += 1


def _too_near(at, reach, cameras):  # type: ignore[no-untyped-def]
    """Whether a camera is nearer than its reach to each point; cameras are sorted by x."""
    out = np.zeros(len(at), np.bool_)
    over_threads(_too_near_part, len(at), at, reach, cameras, out, least=POINTS)
    return out
