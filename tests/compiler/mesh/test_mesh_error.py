"""What a mesh's report states of its error, against points that know nothing of how it was made."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from test_adaptive import one_rig

from scenec.compiler.mesh.cut import CutMesh
from scenec.compiler.mesh.merge import Merge
from scenec.compiler.mesh.mesh import GroundAppearance, Meshing, adaptive_mesh
from scenec.compiler.mesh.surface import GroundSurface
from scenec.compiler.terrain.grid import Grid, HeightField
from scenec.compiler.terrain.operators.multifractal import Multifractal
from scenec.compiler.terrain.operators.worley import Worley
from scenec.compiler.terrain.quantities import Samples
from scenec.compiler.views.resolution import Views, pixels_of_balls, pixels_per_meter, views_of

UNSEEN = 0.125


def heights(kind: str, grid: Grid, size_m: float, rng: np.random.Generator) -> NDArray[np.float64]:
    """Relief of a kind, at a grid's samples."""
    x, y = grid.points()
    if kind == "plane":
        return 0.3 * size_m * x - 0.1 * size_m * y
    if kind == "cliffs":
        return np.where(np.sin(0.7 * x + rng.uniform(0.0, 6.0)) + 0.3 * y > 0.0, size_m, 0.0)
    if kind == "samples":
        return 0.2 * size_m * rng.normal(size=x.size)
    if kind == "spikes":
        out = np.zeros(x.size)
        out[rng.integers(0, x.size, 5)] = size_m
        return out
    if kind == "terraces":
        return np.floor(4.0 * np.sin(x) * np.cos(y)) * 0.5 * size_m
    out = np.zeros(x.size)
    for u, v, radius in rng.uniform([-6.0, -5.0, 0.2], [6.0, 5.0, 2.0], (12, 3)):
        q = np.hypot(x - u, y - v) / radius
        out += 0.4 * size_m * radius * np.where(q < 1.0, q * q - 1.0, np.maximum(0.4 - 0.4 * q, 0))
    return out


def ground(kind: str, size_m: float, detail_m: float, variant: str, seed: int) -> GroundSurface:
    """Relief of a kind with octaves finer than its grid, and with pits in one of two materials."""
    rng = np.random.default_rng(seed)
    grid = Grid((12.0, 10.0), (int(rng.integers(12, 60)), int(rng.integers(12, 60))))
    field = HeightField(grid, heights(kind, grid, size_m, rng).reshape(grid.shape))
    rough = Multifractal(
        key=seed, amplitude_m=detail_m, scale_m=3.0, lacunarity=2.1, variant=variant
    ).detail(grid)
    pits = Worley(key=9, amplitude_m=-0.3 * detail_m, scale_m=rng.uniform(0.04, 0.5))
    return GroundSurface(
        field,
        (Merge(5, 2.0, 3, 0.5, 2.0, 0.0, 8.0, 0.5),),
        () if rough is None else (rough,),
        (None, pits.everywhere()),
    )


def meshed(
    surface: GroundSurface, meshing: Meshing, seed: int
) -> tuple[CutMesh, Views, dict[str, Any]]:
    rng = np.random.default_rng(seed)
    eye, target = rng.uniform(-5.0, 5.0, (2, 2))
    rig = one_rig(surface.field, tuple(eye), tuple(target), rng.uniform(0.5, 3.0))
    views = views_of((rig,))
    near = pixels_per_meter(surface.field, views, meshing.unseen)
    samples = Samples.of(surface.field.grid)
    sides = [one.side_on(samples) for one in surface.merges]
    look = GroundAppearance(np.reshape(sides, (len(sides), *near.shape)), np.zeros(near.shape))
    mesh, _, report = adaptive_mesh(surface, look, near, views, meshing)
    return mesh, views, report["finer"]


def errors_px(
    surface: GroundSurface, mesh: CutMesh, views: Views, points: int
) -> NDArray[np.float64]:
    """Errors in pixels at points drawn at random over the faces, as many in each."""
    rng = np.random.default_rng(3)
    found = []
    a, b, c = (mesh.points[mesh.faces[:, k]] for k in range(3))
    for _ in range(max(1, points // len(mesh.faces))):
        u, v = rng.random((2, len(mesh.faces), 1))
        u, v = np.where(u + v > 1.0, 1.0 - u, u), np.where(u + v > 1.0, 1.0 - v, v)
        at = a + u * (b - a) + v * (c - a)
        off = np.abs(surface.height_at(at[:, 0].copy(), at[:, 1].copy()) - at[:, 2])
        found.append(off * pixels_of_balls(views, at, np.zeros(len(at)), UNSEEN, 0.05))
    return np.concatenate(found)


KINDS = ["plane", "cliffs", "samples", "spikes", "terraces", "craters"]


@pytest.mark.parametrize("kind", KINDS)
def test_what_is_stated_of_some_points_holds_for_many(kind):
    surface = ground(kind, 0.5, 0.05, "fbm", 11)
    mesh, views, finer = meshed(surface, Meshing(0.5, 10**6, UNSEEN), 4)
    error = errors_px(surface, mesh, views, 500_000)
    assert finer["checked_points"] == len(mesh.faces)
    rms = np.sqrt((error * error).mean())
    assert finer["surface_error_rms_px"] == pytest.approx(rms, rel=0.02)
    low, high = np.quantile(error, [0.998, 0.9995])
    assert low < finer["surface_error_99_9_px"] < high
    # The largest of fewer points is one that many points exceed, yet not by far.
    assert 0.6 * error.max() < finer["surface_error_found_px"] <= error.max()


def test_a_plane_without_detail_has_no_error():
    grid = Grid((12.0, 10.0), (41, 49))
    surface = GroundSurface(HeightField(grid, heights("plane", grid, 1.0, np.random.default_rng(0))
                                  .reshape(grid.shape)))  # fmt: skip
    _, _, finer = meshed(surface, Meshing(0.5, 10**6, UNSEEN), 4)
    assert finer["surface_error_found_px"] < 1e-9


def test_what_is_stated_does_not_depend_on_the_run():
    surface = ground("craters", 1.0, 0.1, "hetero", 8)
    assert (
        meshed(surface, Meshing(0.5, 50_000, UNSEEN), 2)[2]
        == (meshed(surface, Meshing(0.5, 50_000, UNSEEN), 2)[2])
    )
