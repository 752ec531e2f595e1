"""A picture of a scene by Blender alone, as its documentation would have one write it.

A Geometry Nodes instancer, mixed shaders, a sun, an environment texture, ``bpy.ops.render.render``.
"""

from __future__ import annotations

import tempfile
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from scenec.backends.contract import BOUNCES
from scenec.backends.stage.scene import Dome, Lighting, Mesh, RenderScene

#: Dome's frame (pole +Y) to world without a turn about the vertical: all that the script knows.
UPRIGHT = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])


def plain(scene: RenderScene) -> RenderScene:
    """Reduces a scene to what the bare script can draw."""
    surfaces = tuple(
        replace(
            surface, maps=None, metallic=0.0, roughness_variation=0.0, reflectance=None,
            emission=(0.0, 0.0, 0.0), diffuse_transmission=0.0,
        )
        for surface in scene.surfaces
    )  # fmt: skip
    lighting = tuple(
        Lighting(
            light.suns,
            tuple(Dome(d.texture, np.ones(3), UPRIGHT) for d in light.domes if d.texture)[:1],
        )
        for light in scene.lighting
    )
    meshes = tuple(replace(mesh, uv=None, height_blends=()) for mesh in scene.meshes)
    # What moves stays where it is at the first sample.
    rows = replace(scene.rows, motion=None)
    return replace(
        scene, surfaces=surfaces, lighting=lighting, meshes=meshes, rows=rows, haze=()
    )  # fmt: skip


class Bare:
    """Blender by hand on the same arrays."""

    def __init__(self, scene: RenderScene) -> None:
        import bpy

        bpy.ops.wm.read_factory_settings(use_empty=True)
        self.bpy, self.scene, self.target = bpy, scene, bpy.context.scene
        self.center = 0.5 * (scene.bounds[0] + scene.bounds[1])

    def load(self) -> None:
        """Build the scene."""
        bpy, target = self.bpy, self.target
        collection = bpy.data.collections.new("prototypes")
        materials: dict[tuple[int, ...], Any] = {}
        for index, mesh in enumerate(self.scene.meshes):
            made = self._mesh(f"{index:06d}", mesh)
            if mesh.layers not in materials:
                materials[mesh.layers] = self._material(mesh.layers)
            made.materials.append(materials[mesh.layers])
            collection.objects.link(bpy.data.objects.new(f"{index:06d}", made))
        target.collection.objects.link(self._instancer(collection))
        camera = bpy.data.objects.new("camera", bpy.data.cameras.new("camera"))
        target.collection.objects.link(camera)
        target.camera = camera
        render, cycles = target.render, target.cycles
        render.engine, render.use_persistent_data, render.film_transparent = "CYCLES", True, True
        for name in ("row", "face"):
            made = target.view_layers[0].aovs.add()
            made.name, made.type = name, "COLOR"
        render.image_settings.media_type = "MULTI_LAYER_IMAGE"
        render.image_settings.file_format = "OPEN_EXR_MULTILAYER"
        render.image_settings.color_depth, render.image_settings.exr_codec = "32", "NONE"
        cycles.use_adaptive_sampling = cycles.use_denoising = cycles.use_auto_tile = False
        cycles.pixel_filter_type = "BOX"
        cycles.diffuse_bounces = cycles.glossy_bounces = cycles.min_light_bounces = BOUNCES
        cycles.sample_clamp_indirect = cycles.blur_glossy = cycles.light_sampling_threshold = 0.0

    def _mesh(self, name: str, mesh: Mesh) -> Any:
        made = self.bpy.data.meshes.new(name)
        count = len(mesh.faces)
        made.vertices.add(len(mesh.points))
        made.loops.add(3 * count)
        made.polygons.add(count)
        made.vertices.foreach_set("co", mesh.points.ravel())
        made.loops.foreach_set("vertex_index", mesh.faces.ravel())
        made.polygons.foreach_set("loop_start", np.arange(0, 3 * count, 3, dtype=np.int32))
        columns = {"weight_" + str(i): w for i, w in enumerate(mesh.weights)}
        if mesh.variation is not None:
            columns["variation"] = mesh.variation
        for key, values in columns.items():
            made.attributes.new(key, "FLOAT", "POINT").data.foreach_set(
                "value", np.ascontiguousarray(values)
            )
        faces = made.attributes.new("face", "FLOAT", "FACE")
        faces.data.foreach_set("value", np.arange(count, dtype=np.float32))
        if mesh.normals is not None:
            normals = made.attributes.new("custom_normal", "FLOAT_VECTOR", "POINT")
            normals.data.foreach_set("vector", mesh.normals.ravel())
        made.update(calc_edges=True)
        return made

    def _instancer(self, collection: Any) -> Any:
        bpy, rows = self.bpy, self.scene.rows
        matrices = np.zeros((len(rows.mesh), 4, 4), np.float32)
        matrices[:, :3, :3] = rows.to_world[:, :, :3].transpose(0, 2, 1)
        matrices[:, 3, :3] = rows.to_world[:, :, 3] - self.center
        matrices[:, 3, 3] = 1.0
        points = bpy.data.meshes.new("rows")
        points.vertices.add(len(rows.mesh))
        for name, kind, field, values in (
            ("matrix", "FLOAT4X4", "value", matrices),
            ("mesh", "INT", "value", rows.mesh),
            ("row", "FLOAT", "value", np.arange(1, len(rows.mesh) + 1, dtype=np.float32)),
            ("row_variation", "FLOAT", "value", rows.variation),
        ):
            points.attributes.new(name, kind, "POINT").data.foreach_set(field, values.ravel())
        group = bpy.data.node_groups.new("rows", "GeometryNodeTree")
        for way in ("INPUT", "OUTPUT"):
            group.interface.new_socket("Geometry", in_out=way, socket_type="NodeSocketGeometry")
        new, link = group.nodes.new, group.links.new
        given, out = new("NodeGroupInput"), new("NodeGroupOutput")
        children, instances = new("GeometryNodeCollectionInfo"), new("GeometryNodeInstanceOnPoints")
        placed = new("GeometryNodeSetInstanceTransform")
        children.inputs[0].default_value = collection
        children.inputs[1].default_value = children.inputs[2].default_value = True
        instances.inputs["Pick Instance"].default_value = True
        which, matrix = (new("GeometryNodeInputNamedAttribute") for _ in range(2))
        which.data_type, which.inputs[0].default_value = "INT", "mesh"
        matrix.data_type, matrix.inputs[0].default_value = "FLOAT4X4", "matrix"
        link(given.outputs[0], instances.inputs["Points"])
        link(children.outputs[0], instances.inputs["Instance"])
        link(which.outputs[0], instances.inputs["Instance Index"])
        link(instances.outputs[0], placed.inputs["Instances"])
        link(matrix.outputs[0], placed.inputs["Transform"])
        link(placed.outputs[0], out.inputs[0])
        made = bpy.data.objects.new("rows", points)
        made.modifiers.new("rows", "NODES").node_group = group
        return made

    def _material(self, layers: tuple[int, ...]) -> Any:
        tree_of = self.bpy.data.materials.new("look")
        tree_of.cycles.use_bump_map_correction = False
        tree = tree_of.node_tree
        tree.nodes.clear()
        new, link = tree.nodes.new, tree.links.new

        def attribute(name: str, kind: str = "GEOMETRY") -> Any:
            node = new("ShaderNodeAttribute")
            node.attribute_name, node.attribute_type = name, kind
            return node.outputs["Fac"]

        def times_variation(name: str, kind: str, amount: float) -> Any:
            node = new("ShaderNodeMath")
            node.operation = "MULTIPLY_ADD"
            link(attribute(name, kind), node.inputs[0])
            node.inputs[1].default_value, node.inputs[2].default_value = amount, 1.0
            return node.outputs[0]

        below: Any = None
        for number, index in enumerate(layers):
            surface = self.scene.surfaces[index]
            factor, scale = new("ShaderNodeMath"), new("ShaderNodeVectorMath")
            factor.operation, scale.operation = "MULTIPLY", "SCALE"
            link(times_variation("variation", "GEOMETRY", surface.variation), factor.inputs[0])
            link(times_variation("row_variation", "INSTANCER", surface.variation), factor.inputs[1])
            scale.inputs[0].default_value = surface.base_color
            link(factor.outputs[0], scale.inputs["Scale"])
            diffuse, glossy, both = (
                new(f"ShaderNode{kind}") for kind in ("BsdfDiffuse", "BsdfGlossy", "MixShader")
            )
            glossy.distribution = "MULTI_GGX"
            glossy.inputs["Color"].default_value = (1.0, 1.0, 1.0, 1.0)
            glossy.inputs["Roughness"].default_value = surface.roughness
            link(scale.outputs[0], diffuse.inputs["Color"])
            both.inputs[0].default_value = surface.specular
            link(diffuse.outputs[0], both.inputs[1])
            link(glossy.outputs[0], both.inputs[2])
            if below is None:
                below = both.outputs[0]
            else:
                merged = new("ShaderNodeMixShader")
                link(attribute(f"weight_{number - 1}"), merged.inputs[0])
                link(below, merged.inputs[1])
                link(both.outputs[0], merged.inputs[2])
                below = merged.outputs[0]
        link(below, new("ShaderNodeOutputMaterial").inputs[0])
        for name, kind in (("row", "INSTANCER"), ("face", "GEOMETRY")):
            out = new("ShaderNodeOutputAOV")
            out.aov_name = name
            link(attribute(name, kind), out.inputs["Color"])
        return tree_of

    def _light(self, sample: int) -> None:
        bpy, lighting = self.bpy, self.scene.lighting[sample]
        for old in [o for o in self.target.collection.objects if o.type == "LIGHT"]:
            bpy.data.objects.remove(old)
        for sun in lighting.suns:
            light = bpy.data.lights.new("sun", "SUN")
            light.energy = float(sun.irradiance.max())
            light.color = (sun.irradiance / sun.irradiance.max()).tolist()
            light.angle = sun.diameter_rad
            made = bpy.data.objects.new("sun", light)
            x, y, z = sun.to_light
            made.rotation_euler = (np.arccos(z), 0.0, np.arctan2(y, x) + np.pi / 2)
            self.target.collection.objects.link(made)
        world = bpy.data.worlds.new("sky")
        nodes, link = world.node_tree.nodes, world.node_tree.links.new
        background = next(n for n in nodes if n.type == "BACKGROUND")
        for dome in lighting.domes:
            if dome.texture is not None:
                node = nodes.new("ShaderNodeTexEnvironment")
                node.image = bpy.data.images.load(str(dome.texture))
                node.texture_mapping.rotation[2] = np.pi / 2
                link(node.outputs[0], background.inputs[0])
        self.target.world = world

    def _render(self, sample: int) -> dict[str, Any]:
        import mathutils
        import OpenEXR

        camera, render = self.scene.cameras[sample][0], self.target.render
        data = self.target.camera.data
        render.resolution_x, render.resolution_y = camera.width, camera.height
        k = camera.intrinsics
        data.lens, data.sensor_width = k[0, 0], camera.width
        data.shift_x = 0.5 - k[0, 2] / camera.width
        data.shift_y = (k[1, 2] - 0.5 * camera.height) / camera.width
        data.clip_start, data.clip_end = 1e-3, 1e5
        pose = camera.camera_to_world.copy()
        pose[:3, 3] -= self.center
        pose[:3, 1:3] *= -1.0
        self.target.camera.matrix_world = mathutils.Matrix(pose.tolist())
        with tempfile.TemporaryDirectory(
            dir="/dev/shm" if Path("/dev/shm").is_dir() else None
        ) as t:
            render.filepath = f"{t}/picture.exr"
            self.bpy.ops.render.render(write_still=True)
            with OpenEXR.File(render.filepath) as source:
                return {
                    part.name(): np.array(part.channels[part.name()].pixels)
                    for part in source.parts
                }

    def witness(self, sample: int) -> None:
        """Row and face of each pixel."""
        self.target.cycles.samples, self.target.cycles.max_bounces = 1, 0
        self._render(sample)

    def radiance(self, sample: int, spp: int, seed: int) -> float:
        """One picture, its light made anew; its mean."""
        self._light(sample)
        self.target.cycles.samples, self.target.cycles.max_bounces = spp, BOUNCES
        self.target.cycles.seed = seed
        picture = next(p for n, p in self._render(sample).items() if n.endswith("Combined"))
        return float(picture[..., :3].mean())
