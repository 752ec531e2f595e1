"""Rims of smooth things: a face is seen though its shading normal leans away from the viewer."""

from __future__ import annotations

import pytest
from numpy.typing import NDArray

from scenec.backends.contract import Backend
from scenec.backends.registry import open_backend
from scenec.backends.stage.scene import RenderScene
from scenec.backends.testing import scenes as ms
from scenec.testing import scenes
from scenec.testing.extras import needs

ALBEDO = 0.5


def coarse_ball(flipped: bool) -> RenderScene:
    """A ball of 20 faces with the normals of a sphere, in even light; at its rim normals lean."""
    points, faces = scenes.icosphere(0)
    normals = points.copy()
    if flipped:
        # Wound inside out, as files have it that nobody looked at: normals stay outward.
        faces = faces[:, ::-1]
    mesh = ms.mesh(points, faces, normals=normals)
    view = ms.look_at((4.0, 1.0, 0.7), (0.0, 0.0, 0.0), 48, 48, 32.0)
    return ms.scene([mesh], [ms.surface((ALBEDO,) * 3)], cameras=[view], lights=[ms.dome()])


@pytest.fixture(
    scope="module",
    params=[pytest.param("cycles", marks=needs("cycles", "bpy")), "mitsuba", "pyrender"],
)
def backend(request: pytest.FixtureRequest) -> Backend:
    return open_backend(request.param)


def inside(backend: Backend, scene: RenderScene) -> NDArray:
    backend.load(scene)
    found = backend.radiance(scene.cameras[0][0], 0, 256, 1)
    return found.halves.mean(axis=0)[found.coverage == 1.0]


@pytest.mark.parametrize("flipped", [False, True])
def test_a_coarse_ball_has_no_dark_rim(backend, flipped):
    radiance = inside(backend, coarse_ball(flipped))
    assert len(radiance) > 500
    # Convex, so all light comes from the sky: albedo times the part of it above both the shading
    # normal's horizon and the face's. They differ by 37 degrees at most, which leaves 0.9 of it.
    assert radiance.min() > 0.8 * ALBEDO
    assert radiance.max() < 1.1 * ALBEDO
