"""Draws lidars."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from scenec.compiler.distributions.resolve import resolve
from scenec.compiler.distributions.streams import Streams
from scenec.compiler.geometry.poses import from_euler
from scenec.compiler.scene.rig import Lidar, LidarNoise


def draw_lidar(name: str, cfg: Mapping[str, Any], path: str, streams: Streams) -> Lidar:
    """A lidar of a cfg, every number drawn.

    Args:
        name: In the cfg.
        cfg: Its part of the cfg, filled in.
        path: To it, for streams.
        streams: Of the batch.
    """
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
