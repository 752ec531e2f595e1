"""Cameras of a stage at each sample."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from pxr import Usd, UsdGeom, UsdRender

from scenec.backends.reader.frame import StageFrame, columns
from scenec.backends.render_scene import Camera
from scenec.schemas import stage as names
from scenec.schemas.errors import StageError

_DEFAULT_RESOLUTION = (640, 480)
#: USD cameras look down -Z with y up, OpenCV's down +z with y down: a half turn about x.
_HALF_TURN = np.array([1.0, -1.0, -1.0])


def read_cameras(
    stage: Usd.Stage, frame: StageFrame, times: list[Usd.TimeCode]
) -> tuple[tuple[tuple[Camera, ...], ...], tuple[str, ...]]:
    """Cameras at every sample, and the outputs that the stage asks for.

    RenderProducts say which cameras are rendered and how large. Without any, every camera is, 640
    pixels wide.

    Raises:
        StageError: A product without a camera, or a camera of no size.
    """
    found: list[tuple[str, Usd.Prim, tuple[int, int]]] = []
    outputs: dict[str, None] = {}
    for prim in stage.Traverse():
        if prim.IsA(UsdRender.Product):
            product = UsdRender.Product(prim)
            targets = product.GetCameraRel().GetForwardedTargets()
            camera = stage.GetPrimAtPath(targets[0]) if targets else None
            if not camera or not camera.IsA(UsdGeom.Camera):
                raise StageError(f"{prim.GetPath()}: this RenderProduct names no camera")
            width, height = product.GetResolutionAttr().Get()
            found.append((prim.GetName(), camera, (int(width), int(height))))
            for target in product.GetOrderedVarsRel().GetForwardedTargets():
                var = UsdRender.Var(stage.GetPrimAtPath(target))
                source = str(var.GetSourceNameAttr().Get() or "") if var else ""
                outputs[source.split(".")[0]] = None
    if not found:
        cameras = [p for p in stage.Traverse() if p.IsA(UsdGeom.Camera)]
        found = [(name, p, _resolution(p)) for name, p in _distinct_names(cameras)]
    samples = tuple(
        tuple(_camera(name, prim, size, frame, time) for name, prim, size in found)
        for time in times
    )
    outputs.pop("", None)
    return samples, tuple(outputs)


def _distinct_names(prims: list[Usd.Prim]) -> list[tuple[str, Usd.Prim]]:
    taken = [p.GetName() for p in prims]
    return [
        (
            p.GetName()
            if taken.count(p.GetName()) == 1
            else str(p.GetPath())[1:].replace("/", "_"),
            p,
        )
        for p in prims
    ]


def _resolution(prim: Usd.Prim) -> tuple[int, int]:
    camera = UsdGeom.Camera(prim)
    across = camera.GetHorizontalApertureAttr().Get()
    up = camera.GetVerticalApertureAttr().Get()
    width = _DEFAULT_RESOLUTION[0]
    return width, max(1, round(width * up / across)) if across > 0 else _DEFAULT_RESOLUTION[1]


def _camera(
    name: str, prim: Usd.Prim, size: tuple[int, int], frame: StageFrame, time: Usd.TimeCode
) -> Camera:
    matrix = columns(UsdGeom.Xformable(prim).ComputeLocalToWorldTransform(time))
    pose = np.eye(4)
    pose[:3, :3] = frame.axes(matrix) * _HALF_TURN
    pose[:3, 3] = frame.point(matrix)
    if not np.isfinite(pose).all() or min(size) < 1:
        raise StageError(
            f"{prim.GetPath()}: a camera needs a resolution and an invertible transform"
        )
    exposure = UsdGeom.Camera(prim).GetExposureAttr().Get(time)
    return Camera(
        name=name,
        path=str(prim.GetPath()),
        width=size[0],
        height=size[1],
        intrinsics=_intrinsics(prim, size, time),
        camera_to_world=pose,
        exposure_ev=float(exposure or 0.0),
    )


def _intrinsics(prim: Usd.Prim, size: tuple[int, int], time: Usd.TimeCode) -> NDArray[np.float64]:
    attribute = prim.GetAttribute(names.ATTR_INTRINSICS)
    if attribute and attribute.HasValue():
        values = np.array(attribute.Get(time), np.float64)
        if values.shape != (9,) or not np.isfinite(values).all():
            raise StageError(
                f"{prim.GetPath()}: {names.ATTR_INTRINSICS} must hold 9 finite numbers"
            )
        k = values.reshape(3, 3)
    else:
        k = intrinsics_from_apertures(prim, size, time)
    if k[0, 0] <= 0.0 or k[1, 1] <= 0.0:
        raise StageError(f"{prim.GetPath()}: a camera's focal length must be positive")
    return k


def intrinsics_from_apertures(
    prim: Usd.Prim, size: tuple[int, int], time: Usd.TimeCode
) -> NDArray[np.float64]:
    """K in pixels from a camera's focal length, apertures and offsets, float64 [3, 3]."""
    camera = UsdGeom.Camera(prim)
    focal = camera.GetFocalLengthAttr().Get(time)
    across = camera.GetHorizontalApertureAttr().Get(time)
    up = camera.GetVerticalApertureAttr().Get(time)
    shift_x = camera.GetHorizontalApertureOffsetAttr().Get(time)
    shift_y = camera.GetVerticalApertureOffsetAttr().Get(time)
    if across <= 0.0 or up <= 0.0:
        raise StageError(f"{prim.GetPath()}: a camera's apertures must be positive")
    width, height = size
    return np.array(
        [
            [focal * width / across, 0.0, 0.5 * width - shift_x * width / across],
            [0.0, focal * height / up, 0.5 * height + shift_y * height / up],
            [0.0, 0.0, 1.0],
        ]
    )
