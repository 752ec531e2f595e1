"""Draws depth cameras."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from scenec.compiler.distributions.resolve import resolve
from scenec.compiler.distributions.streams import Streams
from scenec.schemas.depth_camera import DepthCamera, StereoDepth, TimeOfFlightDepth


def draw_depth_camera(
    cfg: Mapping[str, Any] | None, path: str, streams: Streams
) -> DepthCamera | None:
    """How a sensor measures depth, every number drawn; None where it does not.

    Args:
        cfg: Its part of the cfg, filled in, or None.
        path: To it, for streams.
        streams: Of the batch.
    """
    if cfg is None:
        return None
    node = dict(resolve(cfg, streams, path))
    kind = node.pop("type")
    node["range_m"] = tuple(node["range_m"])
    model = StereoDepth(**node) if kind == "stereo" else TimeOfFlightDepth(**node)
    return DepthCamera(model, streams.key(f"{path}/noise"))
