"""The cfg of a scene of BlenderProc."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.assets.model import cached_model
from scenec.importers.blenderproc.scene import ModelKind, Object, Scene
from scenec.importers.numbers import tidy
from scenec.importers.output import Imported
from scenec.importers.poses import lost_of
from scenec.importers.report import APPROXIMATED, TRANSLATED
from scenec.importers.scene import (
    LEVEL,
    Taxonomy,
    identifier,
    intrinsics,
    soil,
    unused,
    varied_sun,
)
from scenec.importers.writers import mesh_writer, table_writer, track_writer
from scenec.schemas.errors import CfgError, Fault
from scenec.schemas.spelling import shown

#: What an object may move between pictures and count as at rest, m, and its turn, as a sine.
_REST_M, _REST_TURN = 5e-4, 1e-3
#: Side of the box that stands for a model of unknown size, m.
_UNKNOWN_M = 0.1
#: The level of labels that has a source's own ids.
CATEGORY = "category"
_SUFFIXES = (".ply", ".obj", ".glb", ".gltf", ".usd", ".usda", ".usdc", ".usdz", ".stl", ".off")


def build(
    scene: Scene, imported: Imported, source: Path, places: Sequence[Path], stand_ins: bool
) -> None:
    """Makes the cfg.

    Args:
        scene: What the source says.
        imported: The cfg in the making.
        source: What is imported, for names and faults.
        places: Folders that models may be in.
        stand_ins: Whether boxes take the place of models that are missing.

    Raises:
        CfgError: Models are missing.
    """
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
    categories = {f"category_{n}": n for n in sorted({o.category for o in scene.objects} - {0})}
    if categories:
        cfg["labels"][CATEGORY] = categories
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
    report.added("terrain", "a plane that the lowest object stands on")
    cfg["light"] = {"sun": varied_sun(), "sky": {"type": "clear", "labels": sky}}
    report.added("light", "no light is in the format: a sun by day, a clear sky")
    made = imported.make("camera.csv", track_writer(range(len(scene.poses)), scene.poses))
    cfg["rigs"] = {
        "camera": {
            "pose": {"type": "track", "file": made},
            "sensors": {"rgb": {"resolution": list(scene.size), **_intrinsics(scene)}},
        }
    }


def _intrinsics(scene: Scene) -> dict[str, Any]:
    k = scene.matrix
    if len(k) == 1:
        return {"fov_deg": tidy(float(np.degrees(-k[0])))}
    if len(k) != 9:
        return {"fov_deg": 60}
    return intrinsics(k)


def _find_models(
    scene: Scene, source: Path, places: Sequence[Path], stand_ins: bool
) -> dict[str, Path | None]:
    """The file of each kind; all that are missing are told at once.

    Raises:
        CfgError: Some are missing, and nothing may stand in for them.
    """
    models: dict[str, Path | None] = {}
    faults = []
    for kind, model in scene.kinds.items():
        names = [f"{name}{suffix}" for name in model.names for suffix in _SUFFIXES]
        files = [folder / name for folder in places for name in names]
        models[kind] = next((file for file in files if file.is_file()), None)
        if models[kind] is None and not stand_ins:
            message = (
                f"no model {shown(names[0])} (or another ending) in "
                f"{', '.join(str(p) for p in places[:3]) or 'any folder'}; --assets DIR says where "
                "to look, --stand-ins puts a box in its place"
            )
            faults.append(Fault(str(source), 0, 0, f"/{kind}", message))
    if faults:
        raise CfgError(faults)
    return models


def _class(
    imported: Imported,
    kind: str,
    model: ModelKind,
    file: Path | None,
    things: Sequence[Object],
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
        made = imported.make(f"{name}.usdc", mesh_writer(*_box(low, high)))
        entry = {"file": made}
        report.add(APPROXIMATED, kind, None, f"objects/{name}/models/0", "a box in its place")
    _report_losses(imported, name, things)
    moving = any(_moves(thing) for thing in things)
    poses, ids, times = [], [], []
    for number, thing in enumerate(things, 1):
        rows = thing.poses if moving else dict([next(iter(thing.poses.items()))])
        for time, pose in sorted(rows.items()):
            poses.append(pose)
            ids.append(number)
            times.append(float(time))
    table = table_writer(poses, id=ids, time_s=times if moving else None)
    labels = taxonomy.choice(name)
    if category := things[0].category:
        labels[CATEGORY] = f"category_{category}"
    objects[name] = {
        "type": "placed",
        "models": [entry],
        "labels": labels,
        "file": imported.make(f"{name}.csv", table),
        "heights": "world",
    }
    note = "they move: a pose for each picture" if moving else ""
    report.add(TRANSLATED, kind, len(things), f"objects/{name}", note)
    corners, _ = _box(low, high)
    return float(min((corners @ pose[:3, :3].T + pose[:3, 3])[:, 2].min() for pose in poses))


def _report_losses(imported: Imported, name: str, things: Sequence[Object]) -> None:
    """Says of each object what a table of poses cannot hold of it."""
    report, pictures = imported.report, imported.cfg["samples"]
    for number, thing in enumerate(things, 1):
        at, to = f"{thing.kind} {number}", f"objects/{name}/file"
        lost = dict.fromkeys(lost_of(pose[:3, :3]) for pose in thing.poses.values())
        for note in filter(None, lost):
            report.add(APPROXIMATED, at, None, to, note)
        if len(thing.poses) < pictures:
            there = ", ".join(str(picture) for picture in sorted(thing.poses)[:8])
            more = ", …" if len(thing.poses) > 8 else ""
            note = f"in {len(thing.poses)} of {pictures} pictures ({there}{more}), here in all"
            report.add(APPROXIMATED, at, None, to, note)


def _moves(thing: Object) -> bool:
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
