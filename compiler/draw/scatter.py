"""Draws any class of scattered objects, whatever its prototypes are."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.arithmetic import elementary
from scenec.compiler.distributions.laws import golombek_rapp_per_m2, pick
from scenec.compiler.distributions.numbers import Distribution, draw_number
from scenec.compiler.distributions.streams import Streams
from scenec.compiler.kinds.context import Context
from scenec.compiler.kinds.draw import draw_kind
from scenec.compiler.objects.conditions import (
    OffTerrain,
    OnMaterial,
    OnRelief,
    PlacementCondition,
)
from scenec.compiler.objects.feet import FilletPlan
from scenec.compiler.objects.plan import Count, ModelSource, RockShapes, ScatterPlan, Spacing
from scenec.compiler.scene.labels import Labels
from scenec.compiler.terrain.condition import draw_condition
from scenec.schemas.errors import SceneError

#: Objects of one class at most.
MOST_OBJECTS = 100_000_000

Orientation = Literal["random", "upright", "normal"]
#: Of prototypes, int32 [n], and uniform numbers, [n, 3]: turns about the vertical, in whole ones.
Turn = Callable[[NDArray[np.int32], NDArray[np.float64]], NDArray[np.float64]]


def draw_scattered(
    name: str,
    cfg: Mapping[str, Any],
    node: Mapping[str, Any],
    labels: Labels,
    setting: Context,
    *,
    source: RockShapes | ModelSource,
    weights: Sequence[float],
    orientation: Orientation,
    size_key: str,
    turn: Turn | None = None,
) -> ScatterPlan:
    """The plan of one class.

    Args:
        cfg: Its part of the cfg; the keys of ``objects_scattered.schema.json`` are read.
        orientation: Where the cfg gives none.
        size_key: The key of the cfg that gives each instance's scale.
        turn: How instances stand that are not turned at random; None: in all directions alike.

    Raises:
        SceneError: There would be too many objects.
    """
    path, streams = f"objects/{name}", setting.streams
    beyond: float = node["beyond_m"] or 0.0
    where: tuple[PlacementCondition, ...] = ()
    if beyond:
        where = (OffTerrain((0.5 * setting.size_m[0], 0.5 * setting.size_m[1])),)
        wide, deep = (size + 2.0 * beyond for size in setting.size_m)
        setting = replace(setting, size_m=(wide, deep))
    count = _count(path, cfg, node, streams, size_key)
    n = _most(path, count, setting)
    turned = cfg["orientation"] or orientation
    prototype = pick(streams.uniforms(f"{path}/prototype", n), weights).astype(np.int32)
    u = uniforms(streams, f"{path}/orientation", n, 3)
    if turned == "random":
        orientations = _random_turns(u)
    else:
        orientations = _spins(u[:, 0] if turn is None else turn(prototype, u))
    if cfg["lean_deg"] is not None:
        lean = draw_number(cfg["lean_deg"], streams, f"{path}/lean_deg", n)
        orientations = _leaned(orientations, lean, streams.uniforms(f"{path}/lean_side", n))
    apart = node["apart"]
    return ScatterPlan(
        name=name,
        material=cfg["material"],
        labels=labels,
        instances=cfg["instances"],
        source=source,
        count=count,
        density=draw_kind("density", node["density"], f"{path}/density", setting),
        where=(
            *where,
            *(
                _place(condition, f"{path}/where/{i}", setting)
                for i, condition in enumerate(node["where"])
            ),
        ),
        spacing=apart and Spacing(apart["gap_m"], apart["radius"], tuple(apart["of"] or (name,))),
        fewer=cfg["shortfall"] == "fewer",
        clearance_m=cfg["clearance_m"],
        place_key=streams.key(f"{path}/place"),
        position_u=uniforms(streams, f"{path}/position", n, 3),
        prototype=prototype,
        orientations=orientations,
        align=turned == "normal",
        scale=draw_number(cfg[size_key], streams, f"{path}/{size_key}", n).astype(np.float64),
        embed=draw_number(cfg["embed"], streams, f"{path}/embed", n).astype(np.float64),
        variation=2.0 * streams.uniforms(f"{path}/variation", n) - 1.0,
        lod_px=cfg["lod_px"],
        beyond_m=beyond,
        fillet=_fillet(cfg.get("fillet"), f"{path}/fillet", streams, n),
    )


def _fillet(
    cfg: Mapping[str, Any] | None, path: str, streams: Streams, n: int
) -> FilletPlan | None:
    if cfg is None:
        return None
    height, reach = (
        draw_number(cfg[key], streams, f"{path}/{key}", n).astype(np.float64)
        for key in ("height", "reach")
    )
    return FilletPlan(height, reach, streams.key(path))


def uniforms(streams: Streams, path: str, n: int, columns: int) -> NDArray[np.float64]:
    """[n, columns]; a larger n leaves the first rows as they are."""
    return streams.uniforms(path, n * columns).reshape(n, columns)


def _count(
    path: str, cfg: Mapping[str, Any], node: Mapping[str, Any], streams: Streams, size_key: str
) -> Count:
    if node["count"] is not None:
        return Count(int(node["count"]), None, 0.0)
    rounding = float(streams.uniforms(f"{path}/count_rounding", 1)[0])
    per_m2 = node["per_m2"]
    if per_m2 is None:
        size = cfg[size_key]
        assert isinstance(size, Distribution)
        per_m2 = golombek_rapp_per_m2(size.min, size.max, size.shape)
    return Count(None, float(per_m2), rounding)


def _most(path: str, count: Count, setting: Context) -> int:
    """How many there can be: ``where`` only takes some away."""
    most = count.exact
    if most is None:
        assert count.per_m2 is not None
        expected = count.per_m2 * setting.size_m[0] * setting.size_m[1]
        if not expected <= MOST_OBJECTS:
            raise SceneError(
                f"{path}: {count.per_m2:.3g} per m^2 on {setting.size_m[0]:g} m by "
                f"{setting.size_m[1]:g} m are {expected:.3g} objects, at most {MOST_OBJECTS:,} are "
                "taken; lower per_m2, or raise the smallest size"
            )
        most = int(expected + count.rounding_u)
    return most


def _place(node: Mapping[str, Any], path: str, setting: Context) -> PlacementCondition:
    if node["type"] == "material":
        return OnMaterial(setting.layers_of(node))
    if node["type"] in ("camera", "object"):
        made: PlacementCondition = draw_kind("objects_where", node, path, setting)
        return made
    return OnRelief(draw_condition(node, replace(setting, path=path, choice="objects_where")))


def _random_turns(u: NDArray[np.float64]) -> NDArray[np.float64]:
    """Rotations uniform over SO(3) (Shoemake 1992), as quaternions (x, y, z, w), [n, 4]."""
    a, b = 2.0 * elementary.PI * u[:, 1], 2.0 * elementary.PI * u[:, 2]
    p, q = np.sqrt(1.0 - u[:, 0]), np.sqrt(u[:, 0])
    return np.stack(
        [
            p * elementary.sin_array(a),
            p * elementary.cos_array(a),
            q * elementary.sin_array(b),
            q * elementary.cos_array(b),
        ],
        axis=1,
    )


def _spins(turns: NDArray[np.float64]) -> NDArray[np.float64]:
    """Rotations about the vertical, as quaternions (x, y, z, w), [n, 4]."""
    half = elementary.PI * turns
    zero = np.zeros(len(turns))
    return np.stack([zero, zero, elementary.sin_array(half), elementary.cos_array(half)], axis=1)


def _leaned(
    spins: NDArray[np.float64], lean_deg: NDArray[np.float64], u: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Spins about the vertical, followed by a turn about a horizontal axis.

    Args:
        spins: Quaternions (0, 0, z, w), float64 [n, 4].
        lean_deg: By how much, float64 [n].
        u: Uniform in [0, 1): toward which side, float64 [n].
    """
    half = lean_deg * (elementary.PI / 360.0)
    side = 2.0 * elementary.PI * u
    sine, cosine = elementary.sin_array(half), elementary.cos_array(half)
    ax, ay = sine * elementary.cos_array(side), sine * elementary.sin_array(side)
    z, w = spins[:, 2], spins[:, 3]
    return np.stack([ax * w + ay * z, ay * w - ax * z, cosine * z, cosine * w], axis=1)
