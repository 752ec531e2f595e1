"""Scenes whose instances are kept look as if they were written out, and take little memory."""

from __future__ import annotations

import dataclasses
import importlib.util

import numpy as np
import pytest
from numpy.typing import NDArray

from scenec.backends.camera.rays import camera_rays
from scenec.backends.contract import LoadCost
from scenec.backends.exact import ExactCaster
from scenec.backends.mitsuba.adapter import Mitsuba
from scenec.backends.run.memory import peak, reset_peak
from scenec.backends.stage.scene import Motion, RenderScene
from scenec.backends.testing import scenes as ms
from scenec.testing import scenes

pytestmark = pytest.mark.skipif(
    importlib.util.find_spec("mitsuba") is None, reason="Mitsuba is not installed"
)


def field(transmission: float = 0.0) -> RenderScene:
    """Balls on merged ground: turned, mirrored, smooth, varied by vertex and by row."""
    rng = np.random.default_rng(3)
    ball, faces = scenes.icosphere(2)
    ground, ground_faces = ms.plane(20.0, 12)
    meshes = [
        ms.mesh(ground, ground_faces, (0, 1), rng.uniform(0, 1, (1, len(ground)))),
        ms.mesh(ball, faces, (2,), variation=rng.uniform(-1, 1, len(ball))),
        ms.mesh(ball * [1, 0.5, 0.7], faces, (2,), normals=ball / [1, 0.5, 0.7]),
    ]
    rows = [(0, scenes.affine())]
    for i in range(80):
        linear = scenes.rotation(rng) * rng.uniform(0.4, 1.4)
        if i % 5 == 0:
            linear = linear @ np.diag([-1.0, 1, 1])
        rows.append((1 + i % 2, scenes.affine(linear, [*rng.uniform(-8, 8, 2), rng.uniform(0, 1)])))
    return ms.scene(
        meshes,
        [
            ms.surface((0.7, 0.5, 0.3)),
            ms.surface((0.1, 0.2, 0.4), specular=0.3, roughness=0.3),
            dataclasses.replace(
                ms.surface((0.5, 0.4, 0.6), specular=0.1, variation=0.5),
                diffuse_transmission=transmission,
            ),
        ],
        rows=rows,
        row_variation=rng.uniform(-1, 1, len(rows)).tolist(),
        cameras=[ms.look_at((0, -14, 5), (0, 0, 0.5), 96, 64, 60)],
        lights=[ms.sun(30.0, 40.0, 500.0, 5.0), ms.dome(60.0)],
    )


def loaded(scene: RenderScene, most_written: float) -> Mitsuba:
    backend = Mitsuba(device="cpu")
    backend.load_cost = dataclasses.replace(backend.load_cost, most_written=most_written)
    backend.load(scene)
    return backend


def in_blocks(values: NDArray) -> NDArray:
    """Means over 8 x 8 pixels, [..., 8, 12, 3]."""
    return values.reshape(*values.shape[:-3], 8, 8, 12, 8, 3).mean(axis=(-4, -2))


@pytest.mark.parametrize(
    ("transmission", "spp"),
    [(0.6, 96), *(pytest.param(part, 512, marks=pytest.mark.slow) for part in (0.0, 0.6))],
)
def test_pictures_agree_with_those_of_written_instances_within_noise(transmission, spp):
    scene = field(transmission)
    camera = scene.cameras[0][0]
    written, kept = (loaded(scene, most).radiance(camera, 0, spp, 1) for most in (np.inf, 0.0))
    assert np.mean(written.coverage != kept.coverage) < 0.01
    a, b = in_blocks(written.halves), in_blocks(kept.halves)
    # Of equal seeds the two are no independent draws: their noise is that or less.
    noise = np.sqrt((((a[0] - a[1]) ** 2 + (b[0] - b[1]) ** 2) / 4).mean())
    difference = a.mean(axis=0) - b.mean(axis=0)
    assert np.sqrt((difference**2).mean()) < 1.5 * noise
    assert abs(difference.mean()) < 3e-3 * a.mean()


def test_a_witness_of_kept_instances_names_their_rows_and_faces():
    scene = field()
    rays = camera_rays(scene.cameras[0][0])
    row, face, _ = ExactCaster(scene).cast(rays)
    seen = loaded(scene, 0.0).witness(rays, 0)
    np.testing.assert_array_equal(seen.row, row)
    np.testing.assert_array_equal(seen.face, face)
    assert len(np.unique(row)) > 60
    # They are the caster's own, which bears out nothing.
    assert not seen.independent
    assert loaded(scene, np.inf).witness(rays, 0).independent


def test_what_moves_is_drawn_where_it_is_at_the_sample():
    still = field()
    moved = still.rows.to_world[:3].copy()
    moved[1:, :, 3] += (0.0, -4.0, 1.0)
    path = Motion(np.array([1, 2], np.int32), np.stack([still.rows.to_world[1:3], moved[1:]]))
    scene = dataclasses.replace(
        still,
        samples=2,
        cameras=still.cameras * 2,
        lighting=still.lighting * 2,
        times=np.zeros(2),
        rows=dataclasses.replace(still.rows, motion=path),
    )
    camera = scene.cameras[0][0]
    there = dataclasses.replace(still, rows=dataclasses.replace(scene.rows_at(1), motion=None))
    expected = loaded(there, 0.0).radiance(camera, 0, 4, 1)
    backend = loaded(scene, 0.0)
    first = backend.radiance(camera, 0, 4, 1)
    second = backend.radiance(camera, 1, 4, 1)
    # The middle of the bounds, which positions are relative to, is another one.
    assert np.isclose(second.halves, expected.halves, rtol=1e-3).mean() > 0.97
    assert np.isclose(second.halves, first.halves, rtol=1e-3).mean() < 0.97


def test_instances_are_kept_where_writing_them_takes_more_than_is_stated():
    scene = field()
    triangles = int(sum(len(scene.meshes[m].faces) for m in scene.rows.mesh))
    shared = sum(len(mesh.faces) for mesh in scene.meshes)
    for most, kept in ((140.0 * triangles, False), (140.0 * triangles - 1, True)):
        cost = LoadCost(row=900.0, triangle=10.0, written=140.0, most_written=most)
        assert cost.keeps(scene) is kept
        size = 900.0 * len(scene.rows.mesh) if kept else 140.0 * triangles
        assert cost.of(scene)[0] == size + 10.0 * shared
    lit = dataclasses.replace(
        scene,
        surfaces=(*scene.surfaces[:2], dataclasses.replace(scene.surfaces[2], emission=(1, 1, 1))),
    )
    cost = dataclasses.replace(Mitsuba.load_cost, most_written=0.0)
    assert cost.keeps(scene)
    assert not cost.keeps(lit)


def test_sixty_thousand_instances_of_77_million_triangles_take_little():
    count = 60_000
    ball, faces = scenes.icosphere(3)
    scene = field()
    rng = np.random.default_rng(1)
    to_world = np.zeros((count, 3, 4))
    to_world[:, [0, 1, 2], [0, 1, 2]] = 0.05
    to_world[:, :, 3] = rng.uniform(-20, 20, (count, 3)) * (1, 1, 0.001)
    scene = dataclasses.replace(
        scene,
        meshes=(scene.meshes[0], ms.mesh(ball, faces, (2,))),
        rows=dataclasses.replace(
            scene.rows,
            mesh=np.array([0] + [1] * count, np.int32),
            to_world=np.concatenate([scene.rows.to_world[:1], to_world]),
            instance_id=np.arange(count + 1, dtype=np.uint32),
            variation=rng.uniform(-1, 1, count + 1).astype(np.float32),
        ),
    )
    # What the first scene of a process compiles and imports is no matter of its size.
    camera = scene.cameras[0][0]
    loaded(field(), 0.0).radiance(camera, 0, 2, 1)
    reset_peak()
    before = peak()
    if before is None:
        pytest.skip("the system does not tell the peak of a process")
    backend = Mitsuba(device="cpu")
    backend.load(scene)
    shown = backend.radiance(camera, 0, 2, 1)
    assert np.isfinite(shown.halves).all()
    assert shown.coverage.mean() > 0.4
    after = peak()
    assert after is not None
    assert after - before < 0.25e9
    assert backend.load_cost.of(scene)[0] < 0.25e9


def test_guides_are_the_surfaces_own_colors_and_normals():
    scene = ms.scene(
        [ms.mesh(*ms.plane(8.0))],
        [ms.surface((0.5, 0.4, 0.3), specular=0.2, roughness=0.5)],
        cameras=[ms.look_at((0, -6, 3.0), (0, 0, 0.0), 16, 12, 120)],
        lights=[ms.sun(40, 20, 500, 3.0)],
    )
    view = scene.cameras[0][0]
    backend = loaded(scene, np.inf)
    albedo, normal = backend._guides(view, 3)
    ground = backend.radiance(view, 0, 64, 1).coverage
    assert (ground == 1.0).any()
    assert (ground == 0.0).any()
    # A fifth of the light goes to white gloss.
    expected = np.broadcast_to([0.6, 0.52, 0.44], albedo[ground == 1.0].shape)
    np.testing.assert_allclose(albedo[ground == 1.0], expected, 1e-5)
    np.testing.assert_allclose(normal[ground == 1.0][:, 2], 1.0, atol=1e-5)
    assert not albedo[ground == 0.0].any()
    assert not normal[ground == 0.0].any()


def test_kept_instances_guide_as_written_ones_do():
    scene = field()
    view = scene.cameras[0][0]
    written, kept = (loaded(scene, most)._guides(view, 3) for most in (np.inf, 0.0))
    for ours, theirs in zip(kept, written, strict=True):
        # The same rays. Normals are mixed before they are made unit vectors, or after.
        assert (np.abs(ours - theirs).max(axis=-1) > 0.01).mean() < 0.01
