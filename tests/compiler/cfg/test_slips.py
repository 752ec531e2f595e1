"""A slip is answered with the number that was meant."""

from __future__ import annotations

import math

import pytest
from small_cfg import DELETE, changed, faults_of, load_cfg

_SENSOR = "/rigs/rover/sensors/front"
_FOV = f"{_SENSOR}/fov_deg"
_COLOR = "/materials/sand/base_color"


@pytest.mark.parametrize(
    ("changes", "pointer", "message"),
    [
        (
            {"/objects/rocks/size_m": DELETE, "/objects/rocks/size_cm": 30},
            "/objects/rocks/size_cm",
            'unknown key "size_cm"; did you mean "size_m": 0.3?',
        ),
        (
            {
                "/objects/rocks/size_m": DELETE,
                "/objects/rocks/size_cm": {"type": "log_normal", "median": 20, "sigma": 0.5},
            },
            "/objects/rocks/size_cm",
            '"size_m": {"type": "log_normal", "median": 0.2, "sigma": 0.5}?',
        ),
        (
            {_FOV: DELETE, f"{_SENSOR}/fov_rad": 1.05},
            f"{_SENSOR}/fov_rad",
            'unknown key "fov_rad"; did you mean "fov_deg": 60.1606?',
        ),
        ({_FOV: DELETE, f"{_SENSOR}/fov": 60}, f"{_SENSOR}/fov", 'did you mean "fov_deg"?'),
        (
            {_FOV: DELETE, f"{_SENSOR}/fov": 1.5708},
            f"{_SENSOR}/fov",
            'did you mean "fov_deg": 90.0002?',
        ),
        (
            {_FOV: DELETE, f"{_SENSOR}/focal_mm": 18},
            f"{_SENSOR}/focal_mm",
            'did you mean "fov_deg": 90? (so wide it is on a sensor 36 mm wide',
        ),
        (
            {"/rigs/rover/pose/position": {"x_m": 0, "y_m": 0, "height_mm": 1500}},
            "/rigs/rover/pose/position/height_mm",
            'did you mean "height_m": 1.5?',
        ),
        ({"/terrain/size_ft": [30, 15]}, "/terrain/size_ft", '"size_m": [9.144, 4.572]?'),
        ({_COLOR: "#ff8000"}, _COLOR, "did you mean [1, 0.2159, 0]?"),
        ({_COLOR: "#fff"}, _COLOR, '"#fff": expected linear values from 0 to 1'),
        (
            {_COLOR: [255, 128, 0]},
            _COLOR,
            "did you mean [1, 0.2159, 0]? (as of sRGB; [1, 0.502, 0] if it is linear)",
        ),
        ({_COLOR: "red"}, _COLOR, '"red": expected a list'),
        ({f"{_COLOR}/0": 1.5}, f"{_COLOR}/0", "1.5: expected at most 1"),
    ],
)
def test_the_fault_has_the_key_and_the_number_that_were_meant(tmp_path, changes, pointer, message):
    faults = faults_of(changed(changes), tmp_path)
    (fault,) = [fault for fault in faults if fault.pointer == pointer]
    assert message in fault.message


def test_a_color_of_8_bits_is_one_fault(tmp_path):
    (fault,) = faults_of(changed({_COLOR: [200, 150, 99]}), tmp_path)
    linear = [((code / 255 + 0.055) / 1.055) ** 2.4 for code in (200, 150, 99)]
    assert str([round(value, 4) for value in linear]) in fault.message


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({_FOV: 1.05}, "1.05 degrees: looks like radians; 60.2 degrees?"),
        (
            {_FOV: {"type": "uniform", "min": 0.8, "max": 1.2}},
            "looks like radians; 45.8 to 68.8 degrees?",
        ),
        ({"/light/sun": {"elevation_deg": 0.785}}, "looks like radians; 45 degrees?"),
        ({"/light/sun": {"azimuth_deg": math.pi}}, "looks like radians; 180 degrees?"),
    ],
)
def test_an_angle_that_looks_like_radians_is_a_warning(tmp_path, changes, message):
    (warning,) = load_cfg(changed(changes), tmp_path).warnings
    assert message in warning.message
    assert warning.line > 1


def test_an_angle_that_can_only_be_radians_is_a_fault(tmp_path):
    thermal = {"type": "thermal", "angle_deg": 0.6}
    relief = [{"type": "plane"}, thermal]
    (fault,) = faults_of(changed({"/terrain/relief": relief}), tmp_path)
    assert fault.message == "0.6: expected at least 1 °; in radians? 34.4 degrees"


@pytest.mark.parametrize("angle", [0.5, 1, 2, 3, 0.53, 0.35, 5.0, 0.123, 12.5, 57.296])
def test_other_small_angles_are_taken_as_they_are(tmp_path, angle):
    assert load_cfg(changed({"/light/sun": {"elevation_deg": angle}}), tmp_path).warnings == ()
    if float(angle).is_integer() or angle > 4:
        assert load_cfg(changed({_FOV: angle}), tmp_path).warnings == ()
