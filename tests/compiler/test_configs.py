"""The cfgs that ship, made coarse: each builds a sound scene in which every label turns up."""

from __future__ import annotations

import importlib.util
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from usd_validator import independent_findings

from scenec.backends.stage.read import read_stage
from scenec.compiler.build import BuildLog, build
from scenec.compiler.cfg.load import load
from scenec.compiler.compile import compile_cfg
from scenec.compiler.draw import draw
from scenec.compiler.scene.scene import Scene
from scenec.compiler.views.needed import Keep

_ROOT = Path(__file__).parents[2]
_CFGS = sorted((_ROOT / "configs").glob("*.json"))
#: Times fewer samples along a side, and objects.
FEWER = 10
#: By package: what in a cfg asks for it, and the extra that brings it.
_EXTRAS = {
    "bpy": ("package:bpy/", "cycles"),
    "matplotlib": ("package:matplotlib/", "demo"),
    "rasterio": ('.tif"', "geotiff"),
}


def coarse(file: Path, folder: Path) -> Path:
    """A copy with samples far apart, small pictures and textures, and few of the objects."""
    cfg: dict[str, Any] = json.loads(file.read_text())
    cfg["terrain"]["spacing_m"] *= FEWER
    for group in cfg["objects"].values():
        if "count" in group:
            group["count"] = max(1, group["count"] // FEWER)
        elif "per_m2" in group:
            group["per_m2"] /= FEWER
    for material in cfg["materials"].values():
        if "procedural" in material.get("maps", {}):
            material["maps"]["procedural"]["resolution"] = 128
    if cfg["light"]["sky"]["type"] == "atmosphere":
        cfg["light"]["sky"]["resolution"] = 32
    for rig in cfg["rigs"].values():
        for sensor in rig["sensors"].values():
            sensor["resolution"] = [64, 48]
    (folder / "assets").symlink_to(_ROOT / "assets")
    (folder / "configs").mkdir()
    copy = folder / "configs" / file.name
    copy.write_text(json.dumps(cfg))
    return copy


def coarse_or_skip(file: Path, folder: Path) -> Path:
    for package, (mark, extra) in _EXTRAS.items():
        if mark in file.read_text() and not importlib.util.find_spec(package):
            pytest.skip(f"needs the extra {extra}")
    return coarse(file, folder)


def scene_of(file: Path, folder: Path, seed: int) -> Scene:
    return build(draw(load(coarse_or_skip(file, folder)), seed, 0), BuildLog(), Keep.UNPRUNED)


@pytest.mark.invariant
@pytest.mark.slow
@pytest.mark.parametrize("file", _CFGS, ids=lambda file: file.stem)
def test_a_shipped_cfg_builds_a_finite_scene_with_all_of_its_labels(file, tmp_path):
    scene = scene_of(file, tmp_path, seed=5)
    cfg = json.loads(file.read_text())
    seen = [scene.sky_labels]
    for part in scene.ground.parts:
        for tile in part.tiles:
            for array in (tile.translate, tile.points, tile.normals, tile.weights, tile.variation):
                assert np.isfinite(array).all()
            seen += [part.layers[i].labels for i in np.unique(tile.layer).tolist()]
    for objects in scene.objects:
        middles, radii = objects.balls()
        assert np.isfinite(middles).all()
        assert (radii > 0.0).all()
        count = cfg["objects"][objects.name].get("count")
        assert objects.count == max(1, count // FEWER) if count else objects.count > 0
        seen.append(objects.labels)
        seen += [part.labels for mesh in objects.prototypes for part in mesh.parts if part.labels]
    for level, names in cfg["labels"].items():
        assert {labels.get(level, 0) for labels in seen} - {0} == set(names.values()), level


@pytest.mark.slow
@pytest.mark.parametrize("file", _CFGS, ids=lambda file: file.stem)
def test_the_stage_of_a_shipped_cfg_is_read_whole_and_passes_the_independent_validator(
    file, tmp_path
):
    compile_cfg(coarse_or_skip(file, tmp_path), seed=5, out=tmp_path / "out", batches=range(1))
    stage = tmp_path / "out/batch_0000/stage.usda"
    assert read_stage(stage).losses == ()
    # Its advice to index primvars that repeat values would cost more than it saves, and leaves are
    # sheets whose edges meet.
    found = independent_findings(stage, tmp_path / "found.json")
    assert found <= {("WARNING", "IndexedPrimvarChecker"), ("WARNING", "ManifoldChecker")}
