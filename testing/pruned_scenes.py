"""Drawn cfgs on which pruning is put to the proof, and what their stages show."""

from __future__ import annotations

import random
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenec.backends.annotation.annotate import annotate as annotated
from scenec.backends.annotation.lidar import scan
from scenec.backends.exact import ExactCaster
from scenec.backends.registry import open_backend
from scenec.backends.run.session import Session
from scenec.backends.stage.read import read_stage
from scenec.compiler.compile import compile_cfg
from scenec.compiler.views.needed import Keep
from scenec.testing.small import write_cfg

PASSES = ("label", "instance", "depth", "normal", "position")


def drawn_cfg(
    seed: int, folder: Path, outputs: tuple[str, ...] = ("label", "instance")
) -> dict[str, Any]:
    """Hills and craters, low suns, rocks from 5 cm to 10 m, all kinds of views, things that move.

    Every third has land beyond its border, and rocks on it.

    Args:
        seed: Of the draw.
        folder: Receives a table of poses, and shall hold the cfg.
        outputs: Of all sensors.
    """
    pick = random.Random(f"pruned {seed}")
    half = pick.choice([20.0, 40.0])
    relief: list[dict[str, Any]] = [
        {"type": "plane", "slope": [pick.uniform(-0.1, 0.1), pick.uniform(-0.1, 0.1)]},
        {
            "type": "multifractal",
            "amplitude_m": pick.choice([0.2, 2.0, 6.0]),
            "scale_m": pick.uniform(10, 30),
            "octaves": 4,
        },
    ]
    if pick.random() < 0.5:
        relief.append(
            {
                "type": "craters",
                "min_diameter_m": 4,
                "max_diameter_m": 20,
                "density_per_m2": 0.005,
                "depth_ratio": 0.2,
            }
        )
    anywhere = {"type": "uniform", "min": -0.7 * half, "max": 0.7 * half}
    bearing = {"type": "uniform", "min": 0, "max": 360}

    def rig(height: float, distance: float, target: float, fov: float) -> dict[str, Any]:
        sensors = {
            name: {
                "resolution": [pick.choice([24, 40]), pick.choice([16, 30])],
                "fov_deg": fov,
                "outputs": list(outputs),
            }
            for name in ("left", "right")[: pick.choice([1, 2])]
        }
        if len(sensors) == 2:
            sensors["right"]["mount"] = {"position_m": [0.4, 0, 0], "rotation_deg": [0, 35, 0]}
        return {
            "pose": {
                "type": "random_target",
                "position": {"x_m": anywhere, "y_m": anywhere, "height_m": height},
                "target": {"distance_m": distance, "bearing_deg": bearing, "height_m": target},
            },
            "sensors": sensors,
        }

    kinds = {
        "rover": (pick.uniform(0.3, 1.5), 6.0, 0.0, pick.choice([40.0, 70.0])),
        "horizon": (1.0, 50.0, 1.0, 90.0),
        "drone": (pick.uniform(8, 30), 0.5, 0.0, 50.0),
        "wide": (1.2, 5.0, 0.5, pick.choice([150.0, 179.0])),
    }
    chosen = pick.sample(sorted(kinds), pick.choice([1, 1, 2]))
    rocks = {
        "type": "rocks", "material": "stone", "labels": {"class": "rock"}, "prototypes": 3,
        "subdivisions": 1, "clearance_m": 0.05,
    }  # fmt: skip
    rows = ["id,time_s,x_m,y_m,z_m"]
    for log in range(1, 7):
        for time in range(2 if log > 3 else 1):
            x, y = (pick.uniform(-0.7 * half, 0.7 * half) for _ in range(2))
            rows.append(f"{2 * log},{time},{x:.3f},{y:.3f},0")
    (folder / "logs.csv").write_text("\n".join(rows) + "\n", encoding="utf-8")
    cfg: dict[str, Any] = {
        "version": 1,
        "name": "pruned",
        "samples": 2,
        "labels": {"class": {"sky": 1, "ground": 2, "rock": 3, "log": 4}},
        "terrain": {
            "size_m": [2 * half, 1.5 * half],
            "spacing_m": half / 40.0,
            "relief": relief,
            "ground": [{"material": "sand", "labels": {"class": "ground"}}],
        },
        "materials": {
            "sand": {"base_color": [0.4, 0.3, 0.2]},
            "stone": {"base_color": [0.15, 0.12, 0.1], "variation": 0.3},
        },
        "objects": {
            "pebbles": rocks
            | {"count": 400, "size_m": {"type": "uniform", "min": 0.05, "max": 0.4}},
            "boulders": rocks | {"count": 8, "size_m": {"type": "uniform", "min": 1, "max": 10}},
            "logs": {
                "type": "placed",
                "models": [{"file": str(_MODELS / "log.glb")}],
                "labels": {"class": "log"},
                "file": "logs.csv",
            },
        },
        "light": {
            "sun": {
                "elevation_deg": pick.choice([3.0, 10.0, 40.0]),
                "azimuth_deg": bearing,
            },
            "sky": {"type": "clear", "resolution": 32, "labels": {"class": "sky"}},
        },
        "rigs": {name: rig(*kinds[name]) for name in chosen},
    }
    if seed % 3 == 1:
        cfg["terrain"]["horizon"] = {
            "reach_m": 1000, "blend_m": 30, "relief": relief[:2], "material": "sand",
            "labels": {"class": "ground"},
        }  # fmt: skip
        size = {"type": "uniform", "min": 0.3, "max": 8}
        cfg["objects"]["far"] = rocks | {"count": 300, "size_m": size, "beyond_m": 80}
    return cfg


_MODELS = Path(__file__).resolve().parent.parent / "assets" / "models"


def odd_cfg(
    seed: int, folder: Path, outputs: tuple[str, ...] = ("label", "instance")
) -> dict[str, Any]:
    """As ``drawn_cfg``, seen by everything that is no plain camera.

    Bent lenses up to all round, stereo cameras that measure depth, flow to the next sample, lidars,
    and lamps.

    Args:
        seed, folder, outputs: As there.
    """
    pick = random.Random(f"odd {seed}")
    cfg = drawn_cfg(seed, folder, outputs)
    lenses: list[dict[str, Any]] = [
        {"type": "equirectangular"},
        {"type": "kannala_brandt", "k1": 0.02, "k2": -0.004},
        {"type": "brown_conrady", "k1": -0.15, "k2": 0.02, "p1": 0.001},
    ]
    for number, rig in enumerate(cfg["rigs"].values()):
        sensors = rig["sensors"]
        kind = (seed + number) % 4
        if kind < 3:
            lens = lenses[kind]
            bent: dict[str, Any] = {"resolution": [40, 20], "lens": lens, "outputs": list(outputs)}
            if lens["type"] != "equirectangular":
                bent["fov_deg"] = 60.0 if lens["type"] == "brown_conrady" else 170.0
            sensors["bent"] = bent
        else:
            sensors["ranger"] = {
                "resolution": [40, 30],
                "fov_deg": 70.0,
                "outputs": [*outputs, "depth_measured"],
                "depth_camera": {"type": "stereo", "baseline_m": 0.3},
            }
        sensors["left"]["outputs"] = [*outputs, "flow", "occlusion", "flow_backward"]
        rig["lidars"] = {
            "top": {
                "beams": 8,
                "elevation_deg": [5, -25],
                "azimuths": 60,
                "range_m": [0.2, pick.choice([8.0, 60.0])],
                "noise": {"range_m": 0.01, "angle_deg": 0.5},
            }
        }
    if pick.random() < 0.5:
        cfg["light"]["lamps"] = {
            "torch": {
                "intensity": 40,
                "cone_deg": pick.choice([30, 180]),
                "mount": {"type": "rig", "rig": sorted(cfg["rigs"])[0]},
            }
        }
    return cfg


def compiled(folder: Path, cfg: dict[str, Any], keep: Keep, seed: int = 1) -> Path:
    """Compiles a cfg; the folder of its batch."""
    out = folder / str(keep)
    compile_cfg(write_cfg(folder, cfg), seed=seed, out=out, keep=keep)
    return out / "batch_0000"


def annotation(batch: Path) -> Iterator[tuple[str, dict[str, NDArray[Any]]]]:
    """All passes of all frames of a batch, by the exact caster.

    Args:
        batch: Folder of the batch.

    Yields:
        Camera and sample, and the passes.
    """
    scene = read_stage(batch / "stage.usda")
    caster = ExactCaster(scene)
    for sample, cameras in enumerate(scene.cameras):
        caster.pose(sample)
        for camera in cameras:
            shown = annotated(scene, caster, camera, PASSES, sample).arrays
            yield f"{camera.name} {sample}", shown


def everything(batch: Path) -> Iterator[tuple[str, dict[str, NDArray[Any]]]]:
    """All that cameras and lidars say of a batch but color, by the exact caster.

    Args:
        batch: Folder of the batch.

    Yields:
        Sensor and sample, and what it says.
    """
    scene = read_stage(batch / "stage.usda")
    session, caster = Session(scene, None), ExactCaster(scene)
    for sample, cameras in enumerate(scene.cameras):
        for camera in cameras:
            if camera.fires(sample):
                wanted = [name for name in camera.outputs if name != "rgb"]
                passes = session.passes((*wanted, *PASSES), camera)
                yield f"{camera.name} {sample}", session.render(camera, sample, passes, 1, 1).arrays
        caster.pose(sample)
        for lidar in scene.lidars[sample]:
            yield f"{lidar.name} {sample}", scan(scene, caster, lidar, sample)


@dataclass(frozen=True)
class Difference:
    """What pruning changed in the light of surfaces, over blocks of pixels of all frames.

    Attributes:
        paired: Root of the mean square difference, both rendered with the same noise seed, in parts
            of the mean radiance.
        mean: Of all differences, likewise.
        noise: Standard deviation of a block's difference if the seeds were others, likewise.
        z2: Mean square of differences with other seeds, in parts of their own variance: 1 if there
            is nothing but noise.
        control: As ``z2``, of the whole stage and itself: what estimates of variance are off by.
        blocks: How many, with light.
    """

    paired: float
    mean: float
    noise: float
    z2: float
    control: float
    blocks: int


def difference(pruned: Path, whole: Path, spp: int, side: int = 8) -> Difference:
    """Renders two stages of the same views with Mitsuba, and compares.

    Args:
        pruned, whole: Folders of the batches.
        spp: Samples a pixel.
        side: Of the blocks, pixels.
    """
    one, other = _halves(pruned, spp, 1), _halves(whole, spp, 1)
    again = _halves(whole, spp, 101)
    total = sum(float(h.sum()) for h in other) / 2.0
    count = sum(h[0].size for h in other)
    level = max(total / count, 1e-12)
    same, apart, itself, variance = [], [], [], []
    for a, b, c in zip(one, other, again, strict=True):
        mean = [_blocks(h.mean(axis=0), side) for h in (a, b, c)]
        # A block's two halves tell its variance, with one degree of freedom: they are pooled.
        spread = [_blocks(0.5 * (h[0] - h[1]), side) ** 2 for h in (b, c)]
        lit = mean[1] > 0.0
        same.append((mean[0] - mean[1])[lit])
        apart.append((mean[0] - mean[2])[lit])
        itself.append((mean[1] - mean[2])[lit])
        variance.append((spread[0] + spread[1])[lit])
    d, e, f, v = (np.concatenate(x) for x in (same, apart, itself, variance))
    pooled = float(v.mean()) if len(v) else 0.0
    return Difference(
        float(np.sqrt((d * d).mean()) / level),
        float(d.mean() / level),
        float(np.sqrt(pooled) / level),
        float((e * e).mean() / pooled) if pooled > 0.0 else 1.0,
        float((f * f).mean() / pooled) if pooled > 0.0 else 1.0,
        len(d),
    )


def _halves(batch: Path, spp: int, seed: int) -> list[NDArray[np.float64]]:
    scene = read_stage(batch / "stage.usda")
    backend = open_backend("mitsuba")
    backend.load(scene)
    return [
        backend.radiance(camera, sample, spp, seed + sample).halves.astype(np.float64)
        for sample, cameras in enumerate(scene.cameras)
        for camera in cameras
    ]


def _blocks(picture: NDArray[np.float64], side: int) -> NDArray[np.float64]:
    h, w = (n // side for n in picture.shape[:2])
    cut = picture[: h * side, : w * side].reshape(h, side, w, side, 3)
    return np.asarray(cut.mean(axis=(1, 3)))
