"""Amodal areas and masks against analytic answers, and against scenes of one instance alone."""

from __future__ import annotations

import dataclasses

import moving_stages as ms
import numpy as np
import pytest
from amodal_looks import look
from hypothesis import given
from hypothesis import strategies as st

from scenec.backends.annotation import outlines as outlining
from scenec.backends.annotation.instances import Instances
from scenec.backends.camera.rays import camera_rays
from scenec.backends.contract import Rays
from scenec.backends.exact import ExactCaster
from scenec.backends.exact.silhouette import RAY_COST, Pinhole, set_direction
from scenec.backends.stage.read import read_stage
from scenec.backends.stage.scene import Camera, RenderScene
from scenec.backends.testing import lights
from scenec.testing import scenes
from scenec.testing.examples import examples

#: Costs of a ray that leave all to rays, to triangles, and to either.
WAYS = (0, 1 << 40, RAY_COST)


def continued_rays(camera: Camera) -> Rays:
    """Rays of the picture continued by its size on each side, by the formula of ``camera_rays``."""
    k, m = camera.intrinsics, camera.camera_to_world
    rows, columns = (np.arange(-n, 2 * n) + 0.5 for n in (camera.height, camera.width))
    v, u = np.meshgrid(rows, columns, indexing="ij")
    y = (v.ravel() - k[1, 2]) / k[1, 1]
    x = (u.ravel() - k[0, 2] - k[0, 1] * y) / k[0, 0]
    directions = np.stack([m[i, 0] * x + m[i, 1] * y + m[i, 2] for i in range(3)], axis=1)
    origins = np.ascontiguousarray(np.broadcast_to(m[:3, 3], directions.shape))
    return Rays(origins, directions, (3 * camera.height, 3 * camera.width))


def alone(scene: RenderScene, number: int, camera: Camera, sample: int = 0) -> np.ndarray:
    """Pixels of the continued picture that show an instance in a scene without all others."""
    rows = scene.rows_at(sample)
    kept = rows.instance_id == number
    only = dataclasses.replace(
        rows, mesh=rows.mesh[kept], to_world=rows.to_world[kept], motion=None, part=None,
        instance_id=rows.instance_id[kept], variation=rows.variation[kept],
    )  # fmt: skip
    rays = continued_rays(camera)
    row, _, _ = ExactCaster(dataclasses.replace(scene, rows=only)).cast(rays)
    return (row >= 0).reshape(rays.shape)


def inside(shown: np.ndarray, camera: Camera) -> np.ndarray:
    return shown[camera.height : 2 * camera.height, camera.width : 2 * camera.width]


def hold_against_scenes_of_one(
    scene: RenderScene,
    camera: Camera,
    sample: int = 0,
    ways: tuple[int, ...] = WAYS,
    numbers: range = range(2**32),
) -> dict[str, np.ndarray]:
    """All columns and masks, whichever way they were found, against ``alone``."""
    made = Instances(scene)
    for way in ways:
        original = outlining.Outliner.outline
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(
                outlining.Outliner, "outline",
                lambda *a, way=way, original=original: original(*a, ray_cost=way),
            )  # fmt: skip
            table, masks, _ = look(scene, camera, sample, made)
        assert masks.ids.tolist() == table["id"].tolist()
        for i, number in enumerate(table["id"].tolist()):
            if number not in numbers:
                continue
            shown = alone(scene, number, camera, sample)
            np.testing.assert_array_equal(masks.mask(i), inside(shown, camera))
            assert table["amodal"][i] == inside(shown, camera).sum()
            assert table["amodal_full"][i] == shown.sum()
            assert table["amodal_bounded"][i] == _within(scene, number, camera, sample)
        assert (table["pixels"] <= table["amodal"]).all()
        assert (table["amodal"] <= table["amodal_full"]).all()
        np.testing.assert_array_equal(masks.areas(), table["amodal"])
    return table


def test_what_is_cut_out_is_of_no_silhouette(tmp_path):
    made = lights.cutout_scene(tmp_path)
    table = hold_against_scenes_of_one(made, made.cameras[0][0])
    solid = dataclasses.replace(
        made, surfaces=tuple(dataclasses.replace(each, maps=None) for each in made.surfaces)
    )
    whole = look(solid, made.cameras[0][0], 0, Instances(solid))[0]
    cards = (table["id"] == 1) | (table["id"] == 2)
    assert cards.sum() == 2
    assert (table["amodal"][cards] < 0.9 * whole["amodal"][cards]).all()
    assert (table["amodal"][cards] > 0).all()


def _within(scene: RenderScene, number: int, camera: Camera, sample: int) -> bool:
    """Whether all vertices project into the continued picture from before the camera."""
    rows = scene.rows_at(sample)
    to_camera = np.linalg.inv(camera.camera_to_world)
    for at in np.flatnonzero(rows.instance_id == number):
        mesh, m = scene.meshes[rows.mesh[at]], rows.to_world[at]
        if not (m[:, :3] != 0).any():
            continue
        world = mesh.points[np.unique(mesh.faces)].astype(float) @ m[:, :3].T + m[:, 3]
        seen = world @ to_camera[:3, :3].T + to_camera[:3, 3]
        if (seen[:, 2] <= 0).any():
            return False
        u, v = ((seen @ camera.intrinsics.T)[:, i] / seen[:, 2] for i in (0, 1))
        if (u < -camera.width).any() or (u > 2 * camera.width).any():
            return False
        if (v < -camera.height).any() or (v > 2 * camera.height).any():
            return False
    return True


# --- Analytic -----------------------------------------------------------------------------------

W, H = 40, 30
#: Looks along +x from the origin; one meter away, a pixel is a centimeter.
CAMERA = dataclasses.replace(
    scenes.camera(W, H), intrinsics=np.array([[100.0, 0, W / 2], [0, 100.0, H / 2], [0, 0, 1]])
)


def quad(u: tuple[float, float], v: tuple[float, float], depth: float) -> np.ndarray:
    """Corners of an upright rectangle that covers these columns and rows of ``CAMERA``."""
    y = [-(c - W / 2) / 100 * depth for c in u]
    z = [-(r - H / 2) / 100 * depth for r in v]
    return np.array([[depth, y[i], z[j]] for i, j in ((0, 0), (1, 0), (1, 1), (0, 1))])


def quads(*corners: np.ndarray, ids: list[int] | None = None) -> RenderScene:
    meshes = [scenes.mesh(c, [[0, 1, 2], [0, 2, 3]]) for c in corners]
    return scenes.scene(meshes, [(i, scenes.affine()) for i in range(len(meshes))], ids)


def columns(table: dict, *names: str) -> list[list[int]]:
    return [[int(table[name][i]) for name in names] for i in range(len(table["id"]))]


AREAS = ("id", "pixels", "amodal", "amodal_full", "amodal_bounded")


def test_a_quad_half_behind_another_keeps_its_whole_area():
    near, far = quad((10.2, 20.2), (5.3, 15.3), 1.0), quad((15.2, 25.2), (5.3, 15.3), 2.0)
    table, masks, _ = look(quads(near, far), CAMERA)
    assert columns(table, *AREAS) == [[1, 100, 100, 100, 1], [2, 50, 100, 100, 1]]
    y, x = np.nonzero(masks.mask(1))
    assert (x.min(), x.max(), y.min(), y.max()) == (15, 24, 5, 14)


def test_a_quad_half_outside_the_picture_is_measured_beyond_its_border():
    table, masks, _ = look(quads(quad((-9.8, 10.2), (-4.7, 5.3), 1.0)), CAMERA)
    assert columns(table, *AREAS) == [[1, 50, 50, 200, 1]]
    assert masks.mask(0).sum() == 50


def test_a_quad_behind_a_wall_but_for_one_pixel_is_whole():
    wall = [quad((0, 40), (0, 10), 1), quad((0, 40), (11, 30), 1), quad((0, 20), (10, 11), 1),
            quad((21, 40), (10, 11), 1)]  # fmt: skip
    scene = quads(*wall, quad((5.2, 35.2), (5.2, 25.2), 3), ids=[1, 1, 1, 1, 7])
    table, masks, _ = look(scene, CAMERA)
    # The wall is one instance of four rows, with a hole of one pixel.
    assert columns(table, *AREAS) == [[1, 1199, 1199, 1199, 1], [7, 1, 600, 600, 1]]
    assert not masks.mask(0)[10, 20]


def test_what_goes_beyond_the_continued_picture_is_said_to():
    table, _, _ = look(quads(quad((-100, 10.2), (0.2, 10.2), 1.0)), CAMERA)
    assert columns(table, *AREAS) == [[1, 100, 100, 500, 0]]
    # Up to its border nothing is missing; beyond, something is.
    for left, bounded in ((-W + 0.01, 1), (-W - 0.01, 0)):
        table, _, _ = look(quads(quad((left, 10.2), (0.2, 10.2), 1.0)), CAMERA)
        assert columns(table, *AREAS) == [[1, 100, 100, 500, bounded]]


def test_the_ground_under_the_camera_reaches_below_the_picture_and_behind():
    corners = np.array([[-50, -500, -1], [500, -500, -1], [500, 500, -1], [-50, 500, -1]], float)
    table = hold_against_scenes_of_one(quads(corners), CAMERA)
    # The horizon is at the middle; depth 500 is less than a row below it.
    assert columns(table, *AREAS) == [[1, W * H // 2, W * H // 2, 3 * W * 3 * H // 2, 0]]


def test_an_instance_that_no_pixel_shows_is_not_listed():
    scene = quads(quad((0, 40), (0, 30), 1), quad((10, 20), (10, 20), 2))
    table, masks, _ = look(scene, CAMERA)
    assert table["id"].tolist() == masks.ids.tolist() == [1]


def test_a_triangle_on_its_edge_is_hit_where_the_definition_says():
    """Edges and vertices through pixel centers, and triangles seen from their edges."""
    # 100 m away, corners are whole multiples of half a meter.
    centers = np.round(quad((10.5, 14.5), (10.5, 14.5), 100.0), 1)
    edge = np.array([[1, 0.005, 0.5], [3, 0.015, 0.5], [2, 0.01, -0.5], [2, 0.01, -0.5]], float)
    scene = quads(centers, edge)
    hold_against_scenes_of_one(scene, CAMERA)
    table, _, _ = look(quads(centers), CAMERA)
    assert columns(table, "amodal") == [[25]]


# --- Drawn scenes -------------------------------------------------------------------------------


@st.composite
def crowds(draw):
    """Instances of several rows all around a camera: mirrored, flat, sheared, near, behind."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32)))
    ball, faces = scenes.icosphere(draw(st.integers(0, 2)))
    meshes = [scenes.mesh(ball * rng.uniform(0.6, 1.0, 3), faces)]
    points = rng.normal(size=(9, 3))
    if draw(st.booleans()):
        points = np.round(points)
    meshes.append(scenes.mesh(points, rng.integers(0, 9, (draw(st.integers(1, 12)), 3))))
    # A point that no face uses.
    meshes.append(scenes.mesh([[0, 0, 0], [0, 2, 0], [0, 0, 2], [90, 90, 90]], [[0, 1, 2]]))
    middle = np.round(rng.normal(size=3) * 10.0 ** draw(st.floats(-1, 5)), 3)
    spread = draw(st.sampled_from([0.5, 2.0, 6.0]))
    rows, ids = [], []
    for number in range(1, draw(st.integers(1, 5)) + 1):
        for _ in range(draw(st.integers(1, 3))):
            shape = draw(
                st.sampled_from(
                    [(1, 1, 1), (1, 1, 1), (-1, 1, 1), (1, 1, 0), (1, 1, 1e-9), (0, 0, 0)]
                )
            )
            linear = scenes.rotation(rng) * 10.0 ** rng.uniform(-1, 0.7) * np.array(shape)
            if draw(st.booleans()):
                linear = linear @ np.array([[1, 0.7, -0.2], [0, 1, 0.5], [0, 0, 1]])
            offset = middle + rng.normal(size=3) * spread + [1.5, 0, 0]
            rows.append((int(rng.integers(3)), scenes.affine(linear, offset)))
            ids.append(number)
    # The first of two equal rows shows; the other's silhouette is as large.
    if draw(st.booleans()):
        rows.append(rows[0])
        ids.append(99)
    width, height = draw(st.sampled_from([(1, 1), (12, 9), (24, 5), (3, 16)]))
    camera = scenes.camera(
        width, height, draw(st.sampled_from([20.0, 65.0, 120.0])), middle, middle + np.eye(3)[0]
    )
    k = camera.intrinsics.copy()
    if draw(st.booleans()):
        k += [[0, rng.normal(), rng.normal() * width], [0, rng.normal() * 0.1, rng.normal()],
              [0, 0, 0]]  # fmt: skip
    return scenes.scene(meshes, rows, ids), dataclasses.replace(camera, intrinsics=k)


@examples(40)
@given(crowds())
def test_silhouettes_are_those_of_scenes_of_one_instance(case):
    hold_against_scenes_of_one(*case)


def test_rocks_on_rough_ground_have_the_silhouettes_of_each_alone():
    scene = scenes.rocky(100, 40, 10.0, 1, subdivisions=2)
    # The ground, too, which goes on behind the camera.
    ids = scene.rows.instance_id.copy()
    ids[0] = 1000
    scene = dataclasses.replace(scene, rows=dataclasses.replace(scene.rows, instance_id=ids))
    view = scene.cameras[0][1]
    small = scenes.camera(96, 72, 65.0, view.camera_to_world[:3, 3],
                          view.camera_to_world[:3, 3] + view.camera_to_world[:3, 2])  # fmt: skip
    table = hold_against_scenes_of_one(scene, small, ways=(0, 1 << 40))
    assert table["amodal_bounded"].min() == 0
    assert (table["pixels"] < table["amodal"]).any()


def test_a_camera_inside_of_an_instance_sees_it_everywhere():
    ball, faces = scenes.icosphere(2)
    scene = scenes.scene([scenes.mesh(ball, faces)], [(0, scenes.affine(3.0))])
    for camera in (scenes.camera(16, 12), scenes.camera(1, 1)):
        table = hold_against_scenes_of_one(scene, camera)
        size = camera.width * camera.height
        assert columns(table, *AREAS) == [[1, size, size, 9 * size, 0]]


def test_moving_parts_are_outlined_where_they_are(tmp_path):
    scene = read_stage(ms.write_stage(tmp_path / "m.usda"))
    areas = []
    for sample in range(ms.SAMPLES):
        camera = dataclasses.replace(scene.cameras[sample][0], width=80, height=60)
        k = camera.intrinsics * np.array([[0.5], [0.5], [1.0]])
        camera = dataclasses.replace(camera, intrinsics=k)
        table = hold_against_scenes_of_one(scene, camera, sample, (RAY_COST,), range(58, 104))
        areas.append(table["amodal"][table["id"] == 101].tolist())
    assert len({tuple(area) for area in areas}) == ms.SAMPLES


def test_rays_of_silhouettes_are_those_of_the_picture_to_the_bit():
    rng = np.random.default_rng(4)
    camera = scenes.camera(31, 17, 63.0, rng.normal(size=3) * 9, rng.normal(size=3))
    k = camera.intrinsics + np.array([[0.1, 0.3, 0.7], [0, 0.2, -0.9], [0, 0, 0]])
    camera = dataclasses.replace(camera, intrinsics=k)
    expected = camera_rays(camera).directions.reshape(17, 31, 3)
    found, view = np.empty(3), Pinhole.of(camera)
    for row, column in np.ndindex(17, 31):
        set_direction(view, column, row, found)
        assert found.tobytes() == expected[row, column].tobytes()


def test_windows_in_several_groups_give_the_same(monkeypatch):
    scene = scenes.rocky(150, 40, 10.0, 3, subdivisions=1)
    camera = scenes.camera(96, 72, 65.0, (0, 0, 3.0), (4, 0, 0))
    table, masks, _ = look(scene, camera)
    monkeypatch.setattr(outlining, "_AT_ONCE", 500)
    again, other, _ = look(scene, camera)
    assert len(table["id"]) > 20
    for name in AREAS:
        np.testing.assert_array_equal(again[name], table[name])
    np.testing.assert_array_equal(other.counts, masks.counts)
    np.testing.assert_array_equal(other.starts, masks.starts)
