"""Declares what all classes of scattered objects have: how many, where, and how they stand."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import ClassVar, Literal

from scenec.compiler.distributions.numbers import Number
from scenec.compiler.kinds import Finding, Node, an, forms, key, list_of, unknown
from scenec.schemas.codec import JsonObject
from scenec.schemas.spelling import shown

#: Least ``beyond_m`` in the terrain's longer sides: 8 cells of the 384 that the land is taken in
#: (``mesh.horizon``), of which those off the terrain as a whole count: b / (side + 2 b) = 8 / 384.
LEAST_BEYOND = 8 / (384 - 2 * 8)
#: What ends at the terrain's border, by the kinds that ask for it.
_ENDS = {"material": "layers of the ground", "crater_freshness": "craters", "rings": "craters"}


@dataclass(frozen=True, kw_only=True)
class Spacing:
    """Distances in plan between objects, as circles."""

    EXAMPLE: ClassVar = {"gap_m": 1, "radius": 0.3}

    gap_m: float = key(forms.LENGTH_PER_BATCH, default=0, at_least=0, at_most=1000000.0)
    """Least gap between two circles."""
    radius: float | None = key(forms.PER_BATCH, optional=True, at_least=0, at_most=100)
    """Radius of the circle, in distances from origin to farthest point, tree tops included. Left
    out, circles are as wide as objects are from above, and none overlap (with orientation normal:
    1)."""
    of: tuple[str, ...] | None = key(list_of(forms.TEXT, least=1, unique=True), optional=True)
    """Classes to keep apart from: this one, or earlier ones. Left out: this one."""


@dataclass(frozen=True, kw_only=True)
class Scattered:
    """Keys of every class of scattered objects: how many, where, and how they stand."""

    EXAMPLE: ClassVar = {
        "per_m2": 2,
        "labels": {"class": "rock"},
        "density": {"type": "noise", "scale_m": 10},
        "where": [{"type": "slope", "max_deg": 30}],
        "embed": 0.2,
    }

    SHARED: ClassVar = "objects_scattered"
    count: int | None = key(forms.WHOLE_PER_BATCH, optional=True, at_least=0, at_most=100_000_000)
    """Number of instances, met exactly. Or give per_m2; neither where size_m is golombek_rapp,
    which implies it."""
    per_m2: float | None = key(
        forms.PER_BATCH, optional=True, at_least=0, at_most=1000000000000.0, unit="1/m^2"
    )
    """Number per square meter of terrain in plan, times the part of the density that where leaves,
    rounded at random."""
    labels: JsonObject = key(an("label_choice"), default={})
    """The objects' label on every level."""
    instances: bool = key(forms.TRUTH, default=True)
    """Whether each object has an instance id."""
    density: JsonObject = key(an("density"), default={"type": "uniform"})
    """How many there are in one place compared with another."""
    where: tuple[JsonObject, ...] = key(list_of(an("objects_where")), default=[])
    """Conditions on the place, multiplied with the density."""
    beyond_m: float | None = key(forms.LENGTH_PER_BATCH, optional=True, above=0, at_most=1_000_000)
    """Puts them on the land of terrain.horizon, up to this far beyond the border, instead. per_m2,
    size_m and conditions are then of that land, which has no materials or craters to ask for. At
    least a 46th of the terrain's longer side."""
    apart: Spacing | None = key(an("objects_apart", drawn=True), optional=True)
    """Keeps objects from overlapping in plan; left out, they may."""
    shortfall: Literal["error", "fewer"] = key(forms.CHOICE, default="error")
    """What happens where not all can be placed: error, or fewer, which leaves gaps in the ids."""
    clearance_m: float = key(
        forms.CONSTANT, default=0, at_least=-1_000_000, at_most=1000000.0, unit="m"
    )
    """Least distance from any camera of any sample to an object's geometry (at most a 48th of its
    size larger); nearer ones are put elsewhere. Below 0, cameras may be so far within the sphere
    that holds it; -1000000: anywhere."""
    orientation: Literal["random", "upright", "normal"] | None = key(forms.CHOICE, optional=True)
    """random: any; upright: turned about the vertical; normal: about the ground's normal. Left out:
    normal for slabs, random for other rocks, upright for meshes."""
    lean_deg: Number | None = key(
        forms.PER_INSTANCE, optional=True, at_least=0, at_most=180, unit="deg"
    )
    """How far the axis of orientation leans, to a random side; not with random."""
    embed: Number = key(
        forms.FRACTION_PER_INSTANCE, default={"type": "uniform", "min": 0.1, "max": 0.4}
    )
    """Fraction of an object's own height that is below the surface."""
    lod_px: float = key(forms.CONSTANT, default=0.5, at_least=0, at_most=1000)
    """Largest error of shape in pixels of the nearest view (of leaves, root mean square): each
    object gets the coarsest level that keeps to it. 0: always the finest."""

    @staticmethod
    def check(node: Node, hint: str | None = "") -> Iterator[Finding]:
        """Yields findings between its keys, and on other classes that it names.

        Args:
            hint: What else tells how many there are; None where it is told so.
        """
        yield from node.both("count", "per_m2", "how many there are")
        if hint is not None and "count" not in node and "per_m2" not in node:
            yield node.fault(f"expected either the key count or the key per_m2{hint}")
        if "beyond_m" in node:
            yield from _check_beyond(node.whole(), node)
        yield from _check_references(node)


def _check_beyond(cfg: Node, thing: Node) -> Iterator[Finding]:
    if "horizon" not in cfg.at("terrain"):
        yield thing.key_fault("nothing is there: expected a terrain.horizon", "beyond_m")
        return
    beyond, reach = thing.span("beyond_m"), cfg.at("terrain", "horizon").span("reach_m")
    if beyond and reach and beyond[1] > reach[0]:
        yield thing.fault(
            f"{beyond[1]:g} m, and the land ends {reach[0]:g} m beyond the border (reach_m): "
            "expected it within",
            "beyond_m",
        )
    sides = [cfg.at("terrain", "size_m").span(axis) for axis in (0, 1)]
    least = LEAST_BEYOND * max(side[1] if side else 0.0 for side in sides)
    if beyond and beyond[0] < least:
        yield thing.fault(
            f"{beyond[0]:g} m is too little for a terrain so wide: expected {least:.3g} m or more, "
            "a 46th of its longer side",
            "beyond_m",
        )
    if "fillet" in thing:
        yield thing.key_fault(
            "the land beyond the border is not heaped: expected no fillet with beyond_m", "fillet"
        )
    for node, what in (
        *((node, "condition") for node in thing.each("where", "*")),
        (thing.at("density"), "density"),
    ):
        if node["type"] in _ENDS:
            yield node.fault(
                f"{_ENDS[node['type']]} end at the terrain's border: expected another {what} with "
                "beyond_m",
                "type",
            )


def _check_references(thing: Node) -> Iterator[Finding]:
    """Classes that one refers to stand before it; what keeps apart may do so from its own."""
    own, classes = str(thing.path[-1]), thing.whole().at("objects")
    sound = [str(other.path[-1]) for other in classes.each("*")]
    before = sound[: sound.index(own)]
    nodes = [thing.at("density"), *thing.each("where", "*")]
    named = [(node, "of", node["of"], before) for node in nodes]
    apart = thing.at("apart", "of")
    named += [(apart, i, apart[i], [*before, own]) for i in apart.entries]
    for node, at, name, known in named:
        if name is None or name in known:
            continue
        if name == own:
            message = f"{shown(name)} is this class itself: expected an earlier one"
        elif name in classes:
            message = (
                f"the class {shown(name)} comes later: expected one that stands before this one"
            )
        else:
            message = unknown("class of objects", name, known)
        yield node.fault(message, at)
