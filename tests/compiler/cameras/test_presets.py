"""Presets: each is a sound sensor, its own keys go before, and depths err as published."""

from __future__ import annotations

import copy
import json
from dataclasses import replace
from math import radians, tan

import numpy as np
import pytest
from tools import declarations

from scenec.backends.annotation.depth_camera import measure_stereo, measure_time_of_flight
from scenec.backends.stage.read import read_stage
from scenec.backends.stage.scene import Camera
from scenec.cli.main import main
from scenec.compiler.cfg.load import load
from scenec.compiler.compile import compile_cfg
from scenec.schemas.depth_camera import (
    StereoDepth,
    TimeOfFlightDepth,
    as_numbers,
    kind_of,
    of_numbers,
)
from scenec.schemas.errors import CfgError
from scenec.schemas.presets import PRESETS, SOURCES, table, with_presets
from scenec.testing.small import small_cfg

#: Deviation over the square of the depth, 1/m, and the share that is answered.
LAWS = {
    "realsense_d435": (0.1 / (424.0 * 0.05), 0.99, (0.5, 1.0, 2.0, 4.0)),
    "zed_2": (0.01 * 3.0 / 9.0, 1.0, (1.0, 3.0, 7.0, 15.0)),
    "azure_kinect": (0.017 / 3.5**2, 1.0, (0.8, 1.5, 2.5, 3.5)),
}


def with_sensor(sensor: dict) -> dict:
    cfg = small_cfg()
    rig = next(iter(cfg["rigs"].values()))
    rig["sensors"] = {"one": sensor}
    return cfg


def loaded(folder, sensor: dict) -> dict:
    (folder / "cfg.json").write_text(json.dumps(with_sensor(sensor)))
    rigs = load(folder / "cfg.json").cfg["rigs"]
    found: dict = next(iter(rigs.values()))["sensors"]["one"]
    return found


def asked(name: str) -> dict:
    keys = PRESETS[name].keys
    outputs = ["depth", *(["depth_measured"] if "depth_camera" in keys else [])]
    return {"preset": name, "outputs": outputs} | ({} if "fov_deg" in keys else {"fov_deg": 50})


@pytest.mark.parametrize("name", PRESETS)
def test_each_is_a_sound_sensor_and_cites_its_sources(tmp_path, name):
    sensor, preset = loaded(tmp_path, asked(name)), PRESETS[name]
    assert list(sensor["resolution"]) == preset.keys["resolution"]
    for key, value in preset.keys.get("imaging", {}).items():
        assert sensor["imaging"][key] == value
    assert sensor["preset"] == name
    assert preset.sources
    assert set(preset.sources) <= SOURCES.keys()


def test_every_source_is_cited_and_the_page_has_the_table():
    assert {source for preset in PRESETS.values() for source in preset.sources} == SOURCES.keys()
    page = declarations.PRESETS.read_text(encoding="utf-8")
    assert page == declarations.with_presets(page)
    assert table() in page


@pytest.mark.parametrize(
    ("own", "where", "value"),
    [
        ({"resolution": [64, 48]}, ("resolution",), [64, 48]),
        ({"imaging": {"read_noise_e": 9}}, ("imaging", "read_noise_e"), 9),
        ({"imaging": {"read_noise_e": 9}}, ("imaging", "full_well_e"), 21_826),
        ({"imaging": None}, ("imaging",), None),
        ({"lens": {"type": "brown_conrady", "k1": 0.1}}, ("lens", "k1"), 0.1),
        ({"intrinsics": {"fx": 9, "fy": 9, "cx": 1, "cy": 1}}, ("fov_deg",), None),
    ],
)
def test_what_stands_beside_it_goes_before_key_by_key(tmp_path, own, where, value):
    found = loaded(tmp_path, {"preset": "mastcam_z_wide", "outputs": ["rgb"], **own})
    for key in where[:-1]:
        found = found[key]
    found = found.get(where[-1])
    assert (list(found) if isinstance(found, tuple) else found) == value


def test_a_lens_of_another_type_takes_the_place_of_the_presets():
    cfg = with_sensor({"preset": "m2020_navcam", "lens": {"type": "brown_conrady", "k1": 0.1}})
    before = copy.deepcopy(cfg)
    sensor = next(iter(with_presets(cfg)["rigs"].values()))["sensors"]["one"]
    assert sensor["lens"] == {"type": "brown_conrady", "k1": 0.1}
    assert cfg == before


@pytest.mark.parametrize(
    ("sensor", "message"),
    [
        ({"preset": "zed2"}, 'did you mean "zed_2"'),
        ({"preset": 3}, "expected one of"),
        ({"preset": ["zed_2"]}, "expected one of"),
        ({"fov_deg": 60}, 'the key "resolution" is missing'),
        ({"preset": "bfs_u3_51s5"}, "expected either the key fov_deg or the key intrinsics"),
        ({"preset": "zed_2", "outputs": ["rgb"]}, "depth_measured"),
        ({"preset": "zed_2", "fov_deg": 190, "outputs": ["depth_measured"]}, "less than 180"),
    ],
)
def test_what_cannot_be_is_a_fault_at_its_place(tmp_path, sensor, message):
    with pytest.raises(CfgError, match=message):
        loaded(tmp_path, sensor)


@pytest.mark.parametrize("odd", [None, 3, {"rigs": 3}, {"rigs": {"a": {"sensors": {"b": []}}}}])
def test_what_is_no_cfg_stays_as_it_is(odd):
    assert with_presets(odd) == odd


def compiled(folder, name: str) -> Camera:
    """The camera of a preset, as a stage has it."""
    cfg = with_sensor(asked(name))
    (folder / "cfg.json").write_text(json.dumps(cfg))
    compile_cfg(folder / "cfg.json", seed=3, out=folder / "out", batches=range(1))
    return read_stage(folder / "out" / "batch_0000" / "stage.usda").cameras[0][0]


def measured(one: Camera, model: StereoDepth | TimeOfFlightDepth, depth: float) -> np.ndarray:
    """What it says of a wall that faces it, at one depth for stereo, one range for the other."""
    flat = np.full((300, 400), depth)
    if isinstance(model, StereoDepth):
        return measure_stereo(model, one, flat, np.ones(flat.shape, bool), 7, 0)
    ones = np.ones(flat.shape)
    return measure_time_of_flight(model, flat, ones, ones, 7, 0)


@pytest.mark.parametrize("name", LAWS)
def test_depths_err_over_range_and_fill_as_published(tmp_path, name):
    one, (law, fill, depths) = compiled(tmp_path, name), LAWS[name]
    model = one.depth_camera.model
    biased = "bias_px" if isinstance(model, StereoDepth) else "bias_m"
    exact = replace(model, **{biased: 0.0})
    steps = {"step_px": 0.0} if isinstance(model, StereoDepth) else {"blur_px": 0.0}
    for depth in depths:
        made = measured(one, replace(exact, **steps), depth)
        there = made > 0
        # At the end of the range, noise leaves it.
        inside = abs(depth - exact.range_m[1]) > 5 * law * depth * depth
        n = there.size
        if inside:
            assert abs(there.mean() - fill) <= 5 * np.sqrt(fill * (1 - fill) / n)
        # Disparities are normal, depths to first order: held by quantiles, not by tails.
        low, high = np.quantile(made[there], [0.1587, 0.8413])
        assert 0.5 * (high - low) == pytest.approx(law * depth * depth, rel=0.03)
        if law * depth < 0.02:
            rms = np.sqrt(np.square(made[there] - depth).mean())
            assert rms == pytest.approx(law * depth * depth, rel=5 / np.sqrt(2 * n) + 0.005)
        # With its steps: those of width s add s² / 12 of variance, to first order.
        if isinstance(model, StereoDepth) and model.step_px and law * depth < 0.02:
            per_px = law / model.noise_px * depth * depth
            expected = np.hypot(law * depth * depth, per_px * model.step_px / np.sqrt(12))
            rms = np.sqrt(np.square(measured(one, exact, depth)[there] - depth).mean())
            assert rms == pytest.approx(expected, rel=0.03)


@pytest.mark.parametrize(
    ("name", "depth", "most"), [("realsense_d435", 2.0, 0.04), ("azure_kinect", 2.0, 0.011)]
)
def test_a_device_is_off_by_what_is_stated_at_most(tmp_path, name, depth, most):
    one = compiled(tmp_path, name)
    model = one.depth_camera.model
    bias = model.bias_px if isinstance(model, StereoDepth) else model.bias_m
    sharp = {"step_px": 0.0} if isinstance(model, StereoDepth) else {"blur_px": 0.0}
    made = measured(one, replace(model, **sharp), depth)
    off = np.median(made[made > 0]) - depth
    if isinstance(model, StereoDepth):
        expected = -bias * depth * depth / (one.intrinsics[0, 0] * model.baseline_m)
    else:
        expected = bias
    assert off == pytest.approx(expected, rel=0.02, abs=1e-4)
    assert 0.0 < abs(off) <= 1.02 * most


def test_stereo_says_nothing_near_steps_in_disparity(tmp_path):
    one = compiled(tmp_path, "realsense_d435")
    depth = np.where(np.arange(60) < 30, 1.0, 2.0)[None].repeat(40, 0)
    depth[:, 50:] = 2.05  # Less than a pixel of disparity.
    for edge, empty in (
        (0.0, range(0)),
        (0.9, range(0)),
        (1.0, range(29, 31)),
        (3.7, range(27, 33)),
    ):
        model = StereoDepth(0.05, 0.0, 0.0, (0.0, 99.0), edge_px=edge)
        made = measure_stereo(model, one, depth, np.ones(depth.shape, bool), 7, 0)
        np.testing.assert_array_equal(np.flatnonzero(made[20] == 0), list(empty))


@pytest.mark.parametrize(
    "model",
    [
        StereoDepth(0.1, 0.2, 0.0, (0.0, 9.0)),
        StereoDepth(0.1, 0.2, 0.0, (0.0, 0.0), bias_px=0.1),
        StereoDepth(0.1, 0.2, 0.0, (0.0, 9.0), lost=0.5),
        TimeOfFlightDepth(0.1, 1.0, 9.0, 0.0, (0.0, 9.0)),
        TimeOfFlightDepth(0.1, 1.0, 9.0, 0.0, (0.0, 0.0), bias_m=-1.0),
    ],
)
def test_a_stage_lists_no_more_numbers_than_a_model_has(model):
    numbers = as_numbers(model)
    assert of_numbers(kind_of(model), numbers) == model
    assert len(numbers) == 5 + isinstance(model, TimeOfFlightDepth) or numbers[-1] != 0.0


def test_zed_2_has_the_focal_length_that_its_noise_is_stated_for(tmp_path):
    focal = compiled(tmp_path, "zed_2").intrinsics[0, 0]
    assert focal == pytest.approx(960.0 / tan(radians(55.0)))
    assert PRESETS["zed_2"].keys["depth_camera"]["noise_px"] == pytest.approx(
        0.03 / 9.0 * focal * 0.12, rel=1e-3
    )


def test_the_command_line_lists_all_presets_and_says_where_one_is_from(capsys):
    assert main(["assets", "--cameras", "--json"]) == 0
    assert [one["preset"] for one in json.loads(capsys.readouterr().out)] == list(PRESETS)
    for name, preset in PRESETS.items():
        assert main(["assets", name]) == 0
        shown = capsys.readouterr().out
        assert preset.title in shown
        assert all(SOURCES[source] in shown for source in preset.sources)
