"""Maps in cells, of two scales, mixed by heights, and emission in Mitsuba, against float64."""

from __future__ import annotations

import cell_scenes as cs
import pytest

from scenec.backends.mitsuba import Mitsuba

#: Root mean square and mean of the relative differences.
SPREAD, OFFSET = 0.01, 1.5e-3
#: Light of its own takes turns with the sun's: more noise.
SAMPLES, MORE = 256, 1024


@pytest.fixture(scope="module")
def backend():
    return Mitsuba(bounces=0)


def picture(backend, scene, spp):
    backend.load(scene)
    light = backend.radiance(scene.cameras[0][0], 0, spp, 2)
    return light.halves.astype(float).mean(axis=0)


@pytest.mark.parametrize("kind", cs.KINDS)
def test_ground_looks_as_defined(tmp_path, backend, kind):
    scene = cs.scene(tmp_path, kind)
    got = picture(backend, scene, MORE if kind == "emission" else SAMPLES)
    spread, offset, pixels = cs.differences(got, scene)
    assert pixels > 1000
    assert spread < (4.0 * SPREAD if kind == "emission" else SPREAD)
    assert abs(offset) < OFFSET


@pytest.mark.parametrize("turn", [1.0, -1.0])
def test_what_gives_off_light_is_seen_as_it_is_and_lights_its_neighbor_from_both_sides(
    backend, turn
):
    scene = cs.panel_scene(turn)
    cs.check_panel(picture(backend, scene, 1024), scene)


def test_the_sky_behind_what_gives_off_light_is_left_to_shared_code(backend):
    import dataclasses

    import mitsuba_scenes as ms

    scene = ms.with_lights(cs.panel_scene(1.0), [ms.dome(7.0)])
    backend.load(scene)
    light = backend.radiance(scene.cameras[0][0], 0, 16, 2)
    assert light.coverage[0, 0] == 0.0
    assert not light.halves[:, 0, 0].any()
    assert light.coverage[-1, 12] == 1.0
    assert backend.losses(scene) == ()
    dark = dataclasses.replace(scene, surfaces=(scene.surfaces[0], ms.surface()))
    backend.load(dark)
    assert backend.radiance(dark.cameras[0][0], 0, 16, 2).coverage[0, 0] == 0.0
