"""Each fault of further suns and lamps: where it is said to be, and what is said."""

from __future__ import annotations

from typing import Any

import pytest
from small_cfg import changed, faults_of

_RIG = {"type": "rig", "rig": "rover"}
_WORLD = {"type": "world", "x_m": 1, "y_m": 2}


def lamp(mount: dict[str, Any], **more: Any) -> dict[str, Any]:
    return {"mount": mount, "intensity": 10} | more


_FAULTS = [
    ({"/light/lamps": {"a": lamp({"type": "rig", "rig": "rovr"})}}, "a/mount/rig", '"rover"?'),
    ({"/light/lamps": {"a": lamp({"type": "rig"})}}, "a/mount", '"rig" is missing'),
    ({"/light/lamps": {"a": {"mount": _RIG}}}, "a", '"intensity" is missing'),
    ({"/light/lamps": {"a": {"intensity": 1}}}, "a", '"mount" is missing'),
    ({"/light/lamps": {"1a": lamp(_RIG)}}, "1a", "letters, digits and underscores"),
    ({"/light/lamps": {"Sun": lamp(_RIG)}}, "Sun", "the name of the sun"),
    ({"/light/lamps": {"Dome": lamp(_WORLD)}}, "Dome", "the name of the sky"),
    (
        {"/light/lamps": {"x": lamp(_RIG)}, "/light/more": {"x": {"type": "sun"}}},
        "x",
        "light/more/x already",
    ),
    ({"/light/lamps": {"a": lamp(_RIG, color=[0, 0, 0])}}, "a/color", "black"),
    ({"/light/lamps": {"a": lamp(_RIG, cone_deg=0)}}, "a/cone_deg", "more than 0 °"),
    ({"/light/lamps": {"a": lamp(_RIG, cone_deg=181)}}, "a/cone_deg", "at most 180 °"),
    ({"/light/lamps": {"a": lamp(_RIG, radius_m=-1)}}, "a/radius_m", "at least 0 m"),
    ({"/light/lamps": {"a": lamp(_RIG, softnes=0)}}, "a/softnes", '"softness"'),
    ({"/light/lamps": {"a": lamp({**_WORLD, "x_m": 11})}}, "a/mount/x_m", "-10 m to 10 m"),
    (
        {"/light/lamps": {"a": lamp({**_WORLD, "y_m": {"type": "normal", "mean": 0, "std": 1}})}},
        "a/mount/y_m",
        "expected a place on it",
    ),
    (
        {"/light/lamps": {"a": lamp({**_WORLD, "target": {"x_m": 0, "y_m": -6}})}},
        "a/mount/target/y_m",
        '"heights": "world"',
    ),
    (
        {"/light/lamps": {"a": lamp({**_WORLD, "target": {"x_m": 0, "y_m": 0}, "bearing_deg": 5})}},
        "a/mount/bearing_deg",
        "target and bearing_deg",
    ),
]
_MORE_FAULTS = [
    ({"/light/more": {"Sun": {"type": "sun"}}}, "Sun", "the name of the sun"),
    ({"/light/more": {"a": {"type": "moon"}}}, "a/type", "sun, earthshine"),
    ({"/light/more": {"a": {}}}, "a", '"type" is missing'),
    ({"/light/more": {"a": {"type": "sun", "color": [0, 0, 0]}}}, "a/color", "black"),
    ({"/light/more": {"a": {"type": "earthshine", "phase_deg": 181}}}, "a/phase_deg", "at most"),
    ({"/light/more": {"a": {"type": "earthshine", "irradiance": 1}}}, "a/irradiance", "unknown"),
]


@pytest.mark.parametrize(
    ("change", "pointer", "words"),
    [(c, f"/light/lamps/{p}", w) for c, p, w in _FAULTS]
    + [(c, f"/light/more/{p}", w) for c, p, w in _MORE_FAULTS],
)
def test_a_fault_of_lamps_and_further_suns_is_told_where_it_is(tmp_path, change, pointer, words):
    (fault,) = faults_of(changed(change), tmp_path)
    assert fault.pointer == pointer
    assert words in fault.message


def test_off_the_terrain_a_lamp_has_its_height_over_zero(tmp_path):
    far = {**_WORLD, "x_m": 500, "heights": "world", "target": {"x_m": -500, "y_m": 0}}
    assert not faults_of(changed({"/light/lamps": {"a": lamp(far)}}), tmp_path)
