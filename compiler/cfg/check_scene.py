"""What must hold between the keys of a cfg: alternatives, and numbers that bound each other.

Like ``check_names``, these checks pass over what does not have the shape they look for.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

from scenec.compiler.cfg.check_focus import check_focus
from scenec.compiler.cfg.check_imaging import check_imaging
from scenec.compiler.cfg.check_lens import check_lens
from scenec.compiler.cfg.check_lidars import check_lidars
from scenec.compiler.cfg.check_light import check_light
from scenec.compiler.cfg.check_numbers import support
from scenec.compiler.cfg.check_objects import check_objects
from scenec.compiler.cfg.check_partners import check_partners
from scenec.compiler.cfg.check_poses import check_poses
from scenec.compiler.cfg.check_shutters import check_shutters
from scenec.compiler.cfg.check_sky import check_sky
from scenec.compiler.cfg.check_surfaces import check_surfaces
from scenec.compiler.cfg.faults import Finding
from scenec.compiler.cfg.json_positions import Path
from scenec.compiler.cfg.schema import Field, load_schemas
from scenec.schemas.spelling import shown

#: Height samples of a terrain at most (2 GiB of float64).
MAX_HEIGHT_SAMPLES = 2**28

_BASES = ("plane", "dem", "mesh")


def check_scene(document: Any, numbers: dict[Path, Field]) -> list[Finding]:
    """Findings on keys that do not go together.

    Args:
        document: A cfg, perhaps with faults.
        numbers: The numbers that nothing is wrong with, by path.
    """
    spans = {path: support(field.value, field.keywords) for path, field in numbers.items()}
    return [
        *_check_relief(document),
        *_check_mesh_bases(document),
        *_check_craters(document, spans),
        *_check_conditions(document, spans),
        *_check_freshness(document),
        *_check_layers(document),
        *check_surfaces(document, spans),
        *_check_rocks(document),
        *check_objects(document, spans),
        *check_light(document, spans),
        *check_imaging(document, spans),
        *_check_samples(spans),
        *_check_sensors(document, spans),
        *check_partners(document),
        *check_lidars(document),
        *check_shutters(document),
        *_check_positions(document, spans),
        *check_poses(document, spans),
        *_check_colors(document, spans),
        *check_sky(document, spans),
    ]


def _at(document: Any, *path: str | int) -> Any:
    for key in path:
        if isinstance(key, int):
            if not isinstance(document, list) or key >= len(document):
                return None
            document = document[key]
        else:
            document = document.get(key) if isinstance(document, dict) else None
    return document


def _entries(document: Any, *path: str | int) -> list[tuple[str | int, Any]]:
    value = _at(document, *path)
    if isinstance(value, dict):
        return list(value.items())
    return list(enumerate(value)) if isinstance(value, list) else []


def _check_relief(document: Any) -> Iterator[Finding]:
    kind = _at(document, "terrain", "relief", 0, "type")
    known = load_schemas()["relief.schema.json"]["properties"]["type"]["enum"]
    if kind in known and kind not in _BASES:
        yield Finding(
            ("terrain", "relief", 0, "type"),
            f"{shown(kind)}: the first operator is the base: expected one of {', '.join(_BASES)}",
        )


def _check_mesh_bases(document: Any) -> Iterator[Finding]:
    """What goes with a mesh that is kept, and what with one that becomes heights."""
    for i, node in _entries(document, "terrain", "relief"):
        if not isinstance(node, dict) or node.get("type") != "mesh":
            continue
        path = ("terrain", "relief", i)
        if node.get("surface", "mesh") == "mesh":
            if i != 0:
                yield Finding(
                    (*path, "surface") if "surface" in node else path,
                    'a mesh can be kept by the first operator only: expected "surface": "heights"',
                )
            if "mask" in node:
                yield Finding(
                    (*path, "mask"),
                    "a mask blends heights, and the mesh is kept as it is: take it away, or say "
                    '"surface": "heights"',
                    at_key=True,
                )
        elif "roughness" in node and node.get("surface") == "heights":
            yield Finding(
                (*path, "roughness"),
                "roughness moves a mesh along its normals, and heights have none: take it away "
                'and add another operator, or say "surface": "mesh"',
                at_key=True,
            )


def _check_craters(document: Any, spans: dict[Path, tuple[float, float]]) -> Iterator[Finding]:
    for i, _ in _entries(document, "terrain", "relief"):
        path = ("terrain", "relief", i)
        low, high = (spans.get((*path, f"{end}_diameter_m")) for end in ("min", "max"))
        if low and high and low[1] > high[0]:
            yield Finding(
                (*path, "min_diameter_m"),
                f"{low[1]:g} m can be above max_diameter_m ({high[0]:g} m): expected it below",
            )


def _conditions(document: Any) -> Iterator[tuple[Path, dict[str, Any]]]:
    """Conditions of operators' masks, of the ground's layers and of objects."""
    for name, _ in _entries(document, "objects"):
        for k, condition in _entries(document, "objects", name, "where"):
            if isinstance(condition, dict):
                yield ("objects", name, "where", k), condition
    for group, key in (("relief", "mask"), ("ground", "where")):
        for i, _ in _entries(document, "terrain", group):
            for k, condition in _entries(document, "terrain", group, i, key):
                if isinstance(condition, dict):
                    yield ("terrain", group, i, key, k), condition


def _check_conditions(document: Any, spans: dict[Path, tuple[float, float]]) -> Iterator[Finding]:
    known = load_schemas()["objects_where.schema.json"]["properties"]["type"]["enum"]
    for path, condition in _conditions(document):
        if condition.get("type") not in known or condition["type"] == "material":
            continue
        low, high = (
            next((key for key in condition if key == end or key.startswith(f"{end}_")), None)
            for end in ("min", "max")
        )
        if low is None and high is None:
            yield Finding(path, "no bounds: expected a smallest value, a largest one, or both")
        elif low is not None and high is not None:
            least, most = spans.get((*path, low)), spans.get((*path, high))
            if least and most and least[1] > most[0]:
                yield Finding(
                    (*path, low),
                    f"{least[1]:g} can be above {high} ({most[0]:g}): expected it below",
                )


def _check_freshness(document: Any) -> Iterator[Finding]:
    """Only craters leave fresh ground; a mask sees those laid before it."""
    kinds = [_at(node, "type") for _, node in _entries(document, "terrain", "relief")]
    for path, condition in _conditions(document):
        masks = path[1] == "relief" and isinstance(path[2], int)
        before = kinds[: int(path[2])] if masks else kinds
        if condition.get("type") == "crater_freshness" and "craters" not in before:
            where = " before this one" if masks else ""
            yield Finding(
                (*path, "type"),
                f'no craters in the relief{where}: expected an operator of the type "craters"',
            )


def _check_layers(document: Any) -> Iterator[Finding]:
    for i, layer in _entries(document, "terrain", "ground")[1:]:
        if not isinstance(layer, dict):
            continue
        path = ("terrain", "ground", i)
        if "threshold" in layer and "coverage" in layer:
            yield Finding(
                (*path, "coverage"),
                "threshold and coverage both say where the border lies: take one away",
                at_key=True,
            )
        if "where" in layer and "noise" not in layer:
            for key in ("sharpness", "coverage"):
                if key in layer:
                    yield Finding(
                        (*path, key),
                        f"{key} is of the noise, and a layer with where has none of its own: give "
                        "noise, too, or take it away",
                        at_key=True,
                    )


def _check_rocks(document: Any) -> Iterator[Finding]:
    """Keys that only some families of rocks read."""
    for name, thing in _entries(document, "objects"):
        if not isinstance(thing, dict) or thing.get("type") != "rocks":
            continue
        weathered = thing.get("family", "weathered") == "weathered"
        key, other = ("wear", "angularity") if weathered else ("angularity", "wear")
        if key in thing:
            yield Finding(
                ("objects", name, key),
                f"rocks of the family {shown(thing.get('family', 'weathered'))} have no {key}: "
                f"expected {other}",
                at_key=True,
            )


def _check_samples(spans: dict[Path, tuple[float, float]]) -> Iterator[Finding]:
    sizes = [spans.get(("terrain", "size_m", axis)) for axis in range(2)]
    spacing = spans.get(("terrain", "spacing_m"))
    if spacing is None or sizes[0] is None or sizes[1] is None:
        return
    counts = [math.ceil(min(size[1] / spacing[0], 1e18)) + 1 for size in sizes if size]
    if counts[0] * counts[1] > MAX_HEIGHT_SAMPLES:
        enough = math.sqrt(sizes[0][1] * sizes[1][1] / MAX_HEIGHT_SAMPLES)
        yield Finding(
            ("terrain", "spacing_m"),
            f"{spacing[0]:g} m on {sizes[0][1]:g} m by {sizes[1][1]:g} m makes "
            f"{counts[0] * counts[1]:.3g} height samples, at most {MAX_HEIGHT_SAMPLES:.3g} are "
            f"taken: expected a spacing of {1.01 * enough:.3g} m or more, or a smaller terrain",
        )


def _sensors(document: Any) -> Iterator[tuple[Path, dict[str, Any]]]:
    for rig, _ in _entries(document, "rigs"):
        for name, sensor in _entries(document, "rigs", rig, "sensors"):
            if isinstance(sensor, dict):
                yield ("rigs", rig, "sensors", name), sensor


def _check_sensors(document: Any, spans: dict[Path, tuple[float, float]]) -> Iterator[Finding]:
    for path, sensor in _sensors(document):
        yield from check_lens(sensor, path, spans)
        yield from check_focus(sensor, path)
        lens = sensor.get("lens")
        whole = isinstance(lens, dict) and lens.get("type") == "equirectangular"
        if "fov_deg" in sensor and "intrinsics" in sensor:
            yield Finding(
                (*path, "intrinsics"),
                "fov_deg and intrinsics both say what the sensor sees: take one away",
                at_key=True,
            )
        elif "fov_deg" not in sensor and "intrinsics" not in sensor and not whole:
            yield Finding(path, "expected either the key fov_deg or the key intrinsics")


def _check_positions(document: Any, spans: dict[Path, tuple[float, float]]) -> Iterator[Finding]:
    for rig, _ in _entries(document, "rigs"):
        for axis, key in enumerate(("x_m", "y_m")):
            path = ("rigs", rig, "pose", "position", key)
            size, span = spans.get(("terrain", "size_m", axis)), spans.get(path)
            if size is None or span is None:
                continue
            half = 0.5 * size[0]
            if span[0] < -half or span[1] > half:
                unbounded = math.isinf(span[0]) or math.isinf(span[1])
                yield Finding(
                    path,
                    f"reaches from {span[0]:g} m to {span[1]:g} m, but the terrain from "
                    f"{-half:g} m to {half:g} m: expected a position on it"
                    + (" (give the distribution min and max)" if unbounded else ""),
                )


def _check_colors(document: Any, spans: dict[Path, tuple[float, float]]) -> Iterator[Finding]:
    """Colors that are scaled to an irradiance cannot be black."""
    sky = ("light", "sky")
    for paths in ((("light", "sun", "color"),), ((*sky, "zenith_color"), (*sky, "horizon_color"))):
        given = [path for path in paths if len(_entries(document, *path)) == 3]
        components = [spans.get((*path, i)) for path in given for i in range(3)]
        # A color that was left out has a default that is not black.
        if len(given) < len(paths) or None in components:
            continue
        if not any(span and span[0] > 0.0 for span in components):
            yield Finding(
                given[0],
                "black cannot be scaled to an irradiance: expected a component that is always "
                "above 0",
            )
