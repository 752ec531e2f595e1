"""Run apart: renders Blender's sky textures into lat-long pictures, the sun in their middle.

python blender_sky.py OUT.npz HEIGHT '[["SINGLE_SCATTERING", elevation, altitude, air, ...], ...]'
"""

from __future__ import annotations

import json
import sys
from math import pi, radians
from typing import Any

import numpy as np

from scenec.backends.cycles.blender import load_bpy, passing_file, quiet
from scenec.schemas.exr import read_rgb


def render(bpy: Any, height: int, case: list[Any]) -> np.ndarray:
    """float32 [height, 2 * height, 3]."""
    scene = bpy.context.scene
    scene.world = bpy.data.worlds.new("world")
    tree = scene.world.node_tree
    tree.nodes.clear()
    sky, background, out = (
        tree.nodes.new(f"ShaderNode{name}") for name in ("TexSky", "Background", "OutputWorld")
    )
    sky.sky_type, elevation, sky.altitude = case[:3]
    sky.air_density, sky.aerosol_density, sky.ozone_density = case[3:]
    sky.sun_elevation, sky.sun_rotation, sky.sun_disc = radians(elevation), 0.0, False
    tree.links.new(sky.outputs[0], background.inputs[0])
    tree.links.new(background.outputs[0], out.inputs[0])
    camera = bpy.data.objects.new("camera", bpy.data.cameras.new("camera"))
    camera.data.type, camera.data.panorama_type = "PANO", "EQUIRECTANGULAR"
    # It looks north, where a sun without rotation stands.
    camera.rotation_euler = (pi / 2, 0.0, 0.0)
    scene.collection.objects.link(camera)
    scene.camera = camera
    view, cycles = scene.render, scene.cycles
    view.engine = "CYCLES"
    view.resolution_x, view.resolution_y, view.resolution_percentage = 2 * height, height, 100
    view.image_settings.file_format = "OPEN_EXR"
    view.image_settings.color_mode, view.image_settings.color_depth = "RGB", "32"
    cycles.samples, cycles.use_adaptive_sampling, cycles.use_denoising = 1, False, False
    cycles.pixel_filter_type, cycles.filter_width = "BLACKMAN_HARRIS", 0.01
    scene.world.cycles.sampling_method = "NONE"
    with passing_file() as file:
        view.filepath = str(file)
        view.use_file_extension = False
        with quiet():
            bpy.ops.render.render(write_still=True)
        return read_rgb(file)


if __name__ == "__main__":
    blender = load_bpy()
    pictures = [render(blender, int(sys.argv[2]), case) for case in json.loads(sys.argv[3])]
    np.savez(sys.argv[1], *pictures)
