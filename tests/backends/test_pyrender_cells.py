"""Maps in cells, of two scales, mixed by heights, and emission in Pyrender, against float64."""

from __future__ import annotations

import cell_scenes as cs
import numpy as np
import pytest

from scenec.backends.pyrender import Pyrender

#: Root mean square and mean of the relative differences.
SPREAD, OFFSET = 0.004, 6e-4


@pytest.fixture(scope="module")
def backend():
    return Pyrender()


def picture(backend, scene):
    backend.load(scene)
    light = backend.radiance(scene.cameras[0][0], 0, 16, 2)
    return light.halves.astype(float).mean(axis=0)


@pytest.mark.parametrize("kind", cs.KINDS)
def test_ground_looks_as_defined(tmp_path, backend, kind):
    # Hills throw light at each other here, which the oracle has not.
    scene = cs.scene(tmp_path, kind, height=0.0)
    spread, offset, pixels = cs.differences(picture(backend, scene), scene)
    assert pixels > 1000
    assert spread < SPREAD
    assert abs(offset) < OFFSET


def test_what_gives_off_light_is_seen_as_it_is_however_many_lights_there_are(backend):
    import mitsuba_scenes as ms

    scene = cs.panel_scene(1.0)
    suns = [ms.sun(50.0, 10.0, 1e-6), ms.sun(40.0, -10.0, 1e-6)]
    for lights in ([], suns):
        got = picture(backend, ms.with_lights(scene, lights))
        np.testing.assert_allclose(got[12, 12], cs.GLOW, rtol=1e-5)
    assert "light no others" in " ".join(backend.losses(scene))
