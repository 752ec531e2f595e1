"""Meshes from files, for terrain: of what a model file has, points and faces."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.assets.joining import chosen_parts, join, require_keys, unit_and_up
from scenec.compiler.assets.parse import faults_of, parse_model
from scenec.compiler.assets.shells import ParsedModel


@dataclass(frozen=True)
class MeshFile:
    """A mesh from a file: meters, Z up, right-handed.

    Vertices of exactly equal position are one, in the order in which they come first: formats that
    split them along seams of texture or shading leave a connected surface. Faces without area are
    dropped, as are vertices that no face uses.

    Attributes:
        points: float64 [n, 3].
        faces: int32 [m, 3], counter-clockwise seen from outside; polygons are fans.
        part_of_face: Index into ``parts``, int32 [m].
        parts: Names of the file's meshes, with those above them.
        degenerate: Faces dropped.
        welded: Vertices that were copies.
    """

    points: NDArray[np.float64]
    faces: NDArray[np.int32]
    part_of_face: NDArray[np.int32]
    parts: tuple[str, ...]
    degenerate: int
    welded: int


def read_mesh(
    file: Path, *, unit_m: float | None = None, up: str | None = None, part: str | None = None
) -> MeshFile:
    """Reads OBJ, PLY, STL, OFF, glTF or USD.

    Args:
        file: ``.obj``, ``.ply``, ``.stl``, ``.off``, ``.glb``, ``.gltf``, ``.usd``, ``.usda``,
            ``.usdc``, ``.usdz``. PLY, STL and OFF need the extra ``meshes``.
        unit_m: Meters per unit; None takes what the file says.
        up: Upward axis: x, y, z, -x, -y or -z; None takes what the file says.
        part: One of its meshes, or a name above some of them; None takes all.

    Raises:
        SceneError: The file cannot be read or is no mesh; it has no such part; or neither the
            arguments nor the file say the unit or the axis.
    """
    parsed = parse_model(file, looks=False)
    require_keys(file, parsed, unit_m, up)
    return finish_mesh(file, parsed, unit_m=unit_m, up=up, part=part)


def finish_mesh(
    file: Path,
    parsed: ParsedModel,
    *,
    unit_m: float | None = None,
    up: str | None = None,
    part: str | None = None,
) -> MeshFile:
    """What ``read_mesh`` makes of a parsed file; where nobody says them, 1 m and z.

    Raises:
        SceneError: It is no sound mesh, or has no such part.
    """
    with faults_of(file):
        chosen = chosen_parts(parsed.parts, part)
        joined = join(chosen, *unit_and_up(parsed, unit_m, up))
    return MeshFile(
        joined.points,
        joined.faces,
        joined.owner,
        tuple(part.path for part in chosen),
        int((~joined.sound).sum()),
        joined.welded,
    )
