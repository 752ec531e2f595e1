"""Writes a camera's shutter: what readers of ours go by, and what viewers know.

Readers take exact numbers from attributes of our own: poses at seconds from the sample's time,
relative to the camera's own pose then, so that they compose with whatever the camera is below.
Nothing else could carry them: time codes count samples, not seconds, and USD interpolates matrices
component by component. For viewers, the same poses stand at fractional time codes of the rig (real
time, linear between samples, so exposures that overlap agree), and UsdGeomCamera's shutter:open and
shutter:close say which of them a picture takes.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from pxr import Gf, UsdGeom, Vt

from scenec.compiler.cameras.shutters import clock, codes_at
from scenec.compiler.emit.layer import TYPES, author, custom, matrix
from scenec.compiler.scene.rig import OpenShutter, Rig
from scenec.schemas import stage as names

_HALF_TURN = np.array([*names.HALF_TURN, 1.0])


def write_shutter(camera: UsdGeom.Camera, rig: Rig, shutter: OpenShutter) -> None:
    """Author a shutter."""
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
    out *= _HALF_TURN[:, None] * _HALF_TURN[None, :]
    return [matrix(pose + 0.0) for pose in out]
