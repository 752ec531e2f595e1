"""Surfaces and their maps through Cycles are what the equations say, and what Mitsuba draws."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import mitsuba_scenes as ms
import numpy as np
import pytest
import scenes
from cycles_pictures import ABOVE, SUN, draw, lit, picture, reflected
from numpy.typing import NDArray
from PIL import Image
from surface_oracle import brighter

from scenec.backends.stage.scene import Maps, RenderScene, Surface


def ggx(wi: NDArray, wo: NDArray, roughness: float) -> float:
    """D * G / (4 cos cos): Walter et al. 2007, masking and shadowing correlated by height."""
    h = (wi + wo) / np.linalg.norm(wi + wo)
    alpha2 = roughness**4

    def hidden(w: NDArray) -> float:
        return 0.5 * (np.sqrt(1 + alpha2 * (1 - w[2] ** 2) / w[2] ** 2) - 1)

    density = alpha2 / (np.pi * ((alpha2 - 1) * h[2] ** 2 + 1) ** 2)
    return density / (1 + hidden(wi) + hidden(wo)) / (4 * wi[2] * wo[2])


@pytest.mark.parametrize(("elevation_deg", "height"), [(50.0, 10.0), (20.0, 3.0)])
@pytest.mark.parametrize("metallic", [0.0, 0.6])
def test_a_glossy_plane_shows_the_ggx_lobe(elevation_deg, height, metallic):
    roughness, s, color = 0.7, 0.4, np.array([0.9, 0.5, 0.1])
    view = ms.look_at((0, -10, height), (0, 0, 0), 4, 4, 0.5)
    surface = Surface("", (0.9, 0.5, 0.1), s, roughness, 0.0, metallic)
    sun = ms.sun(elevation_deg, 70.0, diameter_deg=0.0)
    scene = ms.scene([ms.mesh(*ms.plane())], [surface], cameras=[view], lights=[sun])
    wo = np.array([0.0, -10.0, height]) / np.hypot(10.0, height)
    f = ggx(sun.to_light, wo, roughness)
    gloss, tinted = (brighter(c, roughness, wo[2]) * f for c in (1.0, color))
    expected = (1 - metallic) * ((1 - s) * color / np.pi + s * gloss) + metallic * color * tinted
    got = picture(scene).mean(axis=(0, 1))
    np.testing.assert_allclose(got, 1000.0 * sun.to_light[2] * expected, rtol=2e-3)


def test_a_mirror_is_drawn_with_the_least_roughness_there_is():
    view = ms.look_at((0, -10, 10), (0, 0, 0), 4, 4, 0.5)
    surface = Surface("", (0.5, 0.5, 0.5), 1.0, 0.0, 0.0)
    scene = ms.scene([ms.mesh(*ms.plane())], [surface], cameras=[view], lights=[ms.dome(2.0)])
    np.testing.assert_allclose(picture(scene), 2.0, rtol=1e-3)


def test_layers_merge_in_order_as_the_equation_says():
    points, faces = ms.plane()
    rng = np.random.default_rng(0)
    colors = rng.uniform(0, 1, (3, 3))
    weights = np.array([0.3, 0.6])
    mesh = ms.mesh(points, faces, (0, 1, 2), np.repeat(weights[:, None], len(points), 1))
    expected = colors[0]
    for w, color in zip(weights, colors[1:], strict=True):
        expected = w * color + (1 - w) * expected
    got = reflected(lit(mesh, [ms.surface(c) for c in colors]))
    np.testing.assert_allclose(got, expected, rtol=1e-3)


def test_colors_blend_linearly_between_vertices():
    points, faces = ms.plane(5.0)
    weights = ((points[:, 0] + 5.0) / 10.0)[None, :]
    mesh = ms.mesh(points, faces, (0, 1), weights)
    scene = lit(mesh, [ms.surface((0, 0, 0)), ms.surface((1, 1, 1))])
    row = picture(scene)[8, :, 0] / (1000.0 * np.sin(np.radians(60.0)) / np.pi)
    k = ABOVE.intrinsics
    x = (np.arange(24) + 0.5 - k[0, 2]) / k[0, 0] * 10.0
    np.testing.assert_allclose(row, (x + 5.0) / 10.0, atol=5e-3)


def test_layers_of_different_gloss_mix_as_pictures_do():
    # Under a sun alone, one bounce: radiance is linear in the BSDF, so pictures mix as BSDFs do.
    points, faces = ms.plane()
    surfaces = [
        Surface("", (0.5, 0.3, 0.2), 0.2, 0.9, 0.0),
        Surface("", (0.1, 0.2, 0.6), 0.5, 0.6, 0.0, 0.3),
        Surface("", (0.7, 0.7, 0.1), 0.1, 0.6, 0.0),
    ]
    pure = [reflected(lit(ms.mesh(points, faces), [s]), 256) for s in surfaces]
    weights = np.repeat(np.array([[0.4], [0.3]]), len(points), axis=1)
    mixed = reflected(lit(ms.mesh(points, faces, (0, 1, 2), weights), surfaces), 512)
    expected = 0.7 * (0.6 * pure[0] + 0.4 * pure[1]) + 0.3 * pure[2]
    np.testing.assert_allclose(mixed, expected, rtol=5e-3)


def test_variation_multiplies_per_vertex_and_per_row_and_is_clipped():
    points, faces = ms.plane(1.0)
    mesh = ms.mesh(points, faces, variation=np.full(len(points), 0.5))
    surface = ms.surface((0.4, 0.2, 0.9), variation=0.3)
    of_rows = [-0.8, 0.0, 1.0]
    rows = [(0, scenes.affine(1.0, (4.0 * i, 0, 0))) for i in range(3)]
    for i, own in enumerate(of_rows):
        view = ms.look_at((4.0 * i, 0, 2), (4.0 * i, 0, 0), 8, 8, 20)
        scene = lit(mesh, [surface], rows=rows, row_variation=of_rows, cameras=[view])
        factor = (1 + 0.3 * 0.5) * (1 + 0.3 * own)
        expected = np.minimum(np.array([0.4, 0.2, 0.9]) * factor, 1.0)
        np.testing.assert_allclose(reflected(scene), expected, rtol=1e-3)


def test_both_sides_of_a_face_reflect():
    points, faces = ms.plane()
    for winding in (faces, faces[:, ::-1]):
        np.testing.assert_allclose(
            reflected(lit(ms.mesh(points, winding), [ms.surface()])), 0.5, rtol=1e-3
        )


@pytest.mark.parametrize("instances", [1, 3])
@pytest.mark.parametrize("wound_down", [False, True])
def test_shading_normals_turn_with_their_rows_mirrors_included(instances, wound_down):
    # A Lambertian plane with tilted normals n reflects E max(n . l, 0) / pi wherever it faces.
    points, faces = ms.plane(2.0)
    mesh = ms.mesh(
        points, faces[:, ::-1] if wound_down else faces, normals=np.tile([-0.6, 0, 0.8], (4, 1))
    )
    linear = np.array([[-1.0, 0.3, 0], [0, 1, 0], [0, 0, 1.5]])
    rows = [(0, scenes.affine(linear, (0, 0, -5.0 * i))) for i in range(instances)]
    normal = np.linalg.inv(linear).T @ [-0.6, 0.0, 0.8]
    normal /= np.linalg.norm(normal)
    view = ms.look_at((0, 0, 3), (0, 0, 0), 8, 8, 30)
    got = picture(lit(mesh, [ms.surface()], rows=rows, cameras=[view]))
    expected = 0.5 * 1000.0 / np.pi * float(normal @ SUN.to_light)
    np.testing.assert_allclose(got, expected, rtol=1e-3)


# Maps


def write_png(path: Path, values: NDArray) -> Path:
    Image.fromarray(np.rint(np.asarray(values) * 255).astype(np.uint8)).save(path)
    return path


@pytest.mark.parametrize("center", [(0.0, 0.0), (12345.0, -6789.0)])
def test_maps_lie_on_the_world_u_along_x_and_v_along_y(tmp_path, center):
    # Four texels of a meter each, the lower left one's corner at the origin; each seen at its
    # center, where nothing blends.
    texels = np.array([[0, 255], [102, 204]]) / 255.0
    file = write_png(tmp_path / "color.png", np.repeat(texels[:, :, None], 3, 2))
    decoded = np.where(texels <= 0.04045, texels / 12.92, ((texels + 0.055) / 1.055) ** 2.4)
    surface = Surface("", (0.5, 0.5, 0.5), 0.0, 0.5, 0.0, 0.0, Maps(2.0, base_color=file))
    rows = [(0, scenes.affine(1.0, (*center, 0.0)))]
    corner = np.array([*center, 0.0]) - np.array([*center, 0.0]) % 2.0
    for row in range(2):
        for column in range(2):
            at = corner + np.array([column + 0.5, 1.5 - row, 0.0])
            view = ms.look_at(at + np.array([0, 0, 5]), at, 4, 4, 0.02)
            scene = lit(ms.mesh(*ms.plane()), [surface], cameras=[view], rows=rows)
            np.testing.assert_allclose(
                reflected(scene, 16), 0.5 * decoded[row, column], rtol=5e-3, atol=1e-3
            )


def test_maps_of_roughness_and_metal_take_the_place_of_the_numbers(tmp_path):
    rough = write_png(tmp_path / "rough.png", np.full((2, 2), 0.6))
    metal = write_png(tmp_path / "metal.png", np.full((2, 2), 0.2))
    mapped = Surface("", (0.9, 0.5, 0.1), 0.4, 0.1, 0.0, 0.9,
                     Maps(3.0, roughness=rough, metallic=metal))  # fmt: skip
    plain = Surface("", (0.9, 0.5, 0.1), 0.4, 0.6, 0.0, 0.2)
    view = ms.look_at((0, -10, 4), (0, 0, 0), 8, 8, 20)
    got, expected = (
        picture(lit(ms.mesh(*ms.plane()), [s], cameras=[view])).mean(axis=(0, 1))
        for s in (mapped, plain)
    )
    np.testing.assert_allclose(got, expected, rtol=1e-3)


@pytest.mark.parametrize("flip_green", [False, True])
@pytest.mark.parametrize("smooth", [False, True])
@pytest.mark.parametrize("mirrored", [False, True])
def test_a_mapped_normal_leans_along_u_and_v(tmp_path, flip_green, smooth, mirrored):
    # A plane that climbs along both axes: u runs in it with x across y, v is normal x u.
    code = np.array([0.75, 0.6, 0.9])
    file = write_png(tmp_path / "normal.png", np.tile(code, (2, 2, 1)))
    local = 2 * np.rint(code * 255) / 255 - 1
    local /= np.linalg.norm(local)
    if flip_green:
        local[1] *= -1
    points, faces = ms.plane(5.0)
    points = points + points[:, :2] @ np.array([0.3, -0.2])[:, None] * [0, 0, 1]
    slope = np.array([-0.3, 0.2, 1.0]) / np.linalg.norm([-0.3, 0.2, 1.0])
    normals = np.tile(slope, (4, 1)) if smooth else None
    linear = np.diag([-1.0, 1, 1]) if mirrored else np.eye(3)
    n = slope * [-1, 1, 1] if mirrored else slope
    u = np.array([n[2], 0, -n[0]]) / np.hypot(n[0], n[2])
    expected = local[0] * u + local[1] * np.cross(n, u) + local[2] * n
    surface = Surface("", (0.5, 0.5, 0.5), 0.0, 0.5, 0.0, 0.0,
                      Maps(1.0, normal=file, flip_green=flip_green))  # fmt: skip
    scene = lit(ms.mesh(points, faces, normals=normals), [surface],
                rows=[(0, scenes.affine(linear))],
                cameras=[ms.look_at((0, 0, 8), (0, 0, 0), 8, 8, 20)])  # fmt: skip
    got = picture(scene) / (0.5 * 1000.0 / np.pi)
    np.testing.assert_allclose(got, float(expected @ SUN.to_light), rtol=2e-3)


# The other path tracer

MITSUBA = """
import sys
sys.path.insert(0, sys.argv[1])
import numpy as np
from test_cycles_surfaces import agreement_scenes
from scenec.backends.mitsuba import Mitsuba
halves = {}
for name, scene in agreement_scenes().items():
    backend = Mitsuba()
    backend.load(scene)
    halves[name] = backend.radiance(scene.cameras[0][0], 0, 1024, 1).halves
np.savez(sys.argv[2], **halves)
"""


def agreement_scenes() -> dict[str, RenderScene]:
    """Small scenes of the surface model: plain, glossy, metal and mirrored bodies on a ground."""
    ball, faces = scenes.icosphere(2)
    view = ms.look_at((0, -6, 2.5), (0, 0, 0.5), 24, 18, 50)
    ground = ms.mesh(*ms.plane(8.0))
    light = [ms.sun(40, 20, 500, 3.0), ms.dome(40.0)]

    def body(surface: Surface, rows: list, smooth: bool = True, **kwargs) -> RenderScene:
        mesh = ms.mesh(ball, faces, (1,), normals=ball if smooth else None,
                       variation=0.6 * ball[:, 2])  # fmt: skip
        return ms.scene(
            [ground, mesh],
            [Surface("", (0.5, 0.4, 0.3), 0.02, 0.9, 0.0), surface],
            rows=[(0, scenes.affine()), *rows],
            cameras=[view],
            lights=light,
            **kwargs,
        )

    one = [(1, scenes.affine(1.0, (0, 0, 0.8)))]
    mirror = np.array([[-0.6, 0.2, 0], [0, 0.6, 0.1], [0, 0, 0.5]])
    two = [(1, scenes.affine(mirror, (x, 0, 0.6))) for x in (-1.1, 1.1)]
    return {
        "flat": body(Surface("", (0.2, 0.3, 0.4), 0.0, 0.5, 0.3), one, smooth=False),
        "glossy": body(Surface("", (0.2, 0.3, 0.4), 0.2, 0.5, 0.0), one),
        "metal": body(Surface("", (0.9, 0.6, 0.3), 0.1, 0.6, 0.0, 0.7), one),
        "mirrored": body(Surface("", (0.6, 0.6, 0.2), 0.05, 0.6, 0.4), two,
                         row_variation=[0.0, -1.0, 0.6]),
    }  # fmt: skip


@pytest.mark.invariant
@pytest.mark.slow
def test_mean_radiance_is_mitsubas_within_half_a_percent(tmp_path: Path):
    out = tmp_path / "mitsuba.npz"
    done = subprocess.run(
        [sys.executable, "-c", MITSUBA, str(Path(__file__).parent), str(out)],
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    theirs = np.load(out)
    for name, scene in agreement_scenes().items():
        ours = draw(scene, 1024)
        a = ours.halves.astype(float).mean(axis=(0, 1, 2))
        b = theirs[name].astype(float).mean(axis=(0, 1, 2))
        np.testing.assert_allclose(a, b, rtol=5e-3, err_msg=name)
