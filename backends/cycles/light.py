"""Suns and domes as Blender's sun lights and world."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenec.backends.cycles.graph import Graph
from scenec.backends.cycles.materials import picture_image
from scenec.backends.render_scene import Sun
from scenec.backends.sky import MIN_SUN_DIAMETER_RAD, Sky

#: A dome's picture is written out with at least so many rows: see ``env_rows``.
MIN_ROWS = 1024
#: Columns of the table that Cycles samples directions from, at least and at most.
SAMPLE_MAP = (256, 4096)
#: The dome's frame (USD: pole +Y, center +Z) to that of Blender's lat-long pictures (pole +Z,
#: center +X): x' = z, y' = x, z' = y.
_AXES = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])


def env_rows(picture: NDArray[np.float32]) -> NDArray[np.float32]:
    """The same function of direction with more rows, [k * h, w, 3] for an odd k.

    Cycles repeats a lat-long picture over the poles: in the outer half of the first row it blends
    in the last one, where ``sky.lookup`` holds the first. An odd number of rows for each carries
    the same piecewise linear function, and shrinks that half to under a tenth of a degree.
    """
    height = len(picture)
    times = 2 * ((MIN_ROWS // height + 1) // 2) + 1 if height < MIN_ROWS else 1
    at = np.clip((np.arange(times * height) + 0.5) / times - 0.5, 0.0, height - 1.0)
    low = np.floor(at).astype(int)
    part = (at - low)[:, None, None]
    high = np.minimum(low + 1, height - 1)
    return ((1.0 - part) * picture[low] + part * picture[high]).astype(np.float32)


def make_world(bpy: Any, sky: Sky | None) -> Any:
    """The world of a sky; black without one."""
    made = bpy.data.worlds.new("scenec_world")
    made.node_tree.nodes.clear()
    graph = Graph(made.node_tree)
    background = graph.node("ShaderNodeBackground")
    graph.feed(graph.node("ShaderNodeOutputWorld").inputs["Surface"], background.outputs[0])
    if sky is None or not np.any(sky.picture):
        graph.feed(background.inputs["Strength"], 0.0)
    elif sky.constant:
        red, green, blue = sky.picture[0, 0].tolist()
        graph.feed(background.inputs["Color"], (red, green, blue))
    else:
        image = picture_image(bpy, env_rows(sky.picture))
        node = graph.node("ShaderNodeTexEnvironment")
        node.image, node.interpolation = image, "Linear"
        direction = graph.node("ShaderNodeTexCoord").outputs["Generated"]
        to_picture = _AXES @ sky.to_world.T
        axes = [graph.vector("DOT_PRODUCT", direction, tuple(axis)) for axis in to_picture.tolist()]
        graph.feed(node.inputs["Vector"], graph.combine(axes[0], axes[1], axes[2]))
        graph.feed(background.inputs["Color"], node.outputs["Color"])
        made.cycles.sampling_method = "MANUAL"
        columns = 2 * sky.picture.shape[1]
        made.cycles.sample_map_resolution = int(np.clip(columns, *SAMPLE_MAP))
    return made


def make_sun(bpy: Any, sun: Sun) -> Any:
    """A sun as an object: its irradiance on a surface that faces it is ``sun.irradiance``."""
    light = bpy.data.lights.new("scenec_sun", "SUN")
    strength = float(np.max(sun.irradiance))
    light.normalize = True
    light.energy = strength
    light.color = (np.asarray(sun.irradiance) / strength).tolist()
    light.angle = max(sun.diameter_rad, MIN_SUN_DIAMETER_RAD)
    made = bpy.data.objects.new("scenec_sun", light)
    # Light travels along the lamp's -Z.
    z = np.asarray(sun.to_light, np.float64)
    x = np.cross([0.0, 1.0, 0.0] if abs(z[1]) < 0.9 else [1.0, 0.0, 0.0], z)
    x /= np.sqrt((x * x).sum())
    pose = np.eye(4)
    pose[:3, 0], pose[:3, 1], pose[:3, 2] = x, np.cross(z, x), z
    made.matrix_world = type(made.matrix_world)(pose.tolist())
    # Shared code draws the disc, once for all renderers.
    made.visible_camera = False
    return made
