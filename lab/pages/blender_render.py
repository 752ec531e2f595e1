"""Renders a stage with Blender's importer and Cycles: a picture, coverage and depth.

Runs in a process of its own, where usd-core is never loaded: ``blender_render.py JOB.json``. The
job holds ``shots``: (stage, camera, time code, width, height, EXR to write).
"""

import json
import sys
from pathlib import Path

import bpy


def render(stage, camera, time, width, height, file):
    """Writes one picture: color and alpha, and depth along the axis, sampled at pixel centers."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.ops.wm.usd_import(filepath=stage, import_subdivision=True)
    scene = bpy.context.scene
    scene.camera = bpy.data.objects[camera]
    scene.camera.data.clip_start, scene.camera.data.clip_end = 0.001, 1e6
    scene.frame_set(time)
    # It reads suns four times too bright (docs/viewers.md).
    for light in bpy.data.lights:
        light.energy *= 0.25 if light.type == "SUN" else 1.0
    if scene.world is None:
        scene.world = bpy.data.worlds.new("world")
        scene.world.use_nodes = True
        scene.world.node_tree.nodes["Background"].inputs[0].default_value = (1, 1, 1, 1)
        scene.world.node_tree.nodes["Background"].inputs[1].default_value = 0.5
    scene.render.engine = "CYCLES"
    scene.cycles.samples, scene.cycles.use_denoising = 16, False
    scene.cycles.pixel_filter_type, scene.cycles.filter_width = "BOX", 0.01
    scene.render.film_transparent = True
    scene.render.resolution_x, scene.render.resolution_y = width, height
    scene.render.resolution_percentage = 100
    scene.view_layers[0].use_pass_z = True
    image = scene.render.image_settings
    if hasattr(image, "media_type"):
        image.media_type = "MULTI_LAYER_IMAGE"
    image.file_format, image.color_depth = "OPEN_EXR_MULTILAYER", "32"
    scene.render.filepath = file
    bpy.ops.render.render(write_still=True)


def main():
    """Renders all shots."""
    for shot in json.loads(Path(sys.argv[1]).read_text(encoding="utf-8"))["shots"]:
        render(*shot)


if __name__ == "__main__":
    main()
