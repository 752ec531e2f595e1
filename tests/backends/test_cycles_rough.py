"""Roughness that varies, in Cycles, and beside Mitsuba."""

from __future__ import annotations

import dataclasses
import subprocess
import sys
from pathlib import Path

import mitsuba_scenes as ms
import numpy as np
import pytest
import rough_scenes
import scenes
from numpy.typing import NDArray

from scenec.backends.cycles import Cycles
from scenec.backends.stage.scene import RenderScene, Surface


def halves(scene: RenderScene, spp: int) -> NDArray:
    backend = Cycles()
    backend.load(scene)
    return backend.radiance(scene.cameras[0][0], 0, spp, 2).halves.astype(float)


def picture(scene: RenderScene, spp: int) -> NDArray:
    return halves(scene, spp).mean(axis=0)


def test_strips_of_a_variation_are_strips_of_these_roughnesses():
    expected = picture(rough_scenes.constant_strips(), 128)
    got = picture(rough_scenes.strips(), 128)
    # The same random numbers meet the same lobes.
    np.testing.assert_allclose(got, expected, rtol=1e-3)
    still = dataclasses.replace(rough_scenes.SURFACE, roughness_variation=0.0)
    assert np.abs(picture(rough_scenes.strips(still), 128) / expected - 1).max() > 0.3


def test_a_map_of_roughness_varies_as_a_number_does(tmp_path):
    mapped, plain = rough_scenes.mapped(tmp_path)
    got = picture(rough_scenes.strips(mapped), 128)
    np.testing.assert_allclose(got, picture(rough_scenes.strips(plain), 128), rtol=1e-3)


def test_roughness_is_interpolated_and_then_squared():
    scene = rough_scenes.ramp()
    expected = rough_scenes.expected_ramp(scene)
    np.testing.assert_allclose(picture(scene, 256)[..., 0], expected, rtol=0.02)


def test_layers_that_vary_mix_as_pictures_do():
    mixed, alone, shares = rough_scenes.layered()
    expected = sum(w * picture(s, 512) for w, s in zip(shares, alone, strict=True))
    got = picture(mixed, 1024).mean((0, 1))
    np.testing.assert_allclose(got, expected.mean((0, 1)), rtol=5e-3)


MITSUBA = """
import sys
sys.path.insert(0, sys.argv[1])
import numpy as np
from test_cycles_rough import two_balls
from scenec.backends.mitsuba import Mitsuba
scene = two_balls()
backend = Mitsuba()
backend.load(scene)
np.save(sys.argv[2], backend.radiance(scene.cameras[0][0], 0, 1024, 1).halves)
"""


def two_balls() -> RenderScene:
    """Balls of one mesh and surface, a smooth and a rough one, on ground that varies and mixes."""
    ball, ball_faces = scenes.icosphere(2)
    points, faces = ms.plane(8.0, 8)
    rng = np.random.default_rng(5)
    ground = ms.mesh(points, faces, (0, 1), rng.uniform(0, 1, (1, len(points))),
                     rng.uniform(-1, 1, len(points)))  # fmt: skip
    rock = ms.mesh(ball, ball_faces, (2,), variation=0.5 * ball[:, 2], normals=ball)
    return ms.scene(
        [ground, rock],
        [
            Surface("", (0.5, 0.4, 0.3), 0.1, 0.5, 0.2, 0.0, None, 0.8),
            Surface("", (0.2, 0.2, 0.3), 0.3, 0.6, 0.0, 0.0, None, -0.7),
            Surface("", (0.6, 0.5, 0.2), 0.2, 0.5, 0.3, 0.2, None, 0.6),
        ],
        rows=[(0, scenes.affine()), *((1, scenes.affine(1.0, (x, 0, 0.8))) for x in (-1.2, 1.2))],
        row_variation=[0.0, -1.0, 0.8],
        cameras=[ms.look_at((0, -6, 2.5), (0, 0, 0.5), 24, 18, 50)],
        lights=[ms.sun(40, 60, 500, 3.0), ms.dome(40.0)],
    )


@pytest.mark.slow
def test_a_scene_has_the_radiance_that_mitsuba_finds(tmp_path: Path):
    out = tmp_path / "mitsuba.npy"
    done = subprocess.run(
        [sys.executable, "-c", MITSUBA, str(Path(__file__).parent), str(out)],
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    both = np.array([halves(two_balls(), 1024), np.load(out).astype(float)])
    ours, theirs = both.mean(axis=(1, 2, 3))
    np.testing.assert_allclose(ours, theirs, rtol=5e-3)
    # And where it is: in blocks of 3 x 8 pixels, within 5 standard errors and 1 %.
    blocks = both.reshape(2, 2, 6, 3, 3, 8, 3)
    ours, theirs = blocks.mean(axis=(1, 3, 5))
    error = np.sqrt((((blocks[:, 0] - blocks[:, 1]) / 2) ** 2).sum(axis=(0, 2, 4))) / 24
    assert (np.abs(ours - theirs) <= 5 * error + 0.01 * theirs).all()
