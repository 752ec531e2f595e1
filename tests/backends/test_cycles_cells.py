"""Maps in cells, of two scales, mixed by heights, and emission in Cycles, against float64."""

from __future__ import annotations

import cell_scenes as cs
import pytest

from scenec.backends.cycles import Cycles

#: Light of its own takes turns with the sun's: more noise.
SPP = {"emission": 512}
#: Root mean square and mean of the relative differences.
SPREAD, OFFSET = 0.004, 6e-4


@pytest.fixture(scope="module")
def backend():
    return Cycles(bounces=0)


def picture(backend, scene, spp=64):
    backend.load(scene)
    light = backend.radiance(scene.cameras[0][0], 0, spp, 2)
    return light.halves.astype(float).mean(axis=0)


@pytest.mark.parametrize("kind", cs.KINDS)
def test_ground_looks_as_defined(tmp_path, backend, kind):
    scene = cs.scene(tmp_path, kind)
    spread, offset, pixels = cs.differences(picture(backend, scene, SPP.get(kind, 64)), scene)
    assert pixels > 1000
    assert spread < SPREAD
    assert abs(offset) < OFFSET


@pytest.mark.parametrize("turn", [1.0, -1.0])
def test_what_gives_off_light_is_seen_as_it_is_and_lights_its_neighbor_from_both_sides(
    backend, turn
):
    scene = cs.panel_scene(turn)
    cs.check_panel(picture(backend, scene, 256), scene)
