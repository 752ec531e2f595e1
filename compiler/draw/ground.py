"""Draws noise keys of ground layers, and of the conditions on where they lie."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from scenec.compiler.distributions.resolve import resolve
from scenec.compiler.draw.of_keys import of_keys, ragged_of
from scenec.compiler.kinds.context import Context
from scenec.compiler.mesh.cover import MaterialCondition
from scenec.compiler.mesh.merge import Merge
from scenec.compiler.terrain.condition import QUANTITIES, Condition, Interval
from scenec.compiler.terrain.shade import Shade


def draw_merges(setting: Context) -> tuple[tuple[Merge, ...], tuple[float | None, ...]]:
    """One merge for each layer after the base, and the part of the terrain each shall cover."""
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
                    draw_condition(node, f"{path}/where/{k}", setting)
                    for k, node in enumerate(layer["where"] or ())
                ),
            )
        )
        coverage.append(layer["coverage"])
    return tuple(merges), tuple(coverage)


def draw_shades(shades: Sequence[Mapping[str, Any]], setting: Context) -> tuple[Shade, ...]:
    """Where the ground is darker or lighter."""
    drawn = []
    for i, node in enumerate(shades):
        path = f"terrain/shades/{i}"
        resolved = resolve(node, setting.streams, path)
        where = [
            draw_condition(condition, f"{path}/where/{k}", setting)
            for k, condition in enumerate(resolved["where"])
        ]
        drawn.append(Shade(resolved["by"], tuple(where)))
    return tuple(drawn)


def draw_condition(node: Mapping[str, Any], path: str, setting: Context) -> Interval:
    """One condition: its bounds, and a quantity whose fields are its other keys."""
    kind, rest = QUANTITIES[node["type"]], dict(node)
    # Their names end with the unit.
    low, high, softness = (
        rest.pop(next(key for key in node if key.partition("_")[0] == name))
        for name in ("min", "max", "softness")
    )
    low, high = (None if bound is None else kind.of_bound(bound) for bound in (low, high))
    ragged = ragged_of(rest.pop("ragged"), setting.streams, path)
    return Interval(of_keys(QUANTITIES, rest, path, setting), low, high, softness, ragged)


def draw_mask(
    mask: Sequence[Mapping[str, Any]], path: str, setting: Context
) -> tuple[Condition, ...]:
    """The mask of an operator."""
    conditions: list[Condition] = []
    for i, node in enumerate(mask):
        if node["type"] == "material":
            conditions.append(MaterialCondition(setting.layers_of(node), *draw_merges(setting)))
            continue
        if node["type"] == "slope" and node["over_m"] is None:
            # An operator asks for the slope of the heights as they are.
            node = {**node, "over_m": 0.0}
        conditions.append(draw_condition(node, f"{path}/{i}", setting))
    return tuple(conditions)
