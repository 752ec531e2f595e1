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

import re
from collections.abc import Sequence
from pathlib import Path

from scenec.importers.blenderproc.bop import read_bop
from scenec.importers.blenderproc.build import build
from scenec.importers.blenderproc.hdf5 import read_hdf5
from scenec.importers.blenderproc.scene import model_folders
from scenec.importers.output import Imported
from scenec.schemas.errors import ScenecError


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
        scene = read_hdf5(files, imported)
    elif (source / "scene_camera.json").is_file():
        scene = read_bop(source, imported)
    else:
        there = sorted(p.parent.name for p in source.glob("**/scene_camera.json"))[:4]
        hint = f"; scenes below it: {', '.join(there)}" if there else ""
        raise ScenecError(
            f"{source}: expected a folder with scene_camera.json and scene_gt.json (BOP), or "
            f"HDF5 files of BlenderProc{hint}"
        )
    places = [*folders, *model_folders(source)]
    build(scene, imported, source, places, stand_ins)
    return imported


def _hdf5_files(source: Path) -> list[Path]:
    if source.suffix.lower() in (".hdf5", ".h5"):
        return [source]
    found = [p for p in source.glob("*.hdf5") if p.is_file()] if source.is_dir() else []
    return sorted(found, key=lambda p: [int(n) for n in re.findall(r"\d+", p.stem)] or [0])
