"""Scenes of BlenderProc become cfgs: BOP datasets, and its HDF5 files with states.

A BOP scene has ``scene_camera.json`` and ``scene_gt.json``: for each picture the camera (``cam_K``,
``cam_R_w2c``, ``cam_t_w2c``; millimeters, x right, y down, z ahead), and for each object the pose
of its model in the camera (``cam_R_m2c``, ``cam_t_m2c``, ``obj_id``). The models are
``models/obj_000001.ply``, in millimeters. An HDF5 file is one picture; ``campose`` and
``object_states`` are texts of JSON in it, with matrices in meters, of cameras that look along
their -z with y up.

One picture becomes one sample: cameras and objects stand where they stood. Light and whatever else
was around is in neither format: ground, light and the rest of the cfg are added.
"""

from __future__ import annotations

import json
import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from scenec.compiler.assets.model import cached_model
from scenec.importers.numbers import tidy
from scenec.importers.output import Imported
from scenec.importers.poses import FLIP, track_writer
from scenec.importers.report import ADDED, APPROXIMATED, DROPPED, TRANSLATED
from scenec.importers.scene import (
    LEVEL,
    Taxonomy,
    identifier,
    soil,
    table_writer,
    unused,
    varied_sun,
)
from scenec.importers.source import Item, Source, check
from scenec.importers.usd_mesh import write_mesh
from scenec.schemas.errors import CfgError, Fault, ScenecError
from scenec.schemas.spelling import shown

_MM = 1e-3
#: What an object may move between pictures and count as at rest, m, and its turn, as a sine.
_REST_M, _REST_TURN = 5e-4, 1e-3
#: Side of the box that stands for a model of unknown size, m.
_UNKNOWN_M = 0.1
_SUFFIXES = (".ply", ".obj", ".glb", ".gltf", ".usd", ".usda", ".usdc", ".usdz", ".stl", ".off")
#: A camera's axes (x right, y down, z ahead) in a world where it looks level, z up.
_LEVEL = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])


@dataclass
class _Object:
    """One object.

    Attributes:
        kind: What model it is of.
        poses: From the model to the world, [4, 4], by the number of the picture.
    """

    kind: str
    poses: dict[int, NDArray[np.float64]] = field(default_factory=dict)


@dataclass
class _Kind:
    """A model.

    Attributes:
        names: Names of files that it may have, without endings.
        unit_m: Meters per unit of its file.
        up: Upward axis of its file, which stays as it is.
        low, high: Corners of its box in meters, where that is known.
    """

    names: tuple[str, ...]
    unit_m: float
    up: str = "z"
    low: NDArray[np.float64] | None = None
    high: NDArray[np.float64] | None = None


@dataclass
class _Scene:
    """What a scene says.

    Attributes:
        poses: Of the camera in each picture: from x right, y down, z ahead to the world.
        matrix: The camera's, by row; of today's pixels, whose first one's middle is (0, 0).
        size: Width and height of pictures.
        objects: All of them.
        kinds: Models by name.
    """

    poses: list[NDArray[np.float64]] = field(default_factory=list)
    matrix: list[float] = field(default_factory=list)
    size: tuple[int, int] = (640, 480)
    objects: list[_Object] = field(default_factory=list)
    kinds: dict[str, _Kind] = field(default_factory=dict)


def import_blenderproc(
    source: Path, out: Path, *, folders: Sequence[Path] = (), stand_ins: bool = False
) -> Imported:
    """Makes a cfg of a scene.

    Args:
        source: A folder of a BOP scene (with ``scene_camera.json``), or of HDF5 files, or one file.
        out: The cfg that it becomes.
        folders: Where models are looked for first.
        stand_ins: Whether boxes take the place of models that are missing.

    Raises:
        ScenecError: It is none of these, or something in it is wrong.
    """
    imported = Imported(out)
    files = _hdf5_files(source)
    if files:
        scene = _read_hdf5(files, imported)
    elif (source / "scene_camera.json").is_file():
        scene = _read_bop(source, imported)
    else:
        there = sorted(p.parent.name for p in source.glob("**/scene_camera.json"))[:4]
        hint = f"; scenes below it: {', '.join(there)}" if there else ""
        raise ScenecError(
            f"{source}: expected a folder with scene_camera.json and scene_gt.json (BOP), or "
            f"HDF5 files of BlenderProc{hint}"
        )
    places = [*folders, *_model_folders(source)]
    _build(scene, imported, source, places, stand_ins)
    return imported


def _hdf5_files(source: Path) -> list[Path]:
    if source.suffix.lower() in (".hdf5", ".h5"):
        return [source]
    found = [p for p in source.glob("*.hdf5") if p.is_file()] if source.is_dir() else []
    return sorted(found, key=lambda p: [int(n) for n in re.findall(r"\d+", p.stem)] or [0])


def _model_folders(source: Path) -> list[Path]:
    parents = [source, *list(source.resolve().parents)[:3]]
    names = ("models", "models_eval", "models_cad", ".")
    return [parent / name for parent in parents for name in names if (parent / name).is_dir()]


# BOP.


def _read_bop(folder: Path, imported: Imported) -> _Scene:
    cameras, truth = Source(folder / "scene_camera.json"), Source(folder / "scene_gt.json")
    scene = _Scene()
    frames = sorted(cameras.root().entries(), key=lambda entry: int(entry[0]))
    objects = dict(truth.root().entries())
    from_world = [_from_world(item) for _, item in frames]
    seen = [_entries(objects.get(name)) for name, _ in frames]
    if not frames:
        cameras.root().fault("no picture: expected an object with one for each")
    check([cameras, truth])
    known = [matrix for matrix in from_world if matrix is not None]
    if len(known) == len(frames):
        scene.poses = [np.linalg.inv(matrix) for matrix in known]
    else:
        scene.poses = _by_objects(seen, frames, imported)
    for number, entries in enumerate(seen):
        count: dict[str, int] = {}
        for kind, in_camera in entries:
            nth = count[kind] = count.get(kind, 0) + 1
            same = [o for o in scene.objects if o.kind == kind]
            if len(same) < nth:
                scene.objects.append(_Object(kind))
                same.append(scene.objects[-1])
            same[nth - 1].poses[number] = scene.poses[number] @ in_camera
    matrices = [item.need("cam_K").numbers(9) for _, item in frames]
    for (_, item), matrix in zip(frames, matrices, strict=True):
        k = item.need("cam_K")
        if matrix == matrices[0]:
            k.translated("rigs/camera/sensors/rgb/intrinsics")
        else:
            k.approximated("rigs/camera/sensors/rgb/intrinsics", "those of the first picture")
        for key in ("depth_scale", "view_level", "elev", "mode"):
            other = item.get(key)
            if other:
                other.dropped("says how pictures are stored, not what is in them")
    check([cameras, truth])
    scene.matrix = matrices[0]
    scene.size = _size(folder, matrices[0], imported)
    _bop_models(folder, scene, imported)
    for source in (cameras, truth):
        source.leave({})
        source.report_to(imported.report)
    return scene


def _from_world(item: Item) -> NDArray[np.float64] | None:
    turn, place = item.get("cam_R_w2c"), item.get("cam_t_w2c")
    if turn is None or place is None:
        return None
    matrix = _rigid(turn, place)
    for part in (turn, place):
        part.translated("rigs/camera/pose")
    return matrix


def _rigid(turn: Item, place: Item) -> NDArray[np.float64]:
    """A rotation by row and a place in millimeters, as a matrix in meters."""
    matrix = np.eye(4)
    rotation = np.array(turn.numbers(9)).reshape(3, 3)
    if np.abs(rotation @ rotation.T - np.eye(3)).max() > 1e-3 or np.linalg.det(rotation) < 0:
        turn.fault(f"{shown(turn.value)}: expected a rotation matrix, by row")
        return matrix
    matrix[:3, :3] = rotation
    matrix[:3, 3] = np.array(place.numbers(3)) * _MM
    return matrix


def _entries(item: Item | None) -> list[tuple[str, NDArray[np.float64]]]:
    """Objects of one picture: name of the model, and its pose in the camera."""
    found = []
    for entry in item.children() if item else ():
        number = entry.need("obj_id").whole(0)
        turn, place = entry.need("cam_R_m2c"), entry.need("cam_t_m2c")
        found.append((f"obj_{number:06d}", _rigid(turn, place)))
        for part in (entry.need("obj_id"), turn, place):
            part.translated(f"objects/obj_{number:06d}")
    return found


def _by_objects(
    seen: Sequence[Sequence[tuple[str, NDArray[np.float64]]]],
    frames: Sequence[tuple[str, Item]],
    imported: Imported,
) -> list[NDArray[np.float64]]:
    """Poses of cameras that do not say theirs: by an object that the first one sees, too."""
    first = np.eye(4)
    first[:3, :3] = _LEVEL
    poses = [first]
    for entries, (name, item) in zip(seen[1:], frames[1:], strict=True):
        pair = next(((a, b) for kind, a in seen[0] for other, b in entries if kind == other), None)
        if pair is None:
            item.fault(
                f"picture {name} has no cam_R_w2c, and none of the objects of the first one: "
                "where its camera is cannot be known"
            )
            poses.append(first)
        else:
            poses.append(first @ pair[0] @ np.linalg.inv(pair[1]))
    check([item.source for _, item in frames[:1]])
    imported.report.add(
        APPROXIMATED, "scene_camera.json", None, "rigs/camera/pose",
        "no cam_R_w2c: the first camera looks level, others are placed by objects at rest",
    )  # fmt: skip
    return poses


def _size(folder: Path, matrix: Sequence[float], imported: Imported) -> tuple[int, int]:
    to = "rigs/camera/sensors/rgb/resolution"
    for parent in (folder, *list(folder.resolve().parents)[:2]):
        if (parent / "camera.json").is_file():
            camera = Source(parent / "camera.json")
            size = tuple(camera.root().need(key).whole(1, 65535) for key in ("width", "height"))
            check([camera])
            imported.report.add(TRANSLATED, "camera.json", list(size), to)
            return size[0], size[1]
    for picture in sorted((*folder.glob("rgb/*"), *folder.glob("gray/*")))[:1]:
        with Image.open(picture) as opened:
            imported.report.add(TRANSLATED, f"rgb/{picture.name}", list(opened.size), to)
            return opened.size
    size = (max(round(2 * matrix[2] + 1), 1), max(round(2 * matrix[5] + 1), 1))
    note = "neither camera.json nor a picture is there: about the principal point"
    imported.report.add(APPROXIMATED, "cam_K", list(size), to, note)
    return size


def _bop_models(folder: Path, scene: _Scene, imported: Imported) -> None:
    """Kinds of models, with their boxes where ``models_info.json`` has them."""
    named = [place / "models_info.json" for place in _model_folders(folder)]
    info = next((file for file in named if file.is_file()), None)
    source = Source(info) if info else None
    for name in dict.fromkeys(thing.kind for thing in scene.objects):
        number = int(name.removeprefix("obj_"))
        kind = _Kind((name, f"obj_{number:02d}", f"obj_{number}"), _MM)
        entry = source.root().get(str(number)) if source else None
        if entry is not None:
            low = np.array([entry.need(f"min_{axis}").number() for axis in "xyz"])
            size = np.array([entry.need(f"size_{axis}").number(0.0) for axis in "xyz"])
            kind.low, kind.high = low * _MM, (low + size) * _MM
        scene.kinds[name] = kind
    if source:
        check([source])
        imported.report.add(TRANSLATED, "models_info.json", None, "terrain/relief/0/height_m")


# HDF5.


def _read_hdf5(files: Sequence[Path], imported: Imported) -> _Scene:
    try:
        import h5py
    except ImportError as error:
        raise ScenecError(
            "reading .hdf5 needs the extra 'hdf5': pip install 'scenec[hdf5]'"
        ) from error
    scene = _Scene()
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
    scene: _Scene, file: Path, number: int, values: dict[str, Any], imported: Imported
) -> None:
    camera = _states(file, "campose", values["campose"])[0]
    pose = _matrix(file, "campose", camera, "cam2world_matrix")
    pose[:3, :3] = pose[:3, :3] @ FLIP
    scene.poses.append(pose)
    if "cam_K" in camera and not scene.matrix:
        scene.matrix = [float(v) for v in np.array(camera["cam_K"], float).ravel()]
    elif "fov_x" in camera and not scene.matrix:
        scene.matrix = [-float(camera["fov_x"])]
    imported.report.add(TRANSLATED, f"{file.name}/campose", None, "rigs/camera")
    if "object_states" not in values:
        note = "no objects: write them with BlenderProc's object state writer"
        imported.report.add(DROPPED, f"{file.name}/object_states", None, "", note)
        return
    for state in _states(file, "object_states", values["object_states"]):
        name = str(state.get("name", "object"))
        found = next((o for o in scene.objects if o.kind == name), None)
        if found is None:
            scene.objects.append(found := _Object(name))
            plain = name.partition(".")[0]
            # Matrices are of files as Blender took them in: z up.
            scene.kinds[name] = _Kind((name, plain), 1.0)
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


def _matrix(file: Path, name: str, state: dict[str, Any], key: str) -> NDArray[np.float64]:
    """A matrix of a state, by itself or by place and Euler angles (x first, radians)."""
    if key in state:
        try:
            matrix = np.array(state[key], float).reshape(4, 4)
        except (ValueError, TypeError) as error:
            raise ScenecError(
                f"{file}/{name}/{key}: {shown(state[key])}: expected a matrix of 4 by 4"
            ) from error
    elif "location" in state and "rotation_euler" in state:
        matrix = np.eye(4)
        for axis, angle in enumerate(state["rotation_euler"]):
            turn = np.eye(3)
            i, j = (axis + 1) % 3, (axis + 2) % 3
            turn[i, i] = turn[j, j] = np.cos(angle)
            turn[i, j], turn[j, i] = -np.sin(angle), np.sin(angle)
            matrix[:3, :3] = turn @ matrix[:3, :3]
        matrix[:3, 3] = state["location"]
    else:
        known = ", ".join(sorted(state)) or "nothing"
        raise ScenecError(
            f"{file}/{name}: expected {key}, or location and rotation_euler; found {known}"
        )
    if not np.isfinite(matrix).all() or abs(np.linalg.det(matrix[:3, :3])) < 1e-12:
        raise ScenecError(f"{file}/{name}: a matrix that is not finite, or flat")
    return matrix


# The cfg.


def _build(
    scene: _Scene, imported: Imported, source: Path, places: Sequence[Path], stand_ins: bool
) -> None:
    cfg, report, taxonomy = imported.cfg, imported.report, Taxonomy()
    files = _find_models(scene, source, places, stand_ins)
    cfg.update(
        version=1,
        # BOP's scenes are called 000000 and so on.
        name=f"scene_{stem}" if (stem := source.resolve().stem)[:1].isdigit() else identifier(stem),
        description=f"Imported from {source.name}, a scene of BlenderProc",
        samples=len(scene.poses),
        outputs=["rgb", "label", "instance", "depth"],
    )
    sky, ground = taxonomy.choice("sky"), taxonomy.choice("ground")
    cfg["labels"] = {LEVEL: taxonomy.ids}
    cfg["materials"] = {"ground": soil()}
    cfg["objects"] = {}
    lowest = np.inf
    for kind, model in scene.kinds.items():
        things = [thing for thing in scene.objects if thing.kind == kind]
        lowest = min(lowest, _class(imported, kind, model, files[kind], things, taxonomy))
    poses = [*scene.poses, *(pose for thing in scene.objects for pose in thing.poses.values())]
    everything = np.array([pose[:3, 3] for pose in poses])
    reach = float(np.abs(everything[:, :2]).max())
    side = tidy(float(f"{max(4.0 * reach, 2.0):.3g}"))
    height = tidy(float(lowest) if np.isfinite(lowest) else float(everything[:, 2].min()) - 1.0)
    cfg["terrain"] = {
        "size_m": [side, side],
        "spacing_m": tidy(side / 200),
        "relief": [{"type": "plane", "height_m": height}],
        "ground": [{"material": "ground", "labels": ground}],
    }
    report.add(ADDED, "", None, "terrain", "a plane that the lowest object stands on")
    cfg["light"] = {"sun": varied_sun(), "sky": {"type": "clear", "labels": sky}}
    report.add(ADDED, "", None, "light", "no light is in the format: a sun by day, a clear sky")
    made = imported.make("camera.csv", track_writer(range(len(scene.poses)), scene.poses))
    cfg["rigs"] = {
        "camera": {
            "pose": {"type": "track", "file": made},
            "sensors": {"rgb": {"resolution": list(scene.size), **_intrinsics(scene)}},
        }
    }


def _intrinsics(scene: _Scene) -> dict[str, Any]:
    k = scene.matrix
    if len(k) == 1:
        return {"fov_deg": tidy(float(np.degrees(-k[0])))}
    if len(k) != 9:
        return {"fov_deg": 60}
    # The middle of the first pixel is (0, 0) there, and (0.5, 0.5) here.
    found = {"fx": k[0], "fy": k[4], "cx": k[2] + 0.5, "cy": k[5] + 0.5}
    found |= {"skew": k[1]} if k[1] else {}
    return {"intrinsics": {name: tidy(value) for name, value in found.items()}}


def _find_models(
    scene: _Scene, source: Path, places: Sequence[Path], stand_ins: bool
) -> dict[str, Path | None]:
    """The file of each kind; all that are missing are told at once.

    Raises:
        CfgError: Some are missing, and nothing may stand in for them.
    """
    found: dict[str, Path | None] = {}
    faults = []
    for kind, model in scene.kinds.items():
        names = [f"{name}{suffix}" for name in model.names for suffix in _SUFFIXES]
        files = [folder / name for folder in places for name in names]
        found[kind] = next((file for file in files if file.is_file()), None)
        if found[kind] is None and not stand_ins:
            message = (
                f"no model {shown(names[0])} (or another ending) in "
                f"{', '.join(str(p) for p in places[:3]) or 'any folder'}; --assets DIR says where "
                "to look, --stand-ins puts a box in its place"
            )
            faults.append(Fault(str(source), 0, 0, f"/{kind}", message))
    if faults:
        raise CfgError(faults)
    return found


def _class(
    imported: Imported,
    kind: str,
    model: _Kind,
    file: Path | None,
    things: Sequence[_Object],
    taxonomy: Taxonomy,
) -> float:
    """The class of all objects of one model; the height of the lowest one's underside."""
    objects, report = imported.cfg["objects"], imported.report
    name = unused(kind, objects)
    low, high = model.low, model.high
    if file is not None:
        box = cached_model(file, model.unit_m, model.up, None).points
        low, high = box.min(axis=0), box.max(axis=0)
        entry = {"file": imported.refer(file), "unit_m": model.unit_m, "up": model.up}
        report.add(TRANSLATED, kind, file.name, f"objects/{name}/models/0")
    else:
        if low is None or high is None:
            low, high = np.full(3, -0.5 * _UNKNOWN_M), np.full(3, 0.5 * _UNKNOWN_M)
        made = imported.make(f"{name}.usdc", lambda path: write_mesh(path, *_box(low, high)))
        entry = {"file": made}
        report.add(APPROXIMATED, kind, None, f"objects/{name}/models/0", "a box in its place")
    moving = any(_moves(thing) for thing in things)
    poses, ids, times = [], [], []
    for number, thing in enumerate(things, 1):
        rows = thing.poses if moving else dict([next(iter(thing.poses.items()))])
        for time, pose in sorted(rows.items()):
            poses.append(pose)
            ids.append(number)
            times.append(float(time))
    table = table_writer(poses, ids=ids, times_s=times if moving else None)
    objects[name] = {
        "type": "placed",
        "models": [entry],
        "labels": taxonomy.choice(name),
        "file": imported.make(f"{name}.csv", table),
        "heights": "world",
    }
    note = "they move: a pose for each picture" if moving else ""
    report.add(TRANSLATED, kind, len(things), f"objects/{name}", note)
    corners, _ = _box(low, high)
    return float(min((corners @ pose[:3, :3].T + pose[:3, 3])[:, 2].min() for pose in poses))


def _moves(thing: _Object) -> bool:
    poses = np.array(list(thing.poses.values()))
    away = np.abs(poses - poses[0])
    return bool(away[:, :3, 3].max() > _REST_M or away[:, :3, :3].max() > _REST_TURN)


def _box(
    low: NDArray[np.float64], high: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Corners [8, 3] and triangles [12, 3] of a box, seen from outside."""
    points = np.array([[x, y, z] for z in (0, 1) for y in (0, 1) for x in (0, 1)])
    quads = [(0, 2, 3, 1), (4, 5, 7, 6), (0, 1, 5, 4), (2, 6, 7, 3), (0, 4, 6, 2), (1, 3, 7, 5)]
    faces = [t for a, b, c, d in quads for t in ((a, b, c), (a, c, d))]
    return low + points * (high - low), np.array(faces)
