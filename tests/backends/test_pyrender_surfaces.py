"""Surfaces and their maps through pyrender are what the equations say, as far as a preview goes."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import map_scenes
import mitsuba_scenes as ms
import numpy as np
import pytest
import scenes
from numpy.typing import NDArray
from PIL import Image
from pyrender_pictures import CAMERA, CLOSE, lit, picture
from surface_oracle import brighter

from scenec.backends.camera.rays import camera_rays
from scenec.backends.pyrender.tables import resample
from scenec.backends.stage.scene import Maps, Surface


def sun_irradiance() -> float:
    return 1000.0 * np.sin(np.radians(60.0))


def test_layers_merge_in_order_as_the_equation_says():
    points, faces = ms.plane()
    rng = np.random.default_rng(0)
    colors = rng.uniform(0, 1, (3, 3))
    weights = np.array([0.3, 0.6])
    mesh = ms.mesh(points, faces, (0, 1, 2), np.repeat(weights[:, None], len(points), 1))
    expected = colors[0]
    for w, color in zip(weights, colors[1:], strict=True):
        expected = w * color + (1 - w) * expected
    got = picture(lit(mesh, [ms.surface(c) for c in colors])) / (sun_irradiance() / np.pi)
    np.testing.assert_allclose(got, np.broadcast_to(expected, got.shape), rtol=CLOSE)


def test_colors_blend_linearly_between_vertices():
    points, faces = ms.plane(5.0)
    weights = ((points[:, 0] + 5.0) / 10.0)[None, :]
    mesh = ms.mesh(points, faces, (0, 1), weights)
    scene = lit(mesh, [ms.surface((0, 0, 0)), ms.surface((1, 1, 1))])
    row = picture(scene)[8, :, 0] / (sun_irradiance() / np.pi)
    k = CAMERA.intrinsics
    x = (np.arange(24) + 0.5 - k[0, 2]) / k[0, 0] * 10.0
    np.testing.assert_allclose(row, (x + 5.0) / 10.0, atol=1e-4)


def test_variation_multiplies_per_vertex_and_per_row_and_clips():
    points, faces = ms.plane()
    mesh = ms.mesh(points, faces, variation=np.full(len(points), 0.5))
    scene = lit(mesh, [ms.surface((0.4, 0.2, 0.99), variation=0.3)], row_variation=[0.2])
    expected = np.minimum(np.array([0.4, 0.2, 0.99]) * (1 + 0.3 * 0.5) * (1 + 0.3 * 0.2), 1.0)
    got = picture(scene) / (sun_irradiance() / np.pi)
    np.testing.assert_allclose(got, np.broadcast_to(expected, got.shape), rtol=CLOSE)


@pytest.mark.parametrize("weight", [0.0, 0.35, 1.0])
@pytest.mark.parametrize("roughness", [0.6, 0.5])
def test_layers_of_different_gloss_mix_as_pictures_do(weight, roughness):
    points, faces = ms.plane()
    below, above = (
        ms.surface((0.5, 0.3, 0.2), 0.1, 0.5),
        ms.surface((0.1, 0.2, 0.6), 0.3, roughness),
    )
    lights = [ms.sun(60.0), ms.dome(50.0)]
    pure = [picture(lit(ms.mesh(points, faces), [s], lights)) for s in (below, above)]
    mesh = ms.mesh(points, faces, (0, 1), np.full((1, len(points)), weight))
    mixed = picture(lit(mesh, [below, above], lights))
    np.testing.assert_allclose(mixed, (1 - weight) * pure[0] + weight * pure[1], rtol=CLOSE)


def test_a_mesh_without_a_material_is_gray():
    scene = lit(dataclasses.replace(ms.mesh(*ms.plane()), layers=()), [ms.surface()])
    np.testing.assert_allclose(picture(scene), 0.18 * sun_irradiance() / np.pi, rtol=CLOSE)


def ggx(wi: NDArray, wo: NDArray, roughness: float) -> NDArray:
    """Single-scatter GGX, height-correlated (Heitz 2014), about +Z; directions [..., 3]."""
    h = wi + wo
    h = h / np.linalg.norm(h, axis=-1, keepdims=True)
    alpha2 = roughness**4

    def hidden(w: NDArray) -> NDArray:
        tan2 = (1 - w[..., 2] ** 2) / w[..., 2] ** 2
        return 0.5 * (np.sqrt(1 + alpha2 * tan2) - 1)

    density = alpha2 / (np.pi * ((alpha2 - 1) * h[..., 2] ** 2 + 1) ** 2)
    return density / (1 + hidden(wi) + hidden(wo)) / (4 * wi[..., 2] * wo[..., 2])


@pytest.mark.parametrize("metallic", [0.0, 0.7])
def test_gloss_and_metal_under_a_point_sun_are_the_model(metallic):
    color, s, roughness = np.array([0.7, 0.4, 0.1]), 0.4, 0.7
    surface = Surface("", tuple(color), s, roughness, 0.0, metallic)
    camera = ms.look_at((0, -10, 10), (0, 0, 0), 4, 4, 0.5)
    scene = ms.scene(
        [ms.mesh(*ms.plane())], [surface], cameras=[camera], lights=[ms.sun(50, 70, 1000, 0.0)]
    )
    wi = scene.lighting[0].suns[0].to_light
    lobe = ggx(wi, np.array([0.0, -1.0, 1.0]) / np.sqrt(2), roughness)
    gloss, tinted = (brighter(c, roughness, np.sqrt(0.5)) * lobe for c in (1.0, color))
    f = (1 - metallic) * ((1 - s) * color / np.pi + s * gloss) + metallic * color * tinted
    got = picture(scene)
    np.testing.assert_allclose(got, np.broadcast_to(1000 * wi[2] * f, got.shape), rtol=5e-3)


@pytest.mark.parametrize("roughness", [0.3, 0.6, 1.0])
def test_a_metal_in_a_furnace_has_the_albedo_of_its_lobe(roughness):
    theta = (np.arange(400) + 0.5) * (np.pi / 2 / 400)
    phi = (np.arange(400) + 0.5) * (2 * np.pi / 400)
    t, p = np.meshgrid(theta, phi, indexing="ij")
    wi = np.stack([np.sin(t) * np.cos(p), np.sin(t) * np.sin(p), np.cos(t)], axis=-1)
    wo = np.array([np.sqrt(0.5), 0.0, np.sqrt(0.5)])
    weight = np.cos(t) * np.sin(t) * (np.pi / 2 / 400) * (2 * np.pi / 400)
    albedo = (ggx(wi, wo, roughness) * weight).sum()
    camera = ms.look_at((0, -10, 10), (0, 0, 0), 4, 4, 0.5)
    surface = Surface("", (0.8, 0.6, 0.4), 0.0, roughness, 0.0, 1.0)
    scene = ms.scene([ms.mesh(*ms.plane())], [surface], cameras=[camera], lights=[ms.dome(2.0)])
    got = picture(scene).mean(axis=(0, 1))
    color = np.array([0.8, 0.6, 0.4])
    expected = 2.0 * albedo * color * brighter(color, roughness, np.sqrt(0.5))
    np.testing.assert_allclose(got, expected, rtol=0.01)


def test_both_sides_of_a_face_reflect():
    points, faces = ms.plane()
    front = picture(lit(ms.mesh(points, faces), [ms.surface()]))
    back = picture(lit(ms.mesh(points, faces[:, ::-1]), [ms.surface()]))
    np.testing.assert_array_equal(back, front)


@pytest.mark.parametrize("mirror", [1.0, -1.0])
def test_shading_normals_turn_with_their_rows_mirrors_included(mirror):
    points, faces = ms.plane(20.0)
    tilted = np.array([0.28, 0.0, 0.96])
    mesh = ms.mesh(points, faces, normals=np.tile(tilted, (len(points), 1)))
    linear = np.diag([mirror, 1.0, 2.0])
    # All but black: shading normals that lean see the ground, which gives light back.
    scene = lit(mesh, [ms.surface((0.01,) * 3)], rows=[(0, scenes.affine(linear))])
    normal = np.linalg.inv(linear).T @ tilted
    normal /= np.linalg.norm(normal)
    cosine = normal @ scene.lighting[0].suns[0].to_light
    np.testing.assert_allclose(picture(scene), 10 * cosine / np.pi, rtol=CLOSE)


# Maps


def write_map(path: Path, values: NDArray) -> Path:
    Image.fromarray(np.asarray(values, np.uint8)).save(path)
    return path


@pytest.mark.parametrize("origin", [(0.0, 0.0), (1e5 + 0.7, -3e5 - 0.2)])
def test_a_base_color_map_lies_along_x_and_y_of_the_world(tmp_path, origin):
    # Four fields of 16 texels: top left red, top right green, bottom left blue, bottom right white.
    texels = np.zeros((32, 32, 3), np.uint8)
    texels[:16, :16, 0] = texels[:16, 16:, 1] = texels[16:, :16, 2] = 255
    texels[16:, 16:] = 255
    maps = Maps(4.0, base_color=write_map(tmp_path / "map.png", texels))
    surface = dataclasses.replace(ms.surface((0.5, 0.5, 0.5)), maps=maps)
    camera = ms.look_at((*origin, 10.0), (*origin, 0.0), 48, 32, 50)
    scene = ms.scene(
        [ms.mesh(*ms.plane())],
        [surface],
        rows=[(0, scenes.affine(1.0, (*origin, 0.0)))],
        cameras=[camera],
        lights=[ms.sun(90.0)],
    )
    got = picture(scene, 1) / (500.0 / np.pi)
    rays = camera_rays(camera)
    ground = rays.origins + rays.directions * 10.0
    u, v = ((ground[:, i].reshape(32, 48) / 4.0) % 1.0 for i in (0, 1))
    column, row = (u * 32).astype(int), 31 - (v * 32).astype(int)
    expected = texels[row, column] / 255.0
    # Away from the edges of the fields, where texels blend.
    inside = (np.abs(u % 0.5 - 0.25) < 0.2) & (np.abs(v % 0.5 - 0.25) < 0.2)
    assert inside.sum() > 300
    np.testing.assert_allclose(got[inside], expected[inside], atol=0.01)


@pytest.mark.parametrize("offset", [(0.0, 0.0), (1003.7, -508.2)])
def test_a_base_color_map_is_bilinear_between_its_texels(tmp_path, offset):
    scene = map_scenes.albedo_scene(tmp_path, offset)
    got = picture(scene, 1) * np.pi / map_scenes.IRRADIANCE
    expected = map_scenes.expected_albedo(scene.cameras[0][0])
    # Half precision.
    np.testing.assert_allclose(got, expected, atol=1e-3)


@pytest.mark.parametrize("flip_green", [False, True])
def test_a_normal_map_leans_the_shading_normal(tmp_path, flip_green):
    tilt = (0.3, -0.4)
    scene = map_scenes.normal_scene(tmp_path, tilt, flip_green)
    got = picture(scene) * np.pi / map_scenes.IRRADIANCE
    np.testing.assert_allclose(got, map_scenes.expected_cosine(tilt, flip_green), rtol=CLOSE)


@pytest.mark.parametrize("mapped", [False, True])
def test_a_metal_is_a_tinted_ggx_lobe(tmp_path, mapped):
    scene = map_scenes.metal_scene(tmp_path if mapped else None)
    expected = map_scenes.expected_metal(scene.cameras[0][0])
    np.testing.assert_allclose(picture(scene), expected, rtol=5e-3)


def test_maps_of_different_sizes_are_brought_to_one(tmp_path):
    rough = write_map(tmp_path / "rough.png", np.full((4, 6), 0.6 * 255))
    metal = write_map(tmp_path / "metal.png", np.full((9, 3), 0.8 * 255))
    plain = Surface("", (0.5, 0.4, 0.3), 0.2, 0.6, 0.0, 0.8)
    mapped = Surface("", (0.5, 0.4, 0.3), 0.2, 0.1, 0.0, 0.1,
                     Maps(3.0, roughness=rough, metallic=metal))  # fmt: skip
    lights = [ms.sun(60.0), ms.dome(30.0)]
    got, expected = (picture(lit(ms.mesh(*ms.plane()), [s], lights)) for s in (mapped, plain))
    np.testing.assert_allclose(got, expected, rtol=5e-3)
    rng = np.random.default_rng(10)
    fine = rng.uniform(0, 1, (12, 20, 3)).astype(np.float32)
    # Means of texels when smaller; the mean of all stays either way.
    small = fine.reshape(6, 2, 5, 4, 3).mean(axis=(1, 3))
    np.testing.assert_allclose(resample(fine, 6, 5), small, atol=1e-6)
    np.testing.assert_allclose(
        resample(fine, 36, 60).mean(axis=(0, 1)), fine.mean(axis=(0, 1)), atol=1e-6
    )
