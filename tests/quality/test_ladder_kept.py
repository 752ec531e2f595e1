"""The rung that ladders mark as the cfg's is what was compiled, whatever is seen and kept."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from scenec.compiler.build import BuildLog, build
from scenec.compiler.cfg.load import load
from scenec.compiler.compile import compile_cfg
from scenec.compiler.draw import draw
from scenec.compiler.materials.values import stored
from scenec.compiler.views.needed import Keep
from scenec.quality.ladder import Ladder, Rung, climb, cost
from scenec.quality.ladder.base import Base
from scenec.quality.ladder.run import climb_base
from scenec.schemas.errors import OutputError
from scenec.schemas.manifest import MANIFEST
from scenec.testing.small import small_cfg, write_cfg

SEED = 5


@pytest.fixture(autouse=True)
def _single_readings(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cost, "ENOUGH_S", 0.0)


def used(ladders: tuple[Ladder, ...], name: str) -> Rung:
    ladder = next(one for one in ladders if one.name == name)
    return next(rung for rung in ladder.rungs if rung.used)


def scanned_cfg() -> dict[str, Any]:
    """A depth camera and a lidar: labels are for the scans alone."""
    cfg = small_cfg(samples=1)
    rig = cfg["rigs"]["rover"]
    rig["sensors"]["front"]["outputs"] = ["depth"]
    rig["lidars"] = {"top": {"beams": 4, "elevation_deg": [5, -30], "azimuths": 90}}
    return cfg


def test_ground_is_cut_along_labels_for_lidars_as_the_compiler_cuts_it(tmp_path: Path) -> None:
    spec = load(write_cfg(tmp_path, scanned_cfg()))
    log = BuildLog()
    build(draw(spec, SEED, 0), log)
    found = climb_base(Base(spec, SEED, 0), ["tessellation"], 2)
    assert used(found.ladders, "tessellation").triangles == log.facts["ground"]["faces"]


def test_an_output_of_which_all_is_kept_is_as_fine_out_of_view(tmp_path: Path) -> None:
    out = compile_cfg(
        write_cfg(tmp_path, scanned_cfg()), seed=SEED, out=tmp_path / "out", keep=Keep.ALL
    ).out
    written = json.loads((out / "batch_0000" / "report.json").read_text())
    found = climb(out, rungs=2, only=["tessellation", "lod", "sky"])
    mesh = used(found.ladders, "tessellation")
    assert mesh.triangles == written["ground"]["faces"]
    assert mesh.details["triangles_before_cuts"] == written["ground"]["mesh"]["triangles"]
    assert used(found.ladders, "lod").triangles == written["objects"]["rocks"]["triangles"]
    # No camera shows color, but whoever walks around does.
    assert used(found.ladders, "sky").value == 32.0
    manifest = json.loads((out / MANIFEST).read_text())
    (out / MANIFEST).write_text(json.dumps({**manifest, "keep": "some"}))
    with pytest.raises(OutputError, match='keep "some": expected one of seen, unpruned, all'):
        climb(out, rungs=2, only=["lod"])


def test_pictures_are_as_small_as_the_cameras_with_color_let_them_be(tmp_path: Path) -> None:
    """A depth camera at the ground sees how fine they are not."""
    cfg = small_cfg(samples=1, objects={})
    del cfg["materials"]["stone"], cfg["labels"]["class"]["rock"], cfg["labels"]["surface"]["stone"]
    cfg["materials"]["sand"]["maps"] = {"procedural": {"type": "sand", "resolution": 512}}
    cfg["rigs"]["rover"]["sensors"] = {
        "far": {"resolution": [24, 16], "fov_deg": 70, "outputs": ["rgb"]},
        "near": {"resolution": [160, 120], "fov_deg": 30, "outputs": ["depth"]},
    }
    spec = load(write_cfg(tmp_path, cfg))
    scene = build(draw(spec, SEED, 0), BuildLog())
    maps = scene.materials["sand"].maps
    texels = stored(maps.files["base_color"]).shape[0]
    assert texels < 512
    found = climb_base(Base(spec, SEED, 0), ["textures"], 2)
    assert used(found.ladders, "textures").details["texels_across_most"] == texels
    kept = climb_base(Base(spec, SEED, 0, Keep.ALL), ["textures"], 2)
    assert "as they are drawn" in kept.absent["textures"]
