"""Each fault of further suns and lamps: where it is said to be, and what is said."""

from __future__ import annotations

from typing import Any

import pytest
from small_cfg import changed, faults_of

_RIG = {"type": "rig", "rig": "rover"}
_WORLD = {"type": "world", "x_m": 1, "y_m": 2}


def lamp(mount: dict[str, Any], **more: Any) -> dict[str, Any]:
    return {"mount": mount, "intensity": 10} | more


#: A lamp, where below it the fault is, what is said.
_LAMPS = [
    ("a", lamp({"type": "rig", "rig": "rovr"}), "/mount/rig", '"rover"?'),
    ("1a", lamp(_RIG), "", "letters, digits and underscores"),
    ("Sun", lamp(_RIG), "", "the name of the sun"),
    ("Dome", lamp(_WORLD), "", "the name of the sky"),
    ("a", lamp(_RIG, color=[0, 0, 0]), "/color", "black"),
    ("a", lamp({**_WORLD, "x_m": 11}), "/mount/x_m", "-10 m to 10 m"),
    (
        "a",
        lamp({**_WORLD, "y_m": {"type": "normal", "mean": 0, "std": 1}}),
        "/mount/y_m",
        "expected a place on it",
    ),
    (
        "a",
        lamp({**_WORLD, "target": {"x_m": 0, "y_m": -6}}),
        "/mount/target/y_m",
        '"heights": "world"',
    ),
    (
        "a",
        lamp({**_WORLD, "target": {"x_m": 0, "y_m": 0}, "bearing_deg": 5}),
        "/mount/bearing_deg",
        "target and bearing_deg",
    ),
]
_SUNS = [
    ("Sun", {"type": "sun"}, "", "the name of the sun"),
    ("a", {"type": "sun", "color": [0, 0, 0]}, "/color", "black"),
]


@pytest.mark.parametrize(
    ("group", "name", "given", "below", "words"),
    [("lamps", *row) for row in _LAMPS] + [("more", *row) for row in _SUNS],
)
def test_a_fault_of_lamps_and_further_suns_is_told_where_it_is(
    tmp_path, group, name, given, below, words
):
    (fault,) = faults_of(changed({f"/light/{group}": {name: given}}), tmp_path)
    assert fault.pointer == f"/light/{group}/{name}{below}"
    assert words in fault.message


def test_a_lamp_and_a_further_sun_have_two_names(tmp_path):
    both = {"/light/lamps": {"x": lamp(_RIG)}, "/light/more": {"x": {"type": "sun"}}}
    (fault,) = faults_of(changed(both), tmp_path)
    assert fault.pointer == "/light/lamps/x"
    assert "light/more/x already" in fault.message


def test_off_the_terrain_a_lamp_has_its_height_over_zero(tmp_path):
    far = {**_WORLD, "x_m": 500, "heights": "world", "target": {"x_m": -500, "y_m": 0}}
    assert not faults_of(changed({"/light/lamps": {"a": lamp(far)}}), tmp_path)
