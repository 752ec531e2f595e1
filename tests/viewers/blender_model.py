"""Imports a .glb or .usdz into Blender; says what is there as JSON: ``blender_model.py FILE``."""

import json
import sys

import bpy


def corners(thing):
    """World corners of an object's box."""
    return [list(thing.matrix_world @ type(thing.location)(c)) for c in thing.bound_box]


bpy.ops.wm.read_factory_settings(use_empty=True)
if sys.argv[1].endswith(".glb"):
    bpy.ops.import_scene.gltf(filepath=sys.argv[1])
else:
    bpy.ops.wm.usd_import(filepath=sys.argv[1])
bpy.context.view_layer.update()
graph = bpy.context.evaluated_depsgraph_get()
ground = [o for o in bpy.data.objects if o.type == "MESH" and "tile_" in o.name]
told = {
    "meshes": sum(o.type == "MESH" for o in bpy.data.objects),
    "instances": sum(one.is_instance for one in graph.object_instances),
    "ground": len(ground),
    "corners": [corner for thing in ground for corner in corners(thing)],
    "pictured": sorted(
        material.name
        for material in bpy.data.materials
        if material.node_tree and any(n.type == "TEX_IMAGE" for n in material.node_tree.nodes)
    ),
    "cameras": sum(o.type == "CAMERA" for o in bpy.data.objects),
    "suns": [o.data.energy for o in bpy.data.objects if o.type == "LIGHT"],
}
print("\nTOLD" + json.dumps(told))
