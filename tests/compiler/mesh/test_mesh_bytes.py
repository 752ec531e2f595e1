"""Terrain that is a mesh has the same bytes on every CPU and with any number of threads."""

from __future__ import annotations

from pathlib import Path

import pytest
from elsewhere import printed_elsewhere, printed_here
from pxr import Gf, Usd, UsdGeom

from scenec.testing.overhangs import shelter, write
from scenec.testing.small import small_cfg, write_cfg

_HASHES = """
import hashlib, sys
from scenec.compiler.build import BuildLog, build
from scenec.compiler.draw import draw
from scenec.compiler.cfg.load import load
log = BuildLog()
scene = build(draw(load(sys.argv[1]), 11, 0), log)
rocks = scene.objects[0]
for tile in scene.ground.tiles:
    for key in ("translate", "points", "faces", "normals", "layer", "weights", "variation"):
        print(tile.name, key, hashlib.sha256(getattr(tile, key).tobytes()).hexdigest())
print(hashlib.sha256(rocks.positions.tobytes() + rocks.orientations.tobytes()).hexdigest())
print(log.facts)
"""


@pytest.fixture(scope="module")
def cfg(tmp_path_factory) -> Path:
    """A mesh under rotations of every kind, with relief, labels and rocks."""
    folder = tmp_path_factory.mktemp("bytes")
    path = write(folder / "cave.usda", *shelter(16))
    stage = Usd.Stage.Open(str(path))
    UsdGeom.Xform.Define(stage, "/World").AddRotateXYZOp().Set(Gf.Vec3f(2, -3, 37))
    stage.Save()
    content = small_cfg()
    content["terrain"]["size_m"] = [12, 12]
    rough = {"amplitude_m": 0.1, "scale_m": 2}
    content["terrain"]["relief"][0] = {
        "type": "mesh", "file": "cave.usda", "rotation_deg": 11, "roughness": rough,
    }  # fmt: skip
    content["objects"]["rocks"]["orientation"] = "normal"
    return write_cfg(folder, content)


@pytest.mark.invariant
@pytest.mark.slow
def test_a_mesh_base_has_the_same_bytes_in_all_circumstances_at_once(cfg):
    reference = printed_here(_HASHES, cfg)
    assert len(reference.splitlines()) == 9
    assert printed_elsewhere(_HASHES, cfg) == reference
