"""The scene that benchmarks of large numbers change: rocks on hills, one camera."""

from __future__ import annotations

from typing import Any


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
