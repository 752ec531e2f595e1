"""Names that the cfg gives, and names that it uses: labels and materials."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from scenec.compiler.kinds.finding import Finding, Path
from scenec.compiler.kinds.node import Node, unknown
from scenec.schemas.spelling import closest, shown


def check_names(cfg: Node, sound: bool) -> Iterator[Finding]:
    """Findings on label and material names.

    Args:
        sound: Whether the schemas found no fault. Where they did, a name counts as used as soon as
            it stands anywhere: its user may have been misspelled.
    """
    whole = [
        *cfg.each("terrain", "ground", "*"),
        *cfg.each("terrain", "horizon"),
        *cfg.each("objects", "*"),
    ]
    # A part of a model has labels on any levels, and the class's on the others.
    users = [*whole, *cfg.each("objects", "*", "parts", "*")]
    materials, levels = cfg.at("materials"), cfg.at("labels")
    coatings = cfg.each("objects", "*", "coatings", "*")
    for user in (*users, *coatings):
        name = user["material"]
        if materials and name is not None and name not in materials:
            yield user.fault(unknown("material", name, materials.entries), "material")
    if (levels or "labels" not in cfg) and not levels.entries:
        yield from _check_label_outputs(cfg)
    user_materials = [user["material"] for user in (*users, *coatings)]
    yield from _check_unused(cfg, users, user_materials, frozenset() if sound else _all_words(cfg))


def _choices(cfg: Node, users: list[Node]) -> list[Node]:
    """Lists all choices of labels: of material users, the sky and its picture's ground."""
    sky = cfg.at("light", "sky")
    return [*(node.at("labels") for node in (*users, sky)), sky.at("labels_below")]


def _check_label_outputs(cfg: Node) -> Iterator[Finding]:
    """The output "label" is asked for by sensors, or for those that say nothing."""
    places: set[Path] = set()
    for sensor in cfg.each("rigs", "*", "sensors", "*"):
        asks = sensor if "outputs" in sensor else cfg
        if "label" in (asks["outputs"] or ()):
            places.add((*asks.path, "outputs") if "outputs" in asks else asks.path)
    for place in places:
        yield Finding(
            place,
            'the output "label" needs at least one level in "labels"; define one, or leave '
            '"label" out of "outputs"',
        )


def _check_unused(
    cfg: Node, users: list[Node], user_materials: list[str | None], words: frozenset[str]
) -> Iterator[Finding]:
    materials, levels = cfg.at("materials"), cfg.at("labels")
    used = _meant(user_materials, materials)
    for name in materials.entries:
        if name not in used | words:
            yield materials.key_fault(
                f"the material {shown(name)} is not used: use it or take it away", name
            )
    choices = _choices(cfg, users)
    for level in levels.each("*"):
        key = level.path[-1]
        given = [choice[key] for choice in choices]
        for values in cfg.each("light", "sky", "label_maps", "*", str(key), "values"):
            given += [values[value] for value in values.entries]
        used = _meant(given, level)
        for name in level.entries:
            if name not in used | words:
                yield level.key_fault(
                    f"the label {shown(name)} is not used: use it or take it away", name
                )


def _meant(given: list[str | None], valid: Node) -> frozenset[str | None]:
    """The known names among the given ones, and those that a misspelled one is closest to."""
    words = [word for word in given if word is not None]
    return frozenset(w if w in valid else closest(w, valid.entries) for w in words)


def _all_words(cfg: Node) -> frozenset[str]:
    """All strings of the file but those that name it or its labels."""
    words: list[str] = []
    pending: list[Any] = [
        value for key, value in cfg.entries.items() if key not in ("labels", "name", "description")
    ]
    while pending:
        value = pending.pop()
        if isinstance(value, str):
            words.append(value)
        elif isinstance(value, (dict, list)):
            pending.extend(value.values() if isinstance(value, dict) else value)
    return frozenset(words)
