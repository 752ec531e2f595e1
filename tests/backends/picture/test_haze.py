"""Haze before surfaces: what pictures show of it, at edges, and below a sky's horizon."""

from __future__ import annotations

import sys
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from third_party import LEVEL, Raster

from scenec.backends.camera.rays import camera_rays
from scenec.backends.contract import Radiance, Rays, Visibility, completed
from scenec.backends.exact import ExactCaster
from scenec.backends.picture.airlight import _halves
from scenec.backends.picture.compose import compose
from scenec.backends.picture.haze import Hazy, Veil, air_at, veil
from scenec.backends.picture.sky import combine
from scenec.backends.run.session import Session
from scenec.backends.stage.scene import Camera, Dome, Haze, Lighting, RenderScene, Sun
from scenec.backends.testing import scenes as ms
from scenec.backends.testing.scenes import write_latlong
from scenec.testing import scenes

GRAY = np.array([0.4, 0.5, 0.6])


def haze(visibility: float = 100.0, height: float = 1e9, shown: NDArray | None = None) -> Haze:
    return Haze(np.full(3, 3.912 / visibility), height, shown)


def wall(distance: float, size: float = 1e4) -> RenderScene:
    """A wall across +x, and above it the sky."""
    points = [[0, -size, -size], [0, size, -size], [0, size, 0], [0, -size, 0]]
    return scenes.scene(
        [scenes.mesh(np.array(points), np.array([[0, 1, 2], [0, 2, 3]]))],
        [(0, scenes.affine(offset=(distance, 0.0, 0.0)))],
    )


def seen(
    scene: RenderScene, camera: Camera, of: Haze, dome: Dome | None, light: float = 0.0
) -> tuple[NDArray, Veil]:
    """The picture of a scene whose surfaces have one radiance, exact coverage at the centers."""
    lighting = Lighting((), () if dome is None else (dome,))
    scene = replace(scene, lighting=(lighting,), haze=(of,))
    caster, rays = ExactCaster(scene), camera_rays(camera)
    t = caster.cast(rays)[2]
    covered = np.isfinite(t).reshape(rays.shape).astype(np.float32)
    halves = np.broadcast_to(light * covered[None, ..., None], (2, *rays.shape, 3))
    air = air_at(scene, 0)
    assert air is not None
    made = veil(air, camera, caster, rays, t, covered)
    radiance = Radiance(np.ascontiguousarray(halves, np.float32), covered, 2)
    return compose(radiance, scene, camera, 0, made).rgb.astype(float), made


def test_of_a_black_wall_at_the_visibility_2_percent_of_contrast_are_left():
    camera = scenes.camera(9, 8, 1.0, target=(1.0, 0.0, 0.0))
    constant = Dome(None, GRAY, np.eye(3))
    rgb, _ = seen(wall(700.0), camera, haze(visibility=700.0, shown=GRAY), constant)
    sky, black = rgb[0, 4], rgb[-1, 4]
    np.testing.assert_allclose((sky - black) / sky, 0.02, atol=1e-4)


def test_a_far_wall_vanishes_in_the_sky():
    camera = scenes.camera(16, 12, 40.0)
    of = haze(10.0, 500.0)
    rgb, made = seen(wall(1e4, 1e6), camera, of, Dome(None, GRAY, np.eye(3)), light=3.0)
    # A furnace of air, sky and ground; around the horizon there is neither wall nor sky.
    np.testing.assert_allclose(rgb, np.broadcast_to(GRAY, rgb.shape), rtol=0.01)
    assert made.transmittance[-1].max() < 1e-9
    assert made.behind[5].max() < 1e-9


def test_airlight_of_ones_own_shows_before_surfaces_and_sky():
    own = np.array([0.1, 0.2, 0.3])
    camera = scenes.camera(16, 12, 40.0)
    of = haze(10.0, 1.0, shown=own)
    rgb, _ = seen(wall(1e4, 1e6), camera, of, Dome(None, GRAY, np.eye(3)))
    np.testing.assert_allclose(rgb[-1, 8], own, rtol=1e-6)
    up = camera_rays(camera).directions[8]
    sky = np.exp(-0.3912 * np.sqrt((up * up).sum()) / up[2])
    np.testing.assert_allclose(rgb[0, 8], own * (1.0 - sky) + GRAY * sky, rtol=1e-6)


def test_a_low_layer_leaves_the_sky_above_it_and_hides_the_sun_behind_it():
    camera = scenes.camera(9, 31, 60.0)
    sun = Sun(ms.sun(8.0, 0.0).to_light, np.full(3, 800.0), np.radians(2.0))
    scene = replace(wall(50.0, 1e-3), lighting=(Lighting((sun,), ()),), haze=(haze(30.0, 4.0),))
    air = air_at(scene, 0)
    assert air is not None
    rays = camera_rays(camera)
    t = np.full(len(rays.directions), np.inf)
    low, high = (
        veil(air, camera, ExactCaster(scene), replace_height(rays, z), t, np.zeros((31, 9), "f4"))
        for z in (0.0, 40.0)
    )
    assert (high.behind[:14] > 0.99).all()
    assert (high.airlight_behind[:14] < 5.0).all()
    # Straight along the layer nothing comes through, steeply up more does.
    assert (low.behind[15] < 0.01).all()
    assert (np.diff(low.behind[:14, 4, 0]) < 0.0).all()


def replace_height(rays: Rays, z: float) -> Rays:
    origins = rays.origins.copy()
    origins[:, 2] = z
    return replace(rays, origins=origins)


def test_surfaces_have_the_light_that_comes_through():
    """Sun by Beer's law; sky and what is scattered down as the layer lets through, to 2 %."""
    sun, dome = ms.sun(40.0, 900.0), Dome(None, np.full(3, 20.0), np.eye(3))
    ground = scenes.mesh(np.array([[-9, -9, 0], [9, -9, 0], [0, 9, 0]]), np.array([[0, 1, 2]]))
    scene = scenes.scene([ground], [(0, scenes.affine())])
    camera = scenes.camera(12, 8, 60.0, target=(1.0, 0.0, -1.0))
    pose = camera.camera_to_world.copy()
    pose[2, 3] = 3.0
    of = Haze(np.full(3, 1e-3))
    scene = replace(
        scene,
        lighting=(Lighting((sun,), (dome,)),),
        haze=(of,),
        cameras=((replace(camera, camera_to_world=pose),),),
    )
    hazy = Hazy(scene, ExactCaster(scene))
    assert hazy.height_m == pytest.approx(0.0, abs=1e-9)
    (lit,) = hazy.lit().lighting
    sine = float(sun.to_light[2])
    np.testing.assert_allclose(lit.suns[0].irradiance, sun.irradiance * np.exp(-1.0 / sine))
    sky = combine(lit.domes)
    assert sky is not None
    _, down, up = _halves(sky)
    before = sine * sun.irradiance + np.pi * 20.0
    air = air_at(scene, 0)
    assert air is not None
    total = down + sine * lit.suns[0].irradiance
    np.testing.assert_allclose(total, before * air.dimming, rtol=0.02)
    # As much less than without as the ground's picture is.
    np.testing.assert_allclose(up, np.pi * 20.0 * air.dimming, rtol=0.02)


def test_next_to_no_haze_is_next_to_no_difference():
    """1e-12 of haze moves no pixel, nor light, by more than that many times a few."""
    camera = scenes.camera(16, 12, 40.0)
    dome = Dome(None, GRAY, np.eye(3))
    rgb, _ = seen(wall(50.0), camera, haze(3.912e12, 1000.0), dome, light=3.0)
    bare = np.where(rgb > 2.0, 3.0, GRAY)
    np.testing.assert_allclose(rgb, bare, rtol=1e-7)


def test_a_thin_haze_low_in_the_valley_leaves_the_summit_clear():
    points = np.array([[0, -900, -900], [0, 900, -900], [0, 900, 900], [0, -900, 900]])
    scene = scenes.scene(
        [scenes.mesh(points, np.array([[0, 1, 2], [0, 2, 3]]))],
        [(0, scenes.affine(offset=(500.0, 0.0, 0.0)))],
    )
    _, made = seen(scene, scenes.camera(8, 31, 50.0), haze(400.0, 30.0), None)
    column = made.transmittance[:, 4, 0]
    assert (np.diff(column) <= 0.0).all()
    assert column[0] > 0.7
    assert column[-1] < 1e-3


def test_below_the_horizon_the_skys_picture_is_hazy_ground(tmp_path):
    # Ground of radiance 5 below a sky of radiance 2, seen from 20 m above the lowest point.
    picture = np.full((1440, 8, 3), 2.0, np.float32)
    picture[720:] = 5.0
    dome = Dome(write_latlong(tmp_path / "sky.exr", picture), np.ones(3), ms.DOME_Z_UP)
    points = np.array([[0, -1, -20], [0, 1, -20], [0, 0, -19.9]])
    scene = scenes.scene([scenes.mesh(points, np.array([[0, 1, 2]]))], [(0, scenes.affine())])
    scene = replace(scene, bounds=np.array([[0.0, -1, -20], [0, 1, -19.9]]))
    camera = scenes.camera(4, 41, 80.0)
    of = Haze(np.full(3, 0.01), 100.0, asymmetry=0.0)
    rgb, made = seen(scene, camera, of, dome)
    up = camera_rays(camera).directions[1::4]
    sine = up[:, 2] / np.sqrt((up * up).sum(axis=1))
    above, below = sine > 0.05, sine < -0.05
    sky, ground = np.exp(-1.0 / sine[above]), np.exp(-np.expm1(0.2) / -sine[below])
    np.testing.assert_allclose(made.behind[above, 1, 0], sky, rtol=1e-9)
    assert ((made.behind[below, 1, 0] / ground > 0.5) & (made.behind[below, 1, 0] < ground)).all()
    # Haze before either is lit by both: between them, or a little less, as some light gets lost.
    passed = np.where(above, made.behind[:, 1, 0], np.exp(-0.22 / np.maximum(np.abs(sine), 1e-9)))
    added = made.airlight_behind[:, 1, 0] / (1.0 - passed)
    assert ((added[above | below] > 1.5) & (added[above | below] < 5.0)).all()
    assert ((rgb[:, 1] > 1.5) & (rgb[:, 1] < 5.0)).all()


def edge(shift: float) -> RenderScene:
    """A near wall's edge before a far one that fills the picture."""
    near = [[0, -50, -50], [0, 0, -50], [0, 0, 50], [0, -50, 50]]
    far = [[0, -5e3, -5e3], [0, 5e3, -5e3], [0, 5e3, 5e3], [0, -5e3, 5e3]]
    faces = np.array([[0, 1, 2], [0, 2, 3]])
    return scenes.scene(
        [scenes.mesh(np.array(near), faces), scenes.mesh(np.array(far), faces)],
        [(0, scenes.affine(offset=(10.0, shift, 0.0))), (1, scenes.affine(offset=(900.0, 0, 0)))],
    )


@pytest.mark.parametrize("part", [0.125, 0.375, 0.625, 0.875])
def test_a_pixel_across_an_edge_has_the_mean_of_both_sides(part, monkeypatch):
    camera = scenes.camera(8, 8, 40.0)
    # The middle column's left border looks along y = 0; +y is to the left.
    pixel = 10.0 / camera.intrinsics[0, 0]
    scene = edge(-part * pixel)
    # More rays than pixels have on the whole: that of them all.
    monkeypatch.setattr("scenec.backends.picture.haze._SHARE", 4.0)
    _, made = seen(scene, camera, haze(300.0), None)
    near, far = made.transmittance[4, 7, 0], made.transmittance[4, 0, 0]
    assert near - far > 0.8
    mixed = made.transmittance[4, 4, 0]
    assert abs(mixed - (part * far + (1.0 - part) * near)) < 0.13
    assert 0 < made.subsampled < 64
    # With none at all: what is linear between centers.
    monkeypatch.setattr("scenec.backends.picture.haze._SHARE", 0.0)
    _, made = seen(scene, camera, haze(300.0), None)
    assert abs(made.transmittance[4, 4, 0] - (part * far + (1.0 - part) * near)) < 0.4
    assert near > made.transmittance[4, 4, 0] > far
    # What the budget leaves out is counted.
    assert made.subsampled == 0
    assert made.changing > 0


def test_the_error_at_edges_is_the_covariance_of_light_and_transmittance(monkeypatch):
    # One pixel against 32 x 32 of them, whose light differs between the walls.
    part = 0.4
    camera = scenes.camera(8, 8, 40.0)
    pixel = 10.0 / camera.intrinsics[0, 0]
    scene = edge(-part * pixel)
    of = haze(300.0, shown=np.full(3, 1.0))
    lights = np.array([0.2, 0.8])
    fine_camera = scenes.camera(256, 256, 40.0)
    fine_rays = camera_rays(fine_camera)
    row, _, t = ExactCaster(scene).cast(fine_rays)
    light = lights[row].reshape(256, 256)
    lengths = np.sqrt((fine_rays.directions**2).sum(1)) * t
    passed = np.exp(-3.912 / 300.0 * lengths).reshape(256, 256)
    exact = light * passed + (1.0 - passed)

    def boxed(values: NDArray) -> NDArray:
        return values.reshape(8, 32, 8, 32).mean(axis=(1, 3))

    monkeypatch.setattr("scenec.backends.picture.haze._SHARE", 4.0)
    _, made = seen(scene, camera, of, None)
    mean = boxed(light)[..., None] * np.ones(3)
    ours = made.over(mean, np.ones((8, 8)))[..., 0]
    covariance = boxed(light * passed) - boxed(light) * boxed(passed)
    np.testing.assert_allclose(boxed(exact) - ours, covariance, atol=0.13)
    # A gray wall in front of one four times as bright: at worst a quarter of their contrast.
    assert np.abs(covariance).max() > 0.05
    assert np.abs(covariance).max() <= 0.25 * 0.6


def test_noise_estimates_shrink_with_what_arrives():
    rng = np.random.default_rng(1)
    halves = rng.uniform(0.5, 1.5, (2, 8, 8, 3)).astype(np.float32)
    whole = np.ones((8, 8), np.float32)
    camera = scenes.camera(8, 8)
    scene = replace(scenes.scene([], []), lighting=(Lighting((), ()),))
    clear = compose(Radiance(halves, whole, 2), scene, camera, 0)
    one = np.ones((8, 8, 3))
    half = Veil(0.5 * one, 0.0 * one, one, 0.0 * one, 0)
    dark = compose(Radiance(halves, whole, 2), scene, camera, 0, half)
    # Black airlight: the picture and its noise are half as bright.
    assert dark.noise.relative_rms == pytest.approx(clear.noise.relative_rms)
    bright = Veil(0.5 * one, 0.5 * one, one, 0.0 * one, 0)
    veiled = compose(Radiance(halves, whole, 2), scene, camera, 0, bright)
    mean = 0.5 * (halves[0] + halves[1]).astype(float)
    level = float((0.5 * mean + 0.5).mean())
    expected = clear.noise.relative_rms * float(mean.mean()) * 0.5 / level
    assert veiled.noise.relative_rms == pytest.approx(expected, rel=1e-5)
    smooth = Radiance(halves, whole, 2, denoised=np.ones((8, 8, 3), np.float32))
    np.testing.assert_allclose(compose(smooth, scene, camera, 0, bright).rgb, 1.0, rtol=1e-6)


def test_what_a_renderer_alone_has_met_is_as_hazy_as_what_is_beside_it():
    camera, of = scenes.camera(8, 8, 40.0), haze(100.0)
    scene = wall(50.0)
    caster, rays = ExactCaster(scene), camera_rays(camera)
    t = caster.cast(rays)[2]
    # A renderer's float32 sees the wall one row higher.
    covered = np.isfinite(t).reshape(8, 8).astype(np.float32)
    covered[:-1] = np.maximum(covered[:-1], covered[1:])
    air = air_at(replace(scene, haze=(of,), lighting=(Lighting((), ()),)), 0)
    assert air is not None
    made = veil(air, camera, caster, rays, t, covered)
    assert made.transmittance[covered > 0.0].max() < 0.2


class Blind(Raster):
    """Sees nothing, so that all of its visibility is wrong."""

    name = "blind"

    def witness(self, rays: Rays, sample: int, camera: Camera | None = None) -> Visibility | None:
        """Misses."""
        nothing = np.full(len(rays.origins), -1, np.int32)
        return Visibility(nothing, np.zeros_like(nothing))


def test_haze_is_bit_identical_whatever_the_renderer_saw_and_is_asked_for():
    camera, own = scenes.camera(24, 18, 60.0), np.array([1.0, 2.0, 3.0])
    scene = replace(edge(0.3), haze=(haze(300.0, shown=own),), cameras=((camera,),))
    pictures = []
    for backend, passes in (
        (completed(Raster)(), ["rgb"]),
        (completed(Raster)(), ["rgb", "depth"]),
        (completed(Blind)(), ["rgb", "depth", "instance"]),
    ):
        session = Session(scene, backend)
        result = session.render(camera, 0, session.passes(passes, camera), 2, 0)
        arrays, record = result.arrays, result.record
        pictures.append(arrays["rgb"])
        assert next(iter(arrays)) == "rgb"
        assert record.seconds["haze"] > 0.0
        assert record.haze.subsampled_pixels > 0
        assert any("haze" in line for line in record.losses)
    np.testing.assert_array_equal(pictures[0], pictures[1])
    np.testing.assert_array_equal(pictures[0], pictures[2])
    # LEVEL near, more of the airlight far.
    near, far = pictures[0][9, 20], pictures[0][9, 3]
    assert np.allclose(far, own, rtol=0.01)
    assert abs(near[1] - 2.0) < 1e-6
    assert 1.0 < near[0] < 2.0


def test_without_haze_nothing_is_done_or_imported(monkeypatch):
    monkeypatch.delitem(sys.modules, "scenec.backends.picture.haze")
    camera = scenes.camera(8, 6)
    session = Session(replace(edge(0.0), cameras=((camera,),)), completed(Raster)())
    result = session.render(camera, 0, ("rgb", "depth"), 2, 0)
    arrays, record = result.arrays, result.record
    assert "scenec.backends.picture.haze" not in sys.modules
    assert "haze" not in record.seconds
    assert record.haze is None
    np.testing.assert_array_equal(arrays["rgb"], np.float32(LEVEL))
