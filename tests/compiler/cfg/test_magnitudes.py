"""Numbers that can be, and leave nothing to see, are warned of with what is usual."""

from __future__ import annotations

import pytest
from small_cfg import DELETE, changed, load_cfg

_SENSOR = "/rigs/rover/sensors/front"
_HEIGHT = "/rigs/rover/pose/position/height_m"
_LIDAR = {"beams": 4, "azimuths": 8}


def _horizon(low_m: float, softness_m: float, **more: object) -> dict[str, object]:
    point = {"type": "point", "x_m": 0, "y_m": 0, "min_m": low_m, "softness_m": softness_m}
    hills = {"type": "multifractal", "amplitude_m": 100, "scale_m": 500, "mask": [point | more]}
    land = {"reach_m": 2000, "relief": [{"type": "plane"}, hills], "material": "sand"}
    return {"/terrain/horizon": land}


def _intrinsics(focal_px: float) -> dict[str, object]:
    return {
        f"{_SENSOR}/fov_deg": DELETE,
        f"{_SENSOR}/intrinsics": {"fx": focal_px, "fy": focal_px, "cx": 32, "cy": 24},
    }


def _exposed(irradiance: object, time_s: object) -> dict[str, object]:
    exposure = {"type": "manual", "time_s": time_s, "iso": 100}
    return {
        "/light/sun": {"elevation_deg": 40, "irradiance": irradiance},
        f"{_SENSOR}/imaging": {"exposure": exposure},
    }


def _scattered(key: str, number: float, size_m: object = 0.3) -> dict[str, object]:
    return {
        "/objects/rocks/count": DELETE,
        f"/objects/rocks/{key}": number,
        "/objects/rocks/size_m": size_m,
    }


@pytest.mark.parametrize(
    ("changes", "pointer", "message"),
    [
        # smoothstep((10 - 100) / 400 + 1/2) = 3 t² - 2 t³ of t = 0.275.
        (
            _horizon(100, 400),
            "/terrain/horizon/relief/1/mask/0/min_m",
            "100 m: 19 % of this relief stands at the terrain's border already; it begins there "
            "with min_m 210 (half",
        ),
        (_scattered("count", 10, 100), "/objects/rocks/size_m", "100 m, on ground 20 m by 10 m"),
        (
            _scattered("count", 1, {"type": "uniform", "min": 1, "max": 300}),
            "/objects/rocks/size_m",
            "less than a tenth of it; did you mean 0.3?",
        ),
        (_scattered("per_m2", 1e-4), "/objects/rocks/per_m2", "0.0001 on 200 m²: none, mostly"),
        (_scattered("per_m2", 1e6, 0.001), "/objects/rocks/per_m2", "2e+08 instances on 200 m²"),
        # 10^6 discs of pi / 400 m² on 200 m².
        (_scattered("count", 1_000_000, 0.1), "/objects/rocks/count", "which cover it 39 times"),
        ({_HEIGHT: 1500}, _HEIGHT, "which spans 0.76° of a view of 60°"),
        (
            {"/rigs/rover/lidars/top": _LIDAR | {"range_m": [0.5, 120_000]}},
            "/rigs/rover/lidars/top/range_m/1",
            "the scene ends after 22.36 m",
        ),
        (
            {"/rigs/rover/lidars/top": _LIDAR | {"range_m": [500, 1000]}},
            "/rigs/rover/lidars/top/range_m/0",
            "500 m, beyond all of the scene, 22.36 m across; did you mean 0.5?",
        ),
        (
            {_HEIGHT: 15, "/rigs/rover/lidars/top": _LIDAR | {"range_m": [0.5, 10]}},
            "/rigs/rover/lidars/top/range_m/1",
            "10 m, and the ground is 15 m below at least",
        ),
        # 2 atan(32 / 3).
        (_intrinsics(3), f"{_SENSOR}/intrinsics/fx", "3 px over 64 px see 169°"),
        (_intrinsics(35_000), f"{_SENSOR}/intrinsics/fx", "35000 px over 64 px see 0.105°"),
        (
            {f"{_SENSOR}/focus": {"distance_m": 3, "f_number": 4, "focal_length_mm": 0.035}},
            f"{_SENSOR}/focus/focal_length_mm",
            "0.035 mm: usual is 1 to 3000 mm; did you mean 35?",
        ),
        (
            {f"{_SENSOR}/mount": {"position_m": [0, 120, 0]}},
            f"{_SENSOR}/mount/position_m/1",
            "120 m off the rig: usual is less than a meter; did you mean 0.12?",
        ),
        ({"/light/haze": {"visibility_m": 4}}, "/light/haze/visibility_m", "did you mean 4000?"),
        # 1000 W/m² on white: a radiance of 1000 / pi.
        (
            {f"{_SENSOR}/exposure": {"type": "fixed", "ev": 13}},
            f"{_SENSOR}/exposure/ev",
            "13 EV shows what the sun lights as white: usual is about -8.3",
        ),
        (
            {f"{_SENSOR}/imaging": {"exposure": {"type": "manual", "time_s": 1e-8, "iso": 100}}},
            f"{_SENSOR}/imaging/exposure/time_s",
            "as black: usual is about 0.00064",
        ),
        (
            {"/materials/sand/maps": {"procedural": {"type": "sand", "grain_m": 1.5}}},
            "/materials/sand/maps/procedural/grain_m",
            "drawn as a quarter of that at most; did you mean 0.0015?",
        ),
        (
            {"/light/sun": {"elevation_deg": {"type": "uniform", "min": -20, "max": -8}}},
            "/light/sun/elevation_deg",
            "-8° is below the horizon: no sunlight falls on the scene",
        ),
        (
            {
                "/light/sun": {"elevation_deg": -8},
                "/light/sky": {"type": "none", "labels": {"class": "sky"}},
            },
            "/light/sun/elevation_deg",
            "nothing lights the scene",
        ),
    ],
)
def test_a_magnitude_that_leaves_nothing_to_see_is_a_warning(tmp_path, changes, pointer, message):
    warnings = {one.pointer: one for one in load_cfg(changed(changes), tmp_path).warnings}
    assert message in warnings[pointer].message
    assert warnings[pointer].line > 1


@pytest.mark.parametrize(
    "changes",
    [
        {},
        _horizon(210, 400),
        # What is added to the distance, or where the point is, may be meant.
        _horizon(100, 400, ragged={"amplitude": 60, "scale_m": 300}),
        _horizon(100, 400, x_m=1500),
        _scattered("count", 0),
        _scattered("count", 10, {"type": "log_normal", "median": 0.2, "sigma": 0.5}),
        {_HEIGHT: 60},
        {_HEIGHT: {"type": "uniform", "min": 2, "max": 1500}},
        {"/rigs/rover/lidars/top": _LIDAR},
        _intrinsics(60),
        {f"{_SENSOR}/exposure": {"type": "fixed", "ev": -8}},
        {f"{_SENSOR}/exposure": {"type": "fixed", "ev": 13}, "/light/sun": {"elevation_deg": 1}},
        {"/light/sun": {"elevation_deg": {"type": "uniform", "min": -9, "max": 9}}},
        {"/light/sun": None},
        # Laws without ends say nothing.
        _exposed({"type": "log_normal", "median": 900, "sigma": 1}, 0.01),
        _exposed({"type": "normal", "mean": 900, "std": 1}, 0.01),
        _exposed(900, {"type": "normal", "mean": 0.01, "std": 1}),
    ],
)
def test_what_may_be_meant_is_taken_as_it_is(tmp_path, changes):
    assert load_cfg(changed(changes), tmp_path).warnings == ()
