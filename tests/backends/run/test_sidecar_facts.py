"""What sidecars say of sun, haze and height is what the cfg asked for."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from scenec.backends.run.facts import sun_record
from scenec.backends.run.render import render
from scenec.backends.stage.scene import Lighting, Sun
from scenec.compiler.compile import compile_cfg
from scenec.schemas.frames import CONVENTIONS
from scenec.testing.small import small_cfg, write_cfg

pytestmark = pytest.mark.usefixtures("workers_here")


def sun(x: float, y: float, z: float, irradiance: tuple[float, float, float]) -> Sun:
    return Sun(np.array([x, y, z]), np.array(irradiance), 0.0)


def test_the_brightest_sun_is_the_one_stated() -> None:
    blue, green = sun(0, 0, 1, (0, 0, 5)), sun(0.6, 0, 0.8, (0, 1, 0))
    found = sun_record(Lighting((blue, green), ()))
    assert found is not None
    assert found.irradiance == (0, 1, 0)
    assert found.azimuth_deg == pytest.approx(90.0)
    assert found.elevation_deg == pytest.approx(np.degrees(np.arcsin(0.8)))
    assert sun_record(Lighting((), ())) is None


@pytest.mark.parametrize(
    ("to_light", "azimuth"), [((0, 1, 0), 0.0), ((1, 0, 0), 90.0), ((0, -1, 0), 180.0),
                              ((-1, 0, 0), 270.0)],
)  # fmt: skip
def test_bearings_are_clockwise_from_north(to_light, azimuth: float) -> None:
    found = sun_record(Lighting((sun(*to_light, (1, 1, 1)),), ()))
    assert found is not None
    assert found.azimuth_deg == pytest.approx(azimuth)


def test_a_frame_states_the_cfg_s_sun_and_the_camera_s_height(tmp_path: Path) -> None:
    cfg = small_cfg(samples=2)
    cfg["objects"]["rocks"] |= {"count": 1, "size_m": 0.05}
    cfg["light"]["sun"] = {"elevation_deg": 33, "azimuth_deg": 210, "irradiance": 1000}
    cfg["light"]["haze"] = {"visibility_m": {"type": "choice", "values": [700]}}
    compile_cfg(write_cfg(tmp_path, cfg), seed=2, out=tmp_path / "out")
    report = render(tmp_path / "out", "reference", passes=("depth",))
    for path in report.frames:
        sidecar = json.loads(path.with_suffix(".json").read_text(encoding="utf-8"))
        assert sidecar["sun"]["elevation_deg"] == pytest.approx(33, abs=1e-4)
        assert sidecar["sun"]["azimuth_deg"] == pytest.approx(210, abs=1e-4)
        assert sidecar["visibility_m"] == pytest.approx(700, rel=1e-6)
        # 1.5 m over the ground as defined; the mesh is off by its stated error.
        assert sidecar["height_above_surface_m"] == pytest.approx(1.5, abs=0.02)
        assert {"sun", "visibility_m", "height_above_surface_m"} <= set(sidecar["conventions"])
    assert "clockwise" in CONVENTIONS["sun"]
