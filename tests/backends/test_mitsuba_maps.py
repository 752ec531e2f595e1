"""Metals and surface maps in Mitsuba, against closed forms."""

from __future__ import annotations

import map_scenes
import numpy as np
import pytest
from surface_oracle import brighter

from scenec.backends.mitsuba import Mitsuba


def picture(scene, spp=256):
    backend = Mitsuba()
    backend.load(scene)
    return backend.radiance(scene.cameras[0][0], 0, spp, 2).halves.astype(float).mean(axis=0)


@pytest.mark.parametrize("offset", [(0.0, 0.0), (1003.7, -508.2)])
def test_a_base_color_map_lies_where_it_is_defined_to_lie(tmp_path, offset):
    scene = map_scenes.albedo_scene(tmp_path, offset)
    got = picture(scene) * np.pi / map_scenes.IRRADIANCE
    expected = map_scenes.expected_albedo(scene.cameras[0][0])
    # A pixel is the mean over its area, the oracle its center: they differ at texel centers.
    assert np.sqrt(np.mean((got - expected) ** 2)) < 0.004
    assert np.abs(got.mean((0, 1)) / expected.mean((0, 1)) - 1).max() < 1e-3


@pytest.mark.parametrize("flip_green", [False, True])
def test_a_normal_map_leans_the_shading_normal(tmp_path, flip_green):
    tilt = (0.3, -0.4)
    scene = map_scenes.normal_scene(tmp_path, tilt, flip_green)
    got = picture(scene, 64).mean() * np.pi / map_scenes.IRRADIANCE
    np.testing.assert_allclose(got, map_scenes.expected_cosine(tilt, flip_green), rtol=3e-3)


@pytest.mark.parametrize("mapped", [False, True])
def test_a_metal_is_a_tinted_ggx_lobe(tmp_path, mapped):
    scene = map_scenes.metal_scene(tmp_path if mapped else None)
    expected = map_scenes.expected_metal(scene.cameras[0][0])
    np.testing.assert_allclose(picture(scene), expected, rtol=0.02)
    np.testing.assert_allclose(picture(scene).mean((0, 1)), expected.mean((0, 1)), rtol=2e-3)


def test_a_varied_metal_beside_a_dull_layer_is_drawn():
    # Per-vertex colors and one weight for all: arrays of both lengths meet.
    import dataclasses

    import mitsuba_scenes as ms

    points, faces = ms.plane(cells=4)
    mesh = ms.mesh(points, faces, variation=np.full(len(points), 0.5))
    metal = dataclasses.replace(ms.surface((0.4, 0.2, 0.1), 0.1, 0.9, 0.4), metallic=0.5)
    camera = ms.look_at((0, 0, 10), (0, 0, 0), 8, 8, 2.0)
    colors = np.array([0.4, 0.2, 0.1]) * 1.2

    def seen(surface):
        scene = ms.scene([mesh], [surface], cameras=[camera], lights=[ms.dome(1.0)])
        return picture(scene, 4096).mean((0, 1))

    lobe = seen(dataclasses.replace(metal, metallic=0.0, specular=1.0))
    again = brighter(colors, 0.9, 1.0) / brighter(1.0, 0.9, 1.0)
    expected = 0.5 * (0.9 * colors + 0.1 * lobe) + 0.5 * colors * lobe * again
    np.testing.assert_allclose(seen(metal), expected, rtol=3e-3)


def test_mapped_and_plain_layers_mix_by_their_weights(tmp_path):
    # A map of one color is that color: the nested BSDFs must equal the merged lobes.
    import dataclasses

    import mitsuba_scenes as ms
    from PIL import Image

    from scenec.backends.stage.scene import Maps

    file = tmp_path / "flat.png"
    Image.fromarray(np.full((2, 2, 3), 188, np.uint8)).save(file)
    linear = ((188 / 255 + 0.055) / 1.055) ** 2.4
    # Two triangles: weights that cross them show any product taken at the vertices.
    points, faces = ms.plane()
    weights = np.stack([(points[:, 0] + 50) / 100, np.full(len(points), 0.3)])
    mesh = ms.mesh(points, faces, (0, 1, 2), weights, variation=np.full(len(points), 0.5))
    plain = [
        ms.surface((linear, linear, linear), 0.1, 0.5, 0.2),
        ms.surface((0.2, 0.5, 0.1), 0.4, 0.3),
        dataclasses.replace(ms.surface((0.7, 0.2, 0.1), roughness=0.5), metallic=0.5),
    ]
    mapped = [
        dataclasses.replace(plain[0], base_color=(1.0, 1.0, 1.0), maps=Maps(3.0, base_color=file)),
        *plain[1:],
    ]
    camera = ms.look_at((0, -30, 30), (0, 0, 0), 24, 16, 60)
    lights = [ms.sun(50.0, diameter_deg=2.0), ms.dome(100.0)]
    pictures = [
        picture(ms.scene([mesh], surfaces, cameras=[camera], lights=lights), 512)
        for surfaces in (plain, mapped)
    ]
    np.testing.assert_allclose(pictures[1].mean((0, 1)), pictures[0].mean((0, 1)), rtol=3e-3)
