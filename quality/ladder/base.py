"""What all ladders of a scene share: built once, when the first of them asks for it."""

from __future__ import annotations

from dataclasses import replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.build import (
    BuildLog,
    build_surface,
    stand_objects,
    stand_rigs,
)
from scenec.compiler.cfg.load import Spec
from scenec.compiler.draw import draw
from scenec.compiler.mesh.surface import Surface
from scenec.compiler.objects.build import Built
from scenec.compiler.objects.plan import ScatterPlan
from scenec.compiler.objects.prototypes import Looks
from scenec.compiler.plan import Plan, fine_everywhere, needs_of_plan
from scenec.compiler.scene.ground import Tile
from scenec.compiler.scene.objects import Placed, Scatter
from scenec.compiler.scene.rig import Rig
from scenec.compiler.terrain.sources.mesh_surface import MeshSurface
from scenec.compiler.views.needed import Keep, with_color
from scenec.compiler.views.resolution import Views, pixels_of_balls, pixels_per_meter, views_of
from scenec.quality.ladder.eyes import Eye, eyes_of

#: As near as errors on the ground are looked at, meters.
_NEAREST_M = 0.05


class Base:
    """One batch of a cfg, as far as it was built.

    Attributes:
        plan: With every number drawn, and as fine out of view as ``keep`` asks for.
        seed: It was drawn from.
        keep: How much of it the output has.
        color, labels: Whether the stage has them: an output shows them, or all is kept.
        tiles: The mesh that the cfg asks for, once it was made.
    """

    def __init__(self, spec: Spec, seed: int, batch: int, keep: Keep = Keep.SEEN, attempt: int = 0):
        """Draws the plan; nothing is built yet.

        Args:
            spec: The cfg.
            seed, batch: Which scene of it.
            keep: How much of it is kept, as of ``compile``.
            attempt: How often it was drawn again.
        """
        plan = draw(spec, seed, batch, attempt)
        self.plan: Plan = fine_everywhere(plan) if keep is Keep.ALL else plan
        self.seed, self.keep = seed, keep
        self.tiles: tuple[Tile, ...] | None = None
        needs = needs_of_plan(self.plan, keep)
        self.color, self.labels = needs.color, needs.labels

    @cached_property
    def surface(self) -> Surface:
        """The ground before it is meshed, and before anything stands on it."""
        return build_surface(self.plan, BuildLog())

    @cached_property
    def rigs(self) -> tuple[Rig, ...]:
        """The cameras; their exposures are of no meaning."""
        return stand_rigs(self.plan, self.surface, None, BuildLog())

    @cached_property
    def eyes(self) -> tuple[Eye, ...]:
        """All cameras and lidars, where they are and how they look."""
        return eyes_of(self.rigs)

    @cached_property
    def views(self) -> Views:
        """The views of the ground, which may hide behind hills."""
        terrain = self.surface.field
        hills = None if isinstance(terrain, MeshSurface) else terrain
        return views_of(self.rigs, hills, self.surface.amplitude_m())

    @cached_property
    def picture_views(self) -> tuple[Views, Views] | None:
        """The views of ground and of objects that say how fine pictures are; None: nothing does.

        Those of cameras that show color alone.
        """
        shown_to = () if self.keep is Keep.ALL else with_color(self.rigs, self.keep)
        if not shown_to:
            return None
        if shown_to is self.rigs:
            return self.views, self.object_views
        terrain = self.surface.field
        hills = None if isinstance(terrain, MeshSurface) else terrain
        return views_of(shown_to, hills, self.surface.amplitude_m()), views_of(shown_to)

    @cached_property
    def object_views(self) -> Views:
        """The views of what stands on the ground."""
        return views_of(self.rigs)

    @property
    def unseen(self) -> float:
        """Part that a pixel counts out of view."""
        return self.plan.terrain.meshing.unseen

    @cached_property
    def near(self) -> NDArray[np.float64] | None:
        """Pixels of a meter at each sample of the grid; None without cameras."""
        if not self.rigs:
            return None
        return pixels_per_meter(self.surface.field, self.views, self.unseen)

    def pixels(self, at: NDArray[np.float64]) -> NDArray[np.float64]:
        """Pixels of a meter at points on the ground, [n, 3], in the view that shows them largest.

        As the mesh's tolerance counts them; 0 without cameras.
        """
        nearest = min(_NEAREST_M, self.plan.terrain.spacing_m)
        return pixels_of_balls(self.views, at, np.zeros(len(at)), self.unseen, nearest)

    @cached_property
    def looks(self) -> Looks | None:
        """The materials; those of models once objects are there."""
        return Looks(dict(self.plan.materials)) if self.color else None

    @cached_property
    def built(self) -> Built:
        """All objects where they stand, as the stage has them before anything is left out.

        And the ground that is meshed, with the fines about their feet.
        """
        return stand_objects(self.plan, self.surface, self.rigs, self.looks, BuildLog())

    @cached_property
    def finest_objects(self) -> tuple[Scatter | Placed, ...]:
        """All objects where they stand, at their finest levels."""
        finest = tuple(
            replace(one, lod_px=0.0) if isinstance(one, ScatterPlan) else one
            for one in self.plan.objects
        )
        plan = replace(self.plan, objects=finest, object_triangles=None)
        return stand_objects(plan, self.surface, self.rigs, self.looks, BuildLog()).objects
