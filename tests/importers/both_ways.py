"""A foreign stage as `render` reads it, and as its import compiles: the same pixels of both."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from scenec.backends.camera.rays import camera_rays
from scenec.backends.exact import ExactCaster
from scenec.backends.stage.read import read_stage
from scenec.backends.stage.scene import Camera, RenderScene
from scenec.compiler.cfg.load import load
from scenec.compiler.compile import compile_cfg
from scenec.importers.output import Imported, write
from scenec.importers.usd.read import import_usd
from scenec.importers.usd.scene import KEEP


def notes(made: Imported, fate: str) -> dict[str, str]:
    """What is said of values of a fate, by where they stood."""
    return {entry.pointer: entry.note for entry in made.report.entries if entry.fate == fate}


@dataclass(frozen=True)
class Pixels:
    """What a camera sees: depth (inf: nothing), instance ids, the label's name on each level."""

    depth: NDArray[np.float64]
    instance: NDArray[np.int64]
    labels: dict[str, NDArray[np.str_]]


def both(
    file: Path, *, keep: Sequence[str] = KEEP, samples: int | None = None, ground: str = ""
) -> tuple[RenderScene, RenderScene, Imported]:
    """The stage, what its import compiles without the rocks that it adds, and the import."""
    made = import_usd(file, file.parent / f"{file.stem}_ours.json", keep=keep, ground=ground)
    rocks = made.cfg["objects"].pop("rocks")
    made.cfg["materials"].pop(rocks["material"])
    for level, name in rocks["labels"].items():
        del made.cfg["labels"][level][name]
        if not made.cfg["labels"][level]:
            del made.cfg["labels"][level]
    if samples:
        made.cfg["samples"] = samples
    write(made)
    out = file.parent / f"{file.stem}_out"
    compile_cfg(load(made.out), seed=0, out=out)
    theirs = read_stage(file, allow_missing=True)
    return theirs, read_stage(out / "batch_0000" / "stage.usda"), made


def seen(scene: RenderScene, camera: Camera, sample: int = 0) -> Pixels:
    """What a camera sees at a sample."""
    caster = ExactCaster(scene)
    caster.pose(sample)
    row, face, depth = caster.cast(camera_rays(camera))
    hit = row >= 0
    instance = np.zeros(len(row), np.int64)
    instance[hit] = scene.rows.instance_id[row[hit]]
    labels = {}
    for level in scene.levels:
        ids = np.full(len(row), scene.sky_labels.get(level, 0), np.int64)
        for mesh in np.unique(scene.rows.mesh[row[hit]]):
            of_mesh = np.flatnonzero(hit)[scene.rows.mesh[row[hit]] == mesh]
            ids[of_mesh] = scene.meshes[mesh].labels[level][face[of_mesh]]
        names = {**scene.label_names[level], 0: ""}
        labels[level] = np.array([names[int(i)] for i in ids])
    return Pixels(np.where(hit, depth, np.inf), instance, labels)


def paired(a: NDArray[np.int64], b: NDArray[np.int64]) -> bool:
    """Whether two pictures of ids are the same but for the numbers; 0 is 0 in both."""
    pairs = {(int(x), int(y)) for x, y in zip(a, b, strict=True)}
    lone = len({x for x, _ in pairs}) == len(pairs) == len({y for _, y in pairs})
    return lone and all((x == 0) == (y == 0) for x, y in pairs)
