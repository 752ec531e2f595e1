"""What a mesh's report states of its error, against points that know nothing of how it was made."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from examples import examples
from hypothesis import example, given
from hypothesis import strategies as st
from numpy.typing import NDArray
from test_adaptive import one_rig

from scenec.compiler.mesh.bend import bends, of_faces
from scenec.compiler.mesh.cut import CutMesh
from scenec.compiler.mesh.merge import Merge
from scenec.compiler.mesh.mesh import Appearance, Meshing, adaptive_mesh
from scenec.compiler.mesh.surface import Surface
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


def ground(kind: str, size_m: float, detail_m: float, variant: str, seed: int) -> Surface:
    """Relief of a kind with octaves finer than its grid, and with pits in one of two materials."""
    rng = np.random.default_rng(seed)
    grid = Grid((12.0, 10.0), (int(rng.integers(12, 60)), int(rng.integers(12, 60))))
    field = HeightField(grid, heights(kind, grid, size_m, rng).reshape(grid.shape))
    rough = Multifractal(
        key=seed,
        amplitude_m=detail_m,
        scale_m=3.0,
        octaves=8,
        lacunarity=2.1,
        gain=0.5,
        variant=variant,
        offset=0.7,
    ).detail(grid)
    pits = Worley(9, -0.3 * detail_m, rng.uniform(0.04, 0.5), "f1", 1.0, 1, 2.0, 0.5)
    return Surface(
        field,
        (Merge(5, 2.0, 3, 0.5, 2.0, 0.0, 8.0, 0.5),),
        () if rough is None else (rough,),
        (None, pits.everywhere()),
    )


def meshed(surface: Surface, meshing: Meshing, seed: int) -> tuple[CutMesh, Views, dict[str, Any]]:
    rng = np.random.default_rng(seed)
    eye, target = rng.uniform(-5.0, 5.0, (2, 2))
    rig = one_rig(surface.field, tuple(eye), tuple(target), rng.uniform(0.5, 3.0))
    views = views_of((rig,))
    near = pixels_per_meter(surface.field, views, meshing.unseen)
    samples = Samples.of(surface.field.grid)
    sides = [one.side_on(samples) for one in surface.merges]
    look = Appearance(np.reshape(sides, (len(sides), *near.shape)), np.zeros(near.shape))
    mesh, _, report = adaptive_mesh(surface, look, near, views, meshing)
    return mesh, views, report["finer"]


def worst_px(
    surface: Surface, mesh: CutMesh, views: Views, points: int, unseen: float = UNSEEN
) -> float:
    """The largest error in pixels at points drawn at random over the faces."""
    rng = np.random.default_rng(3)
    worst = 0.0
    a, b, c = (mesh.points[mesh.faces[:, k]] for k in range(3))
    for _ in range(max(1, points // len(mesh.faces))):
        u, v = rng.random((2, len(mesh.faces), 1))
        u, v = np.where(u + v > 1.0, 1.0 - u, u), np.where(u + v > 1.0, 1.0 - v, v)
        at = a + u * (b - a) + v * (c - a)
        off = np.abs(surface.height_at(at[:, 0].copy(), at[:, 1].copy()) - at[:, 2])
        pixels = off * pixels_of_balls(views, at, np.zeros(len(at)), unseen, 0.05)
        worst = max(worst, float(pixels.max()))
    return worst


KINDS = ["plane", "cliffs", "samples", "spikes", "terraces", "craters"]
VARIANTS = ["fbm", "hetero", "hybrid", "ridged", "billow"]


@examples(12)
# Faces beside cliffs, which a bound from their own samples alone was too small for.
@example("terraces", 0.09088623893895894, 0.01269683808628292, "ridged", 0.5, 1.0, 128397116)
@example("terraces", 0.3163028327538451, 0.0017155785405907826, "fbm", 0.05, 0.02, 1419324547)
@given(
    st.sampled_from(KINDS),
    st.floats(0.02, 10.0),
    st.floats(1e-3, 2.0),
    st.sampled_from(VARIANTS),
    st.sampled_from([0.05, 0.2, 0.5, 2.0, 8.0]),
    st.sampled_from([None, 0.02, 0.1, 1.0]),
    st.integers(0, 2**31),
)
def test_no_point_errs_more_than_the_bound(
    kind, size_m, detail_m, variant, tolerance_px, finest_m, seed
):
    surface = ground(kind, size_m, detail_m, variant, seed)
    meshing = Meshing(tolerance_px, 10_000, UNSEEN, finest_m)
    mesh, views, finer = meshed(surface, meshing, seed)
    stated = seed in (128397116, 1419324547)
    worst = worst_px(surface, mesh, views, 400_000 if stated else 40_000)
    assert worst <= finer["surface_error_bound_px"] * (1.0 + 1e-9) + 1e-9
    assert finer["surface_error_found_px"] <= finer["surface_error_bound_px"]
    assert np.isfinite(finer["surface_error_bound_px"])


def off_bilinear(field: HeightField, parts: int) -> NDArray[np.float64]:
    """How far the smooth surface gets from the bilinear one in each cell, at points all over it."""
    (ny, nx), (x0, y0, dx, dy), h = field.grid.shape, field.frame(), field.height
    j, i = np.mgrid[: ny - 1, : nx - 1]
    worst = np.zeros(j.shape)
    for u in np.linspace(0.0, 1.0, parts):
        for v in np.linspace(0.0, 1.0, parts):
            x, y = (x0 + dx * (i + u)).ravel(), (y0 + dy * (j + v)).ravel()
            low = (1.0 - u) * h[:-1, :-1] + u * h[:-1, 1:]
            high = (1.0 - u) * h[1:, :-1] + u * h[1:, 1:]
            off = Surface(field).height_at(x, y).reshape(j.shape) - (1.0 - v) * low - v * high
            worst = np.maximum(worst, np.abs(off))
    return worst


@examples(20)
@given(st.sampled_from(KINDS), st.integers(2, 12), st.integers(2, 12), st.integers(0, 2**31))
def test_no_point_of_a_cell_bends_farther_than_is_stated(kind, ny, nx, seed):
    grid = Grid((12.0, 10.0), (ny, nx))
    rng = np.random.default_rng(seed)
    # Heavy tails: cliffs beside flats, which limit slopes.
    some = heights(kind, grid, 1.0, rng) + 0.1 * rng.standard_cauchy(ny * nx)
    field = HeightField(grid, some.reshape(ny, nx))
    found, stated = off_bilinear(field, 17), bends(field)
    assert (found <= stated + 1e-12 * np.abs(some).max()).all()


def test_a_row_of_samples_bends_as_far_as_is_stated():
    grid = Grid((12.0, 10.0), (5, 40))
    x, _ = grid.points()
    field = HeightField(grid, np.sin(3.0 * x).reshape(grid.shape))
    np.testing.assert_allclose(bends(field), off_bilinear(field, 81), rtol=0.05, atol=1e-3)


def test_a_cliff_beside_a_face_bends_it_though_its_samples_are_level():
    grid = Grid((4.0, 4.0), (5, 5))
    height = np.zeros(grid.shape)
    height[:, 4] = 1.0
    field = HeightField(grid, height)
    x, y = grid.points()
    points = np.stack([x, y, height.ravel()], axis=1)
    # Samples 0..2 in x; the second ends at the cliff's foot, the third holds it.
    faces = np.array([[0, 2, 12], [1, 3, 13], [2, 4, 14]], np.int32)
    missed = of_faces(field, points, faces)
    assert (missed.cell == -1).all()
    assert missed.samples[0] == missed.samples[1] == 0.0
    assert missed.bend[0] == 0.0
    assert missed.samples[2] > 0.4


@pytest.mark.parametrize("kind", KINDS)
def test_the_bound_is_no_more_than_three_times_what_is_found(kind):
    """In scenes as they are: detail of some centimeters, half a pixel, a budget that suffices."""
    surface = ground(kind, 0.5, 0.05, "fbm", 11)
    mesh, views, finer = meshed(surface, Meshing(0.5, 10**6, UNSEEN), 4)
    worst = worst_px(surface, mesh, views, 300_000)
    found, bound = finer["surface_error_found_px"], finer["surface_error_bound_px"]
    assert worst <= bound <= 3.0 * max(worst, found)
    # The search finds about the worst there is.
    assert found > 0.7 * worst


def test_a_plane_without_detail_has_no_error_and_no_bound_of_one():
    grid = Grid((12.0, 10.0), (41, 49))
    surface = Surface(HeightField(grid, heights("plane", grid, 1.0, np.random.default_rng(0))
                                  .reshape(grid.shape)))  # fmt: skip
    _, _, finer = meshed(surface, Meshing(0.5, 10**6, UNSEEN), 4)
    assert finer["surface_error_bound_px"] < 1e-9


def test_the_search_finds_pits_between_the_edges_that_even_points_miss():
    """Pits finer than triangles: those that no edge's middle hits shape no triangle."""
    grid = Grid((24.0, 20.0), (101, 121))
    pits = Worley(9, -0.012, 0.05, "f1", 1.0, 1, 2.0, 0.5).everywhere()
    surface = Surface(HeightField(grid, np.zeros(grid.shape)), (), (pits,))
    mesh, views, finer = meshed(surface, Meshing(1.0, 10**6, UNSEEN), 4)
    dense = worst_px(surface, mesh, views, 1_000_000)
    assert finer["searched_points"] > 0
    assert 0.7 * dense <= finer["surface_error_found_px"]
    assert dense <= finer["surface_error_bound_px"] <= 2.5 * dense


def test_what_is_stated_does_not_depend_on_the_run():
    surface = ground("craters", 1.0, 0.1, "hetero", 8)
    assert (
        meshed(surface, Meshing(0.5, 50_000, UNSEEN), 2)[2]
        == (meshed(surface, Meshing(0.5, 50_000, UNSEEN), 2)[2])
    )
