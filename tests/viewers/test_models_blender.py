"""What ``export`` makes of stages, in Blender: all is where the stage has it, and painted."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from scenec.backends.stage.read import read_stage
from scenec.backends.stage.scene import RenderScene
from scenec.cli.main import main
from scenec.testing.small import small_cfg, write_cfg

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def out(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("blender_models")
    cfg = write_cfg(folder, small_cfg(samples=1))
    assert main(["compile", str(cfg), "-o", str(folder / "out"), "--no-cache"]) == 0
    return folder / "out"


@pytest.fixture(scope="module")
def scene(out) -> RenderScene:
    return read_stage(out / "batch_0000" / "stage.usda")


def imported(out: Path, kind: str, ending: str) -> dict[str, Any]:
    pytest.importorskip("bpy")
    assert main(["export", str(out), "--format", kind, "--set", "texels=4096"]) == 0
    file = out / "datasets" / kind / f"batch_0000.{ending}"
    done = subprocess.run(
        [sys.executable, str(Path(__file__).with_name("blender_model.py")), str(file)],
        capture_output=True,
        text=True,
        check=False,
    )
    assert "\nTOLD" in done.stdout, done.stderr
    told: dict[str, Any] = json.loads(done.stdout.split("\nTOLD")[1])
    return told


def check_ground(told: dict[str, Any], scene: RenderScene) -> None:
    rows = np.flatnonzero(scene.rows.instance_id == 0)
    world = np.concatenate(
        [
            scene.meshes[scene.rows.mesh[r]].points @ scene.rows.to_world[r, :, :3].T
            + scene.rows.to_world[r, :, 3]
            for r in rows
        ]
    )
    assert told["ground"] == len(rows)
    found = np.array(told["corners"])
    assert np.allclose(found.min(axis=0), world.min(axis=0), atol=1e-4)
    assert np.allclose(found.max(axis=0), world.max(axis=0), atol=1e-4)
    assert sum(name.startswith("ground_") for name in told["pictured"]) == len(rows)
    assert told["cameras"] == len(scene.cameras[0])
    assert len(told["suns"]) == len(scene.lighting[0].suns)


def test_the_gltf_has_all_instances_as_objects(out, scene):
    told = imported(out, "gltf", "glb")
    check_ground(told, scene)
    assert told["meshes"] - told["ground"] == np.count_nonzero(scene.rows.instance_id)


def test_the_package_has_all_instances(out, scene):
    told = imported(out, "usdz", "usdz")
    check_ground(told, scene)
    assert told["instances"] == len(set(scene.rows.instance_id.tolist()) - {0})
