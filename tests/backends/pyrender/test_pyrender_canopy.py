"""What pyrender's preview leaves of the sky under leaves."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from scenec.backends.contract import Rays
from scenec.backends.exact import ExactCaster
from scenec.backends.pyrender import Pyrender
from scenec.backends.pyrender.canopy import CELLS, make_canopy
from scenec.backends.testing import scenes as ms


def sphere_points(n: int, rng: np.random.Generator) -> NDArray:
    points = rng.normal(size=(n, 3))
    return points / np.linalg.norm(points, axis=1)[:, None]


@pytest.mark.parametrize("leaf_area", [0.5, 2.0])
def test_under_leaves_as_much_of_the_sky_is_left_as_rays_find(leaf_area):
    """Black leaves at random in a layer of 20 x 20 x 4 m; rays from its floor to the sky."""
    rng = np.random.default_rng(11)
    count, side = 30000, 20.0
    # Equilateral triangles that look in all directions.
    edge = np.sqrt(leaf_area * side * side / count * 4.0 / np.sqrt(3.0))
    first = sphere_points(count, rng)
    second = np.cross(first, sphere_points(count, rng))
    second /= np.linalg.norm(second, axis=1)[:, None]
    corners = np.stack(
        [first, -0.5 * first + 0.866 * second, -0.5 * first - 0.866 * second], axis=1
    )
    place = rng.uniform([-10.0, -10.0, 0.0], [10.0, 10.0, 4.0], (count, 3))
    points = (corners * edge / np.sqrt(3.0) + place[:, None]).reshape(-1, 3)
    leaves = ms.mesh(points, np.arange(3 * count).reshape(-1, 3))
    black = replace(ms.surface((0.0,) * 3), diffuse_transmission=0.5)
    scene = ms.scene([leaves], [black])
    found = make_canopy(scene)
    assert found is not None
    # Where the layer is as good as endless but for its edges, which low rays leave by.
    cells = ((np.array([[-3.0, -3.0], [3.0, 3.0]]) - found.low[:2]) / found.size[:2]) * CELLS[:2]
    low, high = cells.astype(int)
    layer = int(-found.low[2] / found.size[2] * CELLS[2])
    share = found.open[layer, low[1] : high[1], low[0] : high[0]].mean()
    way = sphere_points(20000, rng)
    way[:, 2] = np.abs(way[:, 2])
    origins = np.zeros((20000, 3))
    origins[:, :2] = rng.uniform(-3.0, 3.0, (20000, 2))
    free = ~np.isfinite(ExactCaster(scene).cast(Rays(origins, way, (1, 20000)))[2])
    assert share == pytest.approx(free.mean(), abs=0.03)
    # Above the leaves is all of it, and what is no sheet hides nothing.
    assert found.open[-1].mean() > 0.95
    assert make_canopy(ms.scene([leaves], [ms.surface((0.0,) * 3)])) is None


def test_cloth_hides_nothing_of_its_own_sky():
    cloth = replace(ms.surface((0.5,) * 3), diffuse_transmission=0.5)
    assert make_canopy(ms.scene([ms.mesh(*ms.plane(2.0))], [cloth])) is None


def test_ground_far_beside_leaves_has_all_of_the_sky():
    """A clump of leaves, 2 m high, and ground that is seen from above at its foot and 60 m away."""
    rng = np.random.default_rng(5)
    first, second = rng.normal(size=(2, 3000, 3)) * 0.05
    place = rng.uniform([-1.0, -1.0, 0.1], [1.0, 1.0, 2.0], (3000, 3))
    points = np.stack([place, place + first, place + second], axis=1).reshape(-1, 3)
    leaves = ms.mesh(points, np.arange(9000).reshape(-1, 3), layers=(1,))
    black = replace(ms.surface((0.0,) * 3), diffuse_transmission=0.5)
    ground, surfaces = ms.mesh(*ms.plane(100.0)), [ms.surface(), black]

    def mean(meshes: list, x: float) -> float:
        backend = Pyrender()
        backend.load(ms.scene(meshes, surfaces, lights=[ms.dome()]))
        camera = ms.look_at((x, 0.0, 5.0), (x, 0.0, 0.0), 8, 6, 0.1)
        return float(backend.radiance(camera, 0, 4, 1).halves[0].mean())

    for x, least, most in ((60.0, 0.98, 1.02), (1.5, 0.0, 0.95)):
        assert least < mean([ground, leaves], x) / mean([ground], x) < most
