"""Stages as models: simplified meshes stay where they were, mixed ground keeps its colors."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from scenec.backends.model.bake import box_uv
from scenec.backends.model.collect import _look, coarse_model, whole_model
from scenec.backends.model.colors import colors_at
from scenec.backends.model.simplify import simplify
from scenec.backends.stage.read import read_stage
from scenec.backends.stage.scene import Maps, Reading, RenderScene, Surface
from scenec.cli.main import main
from scenec.schemas.model import Model
from scenec.schemas.picture import srgb_bytes
from scenec.testing.small import small_cfg, write_cfg


@pytest.fixture(scope="module")
def scene(tmp_path_factory) -> RenderScene:
    folder = tmp_path_factory.mktemp("model")
    out = folder / "out"
    assert main(["compile", str(write_cfg(folder, small_cfg())), "-o", str(out), "--no-cache"]) == 0
    return read_stage(out / "batch_0000" / "stage.usda")


def grid(side: int) -> tuple[np.ndarray, np.ndarray]:
    """A plane of side² squares, two triangles each."""
    y, x = np.mgrid[: side + 1, : side + 1].astype(float)
    points = np.column_stack([x.ravel(), y.ravel(), np.zeros(x.size)])
    corner = (np.arange(side)[:, None] * (side + 1) + np.arange(side)).ravel()
    right, up = corner + 1, corner + side + 1
    faces = np.concatenate(
        [np.column_stack([corner, right, up + 1]), np.column_stack([corner, up + 1, up])]
    )
    return points, faces.astype(np.int32)


def area(points: np.ndarray, faces: np.ndarray) -> float:
    a, b, c = points[faces].transpose(1, 0, 2)
    return float(np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2)


def test_a_mesh_of_few_triangles_is_left_as_it_is():
    points, faces = grid(4)
    same = simplify(points, faces, len(faces))
    assert np.array_equal(same.points, points)
    assert np.array_equal(same.faces, faces)


@pytest.mark.parametrize("most", [40, 400, 1500])
def test_a_plane_stays_a_plane_without_holes_or_folds(most):
    points, faces = grid(40)
    small = simplify(points, faces, most)
    assert most / 4 < len(small.faces) <= most
    assert np.all(small.points[:, 2] == 0.0)
    # Cells at the border shrink by half a cell at most; nothing is covered twice.
    lost = 4 * 40 * np.sqrt(1600 / len(small.faces) * 2)
    assert 1600 - lost <= area(small.points, small.faces) <= 1600
    # Each face lies near the one that it was.
    before = points[faces[small.kept]].mean(axis=1)
    after = small.points[small.faces].mean(axis=1)
    assert np.abs(before - after).max() < 3 * np.sqrt(2 * 1600 / len(small.faces))


def test_triangles_are_finest_where_one_looks_from():
    points, faces = grid(60)
    small = simplify(points, faces, 700, np.array([[0.0, 0.0, 1.0]]))
    middles = small.points[small.faces].mean(axis=1)
    near = (np.hypot(middles[:, 0], middles[:, 1]) < 20).mean()
    assert near > 2 * (np.pi * 20**2 / 4) / 60**2


def test_values_of_clusters_are_means():
    points, faces = grid(30)
    small = simplify(points, faces, 300)
    assert np.allclose(small.mean(points), small.points)


def instances(model: Model) -> dict[int, np.ndarray]:
    """Frame id to the matrices that it stands at, without those of further parts."""
    return {
        int(number): matrix
        for place in model.placements
        for number, matrix in zip(place.ids, place.to_world, strict=True)
        if number
    }


def test_a_whole_model_has_each_triangle_and_instance_of_the_stage(scene):
    model = whole_model(scene, "b", texels=1 << 14)
    rows = scene.rows
    triangles = sum(len(scene.meshes[m].faces) for m in rows.mesh)
    assert triangles == sum(
        len(p.ids) * sum(len(model.parts[part].faces) for part in p.parts) for p in model.placements
    )
    found = instances(model)
    assert set(found) == set(rows.instance_id[rows.instance_id != 0].tolist())
    for row in np.flatnonzero(rows.instance_id != 0)[::7]:
        matrix = rows.to_world[row].copy()
        matrix[:, 3] -= model.origin
        assert np.array_equal(found[int(rows.instance_id[row])], matrix)


def test_a_coarse_model_keeps_within_its_room_and_says_what_went(scene):
    model = coarse_model(scene, "b", ground_faces=500, object_faces=200, instances=5)
    ground, *objects = model.parts
    all_ground = sum(
        len(scene.meshes[m].faces) for m in scene.rows.mesh[scene.rows.instance_id == 0]
    )
    assert len(ground.faces) <= 500 < all_ground
    assert all(set(part.labels) == set(scene.levels) for part in model.parts)
    assert sum(len(p.ids) for p in model.placements if p.owner) == 5
    assert objects
    text = "\n".join(model.losses)
    assert f"of {all_ground:,} triangles" in text
    assert "look smallest" in text
    # It is still where the stage is.
    low, high = (
        (ground.points + model.origin).min(axis=0),
        (ground.points + model.origin).max(axis=0),
    )
    assert np.all(low >= scene.bounds[0] - 1e-3)
    assert np.all(high <= scene.bounds[1] + 1e-3)


def test_what_is_baked_are_the_colors_of_the_mixed_surface(scene):
    model = whole_model(scene, "b", texels=1 << 16)
    row = int(np.flatnonzero(scene.rows.instance_id == 0)[0])
    mesh = scene.meshes[scene.rows.mesh[row]]
    part = next(p for p in model.parts if p.path == mesh.path)
    picture = model.looks[part.look].picture
    assert isinstance(picture, np.ndarray)
    # At the middles of triangles: the texel there against the definition.
    corners = mesh.faces
    shares = np.full((len(corners), 3), 1 / 3)
    matrix = scene.rows.to_world[row]
    world = mesh.points.astype(float) @ matrix[:, :3].T + matrix[:, 3]
    middle = world[corners].mean(axis=1)
    up = np.tile([0.0, 0.0, 1.0], (len(corners), 1))
    wanted = srgb_bytes(colors_at(scene, mesh, corners, shares, middle, up)).astype(int)
    assert part.uv is not None
    u, v = part.uv.mean(axis=1).T
    side = len(picture)
    column = np.clip((u * side).astype(int), 0, side - 1)
    line = np.clip(((1 - v) * side).astype(int), 0, side - 1)
    off = np.abs(picture[line, column].astype(int) - wanted).max(axis=1)
    assert np.median(off) <= 3
    assert wanted.std(axis=0).max() > 0 or off.max() <= 3


def test_texture_coordinates_of_a_box_keep_lengths_along_its_sides():
    points = np.array([[0, 0, 0], [2, 0, 0], [2, 3, 0], [0, 0, 5], [2, 0, 5]], np.float32)
    faces = np.array([[0, 1, 2], [0, 1, 4]], np.int32)
    uv = box_uv(points, faces, 0.5)
    assert np.array_equal(uv[0], np.array([[0, 0], [4, 0], [4, 6]], np.float32))
    assert np.array_equal(uv[1], np.array([[0, 0], [4, 0], [4, 10]], np.float32))


def test_a_model_of_a_stage_without_cameras_and_objects(tmp_path: Path):
    file = tmp_path / "plain.usda"
    file.write_text(
        '#usda 1.0\n(\n    defaultPrim = "World"\n    metersPerUnit = 1\n    upAxis = "Z"\n)\n'
        'def Xform "World"\n{\n    def Mesh "Plane"\n    {\n        int[] faceVertexCounts = [3]\n'
        "        int[] faceVertexIndices = [0, 1, 2]\n"
        "        point3f[] points = [(0, 0, 0), (8, 0, 0), (0, 8, 0)]\n"
        '        uniform token subdivisionScheme = "none"\n    }\n}\n'
    )
    plain = read_stage(file)
    model = coarse_model(plain, "b", ground_faces=10, object_faces=10, instances=10)
    assert [len(part.faces) for part in model.parts] == [1]
    assert np.allclose(model.parts[0].points + model.origin, [(0, 0, 0), (8, 0, 0), (0, 8, 0)])


def test_objects_without_ids_are_instances_all_the_same(tmp_path: Path):
    out = tmp_path / "out"
    cfg = write_cfg(tmp_path, small_cfg(outputs=["depth"]))
    assert main(["compile", str(cfg), "-o", str(out), "--no-cache"]) == 0
    plain = read_stage(out / "batch_0000" / "stage.usda")
    assert not plain.rows.instance_id.any()
    model = coarse_model(plain, "b", ground_faces=10**6, object_faces=10**6, instances=10**6)
    tiles = [m for m in plain.meshes if m.path.startswith("/World/Terrain/")]
    assert len(model.parts[0].faces) == sum(len(mesh.faces) for mesh in tiles)
    assert {place.owner for place in model.placements} == {"", "/World/Objects/rocks"}
    assert model.instances == len(plain.rows.mesh) - len(tiles)


@pytest.mark.parametrize(
    ("reading", "kept", "color"),
    [
        (Reading(), True, (0.5, 0.25, 1.0)),
        (Reading(srgb=True, scale=(0.5, 1.0, 0.5)), True, (0.25, 0.25, 0.5)),
        (Reading(srgb=False), False, None),
        (Reading(bias=(0.1, 0.0, 0.0)), False, None),
    ],
)
def test_a_picture_stays_one_where_a_color_can_multiply_it(tmp_path, reading, kept, color):
    file = tmp_path / "red.png"
    Image.new("RGB", (4, 4), (255, 0, 0)).save(file)
    maps = Maps(1.0, base_color=file, projection="uv", readings=(("base_color", reading),))
    look = _look(Surface("/World/Looks/red", (0.5, 0.25, 1.0), 0.0, 0.5, 0.0, maps=maps), "x")
    assert look.name == "red"
    assert (look.picture == file) is kept
    if kept:
        assert look.base_color == color
    else:
        assert look.base_color[0] == pytest.approx(0.5 * min(1.0, 1.0 + reading.bias[0]), rel=0.11)
        assert look.base_color[1] == 0.0
