"""Runs Blender in a process: ``python -m scenec.compiler.assets.blend_worker FILE OUT``.

Reads a ``.blend`` file with all scripts off, and leaves in OUT, an ``.npz``, what is seen of it:
evaluated meshes and the numbers and pictures of their materials. What is wrong with the file goes
as one line into OUT with the ending ``.fault``. ``blend`` is the other side.
"""

from __future__ import annotations

import contextlib
import json
import os
import sys
from pathlib import Path
from typing import Any

import numpy as np

from scenec.schemas.system_libraries import OF_BLENDER, mend, missing

#: Types of objects that have a surface.
_SURFACES = ("MESH", "CURVE", "SURFACE", "FONT", "META")
_KINDS = {"base_color": "Base Color", "roughness": "Roughness", "metallic": "Metallic"}
#: As in ``looks``, which this process has no use for.
_OPACITY = "opacity is not shown: it is drawn, and labeled, as if it were solid"
_NO_VERTEX_COLORS = "the colors of its vertices are left out"
_CHANNELS = {"Red": 0, "Green": 1, "Blue": 2}


def main(file: Path, out: Path) -> None:
    """Read one file."""
    try:
        import bpy  # noqa: TID251  The one place: a process of its own, never to render.
    except ImportError as error:
        absent = missing(OF_BLENDER)
        why = mend(absent) if absent else f"Blender cannot be imported ({error})"
        out.with_suffix(".fault").write_text(f"it takes Blender to read: {why}", encoding="utf-8")
        return
    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.context.preferences.filepaths.use_scripts_auto_execute = False
    try:
        bpy.ops.wm.open_mainfile(filepath=str(file), load_ui=False, use_scripts=False)
    except RuntimeError as error:
        reason = " ".join(str(error).removeprefix("Error: ").replace(str(file), "").split())
        fault = f"Blender cannot read it: {reason[:160]}"
    else:
        reader = _BlendReader(bpy)
        fault = reader.fault()
        if not fault:
            reader.read()
            document = np.array(json.dumps(reader.document))
            arrays: dict[str, Any] = {"document": document, **reader.arrays}
            np.savez(out, **arrays)
    if fault:
        out.with_suffix(".fault").write_text(fault, encoding="utf-8")


class _BlendReader:
    """Reads the open file into a document and arrays.

    Attributes:
        document: Shells, looks, unit and notes.
        arrays: What the document refers to by name.
    """

    def __init__(self, bpy: Any):
        self._bpy = bpy
        self._looks: dict[str, int] = {}
        self._pictures: dict[str, str] = {}
        self.arrays: dict[str, np.ndarray] = {}
        self.document: dict[str, Any] = {"shells": [], "looks": [], "notes": []}

    def fault(self) -> str:
        libraries = sorted(library.filepath for library in self._bpy.data.libraries)
        if libraries:
            name = libraries[0].replace("\\", "/").rpartition("/")[2]
            return f"links another file ({name}): make everything local and pack it"
        return ""

    def read(self) -> None:
        scene = self._bpy.context.scene
        self.document["unit_m"] = scene.unit_settings.scale_length
        graph = self._bpy.context.evaluated_depsgraph_get()
        found = []
        for instance in graph.object_instances:
            shown = instance.object
            if shown.type not in _SURFACES or not instance.show_self or shown.hide_render:
                continue
            path = _path(shown)
            if instance.is_instance and instance.parent is not None:
                path = _path(instance.parent) + path
            key = (path, tuple(instance.persistent_id) if instance.is_instance else ())
            mesh = shown.to_mesh()
            if mesh is not None:
                found.append((key, self._shell(path, shown, mesh, instance.matrix_world)))
                shown.to_mesh_clear()
        # The order of its evaluation is Blender's own affair.
        self.document["shells"] = [shell for _, shell in sorted(found, key=lambda item: item[0])]

    def _store(self, values: np.ndarray) -> str:
        name = f"a{len(self.arrays)}"
        self.arrays[name] = values
        return name

    def _shell(self, path: str, item: Any, mesh: Any, matrix: Any) -> dict[str, Any]:
        mesh.calc_loop_triangles()
        triangles = len(mesh.loop_triangles)
        points = _flat(mesh.vertices, "co", 3, np.float32)
        faces = _flat(mesh.loop_triangles, "vertices", 3, np.int32)
        loops = _flat(mesh.loop_triangles, "loops", 3, np.int32)
        slot = _flat(mesh.loop_triangles, "material_index", 1, np.int32).ravel()
        slots = [s.material for s in item.material_slots] or list(mesh.materials)
        numbers = np.array([*(self._look(m) for m in slots), -1], np.int64)
        normals = _flat(mesh.corner_normals, "vector", 3, np.float32)
        layers = sorted(mesh.uv_layers, key=lambda layer: not layer.active_render)
        uv = {
            layer.name: self._store(_flat(layer.uv, "vector", 2, np.float32)[loops])
            for layer in layers
        }
        return {
            "path": path,
            "matrix": [list(map(float, row)) for row in matrix],
            "points": self._store(points),
            "faces": self._store(faces),
            "normals": self._store(normals[loops].reshape(triangles, 3, 3)),
            "material": self._store(numbers[np.minimum(slot, len(numbers) - 1)]),
            "uv": uv,
        }

    def _look(self, material: Any) -> int:
        if material is None:
            return -1
        if material.name not in self._looks:
            self._looks[material.name] = len(self.document["looks"])
            self.document["looks"].append(_LookReader(self, material).values)
        return self._looks[material.name]

    def picture(self, image: Any) -> dict[str, str] | str:
        """Returns where a picture is stored, or why it is left out."""
        if image is None:
            return "has no picture"
        if image.source != "FILE":
            return f"is {image.source.lower()}, not a file"
        if image.packed_file is None:
            return {"file": image.filepath, "label": image.name}
        if image.name not in self._pictures:
            data = np.frombuffer(bytes(image.packed_file.data), np.uint8)
            self._pictures[image.name] = self._store(data)
        return {"packed": self._pictures[image.name], "label": image.name}


def _flat(items: Any, key: str, width: int, kind: type) -> np.ndarray:
    values: np.ndarray = np.empty(len(items) * width, kind)
    items.foreach_get(key, values)
    return values.reshape(-1, width)


def _path(item: Any) -> str:
    names = []
    while item is not None:
        names.append(item.name)
        item = item.parent
    return "".join(f"/{name}" for name in reversed(names))


class _LookReader:
    """A material: its Principled BSDF, or what else can be had.

    Attributes:
        values: For ``looks.Look``, as JSON.
    """

    def __init__(self, reader: _BlendReader, material: Any):
        self._reader = reader
        self._notes: list[str] = []
        self._slots: dict[str, Any] = {}
        self.values: dict[str, Any] = {
            "name": material.name,
            "base_color": list(material.diffuse_color)[:3],
            "roughness": material.roughness,
            "metallic": material.metallic,
            "specular_level": 0.5,
            "ior": 1.5,
            "slots": self._slots,
            "notes": self._notes,
        }
        shader = _surface(material)
        kind = shader.bl_idname if shader is not None else "nothing"
        if kind in ("ShaderNodeBsdfPrincipled", "ShaderNodeBsdfDiffuse"):
            self._read(shader, kind == "ShaderNodeBsdfPrincipled")
        else:
            self._notes.append(f"its shader ({kind}) is not known: its viewport color is shown")

    def _read(self, shader: Any, principled: bool) -> None:
        if principled:
            for kind, name in _KINDS.items():
                value = shader.inputs[name].default_value
                self.values[kind] = list(value)[:3] if kind == "base_color" else value
                self._slot(kind, shader.inputs[name])
            self.values["ior"] = shader.inputs["IOR"].default_value
            self.values["specular_level"] = shader.inputs["Specular IOR Level"].default_value
            for name, plain, what in (
                ("Alpha", 1.0, _OPACITY),
                ("Transmission Weight", 0.0, _OPACITY),
                ("Emission Strength", 0.0, "emission is left out"),
                ("Coat Weight", 0.0, "coat is left out"),
                ("Sheen Weight", 0.0, "sheen is left out"),
                ("Subsurface Weight", 0.0, "scattering below the surface is left out"),
            ):
                source = shader.inputs.get(name)
                if source is not None and (source.is_linked or source.default_value != plain):
                    self._notes.append(f"its {what}")
        else:
            self.values.update(
                base_color=list(shader.inputs["Color"].default_value)[:3],
                roughness=1.0,
                metallic=0.0,
                specular_level=0.0,
            )
            self._slot("base_color", shader.inputs["Color"])
        normal = _behind(shader.inputs["Normal"])
        if normal is not None and normal[0].bl_idname == "ShaderNodeNormalMap":
            node = normal[0]
            if node.space == "TANGENT":
                self._slot("normal", node.inputs["Color"])
                if node.inputs["Strength"].default_value != 1.0:
                    self._notes.append("the strength of its map of normals is taken as 1")
            else:
                self._notes.append("its map of normals is left out: it is not one of tangents")
        elif normal is not None:
            self._notes.append(f"its bumps ({normal[0].bl_label}) are left out")

    def _slot(self, kind: str, source: Any) -> None:
        found = _behind(source)
        if found is None:
            return
        node, socket = found
        channel = 0
        if node.bl_idname == "ShaderNodeSeparateColor" and node.mode == "RGB":
            channel = _CHANNELS.get(socket, 0)
            found = _behind(node.inputs["Color"])
            node, socket = found or (node, socket)
        if node.bl_idname == "ShaderNodeRGB" and kind == "base_color":
            self.values[kind] = list(node.outputs[0].default_value)[:3]
            return
        if node.bl_idname != "ShaderNodeTexImage" or socket == "Alpha":
            of_vertices = node.bl_idname in ("ShaderNodeVertexColor", "ShaderNodeAttribute")
            if kind == "base_color" and of_vertices:
                self._notes.append(_NO_VERTEX_COLORS)
            else:
                self._notes.append(f"what gives its {kind} ({node.bl_label}) is not known")
            return
        picture = self._reader.picture(node.image)
        if isinstance(picture, str):
            self._notes.append(f"its {kind} picture {picture}: it is left out")
            return
        space = node.image.colorspace_settings.name
        if (space == "sRGB") != (kind == "base_color") and space in ("sRGB", "Non-Color"):
            taken = "sRGB" if kind == "base_color" else "raw"
            self._notes.append(f"its {kind} picture is taken as {taken}, not as {space}")
        slot = {**picture, "channel": channel, "uv_set": "", "location": [0, 0], "angle": 0.0,
                "scale": [1, 1], "repeats": node.extension == "REPEAT"}  # fmt: skip
        if kind == "base_color":
            self.values[kind] = [1.0, 1.0, 1.0]
        self._coordinates(kind, _behind(node.inputs["Vector"]), slot)
        self._slots[kind] = slot

    def _coordinates(self, kind: str, origin: Any, slot: dict[str, Any]) -> None:
        if origin is not None and origin[0].bl_idname == "ShaderNodeMapping":
            node = origin[0]
            turn = list(node.inputs["Rotation"].default_value)
            linked = any(node.inputs[n].is_linked for n in ("Location", "Rotation", "Scale"))
            if node.vector_type == "POINT" and turn[:2] == [0.0, 0.0] and not linked:
                slot["location"] = list(node.inputs["Location"].default_value)[:2]
                slot["scale"] = list(node.inputs["Scale"].default_value)[:2]
                slot["angle"] = turn[2]
            else:
                self._notes.append(f"what is done to the coordinates of its {kind} is left out")
            origin = _behind(node.inputs["Vector"])
        if origin is None:
            return
        node, socket = origin
        if node.bl_idname == "ShaderNodeUVMap":
            slot["uv_set"] = node.uv_map
        elif node.bl_idname != "ShaderNodeTexCoord" or socket != "UV":
            self._notes.append(f"its {kind} picture lies on what is no UV map: the first is taken")


def _surface(material: Any) -> Any:
    tree = material.node_tree
    output = tree.get_output_node("CYCLES") if tree is not None else None
    found = _behind(output.inputs["Surface"]) if output is not None else None
    return found[0] if found is not None else None


def _behind(source: Any) -> tuple[Any, str] | None:
    """The node that feeds an input, and the name of its output; None without one."""
    for _ in range(100):
        if not source.is_linked:
            return None
        link = source.links[0]
        if link.from_node.bl_idname != "NodeReroute":
            return link.from_node, link.from_socket.name
        source = link.from_node.inputs[0]
    return None


if __name__ == "__main__":
    # Out of memory, the kernel should end this process, and not its parent.
    with contextlib.suppress(OSError):
        Path("/proc/self/oom_score_adj").write_text("500", encoding="ascii")
    main(Path(sys.argv[1]), Path(sys.argv[2]))
    sys.stdout.flush()
    # Blender takes its time to tear down, and may crash at it.
    os._exit(0)
