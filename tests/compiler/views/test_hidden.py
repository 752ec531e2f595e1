"""What hides behind hills: never too much."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from test_adaptive import one_rig

from scenec.compiler.terrain.grid import Grid, HeightField
from scenec.compiler.terrain.operators.multifractal import Multifractal
from scenec.compiler.views.frustum import Views
from scenec.compiler.views.occlusion import with_hidden_ground
from scenec.compiler.views.resolution import pixels_per_meter, views_of
from scenec.testing.examples import examples


def all_round(*eyes: np.ndarray) -> Views:
    """Views of eyes that look everywhere."""
    n = len(eyes)
    everywhere = np.repeat([[-1.0, 0.0, np.inf]], n, axis=0)
    return Views(np.array(eyes), np.zeros((n, 5, 3)), np.zeros((n, 3)), everywhere, np.ones(n),
                 np.ones(n, np.uint8), np.zeros((n, 0, 0), np.float32), np.zeros(4))  # fmt: skip


def hidden_from(field: HeightField, eye: np.ndarray, margin_m: float = 0.0) -> np.ndarray:
    """Whether each sample's block is hidden, [ny, nx]."""
    views = with_hidden_ground(all_round(eye), field, margin_m)
    hidden, blocks = views.ceiling == np.inf, views.blocks
    i = np.floor((field.grid.x() - blocks[0]) / blocks[2]).astype(int)
    j = np.floor((field.grid.y() - blocks[1]) / blocks[3]).astype(int)
    last = hidden.shape[1] - 1, hidden.shape[2] - 1
    return hidden[0][np.clip(j, 0, last[0])[:, None], np.clip(i, 0, last[1])[None, :]]


def visible(field: HeightField, eye: np.ndarray, j: int, i: int) -> bool:
    """Whether the straight line from an eye to a sample stays above the surface."""
    end = np.array([field.grid.x()[i], field.grid.y()[j], field.height[j, i]])
    t = np.linspace(0.0, 1.0, 600)[1:-1, None]
    line = eye + t * (end - eye)
    below = field.height_at(line[:, 0].copy(), line[:, 1].copy())
    return bool((line[:, 2] > below - 1e-9).all())


@examples(12)
@given(st.integers(0, 1000), st.floats(-18.0, 18.0), st.floats(-18.0, 18.0), st.floats(0.1, 6.0))
def test_nothing_that_can_be_seen_counts_as_hidden(key, x, y, height):
    grid = Grid((40.0, 40.0), (161, 161))
    relief = Multifractal(key=key, amplitude_m=4.0, scale_m=14.0, octaves=5, variant="fbm")
    field = HeightField(grid, relief.apply(grid, np.zeros(grid.shape))[0])
    ground = field.height_at(np.array([x]), np.array([y]))[0]
    eye = np.array([x, y, ground + height])
    hidden = hidden_from(field, eye)
    behind = np.argwhere(hidden)
    rng = np.random.default_rng(key)
    for j, i in behind[rng.permutation(len(behind))[:150]]:
        assert not visible(field, eye, j, i)


def wall(height: float) -> HeightField:
    grid = Grid((40.0, 40.0), (161, 161))
    ridge = np.where(np.abs(grid.y()) < 4.0, height, 0.0)
    return HeightField(grid, np.repeat(ridge[:, None], 161, axis=1))


def test_a_wall_hides_what_lies_behind_it():
    field = wall(5.0)
    eye = np.array([0.0, -15.0, 1.5])
    hidden = hidden_from(field, eye)
    behind = field.grid.y() > 9.0
    assert hidden[behind].all()
    # The near side and the crest's near edge are in view.
    assert not hidden[field.grid.y() < -4.0].any()
    # From high above one sees all.
    assert not hidden_from(field, np.array([0.0, -15.0, 60.0])).any()
    # A margin that may raise the ground behind it, or lower the wall, hides nothing.
    assert not hidden_from(field, eye, 3.0).any()


def test_blocks_of_a_long_strip_are_few_and_hide_what_is_hidden():
    # Rays to blocks of 2 × 2 cells would take 800 million steps.
    grid = Grid((60.0, 40_000.0), (40_001, 61))
    ridge = np.where(np.abs(grid.y()) < 40.0, 50.0, 0.0)
    field = HeightField(grid, np.repeat(ridge[:, None], 61, axis=1))
    eye = np.array([0.0, -5_000.0, 1.5])
    rows = with_hidden_ground(all_round(eye), field, 0.0).ceiling.shape[1]
    assert 2_000 < rows <= 8_000
    hidden = hidden_from(field, eye)
    # Beside the border there is no ground that hides.
    assert hidden[grid.y() > 200.0, 16:-16].all()
    assert not hidden[grid.y() < -40.0].any()


def test_blocks_may_be_long_and_narrow():
    # 2 mm in x for 20 km in y: steps of 2 mm would take hours.
    grid = Grid((2.0, 40_000.0), (3, 2_001))
    hidden = hidden_from(HeightField(grid, np.zeros(grid.shape)), np.array([0.0, -5_000.0, 1.5]))
    assert not hidden.any()


def test_hidden_ground_counts_as_out_of_view():
    field = wall(5.0)
    rig = one_rig(field, (0.0, -15.0), (0.0, 0.0), 1.5)
    plain = pixels_per_meter(field, views_of((rig,)), 0.125)
    told = pixels_per_meter(field, views_of((rig,), field), 0.125)
    seen = plain / told
    # In the view and behind the wall: an eighth.
    i = 80
    assert seen[150, i] == 8.0
    assert seen[40, i] == 1.0
