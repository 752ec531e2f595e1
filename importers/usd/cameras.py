"""Cameras of a stage, as rigs of one sensor each."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from pxr import Sdf, Usd, UsdGeom, UsdRender

from scenec.importers.made import track_writer
from scenec.importers.numbers import tidy
from scenec.importers.poses import FLIP, without_scale
from scenec.importers.report import ADDED, APPROXIMATED, DROPPED, TRANSLATED
from scenec.importers.scene import orbit, unused, varied_pose
from scenec.importers.usd.scene import Scene
from scenec.schemas.errors import ScenecError

#: Width of pictures of a camera that no product names.
_WIDTH = 640


def add_cameras(scene: Scene) -> None:
    """A rig for each camera; an orbit where there is none."""
    rigs, report = scene.imported.cfg["rigs"], scene.imported.report
    products = _products(scene.stage)
    for prim in scene.stage.Traverse(Usd.TraverseInstanceProxies()):
        if not prim.IsA(UsdGeom.Camera):
            continue
        camera, at = UsdGeom.Camera(prim), str(prim.GetPath())
        if camera.GetProjectionAttr().Get() == UsdGeom.Tokens.orthographic:
            report.add(DROPPED, at, None, "", "an orthographic camera has no counterpart")
            continue
        name = unused(prim.GetName(), rigs)
        rigs[name] = {
            "pose": _pose(scene, prim, name),
            "sensors": {"camera": _sensor(scene, camera, products, f"rigs/{name}/sensors/camera")},
        }
    if not rigs:
        rigs["orbit"] = orbit(min(scene.extent_m))
        report.added("rigs/orbit", "the stage has no camera: an orbit")


def _products(stage: Usd.Stage) -> dict[Sdf.Path, tuple[int, int]]:
    """Resolution of each camera that a render product names."""
    found = {}
    for prim in stage.Traverse():
        if prim.IsA(UsdRender.Product):
            product = UsdRender.Product(prim)
            size = product.GetResolutionAttr().Get()
            for target in product.GetCameraRel().GetTargets():
                found[target] = (int(size[0]), int(size[1]))
    return found


def _pose(scene: Scene, prim: Usd.Prim, name: str) -> dict[str, Any]:
    report, at = scene.imported.report, str(prim.GetPath())
    times = _times(prim)
    if len(times) > 1:
        rate = scene.stage.GetTimeCodesPerSecond() or 24.0
        poses = [_camera_pose(scene, prim, Usd.TimeCode(t)) for t in times]
        seconds = [(t - times[0]) / rate for t in times]
        made = scene.imported.make(f"{name}.csv", track_writer(seconds, poses))
        report.add(TRANSLATED, at, len(times), f"rigs/{name}/pose", "its motion, as a track")
        return {"type": "track", "file": made, "sampling": {}}
    pose = _camera_pose(scene, prim, Usd.TimeCode.EarliestTime())
    if "cameras" in scene.keep:
        made = scene.imported.make(f"{name}.csv", track_writer([0.0, 1.0], [pose, pose]))
        report.add(TRANSLATED, at, None, f"rigs/{name}/pose")
        return {"type": "track", "file": made, "sampling": {}}
    note = "about where it is and looks; --keep cameras leaves it there"
    report.add(APPROXIMATED, at, None, f"rigs/{name}/pose", note)
    return varied_pose(pose, min(scene.extent_m))


def _times(prim: Usd.Prim) -> list[float]:
    """Time codes at which a prim, or what it stands below, has another transform."""
    found: set[float] = set()
    while prim and not prim.IsPseudoRoot():
        if prim.IsA(UsdGeom.Xformable):
            found.update(UsdGeom.Xformable(prim).GetTimeSamples())
        prim = prim.GetParent()
    return sorted(found)


def _camera_pose(scene: Scene, prim: Usd.Prim, time: Usd.TimeCode) -> NDArray[np.float64]:
    pose = scene.placed(prim, time)
    pose[:3, :3] = without_scale(pose[:3, :3])[0] @ FLIP
    return pose


def _sensor(
    scene: Scene, camera: UsdGeom.Camera, products: dict[Sdf.Path, tuple[int, int]], to: str
) -> dict[str, Any]:
    time = Usd.TimeCode.EarliestTime()
    report, at = scene.imported.report, str(camera.GetPath())
    wide, high, focal, right, up, stop, focus = (
        float(attribute.Get(time))
        for attribute in (
            camera.GetHorizontalApertureAttr(), camera.GetVerticalApertureAttr(),
            camera.GetFocalLengthAttr(), camera.GetHorizontalApertureOffsetAttr(),
            camera.GetVerticalApertureOffsetAttr(), camera.GetFStopAttr(),
            camera.GetFocusDistanceAttr(),
        )
    )  # fmt: skip
    if min(wide, high, focal) <= 0.0:
        found = f"{wide:g}, {high:g} and {focal:g}"
        raise ScenecError(f"{at}: apertures and focal length are {found}: expected them above 0")
    size = products.get(camera.GetPath())
    if size is None:
        size = (_WIDTH, max(round(_WIDTH * high / wide), 1))
        report.add(ADDED, at, list(size), f"{to}/resolution", "no render product names it")
    else:
        report.add(TRANSLATED, at, list(size), f"{to}/resolution")
    width, height = size
    report.add(TRANSLATED, f"{at}.focalLength", focal, f"{to}/intrinsics")
    sensor: dict[str, Any] = {
        "resolution": [width, height],
        "intrinsics": {
            "fx": tidy(width * focal / wide),
            "fy": tidy(height * focal / high),
            "cx": tidy(0.5 * width - right * width / wide),
            "cy": tidy(0.5 * height + up * height / high),
        },
    }
    if stop > 0.0 and focus > 0.0:
        unit = float(scene.model["unit_m"])
        sensor["focus"] = {
            "distance_m": tidy(focus * unit),
            "f_number": tidy(max(stop, 0.5)),
            # Of a camera, lengths are tenths of the stage's unit.
            "focal_length_mm": tidy(100.0 * focal * unit),
        }
        report.add(TRANSLATED, f"{at}.fStop", stop, f"{to}/focus")
    return sensor
