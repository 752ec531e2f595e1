"""What Cycles sees first is what the exact caster sees, but for float32 at edges."""

from __future__ import annotations

import dataclasses
import os
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

import mitsuba_scenes as ms
import numpy as np
import pytest
import scenes

from scenec.backends.camera.rays import camera_rays
from scenec.backends.check.witness import Witness
from scenec.backends.contract import NO_ROW
from scenec.backends.cycles import Cycles
from scenec.backends.exact import ExactCaster
from scenec.backends.stage.scene import Camera, Mesh, RenderScene
from scenec.schemas.errors import BackendError


def with_rows(meshes: list[Mesh], rows: list, camera: Camera) -> RenderScene:
    """A scene of rows that may show meshes without faces."""
    whole = ms.scene(meshes[:1], cameras=[camera])
    table = dataclasses.replace(
        whole.rows,
        mesh=np.array([m for m, _ in rows], np.int32),
        to_world=np.array([a for _, a in rows]),
        instance_id=np.arange(len(rows), dtype=np.uint32),
        variation=np.zeros(len(rows), np.float32),
    )
    return dataclasses.replace(whole, meshes=tuple(meshes), rows=table)


def field(scale: float = 1.0, offset: Sequence[float] = (0.0, 0.0, 0.0)) -> RenderScene:
    """Ground and 350 instances: turned, stretched, sheared, mirrored; and a mesh of no faces."""
    rng = np.random.default_rng(3)
    shift = np.array(offset, float)
    ball, ball_faces = scenes.icosphere(2)
    meshes = [
        ms.mesh(*ms.plane(20.0, 12)),
        ms.mesh(ball, ball_faces),
        ms.mesh(ball * [1, 0.5, 0.7], ball_faces, normals=ball),
        ms.mesh(np.zeros((0, 3)), np.zeros((0, 3), int)),
    ]
    rows = [(0, scenes.affine(scale, shift)), (3, scenes.affine())]
    shear = np.array([[1, 0.6, 0], [0, 1, -0.4], [0, 0, 1]])
    for i in range(350):
        linear = scenes.rotation(rng) * rng.uniform(0.1, 0.8)
        if i % 5 == 0:
            linear = linear @ np.diag([-1.0, 1, 1])
        if i % 3 == 0:
            linear = linear @ shear
        where = np.array([*rng.uniform(-12, 12, 2), rng.uniform(0, 1)])
        rows.append((1 + i % 2, scenes.affine(linear * scale, where * scale + shift)))
    eye, target = np.array([0, -18, 5.0]), np.array([0.1, 0, 0.5])
    camera = ms.look_at(eye * scale + shift, target * scale + shift, 160, 120, 60)
    return with_rows(meshes, rows, camera)


def with_lens(camera: Camera, width: int, height: int, k: list[list[float]]) -> Camera:
    return dataclasses.replace(camera, width=width, height=height, intrinsics=np.array(k))


def assert_nearly_exact(scene: RenderScene, camera: Camera) -> None:
    """Few differences from the exact caster, none by more than a hair."""
    backend = Cycles()
    backend.load(scene)
    rays = camera_rays(camera)
    seen = backend.witness(rays, 0, camera)
    assert seen is not None
    caster = ExactCaster(scene)
    row, face, _ = caster.cast(rays)
    hit = row != NO_ROW
    assert hit.any()
    assert np.mean(seen.row != row) < 1e-3
    assert np.mean(hit & ((seen.row != row) | (seen.face != face))) < 5e-3
    witness = Witness()
    witness.add(caster, rays, seen)
    assert (witness.pixels, witness.beyond) == (len(row), 0)


@pytest.mark.parametrize(
    ("scale", "offset"),
    [(1.0, (0, 0, 0)), (1.0, (1e6, -1e6, 3e4)), (1e-6, (0, 0, 0)), (1e7, (0, 0, 0))],
)
def test_rows_and_faces_agree_with_the_exact_caster_and_settle_to_it(scale, offset):
    scene = field(scale, offset)
    row, _, _ = ExactCaster(scene).cast(camera_rays(scene.cameras[0][0]))
    assert len(np.unique(row)) > 100
    assert (row == NO_ROW).any()
    assert_nearly_exact(scene, scene.cameras[0][0])


@pytest.mark.parametrize(
    ("width", "height", "k"),
    [
        (160, 120, [[150.0, 0, 70.3], [0, 95.0, 66.2], [0, 0, 1]]),
        (160, 120, [[90.0, 0, 20.3], [0, 135.0, -6.2], [0, 0, 1]]),
        (90, 160, [[60.0, 0, 44.6], [0, 61.0, 80.1], [0, 0, 1]]),
        (160, 120, [[3.0, 0, 80.2], [0, 3.0, 60.1], [0, 0, 1]]),
        (160, 120, [[30000.0, 0, 80.0], [0, 30000.0, 60.0], [0, 0, 1]]),
        # Blender's own pictures have four pixels a side at least.
        (3, 2, [[2.0, 0, 1.4], [0, 1.5, 1.1], [0, 0, 1]]),
        (1, 1, [[0.5, 0, 0.5], [0, 0.5, 0.5], [0, 0, 1]]),
    ],
)
def test_any_focal_lengths_and_principal_point_are_followed(width, height, k):
    scene = field()
    assert_nearly_exact(scene, with_lens(scene.cameras[0][0], width, height, k))


def test_ids_beyond_sixteen_bits_come_through():
    # 80,000 rows before the one in view, and 180,000 faces in it.
    count = 80_000
    triangle = ms.mesh(np.eye(3) * 1e-3, np.array([[0, 1, 2]]))
    ground = ms.mesh(*ms.plane(10.0, 300))
    camera = ms.look_at((0.3, -9, 5), (0, 0, 0), 64, 48, 60)
    far = np.zeros((count, 3, 4))
    far[:, :, :3] = np.eye(3)
    far[:, 0, 3] = np.linspace(-9, 9, count)
    far[:, 2, 3] = -5.0
    scene = with_rows([triangle, ground], [(0, m) for m in far] + [(1, scenes.affine())], camera)
    _, face, _ = ExactCaster(scene).cast(camera_rays(camera))
    assert face.max() > 1 << 16
    assert_nearly_exact(scene, camera)


def test_rays_that_meet_nothing_see_no_row():
    scene = field()
    camera = ms.look_at((0, 0, 30), (0, 0, 60), 16, 12)
    backend = Cycles()
    backend.load(scene)
    seen = backend.witness(camera_rays(camera), 0, camera)
    assert seen is not None
    assert np.all(seen.row == NO_ROW)
    assert np.all(seen.face == 0)


def test_an_empty_scene_is_seen_as_empty():
    camera = ms.look_at((0, 0, 1), (1, 0, 1), 16, 12)
    nothing = ms.mesh(np.zeros((0, 3)), np.zeros((0, 3), int))
    whole = ms.scene([ms.mesh(*ms.plane())], cameras=[camera])
    empty = dataclasses.replace(whole, meshes=(nothing,))
    backend = Cycles()
    backend.load(empty)
    seen = backend.witness(camera_rays(camera), 0, camera)
    assert seen is not None
    assert np.all(seen.row == NO_ROW)
    assert np.all(backend.radiance(camera, 0, 2, 0).coverage == 0.0)


def test_rays_of_no_camera_that_blender_has_are_left_to_the_caster():
    scene = field()
    camera = scene.cameras[0][0]
    skewed = with_lens(camera, 160, 120, [[90.0, 5.0, 80], [0, 90.0, 60], [0, 0, 1]])
    backend = Cycles()
    backend.load(scene)
    assert backend.witness(camera_rays(camera), 0, None) is None
    assert backend.witness(camera_rays(skewed), 0, skewed) is None
    with pytest.raises(BackendError, match="skew of 5") as raised:
        backend.radiance(skewed, 0, 2, 0)
    assert len(str(raised.value).splitlines()) == 1


def test_light_leaves_no_geometry_in_the_way_of_visibility():
    camera = ms.look_at((0, 0, 1), (0, 0, 100), 16, 12)
    scene = ms.scene(
        [ms.mesh(*ms.plane())], cameras=[camera], lights=[ms.sun(90, diameter_deg=20), ms.dome()]
    )
    backend = Cycles()
    backend.load(scene)
    backend.radiance(camera, 0, 2, 0)
    seen = backend.witness(camera_rays(camera), 0, camera)
    assert seen is not None
    assert np.all(seen.row == NO_ROW)


def test_visibility_is_the_same_before_and_after_radiance():
    scene = ms.with_lights(field(), [ms.sun(40.0), ms.dome(5.0)])
    camera = scene.cameras[0][0]
    backend = Cycles()
    backend.load(scene)
    before = backend.witness(camera_rays(camera), 0, camera)
    backend.radiance(camera, 0, 4, 0, denoise=True)
    after = backend.witness(camera_rays(camera), 0, camera)
    assert before is not None
    assert after is not None
    np.testing.assert_array_equal(before.row, after.row)
    np.testing.assert_array_equal(before.face, after.face)


def test_radiance_is_drawn_through_the_same_pixels_as_visibility_for_any_intrinsics():
    scene = field()
    k = [[52.0, 0.0, 22.5], [0, 75.0, 30.25], [0, 0, 1]]
    camera = with_lens(scene.cameras[0][0], 60, 44, k)
    backend = Cycles()
    backend.load(scene)
    coverage = backend.radiance(camera, 0, 64, 0).coverage
    seen = backend.witness(camera_rays(camera), 0, camera)
    assert seen is not None
    hit = (seen.row != NO_ROW).reshape(44, 60)
    assert np.all(coverage[hit] > 0.2)
    assert np.all(coverage[~hit] < 0.8)
    assert 0.1 < hit.mean() < 0.9


def test_a_second_backend_and_a_second_batch_disturb_nothing():
    first, camera = field(), field().cameras[0][0]
    other = ms.scene([ms.mesh(*ms.plane(3.0))], cameras=[camera])
    one, two = Cycles(), Cycles()
    one.load(first)
    seen = one.witness(camera_rays(camera), 0, camera)
    two.load(other)
    del two
    again = one.witness(camera_rays(camera), 0, camera)
    assert seen is not None
    assert again is not None
    np.testing.assert_array_equal(seen.row, again.row)
    one.load(other)
    replaced = one.witness(camera_rays(camera), 0, camera)
    assert replaced is not None
    assert set(np.unique(replaced.row)) == {NO_ROW, 0}


def test_broken_faces_and_a_missing_scene_are_said_in_one_line():
    backend = Cycles()
    camera = ms.look_at((0, 0, 1), (1, 0, 1))
    with pytest.raises(BackendError, match="no scene is loaded"):
        backend.witness(camera_rays(camera), 0, camera)
    broken = ms.scene([ms.mesh(np.zeros((3, 3)), np.array([[0, 1, 2]]))], cameras=[camera])
    mesh = dataclasses.replace(broken.meshes[0], faces=np.array([[0, 1, 3]], np.int32))
    with pytest.raises(BackendError, match="reach beyond the 3 points"):
        backend.load(dataclasses.replace(broken, meshes=(mesh,)))


def test_devices_are_the_cpu_or_gpus_that_are_there():
    assert Cycles(device="cpu").device == "cpu"
    chosen = Cycles(device="auto").device
    assert chosen in Cycles.devices
    assert f" {chosen} " in Cycles().version()
    if chosen == "cpu":
        for gpu in ("cuda", "optix"):
            with pytest.raises(BackendError, match=f"{gpu}.*--device cpu") as raised:
                Cycles(device=gpu)
            assert len(str(raised.value).splitlines()) == 1
    else:
        assert Cycles(device=chosen).device == chosen


ALONE = """
import os, sys
sys.path.insert(0, sys.argv[1])
import mitsuba_scenes as ms
from scenec.backends.cycles import Cycles
camera = ms.look_at((0, 0, 10), (0, 0, 0), 8, 8)
backend = Cycles()
backend.load(ms.scene([ms.mesh(*ms.plane())], cameras=[camera], lights=[ms.sun(90.0)]))
light = backend.radiance(camera, 0, 2, 0, denoise=True).halves
print(round(float(light.mean()), 2), os.environ["OCIO"], flush=True)
os._exit(0)
"""


def test_nothing_of_a_users_blender_is_read_and_nothing_is_left_or_said(tmp_path: Path):
    # Start-up scripts and a broken color configuration of the user's; an end as workers have it.
    scripts, temporary, home = (tmp_path / name for name in ("scripts", "tmp", "home"))
    (scripts / "startup").mkdir(parents=True)
    marker = tmp_path / "ran"
    (scripts / "startup" / "own.py").write_text(f"open({str(marker)!r}, 'w').close()\n")
    temporary.mkdir()
    home.mkdir()
    done = subprocess.run(
        [sys.executable, "-c", ALONE, str(Path(__file__).parent)],
        env={
            **os.environ,
            "BLENDER_USER_SCRIPTS": str(scripts),
            "OCIO": "/no/such.ocio",
            "TMPDIR": str(temporary),
            "HOME": str(home),
        },
        check=True,
        capture_output=True,
        text=True,
    )
    assert done.stdout == f"{1000 * 0.5 / np.pi:.2f} /no/such.ocio\n"
    assert not marker.exists()
    assert list(temporary.iterdir()) == []
    assert [path for path in home.rglob("*") if path.is_file()] == []
