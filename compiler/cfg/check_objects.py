"""What must hold between the keys of scattered objects, and between classes of objects.

Like ``check_scene``, these checks pass over what does not have the shape they look for.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from scenec.compiler.cfg.faults import Finding
from scenec.compiler.cfg.json_positions import Path
from scenec.schemas.spelling import nearest, shown

#: Key of each kind of scattered object that says how large an instance is.
_SIZES = {"rocks": "size_m", "meshes": "scale"}


def check_objects(document: Any, spans: dict[Path, tuple[float, float]]) -> list[Finding]:
    """Findings on objects.

    Args:
        document: A cfg, perhaps with faults.
        spans: Least and largest value of the numbers that nothing is wrong with, by path.
    """
    objects = document.get("objects") if isinstance(document, dict) else None
    findings: list[Finding] = []
    if not isinstance(objects, dict):
        return findings
    before: list[str] = []
    for name, thing in objects.items():
        if isinstance(thing, dict):
            path = ("objects", name)
            if thing.get("type") in tuple(_SIZES):
                findings.extend(_check_count(path, thing))
                findings.extend(_check_lean(path, thing))
            findings.extend(_check_density(path, thing, document, spans))
            findings.extend(_check_others(path, thing, name, before, list(objects)))
            findings.extend(_check_materials(path, thing, document))
        before.append(name)
    return findings


def _check_count(path: Path, thing: dict[str, Any]) -> Iterator[Finding]:
    size = thing.get(_SIZES[thing["type"]])
    told = (
        thing["type"] == "rocks"
        and isinstance(size, dict)
        and size.get("type") == "golombek_rapp"
        and size.get("per", "instance") == "instance"
    )
    if "count" in thing and "per_m2" in thing:
        yield Finding(
            (*path, "per_m2"),
            "count and per_m2 both say how many there are: take one away",
            at_key=True,
        )
    elif "count" not in thing and "per_m2" not in thing and not told:
        yield Finding(
            path,
            "expected either the key count or the key per_m2"
            + (
                ', or a size_m of the type "golombek_rapp", which says how many there are'
                if thing["type"] == "rocks"
                else ""
            ),
        )


def _check_lean(path: Path, thing: dict[str, Any]) -> Iterator[Finding]:
    if "lean_deg" not in thing or thing["type"] != "rocks":
        return
    kind = thing.get("orientation", "normal" if thing.get("family") == "slab" else "random")
    if kind == "random":
        yield Finding(
            (*path, "lean_deg"),
            'what is turned at random has no axis that leans: expected the orientation "upright" '
            'or "normal"',
            at_key=True,
        )


def _check_density(
    path: Path, thing: dict[str, Any], document: Any, spans: dict[Path, tuple[float, float]]
) -> Iterator[Finding]:
    density = thing.get("density")
    if not isinstance(density, dict):
        return
    path = (*path, "density")
    kind = density.get("type")
    if kind == "clusters":
        if "parents" in density and "parents_per_m2" in density:
            yield Finding(
                (*path, "parents_per_m2"),
                "parents and parents_per_m2 both say how many clusters there are: take one away",
                at_key=True,
            )
        elif "parents" not in density and "parents_per_m2" not in density:
            yield Finding(path, "expected either the key parents or the key parents_per_m2")
    if kind == "rings":
        terrain = document.get("terrain")
        relief = terrain.get("relief") if isinstance(terrain, dict) else None
        steps = relief if isinstance(relief, list) else []
        kinds = [step.get("type") for step in steps if isinstance(step, dict)]
        if "craters" not in kinds:
            yield Finding(
                (*path, "type"),
                'no craters in the relief: expected an operator of the type "craters"',
            )
        low, high = (spans.get((*path, f"{end}_radii")) for end in ("min", "max"))
        least = low or ((0.9, 0.9) if "min_radii" not in density else None)
        most = high or ((5.0, 5.0) if "max_radii" not in density else None)
        if least and most and least[1] >= most[0]:
            yield Finding(
                (*path, "min_radii" if low else "max_radii"),
                f"min_radii ({least[1]:g}) can reach max_radii ({most[0]:g}): expected it below",
            )


def _check_others(
    path: Path, thing: dict[str, Any], own: str, before: list[str], names: list[str]
) -> Iterator[Finding]:
    """Classes that one refers to stand before it."""
    for at, name, may_be_own in _others(path, thing):
        if name in before or (may_be_own and name == own):
            continue
        known = [*before, own] if may_be_own else before
        if name == own:
            yield Finding(at, f"{shown(name)} is this class itself: expected an earlier one")
        elif name in names:
            yield Finding(
                at, f"the class {shown(name)} comes later: expected one that stands before this one"
            )
        else:
            yield Finding(at, f"no class of objects {shown(name)}{nearest(name, known)}")


def _others(path: Path, thing: dict[str, Any]) -> Iterator[tuple[Path, str, bool]]:
    density, apart = thing.get("density"), thing.get("apart")
    if isinstance(density, dict) and isinstance(density.get("of"), str):
        yield (*path, "density", "of"), density["of"], False
    for i, condition in _listed(thing.get("where")):
        if isinstance(condition, dict) and isinstance(condition.get("of"), str):
            yield (*path, "where", i, "of"), condition["of"], False
    if isinstance(apart, dict):
        for i, name in _listed(apart.get("of")):
            if isinstance(name, str):
                yield (*path, "apart", "of", i), name, True


def _listed(value: Any) -> list[tuple[int, Any]]:
    return list(enumerate(value)) if isinstance(value, list) else []


def _check_materials(path: Path, thing: dict[str, Any], document: Any) -> Iterator[Finding]:
    """Conditions by material name one that lies on the ground, and a layer of it."""
    terrain = document.get("terrain")
    ground = terrain.get("ground") if isinstance(terrain, dict) else None
    lies = [layer.get("material") for _, layer in _listed(ground) if isinstance(layer, dict)]
    if not lies:
        return
    known = list(dict.fromkeys(name for name in lies if isinstance(name, str)))
    for i, node in _listed(thing.get("where")):
        if not isinstance(node, dict) or node.get("type") != "material":
            continue
        name, layer = node.get("material"), node.get("layer")
        at = (*path, "where", i)
        if not isinstance(name, str):
            continue
        if name not in known:
            yield Finding(
                (*at, "material"),
                f"no ground layer of the material {shown(name)}{nearest(name, known)}",
            )
            continue
        own = [n for n, other in enumerate(lies) if other == name]
        if isinstance(layer, int) and layer not in own:
            yield Finding(
                (*at, "layer"),
                f"{shown(layer)} is no layer of {shown(name)}: expected "
                f"{' or '.join(map(str, own))}",
            )
