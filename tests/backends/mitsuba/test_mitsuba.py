"""What is special to Mitsuba, and its conformance."""

from __future__ import annotations

import os
import subprocess
import sys
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from scenec.backends.mitsuba import Mitsuba, variant
from scenec.backends.mitsuba.adapter import MAX_WAVEFRONT, split_samples
from scenec.backends.picture.guide import sky_guide
from scenec.backends.picture.sky import Sky, combine, lookup, texel_directions
from scenec.backends.stage.scene import Dome, RenderScene
from scenec.backends.testing import Conformance
from scenec.backends.testing import scenes as ms


class TestMitsuba(Conformance):
    """All of it, within the default tolerance."""

    backend = Mitsuba


@pytest.mark.parametrize("rotation", range(2))
def test_mitsubas_sky_is_the_shared_lookup_in_every_direction(tmp_path, rotation):
    rng = np.random.default_rng(4)
    file = ms.write_latlong(tmp_path / "sky.exr", rng.uniform(0.1, 5, (7, 12, 3)))
    to_world = ms.DOME_Z_UP if rotation == 0 else ms.rotation(rng)
    sky = combine((Dome(file, np.array([1.0, 2.0, 0.5]), to_world),))
    assert sky is not None
    mi = variant.load_mitsuba()
    # Once the variant is set.
    from scenec.backends.mitsuba.emitter import dome_dict

    directions = rng.normal(size=(5000, 3))
    directions /= np.linalg.norm(directions, axis=1)[:, None]
    # Centers of texels too, and the neighborhoods of the poles; at a pole itself longitude, and
    # with it the lookup, is undefined.
    texels = texel_directions(7, 12).reshape(-1, 3)
    poles = np.array([[0.01, 1, 0.02], [-0.02, 1, 0.01], [0.01, -1, -0.02], [-0.01, -1, 0.02]])
    near = poles / np.linalg.norm(poles, axis=1)[:, None]
    directions = np.concatenate([directions, texels @ to_world.T, near @ to_world.T])
    emitter = mi.load_dict(dome_dict(sky))
    si = mi.SurfaceInteraction3f()
    si.wi = mi.Vector3f(np.ascontiguousarray(-directions.T, np.float32))
    theirs = np.array(emitter.eval(si)).T
    # A GPU's texture units interpolate with weights of eight bits; rows of nodes differ by half.
    on_gpu = mi.variant().startswith("cuda")
    atol = 1.5 * np.ptp(sky.picture) / 2**9 if on_gpu else 2e-4
    np.testing.assert_allclose(theirs, lookup(sky, directions), rtol=2e-4, atol=atol)


@pytest.mark.parametrize("spp", [1, 2, 7, 24, 64, 1000])
def test_sample_counts_split_into_passes_that_fit_and_add_up(spp):
    for pixels in (100, 640 * 480, 1 << 24, 1 << 26):
        parts = split_samples(spp, pixels, MAX_WAVEFRONT)
        assert sum(parts) == spp
        assert min(parts) >= 1
        assert max(parts) == 1 or (max(parts) - 1) * pixels < MAX_WAVEFRONT


about_llvm = pytest.mark.skipif(
    os.environ.get("SCENEC_TEST_DEVICE") == "cuda", reason="about LLVM, which CUDA does without"
)


@about_llvm
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
        pytest.param(
            (variant.LLVM_VARIABLE, "/no/such/library"),
            "Mend it with: pip install llvm-nanobind",
            marks=about_llvm,
        ),
    ],
)
def test_an_unusable_variant_is_said_in_one_line(setting, told):
    code = (
        "from scenec.backends.mitsuba import Mitsuba\n"
        "from scenec.schemas.errors import BackendError\n"
        "try:\n    Mitsuba(device='cpu')\nexcept BackendError as error:\n    print(error)"
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


def test_four_bounces_in_a_white_cup_are_mitsubas_of_independent_samples(tmp_path, monkeypatch):
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
    monkeypatch.setattr(backend, "_gathers", lambda: False)
    theirs, their_error = means(256, range(8))
    error = np.hypot(our_error, their_error)
    assert error < 2e-3 * ours
    assert abs(ours - theirs) < 6.0 * error


def test_pictures_that_go_on_are_one_picture():
    scene = cup()
    camera, renderer = scene.cameras[0][0], Mitsuba()
    renderer.load(scene)
    parts = [renderer.radiance(camera, 0, spp, 3, first=at) for spp, at in ((8, 0), (16, 8))]
    own = renderer.radiance(camera, 0, 16, 3).halves
    together = sum(part.spp * part.halves.astype(float) for part in parts) / 24.0
    whole = renderer.radiance(camera, 0, 24, 3)
    np.testing.assert_allclose(together, whole.halves, rtol=1e-4, atol=1e-6)
    assert np.abs(parts[1].halves - own).max() > 0.01


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


def over_plane(lights: list, albedo: float = 0.5) -> RenderScene:
    surface = ms.surface((albedo,) * 3)
    camera = ms.look_at((0, 0, 10), (0, 0, 0))
    return ms.scene([ms.mesh(*ms.plane())], [surface], cameras=[camera], lights=lights)


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
    lit = over_plane([ms.sun(50, 0, 990.0), ms.sun(30, 80, 10.0)])
    backend = Mitsuba()
    backend.load(lit)
    light = backend.radiance(lit.cameras[0][0], 0, 256, 1).halves.mean(axis=0, dtype=np.float64)
    expected = 0.5 / np.pi * (990 * np.sin(np.radians(50)) + 10 * np.sin(np.radians(30)))
    error = light[..., 0].std(ddof=1) / np.sqrt(light[..., 0].size)
    assert abs(light[..., 0].mean() - expected) <= 5.0 * error + 1e-4 * expected
