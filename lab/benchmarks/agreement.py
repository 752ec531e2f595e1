"""Do renderers see what is annotated on drawn scenes, and does their light agree on average.

    python lab/benchmarks/agreement.py [--scenes 50] [--first 0] [--backends A,B] [--rgb 50]
                                           [--spp 512] [--fast]

Each scene is a cfg drawn from its number: 1 to 100,000 rocks, hills and plains, cameras from a
hand's breadth above the ground to 60 m, fields of view from 20 to 110 degrees, one to four ground
materials, metals, gloss, suns from 3 degrees up, with and without a sky. What renderers see
themselves is held against the exact hits at 640 x 480; radiance of the path tracers at
96 x 72. Radiance is that of each further backend against the first one's.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import numpy as np

from scenec.backends.check.compare import CompareOptions, compare
from scenec.lab.runner import Cell, Study, run

ANNOTATION = ["label", "instance", "depth", "range", "normal", "position", "face"]


def drawn_cfg(number: int, sensor: str) -> dict[str, Any]:
    """The cfg of one scene, with one of its cameras, "eye" or "small"."""
    rng = np.random.default_rng(number)

    def uniform(low: float, high: float) -> float:
        return round(float(rng.uniform(low, high)), 4)

    def log_uniform(low: float, high: float) -> float:
        return float(f"{math.exp(rng.uniform(math.log(low), math.log(high))):.4g}")

    # Whatever is drawn is drawn in this order: a number is a scene.
    size = log_uniform(20, 400)
    grounds = [f"ground_{i}" for i in range(int(rng.integers(1, 5)))]
    amplitude = log_uniform(0.003, 0.06) * size
    classes, rocks = int(rng.integers(1, 4)), int(log_uniform(1, 100_000))
    terrain: dict[str, Any] = {
        "size_m": [size, size], "spacing_m": size / float(rng.integers(100, 700)),
        "relief": [
            {"type": "plane", "slope": [uniform(-0.2, 0.2), uniform(-0.2, 0.2)]},
            {"type": "multifractal", "amplitude_m": amplitude,
             "scale_m": log_uniform(0.03, 0.3) * size, "octaves": int(rng.integers(2, 9))},
        ],
        "ground": [
            {"material": name, "labels": {"class": "ground", "material": name},
             **({"noise": {"scale_m": log_uniform(0.02, 0.3) * size}} if i else {})}
            for i, name in enumerate(grounds)
        ],
    }  # fmt: skip
    materials = {
        name: {
            "base_color": [uniform(0.02, 0.9) for _ in range(3)], "variation": uniform(0, 0.4),
            "specular": uniform(0, 0.3) if rng.random() < 0.5 else 0.0,
            "roughness": uniform(0.2, 1.0),
            "metallic": uniform(0, 1) if rng.random() < 0.2 else 0.0,
        }
        for name in [*grounds, "stone"]
    }  # fmt: skip
    objects = {
        f"rocks_{i}": {
            "type": "rocks", "count": max(1, rocks // classes), "material": "stone",
            "labels": {"class": "rock", "material": "stone"},
            "prototypes": int(rng.integers(1, 9)),
            "subdivisions": int(rng.integers(1, 5 if rocks < 20_000 else 3)),
            "size_m": {"type": "log_uniform", "min": log_uniform(0.0005, 0.002) * size,
                       "max": log_uniform(0.003, 0.03) * size},
            "orientation": str(rng.choice(["random", "normal", "upright"])),
            "embed": uniform(0, 0.8),
        }
        for i in range(classes)
    }  # fmt: skip
    sun = {"elevation_deg": uniform(3, 90), "azimuth_deg": uniform(0, 360),
           "diameter_deg": uniform(0.1, 2.0)}  # fmt: skip
    x, y = uniform(-0.3, 0.3) * size, uniform(-0.3, 0.3) * size
    # Half of the views graze.
    height = log_uniform(0.1, 2.0) if rng.random() < 0.5 else log_uniform(2.0, 60.0)
    target = {"distance_m": log_uniform(0.02, 0.5) * size, "bearing_deg": uniform(0, 360)}
    pose = {"type": "random_target", "position": {"x_m": x, "y_m": y, "height_m": height},
            "target": target, "roll_deg": uniform(-20, 20)}  # fmt: skip
    labels: dict[str, dict[str, int]] = {
        "class": {"ground": 2, "rock": 3},
        "material": {**{name: i + 2 for i, name in enumerate(grounds)}, "stone": 9},
    }
    light: dict[str, Any] = {"sun": sun}
    if rng.random() < 0.8:
        light["sky"] = {"type": "clear", "resolution": 64, "irradiance": log_uniform(30, 400),
                        "labels": {"class": "sky", "material": "sky"}}  # fmt: skip
        labels = {level: {"sky": 1, **ids} for level, ids in labels.items()}
    fov = uniform(20, 110)
    sensors = {
        "eye": {"resolution": [640, 480], "fov_deg": fov, "outputs": ANNOTATION},
        "small": {"resolution": [96, 72], "fov_deg": fov, "outputs": ["rgb", "depth"]},
    }
    return {
        "version": 1, "name": f"drawn_{number}", "samples": 1, "labels": labels,
        "terrain": terrain, "materials": materials, "objects": objects, "light": light,
        "rigs": {"rig": {"pose": pose, "sensors": {sensor: sensors[sensor]}}},
    }  # fmt: skip


def main(study: Study) -> None:
    """Prints a row for each scene, and what all say together."""
    options, backends = study.options, list(study.options.backends)
    count, spp = (2, 16) if study.fast else (options.scenes, options.spp)
    witnesses: dict[str, list[Any]] = {name: [] for name in backends}
    lights: dict[str, list[Any]] = {name: [] for name in backends[1:]}

    def scenes() -> Iterator[list[Cell]]:
        for number in range(options.first, options.first + count):
            cfg = drawn_cfg(number, "eye")
            row: list[Cell] = [number, sum(thing["count"] for thing in cfg["objects"].values())]
            out = study.batch(cfg, seed=number).parent
            found = compare(out, backends, options=CompareOptions(passes=("depth",)))
            for name in backends:
                seen = found.witnesses[name]
                witnesses[name].append(seen)
                row.append(f"{seen.differing} ({seen.beyond})")
            if number - options.first < options.rgb:
                out = study.batch(drawn_cfg(number, "small"), seed=number).parent
                how = CompareOptions(spp=spp, floor=True)
                for light in compare(out, backends, options=how).radiance:
                    # Without light there is no ratio.
                    if None not in light.mean_ratio:
                        lights[light.second].append(light)
                        row.append(f"{100 * np.abs(np.array(light.mean_ratio) - 1).max():.3f} %")
            yield row

    header = ["scene", "rocks", *(f"{name}: differing (beyond)" for name in backends)]
    study.table([*header, *(f"{name}: mean off" for name in lights)], scenes())
    study.table(
        ["witness", "scenes", "pixels of another face", "by more than a hair", "farthest, px"],
        ([name, len(found), sum(w.differing for w in found), sum(w.beyond for w in found),
          max(w.farthest_px for w in found)] for name, found in witnesses.items()),
    )  # fmt: skip
    study.table(
        ["radiance", "scenes", "mean off, median, %", "worst channel, %", "FLIP above the floor",
         "worst"],
        (_light(name, found) for name, found in lights.items() if found),
    )  # fmt: skip


def _light(name: str, found: list[Any]) -> list[Cell]:
    off = 100 * np.abs(np.array([light.mean_ratio for light in found]) - 1.0)
    row: list[Cell] = [name, len(found), np.median(off), off.max()]
    above = [light.flip[0] - light.floor[0] for light in found if None not in light.flip[:1]]
    return [*row, *((np.median(above), max(above)) if above else (None, None))]


if __name__ == "__main__":
    backends = ("mitsuba", "cycles", "pyrender")
    run(main, scenes=50, first=0, backends=backends, rgb=50, spp=512)
