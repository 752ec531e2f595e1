"""White surfaces vanish in a white furnace, whatever their roughness and their lobes."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from scenec.backends import registry
from scenec.backends.stage.scene import RenderScene, Surface
from scenec.backends.surface import lobes
from scenec.backends.surface.algebra import FLOAT64
from scenec.backends.testing import scenes as ms
from scenec.testing.extras import needs

ROUGHNESS = (0.05, 0.2, 0.35, 0.5, 0.65, 0.8, 0.9, 1.0)
#: (specular, metallic): metals, white gloss, and both beside a dull lobe.
LOBES = ((0.0, 1.0), (1.0, 0.0), (0.3, 0.0), (0.2, 0.5))
FURNACE = 2.0


def patches(color: tuple[float, float, float] = (1.0, 1.0, 1.0)) -> RenderScene:
    """Level squares side by side, of a roughness a column and lobes a row."""
    meshes, surfaces = [], []
    for row, (specular, metallic) in enumerate(LOBES):
        for column, roughness in enumerate(ROUGHNESS):
            points, faces = ms.plane(0.5)
            meshes.append(ms.mesh(points + center(row, column), faces, (len(surfaces),)))
            name = f"/M{row}_{column}"
            surfaces.append(Surface(name, color, specular, roughness, 0.0, metallic))
    return ms.scene(meshes, surfaces, cameras=[camera(0.0)], lights=[ms.dome(FURNACE)])


def center(row: int, column: int) -> NDArray[np.float64]:
    """The middle of a square."""
    return np.array([column - 0.5 * len(ROUGHNESS) + 0.5, row - 0.5 * len(LOBES) + 0.5, 0.0])


def camera(degrees: float) -> ms.Camera:
    """Far away, so many degrees off the zenith."""
    angle = np.radians(degrees)
    away = 300.0 * np.array([0.0, -np.sin(angle), np.cos(angle)])
    return ms.look_at(tuple(away), (0, 0, 0), 64, 32, 1.55)


def means(picture: NDArray, seen: ms.Camera) -> NDArray[np.float64]:
    """Mean radiance of each square's inner half, [rows, columns, 3]."""
    to_camera = np.linalg.inv(np.vstack([seen.camera_to_world[:3], [0, 0, 0, 1]]))
    found = np.zeros((len(LOBES), len(ROUGHNESS), 3))
    for row in range(len(LOBES)):
        for column in range(len(ROUGHNESS)):
            corners = center(row, column) + 0.3 * np.array([[-1, -1, 0], [1, 1, 0]])
            pixel = (to_camera[:3, :3] @ corners.T + to_camera[:3, 3:]).T @ seen.intrinsics.T
            pixel = pixel[:, :2] / pixel[:, 2:]
            (left, top), (right, bottom) = pixel.min(axis=0), pixel.max(axis=0)
            inside = (slice(int(np.floor(top)), int(np.ceil(bottom))),
                      slice(int(np.ceil(left)), int(np.floor(right))))  # fmt: skip
            found[row, column] = picture[inside].mean(axis=(0, 1))
    return found


@pytest.mark.parametrize(
    # Mitsuba's samples are independent; nothing in pyrender is random.
    ("name", "samples"),
    [("mitsuba", 8192), pytest.param("cycles", 512, marks=needs("cycles", "bpy")), ("pyrender", 4)],
)
def test_white_surfaces_vanish(name, samples):
    backend = registry.open_backend(name)
    scene = patches()
    backend.load(scene)
    for degrees in (5.0, 45.0, 70.0):
        seen = camera(degrees)
        picture = backend.radiance(seen, 0, samples, 1).halves.astype(float).mean(axis=0)
        np.testing.assert_allclose(means(picture, seen), FURNACE, rtol=0.01)


def hemisphere(count: int) -> tuple[NDArray, float]:
    """Unit vectors of the upper half [3, n], even in solid angle, and the solid angle of each."""
    z, phi = np.meshgrid((np.arange(count) + 0.5) / count, np.arange(2 * count) * np.pi / count)
    across = np.sqrt(1.0 - z * z)
    w = np.stack([across * np.cos(phi), across * np.sin(phi), z]).reshape(3, -1)
    return w, np.pi / count**2


@pytest.mark.parametrize("roughness", [0.3, *ROUGHNESS[3:]])
@pytest.mark.parametrize("degrees", [0.0, 40.0, 65.0, 80.0])
def test_the_definition_keeps_what_a_white_lobe_has_and_darkens_a_colored_one(roughness, degrees):
    alpha, cosine = roughness * roughness, np.cos(np.radians(degrees))
    wi = np.array([[np.sin(np.radians(degrees))], [0.0], [cosine]])
    wo, solid = hemisphere(600)
    half = FLOAT64.unit(wi + wo)
    sine2 = half[0] ** 2 + half[1] ** 2
    value, _ = lobes.ggx(FLOAT64, alpha, (cosine, wo[2]), half[2], sine2)
    once = value.sum() * solid
    assert once == pytest.approx(lobes.albedo(alpha, cosine), rel=6e-3)
    shares = np.array([0.02, 0.5, 1.0])
    metal = lobes.Lobes(shares, alpha, 0.0, 0.0, 1.0)
    seen = once * lobes.gloss_color(metal, cosine)
    assert seen[2] == pytest.approx(1.0, rel=6e-3)
    # Between what scatters once and what would reach the color itself.
    assert (once * shares[:2] <= seen[:2]).all()
    assert (seen[:2] < shares[:2]).all()
    assert seen[0] == pytest.approx(once * shares[0], rel=0.03)
