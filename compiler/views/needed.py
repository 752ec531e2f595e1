"""Selects what the outputs of a batch need of its Scene, and leaves out the rest.

======================  ============================================================================
output                  needs, beside geometry, places and cameras
======================  ============================================================================
``rgb``                 materials and their pictures, weights, variation, shading normals, texture
                        coordinates, lights, haze, exposures
``label``               label tables, label ids on faces and classes, the sky's labels; the ground
                        is cut along label lines
``instance``            instance ids: bases of classes, ids of instances
``amodal``              the same
other packages' passes  the same as ``label`` and ``instance``
lidars that feel color  the same as ``rgb``: intensity, width of beams, detection
all others              nothing: ``normal`` is the geometric one
======================  ============================================================================

Nothing here moves what stays: geometry is the same whatever is asked for, but for the cut.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import StrEnum
from pathlib import Path
from typing import NamedTuple

import numpy as np

from scenec.compiler.scene.ground import Ground, MeshTile
from scenec.compiler.scene.material import Material
from scenec.compiler.scene.objects import Objects, Placed, Prototype, Scatter
from scenec.compiler.scene.rig import Rig
from scenec.schemas.codec import Facts
from scenec.schemas.left_out import entry
from scenec.schemas.passes import BUILT_IN

#: Name of this pass in reports.
PASS = "outputs"  # noqa: S105 (no password)
_NO_RGB = "no sensor asks for rgb"
_NO_LABELS = "no sensor asks for labels"
_NO_IDS = "no sensor asks for instances"
#: Bytes a vertex of what only pictures show: a normal and a color; and of a number.
_SHADING, _NUMBER = 24, 4


class Keep(StrEnum):
    """Chooses how much of a scene stays in the stage.

    ``SEEN``: what the cameras of the batch can see the effect of (the default).
    ``UNPRUNED``: everything, as coarse where no camera sees it as ``SEEN`` would have it: meshes
    and levels of detail are the same, so annotation is, too (``--no-prune``).
    ``ALL``: everything, as fine out of view as in view, for walking around the stage in a viewer
    (``--keep all``).
    """

    SEEN = "seen"
    UNPRUNED = "unpruned"
    ALL = "all"


class Needs(NamedTuple):
    """Says what the outputs show.

    Attributes:
        color: Materials, shading and light.
    """

    color: bool
    labels: bool
    ids: bool


def needs_of(outputs: Iterable[str], keep: Keep = Keep.SEEN, levels: bool = True) -> Needs:
    """Returns what a batch's outputs need.

    Args:
        keep: ``Keep.ALL`` needs everything that the cfg has: someone will walk around in the stage.
    """
    asked = set(outputs)
    if keep is Keep.ALL:
        return Needs(True, levels, True)
    others = not asked <= BUILT_IN.keys()
    labels = "label" in asked or (others and levels)
    return Needs("rgb" in asked, labels, others or bool(asked & {"instance", "amodal"}))


def with_color(rigs: tuple[Rig, ...], keep: Keep = Keep.SEEN) -> tuple[Rig, ...]:
    """The rigs with what sees color only: others do not see how fine pictures are.

    Args:
        rigs: All of them; given back as they are where each sensor does.
        keep: With ``Keep.ALL`` every sensor may.
    """
    colored = all(
        all("rgb" in sensor.outputs for sensor in rig.sensors)
        and all(lidar.sees_color for lidar in rig.lidars)
        for rig in rigs
    )
    if keep is Keep.ALL or colored:
        return rigs
    seeing = (
        replace(
            rig,
            sensors=tuple(sensor for sensor in rig.sensors if "rgb" in sensor.outputs),
            lidars=tuple(lidar for lidar in rig.lidars if lidar.sees_color),
        )
        for rig in rigs
    )
    return tuple(rig for rig in seeing if rig.sensors or rig.lidars)


@dataclass(frozen=True)
class Used[Kind]:
    """Holds what is left of a Scene's contents.

    Attributes:
        materials: By name, drawn or built.
        ground, objects: As in ``Scene``.
    """

    materials: dict[str, Kind]
    ground: Ground
    objects: Objects
    left_out: list[Facts] = field(default_factory=list)


def without_unused[Kind](
    materials: Mapping[str, Kind],
    ground: Ground,
    objects: Sequence[Scatter | Placed],
    needs: Needs,
) -> Used[Kind]:
    """Leaves out models that nothing is, layers that show nowhere, materials that nothing has.

    Classes without instances stay in the list, since their ids stay reserved; they have no
    prototypes then, and are not written.

    Args:
        materials: By name; empty where no color is asked for.
    """
    left_out: list[Facts] = []
    kept = [_without_unused_prototypes(one, left_out) for one in objects]
    if needs.color:
        ground = _without_hidden_layers(ground, left_out)
    used = {layer.material for layer in ground.parts[-1].layers}
    used = used.union(*(one.materials for one in kept))
    why = "nothing in the stage is made of it"
    left_out += [entry(PASS, f"materials/{name}", why) for name in materials if name not in used]
    return Used(
        {name: material for name, material in materials.items() if name in used},
        ground,
        tuple(kept),
        left_out,
    )


def _without_unused_prototypes(one: Scatter | Placed, left_out: list[Facts]) -> Scatter | Placed:
    used, prototype = np.unique(one.prototype, return_inverse=True)
    if len(used) == len(one.prototypes):
        return one
    kept = set(used.tolist())
    gone = [mesh for i, mesh in enumerate(one.prototypes) if i not in kept]
    why = "no object is one" if one.count else "there is no object of the class"
    left_out.append(
        entry(
            PASS,
            f"objects/{one.name}: {_counted(len(gone), 'model')} of {len(one.prototypes)}",
            why,
            size=sum(_bytes_of(mesh) for mesh in gone),
        )
    )
    return replace(
        one,
        prototypes=tuple(one.prototypes[i] for i in used.tolist()),
        prototype=prototype.astype(np.int32),
    )


def _bytes_of(mesh: Prototype | MeshTile) -> int:
    """Returns the bytes that are always written of a mesh: points, faces, and three a face."""
    return int(mesh.points.nbytes + mesh.faces.nbytes + _NUMBER * len(mesh.faces))


def _without_hidden_layers(ground: Ground, left_out: list[Facts]) -> Ground:
    """The ground without layers whose weight is 0 at every vertex.

    Those change no color, with or without heights, and lie on no face.
    """
    layers = ground.layers
    shown = [
        i == 0
        or any(tile.weights[i - 1].any() or (tile.layer == i).any() for tile in ground.meshes)
        for i in range(len(layers))
    ]
    if all(shown):
        return ground
    for i, layer in enumerate(layers):
        if not shown[i]:
            left_out.append(
                entry(
                    PASS,
                    f"terrain/ground/{i}: the layer of {layer.material}",
                    "it shows nowhere on the terrain",
                    size=sum(tile.weights[i - 1].nbytes for tile in ground.meshes),
                )
            )
    horizon = ground.horizon
    # A horizon's own layer is above all of them.
    number = np.cumsum([*shown, True], dtype=np.int32) - 1
    rows = np.flatnonzero(shown[1:])

    def renumbered(tile: MeshTile, count: int) -> MeshTile:
        weights = np.concatenate([tile.weights[rows], tile.weights[len(tile.weights) - count :]])
        return replace(tile, layer=number[tile.layer].astype(np.int32), weights=weights)

    return Ground(
        tuple(layer for layer, is_shown in zip(layers, shown, strict=True) if is_shown),
        tuple(renumbered(tile, 0) for tile in ground.tiles),
        None if horizon is None else replace(horizon, tile=renumbered(horizon.tile, 1)),
    )


def note_outputs(
    needs: Needs,
    materials: Collection[Material],
    ground: Ground,
    objects: Sequence[Scatter | Placed],
    *,
    levels: int,
    lit: bool,
) -> list[Facts]:
    """Entries about what no output shows, with the bytes of the arrays that it would take.

    Args:
        levels: How many kinds of labels there are.
        lit: Whether the cfg has any light.
    """
    meshes: list[MeshTile | Prototype] = [
        *ground.meshes,
        *(mesh for one in objects for mesh in one.prototypes),
    ]
    found = []
    if not needs.color:
        on_ground = sum(len(tile.points) for tile in ground.meshes)
        size = _SHADING * sum(len(mesh.points) for mesh in meshes)
        # Weights of merges, and the variation.
        size += _NUMBER * len(ground.layers) * on_ground
        found = [
            entry(PASS, "terrain, objects: shading normals, weights, colors", _NO_RGB, size=size),
            entry(
                PASS,
                f"materials: {_counted(len(materials), 'material')}",
                _NO_RGB,
                size=sum(_file_bytes(material) for material in materials),
            ),
        ]
        if lit:
            found.append(entry(PASS, "light: sun, sky, lamps, haze", _NO_RGB))
    if not needs.labels and levels:
        faces = sum(len(tile.faces) for tile in ground.meshes)
        found.append(
            entry(
                PASS,
                "labels: ids of faces and the cut along label lines",
                _NO_LABELS,
                size=_NUMBER * levels * faces,
            )
        )
    count = sum(one.count for one in objects)
    if not needs.ids and count:
        found.append(
            entry(PASS, f"objects: ids of {_counted(count, 'instance')}", _NO_IDS, size=8 * count)
        )
    return found


def _file_bytes(material: Material) -> int:
    files = material.maps.files.values() if material.maps is not None else ()
    return sum(file.stat().st_size if isinstance(file, Path) else len(file.data) for file in files)


def _counted(number: int, what: str) -> str:
    return f"{number:,} {what}" + ("" if number == 1 else "s")
