"""What must hold between the keys of what rigs carry: sensors and lidars."""

from __future__ import annotations

from collections.abc import Iterator

from scenec.compiler.cfg.check_imaging import check_imaging
from scenec.compiler.kinds.finding import Finding
from scenec.compiler.kinds.node import Node
from scenec.schemas.correspondence import PARTNER
from scenec.schemas.depth_camera import MEASURED
from scenec.schemas.lens import COEFFICIENTS, EQUIRECTANGULAR
from scenec.schemas.spelling import nearest, shown

#: Poses that come one by one, at no time.
_STILL = ("random", "random_target")
#: What a focus says that imaging says by a key of its own.
_OF_IMAGING = {"f_number": "f_number", "focal_length_mm": "pixel_um"}


def check_rigs(cfg: Node) -> Iterator[Finding]:
    """Findings on all rigs, and on what they carry."""
    for rig in cfg.each("rigs", "*"):
        pose = rig.at("pose")
        for sensor in rig.each("sensors", "*"):
            yield from _check_field_of_view(sensor)
            yield from _check_lens(sensor)
            yield from _check_focus(sensor)
            yield from _check_partner(cfg, rig, sensor)
            yield from _check_shutter(pose, sensor)
            yield from _check_trigger(cfg, sensor)
            yield from check_imaging(sensor)
        for lidar in rig.each("lidars", "*"):
            yield from _check_trigger(cfg, lidar)
            yield from _check_lidar(rig, lidar)


def _check_field_of_view(sensor: Node) -> Iterator[Finding]:
    if sensor.at("lens")["type"] == EQUIRECTANGULAR:
        yield from sensor.both("fov_deg", "intrinsics", "what the sensor sees")
    else:
        yield from sensor.either("fov_deg", "intrinsics", "what the sensor sees")


def _check_lens(sensor: Node) -> Iterator[Finding]:
    lens, outputs = sensor.at("lens"), sensor.at("outputs")
    if lens["type"] is None:
        return
    if "partner" in sensor:
        yield sensor.key_fault(
            "a sensor with a lens is no half of a rectified pair: take one of both away", "partner"
        )
    for i, name in outputs.entries.items():
        if name in PARTNER:
            yield outputs.fault(f'"{name}" is of rectified pairs, which have no lens', i)
    message = _fold(sensor, lens)
    if message is not None:
        yield sensor.fault(message, "lens")


def _fold(sensor: Node, lens: Node) -> str | None:
    """Why a lens is not one-to-one; what is drawn is looked at when it is (``draw``)."""
    kind, size = lens["type"], sensor["resolution"]
    keys = [key for key in (*COEFFICIENTS[kind], "max_angle_deg") if key in lens]
    numbers = {key: lens.constant(key) for key in keys}
    if None in (size, *numbers.values()):
        return None
    # Imported here: it compiles kernels, and few sensors have a lens.
    from scenec.compiler.geometry.lenses import find_fault, lens_intrinsics, make_lens

    made = make_lens({"type": kind, **dict.fromkeys(COEFFICIENTS[kind], 0.0), **numbers})
    assert made is not None
    fov, given = sensor.constant("fov_deg"), sensor.at("intrinsics")
    if "intrinsics" in sensor:
        fx, fy, cx, cy = map(given.constant, ("fx", "fy", "cx", "cy"))
        skew = given.constant("skew") if "skew" in given else 0.0
        if fx is None or fy is None or cx is None or cy is None or skew is None:
            return None
        return find_fault(made, (fx, fy, cx, cy, skew), tuple(size))
    if fov is None and ("fov_deg" in sensor or kind != EQUIRECTANGULAR):
        return None
    intrinsics = lens_intrinsics(made, tuple(size), fov)
    if isinstance(intrinsics, str):
        return intrinsics
    return find_fault(made, intrinsics, tuple(size))


def _check_focus(sensor: Node) -> Iterator[Finding]:
    focus = sensor.at("focus")
    if not focus:
        return
    if "lens" in sensor:
        yield sensor.key_fault(
            "a bent picture has no aperture here: take focus or lens away", "focus"
        )
    for key, other in _OF_IMAGING.items():
        if "imaging" in sensor and key in focus:
            yield focus.key_fault(
                f"imaging/{other} says it already: take it away here, and give it there", key
            )
        elif "imaging" not in sensor and key not in focus:
            yield focus.fault(
                f"expected the key {key}: there is no imaging, whose {other} would say it"
            )


def _check_partner(cfg: Node, rig: Node, sensor: Node) -> Iterator[Finding]:
    """Outputs that need more than a camera: a stereo partner, a way of measuring depth."""
    asks = sensor if "outputs" in sensor else cfg
    place = (*asks.path, "outputs") if asks is sensor else sensor.path
    asked = asks["outputs"]
    outputs = asked or ()
    if MEASURED in outputs and "depth_camera" not in sensor:
        yield Finding(place, f"the output {shown(MEASURED)} needs the key depth_camera")
    if "depth_camera" in sensor and "outputs" in asks and asked and MEASURED not in asked:
        yield sensor.key_fault(
            f"nothing reads it: the output {shown(MEASURED)} is not asked for", "depth_camera"
        )
    partner, name = sensor["partner"], sensor.path[-1]
    if partner is not None:
        sensors = rig.at("sensors")
        if partner == name:
            yield sensor.fault("a sensor is no partner of itself", "partner")
        elif partner not in sensors:
            others = [other for other in sensors.entries if other != name]
            yield sensor.fault(
                f"the rig has no sensor {shown(partner)}{nearest(partner, others)}", "partner"
            )
        return
    pairs = [one for one in outputs if one in PARTNER]
    if pairs and "partner" not in sensor:
        yield Finding(
            place, f"the output {shown(pairs[0])} needs the key partner: the sensor it goes to"
        )


def _check_shutter(pose: Node, sensor: Node) -> Iterator[Finding]:
    shutter = sensor.at("shutter")
    if not shutter:
        return
    if pose["type"] in _STILL:
        yield shutter.key_fault(
            f'poses of the type "{pose["type"]}" are of no time, so nothing moves while a shutter '
            "is open: take it away, or let the rig move (track, orbit, lawn_mower, rover, mav, "
            "descent)"
        )
    if "exposure_s" not in shutter and sensor.at("imaging", "exposure")["type"] != "manual":
        yield shutter.fault(
            'expected the key exposure_s: nothing but an imaging/exposure of type "manual" says it '
            "otherwise"
        )


def _check_trigger(cfg: Node, thing: Node) -> Iterator[Finding]:
    first, samples = thing.at("trigger")["first"], cfg["samples"]
    if "samples" in cfg and first is not None and samples is not None and first >= samples:
        yield thing.fault(
            f"is never reached: there are samples 0 to {samples - 1}", "trigger", "first"
        )


def _check_lidar(rig: Node, lidar: Node) -> Iterator[Finding]:
    name = str(lidar.path[-1])
    if name in rig.at("sensors"):
        yield lidar.fault(f"a sensor has the name {shown(name)}, too")
    yield from lidar.either("beams", "elevations_deg", "how many beams there are")
    low, high = lidar["range_m"] or (0.0, 0.0)
    if low > high:
        yield lidar.fault(f"expected the nearest range first: {high:g}, {low:g}", "range_m")
    low, high = lidar["azimuth_deg"] or (0.0, 360.0)
    if not 0.0 < abs(high - low) <= 360.0:
        yield lidar.fault(
            f"spans {abs(high - low):g} degrees, expected above 0, at most 360", "azimuth_deg"
        )
