"""Light through Mitsuba has the radiance that the equations say, within Monte Carlo error."""

from __future__ import annotations

from typing import Any

import mitsuba_scenes as ms
import numpy as np
import pytest
import scenes
from numpy.typing import NDArray

from scenec.backends.contract import Radiance
from scenec.backends.mitsuba import Mitsuba
from scenec.backends.mitsuba.adapter import MAX_WAVEFRONT, mix, split_samples
from scenec.backends.mitsuba.emitter import sky_guide
from scenec.backends.picture.sky import Sky, combine, texel_directions
from scenec.backends.stage.scene import RenderScene

#: Standard errors allowed; two-sided odds of a false alarm are 6e-7 a test.
Z = 5.0
#: Float32 along the way, relative.
ROUNDING = 1e-4


def render(scene: RenderScene, spp: int = 64, seed: int = 1) -> Radiance:
    backend = Mitsuba()
    backend.load(scene)
    return backend.radiance(scene.cameras[0][0], 0, spp, seed)


def assert_mean(radiance: Radiance, expected: float) -> None:
    """All pixels estimate the same number, independently: a Z-test on their mean."""
    pixels = radiance.halves.astype(float).mean(axis=0)[..., 0].ravel()
    error = pixels.std(ddof=1) / np.sqrt(len(pixels))
    assert abs(pixels.mean() - expected) <= Z * error + ROUNDING * expected


def over_plane(lights: list, albedo: float = 0.5) -> RenderScene:
    surface = ms.surface((albedo,) * 3)
    camera = ms.look_at((0, 0, 10), (0, 0, 0))
    return ms.scene([ms.mesh(*ms.plane())], [surface], cameras=[camera], lights=lights)


@pytest.mark.parametrize("elevation_deg", [90.0, 40.0, 8.0])
def test_a_lambertian_plane_under_the_sun_has_radiance_albedo_e_cos_over_pi(elevation_deg):
    expected = 0.5 * 1000.0 * np.sin(np.radians(elevation_deg)) / np.pi
    assert_mean(render(over_plane([ms.sun(elevation_deg)])), expected)


@pytest.mark.parametrize("diameter_deg", [0.0, 0.5, 10.0])
def test_the_irradiance_of_a_sun_does_not_depend_on_its_diameter(diameter_deg):
    # The mean cosine over a disc of half-angle h, weighted as irradiance is, is exactly that of its
    # center while the whole disc is up: radiance is E / (pi sin(h)**2) for that very reason.
    lit = render(over_plane([ms.sun(35.0, diameter_deg=diameter_deg)]))
    assert_mean(lit, 0.5 * 1000.0 * np.sin(np.radians(35.0)) / np.pi)


def test_suns_and_sky_add_up():
    lights = [ms.sun(50, 0, 400, 5), ms.sun(30, 80, 600, 1), ms.dome(20.0)]
    suns = 0.5 / np.pi * (400 * np.sin(np.radians(50)) + 600 * np.sin(np.radians(30)))
    assert_mean(render(over_plane(lights), 128), suns + 0.5 * 20.0)


def test_a_white_convex_body_vanishes_in_a_white_furnace():
    # Convex, so light meets it once: no path is cut short by the limit on bounces.
    points, faces = scenes.icosphere(2)
    camera = ms.look_at((0, -1.7, 0), (0, 0, 0), 24, 24, 40)
    furnace = ms.scene(
        [ms.mesh(points, faces)], [ms.surface((1, 1, 1))], cameras=[camera], lights=[ms.dome(3.0)]
    )
    radiance = render(furnace)
    assert radiance.coverage.min() == 1.0
    assert_mean(radiance, 3.0)


def cup() -> RenderScene:
    """A white box without a lid, which a camera looks into from above."""
    square = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
    points = np.concatenate(
        [np.column_stack([square, np.zeros(4)]), np.column_stack([square, np.full(4, 2.0)])]
    )
    quads = [(0, 1, 2, 3), (0, 1, 5, 4), (1, 2, 6, 5), (2, 3, 7, 6), (3, 0, 4, 7)]
    faces = [t for a, b, c, d in quads for t in ((a, b, c), (a, c, d))]
    camera = ms.look_at((0, 0, 6), (0, 0, 0), 32, 32, 12)
    white = ms.surface((1, 1, 1))
    return ms.scene([ms.mesh(points, faces)], [white], cameras=[camera], lights=[ms.dome(1.0)])


def test_a_white_cup_in_a_furnace_returns_it_once_paths_are_long_enough():
    # Five white walls and an open top: light is lost to the limit on bounces alone, some 17 % of
    # what is left at each. Samplers whose dimensions depend on each other fail here: at these 16
    # samples a half Mitsuba's stratified gives 1.058, its ldsampler 0.995. In a constant sky no
    # light is drawn: all of it is found by directions of bounces.
    box = cup()
    camera = box.cameras[0][0]
    losses = []
    for bounces in (1, 4, 100):
        backend = Mitsuba(bounces=bounces)
        backend.load(box)
        # 10 seeds of 32 samples rather than one of 320: what is tested is small sets.
        means = np.array([backend.radiance(camera, 0, 32, s).halves.mean() for s in range(10)])
        losses.append(1.0 - means.mean())
    error = means.std(ddof=1) / np.sqrt(len(means))
    assert losses[0] > losses[1] + 0.1
    assert losses[1] > 0.1
    # Nine degrees of freedom: beyond 7 standard errors once in 15,000 runs.
    assert abs(losses[2]) < 7 * error + ROUNDING


def test_four_bounces_in_a_white_cup_are_those_of_independent_samples(tmp_path):
    # Under a sun and a sky whose bright part is drawn: all of a path's dimensions count.
    picture = np.ones((8, 16, 3))
    picture[1, 3] = 30.0
    sky = ms.write_latlong(tmp_path / "sky.exr", picture)
    box = ms.with_lights(cup(), [ms.sun(50.0), ms.dome(100.0, sky)])
    backend = Mitsuba()
    backend.load(box)

    def means(spp: int, seeds: range) -> tuple[float, float]:
        found = [backend.radiance(box.cameras[0][0], 0, spp, s).halves.mean() for s in seeds]
        return float(np.mean(found)), float(np.std(found, ddof=1) / np.sqrt(len(found)))

    ours, our_error = means(8, range(24))

    def independent(seed: Any, pixel: Any, index: Any) -> Any:
        import mitsuba as mi

        sampler = mi.load_dict({"type": "independent"})
        sampler.seed(seed, len(pixel))
        return sampler

    backend._sampler = independent
    theirs, their_error = means(256, range(8))
    error = np.hypot(our_error, their_error)
    assert error < 2e-3 * ours
    assert abs(ours - theirs) < 6.0 * error


@pytest.mark.parametrize("rotation", range(2))
def test_mitsubas_sky_is_the_shared_lookup_in_every_direction(tmp_path, rotation):
    from scenec.backends.mitsuba.emitter import dome_dict
    from scenec.backends.mitsuba.variant import load_mitsuba
    from scenec.backends.picture.sky import lookup
    from scenec.backends.stage.scene import Dome

    rng = np.random.default_rng(4)
    file = ms.write_latlong(tmp_path / "sky.exr", rng.uniform(0.1, 5, (7, 12, 3)))
    to_world = ms.DOME_Z_UP if rotation == 0 else scenes.rotation(rng)
    sky = combine((Dome(file, np.array([1.0, 2.0, 0.5]), to_world),))
    assert sky is not None
    mi = load_mitsuba()
    directions = rng.normal(size=(5000, 3))
    directions /= np.linalg.norm(directions, axis=1)[:, None]
    # Centers of texels too, and the neighborhoods of the poles; at a pole itself longitude, and
    # with it the lookup, is undefined.
    texels = texel_directions(7, 12).reshape(-1, 3)
    poles = np.array([[0.01, 1, 0.02], [-0.02, 1, 0.01], [0.01, -1, -0.02], [-0.01, -1, 0.02]])
    near = poles / np.linalg.norm(poles, axis=1)[:, None]
    directions = np.concatenate([directions, texels @ to_world.T, near @ to_world.T])
    emitter = mi.load_dict(dome_dict(mi, sky))
    si = mi.SurfaceInteraction3f()
    si.wi = mi.Vector3f(np.ascontiguousarray(-directions.T, np.float32))
    theirs = np.array(emitter.eval(si)).T
    np.testing.assert_allclose(theirs, lookup(sky, directions), rtol=2e-4, atol=2e-4)


def test_a_plane_under_a_textured_sky_has_the_radiance_of_its_integral(tmp_path):
    rng = np.random.default_rng(5)
    picture = rng.uniform(0.0, 4.0, (8, 16, 3))
    picture[2, 3] = 60.0
    file = ms.write_latlong(tmp_path / "sky.exr", picture)
    sky = combine((ms.dome(1.0, file),))
    assert sky is not None
    from scenec.backends.picture.sky import lookup

    # The integral of radiance * cosine over the upper half, by the midpoint rule.
    theta = (np.arange(600) + 0.5) * (np.pi / 2 / 600)
    phi = (np.arange(1200) + 0.5) * (2 * np.pi / 1200)
    t, p = np.meshgrid(theta, phi, indexing="ij")
    w = np.stack([np.sin(t) * np.cos(p), np.sin(t) * np.sin(p), np.cos(t)], -1).reshape(-1, 3)
    weight = (np.sin(t) * np.cos(t)).ravel() * (np.pi / 2 / 600) * (2 * np.pi / 1200)
    irradiance = float((lookup(sky, w)[:, 0].astype(float) * weight).sum())
    radiance = render(over_plane([ms.dome(1.0, file)]), 256)
    pixels = radiance.halves.astype(float).mean(axis=0)[..., 0].ravel()
    error = pixels.std(ddof=1) / np.sqrt(len(pixels))
    expected = 0.5 * irradiance / np.pi
    assert abs(pixels.mean() - expected) <= Z * error + 5e-4 * expected


def test_sky_and_sun_are_not_in_the_surface_light_and_have_no_coverage():
    camera = ms.look_at((0, 0, 2), (1000, 0, 2), 16, 12)
    scene = ms.scene(
        [ms.mesh(*ms.plane(1e4))], cameras=[camera], lights=[ms.sun(5.0), ms.dome(7.0)]
    )
    radiance = render(scene)
    assert np.all(radiance.coverage[:5] == 0.0)
    assert np.all(radiance.halves[:, :5] == 0.0)
    assert np.all(radiance.coverage[7:] == 1.0)


def test_without_any_light_surfaces_are_black_and_still_there():
    radiance = render(over_plane([]))
    assert np.all(radiance.halves == 0.0)
    assert np.all(radiance.coverage == 1.0)


def test_light_may_change_from_sample_to_sample_without_loading_again():
    import dataclasses

    lit = over_plane([ms.sun(90.0)])
    changing = dataclasses.replace(
        lit,
        samples=3,
        cameras=lit.cameras * 3,
        lighting=tuple(
            over_plane(lights).lighting[0] for lights in ([ms.sun(90)], [ms.sun(30)], [ms.dome(2)])
        ),
    )
    backend = Mitsuba()
    backend.load(changing)
    camera = lit.cameras[0][0]
    for sample, expected in ((0, 500 / np.pi), (1, 250 / np.pi), (2, 1.0), (0, 500 / np.pi)):
        assert_mean(backend.radiance(camera, sample, 64, 1), expected)


def test_the_halves_differ_and_their_difference_estimates_the_error():
    backend = Mitsuba()
    scene = over_plane([ms.sun(40), ms.dome(300.0)])
    backend.load(scene)
    camera = scene.cameras[0][0]
    radiances = [backend.radiance(camera, 0, 32, seed) for seed in range(12)]
    means = np.array([r.halves.astype(float).mean(axis=0) for r in radiances])
    predicted = np.mean([(0.5 * (r.halves[0].astype(float) - r.halves[1])) ** 2 for r in radiances])
    assert predicted == pytest.approx(means.var(axis=0, ddof=1).mean(), rel=0.1)


@pytest.mark.parametrize("spp", [1, 2, 7, 24, 64, 1000])
def test_sample_counts_split_into_passes_that_fit_and_add_up(spp):
    for pixels in (100, 640 * 480, 1 << 24, 1 << 26):
        parts = split_samples(spp, pixels, MAX_WAVEFRONT)
        assert sum(parts) == spp
        assert min(parts) >= 1
        assert max(parts) == 1 or (max(parts) - 1) * pixels < MAX_WAVEFRONT


def test_only_what_is_bright_of_a_sky_is_drawn():
    up = texel_directions(16, 32) @ ms.DOME_Z_UP[2]
    even = np.ones((16, 32, 3), np.float32)
    bright = even.copy()
    bright[4, 9] = 50.0
    below = even.copy()
    below[12, 9] = 50.0

    def guide(picture: NDArray[np.float32], least: float = 0.0) -> NDArray[np.float32] | None:
        found = sky_guide(Sky(picture, ms.DOME_Z_UP), least)
        return None if found is None else found.picture[..., 0]

    assert guide(even[:1, :1]) is None
    assert guide(0.0 * even) is None
    above = guide(even)
    assert above is not None
    # The sky's picture alone is even; what level ground sees of it is not.
    assert (above[up < 0.2] == 0.0).all()
    assert (above[up > 0.8] > 0.0).all()
    spots = guide(bright), guide(below)
    assert all(spot is not None and spot.argmax() == p[..., 0].argmax()
               for spot, p in zip(spots, (bright, below), strict=True))  # fmt: skip
    assert guide(bright, 1.0) is not None
    assert guide(bright, 1000.0) is None


@pytest.mark.parametrize(
    ("share", "samples", "expected"),
    [(0.0, 8, 0.0), (1.0, 8, 1.0), (0.6, 8, 0.5), (0.7, 8, 0.75), (0.7, 2, 0.5), (0.7, 1, 0.5),
     (0.02, 4, 0.25), (0.99, 12, 0.75), (0.99, 6, 0.5)],
)  # fmt: skip
def test_suns_and_sky_share_samples_in_quarters_or_halves(share, samples, expected):
    backend = Mitsuba()
    backend.load(over_plane([ms.sun(40), ms.dome(300.0)]))
    backend._light.sun_share = share
    backend._light.split(samples)
    assert float(backend._light.sun_fraction[0]) == expected


def test_a_weak_sun_is_chosen_rarely_and_counts_in_full():
    lights = [ms.sun(50, 0, 990.0), ms.sun(30, 80, 10.0)]
    lit = render(over_plane(lights), 256)
    expected = 0.5 / np.pi * (990 * np.sin(np.radians(50)) + 10 * np.sin(np.radians(30)))
    assert_mean(lit, expected)


def test_seeds_of_halves_are_all_different():
    assert len({mix(seed, half) for seed in range(200) for half in range(2)}) == 400
