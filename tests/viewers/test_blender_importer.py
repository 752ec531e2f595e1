"""Blender's own USD importer finds in our stages what our reader finds."""

from __future__ import annotations

import importlib.util
from pathlib import Path

import numpy as np
import pytest
import trimesh
import viewer_scene
from pxr import Usd, UsdGeom

from scenec.backends.stage.implicit import ERROR
from scenec.backends.stage.read import read_stage
from scenec.backends.stage.scene import RenderScene
from scenec.testing.foreign_stages import new_stage

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(
        importlib.util.find_spec("bpy") is None, reason="needs bpy (the extra 'cycles')"
    ),
]
HALF_TURN = np.diag([1.0, -1.0, -1.0, 1.0])


@pytest.fixture(scope="module")
def stage(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("viewer")
    return viewer_scene.compiled(folder, viewer_scene.viewer_cfg())


@pytest.fixture(scope="module")
def scene(stage) -> RenderScene:
    return read_stage(stage)


@pytest.fixture(scope="module")
def imported(stage, scene):
    out = stage.parent.parent / "imported.npz"
    views = [f"{c.path.split('/')[-1]}:{c.width}x{c.height}" for c in scene.cameras[0]]
    script = Path(__file__).with_name("blender_import.py")
    done = viewer_scene.run_apart(script, stage, out, *views)
    assert done.returncode == 0, done.stderr
    return np.load(out)


def our_rocks(scene: RenderScene) -> np.ndarray:
    """Rows of the rocks, in the order of their ids."""
    rows = np.flatnonzero(scene.rows.instance_id)
    return rows[np.argsort(scene.rows.instance_id[rows])]


def test_every_instance_is_there_with_its_id_and_prototype(scene, imported):
    rocks = our_rocks(scene)
    assert len(rocks) == 300
    np.testing.assert_array_equal(imported["ids"], scene.rows.instance_id[rocks])
    ours = [scene.meshes[mesh].path.split("/")[-1] for mesh in scene.rows.mesh[rocks]]
    # Four shapes, in the levels of detail that the view asks for.
    assert {name[:7] for name in ours} == {f"rock_0{i}" for i in range(4)}
    assert len(set(ours)) > 4
    assert imported["prototypes"].tolist() == ours


def test_instances_stand_where_ours_stand(stage, scene, imported):
    ours = scene.rows.to_world[our_rocks(scene)]
    theirs = imported["matrices"][:, :3]
    np.testing.assert_array_equal(theirs[..., 3], ours[..., 3])
    opened = Usd.Stage.Open(str(stage))
    instancer = UsdGeom.PointInstancer(opened.GetPrimAtPath("/World/Objects/rocks"))
    scales = np.array(instancer.GetScalesAttr().Get(), float)
    q = np.array([[*q.GetImaginary(), q.GetReal()] for q in instancer.GetOrientationsAttr().Get()])
    # Blender, and USD itself, take quaternions in half precision as they are; the contract makes
    # unit ones of them. The difference is what half precision leaves of their length, squared.
    length = np.sqrt((q.astype(float) ** 2).sum(axis=1))
    size = scales.max(axis=1)
    difference = np.abs(theirs[..., :3] - ours[..., :3]).max(axis=(1, 2)) / size
    assert (difference <= 2 * np.abs(length**2 - 1) + 1e-6).all()
    assert difference.max() < 2e-3
    authored = rotations(q.astype(float)) * scales[:, None, :]
    assert (np.abs(theirs[..., :3] - authored).max(axis=(1, 2)) / size).max() < 1e-6


def rotations(q: np.ndarray) -> np.ndarray:
    """Rotation matrices by the formula for unit quaternions (x, y, z, w)."""
    x, y, z, w = q.T
    return np.stack(
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w),
         2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w),
         2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        axis=1,
    ).reshape(-1, 3, 3)  # fmt: skip


def test_cameras_have_our_poses_and_intrinsics_in_every_sample(scene, imported):
    assert imported["frames"].tolist() == [0, scene.samples - 1]
    poses = []
    for sample in range(scene.samples):
        for camera in scene.cameras[sample]:
            key = f"{camera.path.split('/')[-1]}_{sample}"
            pose = imported[f"{key}_pose"] @ HALF_TURN
            poses.append(pose)
            np.testing.assert_allclose(pose, camera.camera_to_world, rtol=0, atol=2e-6)
            lens, sensor, shift_x, shift_y = imported[f"{key}_lens"].astype(float)
            w, h = camera.width, camera.height
            focal = lens / sensor * w
            k = [[focal, 0, w / 2 - shift_x * w], [0, focal, h / 2 + shift_y * w], [0, 0, 1]]
            np.testing.assert_allclose(k, camera.intrinsics, rtol=0, atol=1e-4)
    # Not one pose four times.
    assert min(np.abs(a - b).max() for i, a in enumerate(poses) for b in poses[:i]) > 0.1


def test_blender_sees_sky_ground_and_rocks_in_the_pixels_where_the_exact_caster_does(
    scene, imported
):
    for sample in range(scene.samples):
        for camera in scene.cameras[sample]:
            theirs = imported[f"{camera.path.split('/')[-1]}_{sample}_classes"]
            ours = viewer_scene.classes(scene, camera)
            assert (np.bincount(ours.ravel(), minlength=3) > 50).all()
            # Blender casts in float32, through its camera in float32.
            assert (theirs != ours).sum() <= 3


def test_blender_makes_the_preview_looks_of_the_materials(scene, imported):
    for surface in scene.surfaces:
        name = surface.path.split("/")[-1]
        attribute, roughness, metallic = imported[f"material_{name}"].tolist()
        assert attribute == "displayColor"
        assert float(roughness) == pytest.approx(surface.roughness)
        assert float(metallic) == pytest.approx(surface.metallic)


_SHAPES: list[tuple[str, dict[str, float | str]]] = [
    ("Cube", {"size": 2.5}),
    ("Sphere", {"radius": 1.5}),
    ("Cylinder", {"axis": "X", "radius": 0.5, "height": 3.0}),
    ("Cylinder_1", {"axis": "Y", "radiusBottom": 2.0, "radiusTop": 1.0, "height": 3.0}),
    ("Cone", {"axis": "Y", "radius": 1.0, "height": 2.0}),
    ("Capsule", {"axis": "X", "radius": 0.5, "height": 2.0}),
    ("Capsule_1", {"axis": "Y", "radiusBottom": 0.5, "radiusTop": 1.0, "height": 2.0}),
    ("Plane", {"axis": "X", "width": 2.0, "length": 3.0}),
    ("Plane", {"axis": "Y", "width": 2.0, "length": 3.0}),
]


def test_points_of_its_implicit_shapes_lie_on_ours(tmp_path):
    path = tmp_path / "shapes.usda"
    stage = new_stage(path, "/Root")
    for index, (kind, attributes) in enumerate(_SHAPES):
        prim = stage.DefinePrim(f"/Root/shape_{index}", kind)
        for name, value in attributes.items():
            prim.GetAttribute(name).Set(value)
        UsdGeom.Xformable(prim).AddTranslateOp().Set((10.0 * index, 0.0, 0.0))
    stage.Save()
    script = Path(__file__).with_name("blender_shapes.py")
    done = viewer_scene.run_apart(script, path, tmp_path / "shapes.npz")
    assert done.returncode == 0, done.stderr
    theirs = np.load(tmp_path / "shapes.npz")
    scene = read_stage(path)
    assert len(scene.meshes) == len(theirs.files) == len(_SHAPES)
    for mesh, place in zip(scene.meshes, scene.rows.to_world, strict=True):
        points = theirs[mesh.path.split("/")[-1]] - place[:, 3]
        assert len(points) >= 4
        # None of these has a radius above 2.1.
        surface = trimesh.Trimesh(mesh.points, mesh.faces)
        _, distance, _ = trimesh.proximity.closest_point_naive(surface, points)
        assert distance.max() < 2.1 * ERROR
