"""Suns, lamps and domes as Blender's lights and world."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenec.backends.cycles.geometry import Frame
from scenec.backends.cycles.graph import NODES, Graph
from scenec.backends.cycles.materials import picture_image
from scenec.backends.picture.guide import sky_guide
from scenec.backends.picture.sky import MIN_SUN_DIAMETER_RAD, Sky
from scenec.backends.stage.scene import Lamp, Sun
from scenec.backends.surface import lamps
from scenec.backends.surface.gobo import load_gobo

#: A dome's picture is written out with at least so many rows: see ``env_rows``.
MIN_ROWS = 1024
#: Columns of the table that Cycles samples directions from, at least and at most.
SAMPLE_MAP = (256, 4096)
#: Of a sky that differs from its mean by less than this share of the suns' light no directions are
#: drawn. A vertex of a path sends one ray to a light, so each to the sky is one less to the suns:
#: a clear sky at 0.18 is half again as noisy with them, one at 0.27 as noisy (measured).
LEAST_DRAWN = 0.25
#: Half angle of the widest of Blender's spots, and how much wider than our cone they are, radians.
_WIDEST_SPOT, _SPOT_MARGIN = 0.5 * np.pi - 0.01, 2e-3
#: How far off the disc's rim rays are still taken for its own: what float32 directions resolve.
_GOBO_MARGIN = 1e-5
_CORNERS = ((-1, -1), (1, -1), (1, 1), (-1, 1))
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


def make_world(bpy: Any, sky: Sky | None, from_suns: float) -> Any:
    """The world of a sky; black without one.

    Args:
        bpy: Blender.
        sky: The sky.
        from_suns: Irradiance that an average surface has of suns beside it, W/m^2.
    """
    made = bpy.data.worlds.new("scenec_world")
    made.node_tree.nodes.clear()
    graph = Graph(made.node_tree)
    background = graph.node("ShaderNodeBackground")
    light = background.outputs[0]
    made.cycles.sampling_method = "NONE"
    if sky is None or not np.any(sky.picture):
        graph.feed(background.inputs["Strength"], 0.0)
    elif sky.constant:
        graph.feed(background.inputs["Color"], sky.picture[0, 0])
    else:
        graph.feed(background.inputs["Color"], _radiance_along(bpy, graph, sky))
        guide = sky_guide(sky, LEAST_DRAWN * from_suns)
        if guide is not None:
            light = _guided(bpy, graph, light, guide)
            made.cycles.sampling_method = "MANUAL"
            columns = 2 * sky.picture.shape[1]
            made.cycles.sample_map_resolution = int(np.clip(columns, *SAMPLE_MAP))
    graph.feed(graph.node("ShaderNodeOutputWorld").inputs["Surface"], light)
    return made


def _radiance_along(bpy: Any, graph: Graph, sky: Sky) -> Any:
    """A sky's radiance from the direction that is looked at."""
    node = graph.node("ShaderNodeTexEnvironment")
    node.image, node.interpolation = picture_image(bpy, env_rows(sky.picture)), "Linear"
    direction = graph.triple(graph.shared("ShaderNodeTexCoord").outputs["Generated"])
    axes = [NODES.dot(direction, axis) for axis in _AXES @ sky.to_world.T]
    graph.feed(node.inputs["Vector"], NODES.vector(*axes))
    return node.outputs["Color"]


def _guided(bpy: Any, graph: Graph, light: Any, guide: Sky) -> Any:
    """A sky that shows its guide where Cycles tabulates what directions are drawn from.

    Rays that meet the sky, and those sent to it, are one deep at least; the table is made at 0.
    """
    shown = graph.node("ShaderNodeBackground")
    graph.feed(shown.inputs["Color"], _radiance_along(bpy, graph, guide))
    depth = graph.number(graph.node("ShaderNodeLightPath").outputs["Ray Depth"])
    either = graph.node("ShaderNodeMixShader")
    graph.feed(either.inputs[0], NODES.select(0.5 - depth, 1.0, 0.0))
    graph.feed(either.inputs[1], light)
    graph.feed(either.inputs[2], shown.outputs[0])
    return either.outputs[0]


def make_sun(bpy: Any, sun: Sun) -> Any:
    """A sun as an object: its irradiance on a surface that faces it is ``sun.irradiance``."""
    light = bpy.data.lights.new("scenec_sun", "SUN")
    strength = float(np.max(sun.irradiance))
    light.normalize = True
    light.energy = strength
    light.color = (np.asarray(sun.irradiance) / strength).tolist()
    light.angle = max(sun.diameter_rad, MIN_SUN_DIAMETER_RAD)
    # Only rays that are sent to a sun meet its gobo, so none may find it by chance.
    light.cycles.use_multiple_importance_sampling = sun.gobo is None
    return _shining(bpy, "scenec_sun", light, -np.asarray(sun.to_light, np.float64), np.zeros(3))


def make_gobo(bpy: Any, sun: Sun, frame: Frame) -> Any:
    """A sun's gobo as an object: a plane before all geometry, there for shadow rays alone.

    Blender's lights do not know which place they shine on. The plane lets through what the picture
    has of rays toward the sun's disc, and all of others, to the sky and to other suns.
    """
    assert sun.gobo is not None
    material = bpy.data.materials.new("scenec_gobo")
    material.node_tree.nodes.clear()
    graph = Graph(material.node_tree)
    image = picture_image(bpy, load_gobo(sun.gobo.file)[..., None])
    # Where the ray comes from, not where it meets the plane: that is off by the disc's width.
    length = graph.number(graph.node("ShaderNodeLightPath").outputs["Ray Length"])
    at = graph.geometry("Position") + graph.geometry("Incoming") * length
    rows = sun.gobo.to_picture
    u, v = (
        NODES.dot(at, row[:3] / frame.scale) + float(row[:3] @ frame.center + row[3])
        for row in rows
    )
    # Blender's row 0 is the bottom one.
    share = graph.picture(image, u, 1.0 - v, "MIRROR")
    to_light = np.asarray(sun.to_light, np.float64)
    half = 0.5 * max(sun.diameter_rad, MIN_SUN_DIAMETER_RAD)
    aside = NODES.length(graph.geometry("Incoming") + to_light)
    reach = float(2.0 * np.sin(0.5 * half)) + _GOBO_MARGIN
    within = NODES.select(reach - aside, 1.0, 0.0)
    transparent = graph.node("ShaderNodeBsdfTransparent")
    graph.feed(transparent.inputs["Color"], NODES.mix(np.ones(3), share, within))
    output = graph.node("ShaderNodeOutputMaterial").inputs["Surface"]
    graph.feed(output, transparent.outputs[0])
    radius = 1.1 * float(np.sqrt((frame.corners * frame.corners).sum(axis=1).max())) or 1.0
    x = np.cross(to_light, np.eye(3)[np.argmin(np.abs(to_light))])
    x /= np.sqrt((x * x).sum())
    # Wide enough for rays to the disc's rim.
    across = radius * (1.0 + 3.0 * np.tan(half)) * np.stack([x, np.cross(to_light, x)])
    corners = radius * to_light + [across[0] * i + across[1] * j for i, j in _CORNERS]
    plane = bpy.data.meshes.new("scenec_gobo")
    plane.from_pydata(corners.tolist(), [], [(0, 1, 2, 3)])
    plane.materials.append(material)
    made = bpy.data.objects.new("scenec_gobo", plane)
    made.visible_camera = made.visible_diffuse = made.visible_glossy = False
    made.visible_transmission = made.visible_volume_scatter = False
    return made


def make_lamp(bpy: Any, lamp: Lamp, frame: Frame) -> Any:
    """A lamp as an object: a spot light without Blender's own falloff, and ours in its shader.

    Blender's spots end at a cosine over a cone; the law of ``Lamp`` is in the angle, and its cone
    may open beyond a hemisphere, where it is a point light. An energy of P watts is an intensity of
    P / (4 pi) for both (measured), whatever the radius.
    """
    narrow = lamp.cone <= _WIDEST_SPOT
    light = bpy.data.lights.new("scenec_lamp", "SPOT" if narrow else "POINT")
    strength = float(np.max(lamp.intensity))
    light.normalize = True
    light.energy = 4.0 * np.pi * strength * frame.scale**2
    light.color = (np.asarray(lamp.intensity) / strength).tolist()
    light.shadow_soft_size = lamp.radius_m * frame.scale
    light.use_soft_falloff = False
    if narrow:
        # A little wider than the cone, whose border is the shader's: it tells where to sample.
        light.spot_size = min(2.0 * lamp.cone + _SPOT_MARGIN, np.pi)
        light.spot_blend = 0.0
    if lamp.cone < np.pi or lamp.softness > 0.0:
        light.node_tree.nodes.clear()
        graph = Graph(light.node_tree)
        emission = graph.node("ShaderNodeEmission")
        away = graph.geometry("Incoming")
        share = lamps.falloff(NODES, away, np.asarray(lamp.axis, np.float64), lamps.cone(lamp))
        graph.feed(emission.inputs["Strength"], share)
        graph.feed(graph.node("ShaderNodeOutputLight").inputs["Surface"], emission.outputs[0])
    return _shining(bpy, "scenec_lamp", light, lamp.axis, frame.place(lamp.position))


def _shining(
    bpy: Any, name: str, light: Any, along: NDArray[np.float64], at: NDArray[np.float64]
) -> Any:
    """An object of a light that shines along a unit vector; cameras do not see it."""
    made = bpy.data.objects.new(name, light)
    # Light travels along the lamp's -Z.
    z = -np.asarray(along, np.float64)
    x = np.cross([0.0, 1.0, 0.0] if abs(z[1]) < 0.9 else [1.0, 0.0, 0.0], z)
    x /= np.sqrt((x * x).sum())
    pose = np.eye(4)
    pose[:3, 0], pose[:3, 1], pose[:3, 2], pose[:3, 3] = x, np.cross(z, x), z, at
    made.matrix_world = type(made.matrix_world)(pose.tolist())
    # Shared code draws suns' discs, once for all renderers; lamps are not seen at all.
    made.visible_camera = False
    return made
