"""The exact ray caster against analytic answers and against brute force."""

from __future__ import annotations

import dataclasses
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from scenec.backends.camera.rays import camera_rays
from scenec.backends.contract import NO_ROW, Rays
from scenec.backends.exact import ExactCaster
from scenec.backends.exact.build import TASK_SIZE
from scenec.backends.exact.intersect import edge_function
from scenec.schemas.errors import BackendError
from scenec.schemas.threads import at_most
from scenec.testing import scenes
from scenec.testing.examples import examples
from scenec.testing.lens_scenes import FISHEYE, with_lens


def table(origins, directions) -> Rays:
    directions = np.atleast_2d(np.asarray(directions, float))
    origins = np.ascontiguousarray(np.broadcast_to(np.asarray(origins, float), directions.shape))
    return Rays(origins, directions, (1, len(directions)))


def brute_force(scene, rays):
    """Nearest hit by NumPy over every triangle, the arithmetic of ``intersect`` written anew."""
    n = len(rays.origins)
    best = np.full(n, np.inf)
    best_row = np.full(n, NO_ROW)
    best_face = np.zeros(n, int)
    d = rays.directions
    kz = np.argmax(np.abs(d), axis=1)
    k = np.stack([(kz + 1) % 3, (kz + 2) % 3, kz], axis=1)
    origin = np.take_along_axis(rays.origins, k, 1)
    direction = np.take_along_axis(d, k, 1)
    shear = direction[:, :2] / direction[:, 2:]
    for row, (which, m) in enumerate(zip(scene.rows.mesh, scene.rows.to_world, strict=True)):
        mesh = scene.meshes[which]
        p = mesh.points.astype(float)
        world = ((m[:, 0] * p[:, :1] + m[:, 1] * p[:, 1:2]) + m[:, 2] * p[:, 2:]) + m[:, 3]
        for face, corners in enumerate(world[mesh.faces]):
            q = corners[:, k] - origin
            x = q[:, :, 0] - shear[:, 0] * q[:, :, 2]
            y = q[:, :, 1] - shear[:, 1] * q[:, :, 2]
            (ax, bx, cx), (ay, by, cy), z = x, y, q[:, :, 2]
            u, v, w = (
                np.array([edge_function(*e) for e in zip(*edge, strict=True)])
                for edge in ((cx, cy, bx, by), (ax, ay, cx, cy), (bx, by, ax, ay))
            )
            outside = (np.minimum(np.minimum(u, v), w) < 0) & (np.maximum(np.maximum(u, v), w) > 0)
            with np.errstate(invalid="ignore", divide="ignore"):
                t = ((u * z[0] + v * z[1]) + w * z[2]) / ((u + v) + w) / direction[:, 2]
            better = ~outside & (t > 0) & (t < best)
            best[better], best_row[better], best_face[better] = t[better], row, face
    return best_row, best_face, best


@st.composite
def soups(draw):
    """Triangle soups with shared, mirrored, flattened and collapsed rows, far from the origin."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32)))
    meshes = []
    for _ in range(draw(st.integers(1, 3))):
        points = rng.normal(size=(9, 3))
        if draw(st.booleans()):
            points = np.round(points)
        meshes.append(scenes.mesh(points, rng.integers(0, 9, (draw(st.integers(1, 12)), 3))))
    middle = rng.normal(size=3) * 10.0 ** draw(st.floats(-1, 5))
    rows = []
    for _ in range(draw(st.integers(1, 6))):
        linear = scenes.rotation(rng) * 10.0 ** draw(st.sampled_from([0.0, 0.0, -3.0, 1.0, 4.0]))
        shape = draw(
            st.sampled_from([(1, 1, 1), (1, 1, -1), (1, 1, 0), (1, 1, 1e-9), (1, 0, 0), (0, 0, 0)])
        )
        offset = middle + rng.normal(size=3)
        rows.append((int(rng.integers(len(meshes))), scenes.affine(linear * shape, offset)))
    scene = scenes.scene(meshes, rows)
    targets = []
    for _ in range(60):
        mesh, m = rows[rng.integers(len(rows))]
        corner = meshes[mesh].points[rng.integers(0, 9, 3)].astype(float)
        # Vertices, points on edges, and points anywhere near.
        mix = np.array(((1, 0, 0), (0.5, 0.5, 0), rng.dirichlet((1, 1, 1)))[rng.integers(3)])
        targets.append(m[:, :3] @ (mix @ corner) + m[:, 3])
    origins = middle + rng.normal(size=(60, 3)) * 10.0 ** rng.uniform(-1, 4, (60, 1))
    directions = (np.array(targets) - origins) * rng.uniform(0.5, 2, (60, 1))
    directions[:6] = np.repeat(np.eye(3), 2, 0) * rng.choice([-1.0, 1.0], (6, 1))
    return scene, Rays(origins, directions, (6, 10))


@examples(25)
@given(soups())
def test_caster_agrees_with_brute_force_to_the_bit(case):
    scene, rays = case
    row, face, t = ExactCaster(scene).cast(rays)
    expected_row, expected_face, expected_t = brute_force(scene, rays)
    np.testing.assert_array_equal(row, expected_row)
    np.testing.assert_array_equal(face, expected_face)
    np.testing.assert_array_equal(t, expected_t)


@st.composite
def looks(draw):
    """A soup, and a small picture of one of its corners, or of a point on an edge, from one eye."""
    scene, rays = draw(soups())
    rng = np.random.default_rng(draw(st.integers(0, 2**32)))
    which = int(rng.integers(6, 60))
    eye, way = rays.origins[which], rays.directions[which]
    if draw(st.booleans()):
        # Along an axis, or between two: rays go both ways across, or have two main axes.
        way = np.eye(3)[rng.integers(3)] + np.eye(3)[rng.integers(3)] * rng.integers(-1, 2)
        if draw(st.booleans()):
            eye = rays.origins[which] + rays.directions[which] - way * rng.integers(1, 4)
    assume((way != 0.0).any())
    side = np.cross(way, np.eye(3)[np.argmin(np.abs(way))])
    up = np.cross(side, way) / np.sqrt((way**2).sum())
    step = 10.0 ** draw(st.floats(-9.0, -1.0))
    x, y = (np.arange(n) - n // 2 for n in (11, 9))
    grid = way + step * (x[None, :, None] * side + y[:, None, None] * up)
    return scene, Rays(np.tile(eye, (99, 1)), grid.reshape(99, 3), (9, 11))


@examples(25)
@given(looks())
def test_pictures_agree_with_brute_force_to_the_bit(case):
    scene, rays = case
    found = ExactCaster(scene).cast(rays)
    for one, expected in zip(found, brute_force(scene, rays), strict=True):
        np.testing.assert_array_equal(one, expected)


def bent(rays: Rays, turn: float) -> Rays:
    """Another eye for each line, as of a rolling shutter."""
    origins = rays.origins + turn * np.repeat(np.arange(rays.shape[0]), rays.shape[1])[:, None]
    return dataclasses.replace(rays, origins=origins)


@pytest.mark.parametrize(
    "rays",
    [
        camera_rays(scenes.camera(100, 75, 65.0, (0.0, 0.0, 9.0), (20.0, 20.0, 0.0))),
        # Two main axes in a tile; tiles too wide for a packet; eyes that differ; a fisheye, whose
        # tiles at the border have few rays; and one tile that shows thousands of triangles.
        camera_rays(scenes.camera(80, 60, 90.0, (0.0, 0.0, 9.0), (1.0, 1.0, 8.9))),
        camera_rays(scenes.camera(20, 15, 120.0, (0.0, 0.0, 9.0), (1.0, 0.0, 8.5))),
        bent(camera_rays(scenes.camera(64, 48, 50.0, (0.0, 0.0, 9.0), (9.0, 2.0, 0.0))), 1e-3),
        camera_rays(with_lens(FISHEYE, 96, 72, 24.0)),
        camera_rays(scenes.camera(8, 8, 10.0, (-45.0, 0.0, 25.0), (20.0, 0.0, 0.0))),
    ],
)
def test_rays_that_go_together_meet_what_each_meets_alone(rays, rocks):
    together = rocks.hits(rays)
    known = np.arange(len(rays.origins)) if rays.known is None else np.flatnonzero(rays.known)
    row, face, t = rocks.cast(rays, known)
    np.testing.assert_array_equal(together.row[known], row)
    np.testing.assert_array_equal(together.face[known], face)
    np.testing.assert_array_equal(together.t[known], t)
    assert len(np.unique(face)) > 30
    unknown = np.setdiff1d(np.arange(len(rays.origins)), known)
    assert (together.row[unknown] == NO_ROW).all()
    assert np.isinf(together.t[unknown]).all()


@pytest.fixture(scope="module")
def rocks() -> ExactCaster:
    return ExactCaster(scenes.rocky(3000, 200, subdivisions=2))


def test_trees_over_many_faces_lose_none_of_them():
    scene = scenes.rocky(6, 100, 20.0, seed=9, subdivisions=2)
    # A sheet of coplanar triangles, each listed 50 times, cannot be split by position.
    sheet = scenes.mesh([(3, -1, -5), (3, 1, -5), (3, 0, 5)], np.tile([0, 1, 2], 50))
    meshes = [*scene.meshes, sheet]
    rows = [(int(m), t) for m, t in zip(scene.rows.mesh, scene.rows.to_world, strict=True)]
    rows.append((len(meshes) - 1, scenes.affine()))
    rays = camera_rays(scene.cameras[0][0])
    caster = ExactCaster(scenes.scene(meshes, rows))
    index = np.random.default_rng(2).choice(len(rays.origins), 150, replace=False)
    row, face, t = caster.cast(rays, index)
    counts = [len(meshes[m].faces) for m, _ in rows]
    every_row = np.repeat(np.arange(len(counts), dtype=np.int32), counts)
    every_face = np.concatenate([np.arange(n, dtype=np.int32) for n in counts])
    assert len(every_face) > TASK_SIZE
    for k, ray in enumerate(index):
        every = caster.test(rays, np.full(len(every_row), ray), every_row, every_face)
        first = int(np.argmin(every))
        assert t[k] == every[first]
        if np.isfinite(t[k]):
            assert (row[k], face[k]) == (every_row[first], every_face[first])
    assert (row == len(rows) - 1).any()


numbers = st.floats(-1e6, 1e6).filter(lambda x: x == 0 or abs(x) > 1e-60)


@given(numbers, numbers, st.floats(-3, 3), st.integers(-3, 3), st.integers(-3, 3))
def test_edge_function_has_the_sign_of_exact_arithmetic(ax, ay, scale, dx, dy):
    # b is nearly parallel to a, a few units in the last place off: the hard case.
    bx, by = scale * ax, scale * ay
    bx, by = bx + dx * np.spacing(bx), by + dy * np.spacing(by)
    exact = Fraction(ax) * Fraction(float(by)) - Fraction(ay) * Fraction(float(bx))
    computed = edge_function(ax, ay, bx, by)
    assert np.sign(computed) in (np.sign(exact), 0)
    if abs(exact) > Fraction(1, 10**250):
        assert abs(Fraction(float(computed)) - exact) <= abs(exact) * Fraction(1, 2**40)


@given(numbers, numbers, numbers, numbers)
def test_edge_function_of_the_reversed_edge_is_the_exact_negative(ax, ay, bx, by):
    assert edge_function(ax, ay, bx, by) == -edge_function(bx, by, ax, ay)


def test_depth_error_of_a_tessellated_sphere_is_below_the_chord_bound_and_of_second_order():
    center = np.array([5.0, 0.0, 0.0])
    errors, lengths = [], []
    rng = np.random.default_rng(3)
    d = np.concatenate([np.ones((4000, 1)), rng.uniform(-0.1, 0.1, (4000, 2))], axis=1)
    b = d @ center
    dd = (d * d).sum(axis=1)
    expected = (b - np.sqrt(b * b - dd * (center @ center - 1))) / dd
    for subdivisions in (2, 3, 4, 5):
        points, faces = scenes.icosphere(subdivisions)
        ball = scenes.scene([scenes.mesh(points, faces)], [(0, scenes.affine(1.0, center))])
        _, _, t = ExactCaster(ball).cast(table((0.0, 0.0, 0.0), d))
        length = np.sqrt(((points[faces] - points[np.roll(faces, 1, 1)]) ** 2).sum(-1)).max()
        # A chord plane of circumradius rho <= length / sqrt(3) lies rho**2 / 2 (and less than
        # 1.2 times that) inside; along the ray it is that over the cosine of incidence.
        cosine = np.abs(((expected[:, None] * d - center) * d).sum(axis=1)) / np.sqrt(dd)
        assert (t >= expected - 1e-6).all()
        assert ((t - expected) * cosine * np.sqrt(dd) <= 1.2 * length**2 / 6 + 1e-6).all()
        errors.append(np.sqrt(((t - expected) ** 2).mean()))
        lengths.append(length)
    order = np.polyfit(np.log(lengths), np.log(errors), 1)[0]
    assert order == pytest.approx(2.0, abs=0.1)


@pytest.mark.parametrize("offset", [0.0, 1e5])
@pytest.mark.parametrize("scale", [1e-3, 1.0, 1e4])
def test_no_ray_leaks_through_vertices_and_edges_of_a_closed_mesh(offset, scale):
    rng = np.random.default_rng(11)
    points, faces = scenes.icosphere(2)
    linear = scenes.rotation(rng) @ np.diag([1.0, 0.3, -2.0]) * scale
    ball = scenes.scene(
        [scenes.mesh(points, faces)], [(0, scenes.affine(linear, (offset, -offset, offset)))]
    )
    local = points.astype(np.float32).astype(float)
    m = ball.rows.to_world[0]
    world = ((m[:, 0] * local[:, :1] + m[:, 1] * local[:, 1:2]) + m[:, 2] * local[:, 2:]) + m[:, 3]
    a, b = world[faces], world[np.roll(faces, 1, axis=1)]
    targets = np.concatenate([world, *(a + (b - a) * s for s in (0.5, 0.25, 0.7))], axis=None)
    targets = targets.reshape(-1, 3)
    inside = m[:, 3] + (linear @ rng.uniform(-0.3, 0.3, (3, len(targets)))).T
    directions = targets - inside
    row, _, t = ExactCaster(ball).cast(table(inside, directions))
    assert (row == 0).all()
    # The far side of the mesh would be hit by a leaking ray's neighbors, not at its target.
    np.testing.assert_allclose(t, 1.0, rtol=1e-4)


def test_a_ray_through_a_shared_grid_vertex_never_falls_through_the_ground():
    ground = scenes.scene(
        [scenes.grid(np.zeros((33, 33)), 0.1)], [(0, scenes.affine(1.0, (0.3, 0.1, -7.0)))]
    )
    p = ground.meshes[0].points.astype(float) + np.array((0.3, 0.1, -7.0))
    inner = p[np.abs(p - (0.3, 0.1, -7.0)).max(axis=1) < 1.55]
    row, _, _ = ExactCaster(ground).cast(table((0.0, 0.0, 0.0), inner))
    assert (row == 0).all()


def test_ties_go_to_the_lowest_row_then_to_the_lowest_face():
    square = scenes.mesh(
        [(-1, -1, 0), (1, -1, 0), (1, 1, 0), (-1, 1, 0)],
        [(0, 2, 3), (0, 1, 2), (0, 1, 2), (2, 1, 0)],
    )
    m = scenes.affine(1.0, (0.0, 0.0, 2.0))
    stack = scenes.scene([square, square], [(1, m), (0, m), (1, m)])
    rays = table((0.0, 0.0, 0.0), [(0.1, -0.2, 1.0), (-0.2, 0.1, 1.0), (0.25, 0.25, 1.0)])
    row, face, t = ExactCaster(stack).cast(rays)
    assert row.tolist() == [0, 0, 0]
    assert face.tolist() == [1, 0, 0]
    assert t.tolist() == [2.0, 2.0, 2.0]


def test_ties_in_a_picture_go_to_the_lowest_row_and_face():
    corners = [(-1, -1, 0), (1, -1, 0), (1, 1, 0), (-1, 1, 0)]
    sheet = scenes.mesh(corners, [(0, 1, 2), (0, 2, 3), (2, 1, 0), (0, 3, 2)])
    middles = 0.25 * np.random.default_rng(4).permutation(40)
    rows = [(0, scenes.affine(1.0, (x, 0.0, 4.0))) for x in middles]
    x, y = np.arange(24) / 8.0 + 1 / 32, np.arange(16) / 64.0
    grid = np.stack([*np.meshgrid(x / 4.0, y / 4.0), np.ones((16, 24))], axis=-1).reshape(-1, 3)
    rays = Rays(np.zeros_like(grid), grid, (16, 24))
    stack = scenes.scene([sheet], rows)
    row, face, t = ExactCaster(stack).cast(rays)
    lowest = [int(np.argmax(abs(4.0 * d - middles) <= 1.0)) for d in grid[:, 0]]
    np.testing.assert_array_equal(row, lowest)
    np.testing.assert_array_equal(face, brute_force(stack, rays)[1])
    assert (t == 4.0).all()


def test_hits_are_two_sided_and_need_a_positive_parameter():
    triangle = scenes.scene(
        [scenes.mesh([(-1, -1, 0), (1, -1, 0), (0, 1, 0)], [0, 1, 2])], [(0, scenes.affine())]
    )
    caster = ExactCaster(triangle)
    rays = table(
        [(0, 0, 3), (0, 0, -3), (0, 0, 0), (0, 0, 3)], [(0, 0, -1), (0, 0, 2), (0, 0, 1), (0, 0, 1)]
    )
    assert caster.cast(rays)[2].tolist() == [3.0, 1.5, np.inf, np.inf]


def test_degenerate_triangles_and_collapsed_rows_are_never_hit():
    flat = scenes.mesh([(0, 0, 0), (1, 1, 1), (2, 2, 2)], [(0, 1, 2), (0, 0, 1), (1, 1, 1)])
    ball = scenes.mesh(*scenes.icosphere(1))
    empty = scenes.mesh(np.empty((0, 3)), np.empty((0, 3)))
    scene = scenes.scene(
        [flat, ball, empty],
        [(0, scenes.affine()), (1, scenes.affine(0.0, (1.0, 1.0, 1.0))), (2, scenes.affine())],
    )
    row, face, t = ExactCaster(scene).cast(
        table((0.0, 0.0, 5.0), [(1, 1, -4), (0, 0, -1), (2, 2, -3), (0.5, 0.5, -4.5)])
    )
    assert (row == NO_ROW).all()
    assert (face == 0).all()
    assert np.isinf(t).all()


def test_a_scene_without_anything_answers_no_hit():
    row, _, t = ExactCaster(scenes.scene([], [])).cast(table((0, 0, 0), [(1, 0, 0)]))
    assert row.tolist() == [NO_ROW]
    assert t.tolist() == [np.inf]


def test_a_row_flattened_along_an_axis_is_its_shadow():
    ball = scenes.mesh(*scenes.icosphere(3))
    flat = scenes.scene([ball], [(0, scenes.affine(np.diag([1.0, 1.0, 0.0]), (0, 0, -2)))])
    rng = np.random.default_rng(0)
    d = np.concatenate([rng.uniform(-1, 1, (500, 2)), np.full((500, 1), -2.0)], axis=1)
    row, _, t = ExactCaster(flat).cast(table((0.0, 0.0, 0.0), d))
    radius = np.sqrt(d[:, 0] ** 2 + d[:, 1] ** 2)
    assert (row[radius < 0.98] == 0).all()
    assert (row[radius > 1.0] == NO_ROW).all()
    np.testing.assert_allclose(t[radius < 0.98], 1.0, rtol=1e-15)


def test_answers_do_not_depend_on_the_number_of_threads():
    scene = scenes.rocky(400, 80, 20.0, subdivisions=2)
    rays = camera_rays(scene.cameras[0][0])
    with at_most(1):
        one = ExactCaster(scene)
        expected = one.cast(rays)
    many = ExactCaster(scene)
    got = many.cast(rays)
    for a, b in zip(expected, got, strict=True):
        np.testing.assert_array_equal(a, b)
    for name in ("face_order", "row_order", "row_root"):
        np.testing.assert_array_equal(getattr(one.geometry, name), getattr(many.geometry, name))


def test_testing_a_triangle_gives_the_parameter_of_the_cast_and_inf_for_what_is_not_there():
    scene = scenes.rocky(50, 20, 10.0, subdivisions=1)
    rays = camera_rays(scene.cameras[0][0])
    caster = ExactCaster(scene)
    row, face, t = caster.cast(rays)
    index = np.arange(len(row))
    np.testing.assert_array_equal(caster.test(rays, index, row, face), t)
    wrong = caster.test(rays, index, row + np.int32(1000), face)
    assert np.isinf(wrong).all()
    assert np.isinf(caster.test(rays, index, row, face - np.int32(10**6))).all()


@pytest.mark.parametrize("fault", ["point", "matrix", "index"])
def test_broken_arrays_end_in_one_message(fault):
    points, faces = scenes.icosphere(0)
    matrix = scenes.affine()
    if fault == "point":
        points[3, 1] = np.nan
    elif fault == "matrix":
        matrix[0, 0] = np.inf
    else:
        faces[2, 2] = 99
    scene = scenes.scene([scenes.mesh(points, faces)], [(0, matrix)])
    with pytest.raises(BackendError, match=r"not finite|names a vertex"):
        ExactCaster(scene)
