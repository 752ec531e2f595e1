"""Footprints and crusts: volumes, shares and places, against sums made without their code."""

from __future__ import annotations

import numpy as np
import pytest
import test_adaptive
from hypothesis import given
from hypothesis import strategies as st

from scenec.compiler.build import BuildLog, build
from scenec.compiler.cfg.load import load
from scenec.compiler.distributions.streams import Streams
from scenec.compiler.draw import draw
from scenec.compiler.kinds.context import Context
from scenec.compiler.mesh.mesh import Meshing
from scenec.compiler.mesh.surface import GroundSurface
from scenec.compiler.mesh.tiles import build_tiles
from scenec.compiler.noise.worley import feature_point, worley2_cell
from scenec.compiler.terrain.condition import FromPoint, Interval
from scenec.compiler.terrain.grid import Grid, HeightField
from scenec.compiler.terrain.mask import Masked
from scenec.compiler.terrain.operators.crust import Crust
from scenec.compiler.terrain.operators.footprints import (
    DISPLACED,
    RIBS,
    Footprints,
    Walks,
)
from scenec.compiler.terrain.operators.multifractal import Multifractal
from scenec.compiler.terrain.program import run
from scenec.compiler.terrain.sources.plane import Plane
from scenec.compiler.views.resolution import pixels_per_meter, views_of
from scenec.schemas.errors import SceneError
from scenec.schemas.threads import at_most
from scenec.testing.examples import examples
from scenec.testing.small import small_cfg, write_cfg

SIZE = (30.0, 24.0)


def walked(seed: int = 1, size: tuple[float, float] = SIZE, **change) -> Footprints:
    return Walks(**change).draw(Context(Streams(seed, 0), size, path="terrain/relief/1"))


def one_print(x: float = 0.0, y: float = 0.0, turn: float = 0.0, **change) -> Footprints:
    form = {"length_m": 0.33, "depth_m": 0.025, "tread_m": 0.006, "size_m": (1.0, 1.0), **change}
    return Footprints(np.array([[x, y, np.cos(turn), np.sin(turn), 1.0]]), **form)


def sampled(detail, size: float, n: int) -> tuple[np.ndarray, float]:
    """At the middles of n by n squares of a square, and the area of one."""
    at = (np.arange(n) + 0.5) / n * size - 0.5 * size
    x, y = (np.ascontiguousarray(a).ravel() for a in np.meshgrid(at, at))
    return detail.at(x, y).reshape(n, n), (size / n) ** 2


@pytest.mark.parametrize("turn", [0.0, 0.4, 2.0])
@pytest.mark.parametrize("tread", [0.0, 0.006, 0.02])
def test_a_print_s_rim_holds_three_tenths_of_what_its_floor_displaced(turn, tread):
    height, area = sampled(one_print(turn=turn, tread_m=tread).everywhere(), 0.7, 1400)
    raised = height[height > 0.0].sum() * area
    # With ribs higher than the floor is deep some of them stand above the ground around.
    pressed = raised - height.sum() * area
    assert raised / pressed == pytest.approx(DISPLACED, abs=0.006)
    # The integral of the outline sqrt(1 - u^4) is 0.874 of its box; walls take 1 - 0.857.
    assert pressed == pytest.approx(0.857 * 0.874 * 0.33 * 0.132 * 0.025, rel=0.03)


def test_a_print_shows_fifteen_ribs_as_high_as_the_tread():
    x = np.linspace(-0.135, 0.135, 20_001)
    floor = one_print().everywhere().at(x, np.zeros(x.size))
    tops = np.flatnonzero((floor[1:-1] > floor[:-2]) & (floor[1:-1] >= floor[2:]))
    pitch = 0.33 / (RIBS + 0.5)
    assert np.diff(x[tops + 1]) == pytest.approx(pitch, rel=1e-3)
    assert np.ptp(floor) == pytest.approx(0.006, rel=1e-3)


def test_the_volume_converges_with_the_spacing():
    exact, area = sampled(one_print(0.01, 0.02, 0.5).everywhere(), 0.7, 2000)
    off = []
    for n in (200, 400, 800):
        grid = Grid((0.7, 0.7), (n + 1, n + 1))
        _, report = one_print(0.01, 0.02, 0.5).apply(grid, np.zeros(grid.shape))
        off.append(abs(report["volume_change_m3"] / (exact.sum() * area) - 1.0))
    assert off[0] < 2e-3
    assert off[2] < 1e-4


def test_a_grid_holds_all_of_a_print_or_leaves_it_to_the_detail():
    prints, ground = (
        one_print(turn=0.3),
        Multifractal(key=1, amplitude_m=0.1, scale_m=0.5, octaves=3, variant="fbm"),
    )
    fine, coarse = Grid((0.7, 0.7), (101, 101)), Grid((0.7, 0.7), (15, 15))
    height, report = prints.apply(fine, ground.apply(fine, np.zeros(fine.shape))[0])
    assert not report["below_grid"]
    assert prints.detail(fine) is None
    bare = np.zeros(coarse.shape)
    same, report = prints.apply(coarse, bare)
    assert same is bare
    assert report == {"prints": 1, "below_grid": True}
    added = prints.detail(coarse).at(*fine.points()).reshape(fine.shape)
    assert np.allclose(height, ground.apply(fine, np.zeros(fine.shape))[0] + added, atol=1e-15)


def test_feet_alternate_left_and_right_of_a_walk_at_half_strides():
    prints = walked(3).prints
    x, y = prints[:, 0], prints[:, 1]
    # The walk's middle is half way between successive prints.
    ahead = np.stack([x[2:] - x[:-2], y[2:] - y[:-2]])
    assert np.hypot(*ahead) == pytest.approx(1.3, rel=0.06)
    across = ahead[0] * (y[1:-1] - y[:-2]) - ahead[1] * (x[1:-1] - x[:-2])
    side = np.sign(across)
    assert (side[1:] == -side[:-1]).all()
    # Boots point about where the walk goes, toes out.
    points = ahead[0] * prints[1:-1, 3] - ahead[1] * prints[1:-1, 2]
    assert np.abs(points / 1.3).max() < 0.5
    assert (points * side > 0.0).mean() > 0.8


def test_a_walk_crosses_the_terrain_and_more_walks_leave_it_as_it_was():
    for seed in range(20):
        one, three = walked(seed), walked(seed, walks=3)
        assert np.array_equal(one.prints, three.prints[: len(one.prints)])
        away = np.abs(one.prints[:, :2]) / np.array(SIZE)
        # It comes by the inner half, and ends at the border.
        assert (away.max(axis=1) < 0.27).any()
        assert (away[[0, -1]].max(axis=1) > 0.45).all()


def directly(of: Footprints, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """The sum over all prints, each asked for alone."""
    out = np.zeros(x.size)
    for row in of.prints:
        alone = Footprints(row[None], of.length_m, of.depth_m, of.tread_m, of.size_m)
        out += alone.everywhere().at(x, y)
    return out


@examples(20)
@given(
    seed=st.integers(0, 1000),
    stride=st.sampled_from([0.3, 1.3, 9.0]),
    length=st.sampled_from([0.02, 0.33, 3.0]),
)
def test_bins_find_every_print(seed, stride, length):
    prints = walked(seed, stride_m=stride, length_m=length)
    if not len(prints.prints):
        return
    rng = np.random.default_rng(seed)
    near = prints.prints[rng.integers(len(prints.prints), size=300), :2]
    x, y = np.ascontiguousarray((near + rng.normal(size=near.shape) * 0.5 * length).T)
    detail, expected = prints.everywhere(), directly(prints, x, y)
    inside = (np.abs(x) <= 0.5 * SIZE[0]) & (np.abs(y) <= 0.5 * SIZE[1])
    assert np.allclose(detail.at(x, y)[inside], expected[inside], rtol=0, atol=1e-15)
    # No disk without prints has any.
    radius = rng.uniform(0.0, 3.0, x.size)
    turn, part = rng.uniform(0.0, 6.3, x.size), rng.uniform(0.0, 1.0, x.size)
    reached = detail.finer_at(x + part * radius * np.cos(turn), y + part * radius * np.sin(turn),
                              radius * (1.0 + 1e-9), np.full(x.size, np.inf)) > 0.0  # fmt: skip
    assert reached[inside & (expected != 0.0)].all()


def test_too_many_prints_are_refused():
    with pytest.raises(SceneError, match=r"footprints are expected.*raise stride_m or lower walks"):
        walked(stride_m=1e-5)


@pytest.mark.parametrize("length", [1e-6, 1e6])
@pytest.mark.parametrize("depth", [0.0, 1e6])
def test_extreme_prints_are_finite(length, depth):
    prints = walked(length_m=length, depth_m=depth, tread_m=depth)
    x = np.linspace(-15.0, 15.0, 301)
    found = prints.everywhere().at(x, 0.3 * x)
    assert np.isfinite(found).all()
    assert np.abs(found).max() <= 2.0 * depth * max(len(prints.prints), 1)


def test_the_mesh_is_refined_where_prints_are_and_nowhere_else():
    grid = Grid((24.0, 20.0), (101, 121))
    prints = walked(2, grid.size_m)
    relief = run([Plane(0.0, (0.01, 0.02)), prints], grid)
    ground = GroundSurface(relief.field, details=relief.details)
    flat = GroundSurface(HeightField(grid, relief.field.height))
    views = views_of((test_adaptive.one_rig(relief.field, (1.0, -6.0), (0.0, 0.0), 1.2),))
    sight = pixels_per_meter(relief.field, views, 0.125), views
    counts, meshing = [], Meshing(1.0, 10**7, 0.125, 0.01)
    for surface in (flat, ground):
        tiles, report = build_tiles(surface, 1, meshing, *sight)
        counts.append(sum(len(tile.faces) for tile in tiles))
    assert counts[1] > counts[0] + 3000
    x, y, _ = np.concatenate([tile.points + tile.translate for tile in tiles]).T
    between = (np.abs(x / 0.2 - np.round(x / 0.2)) > 1e-3) | (
        np.abs(y / 0.2 - np.round(y / 0.2)) > 1e-3
    )
    away = np.hypot(*(np.stack([x, y], 1)[:, None] - prints.prints[:, :2]).T).min(axis=0)
    # A bin's width, and what follows the halving of a neighbor.
    assert between.sum() > 1500
    assert away[between].max() < 1.5
    assert report["mesh"]["finer"]["surface_error_99_9_px"] < 1.2


# Crusts.

CRUST = Crust(key=5, height_m=0.02, plate_m=0.3, missing=0.25)


@pytest.mark.parametrize("missing", [0.0, 0.1, 0.5, 0.8, 1.0])
def test_the_share_of_missing_plates_is_the_one_asked_for(missing):
    rng = np.random.default_rng(3)
    x, y = rng.uniform(-500.0, 500.0, (2, 40_000))
    height = Crust(key=9, height_m=0.02, plate_m=0.3, missing=missing).everywhere().at(x, y)
    assert (height == 0.0).mean() == pytest.approx(missing, abs=0.01 + 0.01 * (1.0 - missing))


def test_plates_lie_about_as_high_as_the_crust_is_thick_between_cracks_to_the_soil():
    height, _ = sampled(
        Crust(key=5, height_m=0.02, plate_m=0.3, missing=0.0).everywhere(), 6.0, 1500
    )
    assert np.median(height) == pytest.approx(0.02, rel=0.05)
    assert height.min() == pytest.approx(0.0, abs=2e-4)
    assert height.max() <= 0.06
    # One plate in seven is loose.
    assert 0.01 < (height > 0.026).mean() < 0.1
    # Walls fall over a sixteenth of a plate: at most half as steep again as that.
    slope = np.abs(np.diff(height, axis=0)).max() / 0.004
    assert 0.02 / (0.06 * 0.3) < slope < 6.0 * 0.02 / (0.06 * 0.3)


def test_the_nearest_cell_is_the_one_whose_point_is_nearest():
    rng = np.random.default_rng(1)
    key = np.uint64(77)
    for x, y in rng.uniform(-1e3, 1e3, (200, 2)):
        first, second, i, j = worley2_cell(key, x, y, 1.0)
        cells = [(int(np.floor(x)) + a, int(np.floor(y)) + b)
                 for a in range(-3, 4) for b in range(-3, 4)]  # fmt: skip
        away = [np.hypot(*(np.array(feature_point(key, *cell, 1.0)) - (x, y))) for cell in cells]
        order = np.argsort(away)
        assert cells[order[0]] == (i, j)
        assert (first, second) == pytest.approx((away[order[0]], away[order[1]]), rel=1e-12)


def test_a_grid_with_a_sample_on_each_wall_holds_a_crust():
    fine, coarse = Grid((3.0, 3.0), (201, 201)), Grid((3.0, 3.0), (101, 101))
    height, report = CRUST.apply(fine, np.zeros(fine.shape))
    assert np.array_equal(height.ravel(), CRUST.everywhere().at(*fine.points()))
    assert 0.5 * 0.02 < report["mean_m"] < 0.02
    assert CRUST.detail(fine) is None
    assert CRUST.apply(coarse, height[::2, ::2])[0] is not None
    assert CRUST.apply(coarse, np.zeros(coarse.shape))[1] == {"below_grid": True}
    assert np.array_equal(CRUST.detail(coarse).at(*fine.points()), height.ravel())


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("plate", [5e-324, 1e-300, 1e-9, 1e-3, 1e9])
def test_crusts_of_any_plates_are_finite(plate):
    crust = Crust(key=5, height_m=1e6, plate_m=plate, missing=0.3)
    x = np.linspace(-5e5, 5e5, 1001)
    found = crust.everywhere().at(x, -0.7 * x)
    assert np.isfinite(found).all()
    assert found.min() >= 0.0
    assert found.max() <= 3e6


@pytest.mark.parametrize("detail", [CRUST.everywhere(), walked(walks=9).everywhere()])
def test_details_do_not_depend_on_the_number_of_threads(detail):
    x, y = np.random.default_rng(1).uniform(-12.0, 12.0, (2, 100_000))
    with at_most(1):
        alone = detail.at(x, y)
    assert np.array_equal(alone, detail.at(x, y))


def test_a_mask_fades_prints_and_they_stay_local():
    disk = Interval(FromPoint(x_m=0.0, y_m=0.0), None, 6.0, 1.0)
    relief = run([Plane(0.0, (0.0, 0.0)), Masked(walked(walks=5), (disk,))],
                 Grid.with_spacing(SIZE, 0.1))  # fmt: skip
    (detail,) = relief.details
    x, y = np.random.default_rng(2).uniform(-12.0, 12.0, (2, 100_000))
    found, far = detail.at(x, y), np.hypot(x, y) > 7.0
    assert np.abs(found[~far]).max() > 0.02
    assert not found[far].any()


def test_a_crust_lies_where_its_layer_does(tmp_path):
    cfg = small_cfg()
    cfg["terrain"]["relief"] = [{"type": "plane"}, {"type": "footprints", "walks": 2}]
    layer = cfg["terrain"]["ground"][1]["material"]
    cfg["materials"][layer]["displacement"] = [{"type": "crust", "plate_m": 0.5}]
    plan = draw(load(write_cfg(tmp_path, cfg)), 7, 0)
    displaced = [part is not None for part in plan.terrain.displacements]
    assert displaced == [each.material == layer for each in plan.terrain.layers]
    scene = build(plan, log := BuildLog())
    assert np.isfinite(scene.bounds).all()
    assert log.facts["relief"][1]["below_grid"]
