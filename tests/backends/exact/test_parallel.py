"""Parallel rays meet what the caster's trees say, to the bit, whichever way they are cast."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from test_exact import brute_force, soups, table

from scenec.backends.contract import NO_ROW, Rays
from scenec.backends.exact import ExactCaster
from scenec.backends.exact import caster as module
from scenec.backends.stage.scene import Motion, RenderScene
from scenec.backends.testing.scenes import affine
from scenec.schemas.threads import at_most
from scenec.testing import scenes
from scenec.testing.examples import examples


def cast_apart(scene: RenderScene, origins: np.ndarray, way: np.ndarray):
    """Row, face and parameter of each ray by the trees, one by one."""
    rays = Rays(
        origins, np.ascontiguousarray(np.broadcast_to(way, origins.shape)), (1, len(origins))
    )
    return ExactCaster(scene).cast(rays, np.arange(len(origins)))


def assert_same(found, expected) -> None:
    for name, values in zip(("row", "face", "t"), expected, strict=True):
        np.testing.assert_array_equal(getattr(found, name), values, err_msg=name)


@examples(60)
@given(soups(), st.booleans())
def test_parallel_rays_agree_with_brute_force_to_the_bit(case, aligned):
    """At vertices, edges and inside of turned, mirrored, flattened and collapsed rows."""
    scene, rays = case
    targets = rays.origins + rays.directions
    way = np.eye(3)[len(targets) % 3] * -2.0 if aligned else rays.directions[7]
    # From before the targets and from behind them.
    origins = targets - np.linspace(-1.0, 2.0, len(targets))[:, None] * way
    caster = ExactCaster(scene, trees=False)
    found = caster.cast_parallel(origins, way)
    assert_same(found, brute_force(scene, table(origins, np.tile(way, (len(origins), 1)))))
    hit = caster.cast_parallel(origins, way, any_hit=True).row >= 0
    np.testing.assert_array_equal(hit, found.row >= 0)


#: Straight down, along x, near the horizon and far from any axis.
WAYS = [(0.0, 0.0, -1.0), (1.0, 0.0, 0.0), (-0.9, 0.3, 0.02), (0.3, -0.4, 0.5), (0.5, 0.5, -0.5)]


@pytest.fixture(scope="module")
def rocks() -> RenderScene:
    return scenes.rocky(400, 60, 12.0, subdivisions=2)


@pytest.mark.parametrize("way", WAYS)
def test_a_grids_rays_meet_what_the_trees_say(way, rocks):
    """Among them those through vertices of the ground, and along its borders."""
    way = np.array(way)
    x, y = np.meshgrid(np.arange(-6.5, 6.501, 0.1), np.arange(-6.5, 6.501, 0.1))
    places = np.column_stack([x.ravel(), y.ravel(), 0.2 * np.sin(x * y).ravel()])
    origins = places - (20.0 if way[2] < 0.0 else 0.0) * way
    expected = cast_apart(rocks, origins, way)
    assert 0.1 < (expected[0] >= 0).mean() < 1.0
    caster = ExactCaster(rocks, trees=False)
    assert_same(caster.cast_parallel(origins, way), expected)
    shadow = caster.cast_parallel(origins, way, any_hit=True)
    np.testing.assert_array_equal(shadow.row >= 0, expected[0] >= 0)
    with at_most(1):
        assert_same(caster.cast_parallel(origins[::-1], way), [of[::-1] for of in expected])


@pytest.mark.parametrize("nanoseconds", [0.0, 1e9])
def test_trees_are_built_where_they_cost_less_and_answer_the_same(nanoseconds, rocks, monkeypatch):
    monkeypatch.setattr(module, "_TRIANGLE", nanoseconds)
    origins = np.column_stack([*np.random.default_rng(3).uniform(-5, 5, (2, 200)), np.full(200, 9)])
    caster = ExactCaster(rocks, trees=False)
    assert caster.geometry.row_tree < 0
    assert_same(
        caster.cast_parallel(origins, np.array([0.1, 0.0, -1.0])),
        cast_apart(rocks, origins, np.array([0.1, 0.0, -1.0])),
    )
    assert (caster.geometry.row_tree >= 0) == (nanoseconds > 0.0)


def test_rows_that_are_left_out_are_not_there(rocks):
    origins = np.column_stack([*np.random.default_rng(4).uniform(-5, 5, (2, 900)), np.full(900, 9)])
    down = np.array([0.0, 0.0, -1.0])
    ground = rocks.rows.instance_id == 0
    found = ExactCaster(rocks, trees=False).cast_parallel(origins, down, rows=ground)
    assert not found.row.any()
    every = ExactCaster(rocks, trees=False).cast_parallel(origins, down)
    np.testing.assert_array_equal(every.t[every.row == 0], found.t[every.row == 0])
    assert (every.t[every.row > 0] < found.t[every.row > 0]).all()


def test_rows_that_move_are_met_where_they_are():
    tile = scenes.grid(np.zeros((3, 3)), 1.0)
    made = scenes.scene([tile], [(0, affine()), (0, affine(offset=(0.0, 0.0, 2.0)))])
    path = np.stack([made.rows.to_world[1:], made.rows.to_world[1:]])
    path[1, 0, 0, 3] = 50.0
    made = replace(
        made, samples=2, rows=replace(made.rows, motion=Motion(np.array([1], np.int32), path))
    )
    caster = ExactCaster(made, trees=False)
    origins, down = np.array([[0.1, 0.2, 9.0], [50.1, 0.2, 9.0]]), np.array([0.0, 0.0, -1.0])
    for sample, expected in ((0, [1, NO_ROW]), (1, [0, 1]), (0, [1, NO_ROW])):
        caster.pose(sample)
        assert caster.cast_parallel(origins, down).row.tolist() == expected
    caster.pose(1)
    caster.grow()
    assert caster.cast(table(origins, [down, down]))[0].tolist() == [0, 1]


@pytest.mark.parametrize("count", [0, 1])
def test_few_rays_and_scenes_without_anything_have_answers(count):
    origins, down = np.zeros((count, 3)), np.array([0.0, 0.0, -1.0])
    plate = scenes.grid(np.full((2, 2), -1.0), 1.0)
    for made in (scenes.scene([], []), scenes.scene([plate], [(0, affine())])):
        found = ExactCaster(made, trees=False).cast_parallel(origins, down)
        assert len(found.t) == count
        assert (found.row >= 0).tolist() == [bool(made.meshes)] * count
