"""Draws the light of every sample."""

from __future__ import annotations

from typing import Any

import numpy as np

from scenec.compiler.cfg.label_maps import LabelMapPlan
from scenec.compiler.cfg.load import Spec
from scenec.compiler.distributions.resolve import per_sample, resolve
from scenec.compiler.distributions.streams import Streams
from scenec.compiler.draw.lamps import draw_lamps, draw_more_suns
from scenec.compiler.light.latlong import luminance
from scenec.compiler.scene.light_plan import AtmospherePlan, ClearSkyPlan, ImageSkyPlan, LightPlan
from scenec.compiler.scene.scene import Haze, SunLight

#: -ln 0.02: over the visibility, contrast falls to 2 % (Koschmieder 1924).
KOSCHMIEDER = 3.912


def draw_light(spec: Spec, streams: Streams, samples: int) -> LightPlan:
    """The light of a batch."""
    return LightPlan(
        sun=draw_sun(spec.cfg["light"]["sun"], streams, "light/sun", samples),
        sky=_sky(spec, streams, samples),
        haze=_haze(spec.cfg["light"]["haze"], streams, samples),
        more_suns=draw_more_suns(spec, streams, samples),
        lamps=draw_lamps(spec, streams, samples),
    )


def draw_sun(
    cfg: dict[str, Any] | None, streams: Streams, path: str, samples: int
) -> SunLight | None:
    """A distant disc whose keys are the fields of ``SunLight``; its color gets luminance 1.

    A color of None is white.
    """
    if cfg is None:
        return None
    drawn = {
        key: per_sample(value, streams, f"{path}/{key}", samples)
        for key, value in cfg.items()
        if value is not None
    }
    drawn.setdefault("color", np.ones((samples, 3)))
    level = luminance(drawn["color"])
    drawn["color"] = drawn["color"] / np.where(level > 0.0, level, 1.0)[:, None]
    return SunLight(**drawn)


def _sky(
    spec: Spec, streams: Streams, samples: int
) -> ClearSkyPlan | AtmospherePlan | ImageSkyPlan | None:
    cfg = spec.cfg["light"]["sky"]
    kind = cfg["type"] if cfg else "none"
    path = "light/sky"
    if kind == "clear":
        keys = ("irradiance", "zenith_color", "horizon_color", "ground_color")
        drawn = {key: per_sample(cfg[key], streams, f"{path}/{key}", samples) for key in keys}
        resolution = resolve(cfg["resolution"], streams, f"{path}/resolution")
        return ClearSkyPlan(resolution=int(resolution), **drawn)
    if kind == "atmosphere":
        factors = ("air_density", "dust_density", "ozone_density", "altitude_m", "ground_color")
        drawn = {key: per_sample(cfg[key], streams, f"{path}/{key}", samples) for key in factors}
        return AtmospherePlan(
            planet=cfg["planet"],
            scattering=cfg["scattering"],
            resolution=cfg["resolution"],
            **drawn,
        )
    if kind == "image":
        picked = [_pick(cfg, streams, i, samples) for i in range(samples)]
        return ImageSkyPlan(
            files=tuple(spec.files[f"light/sky/files/{index}"].path for index in picked),
            strength=per_sample(cfg["strength"], streams, f"{path}/strength", samples),
            rotation_deg=per_sample(cfg["rotation_deg"], streams, f"{path}/rotation_deg", samples),
            extract_sun=cfg["sun"] == "extract",
            label_maps=_label_maps(spec, cfg, picked),
        )
    return None


def _haze(cfg: dict[str, Any] | None, streams: Streams, samples: int) -> Haze | None:
    if cfg is None:
        return None
    drawn = {
        key: per_sample(cfg[key], streams, f"light/haze/{key}", samples)
        for key, value in cfg.items()
        if value is not None and value != "sky"
    }
    extinction = drawn.get("extinction_per_m")
    if extinction is None:
        color, visibility = drawn["color"], drawn["visibility_m"]
        extinction = color * (KOSCHMIEDER / (visibility * luminance(color)))[:, None]
    return Haze(
        extinction=extinction,
        scale_height_m=drawn.get("scale_height_m", np.full(samples, np.inf)),
        airlight=drawn.get("airlight"),
    )


def _pick(cfg: dict[str, Any], streams: Streams, sample: int, samples: int) -> int:
    """Which of the pictures a sample has."""
    count, path = len(cfg["files"]), "light/sky/pick"
    number = streams.batch * samples + sample
    if cfg["pick"] == "in_turn":
        return number % count
    if cfg["pick"] == "random":
        return int(streams.uniforms(path, 1, sample=sample)[0] * count)
    # Runs through the list go on over batches, so their streams are of none: of the first.
    round_of_all = Streams(streams.seed, 0).uniforms(path, count, sample=number // count)
    return int(np.argsort(round_of_all, kind="stable")[number % count])


def _label_maps(
    spec: Spec, cfg: dict[str, Any], picked: list[int]
) -> dict[str, tuple[LabelMapPlan | None, ...]]:
    """The label maps of the pictures that were picked, by level."""
    maps: dict[str, tuple[LabelMapPlan | None, ...]] = {}
    for level, table in spec.cfg["labels"].items():
        of_level: list[LabelMapPlan | None] = []
        for index in picked:
            node = ((cfg["label_maps"] or {index: None})[index] or {}).get(level)
            if node is None:
                of_level.append(None)
                continue
            file = spec.files[f"light/sky/label_maps/{index}/{level}/file"].path
            ids = ((value, table[name] if name else 0) for value, name in node["values"].items())
            of_level.append(LabelMapPlan(file, tuple(ids)))
        if any(of_level):
            maps[level] = tuple(of_level)
    return maps
