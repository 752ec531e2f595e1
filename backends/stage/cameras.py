"""Cameras of a stage at each sample."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from pxr import Usd, UsdGeom, UsdRender

from scenec.backends.stage import values
from scenec.backends.stage.frame import StageFrame
from scenec.backends.stage.imaging import read_imaging
from scenec.backends.stage.scene import DEFAULT_OUTPUTS, Camera, Focus
from scenec.backends.stage.sensors import read_depth_camera, read_trigger
from scenec.backends.stage.shutter import read_shutter
from scenec.schemas import stage as names
from scenec.schemas.errors import StageError
from scenec.schemas.lens import COEFFICIENTS, Lens
from scenec.schemas.passes import is_pass

_DEFAULT_RESOLUTION = (640, 480)


def read_cameras(
    stage: Usd.Stage, frame: StageFrame, times: list[Usd.TimeCode]
) -> tuple[tuple[Camera, ...], ...]:
    """Cameras at every sample.

    RenderProducts say which cameras are rendered, how large, and with which passes. Without any,
    every camera is, 640 pixels wide.

    Raises:
        StageError: A product without a camera, or a camera of no size.
    """
    found = [_of_product(p) for p in stage.Traverse() if p.IsA(UsdRender.Product)]
    if not found:
        everywhere = stage.Traverse(Usd.TraverseInstanceProxies())
        cameras = [p for p in everywhere if p.IsA(UsdGeom.Camera)]
        found = [
            _Request(name, p, _resolution(p), DEFAULT_OUTPUTS)
            for name, p in _distinct_names(cameras)
        ]
    return tuple(tuple(_camera(request, frame, time) for request in found) for time in times)


@dataclass(frozen=True)
class _Request:
    """What is to be rendered of a camera."""

    name: str
    prim: Usd.Prim
    size: tuple[int, int]
    outputs: tuple[str, ...]


def _of_product(prim: Usd.Prim) -> _Request:
    stage = prim.GetStage()
    product = UsdRender.Product(prim)
    targets = values.targets(prim, "camera")
    camera = stage.GetPrimAtPath(targets[0]) if targets else None
    if not camera or not camera.IsA(UsdGeom.Camera):
        raise StageError(f"{prim.GetPath()}: this RenderProduct names no camera")
    width, height = values.vector(product.GetResolutionAttr(), 2) or _DEFAULT_RESOLUTION
    outputs: dict[str, None] = {}
    for target in values.targets(prim, "orderedVars"):
        var = UsdRender.Var(stage.GetPrimAtPath(target))
        source = values.word(var.GetSourceNameAttr(), "") if var else ""
        # Foreign products name their renderer's own variables: those are not ours to make.
        if is_pass(source.split(".")[0]):
            outputs[source.split(".")[0]] = None
    size = (int(width), int(height))
    return _Request(prim.GetName(), camera, size, tuple(outputs) or DEFAULT_OUTPUTS)


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
    across = values.number(camera.GetHorizontalApertureAttr(), 0.0)
    up = values.number(camera.GetVerticalApertureAttr(), 0.0)
    width = _DEFAULT_RESOLUTION[0]
    return width, max(1, round(width * up / across)) if across > 0 else _DEFAULT_RESOLUTION[1]


def _camera(request: _Request, frame: StageFrame, time: Usd.TimeCode) -> Camera:
    prim, size = request.prim, request.size
    camera = UsdGeom.Camera(prim)
    projection = values.word(camera.GetProjectionAttr(), UsdGeom.Tokens.perspective, time)
    if projection != UsdGeom.Tokens.perspective:
        raise StageError(
            f"{prim.GetPath()}: is {projection}; only perspective cameras are rendered"
        )
    matrix = values.world_matrix(prim, time)
    pose = np.eye(4)
    pose[:3, :3] = frame.axes(matrix) * np.array(names.HALF_TURN)
    pose[:3, 3] = frame.point(matrix)
    if not np.isfinite(pose).all() or min(size) < 1:
        raise StageError(
            f"{prim.GetPath()}: a camera needs a resolution and an invertible transform"
        )
    ev, per = _exposure(prim, time)
    return Camera(
        name=request.name,
        path=str(prim.GetPath()),
        width=size[0],
        height=size[1],
        intrinsics=_intrinsics(prim, size, time),
        camera_to_world=pose,
        exposure_ev=ev,
        exposure_per=per,
        outputs=request.outputs,
        partner=_partner(prim),
        trigger=read_trigger(prim),
        depth_camera=read_depth_camera(prim),
        lens=_lens(prim),
        imaging=read_imaging(prim, time),
        shutter=read_shutter(prim, frame, time, pose),
        focus=_focus(prim, frame, time),
    )


def _exposure(prim: Usd.Prim, time: Usd.TimeCode) -> tuple[float, str | None]:
    """A camera's exposure, and what one is to be found for (``picture.exposure``) or None.

    By USD's definition, log2 of time * iso / 100 * 2^exposure * responsivity / fStop^2
    (``UsdGeomCamera.ComputeLinearExposureScale``, here in float64).
    """
    camera = UsdGeom.Camera(prim)
    factors = (
        (camera.GetExposureTimeAttr(), 1.0, 1.0),
        (camera.GetExposureIsoAttr(), 100.0, 1.0),
        (camera.GetExposureResponsivityAttr(), 1.0, 1.0),
        (camera.GetExposureFStopAttr(), 1.0, -2.0),
    )
    given = (camera.GetExposureAttr(), *(attribute for attribute, _, _ in factors))
    authored = prim.GetAttribute(names.ATTR_EXPOSURE_PER)
    per = None
    if authored.HasAuthoredValue():
        per = values.word(authored, names.EXPOSURES_PER[0], time, names.EXPOSURES_PER)
    elif not any(attribute.HasAuthoredValue() for attribute in given):
        per = "batch"
    ev = values.number(camera.GetExposureAttr(), 0.0, time)
    for attribute, usual, power in factors:
        value = values.number(attribute, usual, time)
        if not 0.0 < value < math.inf:
            raise StageError(
                f"{prim.GetPath()}: {attribute.GetName()} is {value:g}: expected a number above 0"
            )
        if value != usual:
            ev += power * math.log2(value / usual)
    if not math.isfinite(ev):
        raise StageError(f"{prim.GetPath()}: exposure is {ev:g}: expected a finite number")
    return ev, per


def _focus(prim: Usd.Prim, frame: StageFrame, time: Usd.TimeCode) -> Focus | None:
    """The aperture of a camera; without a distance or an f-stop above 0 none, as in USD."""
    camera = UsdGeom.Camera(prim)
    stop = values.number(camera.GetFStopAttr(), 0.0, time)
    distance = values.number(camera.GetFocusDistanceAttr(), 0.0, time) * frame.meters_per_unit
    if stop == 0.0 or distance == 0.0:
        return None
    # A focal length is in tenths of a unit.
    focal = 0.1 * frame.meters_per_unit * values.number(camera.GetFocalLengthAttr(), 0.0, time)
    radius = 0.5 * focal / stop
    if not (0.0 < distance < math.inf and 0.0 < radius < math.inf):
        raise StageError(
            f"{prim.GetPath()}: fStop is {stop:g} and focusDistance {distance:g} m; expected "
            "numbers above 0, or 0 for no depth of field"
        )
    if values.word(prim.GetAttribute(names.ATTR_LENS_MODEL), ""):
        raise StageError(
            f"{prim.GetPath()}: has both fStop and {names.ATTR_LENS_MODEL}; depth of field is "
            "drawn of cameras without a lens of the schema's: set fStop to 0"
        )
    return Focus(distance, radius)


def _lens(prim: Usd.Prim) -> Lens | None:
    """The lens of a camera; without one of the schema's a pinhole, as viewers show it."""
    model = values.word(prim.GetAttribute(names.ATTR_LENS_MODEL), "", known=COEFFICIENTS)
    if not model:
        return None
    count = len(COEFFICIENTS[model])
    coefficients = values.vector(prim.GetAttribute(names.ATTR_LENS_COEFFICIENTS), count) or ()
    if len(coefficients) != count:
        raise StageError(
            f"{prim.GetPath()}: {names.ATTR_LENS_COEFFICIENTS} of {model} must hold {count} finite "
            "numbers"
        )
    farthest = values.number(prim.GetAttribute(names.ATTR_LENS_MAX_ANGLE), math.pi)
    if not 0.0 < farthest <= math.pi:
        raise StageError(
            f"{prim.GetPath()}: {names.ATTR_LENS_MAX_ANGLE} is {farthest:g}; expected an angle "
            "above 0, at most pi"
        )
    return Lens(model, coefficients, farthest)


def _partner(prim: Usd.Prim) -> str | None:
    targets = values.targets(prim, names.REL_PARTNER)
    return str(targets[0]) if targets else None


def _intrinsics(prim: Usd.Prim, size: tuple[int, int], time: Usd.TimeCode) -> NDArray[np.float64]:
    stated = values.vector(prim.GetAttribute(names.ATTR_INTRINSICS), 9, time)
    if stated is None:
        k = intrinsics_from_apertures(prim, size, time)
    else:
        k = np.array(stated).reshape(3, 3)
    if k[0, 0] <= 0.0 or k[1, 1] <= 0.0:
        raise StageError(f"{prim.GetPath()}: a camera's focal length must be positive")
    return k


def intrinsics_from_apertures(
    prim: Usd.Prim, size: tuple[int, int], time: Usd.TimeCode
) -> NDArray[np.float64]:
    """K in pixels from a camera's focal length, apertures and offsets, float64 [3, 3]."""
    camera = UsdGeom.Camera(prim)
    focal, across, up, shift_x, shift_y = (
        values.number(attribute, 0.0, time)
        for attribute in (
            camera.GetFocalLengthAttr(),
            camera.GetHorizontalApertureAttr(),
            camera.GetVerticalApertureAttr(),
            camera.GetHorizontalApertureOffsetAttr(),
            camera.GetVerticalApertureOffsetAttr(),
        )
    )
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
