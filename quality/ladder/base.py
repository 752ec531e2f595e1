"""What all ladders of a scene share: built once, when the first of them asks for it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cached_property
from typing import Any

import numpy as np

from scenec.compiler.build import State, build_to
from scenec.compiler.cameras.rigs import place_rigs
from scenec.compiler.cfg.load import Spec
from scenec.compiler.draw import draw
from scenec.compiler.mesh.build import build_surface, see_ground
from scenec.compiler.mesh.surface import GroundSurface
from scenec.compiler.objects.build import build_objects
from scenec.compiler.objects.plan import ScatterPlan
from scenec.compiler.plan import Plan, fine_everywhere, needs_of_plan
from scenec.compiler.scene.ground import MeshTile
from scenec.compiler.scene.objects import Objects
from scenec.compiler.scene.rig import Rig
from scenec.compiler.views.needed import Keep
from scenec.compiler.views.resolution import Views, pixels_of_balls, views_of
from scenec.quality.ladder.eyes import Eye, eyes_of
from scenec.quality.ladder.points import Floats

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
        self.tiles: tuple[MeshTile, ...] | None = None
        self.needs = needs_of_plan(self.plan, keep)
        self.color, self.labels = self.needs.color, self.needs.labels

    @cached_property
    def surface(self) -> GroundSurface:
        """The ground before it is meshed, and before anything stands on it."""
        surface: GroundSurface = build_to(build_surface, self.plan)["surface"]
        return surface

    @cached_property
    def rigs(self) -> tuple[Rig, ...]:
        """The cameras; their exposures are of no meaning."""
        rigs: tuple[Rig, ...] = build_to(place_rigs, self.plan, surface=self.surface)["rigs"]
        return rigs

    @cached_property
    def eyes(self) -> tuple[Eye, ...]:
        """All cameras and lidars, where they are and how they look."""
        return eyes_of(self.rigs)

    @cached_property
    def _seen(self) -> State:
        return self._to(see_ground, self.plan)

    def _to(self, step: Callable[..., Any], plan: Plan) -> State:
        known = {"surface": self.surface, "rigs": self.rigs, "needs": self.needs, "keep": self.keep}
        return build_to(step, plan, **known)

    @property
    def views(self) -> Views:
        """The views of the ground, which may hide behind hills."""
        views: Views = self._seen["views"]
        return views

    @property
    def picture_views(self) -> tuple[Views, Views] | None:
        """The views of ground and of objects that say how fine pictures are; None: nothing does."""
        views: tuple[Views, Views] | None = self._seen["color_views"]
        return views

    @property
    def near(self) -> Floats | None:
        """Pixels of a meter at each sample of the grid; None without cameras."""
        near: Floats | None = self._seen["near"]
        return near

    @cached_property
    def object_views(self) -> Views:
        """The views of what stands on the ground."""
        return views_of(self.rigs)

    @property
    def unseen(self) -> float:
        """Part that a pixel counts out of view."""
        return self.plan.terrain.meshing.unseen

    def pixels(self, at: Floats) -> Floats:
        """Pixels of a meter at points on the ground, [n, 3], in the view that shows them largest.

        As the mesh's tolerance counts them; 0 without cameras.
        """
        nearest = min(_NEAREST_M, self.plan.terrain.spacing_m)
        return pixels_of_balls(self.views, at, np.zeros(len(at)), self.unseen, nearest)

    @cached_property
    def built(self) -> State:
        """All objects where they stand, as the stage has them before anything is left out.

        And the ground that is meshed, with the fines about their feet; and plans of materials.
        """
        return self._to(build_objects, self.plan)

    @cached_property
    def finest_objects(self) -> Objects:
        """All objects where they stand, at their finest levels."""
        finest = tuple(
            replace(one, lod_px=0.0) if isinstance(one, ScatterPlan) else one
            for one in self.plan.objects
        )
        plan = replace(self.plan, objects=finest, object_triangles=None)
        objects: Objects = self._to(build_objects, plan)["objects"]
        return objects
