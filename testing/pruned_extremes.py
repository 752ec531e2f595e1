"""Scenes at the limits of what pruning has to bear; for tests and a page."""

from __future__ import annotations

import copy
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

Cfg = dict[str, Any]


@dataclass(frozen=True)
class Case:
    """A scene.

    Attributes:
        what: In words.
        change: Makes it of the usual one, in place.
    """

    what: str
    change: Callable[[Cfg], None] = lambda cfg: None


def pruned_cfg(case: Case, outputs: tuple[str, ...] = ("rgb", "label", "instance")) -> Cfg:
    """A cfg: 100 m x 100 m of hills, 3,000 rocks, one camera, two samples.

    Args:
        case: Which.
        outputs: Of the camera.
    """
    cfg = copy.deepcopy(_USUAL)
    _sensor(cfg)["outputs"] = list(outputs)
    case.change(cfg)
    return cfg


_USUAL: Cfg = {
    "version": 1, "name": "pruned_extreme", "samples": 2,
    "labels": {"class": {"sky": 1, "ground": 2, "rock": 3}},
    "terrain": {
        "size_m": [100, 100], "spacing_m": 1,
        "relief": [
            {"type": "plane"},
            {"type": "multifractal", "amplitude_m": 5, "scale_m": 40, "octaves": 5},
        ],
        "ground": [{"material": "sand", "labels": {"class": "ground"}}],
        "mesh": {"tolerance_px": 1},
    },
    "materials": {
        "sand": {"base_color": [0.4, 0.3, 0.2]},
        "stone": {"base_color": [0.15, 0.12, 0.1], "variation": 0.3},
    },
    "objects": {
        "rocks": {
            "type": "rocks", "count": 3000, "material": "stone", "labels": {"class": "rock"},
            "prototypes": 3, "subdivisions": 1,
            "size_m": {"type": "log_uniform", "min": 0.05, "max": 2},
        },
    },
    "light": {
        "sun": {"elevation_deg": 35, "azimuth_deg": 250},
        "sky": {"type": "clear", "resolution": 32, "labels": {"class": "sky"}},
    },
    "rigs": {
        "rover": {
            "pose": {
                "type": "random_target",
                "position": {
                    "x_m": {"type": "uniform", "min": -10, "max": 10},
                    "y_m": {"type": "uniform", "min": -10, "max": 10}, "height_m": 1.5,
                },
                "target": {
                    "distance_m": 10, "bearing_deg": {"type": "uniform", "min": 40, "max": 80},
                    "height_m": 0,
                },
            },
            "sensors": {"front": {"resolution": [96, 72], "fov_deg": 60}},
        },
    },
}  # fmt: skip


def _sensor(cfg: Cfg) -> Cfg:
    sensor: Cfg = cfg["rigs"]["rover"]["sensors"]["front"]
    return sensor


def _pose(cfg: Cfg) -> Cfg:
    pose: Cfg = cfg["rigs"]["rover"]["pose"]
    return pose


def _sun(**values: Any) -> Callable[[Cfg], None]:
    return lambda cfg: cfg["light"].setdefault("sun", {}).update(values)


def _sand(**values: Any) -> Callable[[Cfg], None]:
    return lambda cfg: cfg["materials"]["sand"].update(values)


def _stone(**values: Any) -> Callable[[Cfg], None]:
    return lambda cfg: cfg["materials"]["stone"].update(values)


def _rocks(**values: Any) -> Callable[[Cfg], None]:
    return lambda cfg: cfg["objects"]["rocks"].update(values)


def _hills(amplitude: float) -> Callable[[Cfg], None]:
    return lambda cfg: cfg["terrain"]["relief"][1].update(amplitude_m=amplitude)


def _view(fov: float, **values: Any) -> Callable[[Cfg], None]:
    return lambda cfg: _sensor(cfg).update(fov_deg=fov, **values)


def _from(height: float, distance: float, fov: float) -> Callable[[Cfg], None]:
    def change(cfg: Cfg) -> None:
        _pose(cfg)["position"]["height_m"] = height
        _pose(cfg)["target"]["distance_m"] = distance
        _sensor(cfg)["fov_deg"] = fov

    return change


def _all_round(cfg: Cfg) -> None:
    sensor = _sensor(cfg)
    del sensor["fov_deg"]
    sensor |= {"resolution": [96, 48], "lens": {"type": "equirectangular"}}


def _many_samples(cfg: Cfg) -> None:
    cfg["samples"] = 300
    _sensor(cfg)["resolution"] = [16, 12]


def _night(cfg: Cfg) -> None:
    cfg["light"] = {
        "sun": {"elevation_deg": -60},
        "sky": {"type": "none", "labels": {"class": "sky"}},
        "lamps": {
            "torch": {
                "intensity": 500,
                "cone_deg": 25,
                "mount": {"type": "rig", "rig": "rover", "position_m": [0, 0.3, 0]},
            }
        },
    }


def _no_sky(cfg: Cfg) -> None:
    cfg["light"]["sky"] = {"type": "none", "labels": {"class": "sky"}}


def _haze(cfg: Cfg) -> None:
    cfg["light"]["haze"] = {"visibility_m": 30}


def _wide_land(cfg: Cfg) -> None:
    """All lengths of the ground times 200; as many rocks, 100 times as large."""
    cfg["terrain"] |= {"size_m": [20_000, 20_000], "spacing_m": 200}
    cfg["terrain"]["relief"][1] |= {"amplitude_m": 1000, "scale_m": 8000}
    _rocks(size_m={"type": "log_uniform", "min": 5, "max": 200})(cfg)
    for axis in ("x_m", "y_m"):
        _pose(cfg)["position"][axis] = {"type": "uniform", "min": -2000, "max": 2000}
    _from(50, 1000, 60)(cfg)


CASES = {
    "usual": Case("as described above"),
    "sun_90": Case("sun at the zenith", _sun(elevation_deg=90)),
    "sun_8": Case("sun 8° high", _sun(elevation_deg=8)),
    "sun_1": Case("sun 1° high", _sun(elevation_deg=1)),
    "sun_below": Case("sun 3° below the horizon", _sun(elevation_deg=-3)),
    "sun_off": Case("a sun of 1e-6 W/m²: sky alone", _sun(irradiance=1e-6)),
    "sun_wide": Case("a sun of 40°", _sun(diameter_deg=40)),
    "no_sky": Case("no sky: sun alone", _no_sky),
    "night": Case("night, a lamp on the rover", _night),
    "haze": Case("haze, 30 m of visibility", _haze),
    "flat": Case("flat ground", _hills(0)),
    "steep": Case("hills of 50 m, 40 m wide", _hills(50)),
    "low": Case("camera 2 cm above ground", _from(0.02, 10, 60)),
    "down": Case("straight down from 20 m", _from(20, 0.01, 60)),
    "far_above": Case("all of it from 5 km", _from(5000, 0.01, 1.5)),
    "narrow": Case("0.2° of view", _view(0.2)),
    "wide": Case("179° of view", _view(179)),
    "all_round": Case("equirectangular", _all_round),
    "many": Case("300 samples", _many_samples),
    "grains": Case("grains of 1 to 5 mm", _rocks(size_m={"type": "uniform", "min": 0.001,
                                                          "max": 0.005})),
    "boulders": Case("30 boulders of 5 to 20 m", _rocks(count=30, size_m={
        "type": "uniform", "min": 5, "max": 20})),
    "one": Case("one rock", _rocks(count=1)),
    "mirror": Case("ground like a mirror", _sand(metallic=1, roughness=0.05)),
    "snow": Case("ground of albedo 0.95", _sand(base_color=[0.95, 0.95, 0.95])),
    "glowing": Case("rocks that glow", _stone(emission=[50, 20, 5])),
    "wide_land": Case("20 km × 20 km, rocks of 5 to 200 m", _wide_land),
}  # fmt: skip
