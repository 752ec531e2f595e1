"""What a check reads of a cfg: what is sound, the schema's default, or nothing."""

from __future__ import annotations

import json
import subprocess
import sys

import pytest
from small_cfg import changed, faults_of, minimal

from scenec.compiler.cfg.check_schema import check_schema
from scenec.compiler.kinds import schema
from scenec.compiler.kinds.node import Node, Tree


def node(cfg) -> Node:
    fields = list(schema.walk(schema.root(cfg)))
    return Node(Tree(fields, check_schema(fields)))


def test_a_value_is_read_as_it_stands_and_a_default_where_the_key_is_left_out():
    rocks = node(changed({"/objects/rocks/family": "slab"})).at("objects", "rocks")
    assert ("family" in rocks, rocks["family"]) == (True, "slab")
    assert ("shortfall" in rocks, rocks["shortfall"]) == (False, "error")
    assert ("apart" in rocks, rocks["apart"]) == (False, None)


def test_the_span_of_a_number_that_is_left_out_is_that_of_its_default():
    relief = [{"type": "plane"}, {"type": "polygons", "scale_m": -5, "depth_m": 1}]
    polygons = node(changed({"/terrain/relief": relief})).at("terrain", "relief", 1)
    spans = [polygons.span(key) for key in ("depth_m", "width_m", "scale_m", "mask", "no")]
    assert spans == [(1.0, 1.0), (0.8, 0.8), None, None, None]
    assert polygons.constant("width_m") == 0.8


@pytest.mark.parametrize("value", ["slap", 3, None, ["slab"], {"type": "slab"}])
def test_a_faulty_value_is_there_and_not_to_be_read(value):
    rocks = node(changed({"/objects/rocks/family": value})).at("objects", "rocks")
    assert ("family" in rocks, rocks["family"]) == (True, None)


@pytest.mark.parametrize("value", [None, 3, "rocks", [], True])
def test_what_is_no_object_where_one_belongs_is_empty(value):
    cfg = node(changed({"/objects/rocks": value}))
    assert not cfg.at("objects", "rocks")
    assert cfg.each("objects", "*") == []
    assert cfg.at("objects", "rocks", "density")["type"] is None


def test_a_list_with_a_faulty_item_is_faulty_and_its_other_items_are_not():
    size = {"/terrain/size_m": [0, {"type": "uniform", "min": 1, "max": 2}]}
    terrain = node(changed(size)).at("terrain")
    assert terrain["size_m"] is None
    assert [terrain.at("size_m").span(axis) for axis in (0, 1, 2)] == [None, (1.0, 2.0), None]


def test_each_follows_a_pattern_in_the_order_of_the_file():
    cfg = minimal()
    cfg["objects"]["boulders"] = cfg["objects"]["rocks"]
    found = node(cfg).each("objects", "*", "labels")
    assert [below.path for below in found] == [
        ("objects", "rocks", "labels"),
        ("objects", "boulders", "labels"),
    ]


def test_what_stands_below_an_unknown_key_has_no_faults_of_its_own(tmp_path):
    where = {"/terrain/ground/0/where": [{"type": "slope"}]}
    assert [fault.pointer for fault in faults_of(changed(where), tmp_path)] == [
        "/terrain/ground/0/where"
    ]


def test_checking_a_cfg_without_files_needs_neither_kernels_nor_readers_of_files(tmp_path):
    file = tmp_path / "cfg.json"
    size = {"type": "log_normal", "median": 0.3, "sigma": 0.1}
    file.write_text(json.dumps(changed({"/objects/rocks/size_m": size, "/samples": 0})))
    code = (
        "import sys\nfrom scenec.compiler.cfg.load import load\n"
        "from scenec.schemas.errors import CfgError\n"
        "try:\n    load(sys.argv[1])\nexcept CfgError as error:\n    print(len(error.faults))\n"
        "heavy = {'numba', 'scipy', 'pxr', 'trimesh', 'PIL', 'OpenEXR', 'scenec.compiler.assets'}\n"
        "print(*heavy & set(sys.modules))\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", code, str(file)], check=True, capture_output=True, text=True
    )
    assert done.stdout.split() == ["1"]
