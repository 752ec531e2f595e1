"""Normals at corners: over creases nothing is smoothed, and vertices are split where it shows."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from scenec.compiler.geometry.boxes import boxes_of
from scenec.compiler.geometry.icosphere import icosphere
from scenec.compiler.geometry.normals import face_normals, vertex_normals
from scenec.compiler.objects import corners as corners_
from scenec.compiler.objects.corners import corner_normals, split
from scenec.testing.examples import examples

CUBE = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], np.float64)
QUADS = [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]]
FACES = np.array([t for a, b, c, d in QUADS for t in ((a, b, c), (a, c, d))], np.int32)


def unit(values):
    return values / np.linalg.norm(values, axis=-1, keepdims=True)


def test_a_cube_has_flat_sides_and_24_vertices():
    corners = corner_normals(CUBE, FACES, 40.0)
    flat = np.cross(CUBE[FACES[:, 1]] - CUBE[FACES[:, 0]], CUBE[FACES[:, 2]] - CUBE[FACES[:, 0]])
    assert np.allclose(corners, unit(flat)[:, None, :], atol=1e-15)
    assert (np.einsum("fk,fk->f", flat, CUBE[FACES].mean(axis=1)) > 0).all()
    copies, faces, normals = split(FACES, corners.astype(np.float32))
    assert len(copies) == 24
    assert np.array_equal(copies[faces], FACES)
    assert np.array_equal(normals[faces], corners.astype(np.float32))


def test_a_smooth_crease_angle_gives_the_vertex_normals_of_all_faces():
    points, faces = icosphere(2)
    corners = corner_normals(points, faces, 180.0)
    assert np.allclose(corners, vertex_normals(points, faces)[faces], atol=1e-14)
    copies, _, _ = split(faces, corners.astype(np.float32))
    assert len(copies) == len(points)


@pytest.mark.parametrize(("angle", "vertices"), [(29.0, 6), (31.0, 8)])
def test_a_fold_is_a_crease_from_its_own_angle_on(angle, vertices):
    bend = np.radians(angle)
    points = np.array(
        [[-1, 0, 0], [-1, 1, 0], [0, 0, 0], [0, 1, 0],
         [np.cos(bend), 0, np.sin(bend)], [np.cos(bend), 1, np.sin(bend)]]
    )  # fmt: skip
    faces = np.array([[0, 2, 3], [0, 3, 1], [2, 4, 5], [2, 5, 3]], np.int32)
    copies, _, _ = split(faces, corner_normals(points, faces, 30.0).astype(np.float32))
    assert len(copies) == vertices


def test_a_sheet_with_two_sides_keeps_a_normal_on_each():
    points = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], np.float64)
    faces = np.array([[0, 1, 2], [0, 2, 1]], np.int32)
    corners = corner_normals(points, faces, 180.0)
    assert np.array_equal(corners[0], np.tile([0.0, 0.0, 1.0], (3, 1)))
    assert np.array_equal(corners[1], np.tile([0.0, 0.0, -1.0], (3, 1)))


@examples(60)
@given(
    seed=st.integers(0, 2**32 - 1), crease=st.floats(0, 180), scale=st.sampled_from([1e-6, 1, 1e6])
)
def test_normals_of_any_soup_are_unit_and_never_against_their_face(seed, crease, scale):
    rng = np.random.default_rng(seed)
    points = scale * rng.normal(size=(12, 3))
    faces = np.array([rng.choice(12, 3, replace=False) for _ in range(20)], np.int32)
    corners = corner_normals(points, faces, crease)
    assert np.allclose(np.linalg.norm(corners, axis=2), 1.0, atol=1e-12)
    if crease < 90.0:
        own = unit(face_normals(points, faces))
        assert (np.einsum("fk,fck->fc", own, corners) > 0.0).all()
    copies, made, normals = split(faces, corners.astype(np.float32))
    assert np.array_equal(copies[made], faces)
    assert np.array_equal(normals[made], corners.astype(np.float32))


@pytest.mark.parametrize("vertices", [1, 30, 3000])
def test_corners_are_sorted_as_numpy_sorts_them(vertices, monkeypatch):
    drawn = np.random.default_rng(vertices)
    faces = drawn.integers(0, vertices, (80 if vertices == 1 else vertices, 3)).astype(np.int32)
    # Few values, zeros of both signs among them: many corners share a normal or a part of it.
    normals = drawn.choice(np.array([-1.0, -0.0, 0.0, 0.5], np.float32), (len(faces), 3, 3))
    own = split(faces, normals)
    monkeypatch.setattr(corners_, "_FAN", 0)
    for one, other in zip(own, split(faces, normals), strict=True):
        assert one.tobytes() == other.tobytes()


def test_boxes_are_those_of_each_part_and_infinite_without_points():
    drawn = np.random.default_rng(5)
    points, part = drawn.normal(size=(500, 3)), drawn.integers(0, 9, 500)
    low, high = boxes_of(points, part, 10)
    for k in range(9):
        assert np.array_equal(low[k], points[part == k].min(axis=0))
        assert np.array_equal(high[k], points[part == k].max(axis=0))
    assert (low[9] == np.inf).all()
    assert (high[9] == -np.inf).all()
