"""Draws noise keys of ground layers, and of the conditions on where they lie."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

from scenec.compiler.distributions.resolve import resolve
from scenec.compiler.kinds.context import Context
from scenec.compiler.mesh.cover import MaterialCondition
from scenec.compiler.mesh.merge import Merge
from scenec.compiler.terrain.condition import Condition, draw_condition
from scenec.compiler.terrain.shade import Shade


def draw_merges(setting: Context) -> tuple[tuple[Merge, ...], tuple[float | None, ...]]:
    """One merge for each layer after the base, and the part of the terrain each shall cover."""
    setting = replace(setting, choice="ground_where")
    merges, coverage = [], []
    for i, layer in enumerate(setting.ground[1:], start=1):
        path = f"terrain/ground/{i}"
        # Without a noise its numbers mean nothing.
        noise = layer["noise"] or {
            "scale_m": 1.0, "octaves": 0, "gain": 0.0, "lacunarity": 1.0, "distortion": 0.0
        }  # fmt: skip
        merges.append(
            Merge(
                key=setting.streams.key(f"{path}/noise"),
                **noise,
                sharpness=layer["sharpness"],
                # Coverage is met at weight 1/2; the cfg gives one of the two.
                threshold=0.5 if layer["threshold"] is None else layer["threshold"],
                noisy=layer["noise"] is not None,
                where=tuple(
                    draw_condition(node, setting.at(f"{path}/where/{k}"))
                    for k, node in enumerate(layer["where"] or ())
                ),
            )
        )
        coverage.append(layer["coverage"])
    return tuple(merges), tuple(coverage)


def draw_shades(shades: Sequence[Mapping[str, Any]], setting: Context) -> tuple[Shade, ...]:
    """Where the ground is darker or lighter."""
    setting, drawn = replace(setting, choice="ground_where"), []
    for i, node in enumerate(shades):
        path = f"terrain/shades/{i}"
        resolved = resolve(node, setting.streams, path)
        where = [
            draw_condition(condition, setting.at(f"{path}/where/{k}"))
            for k, condition in enumerate(resolved["where"])
        ]
        drawn.append(Shade(resolved["by"], tuple(where)))
    return tuple(drawn)


def draw_mask(
    mask: Sequence[Mapping[str, Any]], path: str, setting: Context
) -> tuple[Condition, ...]:
    """The mask of an operator."""
    setting = replace(setting, choice="relief_mask")
    conditions: list[Condition] = []
    for i, node in enumerate(mask):
        if node["type"] == "material":
            conditions.append(MaterialCondition(setting.layers_of(node), *draw_merges(setting)))
            continue
        conditions.append(draw_condition(node, setting.at(f"{path}/{i}")))
    return tuple(conditions)
