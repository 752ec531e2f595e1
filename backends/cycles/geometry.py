"""Rows of a RenderScene as one Geometry Nodes instancer over one Blender mesh for each mesh.

A row is a point with a 4x4 matrix (shear and mirrors included), the index of its mesh, its row
number and its albedo variation. Separate objects cost far more: 30,000 take Blender seconds a frame
to evaluate, the instancer next to nothing.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenec.backends.stage.posing import moving
from scenec.backends.stage.scene import Mesh, RenderScene
from scenec.backends.surface.maps import face_tangents
from scenec.schemas.errors import BackendError
from scenec.schemas.kernels import kernel
from scenec.schemas.threads import over_threads

#: Names of the attributes that shaders read.
ROW, FACE, VARIATION = "scenec_row", "scenec_face", "scenec_variation"
COLOR = "scenec_color"
#: Texture coordinates of the corners, and dP/du and dP/dv of the faces, of meshes that have them.
UV, ALONG_U, ALONG_V = "scenec_uv", "scenec_along_u", "scenec_along_v"
_MATRIX, _MESH = "scenec_matrix", "scenec_mesh"
#: Half the extent of a scene as Cycles sees it, to within a factor of two: its shortest clipping
#: distance, 1e-6, is then next to nothing in a scene of any size.
_EXTENT = 2.0**15

type LookKey = tuple[tuple[int, ...], tuple[float, ...], bool]


@dataclass(frozen=True)
class Frame:
    """Blender's frame of the scene: (world - center) * scale.

    Attributes:
        center: Middle of the geometry, float64 [3]: subtracted in float64, so that float32 keeps
            its digits for shape.
        scale: A power of two, so that nothing is rounded by it.
        corners: Bounds of the geometry in Blender's frame, float64 [2, 3].
    """

    center: NDArray[np.float64]
    scale: float
    corners: NDArray[np.float64]

    def place(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """World to Blender, float64 [..., 3]."""
        return (points - self.center) * self.scale


def look_key(mesh: Mesh) -> LookKey:
    """The key of a mesh's material: layers, depths of their merges, whether it has colors."""
    return mesh.layers, mesh.height_blends, mesh.color is not None


def weight_name(merge: int) -> str:
    """Vertex attribute of the weight of a merge, from 0."""
    return f"scenec_weight_{merge}"


def scene_frame(scene: RenderScene) -> Frame:
    """Returns Blender's origin and unit for a scene."""
    low, high = scene.bounds
    center = 0.5 * (low + high)
    radius = float(np.max(0.5 * (high - low)))
    scale = 2.0 ** -_exponent(radius / _EXTENT)
    return Frame(center, scale, np.stack([low - center, high - center]) * scale)


def _exponent(size: float) -> int:
    """Exponent of the power of two next to a size; 0 for none."""
    return round(np.log2(size)) if 0.0 < size < np.inf else 0


@dataclass(frozen=True)
class Rows:
    """Holds the objects that draw the rows.

    Attributes:
        objects: Instancers that are in no scene yet: of what stands, and of what moves if any does.
        moving: Rows of the latter's points, int64 [m].
        stretch: From a mesh's frame in Blender to Blender's world, for each of them, float64 [m].
    """

    objects: tuple[Any, ...]
    moving: NDArray[np.int64]
    stretch: NDArray[np.float64]


def build(bpy: Any, scene: RenderScene, frame: Frame, materials: dict[LookKey, Any]) -> Rows:
    """Make the meshes and the instancers.

    Args:
        bpy: Blender.
        scene: What to build.
        frame: From ``scene_frame``.
        materials: Blender's material for each ``look_key`` that occurs.

    Raises:
        BackendError: Faces that name points which are not there (Blender would crash over them).
    """
    prototypes = bpy.data.collections.new("scenec_prototypes")
    number = np.full(len(scene.meshes), -1, np.int32)
    local_scale = np.ones(len(scene.meshes))
    for index in np.unique(scene.rows.mesh).tolist():
        mesh = scene.meshes[index]
        if not len(mesh.faces):
            continue
        local_scale[index] = 2.0 ** -_exponent(float(np.abs(mesh.points).max()))
        # Children are numbered in the alphabetical order of their names.
        number[index] = len(prototypes.objects)
        name = f"scenec_{number[index]:08d}"
        data = _make_mesh(bpy, name, mesh, float(local_scale[index]))
        data.materials.append(materials[look_key(mesh)])
        prototypes.objects.link(_make_object(bpy, name, data))
    filled = number[scene.rows.mesh] >= 0
    moves = moving(scene)
    nodes = _make_nodes(bpy, prototypes)
    stretch = frame.scale / local_scale[scene.rows.mesh]
    objects = [
        _make_instancer(bpy, scene, frame, number, rows, stretch[rows], nodes)
        for rows in (np.flatnonzero(filled & ~moves), np.flatnonzero(filled & moves))
        if len(rows) or not moves.any()
    ]
    there = np.flatnonzero(filled & moves)
    return Rows(tuple(objects), there, stretch[there])


def _make_object(bpy: Any, name: str, data: Any) -> Any:
    made = bpy.data.objects.new(name, data)
    # Bends light near terminators where shading normals are smooth: no other renderer does.
    made.shadow_terminator_normal_offset = 0.0
    made.shadow_terminator_geometry_offset = 0.0
    made.shadow_terminator_shading_offset = 0.0
    return made


def _make_mesh(bpy: Any, name: str, mesh: Mesh, scale: float) -> Any:
    points, faces = len(mesh.points), len(mesh.faces)
    if mesh.faces.min() < 0 or mesh.faces.max() >= points:
        raise BackendError(f"cycles: {mesh.path}: faces reach beyond the {points} points")
    made = bpy.data.meshes.new(name)
    made.vertices.add(points)
    made.loops.add(3 * faces)
    made.polygons.add(faces)
    made.attributes["position"].data.foreach_set(
        "vector", (mesh.points * np.float32(scale)).ravel()
    )
    corners = np.array(mesh.faces, np.int32)
    if mesh.normals is not None:
        over_threads(_turn, faces, corners, mesh.points, mesh.normals)
    made.attributes[".corner_vert"].data.foreach_set("value", corners.ravel())
    made.polygons.foreach_set("loop_start", np.arange(0, 3 * faces, 3, dtype=np.int32))
    index = np.arange(faces, dtype=np.int64)
    _attribute(made, FACE, "FLOAT2", "FACE", "vector", halves(index))
    for merge, weights in enumerate(mesh.weights):
        _attribute(made, weight_name(merge), "FLOAT", "POINT", "value", weights)
    if mesh.variation is not None:
        _attribute(made, VARIATION, "FLOAT", "POINT", "value", mesh.variation)
    turned = (corners[:, 1] != mesh.faces[:, 1])[:, None, None]
    if mesh.color is not None:
        color = np.where(turned, mesh.color[:, [0, 2, 1]], mesh.color)
        _attribute(made, COLOR, "FLOAT_VECTOR", "CORNER", "vector", color)
    if mesh.uv is not None:
        uv = np.where(turned, mesh.uv[:, [0, 2, 1]], mesh.uv)
        _attribute(made, UV, "FLOAT2", "CORNER", "vector", uv)
        for name_of, along in zip((ALONG_U, ALONG_V), face_tangents(mesh), strict=True):
            _attribute(made, name_of, "FLOAT_VECTOR", "FACE", "vector", along)
    if mesh.normals is None:
        made.shade_flat()
    else:
        # On points they are free normals: kept as they are, in float32.
        _attribute(made, "custom_normal", "FLOAT_VECTOR", "POINT", "vector", mesh.normals)
    made.update(calc_edges=True)
    return made


@kernel
def _turn(first, last, faces, points, normals):  # type: ignore[no-untyped-def]
    """Wind faces as their shading normals point, in place; their order stays.

    Cycles turns normals to the viewer by the winding, and chooses lights by the result.
    """
    for f in range(first, last):
        a, b, c = faces[f, 0], faces[f, 1], faces[f, 2]
        along = 0.0
        for i in range(3):
            j, k = (i + 1) % 3, (i + 2) % 3
            normal = float(points[b, j] - points[a, j]) * float(
                points[c, k] - points[a, k]
            ) - float(points[b, k] - points[a, k]) * float(points[c, j] - points[a, j])
            along += normal * (float(normals[a, i]) + float(normals[b, i]) + float(normals[c, i]))
        if along < 0.0:
            faces[f, 1], faces[f, 2] = c, b


def halves(numbers: NDArray[np.int64]) -> NDArray[np.float32]:
    """Whole numbers as two of 16 bits, which float32 holds exactly, [n, 2]: low, high."""
    return np.stack([numbers & 0xFFFF, numbers >> 16], axis=-1).astype(np.float32)


def _attribute(
    mesh: Any, name: str, kind: str, domain: str, field: str, values: NDArray[Any]
) -> None:
    made = mesh.attributes.new(name, kind, domain)
    made.data.foreach_set(field, np.ascontiguousarray(values).ravel())


def _make_instancer(
    bpy: Any,
    scene: RenderScene,
    frame: Frame,
    number: NDArray[np.int32],
    rows: NDArray[np.int64],
    stretch: NDArray[np.float64],
    nodes: Any,
) -> Any:
    mesh_of = scene.rows.mesh[rows]
    matrices = _matrices(scene, frame, rows, stretch)
    points = bpy.data.meshes.new("scenec_rows")
    points.vertices.add(len(rows))
    # From 1: what no ray hits is 0.
    about = np.concatenate([halves(rows + 1), scene.rows.variation[rows, None]], axis=1)
    _attribute(points, _MATRIX, "FLOAT4X4", "POINT", "value", matrices)
    _attribute(points, _MESH, "INT", "POINT", "value", number[mesh_of])
    _attribute(points, ROW, "FLOAT_VECTOR", "POINT", "vector", about.astype(np.float32))
    made = bpy.data.objects.new("scenec_rows", points)
    made.modifiers.new("scenec_rows", "NODES").node_group = nodes
    return made


def pose(scene: RenderScene, frame: Frame, rows: Rows) -> None:
    """Put what moves where the scene's rows now are.

    Args:
        scene: The scene, posed as at a sample.
        frame: From ``scene_frame``.
        rows: What ``build`` made of it.
    """
    points = rows.objects[-1].data
    matrices = _matrices(scene, frame, rows.moving, rows.stretch)
    points.attributes[_MATRIX].data.foreach_set("value", matrices.ravel())
    points.update()


def _matrices(
    scene: RenderScene, frame: Frame, rows: NDArray[np.int64], stretch: NDArray[np.float64]
) -> NDArray[np.float32]:
    """Matrices of rows as Blender has them, float32 [n, 4, 4]."""
    to_world = scene.rows.to_world[rows]
    matrices = np.zeros((len(rows), 4, 4), np.float32)
    # Column by column, as Blender keeps them.
    matrices[:, :3, :3] = (to_world[:, :, :3] * stretch[:, None, None]).transpose(0, 2, 1)
    matrices[:, 3, :3] = frame.place(to_world[:, :, 3])
    matrices[:, 3, 3] = 1.0
    return matrices


def _make_nodes(bpy: Any, prototypes: Any) -> Any:
    """Instances on points, each with the matrix of its point."""
    group = bpy.data.node_groups.new("scenec_rows", "GeometryNodeTree")
    for way in ("INPUT", "OUTPUT"):
        group.interface.new_socket("Geometry", in_out=way, socket_type="NodeSocketGeometry")
    new, link = group.nodes.new, group.links.new
    given, out = new("NodeGroupInput"), new("NodeGroupOutput")
    children = new("GeometryNodeCollectionInfo")
    children.inputs["Collection"].default_value = prototypes
    children.inputs["Separate Children"].default_value = True
    children.inputs["Reset Children"].default_value = True
    mesh, matrix = (new("GeometryNodeInputNamedAttribute") for _ in range(2))
    mesh.data_type, mesh.inputs["Name"].default_value = "INT", _MESH
    matrix.data_type, matrix.inputs["Name"].default_value = "FLOAT4X4", _MATRIX
    instances = new("GeometryNodeInstanceOnPoints")
    instances.inputs["Pick Instance"].default_value = True
    placed = new("GeometryNodeSetInstanceTransform")
    link(given.outputs[0], instances.inputs["Points"])
    link(children.outputs["Instances"], instances.inputs["Instance"])
    link(mesh.outputs["Attribute"], instances.inputs["Instance Index"])
    link(instances.outputs["Instances"], placed.inputs["Instances"])
    link(matrix.outputs["Attribute"], placed.inputs["Transform"])
    link(placed.outputs["Instances"], out.inputs[0])
    return group
