"""What a picture of opacity cuts out: the caster against the definition by hand."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from scenec.backends.camera.rays import camera_rays
from scenec.backends.check.witness import Witness
from scenec.backends.contract import NO_ROW, Visibility
from scenec.backends.exact import ExactCaster
from scenec.backends.stage.scene import Maps, RenderScene
from scenec.backends.surface.cutouts import LEAST
from scenec.backends.testing import lights
from scenec.backends.testing.scenes import affine, look_at, mesh, plane, scene, surface
from scenec.schemas.errors import StageError

#: Meters of the square, its distance, and the threshold.
HALF, AWAY, THRESHOLD = 2.0, 5.0, 0.4
WRAPS = ("repeat", "clamp", "mirror")


def wrapped(x: np.ndarray, wrap: str, count: int) -> np.ndarray:
    """Texels as OpenGL's wrap modes name them (OpenGL 4.6, table 8.20)."""
    if wrap == "repeat":
        return x % count
    if wrap == "clamp":
        return np.clip(x, 0, count - 1)
    x = x % (2 * count)
    return np.where(x < count, x, 2 * count - 1 - x)


def by_hand(texels: np.ndarray, u: np.ndarray, v: np.ndarray, wraps: tuple[str, str]) -> np.ndarray:
    """Opacity at texture coordinates: four texels each, by their wrap modes."""
    height, width = texels.shape
    x, y = u * width - 0.5, (1.0 - v) * height - 0.5
    i, j = np.floor(x).astype(int), np.floor(y).astype(int)
    a, b = x - i, y - j
    total = np.zeros_like(u)
    for dj, share_y in ((0, 1.0 - b), (1, b)):
        for di, share_x in ((0, 1.0 - a), (1, a)):
            row, column = wrapped(j + dj, wraps[1], height), wrapped(i + di, wraps[0], width)
            total += share_x * share_y * texels[row, column]
    return total / 255.0


def square(folder: Path, wraps: tuple[str, str], texels: np.ndarray, solid: bool) -> RenderScene:
    """A square over ground; u = 0.6 x + 0.3, v = -0.45 y + 0.2 on it."""
    file = folder / "opacity.png"
    Image.fromarray(texels.astype(np.uint8)).save(file)
    maps = Maps(1.0, projection="uv", opacity=file, opacity_threshold=THRESHOLD, opacity_wrap=wraps)
    points, faces = plane(HALF, 3)
    uv = (points[faces][..., :2] * [0.6, -0.45] + [0.3, 0.2]).astype(np.float32)
    card = dataclasses.replace(mesh(points, faces, (1,)), uv=uv)
    cut = dataclasses.replace(surface(), maps=None if solid else maps)
    return scene(
        [mesh(*plane(50.0)), card],
        [surface(), cut],
        rows=[(0, affine()), (1, affine(1.0, (0.0, 0.0, AWAY)))],
        cameras=[look_at((0.3, -0.2, 2.0 * AWAY), (0.3, -0.2, 0.0), 150, 110, 45.0)],
    )


@pytest.mark.parametrize("across", WRAPS)
@pytest.mark.parametrize("up", WRAPS)
def test_a_ray_goes_on_where_opacity_is_below_the_threshold(tmp_path, across, up):
    texels = np.random.default_rng(2).integers(0, 256, (7, 4))
    made = square(tmp_path, (across, up), texels, solid=False)
    rays, caster = camera_rays(made.cameras[0][0]), ExactCaster(made)
    row, face, t = caster.cast(rays)
    solid_row, solid_face, solid_t = ExactCaster(
        square(tmp_path, (across, up), texels, solid=True)
    ).cast(rays)
    on = solid_row == 1
    place = rays.origins[on] + solid_t[on, None] * rays.directions[on]
    u, v = 0.6 * place[:, 0] + 0.3, -0.45 * place[:, 1] + 0.2
    opacity = by_hand(texels, u, v, (across, up))
    # Texture coordinates are float32.
    sure = np.abs(opacity - THRESHOLD) > 1e-5
    assert 0.2 < (opacity < THRESHOLD).mean() < 0.8
    assert sure.mean() > 0.999
    np.testing.assert_array_equal(row[on][sure] == 1, opacity[sure] >= THRESHOLD)
    np.testing.assert_array_equal(row[~on], solid_row[~on])
    behind = on & (row == 0)
    np.testing.assert_allclose(t[behind], 2.0 * AWAY, rtol=1e-12)
    kept = row == solid_row
    np.testing.assert_array_equal(t[kept], solid_t[kept])
    np.testing.assert_array_equal(face[kept], solid_face[kept])
    # Ray by ray as by packets, and as one asks for a triangle.
    every = np.arange(len(row))
    for one, other in zip(caster.cast(rays, every), (row, face, t), strict=True):
        np.testing.assert_array_equal(one, other)
    asked = caster.test(rays, every, solid_row, solid_face)
    np.testing.assert_array_equal(asked, np.where(kept, solid_t, np.inf))


def test_a_texel_at_the_threshold_is_there_and_one_below_is_not(tmp_path):
    level = round(255 * THRESHOLD)
    for value, seen in ((level, 1), (level - 1, 0)):
        made = square(tmp_path, ("repeat", "repeat"), np.full((3, 3), value), solid=False)
        rays = camera_rays(made.cameras[0][0])
        assert ExactCaster(made).cast(rays)[0][len(rays.origins) // 2] == seen
    assert LEAST < 1.0 / 255.0


def test_a_renderer_that_knows_no_masks_is_found_out(tmp_path):
    made = lights.cutout_scene(tmp_path)
    rays, caster = camera_rays(made.cameras[0][0]), ExactCaster(made)
    surfaces = tuple(dataclasses.replace(each, maps=None) for each in made.surfaces)
    solid = ExactCaster(dataclasses.replace(made, surfaces=surfaces))
    right, wrong = (Visibility(*one.cast(rays)[:2]) for one in (caster, solid))
    witness = Witness()
    witness.add(caster, rays, right)
    assert witness.differing == witness.beyond == 0
    witness.add(caster, rays, wrong)
    assert witness.differing > 100
    assert witness.beyond > 0.9 * witness.differing
    missed = Visibility(np.where(right.row > 0, NO_ROW, right.row), right.face)
    before = witness.beyond
    witness.add(caster, rays, missed)
    assert witness.beyond > before


def test_a_missing_picture_is_named(tmp_path):
    made = square(tmp_path, ("repeat", "repeat"), np.zeros((2, 2)), solid=False)
    (tmp_path / "opacity.png").unlink()
    with pytest.raises(StageError, match=r"opacity\.png: the map is missing"):
        ExactCaster(made)
