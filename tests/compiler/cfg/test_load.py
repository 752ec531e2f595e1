"""A sound cfg: its defaults, its files and its digest."""

from __future__ import annotations

import hashlib
import importlib.util
import json
from pathlib import Path

import numpy as np
import pytest
from small_cfg import changed, faults_of, load_cfg, minimal

from scenec.compiler.cfg.load import load

_ROOT = Path(__file__).parents[3]


@pytest.mark.parametrize("file", sorted((_ROOT / "configs").glob("*.json")), ids=lambda f: f.name)
def test_the_cfgs_that_ship_load_without_a_warning(file):
    packages = {"bpy": "cycles", "matplotlib": "demo"}
    for name, extra in packages.items():
        used = f'"package:{name}/' in file.read_text()
        if used and importlib.util.find_spec(name) is None:
            pytest.skip(f"needs the extra {extra}")
    spec = load(file)
    assert spec.cfg["name"]
    assert spec.warnings == ()
    assert all(entry.path.is_file() for entry in spec.files.values())


def test_no_sun_and_no_offset_stay_null(tmp_path):
    np.save(tmp_path / "dem.npy", np.zeros((8, 8)))
    dem = {"type": "dem", "file": "dem.npy", "pixel_m": 9, "height_offset_m": None}
    cfg = load_cfg(changed({"/light/sun": None, "/terrain/relief/0": dem}), tmp_path).cfg
    assert cfg["light"]["sun"] is None
    assert cfg["terrain"]["relief"][0]["height_offset_m"] is None
    assert cfg["terrain"]["relief"][0]["pixel_m"] == 9.0


def test_a_coverage_takes_the_place_of_the_threshold(tmp_path):
    layer = {"material": "sand", "labels": {"class": "ground"}}
    cfg = load_cfg(
        changed({"/terrain/ground/1": layer, "/terrain/ground/2": {**layer, "coverage": 0.3}}),
        tmp_path,
    ).cfg
    base, plain, covering = cfg["terrain"]["ground"]
    assert set(base) == {"material", "labels"}
    assert (plain["threshold"], plain["coverage"]) == (0.5, None)
    assert (covering["threshold"], covering["coverage"]) == (None, 0.3)
    assert plain["noise"]["octaves"] == 4


def test_the_digest_is_that_of_the_meaning(tmp_path):
    digest = load_cfg(minimal(), tmp_path).digest
    same = [
        {"/version": 1.0, "/terrain/size_m": [20.0, 1e1]},
        {"/samples": 1, "/light/sun": {}, "/terrain/relief/0/slope": [0, -0.0]},
        {"/$schema": "../cfg.schema.json"},
        {"/objects/rocks/embed": {"type": "uniform", "max": 0.4, "min": 0.1, "per": "instance"}},
    ]
    for changes in same:
        assert load_cfg(changed(changes), tmp_path).digest == digest
    other = [{"/samples": 2}, {"/objects/rocks/size_m": 0.30000001}, {"/light/sun": None}]
    assert len({load_cfg(changed(c), tmp_path).digest for c in other} | {digest}) == 4


def test_the_digest_does_not_depend_on_where_the_cfg_lies_but_on_what_its_files_hold(tmp_path):
    cfg = changed({"/terrain/relief/0": {"type": "dem", "file": "dem.npy", "pixel_m": 9}})
    digests = []
    for folder, height in (("a", 0.0), ("b", 0.0), ("c", 1.0)):
        (tmp_path / folder).mkdir()
        np.save(tmp_path / folder / "dem.npy", np.full((8, 8), height))
        spec = load_cfg(cfg, tmp_path / folder)
        file = spec.files["terrain/relief/0/file"]
        assert file.path == tmp_path / folder / "dem.npy"
        assert file.sha256 == hashlib.sha256(file.path.read_bytes()).hexdigest()
        digests.append(spec.digest)
    assert digests[0] == digests[1] != digests[2]


def test_the_order_of_objects_is_kept_and_counts_for_the_digest(tmp_path):
    cfg = minimal()
    cfg["objects"]["boulders"] = cfg["objects"]["rocks"]
    one = load_cfg(cfg, tmp_path)
    cfg["objects"] = dict(reversed(cfg["objects"].items()))
    two = load_cfg(cfg, tmp_path)
    assert list(one.cfg["objects"]) == list(reversed(two.cfg["objects"])) == ["rocks", "boulders"]
    assert one.digest != two.digest


def test_a_picture_without_colors_and_a_broken_one_are_faults(tmp_path):
    import OpenEXR

    depth = {"Z": np.zeros((4, 8), np.float32)}
    with OpenEXR.File({}, depth) as picture:
        picture.write(str(tmp_path / "depth.exr"))
    (tmp_path / "cut.exr").write_bytes((tmp_path / "depth.exr").read_bytes()[:60])
    sky = {"type": "image", "files": ["depth.exr", "cut.exr"], "labels": {"class": "sky"}}
    missing, broken = faults_of(changed({"/light/sky": sky}), tmp_path)
    assert "expected the channels R, G and B, found Z" in missing.message
    assert "not a readable OpenEXR file" in broken.message


def test_a_cfg_is_read_in_any_layout(tmp_path):
    file = tmp_path / "flat.json"
    file.write_bytes(b"\xef\xbb\xbf" + json.dumps(minimal()).encode())
    assert load(file).digest == load_cfg(minimal(), tmp_path).digest
