"""Checks of what became of a stage: what was not read of it, and labels that nothing carries."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from scenec.backends.check.finding import Finding
from scenec.backends.stage.scene import RenderScene
from scenec.backends.stage.sky_labels import load_label_map
from scenec.schemas.errors import StageError


def check_scene(scene: RenderScene) -> Iterator[Finding]:
    """Warnings: each of the scene's losses, each label that no pixel can show."""
    where = scene.source.name
    for line in scene.losses:
        yield Finding("unread", "warning", where, line)
    if (scene.source.parent / "report.json").is_file():
        # Compiled here: the table is the cfg's, and the report says what was left out.
        return
    for level in scene.levels:
        carried = _carried(scene, level)
        for number, name in scene.label_names[level].items():
            if number not in carried:
                message = f"no face, instance or sky carries the label {name} of the level {level}"
                yield Finding("labels", "warning", where, message)


def _carried(scene: RenderScene, level: str) -> set[int]:
    """Label ids that a pixel may show at some sample."""
    found = {scene.sky_labels[level], scene.sky_labels_below.get(level, 0)}
    for index in np.unique(scene.rows.mesh).tolist():
        found.update(np.unique(scene.meshes[index].labels[level]).tolist())
    for file in {maps[level].file for maps in scene.sky_label_maps if level in maps}:
        try:
            found.update(np.unique(load_label_map(file)).tolist())
        except StageError:
            # Another check's: here nothing is known of it.
            found.update(scene.label_names[level])
    return found
