"""Draws further suns and lamps."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.cfg.load import Spec
from scenec.compiler.distributions.resolve import per_sample, resolve
from scenec.compiler.distributions.streams import Streams
from scenec.compiler.geometry.poses import from_euler
from scenec.compiler.light.earthshine import earthshine_irradiance
from scenec.compiler.light.latlong import luminance
from scenec.compiler.scene.light_plan import LampPlan, RigMount, WorldMount
from scenec.compiler.scene.scene import SunLight


def draw_more_suns(spec: Spec, streams: Streams, samples: int) -> dict[str, SunLight]:
    """Further distant discs by name."""
    return {
        name: _disc(node, streams, f"light/more/{name}", samples)
        for name, node in spec.cfg["light"]["more"].items()
    }


def draw_lamps(spec: Spec, streams: Streams, samples: int) -> tuple[LampPlan, ...]:
    """Spot lights, in the cfg's order."""
    return tuple(
        _lamp(name, node, streams, f"light/lamps/{name}", samples)
        for name, node in spec.cfg["light"]["lamps"].items()
    )


def of_luminance_one(color: NDArray[np.float64]) -> NDArray[np.float64]:
    """Colors [s, 3] scaled to luminance 1; black stays black."""
    level = luminance(color)
    scaled: NDArray[np.float64] = color / np.where(level > 0.0, level, 1.0)[:, None]
    return scaled


def _drawn(
    node: dict[str, Any], streams: Streams, path: str, samples: int
) -> dict[str, NDArray[np.float64]]:
    return {
        key: per_sample(value, streams, f"{path}/{key}", samples)
        for key, value in node.items()
        if key != "type"
    }


def _disc(node: dict[str, Any], streams: Streams, path: str, samples: int) -> SunLight:
    drawn = _drawn(node, streams, path, samples)
    drawn["color"] = of_luminance_one(drawn["color"])
    if node["type"] == "earthshine":
        drawn["irradiance"] = earthshine_irradiance(
            drawn.pop("phase_deg"), drawn.pop("solar_irradiance"), drawn.pop("geometric_albedo")
        )
    return SunLight(**drawn)


def _lamp(name: str, node: dict[str, Any], streams: Streams, path: str, samples: int) -> LampPlan:
    numbers = ("intensity", "color", "radius_m", "cone_deg", "softness")
    drawn = _drawn({key: node[key] for key in numbers}, streams, path, samples)
    return LampPlan(
        name=name,
        mount=_mount(node["mount"], streams, f"{path}/mount", samples),
        intensity=of_luminance_one(drawn["color"]) * drawn["intensity"][:, None],
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
        axes = [per_sample(at[key], streams, f"{path}/{key}", samples) for key in _AXES]
        return np.stack(axes, axis=1)

    target = node["target"]
    return WorldMount(
        position=place(node, path),
        on_ground=node["heights"] == "ground",
        bearing_deg=per_sample(node["bearing_deg"], streams, f"{path}/bearing_deg", samples),
        elevation_deg=per_sample(node["elevation_deg"], streams, f"{path}/elevation_deg", samples),
        target=None if target is None else place(target, f"{path}/target"),
    )


_AXES = ("x_m", "y_m", "z_m")
