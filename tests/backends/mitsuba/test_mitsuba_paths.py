"""Paths that are gathered after a bounce are those of Mitsuba's own path integrator."""

from __future__ import annotations

import dataclasses
import os
from typing import Any

import numpy as np
import pytest

from scenec.backends.contract import Radiance
from scenec.backends.mitsuba import Mitsuba, adapter
from scenec.backends.stage.scene import Camera, Lamp, RenderScene
from scenec.backends.testing import geometry
from scenec.backends.testing import scenes as ms

pytestmark = pytest.mark.skipif(
    os.environ.get("SCENEC_TEST_DEVICE") == "cuda", reason="on a GPU none are gathered"
)


def leafy(camera: Camera | None = None) -> RenderScene:
    """Glossy balls and sheets that let light through, close together: paths of many bounces."""
    made = geometry.busy()
    leaf = dataclasses.replace(ms.surface((0.7, 0.8, 0.4)), diffuse_transmission=0.6)
    sheet, faces = ms.plane(0.7)
    rng = np.random.default_rng(2)
    turned = [(2, ms.affine(ms.rotation(rng), rng.uniform(-1.5, 1.5, 3))) for _ in range(12)]
    rows = [(0, ms.affine(1.0, (0, 0, -0.5))), (1, ms.affine(1.0, (0, 0, 0.8))), *turned]
    return ms.scene(
        [*made.meshes, ms.mesh(sheet, faces, (2,))],
        [*made.surfaces, leaf],
        rows=rows,
        cameras=[camera or made.cameras[0][0]],
        lights=[ms.sun(40, 20, 500, 3.0), ms.sun(70, 120, 90, 12.0), ms.dome(40.0)],
    )


def lamps_alone() -> RenderScene:
    """The same by two lamps, one of them a point, and neither sun nor sky."""
    made = leafy()
    down = np.array([0.0, 0.0, -1.0])
    lamps = tuple(
        Lamp(np.array([x, -1.0, 3.0]), down, np.array([30.0, 20.0, 10.0]), radius, 1.2, 0.5)
        for x, radius in ((-1.0, 0.3), (1.5, 0.0))
    )
    lighting = dataclasses.replace(made.lighting[0], suns=(), domes=(), lamps=lamps)
    return dataclasses.replace(made, lighting=(lighting,))


def lamps_and_sky() -> RenderScene:
    made = leafy()
    lamps = lamps_alone().lighting[0].lamps
    return dataclasses.replace(made, lighting=(dataclasses.replace(made.lighting[0], lamps=lamps),))


def in_a_bright_sky(folder: Any) -> RenderScene:
    """Light of which one part is drawn, and another is found by surfaces' own samples."""
    picture = np.ones((8, 16, 3))
    picture[1, 3] = 30.0
    sky = ms.write_latlong(folder / "sky.exr", picture)
    return ms.with_lights(leafy(), [ms.sun(50.0), ms.dome(100.0, sky)])


SCENES = {
    "sun and even sky": lambda _: leafy(),
    "lamps": lambda _: lamps_alone(),
    "lamps and sky": lambda _: lamps_and_sky(),
    "bright sky": in_a_bright_sky,
    "nothing in view": lambda _: geometry.into_sky(),
}


@pytest.mark.parametrize("bounces", [0, 1, 4])
@pytest.mark.parametrize("name", SCENES)
def test_each_pixel_is_that_of_mitsubas_path_integrator(tmp_path, monkeypatch, name, bounces):
    scene, backend = SCENES[name](tmp_path), Mitsuba(bounces, device="cpu")
    backend.load(scene)
    ours = backend.radiance(scene.cameras[0][0], 0, 16, 7)
    monkeypatch.setattr(backend, "_gathers", lambda: False)
    theirs = backend.radiance(scene.cameras[0][0], 0, 16, 7)
    # They add up the same numbers in another order.
    np.testing.assert_allclose(ours.halves, theirs.halves, rtol=3e-6, atol=1e-6)
    np.testing.assert_array_equal(ours.coverage, theirs.coverage)
    assert ours.dropped == theirs.dropped


def large_kernels() -> list[str]:
    """Hashes of the kernels with surfaces in them, a launch each, since the last call."""
    import drjit as dr

    return [k["hash"] for k in dr.kernel_history() if k.get("operation_count", 0) > 800]


def test_both_launches_are_one_kernel_however_many_paths_are_left():
    scene, backend = leafy(), Mitsuba(device="cpu")
    import drjit as dr

    backend.load(scene)
    camera, launches = scene.cameras[0][0], []
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
        dr.kernel_history_clear()
        for width, height, spp in ((7, 5, 2), (32, 24, 8), (64, 48, 12)):
            scaled = np.diag([width / 32, height / 24, 1.0]) @ camera.intrinsics
            seen = dataclasses.replace(camera, width=width, height=height, intrinsics=scaled)
            backend.radiance(seen, 0, spp, 1)
            launches += large_kernels()
    # Two for each half of each picture.
    assert len(launches) == 12
    assert len(set(launches)) == 1


def test_other_light_at_each_sample_is_the_same_kernel():
    suns = [ms.sun(40, 20, 500, 3.0), ms.sun(10, -70, 30, 0.5), ms.sun(89, 3, 900, 8.0)]
    skies = (40.0, 3.0, 200.0)
    lighting = [ms.lighting_of([sun, ms.dome(sky)]) for sun, sky in zip(suns, skies, strict=True)]
    made, backend = leafy(), Mitsuba(device="cpu")
    import drjit as dr

    scene = ms.at_samples(made, lighting, made.cameras[0][0])
    backend.load(scene)
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
        dr.kernel_history_clear()
        for sample in range(3):
            backend.radiance(scene.cameras[sample][0], sample, 4, 1)
        assert len(set(large_kernels())) == 1


def require_equal(found: Radiance, expected: Radiance) -> None:
    np.testing.assert_array_equal(found.halves, expected.halves)
    np.testing.assert_array_equal(found.coverage, expected.coverage)


def test_a_frame_knows_nothing_of_the_frames_before():
    made = geometry.moving()
    camera = made.cameras[0][0]
    wide = dataclasses.replace(camera, lens=geometry.LENSES["brown_conrady"])
    small = geometry.varied_views().cameras[1][0]
    small = dataclasses.replace(small, camera_to_world=camera.camera_to_world)
    # Of each: the sample at which things are elsewhere, the view, and samples a pixel.
    frames = [(0, camera, 4), (2, wide, 4), (1, camera, 16), (2, small, 2), (0, camera, 4)]

    def drawn(backend: Mitsuba, frame: tuple[int, Camera, int]) -> Radiance:
        sample, view, spp = frame
        return backend.radiance(view, sample, spp, 5)

    one = Mitsuba(device="cpu")
    one.load(made)
    found = [drawn(one, frame) for frame in frames]
    for frame, radiance in zip(frames, found, strict=True):
        fresh = Mitsuba(device="cpu")
        fresh.load(made)
        require_equal(radiance, drawn(fresh, frame))
    assert not np.array_equal(found[0].coverage, found[2].coverage)


def test_a_half_in_passes_is_the_half_in_one(monkeypatch):
    scene, backend = leafy(), Mitsuba(device="cpu")
    backend.load(scene)
    whole = backend.radiance(scene.cameras[0][0], 0, 16, 3)
    monkeypatch.setattr(adapter, "MAX_GATHERED", 32 * 24 * 3)
    parts = backend.radiance(scene.cameras[0][0], 0, 16, 3)
    np.testing.assert_allclose(parts.halves, whole.halves, rtol=3e-6, atol=1e-6)
    np.testing.assert_array_equal(parts.coverage, whole.coverage)


def test_memory_does_not_grow_with_frames():
    scene, backend = leafy(), Mitsuba(device="cpu")
    import drjit as dr

    backend.load(scene)
    held = []
    for turn in range(12):
        backend.radiance(scene.cameras[0][0], 0, 2 + 2 * (turn % 3), turn)
        # Arrays that are alive: what Dr.Jit keeps to use again is its own.
        held.append(len(dr.whos(as_string=True).splitlines()))
    assert held[3:6] == held[6:9] == held[9:]
