"""The way from a stage on disk to a RenderScene."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pxr import Usd

from scenec.backends.stage import values
from scenec.backends.stage.cameras import read_cameras
from scenec.backends.stage.expanded import Expanded
from scenec.backends.stage.frame import StageFrame
from scenec.backends.stage.instancers import Expander
from scenec.backends.stage.labels import LabelTable, labeled_instances, prim_labels, read_table
from scenec.backends.stage.lidars import read_lidars
from scenec.backends.stage.lights import read_haze, read_lighting, read_sky_label_maps
from scenec.backends.stage.meshes import MeshTable
from scenec.backends.stage.scene import Mesh, Motion, RenderScene, Rows
from scenec.backends.stage.sources import Sources
from scenec.backends.stage.times import sample_times, time_codes
from scenec.backends.stage.unread import Unread
from scenec.schemas import stage as names
from scenec.schemas.affine import box_around, moved_boxes
from scenec.schemas.craters import CraterTable
from scenec.schemas.errors import StageError
from scenec.schemas.georeference import Georeference


def read_stage(path: Path | str, *, allow_missing: bool = False) -> RenderScene:
    """Reads a stage of scenec's schema, or any other, into flat arrays.

    Accepted of foreign stages: polygons (as triangles, with a map back), either handedness,
    Y or Z up, any unit, nested instancers, native instances, mirrored and sheared transforms,
    visibility, purpose, ``inactiveIds`` and ``invisibleIds``, UsdSemantics labels in place of label
    primvars, UsdPreviewSurface constants in place of ours. Implicit shapes are tessellated
    (``implicit.ERROR``), subdivision surfaces refined. What is not followed is named in the scene's
    ``losses``.
    Topology is that of the first time code. Points (also those that a skeleton moves), transforms,
    an instancer's positions, orientations and scales, and visibility are taken as they are at each
    sample's time code (between authored codes as USD has them). The samples of a stage without a
    range of time codes are those that are authored.

    Args:
        path: ``.usda``, ``.usdc``, ``.usd`` or ``.usdz``.
        allow_missing: Whether to read what is there of a stage that lacks layers, prims or
            pictures, or whose files are not those of its manifest; ``losses`` then names these.

    Raises:
        StageError: Not a stage, a newer schema, one that is not whole, or values that no reader
            could make sense of.
    """
    sources = Sources(Path(path), allow_missing)
    with sources.reading() as stage:
        scene = scene_of(stage, Path(path), sources)
    return replace(scene, losses=(*scene.losses, *sources.losses))


def scene_of(stage: Usd.Stage, path: Path, sources: Sources) -> RenderScene:
    """Makes the scene of a composed stage, without the losses of its sources.

    Args:
        stage: From ``Sources.reading``.
        path: Its root layer.
        sources: Of the stage.

    Raises:
        StageError: As ``read_stage``.
    """
    _require_schema(stage, path)
    frame = StageFrame.of(stage)
    times = time_codes(stage)
    table = read_table(stage)
    may_move = len(times) > 1 or not stage.HasAuthoredTimeCodeRange()
    unread = Unread(may_move, sources)
    meshes = MeshTable(table, times, unread, sources)
    expander = Expander(meshes, times, labeled_instances(stage, table))
    rows = _rows(expander.expand(stage.GetPseudoRoot()).settled(), frame, meshes)
    cameras = read_cameras(stage, frame, times, unread)
    lighting = read_lighting(stage, frame, times, sources)
    label_maps = read_sky_label_maps(stage, table, times, sources)
    lidars = read_lidars(stage, frame, times)
    return RenderScene(
        source=path,
        digest=sources.digest(stage),
        samples=len(times),
        meshes=tuple(meshes.meshes),
        rows=rows,
        surfaces=tuple(meshes.surfaces),
        levels=table.levels,
        label_names={
            level: {number: name for name, number in ids.items()}
            for level, ids in table.ids.items()
        },
        sky_labels=_sky_labels(stage, table),
        cameras=cameras,
        lighting=lighting,
        bounds=_bounds(tuple(meshes.meshes), rows),
        instance_paths=expander.bases,
        times=sample_times(stage, times),
        parts=expander.parts,
        origins=tuple(expander.origins),
        haze=read_haze(stage, frame, times),
        sky_label_maps=label_maps,
        sky_labels_below=_sky_labels_below(stage, table),
        lidars=lidars,
        georeference=read_georeference(stage),
        craters=read_craters(stage),
        losses=unread.lines,
    )


def read_georeference(stage: Usd.Stage) -> Georeference | None:
    """Reads where on a body the world lies; None where the root does not say.

    Raises:
        StageError: A value is none, or none that it can have.
    """
    root = stage.GetDefaultPrim()
    found: dict[str, Any] = {}
    for field, (name, kind) in names.GEOREFERENCE.items():
        attribute = root.GetAttribute(name) if root else None
        if not attribute or not attribute.HasValue():
            continue
        if kind == "DoubleArray":
            found[field] = values.vector(attribute, 4 if field == "east_north" else 6)
        elif kind == "String":
            found[field] = values.word(attribute, "")
        else:
            found[field] = values.number(attribute, 0.0)
    if "semi_major_m" not in found:
        return None
    radii = found["semi_major_m"], found.setdefault("semi_minor_m", found["semi_major_m"])
    if not (min(radii) > 0.0 and abs(found.setdefault("latitude_deg", 0.0)) <= 90.0):
        raise StageError(
            f"{root.GetPath()}: scenec:georeference has radii of {radii[0]:g} m and {radii[1]:g} m "
            f"and the latitude {found['latitude_deg']:g}: expected radii above 0, and -90 to 90"
        )
    crs = root.GetAttribute(names.ATTR_GEOREFERENCE_CRS)
    usual = {"body": "", "longitude_deg": 0.0, "crs": values.word(crs, "") if crs else ""}
    return Georeference(**{**usual, **found})


def read_craters(stage: Usd.Stage) -> CraterTable | None:
    """Reads what the stage tells of its terrain's craters, or None.

    Raises:
        StageError: A value is none, or there are more of one than of another.
    """
    prim = stage.GetPrimAtPath(names.TERRAIN)
    if not prim or not prim.HasAttribute(names.CRATERS["x_m"][0]):
        return None
    found = {
        field: values.array(
            prim.GetAttribute(name), np.float64 if kind == "DoubleArray" else np.float32
        )
        for field, (name, kind) in names.CRATERS.items()
    }
    if len({len(column) for column in found.values()}) > 1:
        counts = ", ".join(f"{names.CRATERS[f][0]} {len(column)}" for f, column in found.items())
        raise StageError(f"{names.TERRAIN}: expected as many values of each: {counts}")
    return CraterTable(**found)


def _require_schema(stage: Usd.Stage, path: Path) -> None:
    root = stage.GetDefaultPrim()
    attribute = root.GetAttribute(names.ATTR_SCHEMA_VERSION) if root else None
    if not attribute or not attribute.HasValue():
        return
    version = values.word(attribute, "")
    major = version.split(".")[0]
    if not major.isdigit() or int(major) > int(names.SCHEMA_VERSION.split(".")[0]):
        raise StageError(
            f"{path}: its schema version is {version}; this scenec reads {names.SCHEMA_VERSION}"
        )


def _rows(expanded: Expanded, frame: StageFrame, meshes: MeshTable) -> Rows:
    motion = None
    if expanded.path is not None:
        path = np.ascontiguousarray(frame.affine(expanded.path))
        motion = Motion(expanded.moving.astype(np.int32), path)
        if meshes.families:
            motion = replace(motion, stand_ins=_stand_ins(expanded, motion, meshes))
    return Rows(
        mesh=expanded.mesh,
        to_world=np.ascontiguousarray(frame.affine(expanded.matrix)),
        instance_id=expanded.instance_id.astype(np.uint32),
        variation=expanded.variation,
        motion=motion,
        part=expanded.part,
    )


def _stand_ins(expanded: Expanded, motion: Motion, meshes: MeshTable) -> NDArray[np.int32]:
    found = np.tile(motion.rows, (len(motion.to_world), 1))
    for family, at in meshes.families:
        # Wherever a shape is, its poses are rows behind one another.
        poses = np.flatnonzero(np.isin(expanded.mesh, family)).reshape(-1, len(family))
        for rows in poses.T:
            moves, place = motion.among(rows)
            found[:, place] = poses[moves][:, at].T
    return found


def _sky_labels(stage: Usd.Stage, table: LabelTable) -> dict[str, int]:
    prim = stage.GetPrimAtPath(names.SKY_PRIM)
    own = prim_labels(prim, table) if prim else {}
    return {level: own.get(level, 0) for level in table.levels}


def _sky_labels_below(stage: Usd.Stage, table: LabelTable) -> dict[str, int]:
    prim = stage.GetPrimAtPath(names.SKY_PRIM)
    found = {}
    for level in table.levels if prim else ():
        attribute = prim.GetAttribute(names.ATTR_SKY_LABEL_BELOW.format(level=level))
        if attribute and attribute.HasValue():
            found[level] = values.whole(attribute, 0)
            if found[level] not in (0, *table.ids[level].values()):
                what = f"{attribute.GetPath()}: {found[level]}"
                raise StageError(f"{what}: expected an id that the level {level} has")
    return found


def _bounds(meshes: tuple[Mesh, ...], rows: Rows) -> NDArray[np.float64]:
    """Bounds faces at all samples, by the corners of each row's local bounds: a little generous."""
    local = np.zeros((len(meshes), 2, 3))
    filled = np.array([bool(len(mesh.faces) and len(mesh.points)) for mesh in meshes], bool)
    for index in np.flatnonzero(filled).tolist():
        local[index] = box_around(meshes[index].points)
    there = filled[rows.mesh]
    if not there.any():
        return np.zeros((2, 3))
    boxes = [_world_box(rows.to_world[there], rows.mesh[there], local)]
    if rows.motion is not None:
        mesh_of = rows.mesh[rows.motion.rows]
        there = filled[mesh_of]
        boxes += [_world_box(at[there], mesh_of[there], local) for at in rows.motion.to_world]
    return np.stack([np.min(boxes, axis=0)[0], np.max(boxes, axis=0)[1]])


def _world_box(
    to_world: NDArray[np.float64], mesh: NDArray[np.int32], local: NDArray[np.float64]
) -> NDArray[np.float64]:
    box = np.array([np.full(3, np.inf), np.full(3, -np.inf)])
    # In parts: the products of a million rows at once would be most of what reading takes.
    for start in range(0, len(mesh), 1 << 16):
        at, part = to_world[start : start + (1 << 16)], mesh[start : start + (1 << 16)]
        boxes = moved_boxes(at[:, :, :3], local[part], at[:, :, 3])
        box[0] = np.minimum(box[0], box_around(boxes[:, 0])[0])
        box[1] = np.maximum(box[1], box_around(boxes[:, 1])[1])
    return box
