"""Cameras of a stage, as rigs of one sensor each."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from pxr import Usd, UsdGeom, UsdRender

from scenec.backends.stage import values
from scenec.backends.stage.scene import Camera
from scenec.importers.numbers import tidy
from scenec.importers.report import ADDED, APPROXIMATED, DROPPED, TRANSLATED
from scenec.importers.scene import intrinsics, orbit, unused, varied_pose
from scenec.importers.usd.scene import Scene, name_of
from scenec.importers.writers import track_writer
from scenec.schemas.lens import COEFFICIENTS, KANNALA_BRANDT

#: f-numbers that a cfg can have.
_STOPS = (0.5, 1000.0)


#: A camera at each sample.
type Seen = Sequence[Camera]


def moves(views: Seen) -> bool:
    """Tells whether the pose of a camera changes."""
    first = views[0].camera_to_world
    return any(not np.array_equal(first, camera.camera_to_world) for camera in views)


def add_cameras(scene: Scene, views: Sequence[Seen]) -> None:
    """Adds a rig for each camera that ``render`` draws, or an orbit if there is none."""
    rigs, report = scene.imported.cfg["rigs"], scene.imported.report
    for seen in views:
        name = unused(name_of(seen[0].path), rigs)
        to = f"rigs/{name}/sensors/camera"
        rigs[name] = {
            "pose": _pose(scene, seen, name),
            # Where the stage has it: beyond its ground, or inside of something, as well.
            "allow_below": True,
            "sensors": {"camera": {}},
        }
        rigs[name]["sensors"]["camera"].update(_sensor(scene, seen, to))
    drawn = {seen[0].path for seen in views}
    for prim in scene.stage.Traverse(Usd.TraverseInstanceProxies()):
        if prim.IsA(UsdGeom.Camera) and str(prim.GetPath()) not in drawn:
            why = "render draws others: those of its products, none that is orthographic"
            report.add(DROPPED, str(prim.GetPath()), None, "", why)
    if not rigs:
        rigs["orbit"] = orbit(min(scene.extent_m))
        report.added("rigs/orbit", "the stage has no camera: an orbit")


def _pose(scene: Scene, views: Seen, name: str) -> dict[str, Any]:
    report, at, moving = scene.imported.report, views[0].path, moves(views)
    poses = [camera.camera_to_world.copy() for camera in views]
    for pose in poses:
        pose[:3, 3] += scene.shift
    if not moving and "cameras" not in scene.keep:
        note = "about where it is and looks; --keep cameras leaves it there"
        report.add(APPROXIMATED, at, None, f"rigs/{name}/pose", note)
        return varied_pose(poses[0], min(scene.extent_m))
    times = scene.times_s.tolist()
    if len(times) == 1:
        times, poses = [0.0, 1.0], poses * 2
    made = scene.imported.make(f"{name}.csv", track_writer(times, poses))
    count, note = (len(poses), "its motion, as a track") if moving else (None, "")
    report.add(TRANSLATED, at, count, f"rigs/{name}/pose", note)
    return {"type": "track", "file": made, "sampling": {}}


def _sensor(scene: Scene, views: Seen, to: str) -> dict[str, Any]:
    report, camera = scene.imported.report, views[0]
    at, size = camera.path, [camera.width, camera.height]
    if at in _named(scene.stage):
        report.add(TRANSLATED, at, size, f"{to}/resolution")
    else:
        report.add(ADDED, at, size, f"{to}/resolution", "no render product names it")
    sensor: dict[str, Any] = {
        "resolution": size,
        **intrinsics(camera.intrinsics.ravel().tolist(), corner=0.0),
    }
    constant = all(np.array_equal(c.intrinsics, camera.intrinsics) for c in views)
    note = "" if constant else "as it is at the first sample"
    fate = TRANSLATED if constant else APPROXIMATED
    report.add(fate, f"{at}.focalLength", None, f"{to}/intrinsics", note)
    if camera.lens is not None:
        numbers = zip(COEFFICIENTS[camera.lens.model], camera.lens.coefficients, strict=True)
        sensor["lens"] = {"type": camera.lens.model, **{k: v for k, v in numbers if v}}
        if camera.lens.model == KANNALA_BRANDT and camera.lens.max_angle < math.pi:
            sensor["lens"]["max_angle_deg"] = tidy(math.degrees(camera.lens.max_angle))
        report.add(TRANSLATED, at, camera.lens.model, f"{to}/lens")
    if camera.exposure_per is None:
        sensor["exposure"] = {"type": "fixed", "ev": tidy(camera.exposure_ev)}
        constant = all(c.exposure_ev == camera.exposure_ev for c in views)
        note = "" if constant else "as it is at the first sample"
        fate = TRANSLATED if constant else APPROXIMATED
        report.add(fate, f"{at}.exposure", camera.exposure_ev, f"{to}/exposure", note)
    elif camera.exposure_per == "sample":
        sensor["exposure"] = {"type": "auto", "per": "sample"}
    if camera.focus is not None:
        sensor |= _focus(scene, views, to)
    for name, there in (
        ("shutter", camera.shutter), ("imaging", camera.imaging), ("effects", camera.effects),
        ("depth camera", camera.depth_camera), ("partner", camera.partner),
    ):  # fmt: skip
        if there:
            report.add(DROPPED, at, None, "", f"its {name}, of scenec's own schema")
    return sensor


def _focus(scene: Scene, views: Seen, to: str) -> dict[str, Any]:
    """Returns distance and aperture of a camera; the stage fixes the radius, not the f-number."""
    focus, at = views[0].focus, views[0].path
    assert focus is not None, "a camera without depth of field"
    prim = UsdGeom.Camera(scene.stage.GetPrimAtPath(at))
    stop = values.number(prim.GetFStopAttr(), 1.0, Usd.TimeCode.EarliestTime())
    stop = min(max(stop, _STOPS[0]), _STOPS[1])
    focal_m = 2.0 * stop * focus.aperture_radius_m
    report = scene.imported.report
    if not focal_m < focus.distance_m:
        why = f"sharp at {focus.distance_m:g} m, within its focal length of {focal_m:g} m"
        report.add(DROPPED, f"{at}.fStop", stop, "", why)
        return {}
    constant = all(camera.focus == focus for camera in views)
    note = "" if constant else "as it is at the first sample"
    fate = TRANSLATED if constant else APPROXIMATED
    report.add(fate, f"{at}.fStop", stop, f"{to}/focus", note)
    return {
        "focus": {
            "distance_m": tidy(focus.distance_m),
            "f_number": tidy(stop),
            "focal_length_mm": tidy(1000.0 * focal_m),
        }
    }


def _named(stage: Usd.Stage) -> set[str]:
    """Lists paths of cameras that a render product names."""
    products = [prim for prim in stage.Traverse() if prim.IsA(UsdRender.Product)]
    return {str(target) for p in products for target in values.targets(p, "camera")}
