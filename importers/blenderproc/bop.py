"""BOP: a folder of a scene, with ``models`` and ``camera.json`` above it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from scenec.importers.blenderproc.scene import ModelKind, Object, Scene, model_folders
from scenec.importers.output import Imported
from scenec.importers.report import APPROXIMATED, TRANSLATED
from scenec.importers.source import Item, Source, check
from scenec.schemas.affine import mirrored, orthonormal
from scenec.schemas.spelling import shown

#: Meters per unit.
MM = 1e-3
#: A camera's axes (x right, y down, z ahead) in a world where it looks level, z up.
_LEVEL = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])


def read_bop(folder: Path, imported: Imported) -> Scene:
    """Reads a folder with ``scene_camera.json`` and ``scene_gt.json``.

    Raises:
        CfgError: All that is wrong with these files.
    """
    cameras, truth = Source(folder / "scene_camera.json"), Source(folder / "scene_gt.json")
    scene = Scene()
    frames = sorted(_frames(cameras.root()), key=lambda entry: int(entry[0]))
    from_world = [_from_world(item) for _, item in frames]
    seen = [_entries(truth.root().get(name)) for name, _ in frames]
    if not frames:
        cameras.root().fault("no picture: expected an object with one for each")
    check([cameras, truth])
    known = [np.linalg.inv(matrix) for matrix in from_world if matrix is not None]
    scene.poses = known if len(known) == len(frames) else _by_objects(seen, frames, imported)
    for number, entries in enumerate(seen):
        count: dict[str, int] = {}
        for kind, in_camera in entries:
            nth = count[kind] = count.get(kind, 0) + 1
            same = [o for o in scene.objects if o.kind == kind]
            if len(same) < nth:
                number_of = int(kind.removeprefix("obj_"))
                scene.objects.append(Object(kind, category=number_of))
                same.append(scene.objects[-1])
            same[nth - 1].poses[number] = scene.poses[number] @ in_camera
    matrices = [item.need("cam_K").numbers(9) for _, item in frames]
    for (_, item), matrix in zip(frames, matrices, strict=True):
        note = "" if matrix == matrices[0] else "those of the first picture"
        item.get("cam_K").approximated("rigs/camera/sensors/rgb/intrinsics", note)
        why = "says how pictures are stored, not what is in them"
        item.drop(why, "depth_scale", "view_level", "elev", "mode")
    check([cameras, truth])
    scene.matrix = matrices[0]
    scene.size = _size(folder, matrices[0], imported)
    _bop_models(folder, scene, imported)
    for source in (cameras, truth):
        source.leave({})
        source.report_to(imported.report)
    return scene


def _frames(root: Item) -> Iterator[tuple[str, Item]]:
    for name, item in root.entries():
        if name.isascii() and name.isdecimal():
            yield name, item
        else:
            item.fault(f"{shown(name)}: expected the number of a picture as the key")


def _from_world(item: Item) -> NDArray[np.float64] | None:
    turn, place = item.get("cam_R_w2c"), item.get("cam_t_w2c")
    if not turn or not place:
        return None
    return _rigid(turn.translated("rigs/camera/pose"), place.translated("rigs/camera/pose"))


def _rigid(turn: Item, place: Item) -> NDArray[np.float64]:
    """A rotation by row and a place in millimeters, as a matrix in meters."""
    matrix = np.eye(4)
    rotation = np.array(turn.numbers(9)).reshape(3, 3)
    if not orthonormal(rotation, 1e-3) or mirrored(rotation):
        turn.fault(f"{shown(turn.value)}: expected a rotation matrix, by row")
        return matrix
    matrix[:3, :3] = rotation
    matrix[:3, 3] = np.array(place.numbers(3)) * MM
    return matrix


def _entries(item: Item) -> list[tuple[str, NDArray[np.float64]]]:
    """Objects of one picture: name of the model, and its pose in the camera."""
    found = []
    for entry in item.children():
        number = entry.need("obj_id")
        name = f"obj_{number.whole(0):06d}"
        turn, place = entry.need("cam_R_m2c"), entry.need("cam_t_m2c")
        for part in (number, turn, place):
            part.translated(f"objects/{name}")
        found.append((name, _rigid(turn, place)))
    return found


def _by_objects(
    views: Sequence[Sequence[tuple[str, NDArray[np.float64]]]],
    frames: Sequence[tuple[str, Item]],
    imported: Imported,
) -> list[NDArray[np.float64]]:
    """Poses of cameras that do not say theirs: by an object that the first one sees, too."""
    first = np.eye(4)
    first[:3, :3] = _LEVEL
    poses = [first]
    for entries, (name, item) in zip(views[1:], frames[1:], strict=True):
        pair = next(((a, b) for kind, a in views[0] for other, b in entries if kind == other), None)
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


def _bop_models(folder: Path, scene: Scene, imported: Imported) -> None:
    """Kinds of models, with their boxes where ``models_info.json`` has them."""
    named = [place / "models_info.json" for place in model_folders(folder)]
    info = next((file for file in named if file.is_file()), None)
    source = Source(info) if info else None
    for name in dict.fromkeys(thing.kind for thing in scene.objects):
        number = int(name.removeprefix("obj_"))
        kind = ModelKind((name, f"obj_{number:02d}", f"obj_{number}"), MM)
        entry = source.root().get(str(number)) if source else None
        if entry:
            low = np.array([entry.need(f"min_{axis}").number() for axis in "xyz"])
            size = np.array([entry.need(f"size_{axis}").number(0.0) for axis in "xyz"])
            kind.low, kind.high = low * MM, (low + size) * MM
        scene.kinds[name] = kind
    if source:
        check([source])
        imported.report.add(TRANSLATED, "models_info.json", None, "terrain/relief/0/height_m")
