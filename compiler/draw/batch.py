"""Draws the Plan of a batch: every number; after that nothing is random."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

from scenec.compiler.cameras.paths.motion import Motion
from scenec.compiler.cameras.plan import RigPlan
from scenec.compiler.cfg.fill import Cfg
from scenec.compiler.cfg.load import Spec
from scenec.compiler.distributions.resolve import resolve
from scenec.compiler.distributions.streams import Streams
from scenec.compiler.draw.ground import draw_mask, draw_merges, draw_shades
from scenec.compiler.draw.models import draw_meshes, draw_placed
from scenec.compiler.draw.of_keys import of_keys
from scenec.compiler.draw.paths import draw_motion, draw_random_target, draw_track
from scenec.compiler.draw.rocks import draw_rocks
from scenec.compiler.draw.sensors import draw_lidar, draw_sensor
from scenec.compiler.kinds.context import Context
from scenec.compiler.kinds.draw import draw_kind
from scenec.compiler.light.plan import draw_light
from scenec.compiler.materials.displacement import displacement_of
from scenec.compiler.materials.material import draw_materials
from scenec.compiler.materials.plan import MaterialPlan
from scenec.compiler.mesh.mesh import Meshing
from scenec.compiler.mesh.plan import HorizonPlan, TerrainPlan
from scenec.compiler.objects.placed import PlacedPlan
from scenec.compiler.objects.plan import ScatterPlan
from scenec.compiler.plan import Plan
from scenec.compiler.scene.ground import GroundLayer
from scenec.compiler.scene.labels import Labels
from scenec.compiler.terrain.detail import Detail, Sum
from scenec.compiler.terrain.mask import Masked
from scenec.compiler.terrain.operator import OPERATORS, ReliefOperator
from scenec.compiler.terrain.operators.barchans import draw_barchans
from scenec.compiler.terrain.operators.footprints import draw_footprints
from scenec.compiler.terrain.sources.mesh_base import Roughness

_DECLARED = ("craters", "multifractal")
#: Relief operators that are many things, each drawn.
_SCATTERED: dict[str, Callable[..., ReliefOperator]] = {
    "barchans": draw_barchans,
    "footprints": draw_footprints,
}
#: Samples across the relief of a horizon that says nothing of them.
HORIZON_SAMPLES = 256
#: How each kind of objects is drawn.
_CLASSES: dict[str, Callable[..., ScatterPlan | PlacedPlan]] = {
    "rocks": draw_rocks,
    "meshes": draw_meshes,
    "placed": draw_placed,
}


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
    materials = draw_materials(cfg, Context(streams, files=spec.files))
    terrain, setting = _terrain(spec, streams, materials)
    return Plan(
        name=cfg["name"],
        batch=batch,
        samples=samples,
        label_table=cfg["labels"],
        sky_labels=label_ids(cfg, sky.get("labels") or {}),
        sky_labels_below={
            level: cfg["labels"][level][name] for level, name in sky.get("labels_below", {}).items()
        },
        materials=materials,
        terrain=terrain,
        objects=tuple(
            _CLASSES[node["type"]](name, node, label_ids(cfg, node["labels"]), setting)
            for name, node in cfg["objects"].items()
        ),
        object_triangles=cfg["object_detail"]["max_triangles"],
        light=draw_light(cfg["light"], setting),
        rigs=tuple(_rig(spec, name, setting) for name in cfg["rigs"]),
    )


def label_ids(cfg: Cfg, choice: dict[str, str]) -> Labels:
    """Label ids of a choice of names, on every level; 0 where it chooses none."""
    return {
        level: table[choice[level]] if level in choice else 0
        for level, table in cfg["labels"].items()
    }


def _terrain(
    spec: Spec, streams: Streams, materials: dict[str, MaterialPlan]
) -> tuple[TerrainPlan, Context]:
    """Relief and ground, and the setting of what stands on them."""
    cfg = spec.cfg["terrain"]
    node = resolve({key: cfg[key] for key in ("size_m", "spacing_m", "ground")}, streams, "terrain")
    layers = tuple(
        GroundLayer(
            layer["material"],
            label_ids(spec.cfg, layer["labels"]),
            # The base lies over nothing.
            layer.get("height_blend", 0.0),
        )
        for layer in node["ground"]
    )
    size_m = (node["size_m"][0], node["size_m"][1])
    setting = Context(
        streams, size_m, spec.files, node["ground"], (), spec.cfg["labels"],
        samples=int(spec.cfg["samples"]),
    )  # fmt: skip
    relief: tuple[ReliefOperator, ...] = ()
    for i, operator in enumerate(cfg["relief"]):
        relief = (*relief, _relief(operator, f"terrain/relief/{i}", setting))
        setting = replace(setting, relief=relief)
    merges, coverage = draw_merges(setting)
    plan = TerrainPlan(
        size_m=size_m,
        spacing_m=node["spacing_m"],
        relief=relief,
        layers=layers,
        merges=merges,
        coverage=coverage,
        variation_key=streams.key("terrain/variation"),
        meshing=Meshing(
            # 0 asks for the grid as it is.
            tolerance_px=cfg["mesh"]["tolerance_px"] or None,
            max_triangles=cfg["mesh"]["max_triangles"],
            unseen=cfg["mesh"]["unseen"],
            finest_m=cfg["mesh"]["finest_m"],
        ),
        displacements=tuple(
            _displacement(spec, layer["material"], materials[layer["material"]], setting)
            for layer in node["ground"]
        ),
        horizon=_horizon(spec, setting) if "horizon" in cfg else None,
        shades=draw_shades(cfg.get("shades", ()), setting),
    )
    return plan, setting


def _horizon(spec: Spec, setting: Context) -> HorizonPlan:
    """What lies around the terrain; its relief is as wide as it."""
    cfg, path = spec.cfg["terrain"]["horizon"], "terrain/horizon"
    node = resolve({k: v for k, v in cfg.items() if k != "relief"}, setting.streams, path)
    east, north = (size + 2.0 * node["reach_m"] for size in setting.size_m)
    setting = replace(setting, size_m=(east, north), relief=())
    relief: tuple[ReliefOperator, ...] = ()
    for i, operator in enumerate(cfg["relief"]):
        relief = (*relief, _relief(operator, f"{path}/relief/{i}", setting))
        setting = replace(setting, relief=relief)
    return HorizonPlan(
        node["reach_m"],
        node["spacing_m"] or max(east, north) / HORIZON_SAMPLES,
        node["blend_m"],
        relief,
        GroundLayer(node["material"], label_ids(spec.cfg, node["labels"])),
    )


def _displacement(
    spec: Spec, material: str, surface: MaterialPlan, setting: Context
) -> Detail | None:
    """What a ground material adds to the relief, at any fineness."""
    path = f"materials/{material}/displacement"
    parts: list[Detail] = []
    for i, node in enumerate(spec.cfg["materials"][material]["displacement"] or []):
        if node["type"] in _DECLARED:
            made = draw_kind("displacement", node, f"{path}/{i}", setting)
        else:
            drawn = resolve(node, setting.streams, f"{path}/{i}")
            made = of_keys(OPERATORS, drawn, f"{path}/{i}", setting)
        parts.append(made.everywhere())
    pictured = displacement_of(surface)
    if pictured is not None:
        parts.append(pictured)
    return Sum(tuple(parts)) if parts else None


def _relief(cfg: Mapping[str, Any], path: str, setting: Context) -> ReliefOperator:
    """One operator: its keys in the cfg are the fields of its class, but for scattered ones."""
    streams, cfg = setting.streams, dict(cfg)
    mask = cfg.pop("mask")
    operator: ReliefOperator
    if cfg["type"] in _DECLARED:
        operator = draw_kind("relief", cfg, path, setting)
    elif cfg["type"] in _SCATTERED:
        operator = _SCATTERED[cfg["type"]](cfg, streams, path, setting.size_m)
    else:
        node = resolve(cfg, streams, path)
        if isinstance(node.get("pixel_m"), float):
            # One number stands for square pixels.
            node["pixel_m"] = [node["pixel_m"]] * 2
        if isinstance(node.get("roughness"), dict):
            node["roughness"] = Roughness(streams.key(f"{path}/roughness"), **node["roughness"])
        operator = of_keys(OPERATORS, node, path, setting)
    if mask is None:
        return operator
    path = f"{path}/mask"
    return Masked(operator, draw_mask(resolve(mask, streams, path), path, setting))


def _rig(spec: Spec, name: str, setting: Context) -> RigPlan:
    cfg, streams = spec.cfg["rigs"][name], setting.streams
    samples = int(spec.cfg["samples"])
    path = f"rigs/{name}/pose"
    pose: Motion
    if cfg["pose"]["type"] == "track":
        opened = any("shutter" in sensor for sensor in cfg["sensors"].values())
        pose = draw_track(spec, cfg["pose"], path, streams, samples, opened)
    elif cfg["pose"]["type"] == "random_target":
        pose = draw_random_target(cfg["pose"], path, streams, samples)
    else:
        pose = draw_motion(cfg["pose"], path, setting)
    sensors = tuple(
        draw_sensor(sensor, node, f"rigs/{name}/sensors/{sensor}", streams, samples)
        for sensor, node in cfg["sensors"].items()
    )
    lidars = tuple(
        draw_lidar(lidar, node, f"rigs/{name}/lidars/{lidar}", streams)
        for lidar, node in cfg.get("lidars", {}).items()
    )
    return RigPlan(name, pose, sensors, lidars, cfg.get("allow_below", False))
