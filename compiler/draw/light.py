"""Draws the light of every sample."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.cfg.load import Spec
from scenec.compiler.distributions.resolve import per_sample, resolve
from scenec.compiler.distributions.streams import Streams
from scenec.compiler.geometry.poses import from_euler
from scenec.compiler.light.earthshine import earthshine_irradiance
from scenec.compiler.light.latlong import luminance
from scenec.compiler.light.plan import (
    AtmospherePlan,
    CirrusPlan,
    ClearSkyPlan,
    CloudsPlan,
    CumulusPlan,
    ImageSkyPlan,
    LabelMapPlan,
    LampPlan,
    LightPlan,
    OvercastSkyPlan,
    RigMount,
    WorldMount,
)
from scenec.compiler.scene.light import Haze, SunLight

#: -ln 0.02: over the visibility, contrast falls to 2 % (Koschmieder 1924).
KOSCHMIEDER = 3.912


def draw_light(spec: Spec, streams: Streams, samples: int) -> LightPlan:
    """The light of a batch."""
    cfg = spec.cfg["light"]
    return LightPlan(
        sun=None if cfg["sun"] is None else _sun(cfg["sun"], streams, "light/sun", samples),
        sky=_sky(spec, streams, samples),
        haze=_haze(cfg["haze"], streams, samples),
        clouds=_clouds(cfg.get("clouds"), streams, samples),
        more_suns={
            name: _sun(node, streams, f"light/more/{name}", samples)
            for name, node in cfg["more"].items()
        },
        lamps=tuple(
            _lamp(name, node, streams, f"light/lamps/{name}", samples)
            for name, node in cfg["lamps"].items()
        ),
    )


def _drawn(
    node: Mapping[str, Any], streams: Streams, path: str, samples: int, *keys: str
) -> dict[str, NDArray[np.float64]]:
    """Numbers of a node at every sample: of some keys, or of all that have one but its type."""
    return {
        key: per_sample(node[key], streams, f"{path}/{key}", samples)
        for key in keys or node
        if node[key] is not None and key != "type"
    }


def _sun(node: dict[str, Any], streams: Streams, path: str, samples: int) -> SunLight:
    """A distant disc whose keys are the fields of ``SunLight``; one without a color is white."""
    drawn: dict[str, Any] = {**_drawn(node, streams, path, samples)}
    if node.get("type") == "earthshine":
        drawn["irradiance"] = earthshine_irradiance(
            drawn.pop("phase_deg"), drawn.pop("solar_irradiance"), drawn.pop("geometric_albedo")
        )
    drawn["color"] = _of_luminance_one(drawn.get("color", np.ones((samples, 3))))
    return SunLight(**drawn)


def _of_luminance_one(color: NDArray[np.float64]) -> NDArray[np.float64]:
    """Colors [s, 3] scaled to luminance 1; black stays black."""
    level = luminance(color)
    return color / np.where(level > 0.0, level, 1.0)[:, None]


def _sky(
    spec: Spec, streams: Streams, samples: int
) -> ClearSkyPlan | OvercastSkyPlan | AtmospherePlan | ImageSkyPlan | None:
    cfg = spec.cfg["light"]["sky"]
    kind = cfg["type"] if cfg else "none"
    path = "light/sky"
    if kind == "clear":
        keys = ("irradiance", "zenith_color", "horizon_color", "ground_color")
        drawn = _drawn(cfg, streams, path, samples, *keys)
        resolution = resolve(cfg["resolution"], streams, f"{path}/resolution")
        return ClearSkyPlan(resolution=int(resolution), **drawn)
    if kind == "overcast":
        keys = ("optical_depth", "irradiance", "color", "ground_color")
        drawn = _drawn(cfg, streams, path, samples, *keys)
        return OvercastSkyPlan(resolution=cfg["resolution"], **drawn)
    if kind == "atmosphere":
        factors = ("air_density", "dust_density", "ozone_density", "altitude_m", "ground_color")
        drawn = _drawn(cfg, streams, path, samples, *factors)
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
            **_drawn(cfg, streams, path, samples, "strength", "rotation_deg"),
            extract_sun=cfg["sun"] == "extract",
            label_maps=_label_maps(spec, cfg, picked),
        )
    return None


def _haze(cfg: dict[str, Any] | None, streams: Streams, samples: int) -> Haze | None:
    if cfg is None:
        return None
    keys = [key for key, value in cfg.items() if value != "sky"]
    drawn = _drawn(cfg, streams, "light/haze", samples, *keys)
    extinction = drawn.get("extinction_per_m")
    if extinction is None:
        color, visibility = drawn["color"], drawn["visibility_m"]
        extinction = color * (KOSCHMIEDER / (visibility * luminance(color)))[:, None]
    return Haze(
        extinction=extinction,
        scale_height_m=drawn["scale_height_m"],
        asymmetry=drawn["asymmetry"],
        albedo=drawn["albedo"],
        airlight=drawn.get("airlight"),
    )


def _clouds(cfg: dict[str, Any] | None, streams: Streams, samples: int) -> CloudsPlan | None:
    if cfg is None:
        return None
    layers: dict[str, Any] = {}
    for name, kind in (("cumulus", CumulusPlan), ("cirrus", CirrusPlan)):
        node, path = cfg[name], f"light/clouds/{name}"
        if node is None:
            layers[name] = None
            continue
        keys = [key for key in node if key != "size_m"]
        size = float(resolve(node["size_m"], streams, f"{path}/size_m"))
        drawn = _drawn(node, streams, path, samples, *keys)
        layers[name] = kind(key=streams.key(path), size_m=size, **drawn)
    return CloudsPlan(resolution=cfg["resolution"], **layers)


def _pick(cfg: dict[str, Any], streams: Streams, sample: int, samples: int) -> int:
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


def _lamp(name: str, node: dict[str, Any], streams: Streams, path: str, samples: int) -> LampPlan:
    numbers = ("intensity", "color", "radius_m", "cone_deg", "softness")
    drawn = _drawn(node, streams, path, samples, *numbers)
    return LampPlan(
        name=name,
        mount=_mount(node["mount"], streams, f"{path}/mount", samples),
        intensity=_of_luminance_one(drawn["color"]) * drawn["intensity"][:, None],
        radius_m=drawn["radius_m"],
        cone_deg=drawn["cone_deg"],
        softness=drawn["softness"],
    )


def _mount(
    node: dict[str, Any], streams: Streams, path: str, samples: int
) -> RigMount | WorldMount:
    if node["type"] == "rig":
        drawn = resolve(node, streams, path)
        to_rig = from_euler(tuple(drawn["position_m"]), tuple(drawn["rotation_deg"]))
        return RigMount(node["rig"], to_rig)

    def place(at: dict[str, Any], path: str) -> NDArray[np.float64]:
        axes = _drawn(at, streams, path, samples, "x_m", "y_m", "z_m")
        return np.stack(list(axes.values()), axis=1)

    target = node["target"]
    return WorldMount(
        position=place(node, path),
        on_ground=node["heights"] == "ground",
        **_drawn(node, streams, path, samples, "bearing_deg", "elevation_deg"),
        target=None if target is None else place(target, f"{path}/target"),
    )
