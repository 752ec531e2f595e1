"""Draws the light of every sample."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.frontend.load import Spec
from scenec.compiler.frontend.resolve import resolve
from scenec.compiler.frontend.streams import Streams
from scenec.compiler.light.latlong import luminance
from scenec.compiler.light.plan import ClearSkyPlan, ImageSkyPlan, LightPlan
from scenec.compiler.scene import SunLight


def draw_light(spec: Spec, streams: Streams, samples: int) -> LightPlan:
    """The light of a batch."""
    return LightPlan(
        sun=draw_sun(spec.cfg["light"]["sun"], streams, "light/sun", samples),
        sky=_sky(spec, streams, samples),
    )


def per_sample(node: Any, streams: Streams, path: str, samples: int) -> NDArray[np.float64]:
    """A number, or a list of numbers, at every sample: float64 [samples, ...]."""
    return np.array([resolve(node, streams, path, sample=i) for i in range(samples)], np.float64)


def draw_sun(
    cfg: dict[str, Any] | None, streams: Streams, path: str, samples: int
) -> SunLight | None:
    """A distant disc whose keys are the fields of ``SunLight``; its color gets luminance 1."""
    if cfg is None:
        return None
    drawn = {
        key: per_sample(value, streams, f"{path}/{key}", samples) for key, value in cfg.items()
    }
    level = luminance(drawn["color"])
    drawn["color"] = drawn["color"] / np.where(level > 0.0, level, 1.0)[:, None]
    return SunLight(**drawn)


def _sky(spec: Spec, streams: Streams, samples: int) -> ClearSkyPlan | ImageSkyPlan | None:
    cfg = spec.cfg["light"]["sky"]
    kind = cfg["type"] if cfg else "none"
    path = "light/sky"
    if kind == "clear":
        keys = ("irradiance", "zenith_color", "horizon_color", "ground_color")
        drawn = {key: per_sample(cfg[key], streams, f"{path}/{key}", samples) for key in keys}
        resolution = resolve(cfg["resolution"], streams, f"{path}/resolution")
        return ClearSkyPlan(resolution=int(resolution), **drawn)
    if kind == "image":
        return ImageSkyPlan(
            files=tuple(_pick(spec, cfg, streams, i, samples) for i in range(samples)),
            strength=per_sample(cfg["strength"], streams, f"{path}/strength", samples),
            rotation_deg=per_sample(cfg["rotation_deg"], streams, f"{path}/rotation_deg", samples),
        )
    return None


def _pick(spec: Spec, cfg: dict[str, Any], streams: Streams, sample: int, samples: int) -> Any:
    count = len(cfg["files"])
    if cfg["pick"] == "in_turn":
        index = (streams.batch * samples + sample) % count
    else:
        index = int(streams.uniforms("light/sky/pick", 1, sample=sample)[0] * count)
    return spec.files[f"light/sky/files/{index}"].path
