"""Draws sensors: cameras with all that they have, and lidars."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

import numpy as np

from scenec.compiler.arithmetic import elementary
from scenec.compiler.cameras.imaging import draw_imaging
from scenec.compiler.cameras.plan import ImagingPlan, SensorPlan
from scenec.compiler.distributions.resolve import per_sample, resolve
from scenec.compiler.distributions.streams import Streams
from scenec.compiler.geometry.lenses import find_fault, lens_intrinsics, make_lens
from scenec.compiler.geometry.poses import from_euler
from scenec.compiler.scene.rig import Focus, Lidar, LidarNoise, Sensor
from scenec.schemas.depth_camera import DepthCamera, StereoDepth, TimeOfFlightDepth
from scenec.schemas.errors import SceneError
from scenec.schemas.lens import Lens
from scenec.schemas.plugins import origin
from scenec.schemas.shutter import Shutter


def draw_sensor(
    name: str, cfg: Mapping[str, Any], path: str, streams: Streams, samples: int
) -> SensorPlan:
    """A camera, every number drawn.

    Raises:
        SceneError: Its lens is not one-to-one, its imaging is none, or it is to focus nearer than
            its focal length.
    """
    width, height = cfg["resolution"]
    lens = make_lens(resolve(cfg.get("lens"), streams, f"{path}/lens"))
    intrinsics = _intrinsics(cfg, path, streams, lens)
    fault = find_fault(lens, intrinsics, (width, height))
    if fault is not None:
        raise SceneError(f"{path}/lens: {fault}")
    mount = resolve(cfg["mount"], streams, f"{path}/mount")
    trigger = cfg.get("trigger", {"every": 1, "first": 0})
    imaging = draw_imaging(cfg.get("imaging"), streams, f"{path}/imaging", samples)
    exposure = cfg["exposure"]
    key = {"incident": "ev_offset", "fixed": "ev"}.get(exposure["type"])
    focus = _focus(cfg.get("focus"), streams, f"{path}/focus", samples, intrinsics[0], imaging)
    sensor = Sensor(
        name=name,
        resolution=(width, height),
        intrinsics=intrinsics,
        to_rig=from_euler(tuple(mount["position_m"]), tuple(mount["rotation_deg"])),
        exposure_ev=(
            np.zeros(samples)
            if key is None
            else per_sample(exposure[key], streams, f"{path}/exposure/{key}", samples)
        ),
        outputs=tuple(cfg["outputs"]),
        exposure_per=exposure["per"] if exposure["type"] == "auto" else None,
        partner=cfg.get("partner"),
        trigger=(trigger["every"], trigger["first"]),
        depth_camera=_depth_camera(cfg.get("depth_camera"), f"{path}/depth_camera", streams),
        lens=lens,
        # Light alone is blurred.
        focus=focus if "rgb" in cfg["outputs"] else None,
        effects=_effects(cfg.get("effects", []), streams, f"{path}/effects"),
    )
    shutter = _shutter(cfg.get("shutter"), imaging, streams, f"{path}/shutter", samples)
    return SensorPlan(sensor, exposure["type"] != "fixed", imaging, shutter)


def _effects(cfg: list[dict[str, Any]], streams: Streams, path: str) -> tuple[str, ...]:
    """See ``Sensor.effects``."""
    made = []
    for i, node in enumerate(resolve(cfg, streams, path)):
        made.append({
            "type": node.pop("type"),
            "from": origin("scenec.effects", cfg[i]["type"]),
            "key": streams.key(f"{path}/{i}"),
            **node,
        })  # fmt: skip
    return tuple(json.dumps(effect) for effect in made)


def _intrinsics(
    cfg: Mapping[str, Any], path: str, streams: Streams, lens: Lens | None
) -> tuple[float, float, float, float, float]:
    width, height = cfg["resolution"]
    if cfg["intrinsics"] is not None:
        k = resolve(cfg["intrinsics"], streams, f"{path}/intrinsics")
        return k["fx"], k["fy"], k["cx"], k["cy"], k["skew"]
    fov = resolve(cfg["fov_deg"], streams, f"{path}/fov_deg")
    if lens is not None:
        found = lens_intrinsics(lens, (width, height), fov)
        if isinstance(found, str):
            raise SceneError(f"{path}/lens: {found}")
        return found
    half = fov * elementary.PI / 360.0
    focal = 0.5 * width * elementary.cos(half) / elementary.sin(half)
    return focal, focal, 0.5 * width, 0.5 * height, 0.0


def _depth_camera(cfg: dict[str, Any] | None, path: str, streams: Streams) -> DepthCamera | None:
    if cfg is None:
        return None
    node = dict(resolve(cfg, streams, path))
    kind = node.pop("type")
    node["range_m"] = tuple(node["range_m"])
    model = StereoDepth(**node) if kind == "stereo" else TimeOfFlightDepth(**node)
    return DepthCamera(model, streams.key(f"{path}/noise"))


def _focus(
    cfg: dict[str, Any] | None,
    streams: Streams,
    path: str,
    samples: int,
    focal_px: float,
    imaging: ImagingPlan | None,
) -> Focus | None:
    """A sensor's aperture.

    With imaging, f-number and size of pixels are its own; the focal length is that of pixels of
    this size that see what ``focal_px``, fx, says.
    """
    if cfg is None:
        return None
    distance = per_sample(cfg["distance_m"], streams, f"{path}/distance_m", samples)
    if imaging is None:
        f_number = per_sample(cfg["f_number"], streams, f"{path}/f_number", samples)
        length = float(resolve(cfg["focal_length_mm"], streams, f"{path}/focal_length_mm")) * 1e-3
    else:
        f_number = np.array([one.f_number for one in imaging.samples], np.float64)
        length = focal_px * imaging.samples[0].pixel_um * 1e-6
    nearest = float(distance.min())
    if nearest <= length:
        raise SceneError(
            f"{path}/distance_m: {nearest:g} m is not beyond the focal length, {length * 1e3:g} mm"
        )
    return Focus(distance, f_number, length)


def _shutter(
    cfg: dict[str, Any] | None,
    imaging: ImagingPlan | None,
    streams: Streams,
    path: str,
    samples: int,
) -> tuple[Shutter, ...] | None:
    """A sensor's shutter at each sample; without a time of its own it has the imaging's."""
    if cfg is None:
        return None
    node = resolve(cfg, streams, path)
    upward = node["direction"] == "up"
    if node["exposure_s"] is not None:
        return (Shutter(node["exposure_s"], node["readout_s"], upward),) * samples
    assert imaging is not None
    return tuple(Shutter(one.time_s, node["readout_s"], upward) for one in imaging.samples)


def draw_lidar(name: str, cfg: Mapping[str, Any], path: str, streams: Streams) -> Lidar:
    """A lidar of a cfg, every number drawn."""
    mount = resolve(cfg["mount"], streams, f"{path}/mount")
    if cfg["elevations_deg"] is not None:
        elevations = np.array(cfg["elevations_deg"], np.float64)
    else:
        first, last = cfg["elevation_deg"]
        steps = max(cfg["beams"] - 1, 1)
        elevations = first + (last - first) * np.arange(cfg["beams"]) / steps
    noise = resolve(cfg["noise"], streams, f"{path}/noise")
    return Lidar(
        name=name,
        to_rig=from_euler(tuple(mount["position_m"]), tuple(mount["rotation_deg"])),
        elevations_deg=elevations,
        azimuths=cfg["azimuths"],
        azimuth_deg=tuple(cfg["azimuth_deg"]),
        range_m=tuple(cfg["range_m"]),
        noise=LidarNoise(**noise),
        noise_key=streams.key(f"{path}/noise/key"),
        trigger=(cfg["trigger"]["every"], cfg["trigger"]["first"]),
    )
