"""Classes of objects laid on a small terrain, for tests."""

from __future__ import annotations

import copy
import json
from collections.abc import Mapping
from functools import cache
from typing import Any

import numpy as np

from scenec.compiler.cfg.fill import fill
from scenec.compiler.distributions.streams import Streams
from scenec.compiler.kinds.context import Context, InputFile
from scenec.compiler.kinds.draw import draw_kind
from scenec.compiler.mesh.surface import GroundSurface
from scenec.compiler.objects.placement_context import PlacementContext, footprints, plan_circles
from scenec.compiler.objects.plan import ScatterPlan
from scenec.compiler.objects.rocks import build_chains
from scenec.compiler.objects.scatter import scatter
from scenec.compiler.scene.objects import Scatter
from scenec.compiler.terrain.grid import Grid, HeightField
from scenec.compiler.terrain.operators.multifractal import Multifractal
from scenec.testing.small import small_cfg

SIZE = (40.0, 32.0)
NO_CAMERAS = np.zeros((0, 3))


def surface(amplitude_m: float = 1.0) -> GroundSurface:
    """Hills of 40 m by 32 m."""
    grid = Grid.with_spacing(SIZE, 0.4)
    height = np.zeros(grid.shape)
    if amplitude_m:
        height = Multifractal(
            key=1, amplitude_m=amplitude_m, scale_m=8.0, octaves=5, variant="fbm"
        ).apply(grid, height)[0]
    return GroundSurface(HeightField(grid, height), smooth=False)


def surroundings(
    cameras: np.ndarray = NO_CAMERAS, amplitude_m: float = 1.0, **objects: Scatter
) -> PlacementContext:
    """Hills, cameras, and what lies there already."""
    around = PlacementContext(surface(amplitude_m), cameras)
    around.objects.update({name: plan_circles(laid) for name, laid in objects.items()})
    around.footprints.update({name: footprints(laid) for name, laid in objects.items()})
    return around


def plan(
    name: str = "rocks", seed: int = 1, files: Mapping[str, InputFile] | None = None, **change: Any
) -> ScatterPlan:
    """What is drawn for one class of rocks."""
    filled = copy.deepcopy(_filled(name, json.dumps(change)))
    context = Context(Streams(seed, 0), SIZE, files or {})
    drawn: ScatterPlan = draw_kind("objects", filled, f"objects/{name}", context)
    return drawn


@cache
def _filled(name: str, change: str) -> dict[str, Any]:
    cfg = small_cfg()
    thing = {
        "type": "rocks",
        "material": "stone",
        "labels": {"class": "rock", "surface": "stone"},
        "prototypes": 2,
        "subdivisions": 1,
        "size_m": 0.3,
        "lod_px": 0,
        **json.loads(change),
    }
    cfg["objects"] = {name: thing}
    filled: dict[str, Any] = fill(cfg)["objects"][name]
    return filled


def laid(around: PlacementContext, facts: dict[str, Any] | None = None, **change: Any) -> Scatter:
    """One class of rocks, laid."""
    drawn = plan(**change)
    chains = build_chains(drawn.source.shapes, coarser=False)
    return scatter(drawn, chains, around, {} if facts is None else facts)
