"""Newest-vertex bisection: whole, without slivers, and only where it must."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from scenec.compiler.geometry.bisect import Bisection, bisection
from scenec.testing.examples import examples


def square(cells: int) -> tuple[np.ndarray, np.ndarray]:
    """A grid of the unit square, all diagonals alike: not what bisection would make itself."""
    at = np.linspace(0.0, 1.0, cells + 1)
    y, x = np.meshgrid(at, at, indexing="ij")
    points = np.stack([x.ravel(), y.ravel(), 0.1 * x.ravel() * y.ravel()], axis=1)
    a = (np.arange(cells)[:, None] * (cells + 1) + np.arange(cells)).ravel()
    b, c, d = a + 1, a + cells + 1, a + cells + 2
    faces = np.concatenate([np.stack([a, b, d], 1), np.stack([d, c, a], 1)]).astype(np.int32)
    return points, faces


def refined(points: np.ndarray, mesh: Bisection, wanted: np.ndarray):
    halved = mesh.halve(np.flatnonzero(wanted))
    ends = mesh.edges[halved.middle_of]
    middles = 0.5 * (points[ends[:, 0]] + points[ends[:, 1]])
    return np.concatenate([points, middles]), halved


def areas(points: np.ndarray, faces: np.ndarray) -> np.ndarray:
    a, b, c = (points[faces[:, k]] for k in range(3))
    u, v = b - a, c - a
    return 0.5 * (u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0])


def require_sound(points: np.ndarray, mesh: Bisection) -> None:
    """Edges are those of the faces, each with one or two; nothing flipped, no gap, no overlap."""
    faces = mesh.faces
    ends = np.concatenate([faces[:, [1, 2]], faces[:, [2, 0]], faces[:, [0, 1]]])
    number = np.concatenate([mesh.face_edges[:, k] for k in range(3)])
    np.testing.assert_array_equal(np.sort(ends, axis=1), mesh.edges[number])
    assert len(np.unique(mesh.edges, axis=0)) == len(mesh.edges)
    uses = np.bincount(number, minlength=len(mesh.edges))
    whole = mesh.middles < 0
    assert uses[whole].min() >= 1
    assert uses.max() <= 2
    # What was halved belongs to no face any more.
    assert uses[~whole].max(initial=0) == 0
    border = mesh.edges[uses == 1]
    on = [np.abs(points[border][:, :, k] - v) < 1e-12 for k in (0, 1) for v in (0.0, 1.0)]
    assert np.any([side.all(axis=1) for side in on], axis=0).all()
    assert areas(points, faces).min() > 0.0
    assert areas(points, faces).sum() == pytest.approx(1.0, abs=1e-12)
    # Euler's formula for a disc.
    assert mesh.vertices - whole.sum() + len(faces) == 1
    np.testing.assert_array_equal(np.sort(mesh.order), np.arange(len(faces)))


@examples(40)
@given(st.integers(1, 6), st.integers(0, 2**32 - 1), st.integers(1, 6), st.floats(0.01, 0.7))
def test_any_choice_of_faces_leaves_the_mesh_whole(cells, seed, rounds, part):
    points, faces = square(cells)
    mesh = bisection(points, faces)
    rng = np.random.default_rng(seed)
    for _ in range(rounds):
        wanted = rng.random(len(mesh.faces)) < part
        faces, edges = mesh.faces.copy(), mesh.edges.copy()
        points, halved = refined(points, mesh, wanted)
        require_sound(points, mesh)
        # What was asked for was halved, and a face that was not is as it was.
        kept = np.setdiff1d(np.arange(len(faces)), halved.parts)
        assert not wanted[kept].any()
        np.testing.assert_array_equal(mesh.faces[kept], faces[kept])
        np.testing.assert_array_equal(mesh.edges[: len(edges)], edges)


def test_parts_cover_the_face_they_come_from():
    points, faces = square(3)
    mesh = bisection(points, faces)
    rng = np.random.default_rng(3)
    for _ in range(4):
        before, order = areas(points, mesh.faces), mesh.order
        points, halved = refined(points, mesh, rng.random(len(mesh.faces)) < 0.4)
        origin = np.concatenate([np.arange(len(before)), halved.origin])
        total = np.bincount(origin, areas(points, mesh.faces), len(before))
        np.testing.assert_allclose(total, before, rtol=1e-12)
        # They stand together, where it stood.
        stands = origin[mesh.order]
        np.testing.assert_array_equal(stands[np.flatnonzero(np.diff(stands, prepend=-1))], order)


def test_right_triangles_stay_right_triangles_however_deep():
    points, faces = square(1)
    mesh = bisection(points[:, :2], faces)
    for _ in range(24):
        # Toward one point: the deepest faces lie at it.
        middle = points[mesh.faces][:, :, :2].mean(axis=1)
        nearest = np.argsort(((middle - [0.3, 0.7]) ** 2).sum(axis=1), kind="stable")[:2]
        wanted = np.zeros(len(mesh.faces), bool)
        wanted[nearest] = True
        points, _ = refined(points, mesh, wanted)
    require_sound(points, mesh)
    corners = points[mesh.faces][:, :, :2]
    lengths = np.sort(
        np.stack([((corners[:, k] - corners[:, k - 1]) ** 2).sum(1) for k in range(3)], 1), axis=1
    )
    # Legs alike, and Pythagoras.
    np.testing.assert_allclose(lengths[:, 1], lengths[:, 0], rtol=1e-6)
    np.testing.assert_allclose(lengths[:, 2], 2.0 * lengths[:, 0], rtol=1e-6)
    assert len(mesh.faces) < 40 * 24


def test_asking_for_nothing_changes_nothing():
    points, faces = square(2)
    mesh = bisection(points, faces)
    faces, edges = mesh.faces.copy(), mesh.edges.copy()
    halved = mesh.halve(np.zeros(0, np.int64))
    np.testing.assert_array_equal(mesh.faces, faces)
    np.testing.assert_array_equal(mesh.edges, edges)
    assert len(halved.middle_of) == len(halved.parts) == 0


def test_an_edge_of_three_faces_is_halved_in_all_of_them():
    faces = np.array([[2, 0, 1], [3, 1, 0], [4, 0, 1]], np.int32)
    mesh = Bisection(5, faces)
    halved = mesh.halve(np.array([0]))
    assert len(mesh.faces) == 6
    assert len(halved.middle_of) == 1
    assert (mesh.faces == 5).sum() == 6


def test_neighbors_of_equal_edges_choose_the_same_one():
    # Equilateral triangles: all edges are equally long.
    points = np.array([[0, 0, 0], [1, 0, 0], [0.5, np.sqrt(0.75), 0], [1.5, np.sqrt(0.75), 0]])
    mesh = bisection(points, np.array([[0, 1, 2], [1, 3, 2]], np.int32))
    assert set(mesh.edges[mesh.face_edges[0, 0]]) == {0, 1}
    assert set(mesh.edges[mesh.face_edges[1, 0]]) == {1, 2}
