"""The nearest surface in a pyramid, against linear programs and against rays within it."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.optimize import linprog
from test_exact import soups, table

from scenec.backends.exact import ExactCaster
from scenec.backends.exact.nearest import Pyramids, nearest
from scenec.backends.stage.scene import Motion, RenderScene
from scenec.backends.testing.scenes import plane
from scenec.testing import scenes
from scenec.testing.examples import examples


def pyramid(
    eye: NDArray, turn: NDArray, window: tuple[float, float, float, float], slack: float = 0.0
) -> Pyramids:
    """Along the third column of ``turn``, between tangents left, right, top, bottom."""
    x, y, z = turn.T
    left, right, top, bottom = window
    normals = np.array([x - left * z, right * z - x, y - top * z, bottom * z - y, z])
    normals /= np.sqrt((normals * normals).sum(axis=1))[:, None]
    return Pyramids(np.array([eye], float), normals[None], np.array([slack]))


def by_linear_programs(scene: RenderScene, of: Pyramids, sample: int = 0) -> float:
    """The least depth of convex combinations of each triangle's corners that are inside."""
    best = math.inf
    rows = scene.rows_at(sample)
    normals = of.normals[0]
    for which, m in zip(rows.mesh, rows.to_world, strict=True):
        if not m[:, :3].any():
            # A row scaled to a point has no surface.
            continue
        mesh = scene.meshes[which]
        world = mesh.points.astype(float) @ m[:, :3].T + m[:, 3] - of.eyes[0]
        for corners in world[mesh.faces]:
            found = linprog(
                corners @ normals[4], A_ub=-(normals @ corners.T), b_ub=np.full(5, of.slack[0]),
                A_eq=np.ones((1, 3)), b_eq=[1.0],
            )  # fmt: skip
            if found.status == 0:
                best = min(best, float(found.fun))
    return best


def several(rng: np.random.Generator) -> RenderScene:
    """Triangles in turned, mirrored and flattened rows about the origin."""
    meshes = [
        scenes.mesh(rng.normal(size=(6, 3)), rng.integers(0, 6, (int(rng.integers(1, 7)), 3)))
        for _ in range(2)
    ]
    shapes = [(1, 1, 1), (1, 1, -1), (2, 0.5, 0.0), (0, 0, 0)]
    rows = [
        (
            int(rng.integers(2)),
            scenes.affine(scenes.rotation(rng) * shape, 2.0 * rng.normal(size=3)),
        )
        for shape in shapes
    ]
    return scenes.scene(meshes, rows)


@examples(40)
@given(st.integers(0, 2**32), st.sampled_from([0.0, 0.05, 0.7]))
def test_the_least_depth_is_that_of_linear_programs(seed: int, slack: float) -> None:
    rng = np.random.default_rng(seed)
    scene = several(rng)
    sides = np.sort(rng.uniform(-1.5, 1.5, (2, 2)), axis=1)
    of = pyramid(3.0 * rng.normal(size=3), scenes.rotation(rng), (*sides[0], *sides[1]), slack)
    found = nearest(ExactCaster(scene).geometry, of)[0]
    assert found == pytest.approx(by_linear_programs(scene, of), abs=1e-6)


@examples(25)
@given(soups())
def test_no_ray_within_a_pyramid_meets_anything_nearer(case) -> None:
    """Between corners of a lattice of rays, whatever the scales."""
    scene, rays = case
    caster = ExactCaster(scene)
    rng = np.random.default_rng(1)
    for eye, way in zip(rays.origins[:8], rays.directions[:8], strict=True):
        z = way / np.sqrt((way * way).sum())
        x = np.cross(z, np.eye(3)[np.argmin(np.abs(z))])
        x /= np.sqrt((x * x).sum())
        turn = np.stack([x, np.cross(z, x), z], axis=1)
        near = nearest(caster.geometry, pyramid(eye, turn, (-0.3, 0.2, -0.1, 0.4)))[0]
        inside = rng.uniform((-0.299, -0.099), (0.199, 0.399), (200, 2))
        # The axis itself aims at a triangle.
        ways = np.column_stack([np.vstack([inside, [[0.0, 0.0]]]), np.ones(201)]) @ turn.T
        t = caster.cast(table(eye, ways))[2]
        scale = np.abs(eye).max() + caster.geometry.extent
        assert t.min() >= near * (1.0 - 1e-9) - 1e-9 * scale


def test_rows_that_move_are_found_where_they_are() -> None:
    rng = np.random.default_rng(8)
    scene = several(rng)
    path = np.stack([scene.rows.to_world, scene.rows.to_world])
    path[1, 1:3, :, 3] += [[3.0, 0.0, 0.0], [0.0, -2.0, 1.0]]
    moves = np.array([1, 2], np.int32)
    moving = replace(
        scene, samples=2, rows=replace(scene.rows, motion=Motion(moves, path[:, moves].copy()))
    )
    caster = ExactCaster(moving)
    seen = 0
    for sample in (1, 0):
        caster.pose(sample)
        for _ in range(12):
            of = pyramid(3.0 * rng.normal(size=3), scenes.rotation(rng), (-0.8, 0.9, -0.7, 0.8))
            found = nearest(caster.geometry, of)[0]
            assert found == pytest.approx(by_linear_programs(moving, of, sample), abs=1e-6)
            seen += found < math.inf
    assert seen > 5


def test_a_wall_of_many_triangles_is_at_its_distance_and_nothing_is_behind_it() -> None:
    points, faces = plane(50.0, 40)
    scene = scenes.scene([scenes.mesh(points, faces)], [(0, scenes.affine())])
    up, down = np.diag([1.0, 1.0, 1.0]), np.diag([1.0, -1.0, -1.0])
    geometry = ExactCaster(scene).geometry
    window = (-0.01, 0.013, -0.02, 0.004)
    eye = np.array([3.21, -7.5, 4.0])
    assert nearest(geometry, pyramid(eye, down, window))[0] == pytest.approx(4.0, rel=1e-12)
    assert nearest(geometry, pyramid(eye, up, window))[0] == math.inf
    # Looking along the ground, it is as far as the lower side of the window meets it.
    ahead = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
    slanted = nearest(geometry, pyramid(eye, ahead, (-0.1, 0.1, 0.1, 0.2)))[0]
    assert slanted == pytest.approx(20.0, rel=1e-9)
