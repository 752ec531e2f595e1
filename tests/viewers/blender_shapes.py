"""Imports a stage into Blender and writes points: ``blender_shapes.py STAGE OUT.npz``."""

import sys

import bpy
import numpy as np

bpy.ops.wm.read_factory_settings(use_empty=True)
bpy.ops.wm.usd_import(filepath=sys.argv[1])
np.savez(
    sys.argv[2],
    **{
        thing.name: np.array([thing.matrix_world @ v.co for v in thing.data.vertices])
        for thing in bpy.data.objects
        if thing.type == "MESH"
    },
)
