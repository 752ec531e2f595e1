"""HDF5: one picture a file, with texts of JSON for cameras and objects."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.geometry.poses import from_euler
from scenec.importers.blenderproc.scene import Kind, Object, Scene
from scenec.importers.output import Imported
from scenec.importers.poses import FLIP
from scenec.importers.report import DROPPED, TRANSLATED
from scenec.schemas.errors import ScenecError
from scenec.schemas.spelling import shown
from scenec.schemas.versions import optional


def read_hdf5(files: Sequence[Path], imported: Imported) -> Scene:
    """Reads files of one picture each, in order.

    Raises:
        ScenecError: One cannot be read, or does not say where its camera is; h5py is missing.
    """
    h5py = optional("h5py", "reading .hdf5 needs the extra 'hdf5': pip install 'scenec[hdf5]'")
    scene = Scene()
    for number, file in enumerate(files):
        try:
            with h5py.File(file, "r") as stored:
                wanted = [name for name in ("campose", "object_states") if name in stored]
                values = {name: stored[name][()] for name in wanted}
                colors = stored["colors"].shape if "colors" in stored else None
                names = sorted(stored)
        except OSError as error:
            raise ScenecError(f"{file}: cannot be read: {error}") from error
        if "campose" not in values:
            raise ScenecError(
                f"{file}: no data set 'campose', which says where the camera is (write it with "
                f"BlenderProc's camera state writer); there are {', '.join(names) or 'none'}"
            )
        _hdf5_frame(scene, file, number, values, imported)
        if colors is not None:
            scene.size = (int(colors[1]), int(colors[0]))
        for name in names if number == 0 else ():
            if name not in ("campose", "object_states", "colors"):
                at, note = f"{file.name}/{name}", "a picture or what belongs to one: made anew"
                imported.report.add(DROPPED, at, None, "", note)
    imported.report.add(
        TRANSLATED, "colors", list(scene.size), "rigs/camera/sensors/rgb/resolution"
    )
    return scene


def _hdf5_frame(
    scene: Scene, file: Path, number: int, values: dict[str, Any], imported: Imported
) -> None:
    camera = _states(file, "campose", values["campose"])[0]
    pose = _matrix(file, "campose", camera, "cam2world_matrix")
    pose[:3, :3] = pose[:3, :3] @ FLIP
    scene.poses.append(pose)
    if "cam_K" in camera and not scene.matrix:
        scene.matrix = _numbers(file, "campose", camera, "cam_K", (3, 3)).ravel().tolist()
    elif "fov_x" in camera and not scene.matrix:
        scene.matrix = [-float(_numbers(file, "campose", camera, "fov_x", ()))]
    imported.report.add(TRANSLATED, f"{file.name}/campose", None, "rigs/camera")
    if "object_states" not in values:
        note = "no objects: write them with BlenderProc's object state writer"
        imported.report.add(DROPPED, f"{file.name}/object_states", None, "", note)
        return
    for state in _states(file, "object_states", values["object_states"]):
        name = str(state.get("name", "object"))
        found = next((o for o in scene.objects if o.kind == name), None)
        if found is None:
            scene.objects.append(found := Object(name))
            plain = name.partition(".")[0]
            # Matrices are of files as Blender took them in: z up.
            scene.kinds[name] = Kind((name, plain), 1.0)
        found.poses[number] = _matrix(file, f"object_states/{name}", state, "matrix_world")
    imported.report.add(TRANSLATED, f"{file.name}/object_states", None, "objects")


def _states(file: Path, name: str, value: Any) -> list[dict[str, Any]]:
    """A text of JSON: a list of objects, or one."""
    text = value.decode() if isinstance(value, bytes) else bytes(value).decode("utf-8", "replace")
    try:
        found = json.loads(text.strip("\0"))
    except ValueError as error:
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
    """A matrix of a state, by itself or by place and Euler angles (x first, radians)."""
    if key in state:
        matrix = _numbers(file, name, state, key, (4, 4))
    elif "location" in state and "rotation_euler" in state:
        place = _numbers(file, name, state, "location", (3,))
        angles = np.degrees(_numbers(file, name, state, "rotation_euler", (3,)))
        matrix = from_euler(tuple(place), tuple(angles))
    else:
        known = ", ".join(sorted(state)) or "nothing"
        raise ScenecError(
            f"{file}/{name}: expected {key}, or location and rotation_euler; found {known}"
        )
    if not np.isfinite(matrix).all() or abs(np.linalg.det(matrix[:3, :3])) < 1e-12:
        raise ScenecError(f"{file}/{name}: a matrix that is not finite, or flat")
    return matrix
