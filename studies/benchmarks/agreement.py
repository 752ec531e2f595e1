"""Do renderers see what is annotated on drawn scenes, and does their light agree on average.

python studies/benchmarks/agreement.py [--scenes 50] [--backends mitsuba,cycles,pyrender]
                                     [--rgb 50] [--spp 512] [--json FILE]

Each scene is a cfg drawn from its number: 1 to 100,000 rocks, hills and plains, cameras from a
hand's breadth above the ground to 60 m, fields of view from 20 to 110 degrees, one to four ground
materials, metals, gloss, suns from 3 degrees up, with and without a sky. What renderers see
themselves is held against the exact hits at 640 x 480; radiance of the path tracers at
96 x 72.
"""

from __future__ import annotations

import argparse
import json
import math
import shutil
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

from scenec.backends.check.compare import Agreement, CompareOptions, compare
from scenec.compiler.compile import compile_cfg

ANNOTATION = ["label", "instance", "depth", "range", "normal", "position", "face"]


def drawn_cfg(number: int) -> dict[str, Any]:
    """The cfg of one scene."""
    rng = np.random.default_rng(number)

    def uniform(low: float, high: float) -> float:
        return round(float(rng.uniform(low, high)), 4)

    def log_uniform(low: float, high: float) -> float:
        return float(f"{math.exp(rng.uniform(math.log(low), math.log(high))):.4g}")

    size = log_uniform(20, 400)
    layers = int(rng.integers(1, 5))
    grounds = [f"ground_{i}" for i in range(layers)]
    amplitude = log_uniform(0.003, 0.06) * size
    classes = int(rng.integers(1, 4))
    rocks = int(log_uniform(1, 100_000))
    cfg: dict[str, Any] = {
        "version": 1,
        "name": f"drawn_{number}",
        "samples": 1,
        "labels": {
            "class": {"sky": 1, "ground": 2, "rock": 3},
            "material": {"sky": 1, **{name: i + 2 for i, name in enumerate(grounds)}, "stone": 9},
        },
        "terrain": {
            "size_m": [size, size],
            "spacing_m": size / float(rng.integers(100, 700)),
            "relief": [
                {"type": "plane", "slope": [uniform(-0.2, 0.2), uniform(-0.2, 0.2)]},
                {
                    "type": "multifractal",
                    "amplitude_m": amplitude,
                    "scale_m": log_uniform(0.03, 0.3) * size,
                    "octaves": int(rng.integers(2, 9)),
                },
            ],
            "ground": [
                {
                    "material": name,
                    "labels": {"class": "ground", "material": name},
                    **({"noise": {"scale_m": log_uniform(0.02, 0.3) * size}} if i else {}),
                }
                for i, name in enumerate(grounds)
            ],
        },
        "materials": {
            name: {
                "base_color": [uniform(0.02, 0.9) for _ in range(3)],
                "variation": uniform(0, 0.4),
                "specular": uniform(0, 0.3) if rng.random() < 0.5 else 0.0,
                "roughness": uniform(0.2, 1.0),
                "metallic": uniform(0, 1) if rng.random() < 0.2 else 0.0,
            }
            for name in [*grounds, "stone"]
        },
        "objects": {
            f"rocks_{i}": {
                "type": "rocks",
                "count": max(1, rocks // classes),
                "material": "stone",
                "labels": {"class": "rock", "material": "stone"},
                "prototypes": int(rng.integers(1, 9)),
                "subdivisions": int(rng.integers(1, 5 if rocks < 20_000 else 3)),
                "size_m": {
                    "type": "log_uniform",
                    "min": log_uniform(0.0005, 0.002) * size,
                    "max": log_uniform(0.003, 0.03) * size,
                },
                "orientation": str(rng.choice(["random", "normal", "upright"])),
                "embed": uniform(0, 0.8),
            }
            for i in range(classes)
        },
        "light": {
            "sun": {
                "elevation_deg": uniform(3, 90),
                "azimuth_deg": uniform(0, 360),
                "diameter_deg": uniform(0.1, 2.0),
            },
        },
        "rigs": {
            "rig": {
                "pose": {
                    "type": "random_target",
                    "position": {
                        "x_m": uniform(-0.3, 0.3) * size,
                        "y_m": uniform(-0.3, 0.3) * size,
                        # Half of the views graze.
                        "height_m": log_uniform(0.1, 2.0)
                        if rng.random() < 0.5
                        else log_uniform(2.0, 60.0),
                    },
                    "target": {
                        "distance_m": log_uniform(0.02, 0.5) * size,
                        "bearing_deg": uniform(0, 360),
                    },
                    "roll_deg": uniform(-20, 20),
                },
                "sensors": {},
            }
        },
    }
    if rng.random() < 0.8:
        cfg["light"]["sky"] = {
            "type": "clear",
            "resolution": 64,
            "irradiance": log_uniform(30, 400),
            "labels": {"class": "sky", "material": "sky"},
        }
    else:
        for level in cfg["labels"].values():
            del level["sky"]
    fov = uniform(20, 110)
    sensors = cfg["rigs"]["rig"]["sensors"]
    sensors["eye"] = {"resolution": [640, 480], "fov_deg": fov, "outputs": ANNOTATION}
    sensors["small"] = {"resolution": [96, 72], "fov_deg": fov, "outputs": ["rgb", "depth"]}
    return cfg


def with_outputs(cfg: dict[str, Any], sensor: str) -> dict[str, Any]:
    """The cfg with one of its sensors alone."""
    rig = cfg["rigs"]["rig"]
    sensors = {sensor: rig["sensors"][sensor]}
    return {**cfg, "rigs": {"rig": {**rig, "sensors": sensors}}}


def annotated(folder: Path, cfg: dict[str, Any], number: int, backends: list[str]) -> Agreement:
    """Compile a scene for annotation alone and compare."""
    out = compiled(folder, with_outputs(cfg, "eye"), number)
    return compare(out, backends, options=CompareOptions(passes=("depth",)))


def shaded(
    folder: Path, cfg: dict[str, Any], number: int, backends: list[str], spp: int
) -> Agreement:
    """Compile a scene for radiance and compare, with the floor of noise."""
    out = compiled(folder, with_outputs(cfg, "small"), number)
    return compare(out, backends, options=CompareOptions(spp=spp, floor=True))


def compiled(folder: Path, cfg: dict[str, Any], number: int) -> Path:
    path = folder / "cfg.json"
    path.write_text(json.dumps(cfg))
    shutil.rmtree(folder / "out", ignore_errors=True)
    compile_cfg(path, seed=number, out=folder / "out")
    return folder / "out"


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--scenes", type=int, default=50)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--backends", default="mitsuba,cycles,pyrender")
    parser.add_argument("--rgb", type=int, default=50, help="scenes whose radiance is compared")
    parser.add_argument("--rgb-backends", default="mitsuba,cycles,pyrender")
    parser.add_argument("--spp", type=int, default=512)
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    rows = []
    start = time.perf_counter()
    for number in range(options.first, options.first + options.scenes):
        cfg = drawn_cfg(number)
        row: dict[str, Any] = {
            "scene": number,
            "rocks": sum(thing["count"] for thing in cfg["objects"].values()),
        }
        with tempfile.TemporaryDirectory() as folder:
            found = annotated(Path(folder), cfg, number, options.backends.split(","))
            row["witness"] = {
                name: {"differing": w.differing, "beyond": w.beyond, "farthest_px": w.farthest_px}
                for name, w in found.witnesses.items()
            }
            if number - options.first < options.rgb:
                names = options.rgb_backends.split(",")
                for r in shaded(Path(folder), cfg, number, names, options.spp).radiance:
                    row[r.second] = {
                        "ratio": r.mean_ratio,
                        "flip": r.flip[0],
                        "floor": r.floor[0],
                        "relative_mse": r.relative_mse[0],
                        "noise": r.noise[0],
                    }
        rows.append(row)
        print(json.dumps(row), f"{time.perf_counter() - start:.0f} s", flush=True)
        if options.json:
            options.json.write_text(json.dumps(rows, indent=1))
    summary(rows, options.backends.split(","), options.rgb_backends.split(",")[1:])


def summary(rows: list[dict[str, Any]], seeing: list[str], radiance: list[str]) -> None:
    """What all scenes say together."""
    for name in seeing:
        every = [row["witness"][name] for row in rows]
        print(
            f"{name}: {sum(w['differing'] for w in every)} pixels of {len(rows)} scenes show "
            f"another face, {sum(w['beyond'] for w in every)} by more than a hair; the farthest by "
            f"{max(w['farthest_px'] for w in every):.2g} px"
        )
    for name in radiance:
        found = [row[name] for row in rows if name in row]
        lit = [f for f in found if None not in f["ratio"]]
        if lit:
            off = np.array([[abs(v - 1.0) for v in f["ratio"]] for f in lit])
            above = np.array([f["flip"] - f["floor"] for f in lit])
            print(
                f"{name}: mean radiance off by {100 * np.median(off):.3f} % (median), "
                f"{100 * off.max():.3f} % (worst channel); FLIP above the floor "
                f"{np.median(above):.4f} (median), {above.max():.4f} (worst)"
            )


if __name__ == "__main__":
    main()
