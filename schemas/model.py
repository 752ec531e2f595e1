"""A batch as other people's viewers take it: meshes, where they stand, plain looks, cameras, suns.

Backends make it of a stage; datasets write it into pages and files. World frame: the stage's, in
meters, z up, with the origin moved to ``Model.origin`` so that float32 holds positions.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from scenec.schemas.georeference import Georeference


@dataclass(frozen=True, eq=False)
class Mask:
    """Says where a look has holes: where opacity, bilinear, is below a threshold nothing is there.

    Attributes:
        opacity: Of texels, 255 for 1, uint8 [h, w], row 0 at the top.
        threshold: In (0, 1].
        wrap: How texels go on beyond the picture's sides, along u and v (``stage.WRAPS``).
    """

    opacity: NDArray[np.uint8]
    threshold: float
    wrap: tuple[str, str]


@dataclass(frozen=True, eq=False)
class Look:
    """A material without merges and variation.

    Attributes:
        name: Unique in the model.
        base_color: Linear Rec.709; multiplies the picture.
        roughness: Perceptual, in [0, 1].
        metallic: In [0, 1].
        emission: Radiance given off, linear Rec.709.
        diffuse_transmission: Share of the dull part's light that leaves on the far side.
        picture: Of colors, in sRGB: a file, or pixels uint8 [h, w, 3] with row 0 at the top; None
            where ``base_color`` is all.
        mask: By the same texture coordinates, or None where all of it is there.
    """

    name: str
    base_color: tuple[float, float, float]
    roughness: float
    metallic: float = 0.0
    emission: tuple[float, float, float] = (0.0, 0.0, 0.0)
    picture: Path | NDArray[np.uint8] | None = None
    diffuse_transmission: float = 0.0
    mask: Mask | None = None


@dataclass(frozen=True, eq=False)
class Part:
    """Triangles of one look.

    Attributes:
        path: Prim path in the stage; "" where several were joined.
        points: Float32 [n, 3].
        faces: Vertex indices, int32 [m, 3].
        normals: Shading normals at the vertices, float32 [n, 3], or None (flat).
        colors: Linear Rec.709 at the vertices, float32 [n, 3], or None: in a coarse model in place
            of the look's, in a whole one a factor of it.
        uv: Texture coordinates at the corners, v up, float32 [m, 3, 2], or None.
        labels: Per level, the label id of each triangle, uint32 [m].
        look: Index into ``Model.looks``.
    """

    path: str
    points: NDArray[np.float32]
    faces: NDArray[np.int32]
    normals: NDArray[np.float32] | None
    colors: NDArray[np.float32] | None
    uv: NDArray[np.float32] | None
    labels: dict[str, NDArray[np.uint32]]
    look: int


@dataclass(frozen=True, eq=False)
class Placement:
    """Places some parts together.

    Attributes:
        owner: Prim path of the class or object; "" for the ground.
        parts: Indices into ``Model.parts``.
        to_world: Affine matrices relative to the model's origin, float64 [k, 3, 4].
        ids: Frame ids, uint32 [k]; 0 is "no instance".
        variation: Of the instances' albedo, float32 [k].
    """

    owner: str
    parts: tuple[int, ...]
    to_world: NDArray[np.float64]
    ids: NDArray[np.uint32]
    variation: NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class View:
    """A camera over all samples.

    Attributes:
        name: ``<rig>_<sensor>``.
        width, height: Pixels.
        intrinsics: K of the first sample, float64 [3, 3], as in sidecars.
        poses: Camera to world, relative to the model's origin, x right, y down, z forward, float64
            [samples, 4, 4].
    """

    name: str
    width: int
    height: int
    intrinsics: NDArray[np.float64]
    poses: NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Model:
    """All of a batch that its viewers know of.

    Attributes:
        name: Of the batch.
        origin: What was taken off world positions, meters, float64 [3].
        parts, looks, placements: Of the scene.
        views: All cameras.
        suns: Per sample: unit vectors to the suns and their irradiances [(3), (3)].
        times: Of the samples, seconds, float64 [samples].
        label_names: Per level, id -> name.
        losses: A line for each thing in the stage that is not here.
        georeference: Where on a body the world's origin lies, or None.
    """

    name: str
    origin: NDArray[np.float64]
    parts: tuple[Part, ...]
    looks: tuple[Look, ...]
    placements: tuple[Placement, ...]
    views: tuple[View, ...]
    suns: tuple[tuple[tuple[NDArray[np.float64], NDArray[np.float64]], ...], ...]
    times: NDArray[np.float64]
    label_names: dict[str, dict[int, str]]
    losses: tuple[str, ...]
    georeference: Georeference | None = None

    @property
    def triangles(self) -> int:
        """Counts the triangles drawn, with those of each instance."""
        faces = [len(part.faces) for part in self.parts]
        return sum(len(p.ids) * sum(faces[i] for i in p.parts) for p in self.placements)

    @property
    def instances(self) -> int:
        """Counts instances of objects; of those without ids each part counts."""
        ids = [p.ids for p in self.placements if p.owner]
        found = np.concatenate(ids) if ids else np.zeros(0, np.uint32)
        return len(np.unique(found[found > 0])) + int((found == 0).sum())
