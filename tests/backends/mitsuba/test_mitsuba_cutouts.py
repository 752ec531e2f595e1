"""Cut-outs and colors of vertices look alike however Mitsuba follows paths."""

from __future__ import annotations

import dataclasses
import importlib.util
from pathlib import Path

import numpy as np
import pytest

from scenec.backends.mitsuba.adapter import Mitsuba
from scenec.backends.stage.scene import RenderScene
from scenec.backends.testing import lights
from scenec.backends.testing import scenes as ms

pytestmark = pytest.mark.skipif(
    importlib.util.find_spec("mitsuba") is None, reason="Mitsuba is not installed"
)


def bright(folder: Path) -> RenderScene:
    """Cards with masks and colors over ground, all of which send each other light."""
    made = lights.cutout_scene(folder)
    surfaces = [
        dataclasses.replace(each, base_color=(0.8, 0.7, 0.6), diffuse_transmission=0.4 * (i > 0))
        for i, each in enumerate(made.surfaces)
    ]
    rng = np.random.default_rng(8)
    meshes = [
        dataclasses.replace(
            mesh, color=rng.uniform(0.2, 1.0, (len(mesh.faces), 3, 3)).astype(np.float32)
        )
        for mesh in made.meshes
    ]
    made = dataclasses.replace(made, surfaces=tuple(surfaces), meshes=tuple(meshes))
    return ms.with_lights(made, [ms.sun(50.0, 70.0, 500.0, 3.0), ms.dome(40.0)])


def test_gathered_paths_those_of_volpath_and_kept_instances_agree_within_noise(
    tmp_path, monkeypatch
):
    scene, found = bright(tmp_path), []
    for way in ("gathered", "volpath", "kept"):
        backend = Mitsuba(device="cpu")
        if way == "kept":
            backend.load_cost = dataclasses.replace(backend.load_cost, most_written=0.0)
        if way == "volpath":
            monkeypatch.setattr(backend, "_gathers", lambda: False)
        backend.load(scene)
        found.append(backend.radiance(scene.cameras[0][0], 0, 256, 1))
    first = found[0].halves.reshape(2, 6, 8, 8, 8, 3).mean(axis=(2, 4))
    noise = np.sqrt(((first[0] - first[1]) ** 2).mean() / 4)
    assert noise < 0.01 * first.mean()
    for other in found[1:]:
        assert np.abs(other.coverage - found[0].coverage).mean() < 5e-3
        blocks = other.halves.reshape(2, 6, 8, 8, 8, 3).mean(axis=(0, 2, 4))
        off = blocks - first.mean(axis=0)
        assert np.sqrt((off**2).mean()) < 3.0 * noise
        assert abs(off.mean()) < 3e-3 * first.mean()
