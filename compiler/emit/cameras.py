"""Writes the layer of rigs, cameras, and what is to be rendered.

A rig's frame and a sensor's pose on it have OpenCV axes (x right, y down, z forward). A
UsdGeomCamera looks down its -Z with y up: its prim carries the half turn about x that relates the
two. ``camera_to_world`` of the contract is therefore (prim's local-to-world) * HALF_TURN.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import astuple
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from pxr import Gf, Sdf, Usd, UsdGeom, UsdRender, Vt

from scenec.compiler.cameras.shutters import clock, codes_at
from scenec.compiler.emit.layer import TYPES, author, custom, matrix, new_layer
from scenec.compiler.scene.rig import Lidar, OpenShutter, Rig, Sensor
from scenec.compiler.scene.scene import Scene
from scenec.schemas import imaging as formulas
from scenec.schemas import stage as names
from scenec.schemas.depth_camera import DepthCamera, as_numbers, kind_of
from scenec.schemas.imaging import Imaging
from scenec.schemas.imu import Imu
from scenec.schemas.lens import KANNALA_BRANDT, Lens
from scenec.schemas.lidar import as_numbers as of_lidar
from scenec.schemas.passes import BUILT_IN

RIGS = f"{names.ROOT}/Rigs"
HALF_TURN = np.array([*names.HALF_TURN, 1.0])
#: A lidar's axes (x ahead, y left, z up) as columns in OpenCV's (x right, y down, z forward).
_LIDAR = np.array([[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]])
#: Full-frame width in stage units: USD counts apertures in tenths of a unit, and 36 mm are 0.36.
_APERTURE = 0.36
_NEAR_M = 0.01
#: Roles of vectors; other passes have the type that their channels make.
_VAR_TYPES = {"rgb": "color3f", "normal": "normal3f", "position": "point3f", "amodal": "int"}


def write_cameras(path: Path, scene: Scene) -> None:
    """Writes ``cameras.usdc``: rigs, cameras, a RenderProduct for each camera, samples' times."""
    with new_layer(path) as stage:
        world = stage.GetDefaultPrim()
        time = custom(world, names.ATTR_TIME, TYPES.Double)
        author(time, scene.times.tolist())
        UsdGeom.Scope.Define(stage, RIGS)
        products = []
        for rig in scene.rigs:
            xform = UsdGeom.Xform.Define(stage, f"{RIGS}/{rig.name}")
            op = xform.AddTransformOp()
            author(op.GetAttr(), [matrix(m) for m in rig.to_world])
            write_between(op, rig)
            for sensor in rig.sensors:
                camera = _write_camera(stage, rig, sensor)
                products.append(_write_product(stage, rig, sensor, camera, scene))
            for lidar in rig.lidars:
                write_lidar(stage, f"{RIGS}/{rig.name}/{lidar.name}", lidar)
            for imu in rig.imus:
                write_imu(stage, f"{RIGS}/{rig.name}/{imu.name}", imu)
        settings = UsdRender.Settings.Define(stage, f"{names.RENDER_SCOPE}/Settings")
        settings.CreateProductsRel().SetTargets(products)


def camera_path(rig: Rig, sensor: Sensor) -> str:
    """Prim path of a camera."""
    return f"{RIGS}/{rig.name}/{sensor.name}"


def clipping_range(rig: Rig, sensor: Sensor, bounds: NDArray[np.float64]) -> Gf.Vec2f:
    """Near and far for rasterizers: nothing of the batch lies beyond, from any pose of the rig.

    It depends on all geometry, so it stands in the root layer: another object class must leave the
    layer of cameras as it is.
    """
    mount = sensor.to_rig[:3, 3]
    at = rig.to_world[:, :3, 3]
    if rig.between is not None:
        at = np.concatenate([at, rig.between.to_world[:, :3, 3]])
    reach = np.maximum(*(np.abs(at - corner) for corner in bounds))
    far = np.sqrt((reach * reach).sum(axis=1)).max() + np.sqrt((mount * mount).sum())
    # 1 % beyond; float32 rounds by far less.
    return Gf.Vec2f(min(_NEAR_M, 1e-3 * far), 1.01 * float(far))


def _write_camera(stage: Usd.Stage, rig: Rig, sensor: Sensor) -> UsdGeom.Camera:
    camera = UsdGeom.Camera.Define(stage, camera_path(rig, sensor))
    camera.AddTransformOp().Set(matrix(sensor.to_rig * HALF_TURN[None, :]))
    width, height = sensor.resolution
    fx, fy, cx, cy, skew = sensor.intrinsics
    across = _APERTURE
    if sensor.focus is not None:
        # The lens's own size, which blur follows from: USD's lengths are tenths of a unit.
        across = 10.0 * sensor.focus.focal_length_m * width / fx
    focal = fx * across / width
    vertical = height * focal / fy
    camera.CreateProjectionAttr(UsdGeom.Tokens.perspective)
    camera.CreateFocalLengthAttr(focal)
    camera.CreateHorizontalApertureAttr(across)
    camera.CreateVerticalApertureAttr(vertical)
    camera.CreateHorizontalApertureOffsetAttr((0.5 * width - cx) * across / width)
    camera.CreateVerticalApertureOffsetAttr((cy - 0.5 * height) * vertical / height)
    if sensor.focus is not None:
        author(camera.CreateFStopAttr(), sensor.focus.f_number.tolist())
        author(camera.CreateFocusDistanceAttr(), sensor.focus.distance_m.tolist())
    if sensor.shutter is not None:
        write_shutter(camera, rig, sensor.shutter)
    if sensor.lens is not None:
        write_lens(camera.GetPrim(), sensor.lens)
    write_trigger(camera.GetPrim(), sensor.trigger)
    if sensor.depth_camera is not None:
        write_depth_camera(camera.GetPrim(), sensor.depth_camera)
    if sensor.vehicle is not None:
        numbers = Vt.DoubleArray(list(astuple(sensor.vehicle)))
        custom(camera.GetPrim(), names.ATTR_VEHICLE, TYPES.DoubleArray).Set(numbers)
    if sensor.partner is not None:
        camera.GetPrim().CreateRelationship(names.REL_PARTNER, custom=True).SetTargets(
            [f"{RIGS}/{rig.name}/{sensor.partner}"]
        )
    if "rgb" in sensor.outputs:
        author(camera.CreateExposureAttr(), sensor.exposure_ev.tolist())
        if sensor.exposure_per is not None:
            custom(camera.GetPrim(), names.ATTR_EXPOSURE_PER, TYPES.Token).Set(sensor.exposure_per)
    if sensor.imaging is not None:
        write_imaging(camera.GetPrim(), sensor.imaging)
    if sensor.effects:
        custom(camera.GetPrim(), names.ATTR_EFFECTS, TYPES.StringArray).Set(list(sensor.effects))
    custom(camera.GetPrim(), names.ATTR_INTRINSICS, TYPES.DoubleArray).Set(
        [fx, skew, cx, 0.0, fy, cy, 0.0, 0.0, 1.0]
    )
    return camera


def write_imaging(prim: Usd.Prim, samples: Sequence[Imaging]) -> None:
    """Writes what differs from the defaults, and the rule, which says that there is imaging."""
    usual = Imaging()
    for field, kind in formulas.TYPES.items():
        values = [getattr(imaging, field) for imaging in samples]
        if field == "rule" or any(value != getattr(usual, field) for value in values):
            made = custom(prim, formulas.attribute(field), getattr(TYPES, kind))
            author(made, [list(v) if isinstance(v, tuple) else v for v in values])


def write_lens(prim: Usd.Prim, lens: Lens) -> None:
    """Author a lens; viewers that know none show the pinhole that agrees with it at the axis."""
    custom(prim, names.ATTR_LENS_MODEL, TYPES.Token).Set(lens.model)
    if lens.coefficients:
        custom(prim, names.ATTR_LENS_COEFFICIENTS, TYPES.DoubleArray).Set(list(lens.coefficients))
    if lens.model == KANNALA_BRANDT:
        custom(prim, names.ATTR_LENS_MAX_ANGLE, TYPES.Double).Set(lens.max_angle)


def _write_product(
    stage: Usd.Stage, rig: Rig, sensor: Sensor, camera: UsdGeom.Camera, scene: Scene
) -> Sdf.Path:
    path = f"{names.RENDER_SCOPE}/Products/{rig.name}_{sensor.name}"
    product = UsdRender.Product.Define(stage, path)
    product.CreateResolutionAttr(Gf.Vec2i(*sensor.resolution))
    product.CreateCameraRel().SetTargets([camera.GetPath()])
    targets: list[Sdf.Path] = []
    for output in sensor.outputs:
        levels = list(scene.label_table) if output == "label" else [None]
        targets.extend(_write_var(stage, output, level) for level in levels)
    product.CreateOrderedVarsRel().SetTargets(targets)
    return product.GetPath()


def _write_var(stage: Usd.Stage, output: str, level: str | None) -> Sdf.Path:
    name = output if level is None else f"{output}_{level}"
    var = UsdRender.Var.Define(stage, f"{names.RENDER_SCOPE}/Vars/{name}")
    of = BUILT_IN.get(output)
    if of is not None:
        # What other packages' passes hold is not known before they are loaded, to render.
        count = len(of.channels)
        plain = "int" if of.dtype == "uint32" else "float" + (str(count) if count > 1 else "")
        var.CreateDataTypeAttr(_VAR_TYPES.get(output, plain))
    var.CreateSourceNameAttr(output if level is None else f"{output}.{level}")
    var.CreateSourceTypeAttr(UsdRender.Tokens.raw)
    return var.GetPath()


def write_trigger(prim: Usd.Prim, trigger: tuple[int, int]) -> None:
    """Writes when a sensor is triggered, where that is not at every sample."""
    if trigger != (1, 0):
        custom(prim, names.ATTR_TRIGGER, TYPES.Int2).Set(Gf.Vec2i(*trigger))


def write_depth_camera(prim: Usd.Prim, camera: DepthCamera) -> None:
    """Writes how a camera measures depth."""
    for name, kind, value in (
        (names.ATTR_DEPTH_MODEL, TYPES.Token, kind_of(camera.model)),
        (names.ATTR_DEPTH_NUMBERS, TYPES.DoubleArray, Vt.DoubleArray(as_numbers(camera.model))),
        (names.ATTR_DEPTH_KEY, TYPES.UInt64, camera.key),
    ):
        custom(prim, name, kind).Set(value)


def write_lidar(stage: Usd.Stage, path: str, lidar: Lidar) -> None:
    """Writes a lidar below its rig."""
    xform = UsdGeom.Xform.Define(stage, path)
    to_rig = np.eye(4)
    to_rig[:3, 3] = lidar.to_rig[:3, 3]
    # Signs and zeros: the sums are exact.
    to_rig[:3, :3] = [[sum(row * column) for column in _LIDAR.T] for row in lidar.to_rig[:3, :3]]
    xform.AddTransformOp().Set(matrix(to_rig))
    prim, noise = xform.GetPrim(), lidar.noise
    if lidar.rays is None:
        count, elevations = lidar.azimuths, Vt.DoubleArray(lidar.elevations_deg.tolist())
        custom(prim, names.ATTR_LIDAR_ELEVATIONS, TYPES.DoubleArray).Set(elevations)
        custom(prim, names.ATTR_LIDAR_AZIMUTH, TYPES.Double2).Set(Gf.Vec2d(*lidar.azimuth_deg))
    else:
        count, rays = lidar.rays.shape[1], Vt.Vec2dArray.FromNumpy(lidar.rays.reshape(-1, 2))
        custom(prim, names.ATTR_LIDAR_RAYS, TYPES.Double2Array).Set(rays)
    for name, kind, value, usual in (
        (names.ATTR_LIDAR_AZIMUTHS, TYPES.Int, count, None),
        (names.ATTR_LIDAR_RANGE, TYPES.Double2, Gf.Vec2d(*lidar.range_m), None),
        (names.ATTR_LIDAR_RANGE_NOISE, TYPES.Double, noise.range_m, 0.0),
        (names.ATTR_LIDAR_RATIO_NOISE, TYPES.Double, noise.range_ratio, 0.0),
        (names.ATTR_LIDAR_ANGLE_NOISE, TYPES.Double, noise.angle_deg, 0.0),
        (names.ATTR_LIDAR_DROPOUT, TYPES.Double, noise.dropout, 0.0),
        (names.ATTR_LIDAR_KEY, TYPES.UInt64, lidar.noise_key, None),
    ):
        if value != usual:
            custom(prim, name, kind).Set(value)
    for name, model in (
        (names.ATTR_LIDAR_INTENSITY, lidar.intensity),
        (names.ATTR_LIDAR_FOOTPRINT, lidar.footprint),
        (names.ATTR_LIDAR_DETECTION, lidar.detection),
    ):
        if model is not None:
            custom(prim, name, TYPES.Double4).Set(Gf.Vec4d(*of_lidar(model)))
    write_trigger(prim, lidar.trigger)


def write_imu(stage: Usd.Stage, path: str, imu: Imu) -> None:
    """Writes an IMU below its rig, with what it reads and the true state then."""
    xform = UsdGeom.Xform.Define(stage, path)
    xform.AddTransformOp().Set(matrix(imu.to_rig))
    prim = xform.GetPrim()
    numbers = list(vars(imu.noise).values())
    noisy = any(numbers)
    custom(prim, names.ATTR_IMU_RATE, TYPES.Double).Set(imu.rate_hz)
    custom(prim, names.ATTR_IMU_GRAVITY, TYPES.Double).Set(imu.gravity_m_s2)
    if noisy:
        custom(prim, names.ATTR_IMU_NOISE, TYPES.DoubleArray).Set(Vt.DoubleArray(numbers))
    times = Vt.DoubleArray.FromNumpy(imu.time_s)
    custom(prim, names.ATTR_IMU_TIMES, TYPES.DoubleArray).Set(times)
    turns = Vt.Vec4dArray.FromNumpy(np.ascontiguousarray(imu.orientation))
    custom(prim, names.ATTR_IMU_ORIENTATIONS, TYPES.Double4Array).Set(turns)
    for name, vectors, always in (
        (names.ATTR_IMU_GYROSCOPE, imu.gyroscope, True),
        (names.ATTR_IMU_ACCELEROMETER, imu.accelerometer, True),
        (names.ATTR_IMU_POSITIONS, imu.position_m, True),
        (names.ATTR_IMU_VELOCITIES, imu.velocity_m_s, True),
        (names.ATTR_IMU_ANGULAR_VELOCITY, imu.angular_velocity, noisy),
        (names.ATTR_IMU_SPECIFIC_FORCE, imu.specific_force, noisy),
        (names.ATTR_IMU_GYROSCOPE_BIAS, imu.gyroscope_bias, noisy),
        (names.ATTR_IMU_ACCELEROMETER_BIAS, imu.accelerometer_bias, noisy),
    ):
        if always:
            values = Vt.Vec3dArray.FromNumpy(np.ascontiguousarray(vectors))
            custom(prim, name, TYPES.Double3Array).Set(values)


def write_shutter(camera: UsdGeom.Camera, rig: Rig, shutter: OpenShutter) -> None:
    """Authors a shutter: what readers of ours go by, and what viewers know.

    Readers take exact numbers from attributes of our own: poses at seconds from the sample's time,
    relative to the camera's own pose then, so that they compose with whatever the camera is below.
    Nothing else could carry them: time codes count samples, not seconds, and USD interpolates
    matrices component by component. For viewers, the same poses stand at fractional time codes of
    the rig (real time, linear between samples, so exposures that overlap agree), and
    UsdGeomCamera's shutter:open and shutter:close say which of them a picture takes.
    """
    prim = camera.GetPrim()
    exposures = [one.exposure_s for one in shutter.shutters]
    author(custom(prim, names.ATTR_SHUTTER_EXPOSURE, TYPES.Double), exposures)
    one = shutter.shutters[0]
    custom(prim, names.ATTR_SHUTTER_READOUT, TYPES.Double).Set(one.readout_s)
    direction = "up" if one.upward else "down"
    custom(prim, names.ATTR_SHUTTER_DIRECTION, TYPES.Token).Set(direction)
    times = Vt.DoubleArray(shutter.times.tolist())
    custom(prim, names.ATTR_SHUTTER_TIMES, TYPES.DoubleArray).Set(times)
    poses = custom(prim, names.ATTR_SHUTTER_POSES, TYPES.Matrix4dArray)
    author(poses, [_relative(of_sample, shutter.times) for of_sample in shutter.to_world])
    at = clock(rig)
    half = np.array([one.half_span for one in shutter.shutters])
    sample = np.arange(len(exposures))
    author(camera.CreateShutterOpenAttr(), (codes_at(at, at - half) - sample).tolist())
    author(camera.CreateShutterCloseAttr(), (codes_at(at, at + half) - sample).tolist())


def write_between(op: UsdGeom.XformOp, rig: Rig) -> None:
    """Author a rig's poses between its samples, for viewers; nothing where it has none."""
    if rig.between is None:
        return
    if not op.GetAttr().GetNumTimeSamples():
        # It stands alike at all samples.
        for sample, pose in enumerate(rig.to_world):
            op.Set(matrix(pose), float(sample))
    for code, pose in zip(rig.between.codes.tolist(), rig.between.to_world, strict=True):
        op.Set(matrix(pose), code)


def _relative(poses: NDArray[np.float64], times: NDArray[np.float64]) -> list[Gf.Matrix4d]:
    """Poses [k, 4, 4] as seen from the one at the sample, in USD's axes."""
    middle = int(np.flatnonzero(times == 0.0)[0])
    axes, eye = poses[middle, :3, :3], poses[middle, :3, 3]
    out = np.zeros(poses.shape)
    out[:, 3, 3] = 1.0
    # The axes are orthonormal: the inverse is the transpose. Sums written out, no BLAS.
    for k in range(3):
        out[:, :3, :3] += axes[k, :, None] * poses[:, k, None, :3]
        out[:, :3, 3] += axes[k] * (poses[:, k, 3] - eye[k])[:, None]
    out[middle] = np.eye(4)
    out *= HALF_TURN[:, None] * HALF_TURN[None, :]
    return [matrix(pose + 0.0) for pose in out]
