"""Refined subdivision surfaces are those of closed forms, and of OpenSubdiv (in Blender)."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial import cKDTree

from scenec.schemas.subdivision import ERROR, Cage, FaceVarying, crease_edges, hanging, refine

CUBE = (
    np.array([[x, y, z] for z in (-1, 1) for y in (-1, 1) for x in (-1, 1)], float),
    np.full(6, 4),
    np.array([0, 2, 3, 1, 4, 5, 7, 6, 0, 1, 5, 4, 2, 6, 7, 3, 0, 4, 6, 2, 1, 3, 7, 5]),
)
OCTAHEDRON = (
    np.array([[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]], float),
    np.full(8, 3),
    np.array([0, 2, 4, 2, 1, 4, 1, 3, 4, 3, 0, 4, 2, 0, 5, 1, 2, 5, 3, 1, 5, 0, 3, 5]),
)
RIM = crease_edges(np.array([0, 1, 3, 2, 0]), np.array([5]), np.array([10.0]))


def sheet(n: int, height=lambda x, y: 0.0 * x) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    x, y = (a.ravel().astype(float) for a in np.meshgrid(np.arange(n + 1), np.arange(n + 1)))
    q = (np.arange(n)[:, None] * (n + 1) + np.arange(n)).ravel()
    corners = np.stack([q, q + 1, q + n + 2, q + n + 1], axis=1).ravel()
    return np.stack([x, y, height(x, y)], axis=1), np.full(n * n, 4), corners


def test_a_cubes_corners_go_to_the_limit_of_three_edges_and_three_faces():
    # Once split, x of the corner (1, 1, 1), of its edges (0, 3/4, 3/4), …, and faces (1, 0, 0), …;
    # then (n^2 v + 4 e + f) / n (n + 5).
    vertex, edges, faces = 1.0 / 3.0 + 1.0 / 9.0 + 1.0 / 9.0, 0.75 + 0.75, 1.0
    expected = (9.0 * vertex + 4.0 * edges + faces) / 24.0
    found = refine(Cage(*CUBE)).values[:8]
    assert np.allclose(found, expected * CUBE[0], rtol=0, atol=1e-14)


def test_an_octahedrons_points_go_to_loops_limit_of_valence_four():
    beta = (0.625 - (0.375 + 0.25 * np.cos(np.pi / 2)) ** 2) / 4.0
    share = 1.0 / (0.375 / beta + 4.0)
    # The four neighbors of each point add up to 0, at each level.
    found = refine(Cage(*OCTAHEDRON, scheme="loop")).values[:6]
    assert np.allclose(found, (1.0 - 4.0 * share) * OCTAHEDRON[0], rtol=0, atol=1e-12)


def test_a_regular_sheet_is_a_bicubic_b_spline():
    """Of x^2 at integers, a uniform cubic B-spline is x^2 + 1/3."""
    found = refine(Cage(*sheet(8, lambda x, y: x * x)), error=1e-4)
    x, _, z = found.values.T
    inner = (x > 2.0) & (x < 6.0)
    assert inner.sum() > 100
    assert np.allclose(z[inner], x[inner] ** 2 + 1.0 / 3.0, rtol=0, atol=1e-11)
    # Its border is the curve of the border, its corners its corners.
    assert np.allclose(found.values[[0, 8]], [[0, 0, 0], [8, 0, 64]], rtol=0, atol=1e-12)


@pytest.mark.parametrize("scheme", ["catmullClark", "bilinear"])
def test_what_is_flat_stays_as_it_is(scheme):
    cage = Cage(*sheet(4), scheme=scheme)
    found = refine(cage)
    assert (found.levels, found.off) == (0, 0.0)
    assert np.array_equal(found.values, cage.values)
    assert np.array_equal(found.corners, cage.corners)


CASES = {
    "cube": Cage(*CUBE),
    "octahedron": Cage(*OCTAHEDRON, scheme="loop"),
    "waves": Cage(*sheet(5, lambda x, y: np.sin(2 * x) * np.cos(y))),
    "saddle": Cage(*sheet(2, lambda x, y: x * y), scheme="bilinear"),
    "crease": Cage(*CUBE, creases=(RIM[0], np.full(4, 2.5))),
    "dart": Cage(*CUBE, creases=(RIM[0][:1], np.array([np.inf]))),
    "triangles": Cage(*OCTAHEDRON, smooth_triangles=True),
}


@pytest.mark.parametrize("name", CASES)
def test_triangles_are_within_the_error_of_a_surface_that_is_refined_much_further(name):
    cage = CASES[name]
    size = np.ptp(cage.values, axis=0).max()
    fine = refine(cage, error=2e-4)
    points = fine.values[:: max(1, len(fine.values) // 4000)]
    for error in (2e-2, 5e-3, 2e-3):
        found = refine(cage, error=error)
        assert found.off <= error * size
        # Distances from dense samples of the coarse faces: at most those from the faces.
        quads = found.values[found.corners].reshape(len(found.counts), -1, 3)
        a, b, c = quads[:, 0], quads[:, 1], quads[:, 2]
        triangles = [(a, b, c)] + ([(a, c, quads[:, 3])] if quads.shape[1] == 4 else [])
        steps = [(i / 12, j / 12) for i in range(13) for j in range(13 - i)]
        samples = [p + u * (q - p) + v * (r - p) for p, q, r in triangles for u, v in steps]
        if len(quads) * len(samples) > 1_000_000:
            break
        spacing = max(np.linalg.norm(b - a, axis=1).max(), np.linalg.norm(c - a, axis=1).max())
        way, _ = cKDTree(np.concatenate(samples)).query(points)
        # A nearest sample is off along the triangle by less than their spacing.
        assert way.max() <= np.hypot(error * size, spacing / 12 / 2**0.5 + 1e-12)


def test_an_error_that_would_need_too_many_corners_is_told():
    found = refine(Cage(*CUBE), error=1e-6)
    assert found.off > 1e-6 * 2.0
    assert len(found.corners) <= 2_000_000
    assert found.is_close()


def test_polygons_keep_their_own_and_holes_are_left_out():
    found = refine(Cage(*CUBE, holes=np.array([2])))
    shape = found.values[found.corners].reshape(-1, 4, 3).mean(axis=1)
    assert set(found.polygon.tolist()) == {0, 1, 3, 4, 5}
    # A face's children have its normal's direction.
    normals = np.array([[0, 0, -1], [0, 0, 1], [0, -1, 0], [0, 1, 0], [-1, 0, 0], [1, 0, 0]])
    best = np.argmax(shape @ normals.T, axis=1)
    assert np.mean(best == found.polygon) > 0.95
    # The rest of the surface is that without a hole.
    assert np.array_equal(found.values, refine(Cage(*CUBE)).values)


def test_normals_are_torn_at_creases_alone():
    smooth, sharp = refine(Cage(*CUBE)), refine(Cage(*CUBE, creases=RIM))
    assert np.array_equal(smooth.side, smooth.corners)
    assert np.allclose(np.linalg.norm(smooth.normals[np.unique(smooth.side)], axis=1), 1.0)
    two = np.unique(np.stack([sharp.corners, sharp.side], axis=1), axis=0)
    vertex, sides = np.unique(two[:, 0], return_counts=True)
    assert set(sides.tolist()) == {1, 2}
    # Those of the flat floor point down.
    floor = sharp.side[np.repeat(sharp.polygon == 0, 4)]
    assert np.allclose(sharp.normals[floor], [0, 0, -1], atol=1e-12)
    on_crease = sharp.values[vertex[sides == 2]]
    assert np.allclose(on_crease[:, 2], -1.0)


def test_without_a_rule_for_borders_polygons_at_them_are_not_shown():
    found = refine(Cage(*sheet(4, lambda x, y: x * y), boundary="none"))
    assert set(found.polygon.tolist()) == {5, 6, 9, 10}


@pytest.mark.parametrize("indexed", [True, False])
def test_texture_coordinates_in_one_piece_follow_the_surface(indexed):
    points, counts, corners = sheet(6, lambda x, y: np.cos(x + y))
    found = refine(Cage(points, counts, corners, boundary="edgeOnly"), error=5e-3)
    indices = hanging(corners if indexed else (), len(corners))
    uv = found.at_corners(FaceVarying(points[corners][:, :2], indices, "none"))
    at = found.values[found.corners, :2]
    # Smoothed as the points are, or each polygon by itself: bilinear.
    assert np.allclose(uv, at, rtol=0, atol=1e-12) == indexed
    assert np.allclose(uv, at, rtol=0, atol=0.4)


@given(st.integers(0, 2**32 - 1), st.sampled_from(["catmullClark", "loop", "bilinear"]))
def test_any_polygons_are_refined_to_within_their_hull(seed, scheme):
    """Non-manifold ones, with corners that repeat, and with any creases."""
    rng = np.random.default_rng(seed)
    count = int(rng.integers(1, 9))
    counts = rng.integers(1, 7, rng.integers(1, 7))
    corners = rng.integers(0, count, counts.sum())
    edges = rng.integers(0, count, (3, 2))
    cage = Cage(
        rng.normal(size=(count, 3)),
        counts,
        corners,
        scheme,
        str(rng.choice(["edgeOnly", "edgeAndCorner", "none"])),
        holes=rng.integers(0, len(counts), 1),
        creases=(edges, rng.choice([0.5, 2.5, 11.0], 3)),
        peaks=(edges[:, 0], rng.choice([0.5, 2.5, 11.0], 3)),
    )
    found = refine(cage, error=0.05)
    assert np.isfinite(found.values).all()
    assert found.counts.sum() == len(found.corners) == len(found.side)
    assert np.abs(found.values).max() <= np.abs(cage.values).max() + 1e-9
    linear = str(rng.choice(["cornersPlus2", "boundaries", "all", "none"]))
    values = rng.uniform(size=(4, 2))
    uv = found.at_corners(FaceVarying(values, rng.integers(0, 4, len(corners)), linear))
    assert uv.shape == (len(found.corners), 2)
    assert np.isfinite(uv).all()


@pytest.mark.parametrize(
    ("lengths", "sharpness", "words"),
    [([2], [1.0], "add up to 2"), ([3, 1], [1.0, 1.0], "no length below 2"),
     ([4], [1.0, 1.0], "expected 1, one a crease, or 3, one an edge")],
)  # fmt: skip
def test_creases_that_do_not_go_together_are_refused(lengths, sharpness, words):
    with pytest.raises(ValueError, match=words):
        crease_edges(np.arange(4), np.array(lengths), np.array(sharpness))


UV_RULES = ("none", "cornersOnly", "cornersPlus1", "cornersPlus2", "boundaries", "all")


def test_surfaces_and_texture_coordinates_are_those_of_opensubdiv(tmp_path):
    pytest.importorskip("bpy")
    points, counts, corners = sheet(4, lambda x, y: np.sin(3 * x) + np.cos(2 * y))
    chart = np.repeat((np.arange(16) % 4 >= 2) * (1 + (np.arange(16) // 4 >= 2)), 4)
    uv = points[corners, :2] / 4.0 + 0.3 * chart[:, None]
    cases = {
        f"{rule} {border}": (points, counts, corners, border, np.zeros((0, 3)), uv, rule)
        for rule in UV_RULES
        for border in ("edgeAndCorner", "edgeOnly")
    }
    for name, sharpness in {"soft": [2.5] * 4, "mixed": [0.4, 3.0, 2.2, 1.0], "no": []}.items():
        creases = np.column_stack([RIM[0][: len(sharpness)], sharpness or np.zeros((0,))])
        cases[name] = (*CUBE, "edgeAndCorner", creases.reshape(-1, 3), np.zeros((24, 2)), "all")
    np.save(tmp_path / "in.npy", np.array(list(cases.values()), object), allow_pickle=True)
    script = Path(__file__).with_name("opensubdiv_in_blender.py")
    subprocess.run([sys.executable, str(script), str(tmp_path)], check=True, capture_output=True)
    made = np.load(tmp_path / "out.npy", allow_pickle=True)
    for name, (at, quads, expected) in zip(cases, made, strict=True):
        points, counts, corners, border, creases, uv, rule = cases[name]
        crease = (creases[:, :2].astype(np.int64), creases[:, 2])
        cage = Cage(points, counts, corners, boundary=border, creases=crease)
        # Fine enough that no sharpness is left; its points are the outside's, among others.
        found = refine(cage, error=1e-3)
        indices = hanging(np.unique(uv, axis=0, return_inverse=True)[1].ravel(), len(uv))
        own = found.at_corners(FaceVarying(uv, indices, rule))
        table = np.column_stack([found.values[found.corners], own, np.repeat(found.polygon, 4)])
        polygon = np.repeat(np.arange(len(quads)) // (len(quads) // len(counts)), 4)
        other = np.column_stack([at[quads.ravel()], expected, polygon])
        way, _ = cKDTree(table).query(other)
        # Theirs are float32.
        assert way.max() < 3e-6, name


def test_the_error_is_what_the_docs_say():
    assert ERROR == 5e-4
