"""The shared surface model as shader nodes: Lambert and GGX closures, alpha = roughness**2."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from functools import lru_cache, partial
from typing import Any

import numpy as np

from scenec.backends.cycles.geometry import (
    FACE,
    ROW,
    VARIATION,
    Frame,
    LookKey,
    look_key,
)
from scenec.backends.cycles.graph import BLACK, Graph, Scalar, Vector
from scenec.backends.cycles.heights import merge_weights
from scenec.backends.cycles.planetary import KnownLight, Laws
from scenec.backends.cycles.projection import Pictures
from scenec.backends.stage.scene import DEFAULT_SURFACE, RenderScene, Surface
from scenec.backends.surface import cells
from scenec.backends.surface.maps import load_map, map_key

#: Passes that carry row + 1 and face, each as two halves of 16 bits.
ROW_PASS, FACE_PASS = "scenec_row", "scenec_face"
#: GGX in float32 loses its digits below this; roughness under 0.032 is drawn as 0.032.
MIN_ALPHA = 1e-3

_SMOOTHEST = MIN_ALPHA**0.5


@dataclass
class Lobe:
    """All closures of a mixture that share roughness and normal: their colors mix as they do.

    Attributes:
        roughness: Perceptual; None for Lambertian ones.
        normal: Socket of a mapped normal, or None.
        color: Of them all.
        lit: Where they follow other laws than Lambert's: their color for the known light;
        known: and where that holds, see ``planetary``.
    """

    roughness: Scalar | None
    normal: Any
    color: Vector
    lit: Vector | None = None
    known: Any = None


@dataclass(frozen=True)
class Reach:
    """What occurs on the meshes of a material.

    Attributes:
        vertex, row: The largest variation, absolute; 0 where there is none.
        smooth: Whether there are shading normals.
    """

    vertex: float = 0.0
    row: float = 0.0
    smooth: bool = False


def make_materials(
    bpy: Any, scene: RenderScene, frame: Frame, light: KnownLight | None = None
) -> dict[LookKey, Any]:
    """Blender's material for each ``look_key`` of the meshes that rows show.

    Args:
        bpy: Blender.
        scene: The scene.
        frame: Of Blender's coordinates, for maps, which are projected in the world.
        light: The light that shaders know, in scenes with other laws than Lambert's.

    Raises:
        StageError: A map that cannot be read.
    """
    made = {}
    image = lru_cache(maxsize=None)(partial(make_image, bpy))
    table = lru_cache(maxsize=None)(lambda seed: picture_image(bpy, cells.table(seed)[::-1]))
    for key, reach in _reaches(scene).items():
        layers, depths = key
        material = bpy.data.materials.new("scenec_look")
        material.node_tree.nodes.clear()
        # It would bend shading normals at grazing angles, which no other renderer does.
        material.cycles.use_bump_map_correction = False
        surfaces = tuple(scene.surfaces[i] for i in layers) or (DEFAULT_SURFACE,)
        graph = Graph(material.node_tree)
        pictures = Pictures(graph, frame, image, table)
        laws = None if light is None else Laws(graph, light, partial(picture_image, bpy))
        _Look(graph, pictures, reach, laws).write(surfaces, depths)
        made[key] = material
    return made


def _reaches(scene: RenderScene) -> dict[LookKey, Reach]:
    """How far colors vary, for each ``look_key`` that occurs."""
    of_rows = np.zeros(len(scene.meshes))
    np.maximum.at(of_rows, scene.rows.mesh, np.abs(scene.rows.variation))
    reaches: dict[LookKey, Reach] = {}
    for index in np.unique(scene.rows.mesh).tolist():
        mesh = scene.meshes[index]
        if len(mesh.faces):
            known = reaches.get(look_key(mesh), Reach())
            own = 0.0 if mesh.variation is None else float(np.abs(mesh.variation).max())
            reaches[look_key(mesh)] = Reach(
                max(known.vertex, own),
                max(known.row, float(of_rows[index])),
                known.smooth or mesh.normals is not None,
            )
    return reaches


class _Look:
    """One material in the making."""

    def __init__(
        self, graph: Graph, pictures: Pictures, reach: Reach, laws: Laws | None = None
    ) -> None:
        self._graph, self._reach = graph, reach
        self._pictures, self._laws = pictures, laws

    def write(self, surfaces: tuple[Surface, ...], depths: tuple[float, ...]) -> None:
        """The merge of the layers, base first, and the passes for visibility.

        The model is linear in its lobes: those of one roughness and normal are one closure with a
        mixed color, so that n layers without maps take two closures instead of 3 n.
        """
        graph = self._graph
        merged: dict[tuple[object, ...], Lobe] = {}
        glow: Vector = BLACK
        weights = merge_weights(graph, self._pictures, surfaces, depths)
        for number, surface in enumerate(surfaces):
            own = self._lobes(surface)
            for key, lobe in own.items():
                merged.setdefault(key, dataclasses.replace(lobe, color=BLACK, lit=BLACK))
            for key, lobe in merged.items():
                color = own[key].color if key in own else BLACK
                lit = own[key].lit if key in own else BLACK
                if number == 0:
                    lobe.color, lobe.lit = color, lit
                else:
                    lobe.color = graph.mixed(lobe.color, color, weights[number - 1])
                    if lobe.known is not None:
                        lobe.lit = graph.mixed(lobe.lit, lit, weights[number - 1])
            own_glow = self._glow(surface)
            glow = own_glow if number == 0 else graph.mixed(glow, own_glow, weights[number - 1])
        self._close(list(merged.values()), glow)
        for name, attribute, kind in ((ROW_PASS, ROW, "INSTANCER"), (FACE_PASS, FACE, "GEOMETRY")):
            out = graph.node("ShaderNodeOutputAOV")
            out.aov_name = name
            graph.feed(out.inputs["Color"], graph.attribute(attribute, kind).outputs["Vector"])

    def _glow(self, surface: Surface) -> Vector:
        """What a surface gives off."""
        maps = surface.maps
        if not surface.emits:
            return BLACK
        if maps is None or maps.emission is None:
            return surface.emission
        picture = self._pictures.value(maps, "emission")
        return self._graph.vector("MULTIPLY", picture, surface.emission)

    def _close(self, lobes: list[Lobe], glow: Vector) -> None:
        """Closures, added up; one at least, or rays would pass through."""
        graph = self._graph
        total: Any = None
        lit = [
            lobe for lobe in lobes if not (isinstance(lobe.color, tuple) and lobe.color == BLACK)
        ]
        for lobe in lit or lobes[:1]:
            closure = self._closure(lobe, lobe.color)
            if lobe.known is not None:
                either = graph.node("ShaderNodeMixShader")
                graph.feed(either.inputs[0], lobe.known)
                graph.feed(either.inputs[1], closure)
                graph.feed(either.inputs[2], self._closure(lobe, lobe.lit))
                closure = either.outputs[0]
            total = self._added(total, closure)
        if not (isinstance(glow, tuple) and glow == BLACK):
            emission = graph.node("ShaderNodeEmission")
            graph.feed(emission.inputs["Color"], glow)
            if self._laws is not None:
                graph.feed(emission.inputs["Strength"], self._laws.glow())
            total = self._added(total, emission.outputs[0])
        graph.feed(graph.node("ShaderNodeOutputMaterial").inputs["Surface"], total)

    def _closure(self, lobe: Lobe, color: Vector) -> Any:
        graph = self._graph
        diffuse = lobe.roughness is None
        closure = graph.node("ShaderNodeBsdfDiffuse" if diffuse else "ShaderNodeBsdfGlossy")
        graph.feed(closure.inputs["Color"], color)
        graph.feed(closure.inputs["Roughness"], lobe.roughness or 0.0)
        if not diffuse:
            closure.distribution = "GGX"
        if lobe.normal is not None:
            graph.feed(closure.inputs["Normal"], lobe.normal)
        return closure.outputs[0]

    def _added(self, total: Any, closure: Any) -> Any:
        if total is None:
            return closure
        both = self._graph.node("ShaderNodeAddShader")
        self._graph.feed(both.inputs[0], total)
        self._graph.feed(both.inputs[1], closure)
        return both.outputs[0]

    def _lobes(self, surface: Surface) -> dict[tuple[object, ...], Lobe]:
        """A surface by kinds of lobe.

        (1-m) * ((1-s) * Lambert(c) + s * GGX(white)) + m * GGX(c).
        """
        graph, maps = self._graph, surface.maps
        color = self._color(surface)
        white = surface.specular
        normal, normal_key = None, None
        if maps is not None and maps.normal is not None:
            normal = self._pictures.normal(maps)
            normal_key = map_key(maps, "normal")
        elif self._reach.smooth:
            normal = self._pictures.facing()
        roughness, roughness_key = self._roughness(surface)
        metallic: Scalar = surface.metallic
        dull: Scalar = 1.0 - surface.metallic
        if maps is not None and maps.metallic is not None:
            metallic = self._pictures.value(maps, "metallic")
            dull = graph.math("SUBTRACT", 1.0, metallic)
        share = graph.product(dull, 1.0 - white)
        sheen = graph.scaled((white, white, white), dull)
        gloss = graph.sum(sheen, graph.scaled(color, metallic))
        key: tuple[object, ...] = (None, normal_key)
        base = Lobe(None, normal, graph.scaled(color, share))
        if surface.reflectance is not None and self._laws is not None:
            key = ("law", normal_key)
            facing = graph.geometry("Normal") if normal is None else normal
            even, lit = self._laws.colors(surface.reflectance, color, facing, repr(normal_key))
            known = self._laws.known(facing, repr(normal_key))
            base = Lobe(None, normal, graph.scaled(even, share), graph.scaled(lit, share), known)
        return {key: base, (roughness_key, normal_key): Lobe(roughness, normal, gloss)}

    def _roughness(self, surface: Surface) -> tuple[Scalar, object]:
        """Number or map, times the factor of its variation; and what tells it from others."""
        graph, maps = self._graph, surface.maps
        factor = self._factor(surface.roughness_variation)
        amount = 0.0 if isinstance(factor, float) else surface.roughness_variation
        if maps is not None and maps.roughness is not None:
            value = self._pictures.value(maps, "roughness")
            varied = graph.product(value, factor)
            key: object = (map_key(maps, "roughness"), amount)
        elif isinstance(factor, float):
            smooth = max(surface.roughness, _SMOOTHEST)
            return smooth, smooth
        else:
            varied = graph.product(surface.roughness, factor)
            key = (surface.roughness, amount)
        if amount != 0.0:
            varied = graph.math("MINIMUM", varied, 1.0)
        return graph.math("MAXIMUM", varied, _SMOOTHEST), key

    def _factor(self, amount: float) -> Scalar:
        """(1 + amount * vertex) * (1 + amount * row)."""
        graph = self._graph
        factor: Scalar = 1.0
        if amount != 0.0 and self._reach.vertex > 0.0:
            own = graph.attribute(VARIATION).outputs["Fac"]
            factor = graph.math("MULTIPLY_ADD", own, amount, 1.0)
        if amount != 0.0 and self._reach.row > 0.0:
            row = graph.once(
                "row variation",
                lambda: graph.separate(graph.attribute(ROW, "INSTANCER").outputs["Vector"])[2],
            )
            whole = graph.math("MULTIPLY_ADD", row, amount, 1.0)
            factor = graph.product(factor, whole)
        return factor

    def _color(self, surface: Surface) -> Vector:
        """base_color * (1 + variation * vertex) * (1 + variation * row) * map, in [0, 1]."""
        graph, amount, maps = self._graph, surface.variation, surface.maps
        color = graph.scaled(surface.base_color, self._factor(amount))
        if maps is not None and maps.base_color is not None:
            picture = self._pictures.value(maps, "base_color")
            color = graph.vector("MULTIPLY", color, picture)
        swing = [abs(amount) * self._reach.vertex, abs(amount) * self._reach.row]
        brightest = max(surface.base_color) * (1.0 + swing[0]) * (1.0 + swing[1])
        if max(swing) > 1.0 or min(surface.base_color) < 0.0 or brightest > 1.0:
            color = graph.clipped(color)
        return color


def make_image(bpy: Any, *source: Any) -> Any:
    """A map (the arguments of ``maps.load_map``) as Blender's image, its values as they are.

    Raises:
        StageError: It cannot be read.
    """
    return picture_image(bpy, load_map(*source))


def picture_image(bpy: Any, picture: Any) -> Any:
    """An array [h, w, 1 or 3], row 0 at the top, as a float32 image without a color space."""
    height, width = picture.shape[:2]
    made = bpy.data.images.new(
        "scenec_picture", width, height, alpha=False, float_buffer=True, is_data=True
    )
    made.colorspace_settings.name = "Non-Color"
    pixels = np.ones((height, width, 4), np.float32)
    # Blender's row 0 is the bottom one.
    pixels[..., :3] = picture[::-1]
    made.pixels.foreach_set(pixels.ravel())
    made.update()
    return made
