"""The shared surface model as shader nodes: Lambert and GGX closures, alpha = roughness**2."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from functools import lru_cache, partial
from typing import Any

import numpy as np

from scenec.backends.cycles.geometry import (
    COLOR,
    FACE,
    ROW,
    VARIATION,
    Frame,
    LookKey,
    look_key,
    weight_name,
)
from scenec.backends.cycles.graph import NODES, Graph, is_black
from scenec.backends.cycles.pictures import Pictures
from scenec.backends.cycles.planetary import Laws, ShaderLight, by_law
from scenec.backends.stage.scene import DEFAULT_SURFACE, RenderScene, Surface
from scenec.backends.surface import lobes, merges
from scenec.backends.surface.maps import load_map
from scenec.backends.surface.projections import GRAZING
from scenec.schemas.cells import table as cell_table

#: Passes that carry row + 1 and face, each as two halves of 16 bits.
ROW_PASS, FACE_PASS = "scenec_row", "scenec_face"

_BLACK = np.zeros(3)


@dataclass
class Lobe:
    """All closures of a mixture that share roughness and normal: their colors mix as they do.

    Attributes:
        roughness: Perceptual; None for Lambertian ones.
        normal: The mapped normal, or None.
        color: Of them all.
        lit: Where they follow other laws than Lambert's: their color for the known light;
        known: and where that holds, see ``planetary``.
        through: Whether it is Lambert's lobe on the far side.
    """

    roughness: Any
    normal: Any
    color: Any
    lit: Any = None
    known: Any = None
    through: bool = False


@dataclass(frozen=True)
class Reach:
    """Holds which inputs vary on the meshes of a material.

    Attributes:
        vertex, row: Whether any varies.
        smooth: Whether there are shading normals.
        colored: Whether corners have colors.
    """

    vertex: bool = False
    row: bool = False
    smooth: bool = False
    colored: bool = False


@dataclass(frozen=True)
class Layer:
    """Holds the outputs of a layer at the shaded point.

    Attributes:
        lobes: By what tells those apart that do not mix.
        glow: What it gives off.
        height: For merges that heed it.
    """

    lobes: dict[tuple[Any, ...], Lobe]
    glow: Any
    height: Any


def make_materials(
    bpy: Any, scene: RenderScene, frame: Frame, light: ShaderLight | None = None
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
    radians = np.array([1.0, 1.0, 2.0 * np.pi])
    table = lru_cache(maxsize=None)(
        lambda seed: picture_image(bpy, (cell_table(seed) * radians)[::-1])
    )
    for key, reach in _reaches(scene).items():
        layers, depths, colored = key
        material = bpy.data.materials.new("scenec_look")
        material.node_tree.nodes.clear()
        # It would bend shading normals at grazing angles, which no other renderer does.
        material.cycles.use_bump_map_correction = False
        surfaces = tuple(scene.surfaces[i] for i in layers) or (DEFAULT_SURFACE,)
        graph = Graph(material.node_tree)
        pictures = Pictures(graph, frame, image, table, partial(picture_image, bpy))
        laws = None if light is None else Laws(graph, light, partial(picture_image, bpy))
        _Look(graph, pictures, dataclasses.replace(reach, colored=colored), laws).write(
            surfaces, depths
        )
        made[key] = material
    return made


def _reaches(scene: RenderScene) -> dict[LookKey, Reach]:
    """Returns the inputs that vary, for each ``look_key``."""
    of_rows = np.zeros(len(scene.meshes), np.bool_)
    np.logical_or.at(of_rows, scene.rows.mesh, scene.rows.variation != 0.0)
    reaches: dict[LookKey, Reach] = {}
    for index in np.unique(scene.rows.mesh).tolist():
        mesh = scene.meshes[index]
        if len(mesh.faces):
            known = reaches.get(look_key(mesh), Reach())
            reaches[look_key(mesh)] = Reach(
                known.vertex or (mesh.variation is not None and bool(mesh.variation.any())),
                known.row or bool(of_rows[index]),
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
        """The merge of the layers, base first, and the passes for visibility."""
        graph = self._graph
        heeded = merges.needed(depths)
        layers = [self._layer(surface, k < heeded) for k, surface in enumerate(surfaces)]
        weights = merges.heeded_weights(
            NODES,
            [graph.attribute(weight_name(k), "Fac") for k in range(len(surfaces) - 1)],
            merges.all_slopes(NODES, depths),
            [layer.height for layer in layers],
        )
        if any(surface.maps is not None for surface in surfaces):
            # Cycles skips a shader of weight 0 with all that it alone needs: maps are looked up
            # where their layer shows.
            total = self._close(layers[0])
            for layer, weight in zip(layers[1:], weights, strict=True):
                total = self._mixed(total, self._close(layer), weight)
        else:
            total = self._close(_merged(layers, weights))
        cutout = surfaces[0].cutout if len(surfaces) == 1 else None
        opaque: Any = 1.0
        if cutout is not None:
            opaque = self._pictures.opaque(cutout)
            nothing = graph.node("ShaderNodeBsdfTransparent")
            total = self._mixed(nothing.outputs[0], total, opaque)
        graph.feed(graph.node("ShaderNodeOutputMaterial").inputs["Surface"], total)
        for name, attribute, of in ((ROW_PASS, ROW, "INSTANCER"), (FACE_PASS, FACE, "GEOMETRY")):
            out = graph.node("ShaderNodeOutputAOV")
            out.aov_name = name
            # Cycles adds up what a ray passes and what it meets.
            graph.feed(out.inputs["Color"], graph.attribute(attribute, kind=of) * opaque)

    def _close(self, layer: Layer) -> Any:
        """A layer's closures, added up; one at least, or rays would pass through."""
        graph, found = self._graph, list(layer.lobes.values())
        total: Any = None
        for lobe in [lobe for lobe in found if not is_black(lobe.color)] or found[:1]:
            closure = self._closure(lobe, lobe.color)
            if lobe.known is not None:
                closure = self._mixed(closure, self._closure(lobe, lobe.lit), lobe.known)
            total = self._added(total, closure)
        if not is_black(layer.glow):
            emission = graph.node("ShaderNodeEmission")
            graph.feed(emission.inputs["Color"], layer.glow)
            if self._laws is not None:
                graph.feed(emission.inputs["Strength"], self._laws.glow())
            total = self._added(total, emission.outputs[0])
        return total

    def _closure(self, lobe: Lobe, color: Any) -> Any:
        graph = self._graph
        if lobe.through:
            closure = graph.node("ShaderNodeBsdfTranslucent")
            graph.feed(closure.inputs["Color"], color)
            if lobe.normal is not None:
                graph.feed(closure.inputs["Normal"], lobe.normal)
            return closure.outputs[0]
        diffuse = lobe.roughness is None
        closure = graph.node("ShaderNodeBsdfDiffuse" if diffuse else "ShaderNodeBsdfGlossy")
        graph.feed(closure.inputs["Color"], color)
        graph.feed(closure.inputs["Roughness"], 0.0 if diffuse else lobe.roughness)
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

    def _mixed(self, below: Any, above: Any, weight: Any) -> Any:
        either = self._graph.node("ShaderNodeMixShader")
        for target, value in zip(either.inputs, (weight, below, above), strict=True):
            self._graph.feed(target, value)
        return either.outputs[0]

    def _layer(self, surface: Surface, heeded: bool) -> Layer:
        """A surface where its maps and variations are looked up."""
        graph, maps = self._graph, surface.maps
        wanted = ["base_color", "normal", "metallic"]
        wanted += ["roughness"] if surface.glossy else []
        wanted += ["height"] if heeded else []
        wanted += ["emission"] if surface.emits else []
        found = {} if maps is None else self._pictures.look_up(maps, wanted)
        if self._reach.colored:
            found["base_color"] = graph.attribute(COLOR) * found.get("base_color", 1.0)
        own = lobes.lobes_of(NODES, lobes.numbers_of(NODES, surface), found, self._variations())
        normal = found.get("normal", self._pictures.facing if self._reach.smooth else None)
        facing = graph.geometry("Normal") if normal is None else normal
        key: tuple[Any, ...] = (None, normal)
        base = Lobe(None, normal, own.color * own.dull)
        if self._laws is not None and by_law(surface):
            key = ("law", normal)
            even, lit = self._laws.colors(surface, own.color, facing, self._pictures.facing)
            known = self._laws.known(facing)
            base = Lobe(None, normal, even * own.dull, lit * own.dull, known)
        gloss = Lobe(NODES.sqrt(own.alpha), normal, _BLACK)
        if surface.glossy:
            cosine = NODES.maximum(NODES.dot(graph.geometry("Incoming"), facing), GRAZING)
            gloss.color = np.ones(3) * lobes.gloss_color(own, cosine)
        glow = np.array(surface.emission, np.float64) * found.get("emission", 1.0)
        height = found.get("height", merges.FLAT)
        parts = {key: base, (gloss.roughness, normal): gloss}
        if own.through is not None:
            parts["through", normal] = Lobe(None, normal, own.color * own.through, through=True)
        return Layer(parts, glow, height)

    def _variations(self) -> list[Any]:
        graph, found = self._graph, []
        if self._reach.vertex:
            found.append(graph.attribute(VARIATION, "Fac"))
        if self._reach.row:
            found.append(NODES.parts(graph.attribute(ROW, kind="INSTANCER"))[2])
        return found


def _merged(layers: list[Layer], weights: list[Any]) -> Layer:
    """Layers without maps as one.

    The model is linear in its lobes: those of one roughness and normal are one closure with a mixed
    color, so that n layers take two closures instead of 3 n.
    """
    kinds = {key: lobe for layer in layers for key, lobe in layer.lobes.items()}
    none = Lobe(None, None, _BLACK, _BLACK)
    found, glow = {}, layers[0].glow
    for key, kind in kinds.items():
        own = [layer.lobes.get(key, none) for layer in layers]
        color, lit = own[0].color, own[0].lit
        for lobe, weight in zip(own[1:], weights, strict=True):
            color = NODES.mix(color, lobe.color, weight)
            if kind.known is not None:
                lit = NODES.mix(lit, lobe.lit, weight)
        found[key] = dataclasses.replace(kind, color=color, lit=lit)
    for layer, weight in zip(layers[1:], weights, strict=True):
        glow = NODES.mix(glow, layer.glow, weight)
    return Layer(found, glow, None)


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
