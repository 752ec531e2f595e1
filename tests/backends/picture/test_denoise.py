"""Denoised pictures are nearer to the truth; the sky and the halves stay as they were."""

from __future__ import annotations

import importlib.metadata
import sys
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter

from scenec.backends.contract import Radiance
from scenec.backends.noise_seeds import round_seed
from scenec.backends.picture import denoise
from scenec.backends.picture.adaptive import Target, collect
from scenec.backends.picture.compose import denoised_noise
from scenec.backends.picture.noise import estimate, estimate_denoised
from scenec.backends.registry import open_backend
from scenec.backends.run.plan import RenderPlan
from scenec.backends.stage.scene import RenderScene
from scenec.backends.testing import scenes as ms
from scenec.schemas.errors import BackendError
from scenec.testing.extras import needs


def ball_on_a_plane() -> RenderScene:
    ball, faces = ms.icosphere(3)
    return ms.scene(
        [ms.mesh(*ms.plane(8.0)), ms.mesh(ball, faces, (1,), normals=ball)],
        [ms.surface((0.5, 0.4, 0.3)), ms.surface((0.2, 0.3, 0.4), 0.3, 0.4)],
        rows=[(0, ms.affine()), (1, ms.affine(1.0, (0, 0, 0.8)))],
        cameras=[ms.look_at((0, -6, 1.0), (0, 0, 1.2), 96, 72, 50)],
        lights=[ms.sun(40, 20, 500, 3.0), ms.dome(40.0)],
    )


@pytest.mark.parametrize(
    ("name", "most"),
    [
        ("mitsuba", 0.5),
        pytest.param("cycles", 0.7, marks=[pytest.mark.slow, needs("cycles", "bpy")]),
    ],
)
def test_denoising_leaves_the_halves_alone_and_the_sky_dark(name, most):
    scene = ball_on_a_plane()
    view = scene.cameras[0][0]
    backend = open_backend(name, "cpu")
    backend.load(scene)
    plain = backend.radiance(view, 0, 8, 1)
    assert plain.denoised is None
    denoised = backend.radiance(view, 0, 8, 1, denoise=True)
    np.testing.assert_array_equal(plain.halves, denoised.halves)
    np.testing.assert_array_equal(plain.coverage, denoised.coverage)
    clean = denoised.denoised
    assert clean is not None
    true = backend.radiance(view, 0, 512, 2).halves.mean(axis=0)
    noisy = plain.halves.mean(axis=0)
    inside = plain.coverage == 1.0
    assert np.mean((clean - true)[inside] ** 2) < most * np.mean((noisy - true)[inside] ** 2)
    assert clean[inside].mean() == pytest.approx(true[inside].mean(), rel=0.01)
    assert np.all(clean[plain.coverage == 0.0] == 0.0)
    rim = (plain.coverage > 0.0) & ~inside
    assert rim.sum() > 30
    np.testing.assert_array_equal(clean[rim], noisy[rim])


def blurred(halves: NDArray) -> NDArray:
    """A denoiser that anyone can follow: the mean of 5 x 5 pixels."""
    return uniform_filter(halves, (0, 5, 5, 0))


@pytest.mark.parametrize("deviation", [0.05, 0.3, 1.5])
def test_the_error_after_denoising_is_stated_with_its_bias(deviation):
    rng = np.random.default_rng(5)
    # Edges that the mean blurs, and noise of unequal pixels.
    true = np.where(np.add.outer(np.arange(72) // 12, np.arange(96) // 12) % 2, 3.0, 1.0)
    true = true[..., None] * [1.0, 0.7, 0.4]
    each = deviation * np.exp(rng.normal(0.0, 0.5, (72, 96, 1)))
    covered = np.ones((72, 96), bool)
    covered[:20, :30] = False
    level, held, ratios = true[covered].mean(), 0, []
    for _ in range(60):
        halves = true + each * rng.standard_normal((2, 72, 96, 1)) * [1.0, 0.8, 0.5]
        clean = blurred(halves)
        error = np.sqrt(((clean.mean(axis=0) - true)[covered] ** 2).mean()) / level
        whole = estimate_denoised([(clean, halves, covered)])
        ratios.append((whole.relative_rms / error) ** 2)
        held += error <= whole.relative_rms_bound_95
        rows = [np.s_[:, :40], np.s_[:, 40:]]
        parts = [(clean[own], halves[own], covered[own[1]]) for own in rows]
        assert estimate_denoised(parts).relative_rms == pytest.approx(whole.relative_rms)
    assert np.mean(ratios) == pytest.approx(1.0, abs=0.05)
    assert held >= 54


def test_what_was_not_denoised_has_the_error_that_its_halves_tell():
    halves = np.random.default_rng(6).normal(10.0, 1.0, (2, 24, 32, 3))
    covered = np.ones((24, 32), bool)
    found = estimate_denoised([(halves, halves, covered)])
    assert found.relative_rms == pytest.approx(estimate(halves, covered).relative_rms)
    assert estimate_denoised([(0.0 * halves, 0.0 * halves, covered)]).relative_rms == 0.0
    assert estimate_denoised([]).relative_rms is None


@pytest.mark.parametrize("name", ["mitsuba", pytest.param("cycles", marks=needs("cycles", "bpy"))])
def test_the_error_of_a_denoised_picture_is_stated(name):
    scene = ball_on_a_plane()
    view, backend = scene.cameras[0][0], open_backend(name, "cpu")
    backend.load(scene)
    best = backend.radiance(view, 0, 1024, 2)
    true, covered = best.halves.mean(axis=0, dtype=float), best.coverage > 0.0
    for spp in (4, 16):
        picture = backend.radiance(view, 0, spp, 1, denoise=True)
        error = np.sqrt(((picture.denoised - true)[covered] ** 2).mean()) / true[covered].mean()
        assert denoised_noise([(picture, None)]).relative_rms == pytest.approx(error, rel=0.25)


def test_rounds_are_denoised_together_and_their_error_after_it_counts():
    scene = ball_on_a_plane()
    view, backend = scene.cameras[0][0], open_backend("mitsuba", "cpu")
    backend.load(scene)

    def draw(spp: int, seed: int, first: int) -> Radiance:
        return backend.radiance(view, 0, spp, seed, first=first)

    def clean(picture: Radiance, seed: int) -> Radiance:
        return backend.denoise(view, 0, picture, seed)

    options = {"continues": True, "denoise": clean}
    picture, rounds = collect(draw, 7, Target(0.025, None, 256), **options)
    assert rounds.stopped == "error"
    once = backend.radiance(view, 0, rounds.spp, round_seed(7, 0), denoise=True)
    np.testing.assert_allclose(picture.denoised, once.denoised, rtol=2e-3, atol=2e-3)
    plain = collect(draw, 7, Target(0.025, None, 256), continues=True)[1]
    assert rounds.spp < plain.spp
    # Where denoising does harm, the picture as it is counts.
    picture, rounds = collect(draw, 7, Target(0.004, None, 4096), **options)
    assert (rounds.stopped, rounds.denoised, picture.denoised) == ("error", False, None)


@pytest.mark.parametrize(("goal", "wins"), [(0.02, True), (0.002, False)])
def test_of_rounds_that_are_denoised_apart_the_better_mean_counts(goal, wins):
    true = (2.0 + np.sin(np.arange(64) / 8.0))[:, None, None] * np.ones((64, 64, 3))

    def draw(spp: int, seed: int) -> Radiance:
        noise = np.random.default_rng(seed).standard_normal((2, 64, 64, 3)) / np.sqrt(spp)
        halves = true + 0.4 * noise
        clean = 0.9 * blurred(halves) + 0.1 * halves
        made = Radiance(halves.astype(np.float32), np.ones((64, 64), np.float32), spp)
        return replace(made, denoised=clean.mean(axis=0), denoised_halves=clean)

    picture, rounds = collect(draw, 7, Target(goal, None, 1 << 16))
    assert (rounds.stopped, rounds.denoised) == ("error", wins)
    assert (picture.denoised is not None) == wins
    shown = picture.halves.mean(axis=0) if picture.denoised is None else picture.denoised
    error = np.sqrt(((shown - true) ** 2).mean()) / true.mean()
    assert error <= rounds.made[-1].relative_rms_bound_95 <= goal


@pytest.mark.parametrize("shape", [(1, 1), (3, 70), (48, 64)])
def test_an_even_picture_comes_back_up_to_its_borders(shape):
    even = np.full((2, *shape, 3), 3.0, np.float32)
    up = np.zeros((*shape, 3), np.float32)
    up[..., 2] = 1.0
    clean = denoise.denoise(even, np.ones(shape, np.float32), 0.1 * even[0], up)
    np.testing.assert_allclose(clean, even, rtol=5e-3)


def test_a_library_that_cannot_be_loaded_is_one_line(monkeypatch):
    monkeypatch.setitem(sys.modules, "pyoidn", None)
    even = np.ones((2, 4, 4, 3), np.float32)
    with pytest.raises(BackendError, match="OpenImageDenoise does not work here") as raised:
        denoise.denoise(even, even[0, ..., 0], even[0], even[0])
    assert "\n" not in str(raised.value)


def test_without_its_package_a_message_says_what_brings_a_denoiser(monkeypatch):
    from scenec.backends.mitsuba.adapter import Mitsuba

    def missing(name: str) -> str:
        raise importlib.metadata.PackageNotFoundError(name)

    monkeypatch.setattr(denoise, "version", missing)
    assert denoise.installed() is None
    monkeypatch.setattr(Mitsuba, "denoiser", denoise.installed())
    with pytest.raises(BackendError, match=r"mitsuba has no denoiser here: .*scenec\[denoise\]"):
        RenderPlan("mitsuba", denoise=True)
