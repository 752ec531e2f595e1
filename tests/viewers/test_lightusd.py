"""A reader of USD that is not Pixar's finds in our stages what our reader finds, to the bit."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import viewer_scene

from scenec.backends.stage.read import read_stage
from scenec.backends.stage.scene import RenderScene
from scenec.schemas import materialx
from scenec.schemas import stage as names

lightusd = pytest.importorskip("lightusd")
ROCKS = "/World/Objects/rocks"


@pytest.fixture(scope="module")
def path(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("viewer")
    return viewer_scene.compiled(folder, viewer_scene.viewer_cfg())


@pytest.fixture(scope="module")
def scene(path) -> RenderScene:
    return read_stage(path)


@pytest.fixture(scope="module")
def stage(path):
    return lightusd.load(str(path))


def array(stage, prim: str, name: str) -> np.ndarray:
    return np.asarray(stage.prim_at(prim)[name])


def test_meshes_have_our_points_faces_labels_weights_and_normals(stage, scene):
    for mesh in scene.meshes:
        np.testing.assert_array_equal(array(stage, mesh.path, "points"), mesh.points)
        indices = array(stage, mesh.path, "faceVertexIndices")
        np.testing.assert_array_equal(indices.reshape(-1, 3), mesh.faces)
        assert (array(stage, mesh.path, "faceVertexCounts") == 3).all()
        np.testing.assert_array_equal(array(stage, mesh.path, "normals"), mesh.normals)
        for i, weight in enumerate(mesh.weights, start=1):
            name = f"primvars:{names.weight_primvar(i)}"
            np.testing.assert_array_equal(array(stage, mesh.path, name), weight)
        for level in scene.levels:
            holder = ROCKS if mesh.path.startswith(ROCKS) else mesh.path
            theirs = array(stage, holder, f"primvars:{names.label_primvar(level)}")
            np.testing.assert_array_equal(
                np.broadcast_to(theirs, len(mesh.faces)), mesh.labels[level]
            )
    assert {len(mesh.layers) for mesh in scene.meshes} == {1, 3}


def test_instances_have_our_ids_prototypes_and_transforms(stage, scene):
    rows = np.flatnonzero(scene.rows.instance_id)
    base = int(array(stage, ROCKS, names.ATTR_INSTANCE_ID_BASE))
    ids = base + array(stage, ROCKS, "ids")
    assert len(ids) == len(rows) == 300
    order = np.argsort(scene.rows.instance_id[rows])
    np.testing.assert_array_equal(np.sort(ids), scene.rows.instance_id[rows][order])
    of = np.argsort(ids)
    targets = stage.prim_at(ROCKS).relationship("prototypes").targets
    theirs = [targets[i] for i in array(stage, ROCKS, "protoIndices")[of]]
    assert theirs == [scene.meshes[mesh].path for mesh in scene.rows.mesh[rows][order]]
    to_world = scene.rows.to_world[rows][order]
    positions = array(stage, ROCKS, "positions")[of]
    np.testing.assert_array_equal(to_world[:, :, 3], positions.astype(float))
    # It gives quaternions as (w, x, y, z).
    w, x, y, z = array(stage, ROCKS, "orientations")[of].astype(float).T
    n = w * w + x * x + y * y + z * z
    rotation = np.array(
        [[w * w + x * x - y * y - z * z, 2 * (x * y - z * w), 2 * (x * z + y * w)],
         [2 * (x * y + z * w), w * w - x * x + y * y - z * z, 2 * (y * z - x * w)],
         [2 * (x * z - y * w), 2 * (y * z + x * w), w * w - x * x - y * y + z * z]]
    ).transpose(2, 0, 1) / n[:, None, None]  # fmt: skip
    scales = array(stage, ROCKS, "scales")[of].astype(float)
    expected = rotation * scales[:, None, :]
    np.testing.assert_allclose(to_world[:, :, :3], expected, rtol=0, atol=1e-14)


def test_cameras_have_our_poses_and_intrinsics(stage, scene):
    for sample in range(scene.samples):
        for camera in scene.cameras[sample]:
            intrinsics = array(stage, camera.path, names.ATTR_INTRINSICS)
            np.testing.assert_array_equal(intrinsics.reshape(3, 3), camera.intrinsics)
            rig = stage.prim_at(camera.path.rsplit("/", 1)[0])
            local = array(stage, camera.path, "xformOp:transform").reshape(4, 4)
            world = np.asarray(rig.attribute("xformOp:transform").get(time=float(sample)))
            pose = (local @ world.reshape(4, 4)).T @ np.diag([1, -1, -1, 1])
            np.testing.assert_allclose(pose, camera.camera_to_world, rtol=0, atol=1e-14)


def test_the_ground_s_materials_inherit_the_whole_network_of_the_mix(stage, scene):
    (ground,) = [mesh for mesh in scene.meshes if len(mesh.layers) > 1]
    targets = stage.prim_at(ground.path).relationship(names.REL_LAYERS).targets
    assert list(targets) == [scene.surfaces[i].path for i in ground.layers]
    mix = {prim.name for prim in stage if prim.path.startswith("/World/GroundMix/")}
    assert len(mix) > 10
    for material in targets:
        nodes = {prim.name: prim for prim in stage if prim.path.startswith(f"{material}/")}
        assert mix < set(nodes)
        assert {nodes[name]["info:id"] for name in mix} <= set(materialx.NODES)
