"""The resolver against the exact ray caster, on every pixel, from good and from bad visibility."""

from __future__ import annotations

import dataclasses
import sys
from pathlib import Path

import numba
import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parent))
import scenes

from scenec.backends.contract import NO_ROW, Visibility
from scenec.backends.exact import ExactCaster
from scenec.backends.mitsuba.variant import load_mitsuba
from scenec.backends.rays import camera_rays
from scenec.backends.reference import Reference
from scenec.backends.resolver import NO_FACE, annotate, resolve, settle
from scenec.schemas.errors import BackendError
from scenec.schemas.threads import at_most

ALL = ("label", "instance", "depth", "range", "normal", "position", "face")


@pytest.fixture(scope="module")
def rocks():
    """Ground with 3,000 rocks, most of them under two pixels; caster, camera, rays and truth."""
    scene = scenes.rocky(3000, 120, 40.0, seed=4, subdivisions=2)
    view = scenes.camera(
        200, 150, 65.0, scene.cameras[0][0].camera_to_world[:3, 3], (9.0, 2.0, -0.5)
    )
    caster = ExactCaster(scene)
    rays = camera_rays(view)
    return scene, caster, view, rays, caster.cast(rays)


def assert_exact(settled, truth):
    for got, expected in zip((settled.row, settled.face, settled.t), truth, strict=True):
        np.testing.assert_array_equal(got, expected)


def dithered(truth, shape, offset):
    """What each pixel's neighbor saw: wrong along every edge, right within a face."""
    row, face, _ = (a.reshape(shape) for a in truth)
    return Visibility(
        np.roll(row, offset, (0, 1)).ravel().copy(), np.roll(face, offset, (0, 1)).ravel().copy()
    )


def test_exact_visibility_stays_as_it_is(rocks):
    _scene, caster, view, rays, truth = rocks
    settled = settle(caster, rays, Visibility(truth[0], truth[1]), view)
    assert_exact(settled, truth)
    statistics = settled.statistics
    assert (statistics.changed, statistics.changed_rows, statistics.escalated) == (0, 0, False)
    assert 0 < statistics.suspects < statistics.pixels


@pytest.mark.parametrize("offset", [(0, 1), (1, 0), (-1, 1), (0, -2)])
def test_a_picture_shifted_by_a_pixel_or_two_is_settled_on_every_pixel(rocks, offset):
    _scene, caster, view, rays, truth = rocks
    settled = settle(caster, rays, dithered(truth, rays.shape, offset), view)
    assert_exact(settled, truth)
    assert settled.statistics.changed > 1000


def test_rocks_under_two_pixels_that_a_renderer_missed_are_found(rocks):
    scene, caster, view, rays, truth = rocks
    # A picture without small rocks: what the same scene shows when they are taken away.
    near = np.linalg.norm(scene.rows.to_world[:, :, 3] - view.camera_to_world[:3, 3], axis=1)
    size = caster.geometry.row_spheres[:, 3] * view.intrinsics[0, 0] / near
    kept = np.flatnonzero(size > 1.5)
    rows = dataclasses.replace(
        scene.rows,
        mesh=scene.rows.mesh[kept],
        to_world=scene.rows.to_world[kept],
        instance_id=scene.rows.instance_id[kept],
        variation=scene.rows.variation[kept],
    )
    row, face, _ = ExactCaster(dataclasses.replace(scene, rows=rows)).cast(rays)
    missed = Visibility(np.where(row >= 0, kept[row], NO_ROW).astype(np.int32), face)
    settled = settle(caster, rays, missed, view)
    assert_exact(settled, truth)
    assert settled.statistics.changed_rows > 20


def test_errors_along_edges_are_settled_without_casting_everything(rocks):
    _scene, caster, view, rays, truth = rocks
    rng = np.random.default_rng(1)
    beside = dithered(truth, rays.shape, (0, 1))
    # One in a hundred of the pixels at edges takes its neighbor's side, as float32 might.
    edge = (beside.row != truth[0]) | (beside.face != truth[1])
    edge &= rng.random(len(edge)) < 0.01
    row = np.where(edge, beside.row, truth[0])
    face = np.where(edge, beside.face, truth[1])
    settled = settle(caster, rays, Visibility(row, face), view)
    assert_exact(settled, truth)
    assert settled.statistics.changed > 30
    assert not settled.statistics.escalated


def test_random_wrong_faces_and_rows_and_hits_are_settled(rocks):
    scene, caster, view, rays, truth = rocks
    rng = np.random.default_rng(0)
    row, face = truth[0].copy(), truth[1].copy()
    n = len(row)
    some = rng.choice(n, 600, replace=False)
    row[some[:200]] = rng.integers(-5, len(scene.rows.mesh) + 5, 200)
    face[some[200:400]] = rng.integers(-5, 40000, 200)
    row[some[400:500]] = NO_ROW
    row[some[500:]], face[some[500:]] = 0, 0
    settled = settle(caster, rays, Visibility(row, face), view)
    assert_exact(settled, truth)
    assert settled.statistics.changed >= 300


def test_a_renderer_that_drops_whole_areas_is_caught_by_the_audit(rocks):
    _scene, caster, view, rays, truth = rocks
    n = len(truth[0])
    nothing = Visibility(np.full(n, NO_ROW, np.int32), np.zeros(n, np.int32))
    settled = settle(caster, rays, nothing, view)
    assert settled.statistics.escalated
    assert_exact(settled, truth)


def test_repeated_rows_and_faces_resolve_to_the_first_of_them():
    ball, faces = scenes.icosphere(1)
    twice = scenes.mesh(ball, np.concatenate([faces, faces[:, ::-1]]))
    m = scenes.affine(1.0, (3.0, 0.0, 0.0))
    scene = scenes.scene([twice], [(0, m), (0, m)])
    view = scenes.camera(20, 14, 60.0)
    rays = camera_rays(view)
    caster = ExactCaster(scene)
    truth = caster.cast(rays)
    hit = truth[0] == 0
    assert hit.any()
    # The rounding of a face and of its reverse may differ: the other one is wrong either way.
    other = Visibility(
        np.where(hit, 1, NO_ROW).astype(np.int32),
        np.where(hit, (truth[1] + len(faces)) % (2 * len(faces)), 0).astype(np.int32),
    )
    settled = settle(caster, rays, other, view)
    assert_exact(settled, truth)
    assert settled.statistics.reasons["twin"] == hit.sum()
    assert not settled.statistics.escalated


def test_contact_lines_with_the_ground_are_settled():
    flat = scenes.grid(np.zeros((9, 9)), 1.0)
    cube, faces = scenes.icosphere(3)
    scene = scenes.scene(
        [flat, scenes.mesh(cube, faces, 3)],
        [(0, scenes.affine()), *((1, scenes.affine(0.4, (x, y, 0.1))) for x, y in
         ((2.0, 0.2), (2.9, -0.8), (1.5, 1.0), (3.6, 0.9)))],
    )  # fmt: skip
    view = scenes.camera(160, 120, 65.0, (-1.5, 0.0, 1.0), (2.0, 0.0, 0.0))
    rays = camera_rays(view)
    caster = ExactCaster(scene)
    truth = caster.cast(rays)
    for offset in ((1, 0), (0, 1)):
        assert_exact(settle(caster, rays, dithered(truth, rays.shape, offset), view), truth)


def test_without_a_camera_or_visibility_every_ray_is_cast(rocks):
    _scene, caster, _, rays, truth = rocks
    assert_exact(settle(caster, rays), truth)
    settled = settle(caster, rays, dithered(truth, rays.shape, (3, 3)), None)
    assert_exact(settled, truth)
    assert settled.statistics.suspects == settled.statistics.pixels


def test_results_do_not_depend_on_the_number_of_threads(rocks):
    scene, caster, view, rays, truth = rocks
    visibility = dithered(truth, rays.shape, (0, 1))
    results = []
    for count in (1, numba.config.NUMBA_NUM_THREADS):
        with at_most(count):
            results.append(resolve(scene, caster, rays, visibility, view, ALL))
    (one, one_statistics), (many, many_statistics) = results
    assert one_statistics == many_statistics
    for name, values in one.items():
        assert values.tobytes() == many[name].tobytes(), name


def test_annotation_follows_from_the_hit():
    corners = [(5, -9, -9), (5, 9, -9), (5, 9, 1), (5, -9, 1)]
    wall = scenes.mesh(corners, [0, 1, 2, 0, 2, 3], [7, 8], np.array([3, 3], np.int32))
    view = scenes.camera(30, 40, 60.0)
    # A mirrored row turns the winding around; the normal must face the ray all the same.
    mirror = scenes.affine(np.diag([1.0, -1.0, 1.0]))
    scene = scenes.scene([wall], [(0, mirror)], [42])
    rays = camera_rays(view)
    out, _ = resolve(scene, ExactCaster(scene), rays, None, view, ALL)
    d = rays.directions.reshape(40, 30, 3)
    hit = d[..., 2] * 5 < 1
    assert hit.any()
    assert not hit.all()
    assert set(out) == {"label.class", "instance", "depth", "range", "normal", "position", "face"}
    np.testing.assert_allclose(out["depth"][hit], 5.0, rtol=1e-15)
    np.testing.assert_allclose(
        out["range"][hit], 5 * np.sqrt((d[hit] ** 2).sum(axis=1)), rtol=1e-15
    )
    np.testing.assert_array_equal(out["normal"][hit], np.broadcast_to((-1.0, 0, 0), d[hit].shape))
    np.testing.assert_allclose(out["position"][hit], 5 * d[hit], rtol=1e-14, atol=1e-14)
    assert set(np.unique(out["label.class"][hit])) == {7, 8}
    assert (out["instance"] == np.where(hit, 42, 0)).all()
    assert (out["face"] == np.where(hit, 3, NO_FACE)).all()
    assert np.isposinf(out["depth"][~hit]).all()
    assert np.isposinf(out["range"][~hit]).all()
    assert (out["normal"][~hit] == 0).all()
    assert np.isnan(out["position"][~hit]).all()
    assert (out["label.class"][~hit] == scenes.SKY).all()
    dtypes = {name: values.dtype for name, values in out.items()}
    integers = {"label.class", "instance", "face"}
    assert dtypes == {name: np.uint32 if name in integers else np.float64 for name in out}


def test_only_the_passes_asked_for_are_computed_and_unknown_ones_are_errors(rocks):
    scene, caster, _, rays, _ = rocks
    settled = settle(caster, rays)
    assert list(annotate(scene, settled, rays, ["rgb", "depth"])) == ["depth"]
    assert list(annotate(scene, settled, rays, ["label.class", "label"])) == ["label.class"]
    with pytest.raises(BackendError, match="dept"):
        annotate(scene, settled, rays, ["dept"])


def test_visibility_of_another_size_is_an_error(rocks):
    _scene, caster, view, rays, truth = rocks
    with pytest.raises(BackendError, match="one per ray"):
        settle(caster, rays, Visibility(truth[0][1:], truth[1][1:]), view)


def test_reference_answers_the_definition_and_has_no_radiance(rocks):
    scene, _, view, rays, truth = rocks
    backend = Reference()
    with pytest.raises(BackendError, match="load"):
        backend.visibility(rays, 0)
    backend.load(scene)
    visibility = backend.visibility(rays, 0)
    np.testing.assert_array_equal(visibility.row, truth[0])
    np.testing.assert_array_equal(visibility.face, truth[1])
    with pytest.raises(BackendError, match="no rgb"):
        backend.radiance(view, 0, 16, 0)


@pytest.mark.invariant
@pytest.mark.slow
@pytest.mark.parametrize("offset", [0.0, 3000.0])
def test_float32_visibility_of_mitsuba_is_settled_on_every_pixel(offset):
    mi = load_mitsuba()
    scene = scenes.rocky(2000, 150, 40.0, seed=2, subdivisions=2)
    shift = np.array([offset, -offset, 0.0])
    rows = dataclasses.replace(scene.rows, to_world=scene.rows.to_world.copy())
    rows.to_world[:, :, 3] += shift
    scene = dataclasses.replace(scene, rows=rows)
    caster = ExactCaster(scene)
    view = scenes.camera(160, 120, 65.0, scene.cameras[0][0].camera_to_world[:3, 3] + shift,
                         np.add(shift, (9.0, -3.0, -0.5)))  # fmt: skip
    rays = camera_rays(view)
    row, face = mitsuba_visibility(mi, scene, rays)
    settled = settle(caster, rays, Visibility(row, face), view)
    assert_exact(settled, caster.cast(rays))
    # Far from the origin float32 is coarse, and there is something to settle.
    assert settled.statistics.changed > (10 if offset else -1)


def mitsuba_visibility(mi, scene, rays):
    """First hits by Mitsuba's ray tracer, all rows flattened to one mesh in float32."""
    points, faces, row_of, face_of, count = [], [], [], [], 0
    for row, (which, m) in enumerate(zip(scene.rows.mesh, scene.rows.to_world, strict=True)):
        mesh = scene.meshes[which]
        points.append(mesh.points @ m[:, :3].T + m[:, 3])
        faces.append(mesh.faces + count)
        count += len(mesh.points)
        row_of.append(np.full(len(mesh.faces), row))
        face_of.append(np.arange(len(mesh.faces)))
    shape = mi.Mesh("flat", count, sum(map(len, faces)))
    parameters = mi.traverse(shape)
    parameters["vertex_positions"] = np.concatenate(points).astype(np.float32).ravel()
    parameters["faces"] = np.concatenate(faces).astype(np.uint32).ravel()
    parameters.update()
    tracer = mi.load_dict({"type": "scene", "shape": shape})
    row_of, face_of = np.concatenate(row_of), np.concatenate(face_of)
    ray = mi.Ray3f(mi.Point3f(rays.origins.T), mi.Vector3f(rays.directions.T))
    hit = tracer.ray_intersect_preliminary(ray, coherent=True)
    prim, valid = np.array(hit.prim_index), np.array(hit.is_valid())
    index = np.where(valid, prim, 0)
    return (
        np.where(valid, row_of[index], NO_ROW).astype(np.int32),
        np.where(valid, face_of[index], 0).astype(np.int32),
    )
