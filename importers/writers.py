"""Writes files that a cfg needs and nobody has: tracks, tables of poses, meshes."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from pxr import Usd, UsdGeom, Vt

from scenec.importers.poses import without_scale
from scenec.schemas.quaternions import quaternion

_POSE = ("x_m", "y_m", "z_m", "qw", "qx", "qy", "qz")

Writer = Callable[[Path], object]


def track_writer(times_s: Sequence[float], poses: Sequence[NDArray[np.float64]]) -> Writer:
    """Returns a writer of a track.

    Args:
        times_s: Rising.
        poses: From the rig's frame (x right, y down, z ahead) to the world, [4, 4] each.
    """
    rows = [
        (time, *pose[:3, 3], *np.roll(quaternion(pose[:3, :3]), 1))
        for time, pose in zip(times_s, poses, strict=True)
    ]
    return _csv_writer(("time_s", *_POSE), rows)


def table_writer(poses: Sequence[NDArray[np.float64]], **columns: Sequence[float] | None) -> Writer:
    """Returns a writer of a table of poses for a class of type ``placed``.

    Args:
        poses: From a model to the world, [4, 4] each; an uneven scale becomes an even one.
        columns: Others by name: ``model``, ``id``, ``time_s``; None is left out.
    """
    given = {name: values for name, values in columns.items() if values is not None}
    rows = []
    for pose, *others in zip(poses, *given.values(), strict=True):
        rotation, scale = without_scale(pose[:3, :3])
        rows.append((*pose[:3, 3], *np.roll(quaternion(rotation), 1), scale, *others))
    return _csv_writer((*_POSE, "scale", *given), rows)


def _csv_writer(header: Sequence[str], rows: Iterable[Sequence[float]]) -> Writer:
    cells = [header, *([f"{float(number):.12g}" for number in row] for row in rows)]
    text = "".join(f"{','.join(row)}\n" for row in cells)
    return lambda path: path.write_text(text, encoding="ascii")


def mesh_writer(points: NDArray[np.float64], faces: NDArray[np.int64]) -> Writer:
    """Returns a writer of triangles as USD, in meters, z up.

    Args:
        points: [n, 3], m.
        faces: [m, 3].
    """

    def write(path: Path) -> None:
        stage = Usd.Stage.CreateNew(str(path))
        UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.z)
        UsdGeom.SetStageMetersPerUnit(stage, 1.0)
        mesh = UsdGeom.Mesh.Define(stage, "/mesh")
        stage.SetDefaultPrim(mesh.GetPrim())
        mesh.CreatePointsAttr(Vt.Vec3fArray.FromNumpy(points.astype(np.float32)))
        mesh.CreateFaceVertexCountsAttr(Vt.IntArray.FromNumpy(np.full(len(faces), 3, np.int32)))
        mesh.CreateFaceVertexIndicesAttr(Vt.IntArray.FromNumpy(faces.astype(np.int32).ravel()))
        mesh.CreateSubdivisionSchemeAttr(UsdGeom.Tokens.none)
        stage.GetRootLayer().Save()

    return write
