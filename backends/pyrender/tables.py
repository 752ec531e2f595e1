"""Builds the shading program's tables: meshes, layers, surfaces and maps as flat arrays."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scenec.backends.pyrender.geometry import DrawnMesh, Geometry
from scenec.backends.pyrender.laws import law_features, law_table, laws_of
from scenec.backends.pyrender.tiles import (
    add_blocks,
    place_blocks,
    third_picture,
    tile_features,
)
from scenec.backends.stage.scene import DEFAULT_SURFACE, Maps, Mesh, RenderScene, Surface
from scenec.backends.surface.maps import map_file, map_values
from scenec.schemas.maps import MAP_CHANNELS

#: Maps are brought to one size, at most this, in texels.
LARGEST_MAP = 4096
_HAS_NORMALS = 1
#: Projections by the numbers that the program knows them by, and what it is to know of them.
_PROJECTIONS = {"above": 0.0, "triplanar": 1.0, "uv": 2.0}
_FEATURES = {"above": "WITH_ABOVE", "triplanar": "WITH_TRIPLANAR", "uv": "WITH_UV"}


@dataclass(frozen=True)
class Tables:
    """Arrays as they go to the GPU.

    Attributes:
        faces: Vertex indices of the drawn meshes, one mesh after the other, uint32 [f, 3].
        vertices: x, y, z and variation, float32 [v, 4].
        normals: float32 [v, 3]; zero where a mesh has none.
        weights: Of the vertices, mesh by mesh and merge by merge; with "WITH_HEIGHTS" then depths
            of the mesh's merges, float32 [w].
        meshes: Per drawn mesh (first vertex, first face, first weight, 1 if it has normals + 2 *
            the first row of its colors in ``uvs``, if it has any), then (first layer,
            number of layers, number of vertices, first face in ``uvs`` or 0), uint32 [2 m, 4].
        layers: Indices of surfaces, uint32 [l].
        surfaces: Per surface (base color, specular), (roughness, variation, metallic,
            roughness_variation), (first layer of its maps or -1, projection, 1 / size of the maps,
            its block or 0), (what to add to positions / size, number of its law in ``laws`` from 1,
            or 0); then ``tiles.add_blocks``, float32 [4 s + ..., 4].
        all_surfaces: Whose rows these are.
        laws: ``laws.law_table``.
        sizes: Of the maps of each surface, meters, float64 [s]; 0 without maps that have one.
        uvs: Texture coordinates of faces' corners, two rows each, of the meshes that have them;
            first a face of those that have none; then colors of corners, three rows each,
            float32 [2 u + 3 c, 3].
        maps: Two layers a surface that has any: base color and roughness, then normal and metallic;
            a third one, emission and height, where there is a map of these; row 0 at the bottom,
            float16 [k, h, w, 4].
        features: What the shading program has to know: "WITH_MAPS" and their projections,
            "WITH_GLOSS", and "WITH_MIXED" where layers of a mesh differ in more than color.
    """

    faces: NDArray[np.uint32]
    vertices: NDArray[np.float32]
    normals: NDArray[np.float32]
    weights: NDArray[np.float32]
    meshes: NDArray[np.uint32]
    layers: NDArray[np.uint32]
    surfaces: NDArray[np.float32]
    all_surfaces: tuple[Surface, ...]
    laws: NDArray[np.float32]
    sizes: NDArray[np.float64]
    uvs: NDArray[np.float32]
    maps: NDArray[np.float16]
    features: tuple[str, ...]


def make_tables(scene: RenderScene, geometry: Geometry) -> Tables:
    """Tables of a scene.

    Raises:
        StageError: A map cannot be read.
    """
    surfaces = (*scene.surfaces, DEFAULT_SURFACE)
    features = _features(scene)
    meshes = np.zeros((2 * len(geometry.meshes), 4), np.uint32)
    vertices, normals, weights = [], [], []
    layers: list[int] = []
    first_vertex = first_weight = first_layer = 0
    uvs = [np.zeros((2, 3), np.float32)]
    first_uv = 1
    colors: list[NDArray[np.float32]] = []
    colored: list[int] = []
    for index, drawn in enumerate(geometry.meshes):
        mesh = scene.meshes[drawn.mesh]
        n = len(mesh.points)
        own_layers = mesh.layers or (len(scene.surfaces),)
        vertex = np.zeros((n, 4), np.float32)
        vertex[:, :3] = mesh.points
        if mesh.variation is not None:
            vertex[:, 3] = mesh.variation
        smooth = mesh.normals is not None
        own_weights = mesh.weights[: len(own_layers) - 1].ravel()
        if "WITH_HEIGHTS" in features:
            depths = mesh.height_blends or (0.0,) * (len(own_layers) - 1)
            own_weights = np.concatenate([own_weights, np.array(depths, np.float32)])
        meshes[2 * index] = (
            first_vertex,
            geometry.first_face[index],
            first_weight,
            _HAS_NORMALS * smooth,
        )
        meshes[2 * index + 1] = (
            first_layer,
            len(own_layers),
            n,
            first_uv if mesh.uv is not None else 0,
        )
        if mesh.uv is not None:
            uvs.append(_corner_values(mesh, mesh.uv, drawn).reshape(-1, 3))
            first_uv += len(drawn.faces)
        if mesh.color is not None:
            colors.append(_corner_values(mesh, mesh.color, drawn).reshape(-1, 3))
            colored.append(index)
        vertices.append(vertex)
        normals.append(mesh.normals if smooth else np.zeros((n, 3), np.float32))
        weights.append(own_weights)
        layers.extend(own_layers)
        first_vertex += n
        first_weight += len(own_weights)
        first_layer += len(own_layers)
    first_color = 2 * first_uv
    for index, own in zip(colored, colors, strict=True):
        meshes[2 * index, 3] |= first_color << 1
        first_color += len(own)
    rows, sizes, maps = _surface_rows(surfaces)
    return Tables(
        faces=np.concatenate([np.zeros((0, 3), np.uint32), *(m.faces for m in geometry.meshes)]),
        vertices=np.concatenate([np.zeros((0, 4), np.float32), *vertices]),
        normals=np.concatenate([np.zeros((0, 3), np.float32), *normals]).astype(np.float32),
        weights=np.concatenate([np.zeros(1, np.float32)[:0], *weights]).astype(np.float32),
        meshes=meshes,
        layers=np.array(layers, np.uint32),
        surfaces=add_blocks(surfaces, rows),
        all_surfaces=surfaces,
        laws=law_table(surfaces),
        sizes=sizes,
        uvs=np.concatenate([*uvs, *colors]),
        maps=maps,
        features=features,
    )


def _corner_values(
    mesh: Mesh, values: NDArray[np.float32], drawn: DrawnMesh
) -> NDArray[np.float32]:
    """Spreads values of corners, [m, 3, k], to a mesh's faces as they are drawn.

    Coarser faces take for each vertex what one of its faces has there: across a seam of the
    coordinates they are wrong, by no more than faces of a few pixels show.
    """
    own = drawn.order >= 0
    found = np.empty((len(drawn.faces), *values.shape[1:]), np.float32)
    found[own] = values[drawn.order[own]]
    if not own.all():
        of_vertex = np.zeros((len(mesh.points), values.shape[2]), np.float32)
        of_vertex[mesh.faces.ravel()] = values.reshape(-1, values.shape[2])
        found[~own] = of_vertex[drawn.faces[~own]]
    return found


def place_maps(tables: Tables, origin: NDArray[np.float64]) -> NDArray[np.float32]:
    """``Tables.surfaces`` for positions relative to an origin.

    The whole repeats between the stage's origin and this one leave no trace.
    """
    surfaces = tables.surfaces.copy()
    mapped = np.flatnonzero(tables.sizes)
    surfaces[4 * mapped + 3, :3] = np.mod(origin / tables.sizes[mapped, None], 1.0)
    place_blocks(tables.all_surfaces, surfaces, origin)
    return surfaces


def _features(scene: RenderScene) -> tuple[str, ...]:
    """Lists features of the surfaces in use, so that programs do not compute what none has."""
    features = law_features(scene) | tile_features(scene)
    for mesh in scene.meshes:
        if mesh.color is not None:
            features.add("WITH_COLORS")
        surfaces = [scene.surfaces[i] for i in mesh.layers]
        mapped = [s.maps for s in surfaces if s.maps and any(_files(s.maps))]
        for maps in mapped:
            features |= {"WITH_MAPS", _FEATURES[maps.projection]}
        glossy = any(s.glossy for s in surfaces)
        if glossy:
            features.add("WITH_GLOSS")
        differ = glossy and len({(s.roughness, s.roughness_variation) for s in surfaces}) > 1
        if differ or any(m.normal or m.roughness or m.metallic for m in mapped):
            features.add("WITH_MIXED")
    return tuple(sorted(features))


def _surface_rows(
    surfaces: Sequence[Surface],
) -> tuple[NDArray[np.float32], NDArray[np.float64], NDArray[np.float16]]:
    rows = np.zeros((len(surfaces), 4, 4), np.float32)
    sizes = np.zeros(len(surfaces))
    pictures: list[NDArray[np.float32]] = []
    laws = laws_of(surfaces)
    for row, surface in zip(rows, surfaces, strict=True):
        row[0] = (*surface.base_color, surface.specular)
        row[1] = (
            surface.roughness,
            surface.variation,
            surface.metallic,
            surface.roughness_variation,
        )
        row[2] = (-1.0, 0.0, 0.0, 0.0)
        row[3, 3] = 0.0 if surface.reflectance is None else 1 + laws.index(surface.reflectance)
        if surface.maps is not None and any(_files(surface.maps)):
            projection = _PROJECTIONS[surface.maps.projection]
            row[2] = (len(pictures), projection, 1.0 / surface.maps.size_m, 0.0)
            pictures.extend(_pictures(surface, surface.maps))
    for index, surface in enumerate(surfaces):
        maps = surface.maps
        if rows[index, 2, 0] >= 0.0 and maps is not None and maps.projection != "uv":
            sizes[index] = maps.size_m
    height = min(max([1, *(p.shape[0] for p in pictures)]), LARGEST_MAP)
    width = min(max([1, *(p.shape[1] for p in pictures)]), LARGEST_MAP)
    stack = np.zeros((max(len(pictures), 1), height, width, 4), np.float16)
    for layer, picture in zip(stack, pictures, strict=False):
        layer[:] = resample(picture, height, width)[::-1]
    return rows.reshape(-1, 4), sizes, stack


def _files(maps: Maps) -> tuple[object, ...]:
    return tuple(map_file(maps, kind) for kind in MAP_CHANNELS if kind != "opacity")


def _pictures(surface: Surface, maps: Maps) -> list[NDArray[np.float32]]:
    """The layers of a surface; what has no map of its own is constant."""
    color = _load(maps, "base_color", [1.0, 1.0, 1.0])
    rough = _load(maps, "roughness", [surface.roughness])
    normal = _load(maps, "normal", [0.0, 0.0, 1.0])
    metal = _load(maps, "metallic", [surface.metallic])
    third = third_picture(surface, maps)
    more = [] if third is None else [_joined(*third)]
    return [_joined(color, rough), _joined(normal, metal), *more]


def _load(maps: Maps, kind: str, constant: list[float]) -> NDArray[np.float32]:
    if map_file(maps, kind) is None:
        return np.array(constant, np.float32).reshape(1, 1, -1)
    return map_values(maps, kind)


def _joined(first: NDArray[np.float32], second: NDArray[np.float32]) -> NDArray[np.float32]:
    height, width = (max(first.shape[axis], second.shape[axis]) for axis in (0, 1))
    return np.concatenate([resample(first, height, width), resample(second, height, width)], axis=2)


def resample(picture: NDArray[np.float32], height: int, width: int) -> NDArray[np.float32]:
    """A repeating picture at another size: means of texels when smaller, bilinear when larger."""
    for axis, size in ((0, height), (1, width)):
        picture = _resample_axis(picture, axis, size)
    return picture


def _resample_axis(picture: NDArray[np.float32], axis: int, size: int) -> NDArray[np.float32]:
    old = picture.shape[axis]
    if old == size:
        return picture
    if size < old:
        # The integral over each new texel, from running sums.
        sums = np.cumsum(picture, axis=axis, dtype=np.float64)
        sums = np.concatenate([np.zeros_like(np.take(sums, [0], axis)), sums], axis=axis)
        edges = np.linspace(0.0, old, size + 1)
        low = np.minimum(edges.astype(int), old - 1)
        shape = [1] * picture.ndim
        shape[axis] = -1
        part = (edges - low).reshape(shape)
        at = np.take(sums, low, axis) * (1.0 - part) + np.take(sums, low + 1, axis) * part
        return (np.diff(at, axis=axis) * (size / old)).astype(np.float32)
    place = (np.arange(size) + 0.5) * (old / size) - 0.5
    low = np.floor(place).astype(int)
    shape = [1] * picture.ndim
    shape[axis] = -1
    part = (place - low).astype(np.float32).reshape(shape)
    return (
        np.take(picture, low % old, axis) * (1 - part)
        + np.take(picture, (low + 1) % old, axis) * part
    )
