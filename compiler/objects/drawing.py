"""Draws any class of scattered objects, whatever its prototypes are."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.arithmetic import elementary
from scenec.compiler.distributions.laws import golombek_rapp_per_m2, pick
from scenec.compiler.distributions.numbers import Distribution, Number, draw_number
from scenec.compiler.kinds import Context, draw_kind
from scenec.compiler.objects.conditions import OffTerrain, OnMaterial, OnRelief, PlacementCondition
from scenec.compiler.objects.families.shape import Turn
from scenec.compiler.objects.plan import ModelSource, ObjectCount, RockShapes, ScatterPlan
from scenec.compiler.objects.scattered import Scattered
from scenec.compiler.terrain.condition import draw_condition
from scenec.schemas.codec import JsonObject
from scenec.schemas.errors import SceneError

#: Objects of one class at most.
MOST_OBJECTS = 100_000_000


def draw_scattered(
    law: Scattered,
    context: Context,
    *,
    material: str | None,
    source: RockShapes | ModelSource,
    weights: Sequence[float],
    orientation: Literal["random", "upright", "normal"],
    size_key: str,
    turn: Turn | None = None,
) -> ScatterPlan:
    """Returns what is drawn of a class of scattered objects, whatever its prototypes are.

    Args:
        law: What the cfg says of it.
        orientation: Where the cfg gives none.
        size_key: The key that gives each instance's scale.
        turn: How instances stand that are not turned at random; None: in all directions alike.

    Raises:
        SceneError: There would be too many objects.
    """
    path, streams = context.path, context.streams
    beyond = law.beyond_m or 0.0
    where: tuple[PlacementCondition, ...] = ()
    if beyond:
        where = (OffTerrain((0.5 * context.size_m[0], 0.5 * context.size_m[1])),)
        wide, deep = (size + 2.0 * beyond for size in context.size_m)
        context = replace(context, size_m=(wide, deep))
    size: Number = getattr(law, size_key)
    count, n = _counted(law, size, context)

    def each(key: str, number: Number) -> NDArray[np.float64]:
        return draw_number(number, streams, f"{path}/{key}", n).astype(np.float64)

    turned = law.orientation or orientation
    prototype = pick(streams.uniforms(f"{path}/prototype", n), weights).astype(np.int32)
    u = context.uniforms("orientation", n, 3)
    if turned == "random":
        orientations = _random_turns(u)
    else:
        orientations = _spins(u[:, 0] if turn is None else turn(prototype, u))
    if law.lean_deg is not None:
        lean = each("lean_deg", law.lean_deg)
        orientations = _leaned(orientations, lean, streams.uniforms(f"{path}/lean_side", n))
    return ScatterPlan(
        name=path.rpartition("/")[2],
        material=material,
        labels=context.label_ids(law.labels),
        instances=law.instances,
        source=source,
        count=count,
        density=draw_kind("density", law.density, f"{path}/density", context),
        where=(
            *where,
            *(_place(own, f"{path}/where/{i}", context) for i, own in enumerate(law.where)),
        ),
        spacing=law.apart,
        fewer=law.shortfall == "fewer",
        clearance_m=law.clearance_m,
        place_key=context.key("place"),
        position_u=context.uniforms("position", n, 3),
        prototype=prototype,
        orientations=orientations,
        align=turned == "normal",
        scale=each(size_key, size),
        embed=each("embed", law.embed),
        variation=2.0 * streams.uniforms(f"{path}/variation", n) - 1.0,
        lod_px=law.lod_px,
        beyond_m=beyond,
    )


def _counted(law: Scattered, size: Number, context: Context) -> tuple[ObjectCount, int]:
    """Returns the number of objects, and the most there can be: ``where`` only removes some."""
    if law.count is not None:
        return ObjectCount(int(law.count), None, 0.0), int(law.count)
    rounding = float(context.streams.uniforms(f"{context.path}/count_rounding", 1)[0])
    per_m2 = law.per_m2
    if per_m2 is None:
        assert isinstance(size, Distribution)
        per_m2 = golombek_rapp_per_m2(size.min, size.max, size.shape)
    expected = per_m2 * context.size_m[0] * context.size_m[1]
    if not expected <= MOST_OBJECTS:
        raise SceneError(
            f"{context.path}: {per_m2:.3g} per m^2 on {context.size_m[0]:g} m by "
            f"{context.size_m[1]:g} m are {expected:.3g} objects, at most {MOST_OBJECTS:,} are "
            "taken; lower per_m2, or raise the smallest size"
        )
    return ObjectCount(None, float(per_m2), rounding), int(expected + rounding)


def _place(node: JsonObject, path: str, context: Context) -> PlacementCondition:
    if node["type"] == "material":
        return OnMaterial(context.layers_of(node))
    if node["type"] in ("camera", "object"):
        condition: PlacementCondition = draw_kind("objects_where", node, path, context)
        return condition
    return OnRelief(draw_condition(node, replace(context, path=path, choice="objects_where")))


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
