"""Cfgs that several scripts change, of rocks on hills or level ground; a rig, a noise."""

from __future__ import annotations

from typing import Any

from scenec.compiler.terrain.operators.multifractal import Multifractal


def rocks_on_hills(
    count: int, side_m: float = 100.0, cells: int = 200, **change: Any
) -> dict[str, Any]:
    """A cfg.

    Args:
        count: Of rocks.
        side_m: Of the terrain.
        cells: Along each side.
        change: Other top keys of the cfg.
    """
    cfg: dict[str, Any] = {
        "version": 1,
        "name": "rocks_on_hills",
        "labels": {"class": {"sky": 1, "ground": 2, "rock": 3}},
        "terrain": {
            "size_m": [side_m, side_m],
            "spacing_m": side_m / cells,
            "relief": [
                {"type": "plane"},
                {"type": "multifractal", "amplitude_m": 3, "scale_m": 60, "octaves": 8},
            ],
            "ground": [{"material": "sand", "labels": {"class": "ground"}}],
        },
        "materials": {
            "sand": {"base_color": [0.4, 0.25, 0.15]},
            "stone": {"base_color": [0.2, 0.14, 0.1], "variation": 0.3},
        },
        "objects": {
            "rocks": {
                "type": "rocks",
                "count": count,
                "family": "angular",
                "material": "stone",
                "labels": {"class": "rock"},
                "size_m": {"type": "uniform", "min": 0.04, "max": 0.1},
            }
        },
        "light": {
            "sun": {"elevation_deg": 40},
            "sky": {"type": "clear", "labels": {"class": "sky"}},
        },
        "rigs": {
            "rover": {
                "pose": {
                    "type": "random_target",
                    "position": {"x_m": 0, "y_m": -0.2 * side_m, "height_m": 2},
                    "target": {"distance_m": 12, "bearing_deg": 0, "height_m": 0.5},
                },
                "sensors": {"mast": {"resolution": [640, 480], "fov_deg": 60}},
            }
        },
    }
    return cfg | change


def fbm(
    key: int, amplitude_m: float, scale_m: float, octaves: int = 8, **more: Any
) -> Multifractal:
    """A noise of halving octaves, unless ``more`` says another variant, gain or offset."""
    usual = {"lacunarity": 2.0, "gain": 0.5, "variant": "fbm", "offset": 0.7}
    return Multifractal(
        key=key, amplitude_m=amplitude_m, scale_m=scale_m, octaves=octaves, **usual | more
    )


def looking(
    place: tuple[float, float, float],
    distance_m: float,
    target_m: float = 0.0,
    bearing_deg: float = 0.0,
    **sensor: Any,
) -> dict[str, Any]:
    """A rig of one camera, ``eye``: its x, y and height, what it looks at, keys of the sensor."""
    x, y, height = place
    target = {"distance_m": distance_m, "bearing_deg": bearing_deg, "height_m": target_m}
    position = {"x_m": x, "y_m": y, "height_m": height}
    pose = {"type": "random_target", "position": position, "target": target}
    return {"pose": pose, "sensors": {"eye": sensor}}


def plain(
    size_m: float, spacing_m: float, material: dict[str, Any], rig: dict[str, Any], **change: Any
) -> dict[str, Any]:
    """A cfg of level ground of one material, ``ground``, and one rig: rgb alone, without labels."""
    cfg = {
        "version": 1, "name": "plain", "samples": 1, "labels": {}, "outputs": ["rgb"],
        "terrain": {
            "size_m": [size_m, size_m], "spacing_m": spacing_m, "relief": [{"type": "plane"}],
            "ground": [{"material": "ground"}],
        },
        "materials": {"ground": material}, "rigs": {"camera": rig},
    }  # fmt: skip
    return cfg | change
