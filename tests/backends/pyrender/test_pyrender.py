"""What is special to pyrender: its conformance, its preview of light, its pictures."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image

from scenec.backends.camera.rays import camera_rays
from scenec.backends.picture.sky import combine, lookup, texel_directions
from scenec.backends.pyrender import Pyrender, adapter
from scenec.backends.pyrender.lighting import polynomials, smooth_sky
from scenec.backends.pyrender.tables import resample
from scenec.backends.stage.scene import Dome, Lighting, Maps, RenderScene, Surface
from scenec.backends.testing import Conformance, Lacks, Tolerance, geometry, lights
from scenec.backends.testing import scenes as ms
from scenec.schemas.errors import BackendError

_ONCE = "pictures are looked up once for half a pixel, at the level of its inner half"
_ARC = "an arc cosine of software OpenGL is good to four digits, and the cone ends there"


TOLERANCES = {
    "witness[ids beyond 16 bits]": Tolerance(
        1e-3, 2e-2, "edges are rounded to 1/256 of a pixel, and faces are small"
    ),
    "cavity": Lacks("no light from surface to surface but a height field's"),
    "glow": Lacks("what gives off light lights no others"),
    "half_shadow": Lacks("shadows are sharp whatever a light's size"),
    "sky": Tolerance(
        0.05, 0.05, "harmonics of second order; 9 % at most (Ramamoorthi and Hanrahan 2001)"
    ),
    "sun_shadows[wall out of view]": Tolerance(
        0.02, 0.02, "light that ground throws on ground is an estimate on a coarse height field"
    ),
    "lamps": Tolerance(2e-3, 1e-2, "a pixel is 16 samples on a grid"),
    "lamps[29 degrees off a cone's axis]": Tolerance(1e-2, 1e-2, _ARC),
    "lamps[all soft]": Tolerance(3e-3, 3e-2, "a lamp's direction is one for half a pixel"),
    "maps": Tolerance(2e-3, 2e-2, _ONCE),
    "projections": Tolerance(1e-3, 7e-3, _ONCE),
    "sheets[map]": Tolerance(2.5e-3, 1.5e-2, _ONCE),
    "metals_under_a_sky": Tolerance(2e-2, 2e-2, "the sky is blurred, albedos are a table"),
    "facets_under_a_sky": Tolerance(1.5e-2, 1.5e-2, "a polynomial"),
}


class TestPyrender(Conformance):
    """A preview: what it estimates or leaves out, its ``losses`` say."""

    backend = Pyrender
    tolerances = TOLERANCES


def render(scene: RenderScene, spp: int = 4):
    backend = Pyrender()
    backend.load(scene)
    return backend.radiance(scene.cameras[0][0], 0, spp, 1)


def picture(scene: RenderScene, spp: int = 4) -> NDArray:
    return render(scene, spp).halves[0].astype(float)


@pytest.mark.parametrize(("spp", "used"), [(1, 1), (2, 1), (3, 4), (4, 4), (10, 9), (500, 16)])
def test_samples_are_a_grid_and_their_number_is_stated(spp, used):
    radiance = render(lights.plane_scene(), spp)
    assert radiance.spp == used
    assert not radiance.stochastic


def test_losses_name_what_a_scene_has_and_the_preview_has_not():
    backend = Pyrender()
    plane = ms.mesh(*ms.plane())
    plain = ms.scene([plane], lights=[ms.sun()])
    assert len(backend.losses(plain)) == 1
    shiny = ms.scene([plane], [ms.surface(specular=0.1)], lights=[ms.sun(), ms.dome()])
    assert len(backend.losses(shiny)) == 3
    assert all("\n" not in line for line in backend.losses(shiny))
    leaf = dataclasses.replace(ms.surface(), diffuse_transmission=0.5)
    leafy = ms.scene([plane], [leaf], lights=[ms.dome()])
    assert any("leaves" in line and "texture units" in line for line in backend.losses(leafy))
    assert not any("leaves" in line for line in backend.losses(shiny))
    assert backend.losses(ms.with_lights(plain, [])) == ()
    assert any("lamps" in line for line in backend.losses(lights.lamp_scene()))
    assert any("light no others" in line for line in backend.losses(lights.panel_scene(1.0)))


# The sky


def irradiance(dome: Dome, normals: NDArray) -> NDArray:
    """The integral of radiance times cosine, by the midpoint rule, [n, 3]."""
    theta = (np.arange(180) + 0.5) * (np.pi / 180)
    phi = (np.arange(360) + 0.5) * (2 * np.pi / 360)
    t, p = np.meshgrid(theta, phi, indexing="ij")
    w = np.stack([np.sin(t) * np.cos(p), np.sin(t) * np.sin(p), np.cos(t)], -1).reshape(-1, 3)
    sky = combine((dome,))
    assert sky is not None
    light = lookup(sky, w).astype(float) * (np.sin(t) * (np.pi / 180) ** 2).reshape(-1, 1)
    return np.maximum(normals @ w.T, 0.0) @ light


def sphere_points(n: int, rng: np.random.Generator) -> NDArray:
    points = rng.normal(size=(n, 3))
    return points / np.linalg.norm(points, axis=1)[:, None]


def test_irradiance_of_any_sky_is_within_the_bound_of_second_order(tmp_path):
    # Ramamoorthi and Hanrahan 2001: 9 % of the largest for any light, an average of 3 %.
    rng = np.random.default_rng(7)
    values = rng.uniform(0, 1, (16, 32, 3)) ** 4
    values[4, 9] = 80.0
    file = ms.write_latlong(tmp_path / "sky.exr", values)
    dome = Dome(file, np.array([1.0, 2.0, 0.5]), ms.rotation(rng))
    normals = sphere_points(400, rng)
    exact = irradiance(dome, normals)
    lighting = Lighting((), (dome,))
    ours = polynomials(normals) @ smooth_sky(lighting).irradiance
    error = np.abs(ours - exact) / exact.max(axis=0)
    assert error.max() < 0.09
    assert error.mean() < 0.03


def test_irradiance_of_a_smooth_sky_is_exact(tmp_path):
    # Radiance that is itself of second order in the direction.
    rng = np.random.default_rng(8)
    to_world = ms.rotation(rng)
    world = texel_directions(64, 128).reshape(-1, 3) @ to_world.T
    values = (polynomials(world) @ rng.uniform(-0.2, 0.2, (9, 3)) + 2.0).reshape(64, 128, 3)
    dome = Dome(ms.write_latlong(tmp_path / "sky.exr", values), np.ones(3), to_world)
    normals = sphere_points(100, rng)
    lighting = Lighting((), (dome,))
    ours = polynomials(normals) @ smooth_sky(lighting).irradiance
    np.testing.assert_allclose(ours, irradiance(dome, normals), rtol=2e-3)


def test_a_wall_takes_the_sky_that_its_height_takes():
    # Under a long wall whose top is seen at an elevation h, (1 + cos h) / 2 of an even sky is left
    # to level ground. The ground is all but black, so that it gives nothing back.
    wall = np.array([[-10.0, -200, 0], [-10, 200, 0], [-10, 200, 10], [-10, -200, 10]])
    roof = np.array([[-200.0, -200, 10], [-10, -200, 10], [-10, 200, 10], [-200, 200, 10]])
    quads = [[0, 1, 2], [0, 2, 3]]
    meshes = [ms.mesh(*ms.plane(200.0)), ms.mesh(wall, quads), ms.mesh(roof, quads)]
    for away in (20.0, 50.0, 150.0):
        x = away - 10.0
        camera = ms.look_at((x, 0, 40), (x, 0, 0), 8, 6, 0.1)
        scene = ms.scene(
            meshes, [ms.surface((0.01,) * 3)], cameras=[camera], lights=[ms.dome(100.0)]
        )
        expected = 0.5 * (1.0 + np.cos(np.arctan2(10.0, away)))
        # Cells are 2 m wide.
        np.testing.assert_allclose(picture(scene), expected, rtol=0.02)


# Surfaces


def _gray(file: Path, shape: tuple[int, int], value: float) -> Path:
    Image.fromarray(np.full(shape, round(255 * value), np.uint8)).save(file)
    return file


def test_maps_of_different_sizes_are_brought_to_one(tmp_path):
    rough = _gray(tmp_path / "rough.png", (4, 6), 0.6)
    metal = _gray(tmp_path / "metal.png", (9, 3), 0.8)
    plain = Surface("", (0.5, 0.4, 0.3), 0.2, 0.6, 0.0, 0.8)
    mapped = Surface("", (0.5, 0.4, 0.3), 0.2, 0.1, 0.0, 0.1,
                     Maps(3.0, roughness=rough, metallic=metal))  # fmt: skip
    around = [ms.sun(60.0), ms.dome(30.0)]
    view = ms.look_at((0, 0, 10), (0, 0, 0), 24, 16)
    got, expected = (
        picture(ms.scene([ms.mesh(*ms.plane())], [s], cameras=[view], lights=around))
        for s in (mapped, plain)
    )
    np.testing.assert_allclose(got, expected, rtol=5e-3)
    rng = np.random.default_rng(10)
    fine = rng.uniform(0, 1, (12, 20, 3)).astype(np.float32)
    # Means of texels when smaller; the mean of all stays either way.
    small = fine.reshape(6, 2, 5, 4, 3).mean(axis=(1, 3))
    np.testing.assert_allclose(resample(fine, 6, 5), small, atol=1e-6)
    np.testing.assert_allclose(
        resample(fine, 36, 60).mean(axis=(0, 1)), fine.mean(axis=(0, 1)), atol=1e-6
    )


# What is drawn


@pytest.mark.parametrize("case", ["field", "one mesh of many faces", "through the camera's plane"])
def test_what_is_culled_would_not_be_seen(case):
    made = geometry.SEEN[case]()
    view = made.cameras[0][0]
    whole, culled = (Pyrender(culling=culling) for culling in (False, True))
    whole.load(made)
    culled.load(made)
    rays = camera_rays(view)
    expected, got = (backend.witness(rays, 0, view) for backend in (whole, culled))
    np.testing.assert_array_equal(got.row, expected.row)
    np.testing.assert_array_equal(got.face, expected.face)


def test_a_picture_in_bands_is_the_picture(monkeypatch):
    scene = geometry.field()
    camera = scene.cameras[0][0]
    backend = Pyrender()
    backend.load(scene)
    whole = backend.witness(camera_rays(camera), 0, camera)
    light = backend.radiance(camera, 0, 4, 0)
    monkeypatch.setattr(adapter, "MAX_SAMPLES", 160 * 50)
    assert [rows for _, rows in adapter.bands(camera, 1, 1 << 14)] == [50, 50, 20]
    assert [rows for _, rows in adapter.bands(camera, 1, 160)] == [50, 50, 20]
    again = backend.witness(camera_rays(camera), 0, camera)
    np.testing.assert_array_equal(again.row, whole.row)
    parts = backend.radiance(camera, 0, 4, 0)
    assert np.mean(parts.coverage != light.coverage) < 1e-3


def test_a_picture_wider_than_opengl_draws_is_refused():
    scene = geometry.field()
    backend = Pyrender()
    backend.load(scene)
    camera = dataclasses.replace(scene.cameras[0][0], width=1 << 20, height=1)
    with pytest.raises(BackendError, match="narrower"):
        backend.radiance(camera, 0, 1, 0)


def test_a_table_of_rays_of_no_pinhole_is_left_to_the_caster():
    made = geometry.into_sky()
    backend = Pyrender()
    backend.load(made)
    assert backend.witness(camera_rays(made.cameras[0][0]), 0) is None
