"""Warns of numbers that can be, and leave nothing to see: of another unit, far off the scene.

Each is held against what the cfg itself says: rocks against the terrain, heights against what a
sensor sees, exposures against the sun. Numbers that are drawn count by the end that is nearer to
what is usual; a law without ends says nothing.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace

from scenec.compiler.arithmetic import elementary
from scenec.compiler.kinds import Finding, Node

_DEGREES = 180.0 / math.pi
#: Where numbers stand that another unit of length makes a thousand times off, and usual bounds.
_USUAL = (
    (("rigs", "*", "sensors", "*", "focus"), "focal_length_mm", 1.0, 3000.0, "mm"),
    (("rigs", "*", "sensors", "*", "imaging"), "pixel_um", 0.5, 2000.0, "µm"),
    (("rigs", "*", "sensors", "*", "depth_camera"), "baseline_m", 0.002, 10.0, "m"),
    (("light", "haze"), "visibility_m", 5.0, 1e6, "m"),
)
#: A sensor sits at most so far from its rig's origin, meters.
_FAR_MOUNT_M = 50.0
#: A terrain that spans less than this share of a sensor's field of view is too far below it.
_LEAST_SPAN = 1 / 6
#: Fields of view of a lens without distortion, degrees.
_USUAL_FOV_DEG = 0.5, 150.0
#: The key's own bound: sizes of a law without ends, meters.
_NO_END_M = 1e6
#: Beyond this, and below its reciprocal, lie the ends of laws without any, of light and exposure.
_NO_END = 1e30
#: So often side by side instances may cover the ground that they are scattered over.
_MOST_COVER = 20.0
#: Instances of a class; each takes about 100 bytes of the stage.
_MOST_INSTANCES = 20_000_000
#: Stops that a fixed exposure may be off that of sunlight.
_MOST_STOPS = 10.0
#: Irradiance of sunlight, W/m^2, and the exposure that shows it: f/16 at 1/100 s and ISO 100.
_SUNLIGHT, _SUNNY_EV = 1000.0, 14.6


def unusual(cfg: Node) -> Iterator[Finding]:
    """Yields warnings of magnitudes.

    Args:
        cfg: A whole without faults.
    """
    sides = [span for axis in (0, 1) if (span := cfg.at("terrain", "size_m").span(axis))]
    if len(sides) == 2:
        size = sides[0][1], sides[1][1]
        for check in (_horizon, _objects, _rigs, _ranges):
            yield from map(_warning, check(cfg, size))
    for check_lone in (_of_another_unit, _fields_of_view, _grains, _exposures, _night):
        yield from map(_warning, check_lone(cfg))


def _warning(finding: Finding) -> Finding:
    return replace(finding, is_warning=True)


def _least(node: Node, key: str | int) -> float:
    """The least that a number can be; 0 without one."""
    return (node.span(key) or (0.0, 0.0))[0]


def _horizon(cfg: Node, size: tuple[float, float]) -> Iterator[Finding]:
    """Yields masks about a place on the terrain that leave hills of the horizon at its border."""
    half = 0.5 * max(size)
    for operator in cfg.each("terrain", "horizon", "relief", "*"):
        for mask in operator.each("mask", "*"):
            low = mask.constant("min_m") if mask["type"] == "point" else None
            x, y, soft = (mask.constant(key) for key in ("x_m", "y_m", "softness_m"))
            if low is None or x is None or y is None or soft is None or max(abs(x), abs(y)) > half:
                continue
            begins, border = low - 0.5 * soft, half - max(abs(x), abs(y))
            if begins < border and not mask.at("ragged"):
                share = elementary.smoothstep((border - low) / soft + 0.5) if soft > 0.0 else 1.0
                yield mask.fault(
                    f"{low:g} m: {100 * share:.2g} % of this relief stands at the terrain's border "
                    f"already; it begins there with min_m {0.5 * soft + border:g} (half of "
                    "softness_m and of the terrain) or more",
                    "min_m",
                )


def _objects(cfg: Node, size: tuple[float, float]) -> Iterator[Finding]:
    """Yields sizes and numbers of what is scattered that do not go with the ground's."""
    for node in cfg.each("objects", "*"):
        beyond = _least(node, "beyond_m")
        wide, long = size[0] + 2.0 * beyond, size[1] + 2.0 * beyond
        area = wide * long - (size[0] * size[1] if beyond else 0.0)
        low, high = node.span("size_m") or (0.0, 0.0)
        if 0.5 * min(wide, long) < high < _NO_END_M:
            yield node.fault(
                f"{high:g} m, on ground {wide:g} m by {long:g} m: usual are sizes of less than a "
                f"tenth of it{_thousandth(high, 0.0, 0.1 * min(wide, long))}",
                "size_m",
            )
        key = "count" if "count" in node else "per_m2"
        spans = node.span(key)
        if not spans or spans[1] == 0.0:
            continue
        least, most = (end if key == "count" else end * area for end in spans)
        cover = least * 0.25 * math.pi * low * low / area
        if most < 0.5:
            yield node.fault(f"{spans[1]:g} on {area:g} m²: none, mostly; usual is 0.01 to 10", key)
        elif cover > _MOST_COVER or least > _MOST_INSTANCES:
            covering = f", which cover it {cover:.0f} times" if cover > 1.0 else ""
            yield node.fault(
                f"{least:.3g} instances on {area:g} m²{covering}: usual are at most a million, "
                "which cover it once",
                key,
            )


def _rigs(cfg: Node, size: tuple[float, float]) -> Iterator[Finding]:
    """Yields rigs so high that the terrain is a speck, and sensors far off their rigs."""
    for rig in cfg.each("rigs", "*"):
        mounts = rig.each("sensors", "*", "mount", "position_m")
        for mount in (*mounts, *rig.each("lidars", "*", "mount", "position_m")):
            for axis in mount.entries:
                off = _least(mount, axis)
                if abs(off) > _FAR_MOUNT_M:
                    yield mount.fault(
                        f"{off:g} m off the rig: usual is less than a meter"
                        f"{_thousandth(off, -_FAR_MOUNT_M, _FAR_MOUNT_M)}",
                        axis,
                    )
        fields = [fov for one in rig.each("sensors", "*") if (fov := _fov_deg(one)) > 0.0]
        narrowest = min(fields, default=60.0)
        for height, node, key in _heights(rig.at("pose")):
            seen = 2.0 * elementary.atan(0.5 * max(size) / height) * _DEGREES
            if seen < _LEAST_SPAN * narrowest:
                yield node.fault(
                    f"{height:g} m above a terrain of {size[0]:g} m by {size[1]:g} m, which spans "
                    f"{seen:.2g}° of a view of {narrowest:.3g}°: usual is at most its size",
                    key,
                )


def _heights(pose: Node) -> Iterator[tuple[float, Node, str]]:
    """Yields the least height above the ground that a pose has, above 0, and where it stands."""
    if pose["above"] == "world":
        return
    for node in (pose, pose.at("position")):
        if node and (height := _least(node, "height_m")) > 0.0:
            yield height, node, "height_m"


def _fov_deg(sensor: Node) -> float:
    """The least field of view of a sensor across, as of a pinhole; 0: it is not said."""
    if fov := _least(sensor, "fov_deg"):
        return fov
    focal, width = sensor.at("intrinsics").span("fx"), _least(sensor.at("resolution"), 0)
    return 2.0 * elementary.atan(0.5 * width / focal[1]) * _DEGREES if focal else 0.0


def _fields_of_view(cfg: Node) -> Iterator[Finding]:
    """Yields focal lengths that are hardly in pixels."""
    for sensor in cfg.each("rigs", "*", "sensors", "*"):
        inner, fov = sensor.at("intrinsics"), _fov_deg(sensor)
        focal, width = inner.constant("fx"), _least(sensor.at("resolution"), 0)
        low, high = _USUAL_FOV_DEG
        if focal and width and not sensor.at("lens") and not low <= fov <= high:
            yield inner.fault(
                f"{focal:g} px over {width:g} px see {fov:.3g}°: usual is {0.4 * width:.0f} to "
                f"{10 * width:.0f} px; a focal length in mm is divided by the width of a pixel",
                "fx",
            )


def _ranges(cfg: Node, size: tuple[float, float]) -> Iterator[Finding]:
    """Yields ranges of lidars and depth cameras that no surface of the scene is in."""
    reach = (cfg.at("terrain", "horizon").span("reach_m") or (0.0, 0.0))[1]
    across = math.sqrt(size[0] * size[0] + size[1] * size[1]) + 2.0 * reach
    for rig in cfg.each("rigs", "*"):
        lowest = min((height for height, _, _ in _heights(rig.at("pose"))), default=0.0)
        depths = rig.each("sensors", "*", "depth_camera")
        for node in (*rig.each("lidars", "*"), *depths):
            near, far = _least(node.at("range_m"), 0), _least(node.at("range_m"), 1)
            if not node.at("range_m"):
                continue
            if near > across:
                yield node.at("range_m").fault(
                    f"{near:g} m, beyond all of the scene, {across:.4g} m across"
                    f"{_thousandth(near, 0.0, across)}",
                    0,
                )
            elif far < lowest:
                yield node.at("range_m").fault(
                    f"{far:g} m, and the ground is {lowest:g} m below at least: it is out of range",
                    1,
                )
            elif far > 1000.0 and far > 10.0 * across:
                yield node.at("range_m").fault(
                    f"{far:g} m, and the scene ends after {across:.4g} m"
                    f"{_thousandth(far, 0.0, 10.0 * across)}",
                    1,
                )


def _of_another_unit(cfg: Node) -> Iterator[Finding]:
    for pattern, key, low, high, unit in _USUAL:
        for node in cfg.each(*pattern):
            span = node.span(key) if key in node else None
            if span and (span[1] < low or span[0] > high):
                value = span[1] if span[1] < low else span[0]
                yield node.fault(
                    f"{value:g} {unit}: usual is {low:g} to {high:g} {unit}"
                    f"{_thousandth(value, low, high)}",
                    key,
                )


def _thousandth(value: float, low: float, high: float) -> str:
    """Asks for a value a thousand times smaller or larger, where that would be usual."""
    for meant in (0.001 * value, 1000.0 * value):
        if low <= meant <= high:
            return f"; did you mean {meant:.6g}?"
    return ""


def _grains(cfg: Node) -> Iterator[Finding]:
    """Yields grains of surfaces that are too wide for their pictures."""
    for maps in cfg.each("materials", "*", "maps"):
        surface = maps.at("procedural")
        grain, size = _least(surface, "grain_m"), _least(maps, "size_m") or 2.0
        if "grain_m" in surface and grain > 0.25 * size:
            yield surface.fault(
                f"{grain:g} m, in pictures {size:g} m wide: drawn as a quarter of that at most"
                f"{_thousandth(grain, 0.0, 0.1 * size)}",
                "grain_m",
            )


def _exposures(cfg: Node) -> Iterator[Finding]:
    """Yields fixed exposures that show sunlight as black or as white."""
    sun = cfg.at("light", "sun")
    elevation = sun.span("elevation_deg")
    if "sun" not in cfg.at("light") and cfg.at("light", "sky")["type"] != "image":
        # Its default.
        elevation = (45.0, 45.0)
    if sun["type"] == "ephemeris" or not elevation or elevation[0] < 5.0:
        return
    lowest, highest = sun.span("irradiance") or (_SUNLIGHT, _SUNLIGHT)
    if not 1.0 / _NO_END < lowest <= highest < _NO_END:
        return
    for sensor in cfg.each("rigs", "*", "sensors", "*"):
        imaging = sensor.at("imaging")
        manual, fixed = imaging.at("exposure"), sensor.at("exposure")
        times, speeds, stops = manual.span("time_s"), manual.span("iso"), imaging.span("f_number")
        if manual["type"] == "manual" and times and speeds and stops:
            node, key, unit = manual, "time_s", f" s at ISO {speeds[0]:g} and f/{stops[0]:g}"
            exact = times[0] * speeds[0] / (100.0 * stops[0] * stops[0])
            if not 1.0 / _NO_END < exact < _NO_END:
                continue
            off = _log2(exact * lowest / _SUNLIGHT) + _SUNNY_EV
            usual = times[0] / elementary.exp(off * elementary.log(2.0))
        elif fixed["type"] == "fixed" and not imaging and (ev := fixed.constant("ev")) is not None:
            node, key, unit = fixed, "ev", " EV"
            usual = -_log2(lowest / math.pi)
            off = ev - usual
        else:
            continue
        # Darker suns, at the other end of the law, are brightened by as much.
        if off > _MOST_STOPS or off + _log2(highest / lowest) < -_MOST_STOPS:
            shown = "white" if off > 0.0 else "black"
            yield node.fault(
                f"{node.constant(key) or 0.0:g}{unit} shows what the sun lights as {shown}: usual "
                f"is about {usual:.2g}",
                key,
            )


def _log2(value: float) -> float:
    return elementary.log(value) / elementary.log(2.0)


def _night(cfg: Node) -> Iterator[Finding]:
    """Yields a sun that is never above the horizon."""
    sun, sky = cfg.at("light", "sun"), cfg.at("light", "sky")
    elevation = sun.span("elevation_deg")
    if sun["type"] == "ephemeris" or not elevation or elevation[1] >= 0.0:
        return
    other = [key for key in ("lamps", "more") if cfg.at("light", key).entries]
    left = "no sunlight falls on the scene"
    if sky["type"] == "none" and not other:
        left = "nothing lights the scene"
    yield sun.fault(
        f"{elevation[1]:g}° is below the horizon: {left}; expected more than 0, or light of "
        "light.more (a moon) or light.lamps",
        "elevation_deg",
    )
