"""A cfg's imaging: what is drawn, what stands in the stage, what is rendered, what is refused."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image
from pxr import Sdf, Usd, UsdGeom

from scenec.backends.run.render import render
from scenec.backends.stage.cameras import read_imaging
from scenec.compiler.cameras.imaging import ImagingPlan
from scenec.compiler.cameras.plan import RigPlan
from scenec.compiler.cameras.rigs import expose
from scenec.compiler.cameras.sensor import SensorPlan
from scenec.compiler.cameras.tracks import TrackPlan
from scenec.compiler.cfg.load import load
from scenec.compiler.compile import compile_cfg
from scenec.compiler.distributions.streams import Streams
from scenec.compiler.emit.cameras import write_imaging
from scenec.compiler.kinds.context import Context
from scenec.compiler.kinds.draw import draw_object
from scenec.compiler.scene.rig import Rig, Sensor
from scenec.schemas import imaging as formulas
from scenec.schemas.errors import CfgError, SceneError, StageError
from scenec.schemas.frames import beside_path, read_frame
from scenec.schemas.imaging import Imaging
from scenec.schemas.picture import develop
from scenec.testing import small

PATH = "rigs/rover/sensors/front/imaging"


def cfg(imaging: Any, **sensor: Any) -> dict[str, Any]:
    made = small.small_cfg()
    front = made["rigs"]["rover"]["sensors"]["front"]
    front |= sensor
    if imaging is not None:
        front["imaging"] = imaging
    return made


def loaded(folder: Path, imaging: Any) -> Any:
    """``imaging`` as it is filled in."""
    spec = load(small.write_cfg(folder, cfg(imaging)))
    return spec.cfg["rigs"]["rover"]["sensors"]["front"].get("imaging")


def drawn(folder: Path, imaging: Any, seed: int = 1, batch: int = 0) -> ImagingPlan:
    return drawn_at(PATH, loaded(folder, imaging), Streams(seed, batch))


def drawn_at(path: str, filled: Any, streams: Streams) -> ImagingPlan:
    context = Context(streams, samples=3, path=path)
    made: ImagingPlan = draw_object("imaging", filled, path, context).draw(context)
    return made


def exposed(plan: ImagingPlan, ev: list[float]) -> Sensor:
    """The sensor of a rig whose exposures are these."""
    eye = np.eye(4)
    intrinsics = (10.0, 10.0, 4.0, 3.0, 0.0)
    sensor = Sensor("front", (8, 6), intrinsics, eye, np.array(ev), ("rgb",))
    drawn_sensor = SensorPlan(sensor, True, plan)
    rig_plan = RigPlan("rover", TrackPlan(eye[None], np.zeros(1)), (drawn_sensor,))
    rigs = expose((Rig("rover", eye[None], (sensor,)),), (rig_plan,))
    return rigs[0].sensors[0]


def test_an_empty_imaging_is_a_camera_with_all_its_noise(tmp_path: Path) -> None:
    plan = drawn(tmp_path, {})
    one = plan.samples[0]
    assert plan.metered
    assert one.shot_noise
    assert min(one.read_noise_e, one.dark_current_e_s, one.prnu, one.dsnu_e, one.hot, one.dead) > 0
    assert (one.mosaic, one.demosaic, one.bits) == ("rggb", "malvar", 12)
    assert (one.bloom, one.jpeg_quality, one.vignetting_power, one.clean) == (0.0, 0, 0, False)
    # Its lowest speed is one that its pixels can hold.
    assert formulas.base_iso(one) < one.iso_range[0]


def test_patterns_belong_to_the_sensor_and_noise_to_the_batch(tmp_path: Path) -> None:
    first, again, other = (drawn(tmp_path, {}, batch=batch).samples[0] for batch in (0, 0, 1))
    assert first == again
    assert first.pattern_seed == other.pattern_seed
    assert first.noise_seed != other.noise_seed
    seeded = drawn(tmp_path, {}, seed=2).samples[0]
    assert seeded.pattern_seed != first.pattern_seed
    filled = loaded(tmp_path, {})
    elsewhere = drawn_at(PATH.replace("front", "left"), filled, Streams(1, 0))
    assert elsewhere.samples[0].pattern_seed != first.pattern_seed


def test_numbers_can_be_drawn_for_each_sample(tmp_path: Path) -> None:
    spread = {"type": "log_uniform", "min": 0.001, "max": 0.1}
    made = drawn(
        tmp_path,
        {
            "exposure": {"type": "manual", "time_s": spread, "iso": 400},
            "read_noise_e": {"type": "uniform", "min": 1, "max": 5},
        },
    )
    times = [one.time_s for one in made.samples]
    assert len(set(times)) == 3
    assert len({one.read_noise_e for one in made.samples}) == 1


def test_dark_current_doubles_with_temperature(tmp_path: Path) -> None:
    dark = {"rate_e_s": 3, "reference_c": 20, "doubling_c": 6, "temperature_c": 38}
    one = drawn(tmp_path, {"dark_current": dark, "defects": {"hot_rate_e_s": 10}}).samples[0]
    assert one.dark_current_e_s == pytest.approx(24.0)
    assert one.hot_rate_e_s == pytest.approx(80.0)
    hot = {"temperature_c": 1000, "doubling_c": 0.1}
    assert np.isfinite(drawn(tmp_path, {"dark_current": hot}).samples[0].dark_current_e_s)


def test_a_gain_stands_for_the_speed_that_has_it(tmp_path: Path) -> None:
    for gain in (0.01, 2.0, 1000.0):
        manual = {"type": "manual", "time_s": 0.01, "gain_e": gain}
        one = drawn(tmp_path, {"exposure": manual}).samples[0]
        assert formulas.electrons_per_number(one, one.iso) == pytest.approx(gain)


def test_metered_exposures_show_what_the_meter_says_within_their_limits(tmp_path: Path) -> None:
    plan = drawn(tmp_path, {"f_number": 4})
    sensor = exposed(plan, [-7.0, 2.0, 40.0])
    assert sensor.imaging is not None
    assert sensor.exposure_ev[:2] == pytest.approx([-7.0, 2.0], abs=1e-12)
    assert sensor.exposure_ev[2] < 40.0
    times = [one.time_s for one in sensor.imaging]
    speeds = [one.iso for one in sensor.imaging]
    assert times[0] < times[1] == times[2] == 0.03
    assert speeds[0] == 200.0 < speeds[1] < speeds[2] == 6400.0


def test_manual_and_automatic_exposures_have_no_meter(tmp_path: Path) -> None:
    manual = {"exposure": {"type": "manual", "time_s": 0.01, "iso": 400}, "f_number": 8}
    sensor = exposed(drawn(tmp_path, manual), [3.0, 4.0, 5.0])
    shown = np.log2(formulas.shown_per_value(8.0, 0.01, 400.0, 2.0))
    assert sensor.exposure_ev == pytest.approx([shown] * 3, abs=1e-12)
    auto = drawn(tmp_path, {"exposure": {"type": "auto"}})
    sensor = exposed(auto, [3.0, 4.0, 5.0])
    assert sensor.exposure_ev.tolist() == [3.0, 4.0, 5.0]
    assert sensor.imaging == auto.samples


def test_the_stage_gives_back_what_it_was_given(tmp_path: Path) -> None:
    stage = Usd.Stage.CreateInMemory()
    first = replace(
        drawn(tmp_path, {"jpeg": {}, "bloom": {}, "vignetting": {}, "raw": True}).samples[0],
        time_s=0.01,
        iso=400.0,
        time_range_s=(0.0, 0.0),
        iso_range=(0.0, 0.0),
        pattern_seed=2**64 - 1,
        color_matrix=(0.8, 0.2, 0.0, 0.1, 0.9, 0.0, 0.0, 0.3, 0.7),
    )
    second = replace(first, time_s=0.02, f_number=5.6, white_balance=(1.0, 1.0, 2.0))
    prim = UsdGeom.Camera.Define(stage, "/cam").GetPrim()
    write_imaging(prim, [first, second])
    assert read_imaging(prim, Usd.TimeCode(0)) == first
    assert read_imaging(prim, Usd.TimeCode(1)) == second
    assert read_imaging(prim, Usd.TimeCode.Default()) == first
    usual = UsdGeom.Camera.Define(stage, "/usual").GetPrim()
    write_imaging(usual, [Imaging(time_s=1.0, iso=100.0)])
    authored = {a.GetName() for a in usual.GetAuthoredAttributes()}
    assert authored == {f"scenec:imaging:{name}" for name in ("rule", "timeS", "iso")}
    assert read_imaging(UsdGeom.Camera.Define(stage, "/none").GetPrim(), Usd.TimeCode(0)) is None


@pytest.mark.parametrize(
    ("field", "kind", "value", "message"),
    [
        ("mosaic", "Token", "rgbw", "rggb or bggr"),
        ("bits", "Int", 40, "2 to 16"),
        ("black_level", "Int", 4095, "less than the largest"),
        ("full_well_e", "Double", 0.0, "above 0"),
        ("read_noise_e", "Double", float("nan"), "expected a finite number"),
        ("time_s", "Double", 0.0, "above 0"),
        ("color_matrix", "DoubleArray", [1.0, 2.0], "9 numbers"),
        ("color_matrix", "DoubleArray", [1.0] * 9, "inverted"),
        ("quantum_efficiency", "DoubleArray", [1.0, 0.0, 1.0], "above 0"),
        ("f_number", "String", "2.0", "expected a finite number"),
        ("rule", "Token", "spot", "fixed or auto"),
    ],
)
def test_a_foreign_stages_impossible_sensor_is_one_clear_error(
    field: str, kind: str, value: Any, message: str
) -> None:
    stage = Usd.Stage.CreateInMemory()
    prim = UsdGeom.Camera.Define(stage, "/cam").GetPrim()
    write_imaging(prim, [Imaging(time_s=1.0, iso=100.0)])
    name = formulas.attribute(field)
    prim.RemoveProperty(name)
    prim.CreateAttribute(name, getattr(Sdf.ValueTypeNames, kind), custom=True).Set(value)
    with pytest.raises(StageError, match=re.escape(message)) as error:
        read_imaging(prim, Usd.TimeCode(0))
    assert name in str(error.value)


MANUAL = {"type": "manual", "time_s": 1}
FIXED = {"exposure": {"type": "fixed", "ev": 0}}
LIMITED = {"type": "metered", "time_range_s": [1, 0.5]}
SINGULAR, ZERO = [[1, 0, 0], [1, 0, 0], [0, 0, 1]], [[1, -1, 0], [0, 1, 0], [0, 0, 1]]


@pytest.mark.parametrize(
    ("imaging", "sensor", "place", "message"),
    [
        ({"exposure": MANUAL}, {}, "imaging/exposure", "iso or the key"),
        ({"exposure": MANUAL | {"iso": 1, "gain_e": 1}}, {}, "imaging/exposure", "iso or the key"),
        ({"exposure": {"type": "auto"}}, FIXED, "front/exposure", "nothing reads it"),
        ({"exposure": LIMITED}, {}, "time_range_s", "the smaller one first"),
        ({"bits": 8, "black_level": 255}, {}, "black_level", "less than 255"),
        ({"raw": True, "mosaic": "none"}, {}, "raw", "there is none"),
        ({"raw": True}, {"resolution": [1, 9]}, "raw", "there is none"),
        ({"jpeg": {}}, {"resolution": [65501, 1]}, "imaging/jpeg", "at most 65500"),
        ({"color_matrix": SINGULAR}, {}, "color_matrix", "cannot be inverted"),
        ({"color_matrix": ZERO}, {}, "color_matrix/0", "adds up to 0"),
    ],
)
def test_what_does_not_go_together_is_said(
    tmp_path: Path, imaging: Any, sensor: Any, place: str, message: str
) -> None:
    with pytest.raises(CfgError) as error:
        load(small.write_cfg(tmp_path, cfg(imaging, **sensor)))
    assert place in str(error.value)
    assert message in str(error.value)


def test_drawn_numbers_that_do_not_go_together_are_said_when_they_are_drawn(tmp_path: Path) -> None:
    row = [{"type": "uniform", "min": 0.5, "max": 0.5000001}] * 3
    with pytest.raises(SceneError, match="colorMatrix"):
        drawn(tmp_path, {"color_matrix": [row, row, row]})


@pytest.mark.slow
def test_pictures_are_the_sensors_rgb_is_the_scenes_and_nothing_else_moves(tmp_path: Path) -> None:
    plain, real = cfg(None), cfg({"clean": True, "raw": True, "jpeg": {}})
    for one in (plain, real):
        one["samples"] = 2
        one["rigs"]["rover"]["sensors"]["front"]["resolution"] = [48, 32]
    folders = []
    for name, one in (("plain", plain), ("real", real)):
        path = small.write_cfg(tmp_path, one, f"{name}.json")
        compile_cfg(path, seed=1, out=tmp_path / name)
        folders.append(tmp_path / name / "batch_0000")
    for file in sorted(folders[0].rglob("*.usd*")):
        other = folders[1] / file.relative_to(folders[0])
        assert (file.read_bytes() == other.read_bytes()) == (file.name != "cameras.usdc"), file
    reports = [render(folder.parent, "mitsuba", spp=4) for folder in folders]
    for sample in range(2):
        before, after = (read_frame(report.frames[sample]) for report in reports)
        for name, array in before.passes.items():
            assert array.tobytes() == after.passes[name].tobytes(), name
        stem = after.path.with_suffix("")
        shown = np.asarray(Image.open(stem.with_suffix(".png")))
        clean = np.asarray(Image.open(beside_path(stem, "clean")))
        raw = np.asarray(Image.open(beside_path(stem, "raw")))
        assert raw.shape == (32, 48)
        assert raw.dtype == np.uint16
        # The meter says the same, so the clean picture shows what one without a sensor does.
        expected = develop(before.passes["rgb"], before.sidecar.exposure_ev)
        assert after.sidecar.exposure_ev == pytest.approx(before.sidecar.exposure_ev)
        assert np.abs(clean.astype(int) - expected).max() <= 4
        assert (shown != clean).mean() > 0.3
        facts = after.sidecar.imaging
        assert facts.stages[-1] == "jpeg"
        assert facts.exposure_time_s > 0.0
        assert before.sidecar.imaging is None
    # A picture that is gone is made again, the same; nothing else is.
    stem = reports[1].frames[0].with_suffix("")
    files = {kind: beside_path(stem, kind).read_bytes() for kind in ("clean", "raw")}
    picture = stem.with_suffix(".png").read_bytes()
    beside_path(stem, "raw").unlink()
    again = render(folders[1].parent, "mitsuba", spp=4)
    assert again.rendered == 1
    assert stem.with_suffix(".png").read_bytes() == picture
    assert {kind: beside_path(stem, kind).read_bytes() for kind in files} == files
