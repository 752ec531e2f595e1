"""What must hold between the keys of objects, and between their classes."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path

from scenec.compiler.kinds.context import InputFile
from scenec.compiler.kinds.finding import Finding
from scenec.compiler.kinds.node import Node, unknown
from scenec.schemas.errors import SceneError
from scenec.schemas.spelling import nearest, shown

#: Families of rocks that this package has; others say themselves which keys they read.
FAMILIES = (
    "weathered", "angular", "rounded", "slab", "vesicular", "ventifact", "bedded", "breccia",
)  # fmt: skip
#: Those that lie as they have formed or broken, where the cfg does not say otherwise.
LYING = ("slab", "ventifact", "bedded")
#: Least ``beyond_m`` in the terrain's longer sides: 8 cells of the 384 that the land is taken in
#: (``mesh.horizon``), of which those off the terrain as a whole count: b / (side + 2 b) = 8 / 384.
LEAST_BEYOND = 8 / (384 - 2 * 8)


def check_objects(cfg: Node) -> Iterator[Finding]:
    """Findings on objects."""
    before: list[str] = []
    for thing in cfg.each("objects", "*"):
        if thing["type"] == "rocks":
            yield from _check_rocks(thing)
        if thing["type"] in ("rocks", "meshes"):
            yield from _check_count(thing)
            yield from _check_beyond(cfg, thing)
        if thing["type"] == "meshes":
            yield from _check_weights(thing)
        if thing["type"] == "placed":
            yield from _check_poses(thing)
        yield from _check_others(thing, before, list(cfg.at("objects").entries))
        before.append(str(thing.path[-1]))


def _check_rocks(thing: Node) -> Iterator[Finding]:
    """Keys that only some families or orientations read."""
    family = thing["family"]
    key, other = ("wear", "angularity") if family == "weathered" else ("angularity", "wear")
    if family in FAMILIES and key in thing:
        yield thing.key_fault(
            f"rocks of the family {shown(family)} have no {key}: expected {other}", key
        )
    usual = "normal" if family in LYING else "random"
    turned_at_random = (thing["orientation"] or usual) == "random"
    if "coatings" in thing and turned_at_random:
        yield thing.key_fault(
            "what is turned at random has no top that a coating could lie on: expected the "
            'orientation "upright" or "normal"',
            "coatings",
        )
    if "lean_deg" in thing and turned_at_random:
        yield thing.key_fault(
            'what is turned at random has no axis that leans: expected the orientation "upright" '
            'or "normal"',
            "lean_deg",
        )


def _check_count(thing: Node) -> Iterator[Finding]:
    yield from thing.both("count", "per_m2", "how many there are")
    if "count" in thing or "per_m2" in thing:
        return
    hint = ""
    if thing["type"] == "rocks":
        size = thing.entries.get("size_m")
        law = size if isinstance(size, dict) else {}
        if law.get("type") == "golombek_rapp" and law.get("per", "instance") == "instance":
            return
        hint = ', or a size_m of the type "golombek_rapp", which says how many there are'
    yield thing.fault(f"expected either the key count or the key per_m2{hint}")


def _check_beyond(cfg: Node, thing: Node) -> Iterator[Finding]:
    if "beyond_m" not in thing:
        return
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
    ends = {"material": "layers of the ground", "crater_freshness": "craters", "rings": "craters"}
    for node, what in (
        *((node, "condition") for node in thing.each("where", "*")),
        (thing.at("density"), "density"),
    ):
        if node["type"] in ends:
            yield node.fault(
                f"{ends[node['type']]} end at the terrain's border: expected another {what} with "
                "beyond_m",
                "type",
            )


def _check_weights(thing: Node) -> Iterator[Finding]:
    weights = [model["weight"] for model in thing.each("models", "*")]
    if weights and not any(weight != 0 for weight in weights):
        yield thing.fault("no model has a weight above 0: expected one or more", "models")


def _check_poses(thing: Node) -> Iterator[Finding]:
    yield from thing.both("poses", "file", "where objects are")
    if "poses" not in thing and "file" not in thing:
        yield thing.fault('expected the key "poses" or the key "file"')
    count = len(thing.at("models").entries)
    for pose in thing.each("poses", "*"):
        if count and pose["model"] is not None and pose["model"] >= count:
            yield pose.fault(
                f"{pose['model']}: expected an index into models, at most {count - 1}", "model"
            )


def _check_others(thing: Node, before: list[str], names: list[str]) -> Iterator[Finding]:
    """Classes that one refers to stand before it; what keeps apart may do so from its own."""
    own = str(thing.path[-1])
    nodes = [thing.at("density"), *thing.each("where", "*")]
    named = [(node, "of", node["of"], before) for node in nodes]
    apart = thing.at("apart", "of")
    named += [(apart, i, apart[i], [*before, own]) for i in apart.entries]
    for node, key, name, known in named:
        if name is None or name in known:
            continue
        if name == own:
            message = f"{shown(name)} is this class itself: expected an earlier one"
        elif name in names:
            message = (
                f"the class {shown(name)} comes later: expected one that stands before this one"
            )
        else:
            message = unknown("class of objects", name, known)
        yield node.fault(message, key)


def check_parts(cfg: Node, files: Mapping[str, InputFile]) -> Iterator[Finding]:
    """Findings on parts that no model has.

    Args:
        files: Its files that nothing is wrong with, by path.
    """
    for thing in cfg.each("objects", "*"):
        parts = thing.at("parts").entries
        models = [thing.at("models", i) for i in thing.at("models").entries]
        found = [files.get("/".join(map(str, (*model.path, "file")))) for model in models]
        if thing["type"] not in ("meshes", "placed") or not parts or None in found:
            # Some of the names are not known.
            continue
        from scenec.compiler.assets.parts import is_of

        known = [
            name
            for file, model in zip(found, models, strict=True)
            if file
            for name in _part_names(file.path, model)
        ]
        names = list(dict.fromkeys(path.rpartition("/")[2] for path in known if path))
        for part in parts:
            if not any(is_of(path, part) for path in known):
                yield thing.key_fault(
                    f"no model has a part {shown(part)}{nearest(part, names)}", "parts", part
                )


def _part_names(file: Path, node: Node) -> list[str]:
    from scenec.compiler.assets.model import cached_model, origin_of

    try:
        model = cached_model(
            file, node["unit_m"], node["up"], node["part"], origin_of(node["origin"])
        )
    except SceneError:
        # Told where it stands.
        return []
    return [*model.parts, *(material.name for material in model.materials)]
