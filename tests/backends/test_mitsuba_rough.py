"""Roughness that varies, in Mitsuba."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import rough_scenes
from numpy.typing import NDArray

from scenec.backends.mitsuba import Mitsuba
from scenec.backends.stage.scene import RenderScene


def picture(scene: RenderScene, spp: int) -> NDArray:
    backend = Mitsuba()
    backend.load(scene)
    return backend.radiance(scene.cameras[0][0], 0, spp, 2).halves.astype(float).mean(axis=0)


def test_strips_of_a_variation_are_strips_of_these_roughnesses(tmp_path):
    expected = picture(rough_scenes.constant_strips(), 256)
    got = picture(rough_scenes.strips(), 256)
    # The same random numbers meet the same lobes.
    np.testing.assert_allclose(got, expected, rtol=1e-3)
    still = dataclasses.replace(rough_scenes.SURFACE, roughness_variation=0.0)
    assert np.abs(picture(rough_scenes.strips(still), 256) / expected - 1).max() > 0.3


def test_a_map_of_roughness_varies_as_a_number_does(tmp_path):
    mapped, plain = rough_scenes.mapped(tmp_path)
    got = picture(rough_scenes.strips(mapped), 1024)
    expected = picture(rough_scenes.strips(plain), 1024)
    # The two are put together of other BSDFs, so their noise is not the same.
    strips = (got.reshape(12, 4, 8, 3).mean((0, 2)), expected.reshape(12, 4, 8, 3).mean((0, 2)))
    np.testing.assert_allclose(*strips, rtol=1e-2)


def test_a_number_beside_another_map_varies_too(tmp_path):
    from PIL import Image

    from scenec.backends.stage.scene import Maps

    file = tmp_path / "white.png"
    Image.fromarray(np.full((2, 2, 3), 255, np.uint8)).save(file)
    plain = rough_scenes.SURFACE
    tinted = dataclasses.replace(plain, maps=Maps(3.0, base_color=file))
    got = picture(rough_scenes.strips(tinted), 1024)
    expected = picture(rough_scenes.strips(plain), 1024)
    strips = (got.reshape(12, 4, 8, 3).mean((0, 2)), expected.reshape(12, 4, 8, 3).mean((0, 2)))
    np.testing.assert_allclose(*strips, rtol=1e-2)


def test_roughness_is_interpolated_and_then_squared():
    scene = rough_scenes.ramp()
    expected = rough_scenes.expected_ramp(scene)
    np.testing.assert_allclose(picture(scene, 1024)[..., 0], expected, rtol=0.02)


def test_layers_that_vary_mix_as_pictures_do():
    mixed, alone, shares = rough_scenes.layered()
    expected = sum(w * picture(s, 1024) for w, s in zip(shares, alone, strict=True))
    got = picture(mixed, 2048).mean((0, 1))
    np.testing.assert_allclose(got, expected.mean((0, 1)), rtol=5e-3)


@pytest.mark.parametrize("amount", [-1.0, 1.0])
def test_the_least_roughness_is_finite(amount):
    surface = dataclasses.replace(rough_scenes.SURFACE, roughness_variation=amount)
    got = picture(rough_scenes.strips(surface), 16)
    assert np.isfinite(got).all()
    assert got.min() >= 0.0
