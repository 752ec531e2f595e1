"""Draws apertures of sensors, or takes them from the imaging."""

from __future__ import annotations

from typing import Any

import numpy as np

from scenec.compiler.distributions.resolve import per_sample, resolve
from scenec.compiler.distributions.streams import Streams
from scenec.compiler.scene.plan import ImagingPlan
from scenec.compiler.scene.rig import Focus
from scenec.schemas.errors import SceneError


def draw_focus(
    cfg: dict[str, Any] | None,
    streams: Streams,
    path: str,
    samples: int,
    focal_px: float,
    imaging: ImagingPlan | None,
) -> Focus | None:
    """Draw a sensor's ``focus``.

    With imaging, f-number and size of pixels are its own; the focal length is that of pixels of
    this size that see what ``focal_px`` says.

    Args:
        cfg: It, filled in; None without.
        streams: The batch's.
        path: Where it stands.
        samples: Number of samples.
        focal_px: Of the intrinsics, fx.
        imaging: The sensor's, as drawn.

    Raises:
        SceneError: It is to focus nearer than its focal length.
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
