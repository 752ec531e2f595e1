"""Draws the Plan of a batch: every number; after that nothing is random."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from scenec.compiler.cameras.plan import RigPlan
from scenec.compiler.cfg.load import Spec
from scenec.compiler.distributions.streams import Streams
from scenec.compiler.kinds import Context, draw_kind, draw_object
from scenec.compiler.light.plan import draw_light
from scenec.compiler.materials.displacement import draw_displacement
from scenec.compiler.materials.material import draw_materials
from scenec.compiler.mesh.ground import draw_terrain
from scenec.compiler.plan import Plan


def draw(spec: Spec, seed: int, batch: int, attempt: int = 0) -> Plan:
    """The plan of one batch.

    Each number's stream is named by its place in the cfg, so a change in one place leaves what is
    drawn for every other as it was.

    Args:
        seed: 0 <= seed < 2**64.

    Raises:
        ScenecError: The seed is out of range.
        SceneError: What is drawn makes no scene.
    """
    streams = Streams(seed, batch, attempt)
    cfg, samples = spec.cfg, int(spec.cfg["samples"])
    sky = cfg["light"]["sky"] or {}
    context = Context(streams, files=spec.files, label_table=cfg["labels"], samples=samples)
    materials = draw_materials(cfg, context)
    lying = [layer["material"] for layer in cfg["terrain"]["ground"]]
    displacements = (
        draw_displacement(cfg["materials"][name]["displacement"], name, materials[name], context)
        for name in lying
    )
    terrain, setting = draw_terrain(cfg["terrain"], context, displacements)
    return Plan(
        name=cfg["name"],
        batch=batch,
        samples=samples,
        label_table=cfg["labels"],
        sky_labels=setting.label_ids(sky.get("labels") or {}),
        sky_labels_below={
            level: cfg["labels"][level][name] for level, name in sky.get("labels_below", {}).items()
        },
        materials=materials,
        terrain=terrain,
        objects=tuple(
            draw_kind("objects", node, f"objects/{name}", setting)
            for name, node in cfg["objects"].items()
        ),
        object_triangles=cfg["object_detail"]["max_triangles"],
        light=draw_light(cfg["light"], setting),
        rigs=tuple(_rig(spec, name, setting) for name in cfg["rigs"]),
    )


def _rig(spec: Spec, name: str, setting: Context) -> RigPlan:
    cfg = spec.cfg["rigs"][name]
    opened = "imus" in cfg or any("shutter" in sensor for sensor in cfg["sensors"].values())
    pose = draw_kind("pose", cfg["pose"], f"rigs/{name}/pose", replace(setting, between=opened))
    sensors = _carried("sensor", cfg["sensors"], f"rigs/{name}/sensors", setting)
    lidars = _carried("lidar", cfg.get("lidars", {}), f"rigs/{name}/lidars", setting)
    imus = _carried("imu", cfg.get("imus", {}), f"rigs/{name}/imus", setting)
    return RigPlan(name, pose, sensors, lidars, cfg.get("allow_below", False), imus)


def _carried(kind: str, nodes: Mapping[str, Any], path: str, setting: Context) -> tuple[Any, ...]:
    """Sensors, lidars or IMUs of a rig, drawn."""
    return tuple(
        draw_object(kind, node, f"{path}/{name}", setting).draw(setting.at(f"{path}/{name}"))
        for name, node in nodes.items()
    )
