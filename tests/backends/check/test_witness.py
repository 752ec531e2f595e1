"""What a renderer sees is held against the annotation: a hair is let pass, a mistake is not."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from scenec.backends.camera.rays import camera_rays
from scenec.backends.check.witness import HAIR_PIXELS, Witness
from scenec.backends.contract import NO_ROW, Visibility
from scenec.backends.exact import ExactCaster
from scenec.schemas.errors import BackendError
from scenec.testing import scenes


@pytest.fixture(scope="module")
def rocks():
    """Ground with 800 rocks; scene, caster, rays and exact hits."""
    scene = scenes.rocky(800, 120, 40.0, seed=4, subdivisions=2)
    view = scenes.camera(
        200, 150, 65.0, scene.cameras[0][0].camera_to_world[:3, 3], (9.0, 2.0, -0.5)
    )
    caster, rays = ExactCaster(scene), camera_rays(view)
    return scene, caster, rays, caster.hits(rays)


def held(caster, rays, seen) -> Witness:
    witness = Witness()
    witness.add(caster, rays, seen)
    return witness


def turned(rays, pixels):
    """The same rays, each moved to the right by a part of a pixel."""
    beside = np.roll(rays.directions.reshape(*rays.shape, 3), -1, axis=1)
    beside[:, -1] = rays.directions.reshape(*rays.shape, 3)[:, -1]
    step = beside.reshape(-1, 3) - rays.directions
    return dataclasses.replace(rays, directions=rays.directions + pixels * step)


def test_the_exact_answer_differs_nowhere(rocks):
    _scene, caster, rays, hits = rocks
    witness = held(caster, rays, Visibility(hits.row, hits.face))
    assert (witness.differing, witness.beyond, witness.farthest_px) == (0, 0, 0.0)


@pytest.mark.parametrize("pixels", [1e-6, 1e-3, 0.9 * HAIR_PIXELS])
def test_rays_moved_by_less_than_a_hair_pass(rocks, pixels):
    _scene, caster, rays, _hits = rocks
    moved = caster.hits(turned(rays, pixels))
    witness = held(caster, rays, Visibility(moved.row, moved.face))
    assert witness.beyond == 0
    assert witness.farthest_px <= HAIR_PIXELS
    assert pixels < 1e-3 or witness.differing > 3


@pytest.mark.parametrize("pixels", [0.1, 0.5, 1.0])
def test_rays_moved_by_more_do_not(rocks, pixels):
    _scene, caster, rays, _hits = rocks
    moved = caster.hits(turned(rays, pixels))
    witness = held(caster, rays, Visibility(moved.row, moved.face))
    assert witness.beyond > 20
    assert witness.farthest_px > HAIR_PIXELS


def without(scene, row):
    """The same scene, one row moved away, numbered as before."""
    rows = dataclasses.replace(scene.rows, to_world=scene.rows.to_world.copy())
    rows.to_world[row, :, 3] += 1e4
    return dataclasses.replace(scene, rows=rows)


def test_one_stone_that_a_renderer_has_lost_is_found(rocks):
    scene, caster, rays, hits = rocks
    ids, pixels = np.unique(hits.row[hits.row > 0], return_counts=True)
    stone = ids[pixels == pixels[pixels > 8].min()][0]
    seen = ExactCaster(without(scene, stone)).hits(rays)
    witness = held(caster, rays, Visibility(seen.row, seen.face))
    assert witness.differing == (hits.row == stone).sum()
    assert witness.beyond > 0.5 * witness.differing


def test_one_stone_that_only_a_renderer_has_is_found(rocks):
    scene, _caster, rays, hits = rocks
    ids, pixels = np.unique(hits.row[hits.row > 0], return_counts=True)
    stone = ids[pixels == pixels[pixels > 8].min()][0]
    caster = ExactCaster(without(scene, stone))
    witness = held(caster, rays, Visibility(hits.row, hits.face))
    assert witness.beyond == witness.differing > 8


def test_a_renderer_that_sees_nothing_or_nonsense_is_found(rocks):
    _scene, caster, rays, hits = rocks
    n = len(hits.row)
    nothing = Visibility(np.full(n, NO_ROW, np.int32), np.zeros(n, np.int32))
    assert held(caster, rays, nothing).beyond > 0.9 * (hits.row != NO_ROW).sum()
    nonsense = Visibility(np.full(n, 10**6, np.int32), hits.face)
    witness = held(caster, rays, nonsense)
    assert witness.beyond == n
    assert np.isinf(witness.farthest_px)


def test_either_of_two_surfaces_in_one_place_is_a_fair_answer():
    ball, faces = scenes.icosphere(1)
    m = scenes.affine(1.0, (3.0, 0.0, 0.0))
    scene = scenes.scene([scenes.mesh(ball, faces)], [(0, m), (0, m)])
    rays = camera_rays(scenes.camera(20, 14, 60.0))
    caster = ExactCaster(scene)
    hits = caster.hits(rays)
    assert (hits.row == 0).any()
    other = Visibility(np.where(hits.row == 0, 1, NO_ROW).astype(np.int32), hits.face)
    witness = held(caster, rays, other)
    assert witness.differing == (hits.row == 0).sum()
    assert witness.beyond == 0


def test_pixels_without_a_ray_do_not_count(rocks):
    _scene, caster, rays, hits = rocks
    known = np.zeros(len(hits.row), bool)
    known[:100] = True
    n = len(hits.row)
    nothing = Visibility(np.full(n, NO_ROW, np.int32), np.zeros(n, np.int32))
    witness = held(caster, dataclasses.replace(rays, known=known), nothing)
    assert witness.pixels == 100
    assert witness.differing == (hits.row[:100] != NO_ROW).sum()


def test_a_witness_of_another_size_is_an_error(rocks):
    _scene, caster, rays, hits = rocks
    with pytest.raises(BackendError, match="one per ray"):
        held(caster, rays, Visibility(hits.row[1:], hits.face[1:]))


def test_a_ray_that_slips_between_faces_passes_and_one_through_a_face_does_not(rocks):
    _scene, caster, rays, hits = rocks
    there = np.where(hits.row != NO_ROW, hits.t, 1.0)[:, None] * (1.0 + 3e-6)
    behind = caster.hits(dataclasses.replace(rays, origins=rays.origins + there * rays.directions))
    beside = caster.hits(turned(rays, 0.5 * HAIR_PIXELS))
    edge = (hits.row != NO_ROW) & (hits.row == beside.row) & (hits.face != beside.face)
    for where, beyond in ((np.flatnonzero(edge), False), (np.flatnonzero(~edge)[::97], True)):
        row, face = hits.row.copy(), hits.face.copy()
        row[where], face[where] = behind.row[where], behind.face[where]
        witness = held(caster, rays, Visibility(row, face))
        assert witness.differing > 20
        assert (witness.beyond > 0.5 * witness.differing) == beyond
        assert beyond or witness.beyond == 0


@pytest.mark.parametrize(
    ("pixels", "beyond"), [(1e-3, False), (0.5, False), (3.0, True), (30.0, True)]
)
def test_a_tip_that_a_ray_passes_within_a_hair_is_a_fair_answer(pixels, beyond):
    """A needle ends beside the ray; on a wall behind it, and on nothing."""
    rays = camera_rays(scenes.camera(20, 14, 60.0))
    middle = 7 * 20 + 10
    ray = rays.directions[middle]
    # Between two of the rings' eight directions, and narrower than they are apart.
    across, down = rays.directions[middle + 1] - ray, rays.directions[middle + 20] - ray
    away = np.cos(np.pi / 8) * across + np.sin(np.pi / 8) * down
    tip = 3.0 * (ray + pixels * HAIR_PIXELS * away)
    wide = 1e-3 * np.cross(ray, away) / np.linalg.norm(np.cross(ray, away))
    needle = np.array([tip, tip + 3.0 * away + wide, tip + 3.0 * away - wide])
    wall = np.array([[9.0, -40.0, -40.0], [9.0, 40.0, -40.0], [9.0, 0.0, 60.0]])
    one = np.array([[0, 1, 2]], np.int32)
    meshes = [scenes.mesh(needle, one), scenes.mesh(wall, one)]
    here = np.eye(4)[:3]
    for rows in ([(0, here), (1, here)], [(0, here)]):
        caster = ExactCaster(scenes.scene(meshes, rows))
        hits = caster.hits(rays)
        assert hits.row[middle] == (1 if len(rows) == 2 else NO_ROW)
        row, face = hits.row.copy(), hits.face.copy()
        row[middle] = face[middle] = 0
        witness = held(caster, rays, Visibility(row, face))
        assert witness.differing == 1
        assert witness.beyond == beyond


def test_the_far_side_of_a_stone_is_no_fair_answer():
    """What a renderer shows that culls the faces in front."""
    ball, faces = scenes.icosphere(3)
    scene = scenes.scene([scenes.mesh(ball, faces)], [(0, scenes.affine(1.0, (3.0, 0.0, 0.0)))])
    rays = camera_rays(scenes.camera(60, 40, 60.0))
    caster = ExactCaster(scene)
    behind = dataclasses.replace(rays, origins=rays.origins + 9.0 * rays.directions,
                                 directions=-rays.directions)  # fmt: skip
    seen = caster.hits(behind)
    witness = held(caster, rays, Visibility(seen.row, seen.face))
    assert witness.differing > 300
    assert witness.beyond > 0.8 * witness.differing
