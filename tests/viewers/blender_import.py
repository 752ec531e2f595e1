"""Imports a stage into Blender with its own importer and writes down what is there.

Runs in a process of its own: ``blender_import.py STAGE OUT.npz NAME:WIDTHxHEIGHT ...``.
"""

import sys

import bpy
import numpy as np
from mathutils import Vector


def instances(depsgraph):
    """Matrices, ids and prototypes of all instances."""
    found = [
        (np.array(i.matrix_world), i.persistent_id[1], i.object.name)
        for i in depsgraph.object_instances
        if i.is_instance
    ]
    matrices, ids, names = zip(*found, strict=True)
    return {"matrices": np.array(matrices), "ids": np.array(ids), "prototypes": np.array(names)}


def seen(scene, depsgraph, camera, width, height):
    """0 (nothing), 1 (ground) or 2 (rock) through each pixel's center of Blender's camera."""
    scene.render.resolution_x, scene.render.resolution_y = width, height
    pose = np.array(camera.matrix_world, float)
    corners = [np.array(v, float) for v in camera.data.view_frame(scene=scene)]
    right_top, _, left_bottom, left_top = corners
    classes = np.zeros((height, width), int)
    for v in range(height):
        for u in range(width):
            across = (u + 0.5) / width * (right_top - left_top)
            down = (v + 0.5) / height * (left_bottom - left_top)
            direction = pose[:3, :3] @ (left_top + across + down)
            hit, *_, thing, _ = scene.ray_cast(depsgraph, Vector(pose[:3, 3]), Vector(direction))
            if hit:
                classes[v, u] = 2 if thing.name.startswith("rock") else 1
    return classes


def main():
    """Imports, and writes the file."""
    stage, out, *cameras = sys.argv[1:]
    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.ops.wm.usd_import(filepath=stage)
    scene = bpy.context.scene
    record = instances(bpy.context.evaluated_depsgraph_get())
    record["frames"] = np.array([scene.frame_start, scene.frame_end])
    for sample in range(scene.frame_start, scene.frame_end + 1):
        scene.frame_set(sample)
        depsgraph = bpy.context.evaluated_depsgraph_get()
        for word in cameras:
            name, size = word.split(":")
            width, height = map(int, size.split("x"))
            camera, key = bpy.data.objects[name], f"{name}_{sample}"
            lens = camera.data
            record[f"{key}_pose"] = np.array(camera.matrix_world)
            record[f"{key}_lens"] = np.array(
                [lens.lens, lens.sensor_width, lens.shift_x, lens.shift_y]
            )
            record[f"{key}_classes"] = seen(scene, depsgraph, camera, width, height)
    for material in bpy.data.materials:
        surface = next(n for n in material.node_tree.nodes if n.type == "BSDF_PRINCIPLED")
        link = surface.inputs["Base Color"].links[0].from_node
        record[f"material_{material.name}"] = np.array(
            [link.attribute_name, surface.inputs["Roughness"].default_value,
             surface.inputs["Metallic"].default_value]
        )  # fmt: skip
    np.savez(out, **record)


main()
