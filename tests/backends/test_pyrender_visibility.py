"""What pyrender draws first is what the exact caster sees, but for float32 and rounded edges."""

from __future__ import annotations

import dataclasses
import json
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import mitsuba_scenes as ms
import numpy as np
import pytest
import scenes
from numpy.typing import NDArray

from scenec.backends.camera.rays import camera_rays
from scenec.backends.check.witness import Witness
from scenec.backends.contract import NO_ROW
from scenec.backends.exact import ExactCaster
from scenec.backends.pyrender import Pyrender, adapter, platforms
from scenec.backends.pyrender.geometry import GROUP_FACES, prepare, spatial_order
from scenec.backends.stage.scene import Camera, RenderScene
from scenec.schemas.errors import BackendError


def field(offset: float = 0.0, scale: float = 1.0, rows: int = 60) -> RenderScene:
    """Ground and mixed instances: turned, scaled, sheared, mirrored, one of no faces."""
    rng = np.random.default_rng(3)
    shift = np.array([offset, -offset, 0.0])
    ball, ball_faces = scenes.icosphere(2)
    meshes = [
        ms.mesh(*ms.plane(20.0, 12)),
        ms.mesh(ball, ball_faces),
        ms.mesh(ball * [1, 0.5, 0.7], ball_faces, normals=ball),
        ms.mesh(np.zeros((0, 3)), np.zeros((0, 3), int)),
    ]
    placed = [(0, scenes.affine(scale, shift)), (3, scenes.affine())]
    for i in range(rows):
        linear = scenes.rotation(rng) * rng.uniform(0.2, 1.2)
        if i % 5 == 0:
            linear = linear @ np.diag([-1.0, 1, 1])
        if i % 7 == 0:
            linear = linear @ np.array([[1.0, 0.8, 0], [0, 1, -0.6], [0, 0, 1]])
        where = np.array([*rng.uniform(-12, 12, 2), rng.uniform(0, 1)])
        placed.append((1 + i % 2, scenes.affine(linear * scale, where * scale + shift)))
    eye, target = (np.add(shift, np.multiply(scale, p)) for p in ((0, -18, 5), (0, 0, 0.5)))
    camera = ms.look_at(eye, target, 160, 120, 60)
    made = scenes.scene(meshes, placed, cameras=[camera])
    return dataclasses.replace(made, surfaces=(ms.surface(),))


def hills() -> RenderScene:
    """A mesh that is cut into groups, seen from among its bumps."""
    rng = np.random.default_rng(5)
    heights = rng.normal(size=(90, 90)) * 0.15
    camera = ms.look_at((0, -6, 1.2), (0, 4, 0), 160, 120, 75)
    return scenes.scene([scenes.grid(heights, 0.2)], [(0, scenes.affine())], cameras=[camera])


def around_the_camera() -> RenderScene:
    """Ground, wall and slivers through the camera's plane, some of them all but at its eye."""
    rng = np.random.default_rng(6)
    big = np.array([[-50, -60, -1.5], [60, -50, -1.5], [0, 70, -1.5]])
    wall = np.array([[0.4, -5, -3], [0.4, 40, -3], [0.4, 3, 9]])
    soup = rng.normal(size=(240, 3)) * [3.0, 3.0, 1.0]
    meshes = [
        scenes.mesh(big, [[0, 1, 2]]),
        scenes.mesh(wall, [[0, 1, 2]]),
        scenes.mesh(soup, np.arange(240)),
        scenes.mesh(soup * 1e-3 + [0, 0.004, 0], np.arange(240)),
    ]
    camera = ms.look_at((0, 0, 0), (0.2, 1, -0.1), 160, 120, 95)
    return scenes.scene(meshes, [(i, scenes.affine()) for i in range(4)], cameras=[camera])


def through(scene: RenderScene, intrinsics: list[list[float]]) -> RenderScene:
    camera = dataclasses.replace(scene.cameras[0][0], intrinsics=np.array(intrinsics))
    return dataclasses.replace(scene, cameras=((camera,),))


SCENES: dict[str, Callable[[], RenderScene]] = {
    "mixed": field,
    "a thousand kilometers off": lambda: field(1e6),
    "a tenth of a millimeter": lambda: field(scale=1e-5),
    "as large as a planet": lambda: field(scale=1e5),
    "many rows": lambda: field(rows=700),
    "groups of faces": hills,
    "through the camera's plane": around_the_camera,
    "odd pixels": lambda: through(field(), [[150, 12, 70.5], [0, 95, 41.25], [0, 0, 1]]),
    "nothing in it": lambda: dataclasses.replace(
        scenes.scene([], [], cameras=[scenes.camera()]), bounds=np.full((2, 3), np.nan)
    ),
}


def seen_and_true(scene: RenderScene, **options: bool) -> tuple[float, float, bool]:
    """Shares of pixels with a wrong row and with a wrong face; whether all lie within a hair."""
    backend = Pyrender(**options)
    backend.load(scene)
    camera = scene.cameras[0][0]
    rays = camera_rays(camera)
    seen = backend.witness(rays, 0, camera)
    assert seen is not None
    caster = ExactCaster(scene)
    row, face, _ = caster.cast(rays)
    witness = Witness()
    witness.add(caster, rays, seen)
    right = witness.beyond == 0
    hit = row != NO_ROW
    other = seen.row != row
    return float(other.mean()), float((other | (hit & (seen.face != face))).mean()), right


@pytest.mark.parametrize("culling", [True, False])
@pytest.mark.parametrize("name", SCENES)
def test_few_pixels_differ_from_the_exact_caster_and_none_by_more_than_a_hair(name, culling):
    wrong_row, wrong_face, right = seen_and_true(SCENES[name](), culling=culling)
    assert wrong_row < 1e-3
    assert wrong_face < 5e-3
    assert right


OTHER_PLATFORM = """
import json, sys
sys.path.insert(0, sys.argv[1])
from test_pyrender_visibility import SCENES, seen_and_true
from scenec.backends.pyrender import Pyrender
results = [seen_and_true(SCENES[name]()) for name in SCENES]
print(json.dumps([Pyrender().version(), results]))
"""


def elsewhere(code: str, platform: str, *arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-c", code, *arguments],
        env={**os.environ, platforms.PLATFORM_VARIABLE: platform},
        capture_output=True,
        text=True,
        check=False,
    )


@pytest.mark.slow
def test_it_is_the_same_through_osmesa():
    if not platforms.wheel_libraries():
        pytest.skip("lavavu-osmesa is not installed")
    done = elsewhere(OTHER_PLATFORM, "osmesa", str(Path(__file__).parent))
    assert done.returncode == 0, done.stderr
    version, results = json.loads(done.stdout.splitlines()[-1])
    assert "osmesa" in version
    assert len(results) == len(SCENES)
    for wrong_row, wrong_face, right in results:
        assert wrong_row < 1e-3
        assert wrong_face < 5e-3
        assert right


def visible_rows(scene: RenderScene, camera: Camera) -> NDArray[np.int32]:
    backend = Pyrender()
    backend.load(scene)
    seen = backend.witness(camera_rays(camera), 0, camera)
    assert seen is not None
    return seen.row.reshape(camera.height, camera.width)


def facing(distance: float, half: float) -> NDArray:
    """A square across +X."""
    points, _ = ms.plane(half)
    return np.stack([np.full(4, distance), points[:, 0], points[:, 1]], axis=-1)


def test_depth_tells_a_millimeter_apart_at_a_hundred_meters_beside_what_is_at_hand():
    # 24 bits of the usual depth between 0.01 m and 1 km are steps of 60 mm there.
    faces = ms.plane()[1]
    meshes = [
        scenes.mesh(facing(100.001, 80), faces),
        scenes.mesh(facing(100.0, 40), faces),
        scenes.mesh(facing(0.01, 0.001), faces),
    ]
    scene = scenes.scene(meshes, [(i, scenes.affine()) for i in range(3)])
    camera = scenes.camera(64, 48, 90.0)
    rows = visible_rows(scene, camera)
    # 40 m at 100 m are 12.8 pixels of focal length 32; 1 mm at 10 mm are 3.2.
    v, u = np.meshgrid(np.arange(48) + 0.5 - 24, np.arange(64) + 0.5 - 32, indexing="ij")
    across = np.maximum(np.abs(u), np.abs(v))
    expected = np.where(across < 3.2, 2, np.where(across < 12.8, 1, 0))
    np.testing.assert_array_equal(rows[across < 25.6], expected[across < 25.6])


@pytest.mark.parametrize("distance", [1e-4, 1.0, 1e7])
def test_nothing_is_clipped_near_or_far(distance):
    faces = ms.plane()[1]
    meshes = [scenes.mesh(facing(distance, distance), faces), scenes.mesh(facing(1e3, 10), faces)]
    scene = scenes.scene(meshes, [(0, scenes.affine()), (1, scenes.affine(1.0, (0, 0, 1e5)))])
    assert np.all(visible_rows(scene, scenes.camera(16, 12, 60.0)) == 0)


def test_both_sides_of_a_face_are_seen():
    points, faces = facing(2.0, 5.0), ms.plane()[1]
    for turned in (faces, faces[:, ::-1]):
        scene = scenes.scene([scenes.mesh(points, turned)], [(0, scenes.affine())])
        assert np.all(visible_rows(scene, scenes.camera(8, 6)) == 0)


def test_a_table_of_rays_of_no_pinhole_is_left_to_the_caster():
    scene = field()
    backend = Pyrender()
    backend.load(scene)
    assert backend.witness(camera_rays(scene.cameras[0][0]), 0) is None


def test_a_picture_in_bands_is_the_picture(monkeypatch):
    scene = field()
    camera = scene.cameras[0][0]
    whole = visible_rows(scene, camera)
    backend = Pyrender()
    backend.load(scene)
    light = backend.radiance(camera, 0, 4, 0)
    monkeypatch.setattr(adapter, "MAX_SAMPLES", 160 * 50)
    assert [rows for _, rows in adapter.bands(camera, 1, 1 << 14)] == [50, 50, 20]
    assert [rows for _, rows in adapter.bands(camera, 1, 160)] == [50, 50, 20]
    np.testing.assert_array_equal(visible_rows(scene, camera), whole)
    parts = backend.radiance(camera, 0, 4, 0)
    assert np.mean(parts.coverage != light.coverage) < 1e-3


def test_a_picture_wider_than_opengl_draws_is_refused():
    scene = field()
    backend = Pyrender()
    backend.load(scene)
    camera = dataclasses.replace(scene.cameras[0][0], width=1 << 20, height=1)
    with pytest.raises(BackendError, match="narrower"):
        backend.radiance(camera, 0, 1, 0)


def test_another_scene_may_be_loaded_and_two_backends_share_a_process():
    first, second = Pyrender(), Pyrender()
    one, other = field(), hills()
    first.load(one)
    second.load(other)
    camera = one.cameras[0][0]
    before = first.witness(camera_rays(camera), 0, camera)
    second.load(one)
    after = second.witness(camera_rays(camera), 0, camera)
    assert before is not None
    assert after is not None
    np.testing.assert_array_equal(before.row, after.row)
    np.testing.assert_array_equal(before.face, after.face)


def test_radiance_leaves_visibility_as_it_was():
    # Light is drawn with coarser faces, which are none of the scene's.
    scene = hills()
    backend = Pyrender()
    backend.load(scene)
    camera = scene.cameras[0][0]
    before = backend.witness(camera_rays(camera), 0, camera)
    backend.radiance(camera, 0, 1, 0)
    after = backend.witness(camera_rays(camera), 0, camera)
    assert before is not None
    assert after is not None
    np.testing.assert_array_equal(before.face, after.face)


def test_nothing_can_be_drawn_before_a_scene_is_loaded():
    camera = scenes.camera()
    with pytest.raises(BackendError, match="call load first"):
        Pyrender().witness(camera_rays(camera), 0, camera)


def test_groups_hold_every_face_once_and_lie_close_together():
    scene = hills()
    mesh = scene.meshes[0]
    geometry = prepare(scene)
    assert len(geometry.items.group_mesh) == -(-len(mesh.faces) // GROUP_FACES)
    assert sorted(geometry.order.tolist()) == list(range(len(mesh.faces)))
    np.testing.assert_array_equal(geometry.meshes[0].faces, mesh.faces[geometry.order])
    # A quarter of the square, not a stripe across all of it.
    part = mesh.points[mesh.faces[spatial_order(mesh)[:GROUP_FACES]]]
    whole = np.ptp(mesh.points[:, :2], axis=0)
    assert np.all(np.ptp(part.reshape(-1, 3)[:, :2], axis=0) < 0.75 * whole)


def test_each_item_lies_in_its_sphere():
    scene = field()
    geometry = prepare(scene)
    items = geometry.items
    for item in range(len(items.row)):
        first, count = items.group_faces[items.group[item], 0]
        drawn = geometry.meshes[items.group_mesh[items.group[item]]]
        points = scene.meshes[drawn.mesh].points[np.unique(drawn.faces[first : first + count])]
        matrix = scene.rows.to_world[items.row[item]]
        world = points.astype(float) @ matrix[:, :3].T + matrix[:, 3]
        away = np.linalg.norm(world - items.spheres[item, :3], axis=1)
        assert away.max() <= items.spheres[item, 3] * (1 + 1e-9)


def test_it_says_where_it_runs():
    backend = Pyrender()
    assert backend.device in backend.devices
    assert backend.version().startswith("pyrender 1.")
    assert " egl " in backend.version() or " osmesa " in backend.version()


CUDA = platforms.EglDevice(0, True, False)
SOFTWARE = platforms.EglDevice(1, False, True)
OTHER = platforms.EglDevice(2, False, False)


@pytest.mark.parametrize(
    ("devices", "wanted", "index"),
    [
        ([SOFTWARE, CUDA], "auto", 0),
        ([OTHER, SOFTWARE], "auto", 1),
        ([OTHER], "auto", 2),
        ([OTHER, CUDA, SOFTWARE], "cpu", 1),
        ([OTHER, SOFTWARE, CUDA], "cuda", 0),
    ],
)
def test_the_device_is_a_gpu_of_nvidia_or_else_software(devices, wanted, index):
    assert platforms.choose(devices, wanted).index == index


SAYS = """
import sys
from scenec.backends.pyrender import Pyrender, platforms
from scenec.schemas.errors import BackendError
if "none" in sys.argv:
    def missing(*names):
        raise OSError(f"{names[0]} is missing")
    platforms._library, platforms.wheel_libraries = missing, lambda: []
try:
    print(Pyrender(sys.argv[1]).version())
except BackendError as error:
    print(error)
"""


@pytest.mark.slow
@pytest.mark.parametrize(
    ("platform", "device", "extra", "words"),
    [
        ("glx", "auto", "", ["SCENEC_PYRENDER_PLATFORM", "'glx'", "egl or osmesa"]),
        ("", "auto", "none", ["libEGL", "libOSMesa", "pip install 'scenec[osmesa]'"]),
        ("osmesa", "cuda", "", ["no NVIDIA GPU", "--device cpu"]),
    ],
)
def test_what_does_not_work_is_said_in_one_line(platform, device, extra, words):
    done = elsewhere(SAYS, platform, device, extra)
    assert len(done.stdout.splitlines()) == 1, done.stderr
    assert all(word in done.stdout for word in words), done.stdout
    # Nothing is left to complain about at the end either.
    assert "Traceback" not in done.stderr


@pytest.mark.slow
def test_where_egl_is_missing_osmesa_takes_its_place():
    if not platforms.wheel_libraries():
        pytest.skip("lavavu-osmesa is not installed")
    code = SAYS.replace('if "none" in sys.argv:', "if True:").replace(
        ", platforms.wheel_libraries = missing, lambda: []", " = missing"
    )
    done = elsewhere(code, "", "auto")
    assert " osmesa " in done.stdout, done.stdout + done.stderr
    assert done.stderr == ""
