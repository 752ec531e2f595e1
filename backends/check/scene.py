"""Checks what became of a stage: losses, labels without use, cameras inside of objects."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import product

import numpy as np
from numpy.typing import NDArray

from scenec.backends.check.finding import Finding
from scenec.backends.contract import Rays
from scenec.backends.exact.caster import ExactCaster
from scenec.backends.stage.scene import RenderScene, Rows
from scenec.backends.stage.sky_labels import load_label_map
from scenec.schemas.errors import StageError

#: Rays about a camera that have to meet the backs of surfaces: below a sheet five look up steeply.
_FEWEST = 5


def check_scene(scene: RenderScene) -> Iterator[Finding]:
    """Yields warnings: the scene's losses, labels no pixel can show, cameras below or inside."""
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
    for path, samples in _enclosed(scene).items():
        more = f" and {len(samples) - 1} others" if len(samples) > 1 else ""
        message = (
            f"at sample {samples[0]}{more} all surfaces about it show their backs: is it below the "
            "ground or inside of something, or are these turned inside out?"
        )
        yield Finding("enclosed", "warning", path, message)


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


def _enclosed(scene: RenderScene) -> dict[str, list[int]]:
    """Finds samples of cameras and lidars that hit only the backs of surfaces, by their prims."""
    # Along the axes and between three of them.
    ways = [way for way in product((-1.0, 0.0, 1.0), repeat=3) if sum(map(abs, way)) in (1, 3)]
    samples_of: dict[str, list[int]] = {}
    caster = ExactCaster(scene)
    for sample, cameras in enumerate(scene.cameras):
        places = [(one.path, one.camera_to_world[:3, 3]) for one in cameras if one.fires(sample)]
        if scene.lidars:
            places += [(one.path, one.to_world[:3, 3]) for one in scene.lidars[sample]]
        if not places:
            continue
        caster.pose(sample)
        origins = np.repeat(np.stack([at for _, at in places]), len(ways), axis=0)
        rays = Rays(origins, np.tile(ways, (len(places), 1)), (len(origins), 1))
        row, face, _ = caster.cast(rays)
        posed = scene.rows_at(sample)
        hit = (row >= 0).reshape(len(places), -1)
        back = np.zeros(len(row), np.bool_)
        for k in np.flatnonzero(row >= 0):
            back[k] = (_outward(scene, posed, row[k], face[k]) * rays.directions[k]).sum() > 0.0
        backs = back.reshape(hit.shape)
        for k in np.flatnonzero((backs == hit).all(axis=1) & (hit.sum(axis=1) >= _FEWEST)):
            samples_of.setdefault(places[k][0], []).append(sample)
    return samples_of


def _outward(scene: RenderScene, rows: Rows, row: int, face: int) -> NDArray[np.float64]:
    """Returns a face's normal, [3], of any length, on the side where it is counter-clockwise."""
    mesh, matrix = scene.meshes[rows.mesh[row]], rows.to_world[row][:, :3]
    corners = mesh.points[mesh.faces[face]].astype(np.float64) @ matrix.T
    # A mirrored row winds its faces the other way.
    return np.asarray(
        np.cross(corners[1] - corners[0], corners[2] - corners[0]) * np.sign(np.linalg.det(matrix))
    )
