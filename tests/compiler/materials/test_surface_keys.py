"""Keys of materials and layers for cells, larger scales, blends by height, and light given off."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from pxr import Usd, UsdShade

from scenec.backends.check.stage import check_stage
from scenec.backends.stage.read import read_stage
from scenec.compiler.cfg.load import load
from scenec.compiler.compile import compile_cfg
from scenec.compiler.draw import draw
from scenec.schemas import stage as names
from scenec.schemas.errors import CfgError
from scenec.testing.small import small_cfg, write_cfg


def keyed_cfg() -> dict:
    cfg = small_cfg()
    cfg["materials"]["sand"] = {
        "base_color": [0.4, 0.3, 0.2],
        "maps": {
            "procedural": {"type": "sand", "resolution": 64},
            "cells": {},
            "far": {"factor": 5.5, "share": 0.25},
        },
    }
    cfg["materials"]["gravel"] = {
        "base_color": [0.2, 0.2, 0.2],
        "emission": [0.5, 0, 2],
        "maps": {
            "size_m": 2,
            "base_color": "c.png",
            "emission": "e.png",
            "displacement": "h.png",
            "displacement_m": 0,
            "cells": {"size_m": 3},
        },
    }
    cfg["materials"]["stone"]["emission"] = [1, 1, 0.5]
    cfg["terrain"]["ground"][1]["height_blend"] = 0.25
    return cfg


@pytest.fixture
def folder(tmp_path) -> Path:
    rng = np.random.default_rng(1)
    for name, shape in (("c", (8, 8, 3)), ("e", (8, 8, 3)), ("h", (8, 8))):
        codes = rng.integers(0, 255, shape).astype(np.uint8)
        Image.fromarray(codes).save(tmp_path / f"{name}.png")
    return tmp_path


def test_keys_reach_the_renderers(folder):
    compile_cfg(write_cfg(folder, keyed_cfg()), seed=2, out=folder / "out")
    stage = folder / "out/batch_0000/stage.usda"
    scene = read_stage(stage)
    assert not list(check_stage(stage))
    surfaces = {s.path.rsplit("/", 1)[1]: s for s in scene.surfaces}
    sand, gravel = surfaces["sand"].maps, surfaces["gravel"].maps
    assert sand.far == (5.5, 0.25)
    assert sand.cells.size_m == 1.5
    assert gravel.cells.size_m == 3.0
    assert sand.cells.seed != gravel.cells.seed
    assert max(sand.cells.seed, gravel.cells.seed) < 2**31
    assert gravel.far is None
    assert surfaces["gravel"].emission == (0.5, 0.0, 2.0)
    assert gravel.emission.read_bytes() == (folder / "e.png").read_bytes()
    assert gravel.height.read_bytes() == (folder / "h.png").read_bytes()
    assert surfaces["stone"].emission == (1.0, 1.0, 0.5)
    # Up to the blended layer; the mud above it blends by its weight.
    assert sand.height is not None
    assert surfaces["mud"].maps is None
    ground = [mesh for mesh in scene.meshes if len(mesh.weights)]
    assert ground
    assert all(mesh.height_blends == (0.25, 0.0) for mesh in ground)


def test_what_is_not_asked_for_is_not_in_the_stage(folder):
    compile_cfg(write_cfg(folder, small_cfg()), seed=2, out=folder / "out")
    stage = Usd.Stage.Open(str(folder / "out/batch_0000/stage.usda"))
    unwanted = (
        names.ATTR_MAP_CELL_SIZE, names.ATTR_MAP_CELL_SEED, names.ATTR_MAP_FAR,
        names.ATTR_EMISSION, names.ATTR_HEIGHT_BLENDS, *names.ATTR_MAPS.values(),
    )  # fmt: skip
    for prim in stage.TraverseAll():
        assert not any(prim.HasAttribute(name) for name in unwanted), prim.GetPath()


def test_viewers_see_what_a_material_gives_off(folder):
    compile_cfg(write_cfg(folder, keyed_cfg()), seed=2, out=folder / "out")
    stage = Usd.Stage.Open(str(folder / "out/batch_0000/stage.usda"))
    for name, expected in (("stone", (1.0, 1.0, 0.5)), ("sand", None)):
        look = UsdShade.Material(stage.GetPrimAtPath(f"/World/Looks/{name}"))
        surface, *_ = look.ComputeSurfaceSource()
        glow = surface.GetInput("emissiveColor")
        assert (tuple(glow.Get()) if glow else None) == expected


def test_cells_are_others_in_each_batch_and_the_same_for_one_seed(folder):
    spec = load(write_cfg(folder, {**keyed_cfg(), "batches": 2}))
    seeds = [draw(spec, 5, batch).materials["sand"].material.maps.cells.seed for batch in (0, 1, 0)]
    assert seeds[0] == seeds[2] != seeds[1]


@pytest.mark.parametrize(
    ("change", "below", "message"),
    [
        ({"cells": {}, "projection": "triplanar"}, "/cells", 'is "triplanar"'),
        ({"far": {}, "projection": "triplanar"}, "/far", "projected from above"),
        ({"displacement": "h.png"}, "", "displacement_m"),
        ({"displacement_m": 0.1}, "/displacement_m", "without a picture"),
        ({"ambient_occlusion_strength": 1}, "/ambient_occlusion_strength", "without a picture"),
        ({"emission": "e.png"}, "/emission", "left out"),
        ({"opacity": "h.png"}, "/opacity", 'expected "projection": "uv"'),
        ({"opacity_threshold": 0.2}, "/opacity_threshold", "without a picture"),
        ({"gloss": "h.png", "roughness": "h.png"}, "/gloss", "take one away"),
    ],
)
def test_faults_of_maps_name_the_key(folder, change, below, message):
    cfg = small_cfg()
    cfg["materials"]["gravel"] = {"maps": {"size_m": 1, "base_color": "c.png"} | change}
    with pytest.raises(CfgError, match=message) as caught:
        load(write_cfg(folder, cfg))
    assert [fault.pointer for fault in caught.value.faults] == [f"/materials/gravel/maps{below}"]


@pytest.mark.parametrize("made", [True, False])
def test_what_becomes_geometry_is_for_the_ground_only(folder, made):
    cfg = small_cfg()
    maps = {"size_m": 1, "projection": "above"}
    if made:
        maps["procedural"] = {"type": "gravel", "displacement": True}
    else:
        maps |= {"displacement": "h.png", "displacement_m": 0.1}
    cfg["materials"]["stone"]["maps"] = maps
    with pytest.raises(CfgError, match="for the ground only") as caught:
        load(write_cfg(folder, cfg))
    assert [fault.pointer for fault in caught.value.faults] == ["/objects/rocks/material"]
    # An object's material is triplanar by itself.
    del maps["projection"]
    with pytest.raises(CfgError, match="of a material of objects is triplanar"):
        load(write_cfg(folder, cfg))


def test_a_blend_by_height_needs_heights_below_it_or_its_own(folder):
    cfg = small_cfg()
    cfg["terrain"]["ground"][1]["height_blend"] = {"type": "uniform", "min": 0, "max": 1}
    with pytest.raises(CfgError, match="has heights") as caught:
        load(write_cfg(folder, cfg))
    pointer = "/terrain/ground/1/height_blend"
    assert [fault.pointer for fault in caught.value.faults] == [pointer]
    cfg["materials"]["sand"]["maps"] = {"procedural": {"type": "sand"}}
    load(write_cfg(folder, cfg))
    cfg["terrain"]["ground"][1]["height_blend"] = 0
    del cfg["materials"]["sand"]["maps"]
    load(write_cfg(folder, cfg))
