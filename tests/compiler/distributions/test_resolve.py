"""When the numbers of a cfg are drawn, and from which stream."""

from __future__ import annotations

import copy

import numpy as np
from small_cfg import changed, load_cfg

from scenec.compiler.distributions.numbers import Distribution, draw_number
from scenec.compiler.distributions.resolve import resolve
from scenec.compiler.distributions.streams import Streams
from scenec.compiler.draw import draw

_UNIFORM = {"type": "uniform", "min": 10, "max": 20}
_STREAMS = Streams(1, 0)


def test_light_is_drawn_per_sample_and_per_batch_where_the_cfg_says_so(tmp_path):
    sun = {"elevation_deg": _UNIFORM, "azimuth_deg": {**_UNIFORM, "per": "batch"}}
    cfg = load_cfg(changed({"/light/sun": sun}), tmp_path).cfg["light"]["sun"]
    drawn = [resolve(cfg, _STREAMS, "light/sun", sample=i) for i in range(3)]
    assert len({d["elevation_deg"] for d in drawn}) == 3
    assert len({d["azimuth_deg"] for d in drawn}) == 1
    assert all(10 <= d[key] <= 20 for d in drawn for key in sun)
    without = resolve(cfg, _STREAMS, "light/sun")
    assert isinstance(without["elevation_deg"], Distribution)
    assert without["azimuth_deg"] == drawn[0]["azimuth_deg"]


def test_a_part_is_drawn_as_within_the_whole(tmp_path):
    changes = {"/terrain/relief/0/slope": [0, {"type": "normal", "mean": 0, "std": 1}]}
    cfg = load_cfg(changed(changes), tmp_path).cfg
    whole = resolve(cfg["terrain"], _STREAMS, "terrain")
    part = resolve(cfg["terrain"]["relief"][0]["slope"][1], _STREAMS, "terrain/relief/0/slope/1")
    assert whole["relief"][0]["slope"] == [0.0, part]


def test_instance_numbers_are_left_to_be_drawn_for_each(tmp_path):
    changes = {"/objects/rocks/size_m": _UNIFORM, "/objects/rocks/count": _UNIFORM}
    cfg = load_cfg(changed(changes), tmp_path).cfg["objects"]["rocks"]
    rocks = resolve(cfg, _STREAMS, "objects/rocks", sample=0)
    assert isinstance(rocks["count"], int)
    assert isinstance(rocks["size_m"], Distribution)
    sizes = draw_number(rocks["size_m"], _STREAMS, "objects/rocks/size_m", rocks["count"])
    assert np.unique(sizes).size == rocks["count"]


def test_all_instances_share_a_number_that_the_cfg_draws_once_a_batch(tmp_path):
    rocks = "/objects/rocks"
    once = {**_UNIFORM, "per": "batch"}
    small = {"type": "uniform", "min": 0.1, "max": 0.2, "per": "batch"}
    changes = {
        f"{rocks}/size_m": once, f"{rocks}/embed": small, f"{rocks}/orientation": "upright",
        f"{rocks}/lean_deg": once, f"{rocks}/fillet": {"height": small, "reach": small},
        "/terrain/relief": [
            {"type": "plane"},
            {"type": "craters", "min_diameter_m": 1, "max_diameter_m": 8, "rim_ratio": small},
        ],
    }  # fmt: skip
    plan = draw(load_cfg(changed(changes), tmp_path), 1, 0)
    own, craters = plan.objects[0], plan.terrain.relief[1]
    assert len(own.scale) > 1
    assert len(craters.rim_ratio) > 1
    for path, drawn in (
        ("size_m", own.scale), ("embed", own.embed), ("fillet/height", own.fillet.height),
        ("fillet/reach", own.fillet.reach),
    ):  # fmt: skip
        low, high = (10, 20) if path == "size_m" else (0.1, 0.2)
        u = _STREAMS.uniforms(f"objects/rocks/{path}", 1)[0]
        assert drawn.tolist() == [low + (high - low) * u] * len(drawn)
    # An axis that leans by t is at cos t to the vertical: 1 - 2 (x^2 + y^2) of its quaternion.
    x, y, _, _ = own.orientations.T
    assert np.ptp(x * x + y * y) < 1e-12
    assert np.unique(craters.rim_ratio).size == 1


def test_another_class_of_objects_changes_no_other_draw(tmp_path):
    rocks = {"count": _UNIFORM, "size_m": _UNIFORM, "flatness": {**_UNIFORM, "min": 0, "max": 0.9}}
    changes = {f"/objects/rocks/{key}": value for key, value in rocks.items()}
    cfg = changed({**changes, "/light/sun": {"elevation_deg": _UNIFORM}})
    one = load_cfg(cfg, tmp_path).cfg
    more = copy.deepcopy(cfg)
    more["objects"] = {"pebbles": cfg["objects"]["rocks"], **cfg["objects"]}
    two = load_cfg(more, tmp_path).cfg
    for path in ("terrain", "light", "objects/rocks", "rigs"):
        a, b = one, two
        for key in path.split("/"):
            a, b = a[key], b[key]
        assert resolve(a, _STREAMS, path, 2) == resolve(b, _STREAMS, path, 2)
    drawn = resolve(two["objects"], _STREAMS, "objects")
    assert drawn["pebbles"]["flatness"] != drawn["rocks"]["flatness"]


def test_resolving_leaves_the_cfg_as_it_is(tmp_path):
    spec = load_cfg(changed({"/light/sun": {"elevation_deg": _UNIFORM}}), tmp_path)
    before = copy.deepcopy(spec.cfg)
    resolve(spec.cfg["light"], _STREAMS, "light", 0)["sun"]["color"][0] = 9.0
    assert spec.cfg == before
