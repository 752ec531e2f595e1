"""What a cfg's exposure becomes in the stage, and what every frame of a batch is shown with."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from pxr import Usd, UsdGeom

from scenec.backends.run.render import render
from scenec.backends.stage.read import read_stage
from scenec.compiler.compile import compile_cfg
from scenec.testing.small import small_cfg, write_cfg

pytestmark = pytest.mark.usefixtures("workers_here")


def compiled(folder: Path, **sensor: Any) -> Path:
    cfg = small_cfg()
    cfg["objects"]["rocks"]["count"] = 20
    cfg["rigs"]["rover"]["sensors"]["front"] |= sensor
    compile_cfg(write_cfg(folder, cfg), seed=3, out=folder / "out", replace=True)
    return folder / "out"


def stage_of(out: Path) -> Path:
    return out / "batch_0000/stage.usda"


def cameras(out: Path):
    return [of_sample[0] for of_sample in read_stage(stage_of(out)).cameras]


@pytest.mark.parametrize(
    ("sensor", "per"),
    [
        ({}, "batch"),
        ({"exposure": {"type": "auto"}}, "batch"),
        ({"exposure": {"type": "auto", "per": "sample"}}, "sample"),
        ({"exposure": {"type": "incident"}}, None),
        ({"exposure": {"type": "fixed", "ev": -8.5}}, None),
        # A time and a speed are an exposure of their own.
        ({"imaging": {"exposure": {"type": "manual", "time_s": 0.01, "iso": 100}}}, None),
        ({"imaging": {"exposure": {"type": "auto"}}}, None),
    ],
)
def test_an_exposure_is_found_where_the_cfg_gives_none(
    tmp_path: Path, sensor: dict[str, Any], per: str | None
) -> None:
    found = cameras(compiled(tmp_path, **sensor))
    assert {camera.exposure_per for camera in found} == {per}
    if "exposure" in sensor and sensor["exposure"]["type"] == "fixed":
        assert {camera.exposure_ev for camera in found} == {-8.5}


def test_viewers_get_the_incident_meter_s_exposure(tmp_path: Path) -> None:
    """They find none themselves, and shown as it is sunlight is white."""
    (tmp_path / "auto").mkdir()
    (tmp_path / "incident").mkdir()
    outs = [
        compiled(tmp_path / "auto"),
        compiled(tmp_path / "incident", exposure={"type": "incident"}),
    ]
    auto, incident = (
        [
            UsdGeom.Camera.Get(stage, "/World/Rigs/rover/front").GetExposureAttr().Get(i)
            for i in range(3)
        ]
        for stage in (Usd.Stage.Open(str(stage_of(out))) for out in outs)
    )
    assert auto == incident
    assert max(auto) < -5.0


def test_a_metered_sensor_waits_for_the_exposure_and_follows_it(tmp_path: Path) -> None:
    imaging = {"shot_noise": False, "read_noise_e": 0, "mosaic": "none"}
    out = compiled(tmp_path, imaging=imaging, outputs=["rgb"])
    assert {camera.imaging.rule for camera in cameras(out)} == {"metered"}
    report = render(out, "mitsuba", spp=2, samples=[0])
    sidecar = json.loads(report.frames[0].with_suffix(".json").read_bytes())
    assert sidecar["exposure"]["rule"] == "auto"
    # Within the limits of its time, what it shows of a value of 1 is what the exposure says.
    plain = compiled(tmp_path, outputs=["rgb"])
    report = render(plain, "mitsuba", spp=2, samples=[0])
    without = json.loads(report.frames[0].with_suffix(".json").read_bytes())
    assert sidecar["exposure_ev"] == pytest.approx(without["exposure_ev"], abs=1e-6)


def test_all_frames_have_one_value_whatever_is_rendered_first(tmp_path: Path) -> None:
    out = compiled(tmp_path, outputs=["rgb"])
    late = render(out, "mitsuba", spp=2, samples=[2])
    rest = render(out, "mitsuba", spp=2)
    other = render(out, "pyrender", spp=2, samples=[1])
    assert rest.skipped == 1
    frames = [*late.frames, *rest.frames, *other.frames]
    values = {json.loads(f.with_suffix(".json").read_bytes())["exposure_ev"] for f in frames}
    assert len(values) == 1
