"""What must hold between the keys of sky and haze.

Like ``check_names``, these checks pass over what does not have the shape they look for.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from scenec.compiler.cfg.faults import Finding
from scenec.compiler.cfg.json_positions import Path
from scenec.compiler.cfg.label_maps import LARGEST_ID, code_of
from scenec.schemas.spelling import nearest, shown

_SKY: Path = ("light", "sky")
_HAZE: Path = ("light", "haze")


def check_sky(document: Any, spans: dict[Path, tuple[float, float]]) -> Iterator[Finding]:
    """Findings on the sky, its label maps and haze.

    Args:
        document: A cfg, perhaps with faults.
        spans: Least and greatest value of the numbers that nothing is wrong with, by path.
    """
    light = _mapping(_mapping(document).get("light"))
    sky = _mapping(light.get("sky"))
    if sky.get("type") == "image":
        yield from _check_extraction(light, sky)
        yield from _check_label_maps(sky, _mapping(_mapping(document).get("labels")))
    if sky.get("type") == "atmosphere" and "sun" in light and light["sun"] is None:
        yield Finding(
            ("light", "sun"),
            "an atmosphere shows the light of the sun: expected a sun (below the horizon for "
            'night), or a sky of the type "none"',
        )
    haze = light.get("haze")
    if isinstance(haze, dict):
        yield from _check_haze(haze, sky, spans)


def sky_map_labels(cfg: Any) -> Iterator[tuple[Path, str, str]]:
    """Path, level and name of each label that a panorama's label maps give."""
    sky = _mapping(_mapping(_mapping(cfg).get("light")).get("sky"))
    for path, level, node in _label_maps(sky):
        for value, name in _mapping(node.get("values")).items():
            if isinstance(name, str):
                yield (*path, "values", value), level, name


def _mapping(value: Any) -> dict[str, Any]:
    return value if isinstance(value, dict) else {}


def _check_extraction(light: dict[str, Any], sky: dict[str, Any]) -> Iterator[Finding]:
    if sky.get("sun") == "extract" and light.get("sun") is not None:
        yield Finding(
            ("light", "sun"),
            'the sun is taken from the pictures ("sun": "extract" of light.sky): expected null, or '
            "no key; further suns go into light.more",
            at_key=True,
        )


def _label_maps(sky: dict[str, Any]) -> Iterator[tuple[Path, str, dict[str, Any]]]:
    maps = sky.get("label_maps")
    for i, entry in enumerate(maps if isinstance(maps, list) else []):
        for level, node in _mapping(entry).items():
            if isinstance(node, dict):
                yield (*_SKY, "label_maps", i, level), level, node


def _check_label_maps(sky: dict[str, Any], labels: dict[str, Any]) -> Iterator[Finding]:
    maps, files = sky.get("label_maps"), sky.get("files")
    if isinstance(maps, list) and isinstance(files, list) and len(maps) != len(files):
        yield Finding(
            (*_SKY, "label_maps"),
            f"{len(maps)} entries for {len(files)} files: expected one for each, null for none",
        )
    for path, level, node in _label_maps(sky):
        if level not in labels:
            yield Finding(path, f"no label level {shown(level)}{nearest(level, labels)}", True)
            continue
        table = _mapping(labels[level])
        for value, name in _mapping(node.get("values")).items():
            at = (*path, "values", value)
            if code_of(value) is None:
                yield Finding(
                    at,
                    f'{shown(value)}: expected a whole number from 0 to {LARGEST_ID}, or "#RRGGBB"',
                    at_key=True,
                )
            if isinstance(name, str) and name not in table:
                yield Finding(
                    at,
                    f"no label {shown(name)} on the level {shown(level)}{nearest(name, table)}",
                )
            number = table.get(name) if isinstance(name, str) else None
            if isinstance(number, int) and number > LARGEST_ID:
                yield Finding(
                    at,
                    f"{shown(name)} has the id {number}, and label maps hold ids up to "
                    f"{LARGEST_ID}: expected a smaller one in labels",
                )


def _no_sky(sky: dict[str, Any]) -> bool:
    return sky.get("type") == "none" or (
        sky.get("type") == "atmosphere" and sky.get("planet") == "moon"
    )


def _check_haze(
    haze: dict[str, Any], sky: dict[str, Any], spans: dict[Path, tuple[float, float]]
) -> Iterator[Finding]:
    if "visibility_m" in haze and "extinction_per_m" in haze:
        yield Finding(
            (*_HAZE, "extinction_per_m"),
            "visibility_m and extinction_per_m both say how dense it is: take one away",
            at_key=True,
        )
    elif "visibility_m" not in haze and "extinction_per_m" not in haze:
        yield Finding(_HAZE, "expected the key visibility_m, or extinction_per_m")
    elif "color" in haze and "extinction_per_m" in haze:
        yield Finding(
            (*_HAZE, "color"),
            "extinction_per_m has a color of its own: take one of the two away",
            at_key=True,
        )
    color = haze.get("color")
    if isinstance(color, list) and len(color) == 3:
        components = [spans.get((*_HAZE, "color", i)) for i in range(3)]
        if None not in components and not any(span and span[0] > 0.0 for span in components):
            yield Finding(
                (*_HAZE, "color"),
                "black cannot be scaled to a visibility: expected a component that is always "
                "above 0",
            )
    if haze.get("airlight", "sky") == "sky" and _no_sky(sky):
        yield Finding(
            (*_HAZE, "airlight") if "airlight" in haze else _HAZE,
            "haze shows the light of the sky, and there is none: expected an airlight of its own, "
            "[red, green, blue] in W/(m² sr), or another sky",
        )
