"""Materials in Mitsuba are the shared surface model, however they are put together."""

from __future__ import annotations

import mitsuba_scenes as ms
import numpy as np
import pytest
from numpy.typing import NDArray
from surface_oracle import brighter

from scenec.backends.mitsuba import Mitsuba
from scenec.backends.mitsuba.geometry import flatten, make_groups
from scenec.backends.stage.scene import Mesh, RenderScene, Surface

CAMERA = ms.look_at((0, 0, 10), (0, 0, 0), 24, 16)
SUN = ms.sun(60.0, diameter_deg=2.0)


def picture(scene: RenderScene, spp: int = 64) -> NDArray:
    backend = Mitsuba()
    backend.load(scene)
    return backend.radiance(scene.cameras[0][0], 0, spp, 2).halves.astype(float).mean(axis=0)


def lit(mesh: Mesh, surfaces: list[Surface], **kwargs) -> RenderScene:
    return ms.scene([mesh], surfaces, cameras=[CAMERA], lights=[SUN], **kwargs)


def irradiance() -> float:
    return 1000.0 * np.sin(np.radians(60.0))


def test_layers_merge_in_order_as_the_equation_says():
    points, faces = ms.plane()
    rng = np.random.default_rng(0)
    colors = rng.uniform(0, 1, (3, 3))
    weights = np.array([0.3, 0.6])
    mesh = ms.mesh(points, faces, (0, 1, 2), np.repeat(weights[:, None], len(points), 1))
    scene = lit(mesh, [ms.surface(c) for c in colors])
    expected = colors[0]
    for w, color in zip(weights, colors[1:], strict=True):
        expected = w * color + (1 - w) * expected
    got = picture(scene).mean(axis=(0, 1)) / (irradiance() / np.pi)
    np.testing.assert_allclose(got, expected, rtol=2e-3)


def test_colors_blend_linearly_between_vertices():
    points, faces = ms.plane(5.0)
    weights = ((points[:, 0] + 5.0) / 10.0)[None, :]
    mesh = ms.mesh(points, faces, (0, 1), weights)
    scene = lit(mesh, [ms.surface((0, 0, 0)), ms.surface((1, 1, 1))])
    row = picture(scene)[8, :, 0] / (irradiance() / np.pi)
    k = CAMERA.intrinsics
    x = (np.arange(24) + 0.5 - k[0, 2]) / k[0, 0] * 10.0
    np.testing.assert_allclose(row, (x + 5.0) / 10.0, atol=5e-3)


def test_variation_multiplies_per_vertex_and_per_row():
    points, faces = ms.plane()
    mesh = ms.mesh(points, faces, variation=np.full(len(points), 0.5))
    scene = lit(mesh, [ms.surface((0.4, 0.2, 0.1), variation=0.3)], row_variation=[-0.8])
    expected = np.array([0.4, 0.2, 0.1]) * (1 + 0.3 * 0.5) * (1 - 0.3 * 0.8)
    got = picture(scene).mean(axis=(0, 1)) / (irradiance() / np.pi)
    np.testing.assert_allclose(got, expected, rtol=2e-3)


@pytest.mark.parametrize("weight", [0.0, 0.35, 1.0])
def test_layers_of_different_gloss_mix_as_pictures_do(weight):
    # Under a sun alone, one bounce: radiance is linear in the BSDF, so pictures mix as BSDFs do.
    points, faces = ms.plane()
    dull, gloss = ms.surface((0.5, 0.3, 0.2)), ms.surface((0.1, 0.2, 0.6), 0.3, 0.6)
    pure = [picture(lit(ms.mesh(points, faces), [s])).mean(axis=(0, 1)) for s in (dull, gloss)]
    mesh = ms.mesh(points, faces, (0, 1), np.full((1, len(points)), weight))
    mixed = picture(lit(mesh, [dull, gloss]), 256).mean(axis=(0, 1))
    np.testing.assert_allclose(mixed, (1 - weight) * pure[0] + weight * pure[1], rtol=1e-2)


def test_a_glossy_plane_shows_the_ggx_lobe():
    # Radiance of a point-like sun: E cos_i f, with f of single-scatter GGX and the correlated
    # masking and shadowing of Heitz 2014.
    s, roughness = 0.4, 0.7
    points, faces = ms.plane()
    camera = ms.look_at((0, -10, 10), (0, 0, 0), 4, 4, 0.5)
    surface = ms.surface((0.0, 0.0, 0.0), s, roughness)
    scene = ms.scene(
        [ms.mesh(points, faces)],
        [surface],
        cameras=[camera],
        lights=[ms.sun(50.0, 70.0, diameter_deg=0.0)],
    )
    wi = scene.lighting[0].suns[0].to_light
    wo = np.array([0.0, -1.0, 1.0]) / np.sqrt(2)
    h = (wi + wo) / np.linalg.norm(wi + wo)
    alpha2 = roughness**4

    def hidden(w: NDArray) -> float:
        tan2 = (1 - w[2] ** 2) / w[2] ** 2
        return (np.sqrt(1 + alpha2 * tan2) - 1) / 2

    density = alpha2 / (np.pi * ((alpha2 - 1) * h[2] ** 2 + 1) ** 2)
    f = density / (1 + hidden(wi) + hidden(wo)) / (4 * wi[2] * wo[2])
    f *= brighter(1.0, roughness, wo[2])
    assert picture(scene).mean() == pytest.approx(1000.0 * wi[2] * s * f, rel=5e-3)


def test_both_sides_of_a_face_reflect():
    points, faces = ms.plane()
    front = picture(lit(ms.mesh(points, faces), [ms.surface()]))
    back = picture(lit(ms.mesh(points, faces[:, ::-1]), [ms.surface()]))
    np.testing.assert_allclose(back.mean(), front.mean(), rtol=1e-3)


def test_shading_normals_turn_with_their_rows_mirrors_included():
    points, faces = ms.plane(2.0)
    tilted = np.tile([0.6, 0.0, 0.8], (len(points), 1))
    mesh = ms.mesh(points, faces, normals=tilted)
    linear = np.array([[-1.0, 0, 0], [0, 1, 0], [0, 0, 2.0]])
    matrix = np.column_stack([linear, np.zeros(3)])
    scene = lit(mesh, [ms.surface()], rows=[(0, matrix)])
    group = make_groups(scene)[0]
    flat = flatten(scene, group, np.zeros(3))
    expected = np.linalg.inv(linear).T @ [0.6, 0.0, 0.8]
    expected /= np.linalg.norm(expected)
    assert flat.normals is not None
    np.testing.assert_allclose(flat.normals, np.tile(expected, (len(points), 1)), atol=1e-6)
    corners = flat.points[flat.faces].astype(float)
    winding = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    assert np.all(winding[:, 2] > 0)


def test_three_layers_of_three_roughnesses_are_their_pictures_mixed():
    points, faces = ms.plane()
    surfaces = [ms.surface((0.5, 0.3, 0.2), 0.2, 0.9), ms.surface((0.1, 0.2, 0.6), 0.5, 0.6),
                ms.surface((0.7, 0.7, 0.1), 0.1, 0.75)]  # fmt: skip
    pure = [picture(lit(ms.mesh(points, faces), [s]), 256).mean(axis=(0, 1)) for s in surfaces]
    weights = np.repeat(np.array([[0.4], [0.3]]), len(points), axis=1)
    mesh = ms.mesh(points, faces, (0, 1, 2), weights)
    mixed = picture(lit(mesh, surfaces), 1024).mean(axis=(0, 1))
    expected = 0.7 * (0.6 * pure[0] + 0.4 * pure[1]) + 0.3 * pure[2]
    np.testing.assert_allclose(mixed, expected, rtol=1e-2)
