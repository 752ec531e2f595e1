"""Denoised pictures are nearer to the truth; the sky and the halves stay as they were."""

from __future__ import annotations

import importlib.metadata
import sys

import numpy as np
import pytest
from test_mitsuba_kept import field, loaded

from scenec.backends.picture import denoise
from scenec.backends.registry import open_backend
from scenec.backends.run.plan import RenderPlan
from scenec.backends.stage.scene import RenderScene
from scenec.backends.testing import scenes as ms
from scenec.schemas.errors import BackendError


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
    ("name", "most"), [("mitsuba", 0.5), pytest.param("cycles", 0.7, marks=pytest.mark.slow)]
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


@pytest.mark.parametrize("shape", [(1, 1), (3, 70), (48, 64)])
def test_an_even_picture_comes_back_up_to_its_borders(shape):
    even = np.full((2, *shape, 3), 3.0, np.float32)
    up = np.zeros((*shape, 3), np.float32)
    up[..., 2] = 1.0
    clean = denoise.denoise(even, np.ones(shape, np.float32), 0.1 * even[0], up)
    np.testing.assert_allclose(clean, even[0], rtol=5e-3)


def test_a_library_that_cannot_be_loaded_is_one_line(monkeypatch):
    monkeypatch.setitem(sys.modules, "pyoidn", None)
    even = np.ones((2, 4, 4, 3), np.float32)
    with pytest.raises(BackendError, match="OpenImageDenoise does not work here") as raised:
        denoise.denoise(even, even[0, ..., 0], even[0], even[0])
    assert "\n" not in str(raised.value)


def test_guides_are_the_surfaces_own_colors_and_normals():
    scene = ms.scene(
        [ms.mesh(*ms.plane(8.0))],
        [ms.surface((0.5, 0.4, 0.3), specular=0.2, roughness=0.5)],
        cameras=[ms.look_at((0, -6, 3.0), (0, 0, 0.0), 16, 12, 120)],
        lights=[ms.sun(40, 20, 500, 3.0)],
    )
    view = scene.cameras[0][0]
    backend = loaded(scene, np.inf)
    albedo, normal = backend._guides(view, 3)
    ground = backend.radiance(view, 0, 64, 1).coverage
    assert (ground == 1.0).any()
    assert (ground == 0.0).any()
    # A fifth of the light goes to white gloss.
    expected = np.broadcast_to([0.6, 0.52, 0.44], albedo[ground == 1.0].shape)
    np.testing.assert_allclose(albedo[ground == 1.0], expected, 1e-5)
    np.testing.assert_allclose(normal[ground == 1.0][:, 2], 1.0, atol=1e-5)
    assert not albedo[ground == 0.0].any()
    assert not normal[ground == 0.0].any()


def test_kept_instances_guide_as_written_ones_do():
    scene = field()
    view = scene.cameras[0][0]
    written, kept = (loaded(scene, most)._guides(view, 3) for most in (np.inf, 0.0))
    for ours, theirs in zip(kept, written, strict=True):
        # The same rays. Normals are mixed before they are made unit vectors, or after.
        assert (np.abs(ours - theirs).max(axis=-1) > 0.01).mean() < 0.01


def test_without_its_package_a_message_says_what_brings_a_denoiser(monkeypatch):
    from scenec.backends.mitsuba.adapter import Mitsuba

    def missing(name: str) -> str:
        raise importlib.metadata.PackageNotFoundError(name)

    monkeypatch.setattr(denoise, "version", missing)
    assert denoise.installed() is None
    monkeypatch.setattr(Mitsuba, "denoiser", denoise.installed())
    with pytest.raises(BackendError, match=r"mitsuba has no denoiser here: .*scenec\[denoise\]"):
        RenderPlan("mitsuba", denoise=True)
