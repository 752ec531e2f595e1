"""Roughness that varies, in the preview; nothing in it is random."""

from __future__ import annotations

import dataclasses

import numpy as np
import rough_scenes
from numpy.typing import NDArray

from scenec.backends.pyrender import Pyrender
from scenec.backends.stage.scene import RenderScene


def picture(scene: RenderScene, spp: int = 4) -> NDArray:
    backend = Pyrender()
    backend.load(scene)
    return backend.radiance(scene.cameras[0][0], 0, spp, 1).halves[0].astype(float)


def test_strips_of_a_variation_are_strips_of_these_roughnesses():
    expected = picture(rough_scenes.constant_strips())
    np.testing.assert_allclose(picture(rough_scenes.strips()), expected, rtol=1e-4)
    still = dataclasses.replace(rough_scenes.SURFACE, roughness_variation=0.0)
    assert np.abs(picture(rough_scenes.strips(still)) / expected - 1).max() > 0.3


def test_a_map_of_roughness_varies_as_a_number_does(tmp_path):
    mapped, plain = rough_scenes.mapped(tmp_path)
    expected = picture(rough_scenes.strips(plain))
    # Maps are half floats there.
    np.testing.assert_allclose(picture(rough_scenes.strips(mapped)), expected, rtol=5e-3)


def test_roughness_is_interpolated_and_then_squared():
    scene = rough_scenes.ramp()
    expected = rough_scenes.expected_ramp(scene)
    np.testing.assert_allclose(picture(scene, 16)[..., 0], expected, rtol=0.02)


def test_layers_that_vary_mix_as_pictures_do():
    mixed, alone, shares = rough_scenes.layered()
    expected = sum(w * picture(s) for w, s in zip(shares, alone, strict=True))
    np.testing.assert_allclose(picture(mixed), expected, rtol=2e-3)
