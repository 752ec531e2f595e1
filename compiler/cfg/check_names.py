"""Names that the cfg gives, and names that it uses: labels and materials.

These checks also run on a cfg that the schemas found fault with, so that all faults are told at
once; they pass over what does not have the shape they look for.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from scenec.compiler.cfg.check_sky import sky_map_labels
from scenec.compiler.cfg.faults import Finding
from scenec.compiler.cfg.json_positions import Path
from scenec.schemas.spelling import closest, nearest, shown


def check_names(document: Any, sound: bool) -> list[Finding]:
    """Findings on label and material names.

    Args:
        document: A cfg, perhaps with faults.
        sound: Whether the schemas found no fault. Where they did, a name counts as used as soon as
            it stands anywhere: its user may have been misspelled.
    """
    cfg = _mapping(document)
    users, parts = list(_users(cfg)), list(_parts(cfg))
    findings = [*_check_materials(cfg, users + parts), *_check_levels(cfg, users)]
    findings.extend(_check_parts(cfg, parts))
    findings.extend([*_check_ids(cfg), *_check_masks(cfg)])
    findings.extend(_check_unused(cfg, users + parts, None if sound else _all_words(cfg)))
    return findings


def _mapping(value: Any) -> Mapping[str, Any]:
    return value if isinstance(value, dict) else {}


def _users(cfg: Mapping[str, Any]) -> Iterator[tuple[Path, Mapping[str, Any]]]:
    """What has a material and labels: ground layers and objects."""
    ground = _mapping(cfg.get("terrain")).get("ground")
    for i, layer in enumerate(ground if isinstance(ground, list) else []):
        if isinstance(layer, dict):
            yield ("terrain", "ground", i), layer
    for name, thing in _mapping(cfg.get("objects")).items():
        if isinstance(thing, dict):
            yield ("objects", name), thing


def _parts(cfg: Mapping[str, Any]) -> Iterator[tuple[Path, Mapping[str, Any]]]:
    """Parts of models that have a material or labels of their own."""
    for name, thing in _mapping(cfg.get("objects")).items():
        for part, node in _mapping(_mapping(thing).get("parts")).items():
            if isinstance(node, dict):
                yield ("objects", name, "parts", part), node


def _sky(cfg: Mapping[str, Any]) -> Mapping[str, Any]:
    return _mapping(_mapping(cfg.get("light")).get("sky"))


def _check_materials(
    cfg: Mapping[str, Any], users: list[tuple[Path, Mapping[str, Any]]]
) -> Iterator[Finding]:
    materials = cfg.get("materials")
    if not isinstance(materials, dict):
        return
    for path, thing in users:
        name = thing.get("material")
        if isinstance(name, str) and name not in materials:
            yield Finding(
                (*path, "material"), f"no material {shown(name)}{nearest(name, materials)}"
            )


def _check_masks(cfg: Mapping[str, Any]) -> Iterator[Finding]:
    """Masks by material name one that lies on the ground, and a layer of it."""
    terrain = _mapping(cfg.get("terrain"))
    ground, relief = terrain.get("ground"), terrain.get("relief")
    if not isinstance(ground, list) or not isinstance(relief, list):
        return
    lies = [_mapping(layer).get("material") for layer in ground]
    known = list(dict.fromkeys(name for name in lies if isinstance(name, str)))
    for i, operator in enumerate(relief):
        mask = _mapping(operator).get("mask")
        for k, condition in enumerate(mask if isinstance(mask, list) else []):
            node = _mapping(condition)
            name, layer = node.get("material"), node.get("layer")
            if node.get("type") != "material" or not isinstance(name, str):
                continue
            path = ("terrain", "relief", i, "mask", k)
            if name not in known:
                yield Finding(
                    (*path, "material"),
                    f"no ground layer of the material {shown(name)}{nearest(name, known)}",
                )
                continue
            own = [n for n, other in enumerate(lies) if other == name]
            if isinstance(layer, int) and layer not in own:
                yield Finding(
                    (*path, "layer"),
                    f"{shown(layer)} is no layer of {shown(name)}: expected "
                    f"{' or '.join(map(str, own))}",
                )


def _check_levels(
    cfg: Mapping[str, Any], users: list[tuple[Path, Mapping[str, Any]]]
) -> Iterator[Finding]:
    if not isinstance(cfg.get("labels", {}), dict):
        return
    levels = _mapping(cfg.get("labels"))
    for path, thing in users:
        chosen = thing.get("labels", {})
        if not isinstance(chosen, dict):
            continue
        at = (*path, "labels") if "labels" in thing else path
        yield from _check_choice(levels, at, chosen)
        guesses = {closest(level, levels) for level in chosen if level not in levels}
        for level in levels:
            # A misspelled level is told once, as the unknown key that it is.
            if level not in chosen and level not in guesses:
                yield Finding(at, f"no label on the level {shown(level)}: give one")
    chosen = _sky(cfg).get("labels", {})
    if isinstance(chosen, dict):
        yield from _check_choice(levels, ("light", "sky", "labels"), chosen)
    if not levels:
        for at in _label_outputs(cfg):
            yield Finding(
                at,
                'the output "label" needs at least one level in "labels"; define one, or leave '
                '"label" out of "outputs"',
            )


def _check_parts(
    cfg: Mapping[str, Any], parts: list[tuple[Path, Mapping[str, Any]]]
) -> Iterator[Finding]:
    """A part has labels on any levels, and the class's on the others."""
    if isinstance(cfg.get("labels", {}), dict):
        for path, part in parts:
            yield from _check_choice(
                _mapping(cfg.get("labels")), (*path, "labels"), _mapping(part.get("labels"))
            )


def _label_outputs(cfg: Mapping[str, Any]) -> list[Path]:
    """Where the output "label" is asked for: by sensors, or for those that say nothing."""
    found: dict[Path, None] = {}
    for rig, content in _mapping(cfg.get("rigs")).items():
        for sensor, node in _mapping(_mapping(content).get("sensors")).items():
            own = "outputs" in _mapping(node)
            outputs = _mapping(node)["outputs"] if own else cfg.get("outputs", ["label"])
            if isinstance(outputs, list) and "label" in outputs:
                place: Path = ("rigs", rig, "sensors", sensor, "outputs")
                found[place if own else (("outputs",) if "outputs" in cfg else ())] = None
    return list(found)


def _check_choice(
    levels: Mapping[str, Any], at: Path, chosen: Mapping[str, Any]
) -> Iterator[Finding]:
    for level, name in chosen.items():
        if level not in levels:
            yield Finding(
                (*at, level), f"no label level {shown(level)}{nearest(level, levels)}", at_key=True
            )
        elif isinstance(name, str) and isinstance(levels[level], dict):
            names = levels[level]
            if name not in names:
                yield Finding(
                    (*at, level),
                    f"no label {shown(name)} on the level {shown(level)}{nearest(name, names)}",
                )


def _check_ids(cfg: Mapping[str, Any]) -> Iterator[Finding]:
    for level, names in _mapping(cfg.get("labels")).items():
        first: dict[float, str] = {}
        for name, number in _mapping(names).items():
            if isinstance(number, bool) or not isinstance(number, (int, float)):
                continue
            if number in first:
                yield Finding(
                    ("labels", level, name),
                    f"the id {shown(number)} is that of {shown(first[number])} already: ids are "
                    "unique within a level",
                )
            first.setdefault(number, name)


def _check_unused(
    cfg: Mapping[str, Any],
    users: list[tuple[Path, Mapping[str, Any]]],
    words: frozenset[str] | None,
) -> Iterator[Finding]:
    materials = _mapping(cfg.get("materials"))
    used = _meant([thing.get("material") for _, thing in users], materials)
    for name in materials:
        if name not in used and (words is None or name not in words):
            yield Finding(
                ("materials", name),
                f"the material {shown(name)} is not used: use it or take it away",
                at_key=True,
            )
    choices = [_mapping(thing.get("labels")) for _, thing in users]
    choices.append(_mapping(_sky(cfg).get("labels")))
    choices.extend({level: name} for _, level, name in sky_map_labels(cfg))
    for level, names in _mapping(cfg.get("labels")).items():
        given = _meant([choice.get(level) for choice in choices], _mapping(names))
        for name in _mapping(names):
            if name not in given and (words is None or name not in words):
                yield Finding(
                    ("labels", level, name),
                    f"the label {shown(name)} is not used: use it or take it away",
                    at_key=True,
                )


def _meant(given: list[Any], known: Mapping[str, Any]) -> frozenset[str | None]:
    """The known names among the given ones, and those that a misspelled one is closest to."""
    words = [word for word in given if isinstance(word, str)]
    return frozenset(word if word in known else closest(word, known) for word in words)


def _all_words(cfg: Mapping[str, Any]) -> frozenset[str]:
    found: list[str] = []
    pending: list[Any] = [
        value for key, value in cfg.items() if key not in ("labels", "name", "description")
    ]
    while pending:
        value = pending.pop()
        if isinstance(value, str):
            found.append(value)
        elif isinstance(value, dict):
            pending.extend(value.values())
        elif isinstance(value, list):
            pending.extend(value)
    return frozenset(found)
