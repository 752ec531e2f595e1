"""Cameras of a stage at each sample."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from dataclasses import fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pxr import Gf, Usd, UsdGeom, UsdRender, Vt

from scenec.backends.stage import values
from scenec.backends.stage.frame import StageFrame
from scenec.backends.stage.omniverse import read_calibration
from scenec.backends.stage.products import Request, conformed, read_requests
from scenec.backends.stage.rigid import camera_poses
from scenec.backends.stage.scene import Camera, Focus, OpenShutter
from scenec.backends.stage.unread import Unread
from scenec.schemas import imaging as formulas
from scenec.schemas import stage as names
from scenec.schemas.affine import mirrored, orthonormal
from scenec.schemas.depth_camera import DepthCamera, of_numbers
from scenec.schemas.errors import OutputError, StageError
from scenec.schemas.imaging import Imaging
from scenec.schemas.lens import COEFFICIENTS, Lens
from scenec.schemas.shutter import Shutter
from scenec.schemas.spelling import shown
from scenec.schemas.vehicle import Vehicle

_DIRECTIONS = ("down", "up")
#: What names of attributes of a camera's exposure begin with.
_EXPOSURE = ("exposure", "scenec:exposure:")
#: How far a relative pose may be from a rigid one.
_RIGID = 1e-6
#: By how much of themselves the times of poses may miss the ends of the exposures.
_ENDS = 1e-9


def read_cameras(
    stage: Usd.Stage,
    frame: StageFrame,
    times: list[Usd.TimeCode],
    unread: Unread | None = None,
) -> tuple[tuple[Camera, ...], ...]:
    """Reads the cameras of the stage's render products at every sample (``products``).

    Args:
        stage: The stage.
        frame: Of the stage.
        times: Of the samples.
        unread: Collects what is not followed of them.

    Raises:
        StageError: A product without a camera, a camera of no size, or one that has no pose.
    """
    requests, left_out = read_requests(stage)
    columns = [_over_time(request, frame, times, unread) for request in requests]
    if unread is not None:
        for prim in left_out:
            unread.add("an orthographic camera is not rendered", prim)
    return tuple(tuple(column[i] for column in columns) for i in range(len(times)))


def _over_time(
    request: Request, frame: StageFrame, times: list[Usd.TimeCode], unread: Unread | None
) -> list[Camera]:
    """A camera at each time."""
    prim = request.prim
    poses, told = camera_poses(prim, frame, times)
    if told and prim.GetAttribute(names.ATTR_SHUTTER_EXPOSURE).HasValue():
        raise StageError(
            f"{prim.GetPath()}: {told[0].split(':')[0]}, and has {names.ATTR_SHUTTER_EXPOSURE}: "
            "expected moves, turns and one scale above 0"
        )
    if request.window != (0, 0, *request.full):
        # Both are of the whole sensor.
        for name in (names.ATTR_SHUTTER_EXPOSURE, formulas.attribute("rule")):
            if prim.GetAttribute(name).HasAuthoredValue():
                raise StageError(
                    f"{prim.GetPath()}: has {name}, and a dataWindowNDC of a part of its picture; "
                    "expected one of them"
                )
    if unread is not None:
        unread.camera(prim)
        calibrated = read_calibration(prim, request.full, times[0])
        for line in (*told, *(calibrated.notes if calibrated else ())):
            unread.add(line, prim)
        if calibrated and calibrated.lens and _focus(prim, frame, times[0]):
            unread.add("depth of field of a camera with a lens is not drawn", prim)
    poses[..., :3, :3] *= names.HALF_TURN
    # What differs from sample to sample where nothing else does.
    exposures = [a for a in prim.GetAttributes() if a.GetName().startswith(_EXPOSURE)]
    exposed = values.cached(exposures, lambda time: _exposure(prim, time))
    at = values.cached(
        values.inputs(prim, *_EXPOSURE, "scenec:shutter:"),
        lambda time: _camera(request, frame, time),
    )
    found = []
    for time, pose in zip(times, poses, strict=True):
        camera, (ev, per) = at(time), exposed(time)
        shutter = _shutter(prim, frame, time, pose)
        found.append(
            replace(camera, camera_to_world=pose, exposure_ev=ev, exposure_per=per, shutter=shutter)
        )
    return found


def _camera(request: Request, frame: StageFrame, time: Usd.TimeCode) -> Camera:
    """All of a camera but its pose, exposure and shutter."""
    prim, (_, _, width, height) = request.prim, request.window
    camera = UsdGeom.Camera(prim)
    projection = values.word(camera.GetProjectionAttr(), UsdGeom.Tokens.perspective, time)
    if projection != UsdGeom.Tokens.perspective:
        raise StageError(
            f"{prim.GetPath()}: is {projection}; only perspective cameras are rendered"
        )
    calibrated = read_calibration(prim, request.full, time)
    k = _intrinsics(request, time) if calibrated is None else calibrated.intrinsics
    k[:2, 2] -= request.window[:2]
    lens = _lens(prim) if calibrated is None else calibrated.lens
    return Camera(
        name=request.name,
        path=str(prim.GetPath()),
        width=width,
        height=height,
        intrinsics=k,
        camera_to_world=np.eye(4),
        outputs=request.outputs,
        partner=_partner(prim),
        trigger=read_trigger(prim),
        depth_camera=_depth_camera(prim),
        lens=lens,
        imaging=read_imaging(prim, time),
        focus=None if calibrated and lens else _focus(prim, frame, time),
        effects=_effects(prim),
        vehicle=_vehicle(prim),
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


def _effects(prim: Usd.Prim) -> tuple[str, ...]:
    """Returns other packages' effects on the camera's pictures, each as JSON."""
    found = tuple(values.words(prim.GetAttribute(names.ATTR_EFFECTS)))
    for text in found:
        try:
            keys = json.loads(text)
            fine = {"type": str, "from": str, "key": int}.items()
            sound = isinstance(keys, dict) and all(isinstance(keys.get(k), t) for k, t in fine)
        except (ValueError, RecursionError):
            sound = False
        if not sound:
            raise StageError(
                f"{prim.GetPath()}: {names.ATTR_EFFECTS}: {shown(text)}: expected a JSON object "
                "with a type, a package (from) and a key"
            )
    return found


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


def _intrinsics(request: Request, time: Usd.TimeCode) -> NDArray[np.float64]:
    prim = request.prim
    stated = values.vector(prim.GetAttribute(names.ATTR_INTRINSICS), 9, time)
    if stated is None:
        k = intrinsics_from_apertures(
            prim, request.full, time, request.policy, request.pixel_aspect
        )
    else:
        k = np.array(stated).reshape(3, 3)
    if k[0, 0] <= 0.0 or k[1, 1] <= 0.0:
        raise StageError(f"{prim.GetPath()}: a camera's focal length must be positive")
    return k


def intrinsics_from_apertures(
    prim: Usd.Prim,
    size: tuple[int, int],
    time: Usd.TimeCode,
    policy: str = UsdRender.Tokens.adjustPixelAspectRatio,
    pixel_aspect: float = 1.0,
) -> NDArray[np.float64]:
    """Returns K in pixels from a camera's focal length, apertures and offsets, float64 [3, 3].

    Args:
        prim: The camera.
        size: Width and height of its picture, pixels.
        time: When.
        policy: How apertures are made to fit the picture (``products.conformed``); pixels as the
            apertures have them without one.
        pixel_aspect: Width of a pixel over its height.

    Raises:
        StageError: An aperture is not above 0.
    """
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
    across, up = conformed(across, up, size, policy, pixel_aspect)
    return np.array(
        [
            [focal * width / across, 0.0, 0.5 * width - shift_x * width / across],
            [0.0, focal * height / up, 0.5 * height + shift_y * height / up],
            [0.0, 0.0, 1.0],
        ]
    )


def read_trigger(prim: Usd.Prim) -> tuple[int, int]:
    """Samples from one to the next that a sensor is triggered at, and the first.

    Raises:
        StageError: Numbers that cannot be.
    """
    if not prim.HasAttribute(names.ATTR_TRIGGER):
        return 1, 0
    every, first = values.vector(prim.GetAttribute(names.ATTR_TRIGGER), 2) or (0.0, 0.0)
    if every < 1 or first < 0:
        raise StageError(
            f"{prim.GetPath()}: {names.ATTR_TRIGGER} is ({every:g}, {first:g}), expected at least "
            "(1, 0)"
        )
    return int(every), int(first)


def _depth_camera(prim: Usd.Prim) -> DepthCamera | None:
    """Reads a camera's model of depth, or None."""
    kind = values.word(prim.GetAttribute(names.ATTR_DEPTH_MODEL), "")
    if not kind:
        return None
    numbers = values.array(prim.GetAttribute(names.ATTR_DEPTH_NUMBERS), np.float64, finite=False)
    key = values.whole(prim.GetAttribute(names.ATTR_DEPTH_KEY), 0)
    try:
        return DepthCamera(of_numbers(kind, numbers.tolist()), key)
    except ValueError as error:
        raise StageError(f"{prim.GetPath()}: {names.ATTR_DEPTH_NUMBERS}: {error}") from error


def _vehicle(prim: Usd.Prim) -> Vehicle | None:
    """Reads a camera's vehicle, or None."""
    attribute = prim.GetAttribute(names.ATTR_VEHICLE)
    if not attribute or not attribute.HasAuthoredValue():
        return None
    numbers = values.array(attribute, np.float64).tolist()
    declared = [one.name for one in fields(Vehicle)]
    if len(numbers) != len(declared):
        raise StageError(
            f"{attribute.GetPath()}: has {len(numbers)} numbers, expected {len(declared)}: "
            f"{', '.join(declared)}"
        )
    try:
        return Vehicle(**dict(zip(declared, numbers, strict=True)))
    except OutputError as error:
        raise StageError(f"{attribute.GetPath()}: {error}") from error


#: By the names of ``Sdf.ValueTypeNames``.
_READERS: dict[str, Callable[[Usd.Attribute, Usd.TimeCode], Any]] = {
    "Bool": lambda attribute, time: values.flag(attribute, False, time),
    "Double": lambda attribute, time: values.number(attribute, 0.0, time),
    "DoubleArray": lambda attribute, time: tuple(
        values.array(attribute, np.float64, time).tolist()
    ),
    "Int": lambda attribute, time: values.whole(attribute, 0, time),
    "Token": lambda attribute, time: values.word(attribute, "", time),
    "UInt64": lambda attribute, time: values.whole(attribute, 0, time),
}


def read_imaging(prim: Usd.Prim, time: Usd.TimeCode) -> Imaging | None:
    """Reads a camera's imaging at a time; None without ``scenec:imaging:rule``.

    Raises:
        StageError: A parameter is not what it can be.
    """
    given = {field: prim.GetAttribute(formulas.attribute(field)) for field in formulas.TYPES}
    if not given["rule"].HasAuthoredValue():
        return None
    imaging = Imaging(
        **{
            field: _READERS[kind](given[field], time)
            for field, kind in formulas.TYPES.items()
            if given[field].HasAuthoredValue()
        }
    )
    faults = formulas.faults(imaging)
    if faults:
        raise StageError(f"{prim.GetPath()}: {'; '.join(faults)}")
    return imaging


def _shutter(
    prim: Usd.Prim, frame: StageFrame, time: Usd.TimeCode, pose: NDArray[np.float64]
) -> OpenShutter | None:
    """The shutter of a camera that has a pose at a sample; None where the stage names none."""
    exposure = prim.GetAttribute(names.ATTR_SHUTTER_EXPOSURE)
    if not exposure or not exposure.HasValue():
        return None
    direction = prim.GetAttribute(names.ATTR_SHUTTER_DIRECTION)
    shutter = Shutter(
        values.number(exposure, 0.0, time),
        values.number(prim.GetAttribute(names.ATTR_SHUTTER_READOUT), 0.0),
        values.word(direction, "down", known=_DIRECTIONS) == "up",
    )
    if shutter.exposure_s < 0.0 or shutter.readout_s < 0.0:
        raise StageError(
            f"{prim.GetPath()}: {names.ATTR_SHUTTER_EXPOSURE} is {shutter.exposure_s:g} s and "
            f"{names.ATTR_SHUTTER_READOUT} {shutter.readout_s:g} s; expected 0 or more"
        )
    listed, moved = (
        prim.GetAttribute(name) for name in (names.ATTR_SHUTTER_TIMES, names.ATTR_SHUTTER_POSES)
    )
    times, steps = np.zeros(1), np.eye(4)[None]
    if values.value_of(listed) is not None:
        times = values.array(listed, np.float64)
    if values.value_of(moved, time) is not None:
        steps = values.array(moved, np.float64, time, width=(4, 4), finite=False)
    half = shutter.half_span * (1.0 - _ENDS)
    if (
        not (np.diff(times) > 0.0).all()
        or 0.0 not in times
        or (len(times) > 1 and not times[0] <= -half <= half <= times[-1])
    ):
        raise StageError(
            f"{prim.GetPath()}: {names.ATTR_SHUTTER_TIMES} are {shown(times.tolist())}; expected "
            f"seconds that rise, 0 among them, from -{shutter.half_span:g} to "
            f"{shutter.half_span:g} or beyond"
        )
    if len(steps) != len(times):
        raise StageError(
            f"{prim.GetPath()}: {len(steps)} {names.ATTR_SHUTTER_POSES} for {len(times)} "
            f"{names.ATTR_SHUTTER_TIMES}; expected one for each"
        )
    turns = steps[:, :3, :3]
    affine = np.abs(steps[..., 3] - (0.0, 0.0, 0.0, 1.0)).max(axis=1) <= _RIGID
    rigid = np.isfinite(steps).all(axis=(1, 2)) & affine
    rigid &= orthonormal(turns, _RIGID) & ~mirrored(turns)
    rigid |= times == 0.0
    if not rigid.all():
        at = int(np.argmin(rigid))
        raise StageError(f"{prim.GetPath()}: {names.ATTR_SHUTTER_POSES}[{at}] is no rigid motion")
    whole = UsdGeom.Xformable(prim).ComputeLocalToWorldTransform(time)
    moved_by = [Gf.Matrix4d(step) * whole for step in steps.tolist()]
    poses = frame.pose(np.array(Vt.Matrix4dArray(moved_by)).transpose(0, 2, 1)[:, :3])
    poses[:, :3, :3] *= names.HALF_TURN
    poses[times == 0.0] = pose
    return OpenShutter(shutter, times, poses)
