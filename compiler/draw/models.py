"""Draws poses of single objects, and reads what models there are."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.arithmetic import elementary
from scenec.compiler.assets.model import origin_of
from scenec.compiler.assets.pose_table import PoseTable, read_poses
from scenec.compiler.distributions.resolve import resolve
from scenec.compiler.draw.scatter import draw_scattered
from scenec.compiler.kinds.context import Context
from scenec.compiler.objects.placed import PlacedPlan, PoseKeys
from scenec.compiler.objects.plan import ModelPlan, ModelSource, PartRule, ScatterPlan
from scenec.compiler.scene.labels import Labels


def draw_meshes(name: str, cfg: Mapping[str, Any], labels: Labels, setting: Context) -> ScatterPlan:
    """The plan of a class of scattered models."""
    path = f"objects/{name}"
    node = resolve(cfg, setting.streams, path)
    return draw_scattered(
        name,
        cfg,
        node,
        labels,
        setting,
        source=ModelSource(
            _models(path, cfg, setting),
            _rules(cfg, setting),
            float(node["variation"]),
            cfg["seat"] == "touch",
        ),
        weights=[float(model["weight"]) for model in cfg["models"]],
        orientation="upright",
        size_key="scale",
    )


def draw_placed(name: str, cfg: Mapping[str, Any], labels: Labels, setting: Context) -> PlacedPlan:
    """The plan of a class of single objects."""
    path = f"objects/{name}"
    if cfg["file"] is not None:
        poses = read_poses(setting.files[f"{path}/file"].path, len(cfg["models"]))
    else:
        poses = _listed(resolve(cfg["poses"], setting.streams, f"{path}/poses"))
    ids, first = np.unique(poses.id, return_index=True)
    bounds = [*first.tolist(), len(poses.id)]
    return PlacedPlan(
        name=name,
        material=cfg["material"],
        labels=labels,
        instances=cfg["instances"],
        models=_models(path, cfg, setting),
        rules=_rules(cfg, setting),
        model=poses.model[first].astype(np.int32),
        ids=ids,
        keys=tuple(
            PoseKeys(
                poses.time_s[a:b], poses.position_m[a:b], poses.quaternion[a:b], poses.scale[a:b]
            )
            for a, b in pairwise(bounds)
        ),
        on_ground=cfg["heights"] == "ground",
        along_normal=cfg["orientation"] == "normal",
        variation=0.0,
    )


def _models(path: str, cfg: Mapping[str, Any], setting: Context) -> tuple[ModelPlan, ...]:
    files = [setting.files[f"{path}/models/{i}/file"].path for i in range(len(cfg["models"]))]
    return tuple(
        ModelPlan(file, node["unit_m"], node["up"], node["part"], origin_of(node["origin"]))
        for file, node in zip(files, cfg["models"], strict=True)
    )


def _rules(cfg: Mapping[str, Any], setting: Context) -> tuple[PartRule, ...]:
    return tuple(
        PartRule(
            name,
            node["material"],
            {level: setting.label_table[level][own] for level, own in node["labels"].items()},
        )
        for name, node in cfg["parts"].items()
    )


def _listed(nodes: Sequence[Mapping[str, Any]]) -> PoseTable:
    count = len(nodes)
    return PoseTable(
        id=np.arange(1, count + 1),
        time_s=np.zeros(count),
        position_m=np.array([[node[key] for key in ("x_m", "y_m", "z_m")] for node in nodes]),
        quaternion=np.array([quaternion_of(node["rotation_deg"]) for node in nodes]),
        scale=np.array([float(node["scale"]) for node in nodes]),
        model=np.array([node["model"] for node in nodes], np.int64),
    )


def quaternion_of(degrees: Sequence[float]) -> NDArray[np.float64]:
    """Turns about x, y, z in turn (fixed axes) as a unit quaternion (w, x, y, z), [4]."""
    out = np.array([1.0, 0.0, 0.0, 0.0])
    for axis, angle in enumerate(degrees):
        half = 0.5 * angle * elementary.PI / 180.0
        s = elementary.sin(half)
        turn = np.array([elementary.cos(half), 0.0, 0.0, 0.0])
        turn[1 + axis] = s
        out = multiplied(turn, out)
    return out


def multiplied(a: NDArray[np.float64], b: NDArray[np.float64]) -> NDArray[np.float64]:
    """The product of two quaternions (w, x, y, z): the turn b, then a, [4]."""
    w, x, y, z = a
    v, i, j, k = b
    return np.array(
        [
            w * v - x * i - y * j - z * k,
            w * i + x * v + y * k - z * j,
            w * j - x * k + y * v + z * i,
            w * k + x * j - y * i + z * v,
        ]
    )
