"""``SENSOR_SETUP``: one rig, its pose, and its sensors."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from scenec.compiler.assets.tracks import read_stamped
from scenec.importers.numbers import tidy, uniform
from scenec.importers.oaisys import boxes
from scenec.importers.oaisys.context import Context
from scenec.importers.poses import FLIP, rotation_of, track_writer, turns_of
from scenec.importers.report import ADDED
from scenec.importers.scene import identifier
from scenec.importers.source import Item
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


def sensors(ctx: Context, setup: Item) -> None:
    """The rig."""
    general = setup.need("GENERAL")
    rig: dict[str, Any] = {"pose": _pose(ctx, general), "sensors": {}}
    ctx.cfg["rigs"] = {_RIG: rig}
    entries = setup.need("SENSORS").children()
    for entry in entries:
        _sensor(ctx, entry, rig["sensors"])
    if not entries and "SENSORS" in setup:
        setup.need("SENSORS").fault("no sensor: expected a list of one or more")
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
        other = general.get(key)
        if other is not None and kind not in meant:
            other.dropped(f"says nothing where sensorMovementType is {kind}")
    step = general.get("stepInterval")
    if step:
        step.dropped("there is one pose a sample")
    return found


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


def _box(item_low: Item, item_high: Item) -> tuple[list[float], list[float]]:
    low, high = item_low.numbers(3), item_high.numbers(3)
    if any(b < a for a, b in zip(low, high, strict=True)):
        item_high.fault(f"{item_high.value}: expected no number below those of {item_low.value}")
        return low, low
    return low, high


def _within(ctx: Context, low: list[float], high: list[float]) -> tuple[list[float], list[float]]:
    """A box's plan, on the terrain."""
    ends = [0.499 * side for side in ctx.extent_m]
    cut = [[min(max(v, -e), e) for v, e in zip(box, ends, strict=False)] for box in (low, high)]
    return cut[0], cut[1]


def _place(ctx: Context, general: Item) -> tuple[list[float], list[float], bool]:
    """Least and largest position, in plan on the terrain; whether it was cut."""
    first, last = general.need("randomEuclideanPosMin"), general.need("randomEuclideanPosMax")
    low, high = _box(first, last)
    cut_low, cut_high = _within(ctx, low, high)
    is_cut = cut_low != low[:2] or cut_high != high[:2]
    for item in (first, last):
        if is_cut:
            item.approximated(f"{_POSE}/position", "cut at the border of the terrain")
        else:
            item.translated(f"{_POSE}/position")
    return [*cut_low, low[2]], [*cut_high, high[2]], is_cut


def _hover(general: Item) -> Any:
    """Height above the ground, where the base hovers."""
    enabled = general.get("hoverBaseModeEnabled")
    stage, noise = general.get("hoverBaseStage"), general.get("hoverBaseDistanceNoise")
    distance = general.get("hoverBaseDistance")
    if enabled is None or not enabled.flag():
        for item in (enabled, stage, noise, distance):
            if item:
                item.dropped("hoverBaseModeEnabled is off")
        return None
    enabled.translated(_POSE)
    item = distance or general.need("hoverBaseDistance")
    low, high = item.span(_LEAST_HEIGHT, 1e6)
    item.approximated(f"{_POSE}/position/height_m", "above the ground below, not the nearest one")
    if noise:
        # It takes away up to half of what is said.
        low = max(low - 0.5 * noise.number(0.0, 1e6), _LEAST_HEIGHT)
        noise.translated(f"{_POSE}/position/height_m")
    if stage:
        stage.translated(_POSE, "there is one terrain")
    return uniform(low, high)


def _target(ctx: Context, general: Item) -> dict[str, Any]:
    low, high, _ = _place(ctx, general)
    first, last = general.need("randomTargetPosMin"), general.need("randomTargetPosMax")
    points = boxes.offsets(*_box(first, last))
    height = _hover(general)
    roll = general.get("randomTargetRollDeg")
    turn = roll.numbers(2) if roll else [0.0, 0.0]
    if roll and max(map(abs, turn)) > _MOST_TURN:
        roll.fault(f"{roll.value}: expected angles of {_MOST_TURN:g} degrees at most")
    if roll:
        roll.translated(f"{_POSE}/roll_deg", "without effect there, and meant so")
    on_ground, above = _hover_target(general)
    for item in (first, last):
        item.approximated(
            f"{_POSE}/{'target' if on_ground and height is not None else 'look'}",
            "bearing and distance have the box's distributions, drawn apart from each other",
        )
    if on_ground and height is not None:
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
            "roll_deg": uniform(min(turn), max(turn)),
        }
    return {
        **_region(low, high),
        "height_m": uniform(low[2], high[2]) if height is None else height,
        "above": "world" if height is None else "ground",
        "look": {
            "type": "direction",
            "bearing_deg": boxes.bearings(points),
            "pitch_deg": boxes.pitches(points),
        },
        "roll_deg": uniform(min(turn), max(turn)),
        # OAISYS' cameras may be anywhere.
        "limits": {"clearance_m": -1000} if height is None else {},
    }


def _hover_target(general: Item) -> tuple[bool, Any]:
    enabled, stage = general.get("hoverTargetModeEnabled"), general.get("hoverTargetStage")
    distance = general.get("hoverTargetDistance")
    is_on = enabled is not None and enabled.flag()
    for item in (enabled, stage, distance):
        if item and is_on:
            item.translated(f"{_POSE}/target/height_m")
        elif item:
            item.dropped("hoverTargetModeEnabled is off")
    return is_on, uniform(*distance.span(-1e6, 1e6)) if is_on and distance else 0


def _region(low: list[float], high: list[float]) -> dict[str, Any]:
    # A box without extent is a point: the region needs two corners.
    wide = [max(b, a + 1e-3) for a, b in zip(low[:2], high[:2], strict=True)]
    return {"type": "random", "region_m": [[tidy(v) for v in low[:2]], [tidy(v) for v in wide]]}


def _euclidean(ctx: Context, general: Item) -> dict[str, Any]:
    low, high, _ = _place(ctx, general)
    keys = ("randomEuclideanEulerMin", "randomEuclideanEulerMax")
    first, last = (general.get(key) for key in keys)
    least = first.numbers(3) if first else [0.0, 0.0, 0.0]
    most = last.numbers(3) if last else least
    degrees = [[math.degrees(v) for v in angles] for angles in (least, most)]
    for item in (first, last):
        if item:
            item.approximated(
                f"{_POSE}/look", "x is the tilt from straight down, z the heading, y the roll"
            )
    pitch = [min(max(angles[0] - 90.0, -90.0), 90.0) for angles in degrees]
    return {
        **_region(low, high),
        "height_m": uniform(low[2], high[2]),
        "above": "world",
        "look": {
            "type": "direction",
            "bearing_deg": uniform(-degrees[1][2], -degrees[0][2]),
            "pitch_deg": uniform(*pitch),
        },
        "roll_deg": uniform(degrees[0][1], degrees[1][1]),
        "limits": {"clearance_m": -1000},
    }


def _track(ctx: Context, general: Item) -> dict[str, Any]:
    item = general.need("sensorMovementPose")
    file = ctx.assets.find(item, "an orbit")
    convention = "usd" if ctx.current else "opencv"
    mode, offset = general.get("interpolationMode"), general.get("deterministicSensorOffsetPos")
    if mode:
        mode.dropped("one row is one sample; sampling beside the track interpolates it")
    if file is None:
        if offset:
            offset.dropped("its file is not there")
        radius = tidy(0.2 * min(ctx.extent_m))
        return {"type": "orbit", "radius_m": radius, "height_m": tidy(0.25 * radius)}
    try:
        stamped = read_stamped(file, "oaisys", frame_rate_hz=1.0)
    except SceneError as error:
        item.fault(str(error))
        return {"type": "orbit", "radius_m": 1}
    rows = len(stamped.time_s)
    if rows < ctx.samples:
        item.fault(f"{file.name} has {rows} poses, expected {ctx.samples}: one for each sample")
    found = {"type": "track", "format": "oaisys", "convention": convention, "frame_rate_hz": 1}
    moved = offset.numbers(3) if offset else [0.0, 0.0, 0.0]
    if not any(moved):
        item.translated(f"{_POSE}/file", "frames at 1 Hz")
        if offset:
            offset.translated(f"{_POSE}/file")
        return {**found, "file": ctx.imported.refer(file)}
    poses = []
    for place, turn in zip(stamped.position_m, stamped.quaternion, strict=True):
        pose = np.eye(4)
        rotation = rotation_of(turn)
        pose[:3, :3] = rotation @ FLIP if convention == "usd" else rotation
        pose[:3, 3] = place + np.array(moved)
        poses.append(pose)
    made = ctx.imported.make("track.csv", track_writer(list(stamped.time_s), poses))
    item.translated(f"{_POSE}/file", "moved by deterministicSensorOffsetPos")
    if offset:
        offset.translated(f"{_POSE}/file")
    return {"type": "track", "file": made}


def _centered(ctx: Context, general: Item) -> dict[str, Any]:
    target, scale = general.get("targetObject"), general.get("sensorDistanceScale")
    ends = scale.numbers(2) if scale else [1.0, 2.0]
    reach = tidy(min(max(ends) * 0.1, 0.45) * min(ctx.extent_m))
    name = identifier(target.text()) if target else ""
    look: dict[str, Any] = {"type": "point", "x_m": 0, "y_m": 0}
    if name in ctx.cfg["objects"]:
        look = {"type": "object", "object": name}
    if target:
        target.approximated(f"{_POSE}/look", "the object" if "object" in look else "the middle")
    if scale:
        scale.approximated(f"{_POSE}/region_m", "tenths of the stage in place of object's radii")
    return {
        "type": "random",
        "region_m": [[-reach, -reach], [reach, reach]],
        "height_m": uniform(0.2 * reach, 0.6 * reach),
        "look": look,
    }


def _sensor(ctx: Context, entry: Item, found: dict[str, Any]) -> None:
    kind = entry.get("type")
    if kind:
        kind.one_of("SensorCameraRGBD")
        kind.translated(f"rigs/{_RIG}/sensors")
    params = entry.need("sensorParams")
    called = params.get("outputBaseName")
    name = identifier(called.text() if called else "camera")
    while name in found:
        name += "_2"
    to = f"rigs/{_RIG}/sensors/{name}"
    if called:
        called.translated(to)
    size = params.need("imageResolution")
    width, height = (max(int(v), 1) for v in size.numbers(2))
    if max(width, height) > _LARGEST_SIDE:
        size.fault(f"{size.value}: expected a width and a height of {_LARGEST_SIDE} at most")
    size.translated(f"{to}/resolution")
    sensor: dict[str, Any] = {"resolution": [width, height]}
    matrix = params.need("KMatrix")
    k = matrix.numbers(9)
    if min(k[0], k[4]) < _LEAST_FOCAL:
        matrix.fault(f"{matrix.value}: expected focal lengths above 0 in its places 0 and 4")
        k[0] = k[4] = 1.0
    # Today's OAISYS counts pixels from the middle of the first one, that of 2021 from its corner.
    corner = 0.5 if ctx.current else 0.0
    sensor["intrinsics"] = {
        "fx": tidy(k[0]),
        "fy": tidy(k[4]),
        "cx": tidy(k[2] + corner),
        "cy": tidy(k[5] + corner),
        **({"skew": tidy(k[1])} if k[1] else {}),
    }
    matrix.translated(f"{to}/intrinsics")
    _mount(params, sensor, to)
    _focus(params, sensor, k[0] / width, to)
    _passes(ctx, params, sensor, to)
    found[name] = sensor


def _mount(params: Item, sensor: dict[str, Any], to: str) -> None:
    item = params.get("transformation")
    if item is None:
        return
    values = item.numbers(7)
    if not any(values[3:]):
        item.fault(f"{item.value}: expected a quaternion that is not 0 in its last four places")
        return
    item.translated(f"{to}/mount")
    place = [tidy(v) for v in FLIP @ np.array(values[:3])]
    turns = [tidy(round(v, 9)) for v in turns_of(FLIP @ rotation_of(values[3:]) @ FLIP)]
    mount = {
        **({"position_m": place} if any(place) else {}),
        **({"rotation_deg": turns} if any(turns) else {}),
    }
    if mount:
        sensor["mount"] = mount


def _focus(params: Item, sensor: dict[str, Any], focal_widths: float, to: str) -> None:
    item = params.get("depthOfField")
    if item is None:
        return
    distance, stop = item.get("distance"), item.get("fStop")
    sensor["focus"] = {
        "distance_m": distance.number(1e-3, 1e9) if distance else 10,
        "f_number": stop.number(0.5, 1000.0) if stop else 1.5,
        "focal_length_mm": tidy(focal_widths * _FILM_MM),
    }
    for found, name in ((distance, "distance_m"), (stop, "f_number")):
        if found:
            found.translated(f"{to}/focus/{name}")
    for key in ("blades", "rotationDeg", "ratio"):
        other = item.get(key)
        if other:
            other.dropped("the aperture is a circle")


def _passes(ctx: Context, params: Item, sensor: dict[str, Any], to: str) -> None:
    """Outputs of one sensor: those of the cfg that its slots switch on."""
    passes = params.get("renderPasses")
    if passes is None:
        return
    outputs: list[str] = []
    for name, output in (
        ("RGBDPass", "rgb"),
        ("SemanticPass", "label"),
        ("InstancePass", "instance"),
    ):
        item = passes.get(name)
        if item is None:
            continue
        slots = item.get("activationSlot")
        values = slots.numbers() if slots else [1.0]
        if any(values) and output in ctx.cfg["outputs"]:
            outputs.append(output)
        if slots and any(values) and not all(values):
            slots.approximated(f"{to}/outputs", "all levels or none")
        elif slots:
            slots.translated(f"{to}/outputs")
        depth = item.get("DepthEnabled")
        if depth:
            if depth.flag() and any(values):
                outputs.append("depth")
            depth.translated(f"{to}/outputs")
    order = ("rgb", "label", "instance", "depth")
    sensor["outputs"] = [name for name in order if name in outputs] or ["rgb"]


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
    ctx.imported.report.add(ADDED, "", None, f"rigs/{_RIG}", "the listing says nothing of sensors")
