"""Places instances at their candidate positions, rounded as the stage will have them."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.geometry.rotations import align_to_normals
from scenec.compiler.mesh.surface import GroundSurface
from scenec.compiler.objects.bodies import Bodies, vertices
from scenec.compiler.objects.height_pyramid import HeightPyramid
from scenec.compiler.objects.mesh_candidates import MeshCandidates, Spots
from scenec.compiler.objects.mesh_seating import seat_on_mesh
from scenec.compiler.objects.placement_context import PlacementContext
from scenec.compiler.objects.plan import ScatterPlan
from scenec.compiler.objects.seating import seat, seat_on_detail
from scenec.compiler.scene.objects import Prototype, Scatter
from scenec.compiler.terrain.fillets import Fillets
from scenec.compiler.terrain.grid import HeightField
from scenec.compiler.terrain.sources.mesh_surface import MeshSurface
from scenec.compiler.views.resolution import NEAREST_M, pixels_of_balls
from scenec.schemas.codec import Facts

#: Instances whose seat is measured again: all, up to so many, then as many spread over all.
_MEASURED = 16_384
#: Vertices that are held against the surface as it will be meshed.
_VERTICES = 100_000
#: Pixels from which on it shows how the ground's detail is touched.
_SHOWS_PX = 0.5
#: Instances that are placed at once.
_AT_ONCE = 1 << 20


class ClassPlacement:
    """The instances of a class where they are so far."""

    def __init__(
        self,
        plan: ScatterPlan,
        prototypes: tuple[Prototype, ...],
        context: PlacementContext,
        mesh: MeshCandidates | None,
    ):
        self._plan, self._prototypes, self._mesh = plan, prototypes, mesh
        self._context = context
        self._radius = np.array([p.radius for p in prototypes], np.float64)
        self.surface = context.surface
        details = self.surface.details if self.surface.smooth else ()
        self._fillets = [detail for detail in details if isinstance(detail, Fillets)]
        everywhere = tuple(detail for detail in details if not isinstance(detail, Fillets))
        self._amplitude = replace(self.surface, details=everywhere).amplitude_m()
        n = len(plan.scale)
        #: As rounded, float64 [n].
        self.x, self.y, self.z = (np.zeros(n) for _ in range(3))
        self.orientations: NDArray[np.float16] = plan.orientations.astype(np.float16)
        #: Whether each is seated on what is finer than the grid, bool [n].
        self.on_detail = np.zeros(n, np.bool_)

    def place(
        self,
        which: NDArray[np.int64],
        u: NDArray[np.float64],
        x: NDArray[np.float64],
        y: NDArray[np.float64],
    ) -> None:
        """Places instances and seats them.

        Args:
            which: The instances, int64 [m].
            u: The numbers that led to their places, float64 [m, 3].
            x, y: The places in plan, float64 [m].
        """
        if not len(which):
            return
        least = float(self._radii(which).min())
        # In parts: all numbers on the way, of millions at once, are most of what compiling takes.
        for start in range(0, len(which), _AT_ONCE):
            part = slice(start, start + _AT_ONCE)
            self._place(which[part], u[part], x[part], y[part], least)

    def _place(
        self,
        which: NDArray[np.int64],
        u: NDArray[np.float64],
        x: NDArray[np.float64],
        y: NDArray[np.float64],
        least: float,
    ) -> None:
        plan, field = self._plan, self.surface.field
        spots: Spots | None = None
        if self._mesh is not None:
            spots = self._mesh.spots(u)
            x, y = spots.points[:, 0], spots.points[:, 1]
        orientations = plan.orientations[which]
        if plan.align:
            normals = spots.normals if spots else surface_normals(field, x, y)
            orientations = align_to_normals(orientations, normals)
        # Rounded before seating: what stands in the stage is what is held against the ground.
        half = orientations.astype(np.float16)
        x, y = (at.astype(np.float32).astype(np.float64) for at in (x, y))
        size = plan.scale[which].astype(np.float32).astype(np.float64)
        bodies = Bodies.of(
            self._prototypes, plan.prototype[which], (x, y), half, size, plan.embed[which]
        )
        if isinstance(field, MeshSurface) and spots:
            z = seat_on_mesh(field, spots, bodies)
        else:
            z = seat(self.ground, bodies)
        # They follow what is finer than the grid as a whole: by what it is at their middles ...
        z += self.surface.lift_at(x, y)
        # ... unless one could see that.
        at = np.stack([x, y, z], axis=1)
        radius, amplitude = self._radii(which), np.full(len(x), self._amplitude)
        near = self._pixels_per_m(at, radius, least)
        for fillets in self._fillets:
            amplitude += fillets.finer_at(x, y, radius, np.full(len(x), np.inf))
        seen = np.flatnonzero(near * amplitude > _SHOWS_PX)
        if len(seen):
            z[seen] = seat_on_detail(self.surface, self.ground, bodies.some(seen))
        self.on_detail[which] = False
        self.on_detail[which[seen]] = True
        self.x[which], self.y[which], self.z[which] = x, y, z
        self.orientations[which] = half

    @property
    def ground(self) -> HeightPyramid:
        """The relief."""
        return self._context.height_pyramid()

    def pixels_per_m(
        self, at: NDArray[np.float64], prototype: NDArray[np.int32], size: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Pixels of a meter of each object in the view that shows it largest; 0 without views."""
        radius = self._radius[prototype] * size
        return self._pixels_per_m(at, radius, float(radius.min(initial=np.inf)))

    def _pixels_per_m(
        self, at: NDArray[np.float64], radius: NDArray[np.float64], least: float
    ) -> NDArray[np.float64]:
        context = self._context
        if not len(context.views.eye) or not len(at):
            return np.zeros(len(at))
        return pixels_of_balls(context.views, at, radius, context.unseen, min(NEAREST_M, least))

    def _radii(self, which: NDArray[np.int64]) -> NDArray[np.float64]:
        size = self._plan.scale[which].astype(np.float32).astype(np.float64)
        return self._radius[self._plan.prototype[which]] * size

    def positions(self, which: NDArray[np.int64]) -> NDArray[np.float32]:
        """Returns the positions of some instances, float32 [m, 3]."""
        columns = [at[which].astype(np.float32) for at in (self.x, self.y, self.z)]
        return np.stack(columns, axis=1)

    def rounding_m(self, which: NDArray[np.int64]) -> float:
        """Returns how far float32 moves an instance up or down at most, meters."""
        z = self.z[which]
        return float(np.abs(z.astype(np.float32) - z).max(initial=0.0))


def surface_normals(
    field: HeightField, x: NDArray[np.float64], y: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Unit normals of heights at points, over two spacings, float64 [n, 3]."""
    step_x, step_y = field.grid.spacing_m
    gx = (field.height_at(x + step_x, y) - field.height_at(x - step_x, y)) / (2.0 * step_x)
    gy = (field.height_at(x, y + step_y) - field.height_at(x, y - step_y)) / (2.0 * step_y)
    length = np.sqrt(gx * gx + gy * gy + 1.0)
    return np.stack([-gx / length, -gy / length, 1.0 / length], axis=1)


def seating_report(
    scatter: Scatter,
    embed: NDArray[np.float64],
    placement: ClassPlacement,
    which: NDArray[np.int64],
) -> Facts:
    """Measures how well finished instances sit, on the arrays as the stage will have them.

    ``float_max_m`` and ``sink_max_m`` are how far the deepest vertex is above and below the depth
    asked for under the surface as it will be meshed, with all rounding; ``gap_max_px`` what that is
    in the view that shows it largest. ``on_detail`` counts the objects that are seated on what is
    finer than the grid. ``seating_error_max_m`` is how far the others are off under the relief's
    triangles, whose finer detail they follow only as a whole.

    Args:
        embed: What was asked for, float64 [n].
    """
    n = scatter.count
    surface = placement.surface
    if not n or isinstance(surface.field, MeshSurface):
        return {}
    x, y, z = np.ascontiguousarray(scatter.positions.T, np.float64)
    bodies = Bodies.of(
        scatter.prototypes, scatter.prototype, (x, y), scatter.orientations,
        scatter.scales[:, 0].astype(np.float64), embed,
    )  # fmt: skip
    some = np.arange(0, n, -(-n // _MEASURED))
    seated = seat(placement.ground, bodies.some(some))
    off = np.abs(z[some] - surface.lift_at(x[some], y[some]) - seated)
    off = off[~placement.on_detail[which][some]]
    report: dict[str, Any] = {
        "seating_error_max_m": float(off.max(initial=0.0)),
        "seating_measured": len(off),
    }
    if not surface.smooth:
        return report
    per = max(len(p.points) for p in scatter.prototypes)
    few = np.arange(0, n, -(-n // max(_VERTICES // per, 1)))
    gaps = _gaps(surface, bodies.some(few), z[few])
    near = placement.pixels_per_m(
        scatter.positions[few].astype(np.float64),
        scatter.prototype[few],
        scatter.scales[few, 0].astype(np.float64),
    )
    return report | {
        "on_detail": int(placement.on_detail[which].sum()),
        "float_max_m": float(max(gaps.max(), 0.0)),
        "sink_max_m": float(max(-gaps.min(), 0.0)),
        "gap_rms_m": float(np.sqrt((gaps * gaps).mean())),
        "gap_max_px": float((np.abs(gaps) * near).max()),
        "gaps_measured": len(gaps),
    }


def _gaps(
    surface: GroundSurface, bodies: Bodies, origin_z: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Returns the height of each body's deepest vertex above the depth asked for, meters, [n]."""
    (x, y, z), starts = vertices(bodies)
    z += np.repeat(origin_z, np.diff(starts, append=len(z)))
    above = np.minimum.reduceat(z - surface.height_at(x, y), starts)
    tall = np.maximum.reduceat(z, starts) - np.minimum.reduceat(z, starts)
    return above + bodies.embed * tall
