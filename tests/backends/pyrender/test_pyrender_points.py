"""Points stand for samples that look alike: none is lost, none counts twice."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from scenec.backends.pyrender.points import find_points, resolve

FIRSTS = np.zeros(3, np.int64)
LEVEL = np.array([0.0, 0.0, 1.0], np.float32)


def leaning(degrees: float) -> np.ndarray:
    return np.array([np.sin(np.radians(degrees)), 0.0, np.cos(np.radians(degrees))], np.float32)


def ids_of(slots: np.ndarray, faces: np.ndarray | int = 0) -> np.ndarray:
    return np.stack(np.broadcast_arrays(slots, faces), axis=-1).astype(np.uint32)


@given(st.integers(1, 4), st.integers(1, 5), st.integers(1, 5), st.integers(0, 2**32 - 1))
def test_each_sample_counts_once(side, height, width, seed):
    rng = np.random.default_rng(seed)
    shape = height * side, width * side
    ids = ids_of(rng.integers(0, 4, shape), rng.integers(0, 6, shape))
    normals = rng.normal(size=(6, 3)).astype(np.float32)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    points = find_points(ids, side, normals, FIRSTS)
    # Light that is a function of the row alone has the same mean as sample by sample.
    light = np.zeros((len(points.packed), 4), np.float32)
    light[:, :3] = points.packed[:, :1]
    found = resolve(points, light).reshape(height, width, 4)
    blocks = ids[..., 0].reshape(height, side, width, side)
    assert found[..., 0] == pytest.approx(blocks.mean(axis=(1, 3)), rel=1e-6)
    assert found[..., 3] == pytest.approx((blocks > 0).mean(axis=(1, 3)), rel=1e-6)
    masks = points.packed[:, 3] & 0xFFFF
    samples = sum((masks >> bit) & 1 for bit in range(16))
    assert samples.sum() == (ids[..., 0] > 0).sum()


def test_a_pixel_of_one_plane_is_shaded_twice_at_the_middles_of_its_halves():
    points = find_points(ids_of(np.ones((4, 4))), 4, LEVEL[None], FIRSTS)
    assert points.pixel.tolist() == [0, 2]
    upper, lower = points.packed[:2, 3].tolist()
    assert (upper & 0xFFFF, lower & 0xFFFF) == (0x00FF, 0xFF00)
    assert [(word >> 16 & 255, word >> 24) for word in (upper, lower)] == [(128, 64), (128, 192)]


@pytest.mark.parametrize(("degrees", "number"), [(25.0, 2), (35.0, 4)])
def test_faces_of_a_row_are_shaded_apart_where_they_lean_by_more_than_thirty_degrees(
    degrees, number
):
    faces = np.tile([0, 0, 1, 1], (4, 1))
    normals = np.stack([LEVEL, leaning(degrees)])
    points = find_points(ids_of(np.ones((4, 4)), faces), 4, normals, FIRSTS)
    assert points.pixel.tolist() == [0, number]


def test_rows_are_shaded_apart_and_nothing_is_not_shaded():
    slots = np.tile([0, 1, 2, 2], (4, 1))
    points = find_points(ids_of(slots), 4, LEVEL[None], FIRSTS)
    assert points.weight[: points.pixel[-1]].tolist() == [0.125, 0.25, 0.125, 0.25]
    assert not points.packed[points.pixel[-1] :].any()
