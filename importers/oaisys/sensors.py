"""``SENSOR_SETUP``: one rig, its pose, and its sensors."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from scenec.compiler.assets.tracks import read_stamped
from scenec.compiler.geometry.poses import from_quaternion
from scenec.importers.numbers import tidy, uniform
from scenec.importers.oaisys import boxes
from scenec.importers.oaisys.context import Context
from scenec.importers.oaisys.render import PASSES, ordered
from scenec.importers.poses import FLIP, rotation_of, turns_of
from scenec.importers.scene import identifier, intrinsics
from scenec.importers.source import Item
from scenec.importers.writers import track_writer
from scenec.schemas.errors import SceneError

_RIG = "base"
_POSE = f"rigs/{_RIG}/pose"
#: Width of the film that Blender assumes where nothing is said, mm.
_FILM_MM = 36.0
#: Lowest height over ground, m.
_LEAST_HEIGHT = 0.01
#: Largest angle that is drawn, degrees.
_MOST_TURN = 1e5
#: Largest width or height of a picture.
_LARGEST_SIDE = 65535
#: Shortest focal length, pixels.
_LEAST_FOCAL = 1e-3
#: Keys of a kind of movement.
_KEYS: dict[str, tuple[str, ...]] = {
    **dict.fromkeys(("randomEuclideanPosMin", "randomEuclideanPosMax"),
                    ("randomEuclideanTarget", "randomEuclidean")),
    **dict.fromkeys(("randomEuclideanEulerMin", "randomEuclideanEulerMax"), ("randomEuclidean",)),
    **dict.fromkeys(
        ("randomTargetPosMin", "randomTargetPosMax", "randomTargetRollDeg", "hoverBaseModeEnabled",
         "hoverBaseDistance", "hoverBaseDistanceNoise", "hoverBaseStage", "hoverTargetModeEnabled",
         "hoverTargetDistance", "hoverTargetStage"),
        ("randomEuclideanTarget",),
    ),
    **dict.fromkeys(("sensorMovementPose", "deterministicSensorOffsetPos", "interpolationMode"),
                    ("deterministic",)),
    **dict.fromkeys(("targetObject", "sensorDistanceScale"), ("centeredTarget",)),
}  # fmt: skip


def sensors(ctx: Context, setup: Item) -> None:
    """The rig."""
    general = setup.need("GENERAL")
    rig: dict[str, Any] = {"pose": _pose(ctx, general), "sensors": {}}
    ctx.cfg["rigs"] = {_RIG: rig}
    entries = setup.need("SENSORS")
    for entry in entries.children():
        _sensor(ctx, entry, rig["sensors"])
    if entries.value == []:
        entries.fault("no sensor: expected a list of one or more")
    wanted = [sensor.get("outputs", ctx.cfg["outputs"]) for sensor in rig["sensors"].values()]
    if wanted and all(outputs == wanted[0] for outputs in wanted):
        ctx.cfg["outputs"] = list(wanted[0])
        for sensor in rig["sensors"].values():
            sensor.pop("outputs", None)


def _pose(ctx: Context, general: Item) -> dict[str, Any]:
    kinds: dict[str, Callable[[Context, Item], dict[str, Any]]] = {
        "randomEuclideanTarget": _target,
        "deterministic": _track,
        "randomEuclidean": _euclidean,
        "centeredTarget": _centered,
    }
    item = general.need("sensorMovementType")
    kind = item.one_of(*kinds)
    found = kinds[kind](ctx, general)
    item.translated(f"{_POSE}/type", str(found["type"]))
    for key, meant in _KEYS.items():
        if kind not in meant:
            general.drop(f"says nothing where sensorMovementType is {kind}", key)
    general.drop("there is one pose a sample", "stepInterval")
    return found


def _box(item_low: Item, item_high: Item) -> tuple[list[float], list[float]]:
    low, high = item_low.numbers(3), item_high.numbers(3)
    if any(b < a for a, b in zip(low, high, strict=True)):
        item_high.fault(f"{item_high.value}: expected no number below those of {item_low.value}")
        return low, low
    return low, high


def _place(ctx: Context, general: Item) -> tuple[list[float], list[float]]:
    """Least and largest position, in plan on the terrain."""
    items = [general.need(f"randomEuclideanPos{end}") for end in ("Min", "Max")]
    ends = [0.499 * side for side in ctx.extent_m]
    boxes_of = _box(*items)
    low, high = (
        [*(min(max(v, -e), e) for v, e in zip(box, ends, strict=False)), box[2]] for box in boxes_of
    )
    note = "" if (low, high) == boxes_of else "cut at the border of the terrain"
    for item in items:
        item.approximated(f"{_POSE}/position", note)
    return low, high


def _hover(general: Item) -> Any:
    """Height above the ground, where the base hovers."""
    enabled, name = general.get("hoverBaseModeEnabled"), "hoverBaseDistance"
    if not enabled.flag():
        keys = ("hoverBaseModeEnabled", "hoverBaseStage", f"{name}Noise", name)
        general.drop("hoverBaseModeEnabled is off", *keys)
        return None
    enabled.translated(_POSE)
    item, noise = general.need(name), general.get(f"{name}Noise")
    low, high = item.span(_LEAST_HEIGHT, 1e6)
    item.approximated(f"{_POSE}/position/height_m", "above the ground below, not the nearest one")
    # It takes away up to half of what is said.
    low = max(low - 0.5 * noise.number(0.0, 1e6, 0.0), _LEAST_HEIGHT)
    noise.translated(f"{_POSE}/position/height_m")
    general.get("hoverBaseStage").translated(_POSE, "there is one terrain")
    return uniform(low, high)


def _target(ctx: Context, general: Item) -> dict[str, Any]:
    low, high = _place(ctx, general)
    ends = [general.need(f"randomTargetPos{end}") for end in ("Min", "Max")]
    points = boxes.offsets(*_box(*ends))
    height = _hover(general)
    roll = general.get("randomTargetRollDeg")
    turn = roll.numbers(2, (0.0, 0.0))
    if max(map(abs, turn)) > _MOST_TURN:
        roll.fault(f"{roll.value}: expected angles of {_MOST_TURN:g} degrees at most")
    roll.translated(f"{_POSE}/roll_deg", "without effect there, and meant so")
    roll_deg = uniform(min(turn), max(turn))
    on_ground, above = _hover_target(general)
    on_ground = on_ground and height is not None
    for item in ends:
        item.approximated(
            f"{_POSE}/{'target' if on_ground else 'look'}",
            "bearing and distance have the box's distributions, drawn apart from each other",
        )
    if on_ground:
        return {
            "type": "random_target",
            "position": {
                "x_m": uniform(low[0], high[0]),
                "y_m": uniform(low[1], high[1]),
                "height_m": height,
            },
            "target": {
                "distance_m": boxes.distances(points),
                "bearing_deg": boxes.bearings(points),
                "height_m": above,
            },
            "roll_deg": roll_deg,
        }
    look = boxes.bearings(points), boxes.pitches(points)
    return _random(low, high, height, look, roll_deg)


def _hover_target(general: Item) -> tuple[bool, Any]:
    enabled, stage = general.get("hoverTargetModeEnabled"), general.get("hoverTargetStage")
    distance = general.get("hoverTargetDistance")
    for item in (enabled, stage, distance):
        if enabled.flag():
            item.translated(f"{_POSE}/target/height_m")
        else:
            item.dropped("hoverTargetModeEnabled is off")
    is_on = enabled.flag()
    return is_on, uniform(*distance.span(-1e6, 1e6, (0, 0))) if is_on else 0


def _random(
    low: list[float], high: list[float], height: Any, look: tuple[Any, Any], roll_deg: Any
) -> dict[str, Any]:
    """Poses in a box; ``height``: above the ground, None: in the world as the box has it."""
    # A box without extent is a point: the region needs two corners.
    wide = [max(b, a + 1e-3) for a, b in zip(low[:2], high[:2], strict=True)]
    return {
        "type": "random",
        "region_m": [[tidy(v) for v in low[:2]], [tidy(v) for v in wide]],
        "height_m": uniform(low[2], high[2]) if height is None else height,
        "above": "world" if height is None else "ground",
        "look": {"type": "direction", "bearing_deg": look[0], "pitch_deg": look[1]},
        "roll_deg": roll_deg,
        # OAISYS' cameras may be anywhere.
        "limits": {"clearance_m": -1000} if height is None else {},
    }


def _euclidean(ctx: Context, general: Item) -> dict[str, Any]:
    low, high = _place(ctx, general)
    first, last = (general.get(f"randomEuclideanEuler{end}") for end in ("Min", "Max"))
    note = "x is the tilt from straight down, z the heading, y the roll"
    least = first.approximated(f"{_POSE}/look", note).numbers(3, (0.0, 0.0, 0.0))
    most = last.approximated(f"{_POSE}/look", note).numbers(3, least)
    ends = [[math.degrees(v) for v in angles] for angles in (least, most)]
    pitch = [min(max(angles[0] - 90.0, -90.0), 90.0) for angles in ends]
    look = uniform(-ends[1][2], -ends[0][2]), uniform(*pitch)
    return _random(low, high, None, look, uniform(ends[0][1], ends[1][1]))


def _track(ctx: Context, general: Item) -> dict[str, Any]:
    item, offset = general.need("sensorMovementPose"), general.get("deterministicSensorOffsetPos")
    file = ctx.assets.find(item, "an orbit")
    why = "one row is one sample; sampling beside the track interpolates it"
    general.drop(why, "interpolationMode")
    if file is None:
        offset.dropped("its file is not there")
        radius = tidy(0.2 * min(ctx.extent_m))
        return {"type": "orbit", "radius_m": radius, "height_m": tidy(0.25 * radius)}
    try:
        stamped = read_stamped(file, "oaisys", frame_rate_hz=1.0)
    except SceneError as error:
        item.fault(str(error))
        return {"type": "orbit", "radius_m": 1}
    rows, samples = len(stamped.time_s), ctx.cfg["samples"]
    if rows < samples:
        item.fault(f"{file.name} has {rows} poses, expected {samples}: one for each sample")
    convention = "usd" if ctx.current else "opencv"
    moved = offset.translated(f"{_POSE}/file").numbers(3, (0.0, 0.0, 0.0))
    if not any(moved):
        item.translated(f"{_POSE}/file", "frames at 1 Hz")
        found = {"type": "track", "format": "oaisys", "convention": convention, "frame_rate_hz": 1}
        return {**found, "file": ctx.imported.refer(file)}
    poses = []
    for place, turn in zip(stamped.position_m, stamped.quaternion, strict=True):
        pose = from_quaternion(place + np.array(moved), turn)
        if convention == "usd":
            pose[:3, :3] = pose[:3, :3] @ FLIP
        poses.append(pose)
    made = ctx.imported.make("track.csv", track_writer(list(stamped.time_s), poses))
    item.translated(f"{_POSE}/file", "moved by deterministicSensorOffsetPos")
    return {"type": "track", "file": made}


def _centered(ctx: Context, general: Item) -> dict[str, Any]:
    target, scale = general.get("targetObject"), general.get("sensorDistanceScale")
    reach = tidy(min(max(scale.numbers(2, (1.0, 2.0))) * 0.1, 0.45) * min(ctx.extent_m))
    name = identifier(target.text()) if target else ""
    look: dict[str, Any] = {"type": "point", "x_m": 0, "y_m": 0}
    if name in ctx.cfg["objects"]:
        look = {"type": "object", "object": name}
    target.approximated(f"{_POSE}/look", "the object" if "object" in look else "the middle")
    scale.approximated(f"{_POSE}/region_m", "tenths of the stage in place of object's radii")
    return {
        "type": "random",
        "region_m": [[-reach, -reach], [reach, reach]],
        "height_m": uniform(0.2 * reach, 0.6 * reach),
        "look": look,
    }


def _sensor(ctx: Context, entry: Item, sensors: dict[str, Any]) -> None:
    entry.get("type").translated(f"rigs/{_RIG}/sensors").one_of("SensorCameraRGBD")
    params = entry.need("sensorParams")
    called = params.get("outputBaseName")
    name = identifier(called.text() if called else "camera")
    while name in sensors:
        name += "_2"
    to = f"rigs/{_RIG}/sensors/{name}"
    called.translated(to)
    size = params.need("imageResolution").translated(f"{to}/resolution")
    width, height = (max(int(v), 1) for v in size.numbers(2))
    if max(width, height) > _LARGEST_SIDE:
        size.fault(f"{size.value}: expected a width and a height of {_LARGEST_SIDE} at most")
    matrix = params.need("KMatrix").translated(f"{to}/intrinsics")
    k = matrix.numbers(9)
    if min(k[0], k[4]) < _LEAST_FOCAL:
        matrix.fault(f"{matrix.value}: expected focal lengths above 0 in its places 0 and 4")
        k[0] = k[4] = 1.0
    # Today's OAISYS counts pixels from the middle of the first one, that of 2021 from its corner.
    sensors[name] = {"resolution": [width, height], **intrinsics(k, 0.5 if ctx.current else 0.0)}
    _mount(params, sensors[name], to)
    _focus(params, sensors[name], k[0] / width, to)
    _passes(ctx, params, sensors[name], to)


def _mount(params: Item, sensor: dict[str, Any], to: str) -> None:
    item = params.get("transformation")
    if not item:
        return
    values = item.numbers(7)
    if not any(values[3:]):
        item.fault(f"{item.value}: expected a quaternion that is not 0 in its last four places")
        return
    item.translated(f"{to}/mount")
    place = [tidy(v) for v in FLIP @ np.array(values[:3])]
    turns = [tidy(round(v, 9)) for v in turns_of(FLIP @ rotation_of(values[3:]) @ FLIP)]
    mount = {"position_m": place, "rotation_deg": turns}
    if any(place) or any(turns):
        sensor["mount"] = {key: numbers for key, numbers in mount.items() if any(numbers)}


def _focus(params: Item, sensor: dict[str, Any], focal_widths: float, to: str) -> None:
    item = params.get("depthOfField")
    if not item:
        return
    sensor["focus"] = {
        "distance_m": item.get("distance")
        .translated(f"{to}/focus/distance_m")
        .number(1e-3, 1e9, 10),
        "f_number": item.get("fStop").translated(f"{to}/focus/f_number").number(0.5, 1000.0, 1.5),
        "focal_length_mm": tidy(focal_widths * _FILM_MM),
    }
    item.drop("the aperture is a circle", "blades", "rotationDeg", "ratio")


def _passes(ctx: Context, params: Item, sensor: dict[str, Any], to: str) -> None:
    """Outputs of one sensor: those of the cfg that its slots switch on."""
    passes = params.get("renderPasses")
    if not passes:
        return
    outputs: list[str] = []
    for name, output in PASSES.items():
        item = passes.get(name)
        if not item:
            continue
        slots, depth = item.get("activationSlot"), item.get("DepthEnabled")
        values = slots.numbers(usual=[1.0])
        if any(values) and output in ctx.cfg["outputs"]:
            outputs.append(output)
        is_mixed = any(values) and not all(values)
        slots.approximated(f"{to}/outputs", "all levels or none" if is_mixed else "")
        if depth.translated(f"{to}/outputs").flag() and any(values):
            outputs.append("depth")
    sensor["outputs"] = ordered(outputs)


def added_sensor(ctx: Context) -> None:
    """A camera where a cfg has none."""
    reach = tidy(0.3 * min(ctx.extent_m))
    box: dict[str, Any] = {"type": "uniform", "min": -reach, "max": reach}
    ctx.cfg["rigs"] = {
        _RIG: {
            "pose": {
                "type": "random_target",
                "position": {"x_m": box, "y_m": dict(box), "height_m": 1.5},
                "target": {"distance_m": tidy(max(0.1 * reach, 2.0))},
            },
            "sensors": {"camera": {"resolution": [640, 480], "fov_deg": 61.2}},
        }
    }
    ctx.imported.report.added(f"rigs/{_RIG}", "the listing says nothing of sensors")
