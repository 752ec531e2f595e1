"""Every renderer shows the laws of reflectance as they are defined."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from typing import Any

import mitsuba_scenes as ms
import numpy as np
import pytest
from numpy.typing import NDArray

from scenec.backends.cycles import Cycles
from scenec.backends.mitsuba import Mitsuba
from scenec.backends.pyrender import Pyrender
from scenec.backends.stage.scene import (
    Camera,
    Dome,
    Lighting,
    Reflectance,
    RenderScene,
    Sun,
    Surface,
)
from scenec.backends.surface.reflectance import albedo, brdf

MARE = Reflectance("hapke", 0.254, 0.16, 1.993, 0.06, math.radians(23.657))
GRAINS = Reflectance("lommel_seeliger", 0.3, -0.2, 0.8, 0.05, 0.0)
SMOOTH = dataclasses.replace(MARE, roughness=0.0, opposition=0.5)
LAWS = {"hapke": MARE, "smooth": SMOOTH, "lommel_seeliger": GRAINS}
COLOR = (0.063, 0.3, 0.85)
IRRADIANCE = 1000.0
#: (sun's elevation and azimuth, camera's position): sun behind it, ten degrees off, ahead, grazing.
GEOMETRIES = (
    (30.0, 10.0, "behind"),
    (30.0, 10.0, "ten degrees"),
    (40.0, 200.0, (6.0, 2.0, 3.0)),
    (8.0, 70.0, (-3.0, 5.0, 2.0)),
)
#: x, y, z of the plane's normal.
NORMAL = np.array([0.2, -0.1, 1.0]) / math.sqrt(1.05)


@pytest.fixture(scope="module", params=["cycles", "mitsuba", "pyrender"])
def backend(request) -> Any:
    kinds: dict[str, Callable[[], Any]] = {
        "cycles": lambda: Cycles(device="cpu"),
        "mitsuba": lambda: Mitsuba(device="cpu"),
        "pyrender": Pyrender,
    }
    return kinds[request.param]()


def surface(law: Reflectance | None, color: tuple[float, float, float] = COLOR) -> Surface:
    return dataclasses.replace(ms.surface(color), reflectance=law)


def tilted(surfaces: list[Surface], weights: list[float] = ()) -> RenderScene:
    """A plane with a normal of ``NORMAL``, at each sample another sun and camera."""
    points, faces = ms.plane(20.0)
    points[:, 2] = -(points[:, 0] * NORMAL[0] + points[:, 1] * NORMAL[1]) / NORMAL[2]
    merges = np.repeat(np.array(weights, float)[:, None], len(points), axis=1)
    mesh = ms.mesh(points, faces, range(len(surfaces)), merges.reshape(-1, len(points)))
    cameras, lighting = [], []
    for elevation, azimuth, eye in GEOMETRIES:
        sun = ms.sun(elevation, azimuth, IRRADIANCE)
        if isinstance(eye, str):
            turn = math.radians(10.0 if eye == "ten degrees" else 0.0)
            aside = np.cross(sun.to_light, [0.0, 0.0, 1.0])
            aside /= np.linalg.norm(aside)
            eye = 8.0 * (math.cos(turn) * sun.to_light + math.sin(turn) * aside)
        cameras.append((ms.look_at(eye, (0.0, 0.0, 0.0), 8, 8, 0.1),))
        lighting.append(Lighting((sun,), ()))
    scene = ms.scene([mesh], surfaces, samples=len(GEOMETRIES))
    return dataclasses.replace(scene, cameras=tuple(cameras), lighting=tuple(lighting))


def shown(backend: Any, scene: RenderScene, sample: int = 0, spp: int = 16) -> NDArray:
    """Mean over the picture, by channel."""
    halves = backend.radiance(scene.cameras[sample][0], sample, spp, 3).halves
    return halves.astype(float).mean(axis=(0, 1, 2))


def to_viewer(camera: Camera) -> NDArray:
    position = camera.camera_to_world[:3, 3]
    return position / np.linalg.norm(position)


def expected(law: Reflectance, sun: Sun, view: NDArray) -> NDArray:
    """The mean over the sun's disc of E mu0 f."""
    k = np.arange(200) + 0.5
    radius, angle = 0.5 * sun.diameter_rad * np.sqrt(k / 200), 2.399963 * k
    right = np.cross(sun.to_light, [0.3, 0.9, 0.1])
    right /= np.linalg.norm(right)
    up = np.cross(sun.to_light, right)
    to_sun = (
        sun.to_light
        + np.outer(radius * np.cos(angle), right)
        + np.outer(radius * np.sin(angle), up)
    )
    to_sun /= np.linalg.norm(to_sun, axis=1, keepdims=True)
    mu0 = (to_sun @ NORMAL)[:, None]
    f = brdf(law, np.array(COLOR), mu0, view @ NORMAL, (to_sun @ view)[:, None])
    return IRRADIANCE * (mu0 * f).mean(axis=0)


@pytest.mark.parametrize("name", LAWS)
def test_a_plane_shows_the_law_at_every_sample(backend, name):
    scene = tilted([surface(LAWS[name])])
    backend.load(scene)
    pictures = [shown(backend, scene, sample) for sample in range(scene.samples)]
    for sample, picture in enumerate(pictures):
        view = to_viewer(scene.cameras[sample][0])
        light = expected(LAWS[name], scene.lighting[sample].suns[0], view)
        np.testing.assert_allclose(picture, light, rtol=0.01)
    # With the sun behind the camera the plane is brighter than ten degrees off, by the surge.
    views = [to_viewer(scene.cameras[sample][0]) for sample in (0, 1)]
    sun = scene.lighting[0].suns[0]
    surge = expected(LAWS[name], sun, views[0]) / expected(LAWS[name], sun, views[1])
    assert surge[0] > 1.1
    np.testing.assert_allclose(pictures[0] / pictures[1], surge, rtol=0.01)


@pytest.mark.parametrize("name", LAWS)
def test_under_an_even_sky_a_plane_shows_its_albedo(backend, name):
    mesh = ms.mesh(*ms.plane(20.0))
    # A hair of variation, so that colors are looked up and not known beforehand.
    mesh = dataclasses.replace(mesh, variation=np.full(4, 1e-4, np.float32))
    varied = dataclasses.replace(surface(LAWS[name]), variation=1.0)
    camera = ms.look_at((4.0, 0.0, 5.0), (0.0, 0.0, 0.0), 16, 16, 0.1)
    for own in (surface(LAWS[name]), varied):
        scene = ms.scene([mesh], [own], cameras=[camera], lights=[ms.dome(10.0)])
        backend.load(scene)
        light = 10.0 * albedo(LAWS[name], np.array(COLOR), to_viewer(camera)[2:])[:, 0]
        np.testing.assert_allclose(shown(backend, scene, spp=256), light, rtol=0.015)


def test_layers_of_several_laws_mix_as_their_pictures_do(backend):
    surfaces = [surface(MARE), surface(None, (0.4, 0.2, 0.1)), surface(GRAINS, (0.2, 0.2, 0.2))]
    below, above = 0.4, 0.3
    shares = ((1 - above) * (1 - below), (1 - above) * below, above)
    alone = []
    for own in surfaces:
        scene = tilted([own])
        backend.load(scene)
        alone.append(shown(backend, scene, 2))
    scene = tilted(surfaces, [below, above])
    backend.load(scene)
    mixed = sum(share * picture for share, picture in zip(shares, alone, strict=True))
    np.testing.assert_allclose(shown(backend, scene, 2), mixed, rtol=2e-3)


@pytest.mark.slow
def test_lights_and_gloss_add_up(backend):
    """Each light's own share and the rest are the whole, whatever else the surface does."""
    own = dataclasses.replace(surface(MARE), specular=0.2, roughness=0.7)
    lights: list[Sun | Dome] = [ms.sun(30.0, 10.0), ms.sun(60.0, 150.0, 300.0), ms.dome(20.0)]
    camera = ms.look_at((5.0, 2.0, 3.0), (0.0, 0.0, 0.0), 16, 16, 0.1)
    mesh = ms.mesh(*ms.plane(20.0))
    pictures = []
    for chosen in (*([light] for light in lights), lights):
        scene = ms.scene([mesh], [own], cameras=[camera], lights=chosen)
        backend.load(scene)
        pictures.append(shown(backend, scene, spp=256))
    np.testing.assert_allclose(pictures[3], sum(pictures[:3]), rtol=0.01)


@pytest.mark.slow
def test_bumpy_ground_is_the_same_in_cycles_as_in_mitsuba():
    """With what surfaces throw at each other, a twentieth of the light."""
    points, faces = ms.plane(10.0, 24)
    points[:, 2] = np.cos(points[:, 0]) + np.cos(1.3 * points[:, 1])
    camera = ms.look_at((-14.0, -9.0, 9.0), (0.0, 0.0, 0.0), 24, 16, 45)
    scene = ms.scene(
        [ms.mesh(points, faces)],
        [surface(MARE, (0.3, 0.3, 0.3))],
        cameras=[camera],
        lights=[ms.sun(20.0, 150.0)],
    )
    means = []
    for made in (Cycles(device="cpu"), Mitsuba(device="cpu")):
        made.load(scene)
        means.append(shown(made, scene, spp=128).mean())
    assert means[0] == pytest.approx(means[1], rel=0.02)


def test_what_is_not_exact_is_said():
    scene = tilted([surface(MARE)])
    plain = tilted([surface(None)])
    cycles = Cycles(device="cpu")
    assert "aureole" in "".join(cycles.losses(scene))
    assert cycles.losses(plain) == ()
    assert Mitsuba(device="cpu").losses(scene) == ()
