"""Draws the terrain: its relief, the layers of its ground, and the land beyond its border."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from functools import cache

from scenec.compiler.distributions.resolve import resolve
from scenec.compiler.kinds import Context, draw_kind, draw_object
from scenec.compiler.mesh.cover import MaterialCondition
from scenec.compiler.mesh.merge import Merge
from scenec.compiler.mesh.mesh import Meshing
from scenec.compiler.mesh.plan import HorizonPlan, TerrainPlan
from scenec.compiler.scene.ground import GroundLayer
from scenec.compiler.terrain.condition import Interval, ReliefCondition, draw_condition
from scenec.compiler.terrain.detail import Detail
from scenec.compiler.terrain.grid import Grid
from scenec.compiler.terrain.mask import Masked
from scenec.compiler.terrain.operator import ReliefOperator
from scenec.compiler.terrain.shade import Shade
from scenec.compiler.terrain.sources.dem import georeference_of
from scenec.schemas.codec import JsonObject

#: Samples across the relief of a horizon that says nothing of them.
HORIZON_SAMPLES = 256


def draw_terrain(
    cfg: JsonObject, context: Context, displacements: Iterable[Detail | None]
) -> tuple[TerrainPlan, Context]:
    """Returns the terrain, and the context of what stands on it.

    Args:
        displacements: What the material of each ground layer adds to the relief.
    """
    streams = context.streams
    node = resolve({key: cfg[key] for key in ("size_m", "spacing_m", "ground")}, streams, "terrain")
    size_m = (node["size_m"][0], node["size_m"][1])
    spacing_m = node["spacing_m"]
    context = replace(context, size_m=size_m, spacing_m=spacing_m, ground=node["ground"])
    context = _on_relief(cfg["relief"], "terrain/relief", context)
    relief, grid = context.relief, Grid.with_spacing(size_m, spacing_m)
    # Few ask, and DEMs are read for it.
    context = replace(context, georeference=cache(lambda: georeference_of(relief, grid)))
    merges, coverage = draw_merges(context)
    plan = TerrainPlan(
        size_m=size_m,
        spacing_m=spacing_m,
        relief=tuple(context.relief),
        layers=tuple(
            GroundLayer(
                layer["material"],
                context.label_ids(layer["labels"]),
                # The base lies over nothing.
                layer.get("height_blend", 0.0),
            )
            for layer in node["ground"]
        ),
        merges=merges,
        coverage=coverage,
        variation_key=streams.key("terrain/variation"),
        # 0 asks for the grid as it is.
        meshing=Meshing(**{**cfg["mesh"], "tolerance_px": cfg["mesh"]["tolerance_px"] or None}),
        displacements=tuple(displacements),
        horizon=_horizon(cfg["horizon"], context) if "horizon" in cfg else None,
        shades=tuple(
            Shade(
                resolve(shade["by"], streams, f"terrain/shades/{i}/by"),
                _where(shade["where"], f"terrain/shades/{i}/where", context),
            )
            for i, shade in enumerate(cfg.get("shades", ()))
        ),
        planet=draw_object("terrain_planet", cfg["planet"], "terrain/planet", context)
        if "planet" in cfg
        else None,
    )
    return plan, context


def _horizon(cfg: JsonObject, context: Context) -> HorizonPlan:
    """Returns what lies around the terrain; its relief is as wide as it."""
    path = "terrain/horizon"
    node = resolve({k: v for k, v in cfg.items() if k != "relief"}, context.streams, path)
    east, north = (size + 2.0 * node["reach_m"] for size in context.size_m)
    spacing_m = node["spacing_m"] or max(east, north) / HORIZON_SAMPLES
    context = replace(context, size_m=(east, north), spacing_m=spacing_m, relief=())
    return HorizonPlan(
        node["reach_m"],
        spacing_m,
        node["blend_m"],
        tuple(_on_relief(cfg["relief"], f"{path}/relief", context).relief),
        GroundLayer(node["material"], context.label_ids(node["labels"])),
    )


def _on_relief(nodes: Sequence[JsonObject], path: str, context: Context) -> Context:
    """Returns the context with a relief: each operator is drawn from those before it."""
    for i, node in enumerate(nodes):
        own = {key: value for key, value in node.items() if key != "mask"}
        operator: ReliefOperator = draw_kind("relief", own, f"{path}/{i}", context)
        if node["mask"] is not None:
            operator = Masked(operator, _mask(node["mask"], f"{path}/{i}/mask", context))
        context = replace(context, relief=(*context.relief, operator))
    return context


def _mask(nodes: Sequence[JsonObject], path: str, context: Context) -> tuple[ReliefCondition, ...]:
    """Returns the mask of an operator."""
    context = replace(context, choice="relief_mask")
    return tuple(
        MaterialCondition(context.layers_of(node), *draw_merges(context))
        if node["type"] == "material"
        else draw_condition(node, context.at(f"{path}/{i}"))
        for i, node in enumerate(nodes)
    )


def _where(nodes: Sequence[JsonObject], path: str, context: Context) -> tuple[Interval, ...]:
    """Returns conditions on where a layer lies, or a shade."""
    context = replace(context, choice="ground_where")
    return tuple(draw_condition(node, context.at(f"{path}/{i}")) for i, node in enumerate(nodes))


def draw_merges(context: Context) -> tuple[tuple[Merge, ...], tuple[float | None, ...]]:
    """Returns a merge for each layer after the base, and the part of the terrain it shall cover."""
    merges, coverage = [], []
    for i, layer in enumerate(context.ground[1:], start=1):
        path = f"terrain/ground/{i}"
        # Without a noise its numbers mean nothing.
        noise = layer["noise"] or {
            "scale_m": 1.0, "octaves": 0, "gain": 0.0, "lacunarity": 1.0, "distortion": 0.0
        }  # fmt: skip
        merges.append(
            Merge(
                key=context.streams.key(f"{path}/noise"),
                **noise,
                sharpness=layer["sharpness"],
                # Coverage is met at weight 1/2; the cfg gives one of the two.
                threshold=0.5 if layer["threshold"] is None else layer["threshold"],
                noisy=layer["noise"] is not None,
                where=_where(layer["where"] or (), f"{path}/where", context),
            )
        )
        coverage.append(layer["coverage"])
    return tuple(merges), tuple(coverage)
