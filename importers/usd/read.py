"""Makes a cfg of a stage, by the reader that ``render`` reads it with."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from pxr import Usd, UsdGeom

from scenec.backends.stage.frame import StageFrame
from scenec.backends.stage.read import scene_of
from scenec.backends.stage.sources import Sources
from scenec.importers.output import Imported
from scenec.importers.report import DROPPED, TRANSLATED
from scenec.importers.scene import LEVEL, identifier
from scenec.importers.usd.cameras import add_cameras, moves
from scenec.importers.usd.light import add_light
from scenec.importers.usd.models import ModelWriter
from scenec.importers.usd.scene import Labels, Scene
from scenec.importers.usd.shapes import add_rocks, add_shapes
from scenec.schemas.errors import StageError

#: Samples of a batch of a stage in which nothing moves.
_SAMPLES = 8


def import_usd(file: Path, out: Path, *, ground: str = "", keep: Sequence[str] = ()) -> Imported:
    """Makes a cfg of a stage.

    Args:
        file: The stage.
        out: The cfg that it becomes.
        ground: Path or name of the mesh that is the ground; "": the widest one.
        keep: What of ``KEEP`` does not vary.

    Raises:
        ScenecError: It cannot be read, or has no such mesh.
    """
    sources = Sources(file, allow_missing=True)
    with sources.reading() as stage:
        imported = _imported(stage, file, sources, Imported(out), ground, keep)
    for line in sources.losses:
        imported.report.add(DROPPED, file.name, None, "", line)
    return imported


def _imported(
    stage: Usd.Stage,
    file: Path,
    sources: Sources,
    imported: Imported,
    ground: str,
    keep: Sequence[str],
) -> Imported:
    read = scene_of(stage, file, sources)
    if not (read.bounds < 1e300).all() or not (read.bounds > -1e300).all():
        raise StageError("its transforms and metersPerUnit leave the range of numbers")
    scene = Scene(
        stage,
        read,
        StageFrame.of(stage),
        imported,
        keep,
        Labels(read),
        ModelWriter(read.meshes, read.surfaces),
    )
    report = imported.report
    unit, axis = UsdGeom.GetStageMetersPerUnit(stage), UsdGeom.GetStageUpAxis(stage)
    report.add(TRANSLATED, "metersPerUnit", unit, "", "lengths are meters")
    report.add(TRANSLATED, "upAxis", str(axis), "", "z is up")
    cameras = list(zip(*read.cameras, strict=True))
    moving = any(map(moves, cameras))
    scene.moves = moving or read.rows.motion is not None
    scene.tracked = moving or (bool(cameras) and "cameras" in keep)
    imported.cfg.update(
        version=1,
        name=identifier(file.stem),
        description=f"Imported from {file.name}",
        samples=read.samples if scene.moves else _SAMPLES,
        outputs=["rgb", "label", "instance", "depth"],
        labels={},
        terrain={},
        materials={},
        objects={},
        light={},
        rigs={},
    )
    if not scene.labels.authored:
        why = "a label and an instance id for each object: the stage has no labels"
        report.added(f"labels/{LEVEL}", why)
    add_shapes(scene, ground)
    add_rocks(scene)
    add_light(scene, sources)
    add_cameras(scene, cameras)
    imported.cfg["labels"] = scene.labels.as_cfg(imported)
    for what, there in (
        ("haze", read.haze), ("label maps of the sky", read.sky_label_maps),
        ("lidars", read.lidars and any(read.lidars)),
        ("layers of ground", any(len(mesh.layers) > 1 for mesh in read.meshes)),
    ):  # fmt: skip
        if there:
            report.add(DROPPED, file.name, None, "", f"{what}, of scenec's own schema")
    for line in read.losses:
        report.add(DROPPED, file.name, None, "", line)
    return imported
