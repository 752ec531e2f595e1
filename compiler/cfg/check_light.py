"""What must hold between the keys of the light: suns, sky and its label maps, haze, lamps."""

from __future__ import annotations

from collections.abc import Iterator

from scenec.compiler.kinds.finding import Finding
from scenec.compiler.kinds.node import Node, black, is_black, off_terrain, unknown
from scenec.schemas.spelling import shown

#: Prims of the stage that the sun and the sky have.
_TAKEN = {"Sun": "the sun", "Dome": "the sky"}


def check_light(cfg: Node) -> Iterator[Finding]:
    """Findings on all lights, the sky and haze."""
    light = cfg.at("light")
    sky = light.at("sky")
    yield from _check_names(light)
    for pattern in (("more", "*"), ("lamps", "*")):
        for node in light.each(*pattern):
            if is_black(node):
                yield node.fault(black("what is asked for"), "color")
    for mount in light.each("lamps", "*", "mount"):
        yield from _check_mount(cfg, mount)
    if is_black(light.at("sun")):
        yield light.fault(black("an irradiance"), "sun", "color")
    if is_black(sky, "zenith_color") and is_black(sky, "horizon_color"):
        yield sky.fault(black("an irradiance"), "zenith_color")
    if sky["type"] == "overcast":
        if is_black(sky):
            yield sky.fault(black("an irradiance"), "color")
        if light.entries.get("sun", {}) is None and "irradiance" not in sky:
            yield sky.fault("expected the key irradiance, or a sun above the cloud (light.sun)")
    if sky["type"] == "image":
        yield from _check_label_maps(cfg, sky)
        if sky["sun"] == "extract" and light.entries.get("sun") is not None:
            yield light.key_fault(
                'the sun is taken from the pictures ("sun": "extract" of light.sky): expected '
                "null, or no key; further suns go into light.more",
                "sun",
            )
    if sky["type"] == "atmosphere" and light.entries.get("sun", {}) is None:
        yield light.fault(
            "an atmosphere shows the light of the sun: expected a sun (below the horizon for "
            'night), or a sky of the type "none"',
            "sun",
        )
    if light.at("clouds") and (sky["type"] not in ("atmosphere", "clear") or _is_dry(sky)):
        yield light.key_fault(
            "clouds need a sky that is made, of air with water in it: expected one of the type "
            '"atmosphere" (planet "earth") or "clear"',
            "clouds",
        )
    if light.at("haze"):
        yield from _check_haze(light.at("haze"))


def _is_dry(sky: Node) -> bool:
    return bool(sky["type"] == "atmosphere" and sky["planet"] != "earth")


def _check_names(light: Node) -> Iterator[Finding]:
    """All lights stand beside each other in the stage."""
    taken = dict(_TAKEN)
    for group in ("more", "lamps"):
        for name in light.at(group).entries:
            if name in taken:
                yield light.key_fault(
                    f"{shown(name)} is the name of {taken[name]} already: expected another one",
                    group,
                    name,
                )
            taken.setdefault(name, f"light/{group}/{name}")


def _check_mount(cfg: Node, mount: Node) -> Iterator[Finding]:
    rigs = cfg.at("rigs")
    if mount["type"] == "rig" and rigs and mount["rig"] not in (None, *rigs.entries):
        yield mount.fault(unknown("rig", mount["rig"], rigs.entries), "rig")
    if mount["type"] != "world":
        return
    yield from mount.both("target", "bearing_deg", "where it shines")
    yield from mount.both("target", "elevation_deg", "where it shines")
    if mount["heights"] == "ground":
        # The ground's height is known on the terrain only.
        for place in (mount, mount.at("target")):
            for key, how in off_terrain(cfg, place):
                yield place.fault(f'{how}: expected a place on it, or "heights": "world"', key)


def label_maps(cfg: Node) -> Iterator[tuple[str, Node]]:
    """Level and node of each label map of a panorama."""
    for node in cfg.each("light", "sky", "label_maps", "*", "*"):
        yield str(node.path[-1]), node


def _check_label_maps(cfg: Node, sky: Node) -> Iterator[Finding]:
    from scenec.compiler.assets.label_maps import LARGEST_ID, code_of

    maps, files, labels = sky.at("label_maps"), sky.at("files"), cfg.at("labels")
    if maps and files and len(maps.entries) != len(files.entries):
        yield maps.fault(
            f"{len(maps.entries)} entries for {len(files.entries)} files: expected one for each, "
            "null for none"
        )
    for level, node in label_maps(cfg):
        if level not in labels:
            yield node.key_fault(unknown("label level", level, labels.entries))
            continue
        values, table = node.at("values"), labels.at(level)
        for value in values.entries:
            if code_of(value) is None:
                yield values.key_fault(
                    f'{shown(value)}: expected a whole number from 0 to {LARGEST_ID}, or "#RRGGBB"',
                    value,
                )
            name = values[value]
            if name is not None and name not in table:
                where = f" on the level {shown(level)}"
                yield values.fault(unknown("label", name, table.entries, where), value)
            elif name is not None and (table[name] or 0) > LARGEST_ID:
                yield values.fault(
                    f"{shown(name)} has the id {table[name]}, and label maps hold ids up to "
                    f"{LARGEST_ID}: expected a smaller one in labels",
                    value,
                )


def _check_haze(haze: Node) -> Iterator[Finding]:
    yield from haze.both("visibility_m", "extinction_per_m", "how dense it is")
    if "visibility_m" not in haze:
        if "extinction_per_m" not in haze:
            yield haze.fault("expected the key visibility_m, or extinction_per_m")
        elif "color" in haze:
            yield haze.key_fault(
                "extinction_per_m has a color of its own: take one of the two away", "color"
            )
    if is_black(haze):
        yield haze.fault(black("a visibility"), "color")
