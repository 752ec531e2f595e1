"""What Mitsuba sees first is what the exact caster sees, but for float32 at edges."""

from __future__ import annotations

import dataclasses
import os
import subprocess
import sys

import mitsuba_scenes as ms
import numpy as np
import pytest
import scenes

from scenec.backends.camera.rays import camera_rays
from scenec.backends.check.witness import Witness
from scenec.backends.contract import NO_ROW
from scenec.backends.exact import ExactCaster
from scenec.backends.mitsuba import Mitsuba, variant
from scenec.backends.stage.scene import RenderScene


def field(offset: np.ndarray | None = None) -> RenderScene:
    """Ground and mixed instances: turned, scaled, mirrored, one of no faces."""
    rng = np.random.default_rng(3)
    shift = np.zeros(3) if offset is None else offset
    ball, ball_faces = scenes.icosphere(2)
    meshes = [
        ms.mesh(*ms.plane(20.0, 12)),
        ms.mesh(ball, ball_faces),
        ms.mesh(ball * [1, 0.5, 0.7], ball_faces, normals=ball),
        ms.mesh(np.zeros((0, 3)), np.zeros((0, 3), int)),
    ]
    rows = [(0, scenes.affine(1.0, shift)), (3, scenes.affine())]
    for i in range(60):
        linear = scenes.rotation(rng) * rng.uniform(0.2, 1.2)
        if i % 5 == 0:
            linear = linear @ np.diag([-1.0, 1, 1])
        where = np.array([*rng.uniform(-12, 12, 2), rng.uniform(0, 1)]) + shift
        rows.append((1 + i % 2, scenes.affine(linear, where)))
    camera = ms.look_at(np.add(shift, (0, -18, 5)), np.add(shift, (0, 0, 0.5)), 160, 120, 60)
    kept = [(m, a) for m, a in rows if m != 3]
    whole = ms.scene(meshes, rows=kept, cameras=[camera])
    return dataclasses.replace(
        whole,
        rows=dataclasses.replace(
            whole.rows,
            mesh=np.array([m for m, _ in rows], np.int32),
            to_world=np.array([a for _, a in rows]),
            instance_id=np.arange(len(rows), dtype=np.uint32),
            variation=np.zeros(len(rows), np.float32),
        ),
    )


@pytest.mark.parametrize("far", [0.0, 1e5])
def test_rows_and_faces_agree_with_the_exact_caster_on_all_but_a_few_edge_pixels(far):
    scene = field(np.array([far, -far, 0.0]))
    backend = Mitsuba()
    backend.load(scene)
    rays = camera_rays(scene.cameras[0][0])
    seen = backend.witness(rays, 0)
    row, face, _ = ExactCaster(scene).cast(rays)
    assert (row == NO_ROW).any()
    assert len(np.unique(row)) > 40
    assert np.mean(seen.row != row) < 1e-3
    assert np.mean((seen.row != row) | (seen.face != face)) < 5e-3


def test_what_differs_is_within_a_hair_of_an_edge():
    scene = field()
    backend = Mitsuba()
    backend.load(scene)
    rays = camera_rays(scene.cameras[0][0])
    witness = Witness()
    witness.add(ExactCaster(scene), rays, backend.witness(rays, 0))
    assert (witness.pixels, witness.beyond) == (len(rays.origins), 0)


def test_light_leaves_no_geometry_in_the_way_of_visibility():
    camera = ms.look_at((0, 0, 1), (0, 0, 100), 16, 12)
    scene = ms.scene(
        [ms.mesh(*ms.plane())], cameras=[camera], lights=[ms.sun(90, diameter_deg=20), ms.dome()]
    )
    backend = Mitsuba()
    backend.load(scene)
    backend.radiance(camera, 0, 2, 0)
    assert np.all(backend.witness(camera_rays(camera), 0).row == NO_ROW)


def test_radiance_is_drawn_through_the_same_pixels_as_visibility_for_any_intrinsics():
    camera = ms.look_at((0, -18, 5), (0, 0, 0.5), 60, 44, 60)
    k = np.array([[52.0, 3.0, 22.5], [0, 75.0, 30.25], [0, 0, 1]])
    camera = dataclasses.replace(camera, intrinsics=k)
    scene = dataclasses.replace(field(), cameras=((camera,),))
    backend = Mitsuba()
    backend.load(scene)
    coverage = backend.radiance(camera, 0, 64, 0).coverage
    hit = (backend.witness(camera_rays(camera), 0).row != NO_ROW).reshape(44, 60)
    assert np.all(coverage[hit] > 0.2)
    assert np.all(coverage[~hit] < 0.8)
    assert 0.1 < hit.mean() < 0.9


def test_libllvm_is_found_in_the_wheel_without_importing_it():
    code = (
        "import sys; from scenec.backends.mitsuba.variant import wheel_llvm; p = wheel_llvm(); "
        "assert p and p.is_file(), p; assert not any('llvm' in m for m in sys.modules if m in "
        "('llvm', 'llvm_nanobind')), 'imported'"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


@pytest.mark.parametrize(
    ("setting", "told"),
    [
        ((variant.VARIANT_VARIABLE, "no_such_variant"), "no_such_variant"),
        ((variant.VARIANT_VARIABLE, "scalar_rgb"), "of LLVM or CUDA"),
        ((variant.LLVM_VARIABLE, "/no/such/library"), "Mend it with: pip install llvm-nanobind"),
    ],
)
def test_an_unusable_variant_is_said_in_one_line(setting, told):
    code = (
        "from scenec.backends.mitsuba import Mitsuba\n"
        "from scenec.schemas.errors import BackendError\n"
        "try:\n    Mitsuba()\nexcept BackendError as error:\n    print(error)"
    )
    done = subprocess.run(
        [sys.executable, "-c", code],
        env={**os.environ, setting[0]: setting[1]},
        capture_output=True,
        text=True,
        check=True,
    )
    assert told in done.stdout
    assert len(done.stdout.splitlines()) == 1
