"""From a stage to a cfg."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from pxr import Tf, Usd, UsdGeom

from scenec.compiler.geometry.affine import TO_Z_UP
from scenec.importers.output import Imported
from scenec.importers.report import TRANSLATED
from scenec.importers.scene import LEVEL, identifier
from scenec.importers.usd.cameras import add_cameras
from scenec.importers.usd.light import add_light
from scenec.importers.usd.meshes import add_ground, add_instances, add_rocks, model_of
from scenec.importers.usd.scene import Scene, is_prototype, shown_prims
from scenec.schemas.crate import crate_fault
from scenec.schemas.errors import ScenecError
from scenec.schemas.native import native_reading

#: Samples of a batch.
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
    try:
        with native_reading(file):
            return _imported(file, out, ground, keep)
    except Tf.ErrorException as error:
        reason = str(error).strip().splitlines()[-1].strip() or "USD gives no reason"
        raise ScenecError(f"{file}: not a sound USD file: {reason[:300]}") from error


def _imported(file: Path, out: Path, ground: str, keep: Sequence[str]) -> Imported:
    if not file.is_file():
        raise ScenecError(f"{file}: {'not a file' if file.exists() else 'there is no such file'}")
    if damage := crate_fault(file):
        raise ScenecError(f"{file}: not a sound USD file: {damage}")
    imported = Imported(out)
    stage = Usd.Stage.Open(str(file))
    unit, axis = UsdGeom.GetStageMetersPerUnit(stage), str(UsdGeom.GetStageUpAxis(stage)).lower()
    to_world = np.eye(4)
    to_world[:3, :3] = np.array(TO_Z_UP[axis], float) * unit
    scene = Scene(stage, imported, to_world, keep)
    imported.report.add(TRANSLATED, "metersPerUnit", unit, "unit_m")
    imported.report.add(TRANSLATED, "upAxis", axis, "up")
    imported.cfg.update(
        version=1,
        name=identifier(file.stem),
        description=f"Imported from {file.name}",
        samples=_SAMPLES,
        outputs=["rgb", "label", "instance", "depth"],
        labels={},
        terrain={},
        materials={},
        objects={},
        light={},
        rigs={},
    )
    instancers = [p for p in shown_prims(stage, UsdGeom.PointInstancer) if not is_prototype(p)]
    scene.model = model_of(scene, file, instancers, {"unit_m": unit, "up": axis})
    sky = scene.taxonomy.choice("sky")
    add_ground(scene, ground)
    for instancer in instancers:
        add_instances(scene, instancer)
    add_rocks(scene)
    add_light(scene, sky)
    add_cameras(scene)
    imported.cfg["labels"] = {LEVEL: scene.taxonomy.ids}
    return imported
