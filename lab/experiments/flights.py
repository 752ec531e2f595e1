"""Flights of a small aircraft over a made surface: tracks, the cfg, what is varied in it."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

RATE_HZ = 10.0
#: Frames of a whole flight.
WHOLE = 60
SEED = 1
#: Distance of the two cameras.
BASELINE_M = 0.25
LEFT, RIGHT = "mav_left", "mav_right"

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Flight:
    """One way to fly.

    Attributes:
        name: For tables.
        what: One line.
        position: Time in [0, 1] -> world position, meters, [n, 3].
        swing: Likewise, degrees that are added to the direction of flight, looking down:
            (yaw, pitch, roll), [n, 3].
    """

    name: str
    what: str
    position: Callable[[Floats], Floats]
    swing: Callable[[Floats], Floats]


def _stack(*columns: Floats) -> Floats:
    return np.stack(np.broadcast_arrays(*columns), axis=-1)


sin, cos, pi = np.sin, np.cos, np.pi
FLIGHTS = (
    Flight(
        "1 fast",
        "a slalom with fast turns of the head",
        lambda s: _stack(-6 + 12 * s, 1.6 * sin(4 * pi * s), 3.2 + 0.5 * sin(9 * s)),
        lambda s: _stack(30 * sin(10 * pi * s), 6 * sin(14 * s), 14 * sin(16 * s)),
    ),
    Flight(
        "2 gentle",
        "a wide arc",
        lambda s: _stack(6 * sin(2.4 * s - 1.2), 4 - 6 * cos(2.4 * s - 1.2), 3 + 0.6 * s),
        lambda s: _stack(4 * sin(5 * s), 2 * sin(7 * s), 3 * sin(4 * s)),
    ),
    Flight(
        "3 gentle",
        "an S that climbs",
        lambda s: _stack(-5 + 10 * s, -1 + 2 * sin(2 * pi * s), 2.6 + 1.4 * s),
        lambda s: _stack(3 * sin(6 * s), 3 * sin(5 * s), 2 * sin(9 * s)),
    ),
)
#: How far the camera looks down.
_DOWN_DEG = 42.0


def write_track(path: Path, flight: Flight, frames: int) -> None:
    """Writes the first frames of a flight as the pose ``track`` reads them, in OpenCV's axes."""
    s = np.arange(frames) / WHOLE
    position = flight.position(s)
    ahead = flight.position(s + 1e-4) - flight.position(s - 1e-4)
    yaw = np.degrees(np.arctan2(ahead[:, 1], ahead[:, 0]))
    swing = flight.swing(s)
    # Camera axes of a level look along +x: x right (-y), y down (-z), z forward (+x).
    level = Rotation.from_matrix([[0, 0, 1], [-1, 0, 0], [0, -1, 0]])
    angles = np.stack([yaw + swing[:, 0], _DOWN_DEG + swing[:, 1], swing[:, 2]], axis=1)
    turn = Rotation.from_euler("ZYX", angles, degrees=True) * level
    x, y, z, w = turn.as_quat().T
    rows = np.column_stack([np.arange(frames) / RATE_HZ, position, w, x, y, z])
    header = "time_s,x_m,y_m,z_m,qw,qx,qy,qz"
    np.savetxt(path, rows, "%.9f", delimiter=",", header=header, comments="")


def cfg(track: Path, size: tuple[int, int]) -> dict[str, Any]:
    """A stony plain under a sun of 40 degrees, flown over along a track by two cameras."""
    file = Path(__file__).with_suffix(".json")
    made: dict[str, Any] = json.loads(file.read_text(encoding="utf-8"))
    made["samples"] = len(track.read_text(encoding="utf-8").splitlines()) - 1
    mav = made["rigs"]["mav"]
    mav["pose"]["file"] = track.name
    for sensor in mav["sensors"].values():
        sensor["resolution"] = list(size)
    return made


def _sensors(**keys: Any) -> Callable[[dict[str, Any]], None]:
    def change(made: dict[str, Any]) -> None:
        for sensor in made["rigs"]["mav"]["sensors"].values():
            sensor |= keys

    return change


def _sun(elevation_deg: float) -> Callable[[dict[str, Any]], None]:
    def change(made: dict[str, Any]) -> None:
        made["light"]["sun"]["elevation_deg"] = elevation_deg

    return change


def _plain(made: dict[str, Any]) -> None:
    soil = made["materials"]["soil"]
    del soil["maps"]
    soil["variation"] = 0


def _bare(made: dict[str, Any]) -> None:
    _plain(made)
    del made["objects"], made["materials"]["stone"], made["labels"]["class"]["rock"]


def _iso(speed: float) -> Callable[[dict[str, Any]], None]:
    exposure = {"type": "metered", "time_range_s": [1e-6, 1], "iso_range": [speed, speed]}
    return _sensors(imaging={"exposure": exposure})


#: What is varied -> its values -> what that changes in the cfg; None is the cfg as it is. The last
#: value is the hardest.
VARIED: dict[str, dict[str, Callable[[dict[str, Any]], None] | None]] = {
    "texture": {
        "soil and rocks": None,
        "rocks on plain ground": _plain,
        "bare plain ground": _bare,
    },
    "sun": {"75 deg": _sun(75), "40 deg": None, "8 deg": _sun(8)},
    "sensor": {"no noise": None, **{f"ISO {n}": _iso(n) for n in (6400, 51200)}},
    "blur": {"none": None, "40 ms": _sensors(shutter={"exposure_s": 0.04})},
}
