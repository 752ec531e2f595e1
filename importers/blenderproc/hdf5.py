"""HDF5: one picture a file, with texts of JSON for cameras and objects."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.geometry.poses import from_euler
from scenec.importers.blenderproc.scene import ModelKind, Object, Scene
from scenec.importers.output import Imported
from scenec.importers.poses import FLIP, lost_of
from scenec.importers.report import ADDED, APPROXIMATED, DROPPED, TRANSLATED, Report
from scenec.schemas.errors import ScenecError
from scenec.schemas.spelling import shown
from scenec.schemas.versions import optional

#: Data sets that are texts of JSON, and how long one may be, bytes.
_TEXTS = ("campose", "object_states")
_LONGEST = 1 << 26
#: Pixels of a side, letters of a name, and meters, that are taken.
_LARGEST, _LONGEST_NAME, _FARTHEST_M = 65535, 60, 1e6
#: What has a meaning here, and what BlenderProc's own writers and users call the category.
_OF_CAMERA = ("cam2world_matrix", "location", "rotation_euler", "cam_K", "fov_x", "fov_y")
_CATEGORIES = ("customprop_category_id", "category_id")
_OF_OBJECT = ("name", "matrix_world", "location", "rotation_euler", "scale", *_CATEGORIES)


def read_hdf5(files: Sequence[Path], imported: Imported) -> Scene:
    """Reads files of one picture each, in order.

    Raises:
        ScenecError: One cannot be read, or does not say where its camera is; h5py is missing.
    """
    h5py = optional("h5py", "reading .hdf5 needs the extra 'hdf5': pip install 'scenec[hdf5]'")
    scene, report = Scene(), imported.report
    for number, file in enumerate(files):
        try:
            with h5py.File(file, "r") as stored:
                names = sorted(stored)
                values = {name: _text(stored[name]) for name in _TEXTS if name in stored}
                shape = _shape(stored["colors"]) if "colors" in stored else None
        # A damaged file raises whatever the library stumbles over.
        except (OSError, KeyError, RuntimeError, ValueError, TypeError, AttributeError) as error:
            raise ScenecError(f"{file}: cannot be read: {' '.join(str(error).split())}") from error
        if "campose" not in values:
            raise ScenecError(
                f"{file}: no data set 'campose', which says where the camera is (write it with "
                f"BlenderProc's camera state writer); there are {', '.join(names) or 'none'}"
            )
        _add_frame(scene, file, number, values, shape, imported)
        for name in names if number == 0 else ():
            if name not in (*_TEXTS, "colors"):
                at, note = f"{file.name}/{name}", "a picture or what belongs to one: made anew"
                report.add(DROPPED, at, None, "", note)
    return scene


def _text(stored: Any) -> str:
    """Reads a data set that is a text.

    Raises:
        ValueError: It is none, or too large for one.
    """
    if not hasattr(stored, "nbytes") or stored.ndim > 1 or stored.nbytes > _LONGEST:
        raise ValueError(f"{stored.name}: expected a text of JSON of at most {_LONGEST} bytes")
    value = stored[()]
    if isinstance(value, np.ndarray) and value.dtype == object and value.size == 1:
        value = value.ravel()[0]
    if isinstance(value, str):
        return value
    if isinstance(value, bytes) or (isinstance(value, np.ndarray) and value.dtype.kind in "SuV"):
        return bytes(value).decode("utf-8", "replace")
    raise ValueError(f"{stored.name}: expected a text of JSON")


def _shape(stored: Any) -> tuple[int, ...]:
    """Returns the shape of a picture [height, width, channels], or of a stereo pair.

    Raises:
        ValueError: It has another.
    """
    shape = tuple(getattr(stored, "shape", ()))
    if len(shape) not in (3, 4) or not all(1 <= side <= _LARGEST for side in shape):
        raise ValueError(
            f"{stored.name}: a shape of {list(shape)}, expected [height, width, channels], each "
            f"from 1 to {_LARGEST}"
        )
    return shape


def _add_frame(
    scene: Scene,
    file: Path,
    number: int,
    values: dict[str, str],
    shape: tuple[int, ...] | None,
    imported: Imported,
) -> None:
    report = imported.report
    cameras = _states(file, "campose", values["campose"])
    camera, at = cameras[0], f"{file.name}/campose"
    pose = _matrix(file, "campose", camera, "cam2world_matrix")
    if note := lost_of(pose[:3, :3]):
        raise ScenecError(f"{file}/campose/cam2world_matrix: expected a pose, but {note}")
    pose[:3, :3] = pose[:3, :3] @ FLIP
    scene.poses.append(pose)
    report.add(TRANSLATED, at, None, "rigs/camera/pose")
    if len(cameras) > 1:
        note = f"{len(cameras)} cameras in a picture: the first"
        report.add(APPROXIMATED, at, None, "rigs/camera", note)
    _leave(report, at, camera, _OF_CAMERA)
    _set_picture(scene, number, _camera_matrix(file, camera), shape, at, imported)
    if "object_states" not in values:
        note = "no objects: write them with BlenderProc's object state writer"
        report.add(DROPPED, f"{file.name}/object_states", None, "", note)
        return
    used: set[str] = set()
    for state in _states(file, "object_states", values["object_states"]):
        name = str(state.get("name") or "object")[:_LONGEST_NAME]
        if name in used:
            raise ScenecError(f"{file}/object_states: two objects are called {shown(name)}")
        used.add(name)
        at = f"{file.name}/object_states/{name}"
        found = next((o for o in scene.objects if o.kind == name), None)
        if found is None:
            scene.objects.append(found := Object(name))
            plain = name.partition(".")[0]
            # Matrices are of files as Blender took them in: z up.
            scene.kinds[name] = ModelKind((name, plain), 1.0)
        found.poses[number] = _matrix(file, f"object_states/{name}", state, "matrix_world")
        _set_category(found, state, at, report)
        _leave(report, at, state, _OF_OBJECT)
    report.add(TRANSLATED, f"{file.name}/object_states", None, "objects")


def _camera_matrix(file: Path, camera: dict[str, Any]) -> list[float]:
    """Returns a camera's matrix as nine numbers by row, a negated field of view, or nothing."""
    if "cam_K" in camera:
        k = _numbers(file, "campose", camera, "cam_K", (3, 3))
        if not (np.isfinite(k).all() and 0.0 < k[0, 0] < 1e9 and 0.0 < k[1, 1] < 1e9):
            raise ScenecError(
                f"{file}/campose/cam_K: {shown(camera['cam_K'])}: expected focal lengths above 0"
            )
        if np.abs(k[[1, 2, 2], [0, 0, 1]]).max() > 0.0 or k[2, 2] != 1.0:
            raise ScenecError(
                f"{file}/campose/cam_K: {shown(camera['cam_K'])}: expected a last row of 0, 0, 1, "
                "and 0 below the diagonal"
            )
        return k.ravel().tolist()
    if "fov_x" in camera:
        fov = float(_numbers(file, "campose", camera, "fov_x", ()))
        if not 0.0 < fov < np.pi:
            raise ScenecError(
                f"{file}/campose/fov_x: {shown(camera['fov_x'])}: expected radians between 0 and pi"
            )
        return [-fov]
    return []


def _set_picture(
    scene: Scene,
    number: int,
    matrix: list[float],
    shape: tuple[int, ...] | None,
    at: str,
    imported: Imported,
) -> None:
    """Keeps the size and the matrix of the first picture, and says where others differ."""
    report, to = imported.report, "rigs/camera/sensors/rgb"
    size = scene.size if shape is None else (shape[-2], shape[-3])
    if number == 0:
        scene.matrix, scene.size = matrix, size
        report.add(TRANSLATED if shape else ADDED, "colors", list(size), f"{to}/resolution")
        report.add(TRANSLATED if matrix else ADDED, f"{at}/cam_K", None, f"{to}/intrinsics")
    elif (size, matrix) != (scene.size, scene.matrix):
        what = [f"{size[0]} x {size[1]} pixels"] if size != scene.size else []
        what += ["another camera matrix"] if matrix != scene.matrix else []
        note = f"{' and '.join(what)}: a sensor has one, here those of the first picture"
        report.add(APPROXIMATED, at, None, to, note)
    if shape is not None and len(shape) == 4 and number == 0:
        report.add(APPROXIMATED, "colors", shape[0], to, "a stereo pair: one camera")


def _set_category(thing: Object, state: dict[str, Any], at: str, report: Report) -> None:
    """Takes the category of an object, as BlenderProc's own property or as one of a user's."""
    key = next((key for key in _CATEGORIES if key in state), None)
    if key is None:
        return
    value = state[key]
    whole = isinstance(value, int | float) and not isinstance(value, bool) and value == value // 1
    if not (whole and 0 < value < 1 << 32):
        report.add(DROPPED, f"{at}/{key}", value, "", "no id of a label: a whole number from 1")
    elif thing.category not in (0, int(value)):
        note = f"another one than in an earlier picture ({thing.category}), which stays"
        report.add(DROPPED, f"{at}/{key}", value, "", note)
    else:
        thing.category = int(value)
        report.add(TRANSLATED, f"{at}/{key}", value, "labels/category")


def _leave(report: Report, at: str, values: dict[str, Any], handled: Sequence[str]) -> None:
    """Says what of a state has no place in a cfg."""
    for key in values:
        if key not in handled:
            report.add(DROPPED, f"{at}/{key}", values[key], "", "nothing here has it")


def _states(file: Path, name: str, text: str) -> list[dict[str, Any]]:
    """A text of JSON: a list of objects, or one."""
    try:
        found = json.loads(text.strip("\0"))
    except (ValueError, RecursionError) as error:
        raise ScenecError(f"{file}/{name}: is no JSON: {error}") from error
    states = found if isinstance(found, list) else [found]
    if not states or not all(isinstance(state, dict) for state in states):
        raise ScenecError(f"{file}/{name}: {shown(found)}: expected a list of objects")
    return states


def _numbers(
    file: Path, name: str, state: dict[str, Any], key: str, shape: tuple[int, ...]
) -> NDArray[np.float64]:
    """Numbers of a state."""
    try:
        return np.array(state[key], float).reshape(shape)
    except (ValueError, TypeError) as error:
        what = f"a matrix of {shape[0]} by {shape[1]}" if len(shape) == 2 else "a number"
        what = f"{shape[0]} numbers" if len(shape) == 1 else what
        raise ScenecError(f"{file}/{name}/{key}: {shown(state[key])}: expected {what}") from error


def _matrix(file: Path, name: str, state: dict[str, Any], key: str) -> NDArray[np.float64]:
    """Reads a state's matrix, stored whole or as place, Euler angles (x first) and scale."""
    if key in state:
        matrix = _numbers(file, name, state, key, (4, 4))
    elif "location" in state and "rotation_euler" in state:
        place = _numbers(file, name, state, "location", (3,))
        angles = np.degrees(_numbers(file, name, state, "rotation_euler", (3,)))
        matrix = from_euler(tuple(place), tuple(angles))
        if "scale" in state:
            matrix[:3, :3] *= _numbers(file, name, state, "scale", (3,))
    else:
        known = ", ".join(sorted(state)) or "nothing"
        raise ScenecError(
            f"{file}/{name}: expected {key}, or location and rotation_euler; found {known}"
        )
    fault = ""
    if not np.isfinite(matrix).all():
        fault = "a matrix that is not finite"
    elif np.abs(matrix[3] - (0.0, 0.0, 0.0, 1.0)).max() > 1e-9:
        fault = f"a last row of {matrix[3].tolist()}, expected 0, 0, 0, 1"
    elif np.abs(matrix[:3]).max() > _FARTHEST_M:
        fault = f"numbers of up to {np.abs(matrix[:3]).max():g}, expected {_FARTHEST_M:g} at most"
    elif abs(np.linalg.det(matrix[:3, :3])) < 1e-12:
        fault = "a matrix that is flat"
    if fault:
        raise ScenecError(f"{file}/{name}: {fault}")
    return matrix
