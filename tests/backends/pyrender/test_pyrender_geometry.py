"""How pyrender cuts meshes up, and the coarser levels that it draws light with."""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray

from scenec.backends.pyrender.detail import add_levels, border
from scenec.backends.pyrender.geometry import GROUP_FACES, LEVELS, prepare, spatial_order
from scenec.backends.pyrender.tables import make_tables
from scenec.backends.stage.scene import Maps
from scenec.backends.testing import geometry, looks
from scenec.backends.testing import scenes as ms
from scenec.testing import scenes


def test_groups_hold_every_face_once_and_lie_close_together():
    scene = geometry.hills()
    mesh = scene.meshes[0]
    drawn = prepare(scene)
    assert len(drawn.items.group_mesh) == -(-len(mesh.faces) // GROUP_FACES)
    assert sorted(drawn.order.tolist()) == list(range(len(mesh.faces)))
    np.testing.assert_array_equal(drawn.meshes[0].faces, mesh.faces[drawn.order])
    # A quarter of the square, not a stripe across all of it.
    part = mesh.points[mesh.faces[spatial_order(mesh)[:GROUP_FACES]]]
    whole = np.ptp(mesh.points[:, :2], axis=0)
    assert np.all(np.ptp(part.reshape(-1, 3)[:, :2], axis=0) < 0.75 * whole)


def test_each_item_lies_in_its_sphere():
    scene = geometry.field()
    prepared = prepare(scene)
    items = prepared.items
    for item in range(len(items.row)):
        first, count = items.group_faces[items.group[item], 0]
        drawn = prepared.meshes[items.group_mesh[items.group[item]]]
        points = scene.meshes[drawn.mesh].points[np.unique(drawn.faces[first : first + count])]
        matrix = scene.rows.to_world[items.row[item]]
        world = points.astype(float) @ matrix[:, :3].T + matrix[:, 3]
        away = np.linalg.norm(world - items.spheres[item, :3], axis=1)
        assert away.max() <= items.spheres[item, 3] * (1 + 1e-9)


def test_coarser_levels_leave_no_gaps_between_groups_and_lie_close():
    rng = np.random.default_rng(9)
    y, x = np.meshgrid(np.arange(120), np.arange(120), indexing="ij")
    heights = np.sin(x * 0.1) * np.cos(y * 0.13) + rng.normal(size=x.shape) * 1e-3
    scene = scenes.scene([scenes.grid(heights, 0.1)], [(0, scenes.affine())])
    plain = prepare(scene)
    drawn = add_levels(scene, plain)
    mesh, items = drawn.meshes[0], drawn.items
    groups = len(items.group_mesh)
    assert groups > 4
    counts = items.group_faces[:, :, 1].sum(axis=0)
    assert counts[1] < 0.5 * counts[0]
    # Any mixture of levels: on each border edge of a group, as many faces as without levels.
    firsts = items.group_faces[:, 0, 0]
    fixed = border(len(scene.meshes[0].points), plain.meshes[0].faces, firsts)

    def edges(levels: NDArray) -> dict[tuple[int, int], int]:
        counted: dict[tuple[int, int], int] = {}
        for group, level in enumerate(levels):
            first, count = items.group_faces[group, level]
            own: dict[tuple[int, int], int] = {}
            for face in mesh.faces[first : first + count].tolist():
                for a, b in zip(face, face[1:] + face[:1], strict=True):
                    key = (min(a, b), max(a, b))
                    own[key] = own.get(key, 0) + 1
            # The rim of the group.
            for key, number in own.items():
                if number == 1:
                    counted[key] = counted.get(key, 0) + 1
        return counted

    expected = edges(np.zeros(groups, int))
    assert all(fixed[a] and fixed[b] for a, b in expected)
    assert edges(rng.integers(0, LEVELS, groups)) == expected
    assert np.all(np.diff(items.group_error, axis=1) >= 0.0)
    # A wave of 1 m height: a level that leaves out every other vertex is off by millimeters.
    assert items.group_error[:, 1].max() < 0.05


def test_coarser_faces_have_the_coordinates_of_their_vertices(tmp_path):
    picture = looks.write_picture(tmp_path, "base_color")
    surface = dataclasses.replace(ms.surface(), maps=Maps(1.0, base_color=picture, projection="uv"))
    points, faces = ms.icosphere(5)
    uv = looks.smooth_coordinates(points[faces]).astype(np.float32)
    mesh = dataclasses.replace(ms.mesh(points, faces), uv=uv)
    scene = ms.scene([mesh], [surface])
    levels = add_levels(scene, prepare(scene))
    [drawn] = levels.meshes
    assert (drawn.order < 0).sum() > 1000
    tables = make_tables(scene, levels)
    assert tables.meshes[1, 3] == 1
    found = tables.uvs[2:].reshape(-1, 3, 2)
    corners = mesh.points[drawn.faces]
    np.testing.assert_allclose(found, looks.smooth_coordinates(corners), atol=1e-5)
