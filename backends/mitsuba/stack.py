"""The shared surface model: a stack of layers as one BSDF, which looks at each point once.

Mitsuba's ``blendbsdf`` and ``normalmap`` nest, and each asks its children's textures anew for the
light's direction and for the one that is drawn: 57,000 operations and 20 to 40 s of compilation for
three layers with maps in cells, and a quarter more time for layers without any. Here a point's
weights, colors, roughness and normals are found once, layers that have no share in any ray of a
packet are skipped, and the lobes of all layers answer from that. What is drawn is weighed by the
density of the whole mixture.

Gloss is GGX, alpha = roughness**2, masked and shadowed as on a surface of heights (Heitz 2014,
Understanding the Masking-Shadowing Function, eq. 99), as Cycles has it; ``roughconductor`` takes
the two directions as if they were independent, which at roughness 0.9 under an even sky is 10 %
darker (measured).

Both sides of a face are alike; through it goes what a sheet transmits, and no other light.
Mitsuba's ``twosided`` goes by the shading normal alone: at smooth normals, directions that lie
above it but below the face itself pass through the ground and meet the sky under it (up to a
quarter of the sky's light on coarse drawn relief, measured). Which side is seen is the face's
matter too: at the rim of a smooth thing of few faces the shading normal leans away from the viewer,
who sees the face all the same, and counts as at the horizon, where dull lobes are as bright as
ever; ``twosided`` draws a black rim.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from scenec.backends.mitsuba import mix
from scenec.backends.mitsuba.arrays import ARRAYS
from scenec.backends.mitsuba.cutouts import SurfaceMask
from scenec.backends.mitsuba.geometry import FlatMesh
from scenec.backends.mitsuba.pictures import Pictures
from scenec.backends.stage.scene import Surface
from scenec.backends.surface import facets, lobes, merges, projections
from scenec.backends.surface.reflectance import Numbers, numbers_of, terms, value

PLUGIN = "scenec_stack"
#: Cosine below which there is no gloss, as in Cycles.
SEEN = 1.01 * projections.GRAZING


@dataclass(frozen=True)
class Look:
    """Holds the material of a flattened mesh.

    Attributes:
        bsdf: Mitsuba's.
        attributes: Vertex attributes that it reads, name -> float32 [n, channels].
        glow: What it gives off, or None.
    """

    bsdf: Any
    attributes: dict[str, NDArray[np.float32]]
    glow: Glow | None


class Layer:
    """One layer's numbers, opaque: another scene's are no other kernel to compile.

    Args:
        surface: What they are of; of it only is looked at what decides the kernel.
        pictures: Its maps, or None.
    """

    def __init__(self, surface: Surface, pictures: Pictures | None) -> None:
        self.pictures, self.glossy, self.transmits = pictures, surface.glossy, surface.transmits
        self.numbers = lobes.numbers_of(ARRAYS, surface)
        law = surface.reflectance
        self.law: Numbers | None = None if law is None else numbers_of(law, ARRAYS)
        rough = facets.deviation(surface)
        self.deviation = ARRAYS.number(rough) if rough > 0.0 else None


@dataclass
class LayerPoint:
    """Holds the properties of a layer at a point.

    Attributes:
        share: Of the whole.
        lobes: What it reflects.
        normal: In the local frame; None: the shading normal.
        height: For merges that heed it.
    """

    share: Any
    lobes: lobes.Lobes
    normal: Any
    height: Any


class Glow:
    """The light that the layers of a surface give off."""

    def __init__(self, stack: Stack, shining: Sequence[tuple[Any, Pictures | None]]) -> None:
        """Takes of each layer the factor of its map of emission, if any."""
        self._stack, self._shining = stack, shining

    def eval(self, si: Any, active: Any = True) -> Any:
        """Radiance at points, W m^-2 sr^-1."""
        return self._stack.glow(self._shining, si, active)


def make_look(surfaces: Sequence[Surface], flat: FlatMesh, center: NDArray[np.float64]) -> Look:
    """The merge of layers on a mesh.

    Args:
        surfaces: The layers, base first.
        flat: The mesh; its texture coordinates are x and y relative to ``center``, unless a surface
            has maps by the mesh's own.
        center: Of the scene, meters.
    """
    heeded = merges.needed(flat.height_blends)
    layers = []
    for index, surface in enumerate(surfaces):
        kinds = ["base_color", "normal", "metallic"]
        kinds += ["roughness"] if surface.glossy else []
        kinds += ["height"] if index < heeded else []
        maps = surface.maps
        layers.append(Layer(surface, None if maps is None else Pictures(maps, kinds, center)))
    packed, attributes = mix.pack(flat)
    made = mi.load_dict({"type": PLUGIN})
    made.prepare(packed, layers, flat.height_blends)
    cutout = surfaces[0].cutout if len(surfaces) == 1 else None
    # Rays of kept instances are the exact caster's, which has asked.
    if cutout is not None and flat.lanes is None:
        made.cut_out(SurfaceMask(cutout))
    glow = None
    if any(surface.emits for surface in surfaces):
        shining = []
        for surface in surfaces:
            pictures = None
            if surface.emits and surface.maps is not None and surface.maps.emission is not None:
                pictures = Pictures(surface.maps, ("emission",), center)
            shining.append((ARRAYS.numbers(surface.emission), pictures))
        glow = Glow(made, shining)
    return Look(made, attributes, glow)


class Stack(mi.BSDF):
    """See the module. Set up by ``prepare``, never by Mitsuba's own parameters."""

    def __init__(self, props: Any) -> None:
        super().__init__(props)
        flags = mi.BSDFFlags.DiffuseReflection | mi.BSDFFlags.GlossyReflection
        flags |= mi.BSDFFlags.FrontSide | mi.BSDFFlags.BackSide
        self.m_components = [flags | mi.BSDFFlags.SpatiallyVarying]
        self.m_flags = self.m_components[0]
        self.kept: tuple[Any, Any] | None = None
        self.mask: SurfaceMask | None = None

    def prepare(self, packed: mix.Mix, layers: list[Layer], height_blends: Sequence[float]) -> None:
        self.mix, self.layers = packed, layers
        self.weights = [w if isinstance(w, int) else ARRAYS.number(w) for w in packed.weights]
        self.slopes = merges.all_slopes(ARRAYS, height_blends)
        self.glossy = any(layer.glossy for layer in layers)
        self.transmits = any(layer.transmits for layer in layers)

    def cut_out(self, mask: SurfaceMask) -> None:
        self.mask = mask
        self.m_components = [*self.m_components, mi.BSDFFlags.Null | mi.BSDFFlags.FrontSide]
        self.m_flags = self.m_components[0] | self.m_components[1]

    # What a surface is at a point.

    def _look(self, si: Any, active: Any) -> list[LayerPoint]:
        channels = mix.channels_of(mi, self.mix, si, active)
        weights = self._weights(channels)
        found = [
            self._layer(layer, share, channels, si, active)
            for layer, share in zip(self.layers, merges.shares(weights), strict=True)
        ]
        if self.slopes:
            heights = [layer.height for layer in found]
            weights = merges.heeded_weights(ARRAYS, weights, self.slopes, heights)
            for layer, share in zip(found, merges.shares(weights), strict=True):
                layer.share = share
        return found

    def _layer(
        self, layer: Layer, share: Any, channels: list[Any], si: Any, active: Any
    ) -> LayerPoint:
        pictured: dict[str, Any] = {}
        if layer.pictures is not None and layer.pictures.kinds:
            pictured = _where_needed(layer.pictures, share, si, active)
        if self.mix.color is not None:
            color = mi.Vector3f(*channels[self.mix.color : self.mix.color + 3])
            shown = pictured.get("base_color")
            pictured["base_color"] = color if shown is None else shown * color
        variations = [channels[i] for i in (self.mix.own, self.mix.row) if i is not None]
        own = lobes.lobes_of(ARRAYS, layer.numbers, pictured, variations)
        return LayerPoint(share, own, pictured.get("normal"), pictured.get("height", merges.FLAT))

    def glow(self, shining: Any, si: Any, active: Any) -> Any:
        """Radiance that the layers give off; see ``Glow``."""
        weights = self._weights(mix.channels_of(mi, self.mix, si, active))
        if self.slopes:
            heights = []
            for layer in self.layers[: len(self.slopes) + 1]:
                maps = layer.pictures
                found = {} if maps is None else maps.look_up(si, active)
                heights.append(found.get("height", merges.FLAT))
            weights = merges.heeded_weights(ARRAYS, weights, self.slopes, heights)
        total = mi.Vector3f(0.0)
        for share, (light, maps) in zip(merges.shares(weights), shining, strict=True):
            if maps is not None:
                light = light * maps.look_up(si, active)["emission"]
            total += light * share
        return mi.Color3f(total)

    def _weights(self, channels: list[Any]) -> list[Any]:
        return [dr.clip(channels[w] if isinstance(w, int) else w, 0.0, 1.0) for w in self.weights]

    # Directions.

    def _turned(self, si: Any) -> tuple[Any, Any]:
        """The viewer's direction as from the front, and whether it was from behind."""
        frame = si.sh_frame
        behind = dr.dot(si.n, frame.to_world(si.wi)) * dr.dot(si.n, frame.n) < 0.0
        height = dr.maximum(dr.select(behind, -si.wi.z, si.wi.z), projections.GRAZING)
        return dr.normalize(mi.Vector3f(si.wi.x, si.wi.y, height)), behind

    def _same_side(self, si: Any, wo: Any) -> Any:
        """Whether both directions, in the local frame, lie on one side of the face."""
        to_world = si.sh_frame.to_world
        return dr.dot(si.n, to_world(si.wi)) * dr.dot(si.n, to_world(wo)) > 0.0

    def _at(self, si: Any, active: Any) -> tuple[Any, Any, list[LayerPoint]]:
        wi, behind = self._turned(si)
        found = self._look(si, active)
        up = mi.Vector3f(0.0, 0.0, 1.0)
        for layer, at in zip(self.layers, found, strict=True):
            # Facets are seen where others are that face the viewer.
            if at.normal is not None and layer.deviation is None:
                x, y, z = at.normal
                at.normal = projections.towards(ARRAYS, mi.Vector3f(x, y, 0.0), z, up, wi)
        return wi, behind, found

    # The lobes.

    def _terms(self, wi: Any, wo: Any, points: list[LayerPoint]) -> tuple[Any, Any]:
        """BRDF times cosine, and the density with which ``wo`` is drawn."""
        total, density = mi.Vector3f(0.0), mi.Float(0.0)
        both = wi + wo
        length = dr.norm(both)
        half = both / length
        for layer, at in zip(self.layers, points, strict=True):
            cos_i, cos_o = (w.z if at.normal is None else dr.dot(w, at.normal) for w in (wi, wo))
            seen = cos_i if layer.deviation is None else wi.z
            own = at.lobes
            chance = own.dull * cos_o * dr.inv_pi
            light = own.color * chance
            if layer.law is not None:
                tangent = dr.norm(wi - wo) / dr.maximum(length, 1e-6)
                law = terms(ARRAYS, layer.law, cos_o, seen, tangent)
                light = value(law, own.color) * (own.dull * cos_o)
            if layer.deviation is not None:
                light *= facets.factor(ARRAYS, layer.deviation, wi.z, wo.z, dr.dot(wi, wo))
            if layer.glossy:
                if at.normal is None:
                    cos_h, sine2 = half.z, dr.square(half.x) + dr.square(half.y)
                else:
                    cos_h = dr.dot(half, at.normal)
                    sine2 = dr.squared_norm(half - at.normal * cos_h)
                gloss, drawn = lobes.ggx(ARRAYS, own.alpha, (cos_i, cos_o), cos_h, sine2)
                shiny = cos_i > SEEN
                tint = lobes.gloss_color(own, dr.maximum(cos_i, projections.GRAZING))
                light += dr.select(shiny, gloss, 0.0) * tint
                chance += dr.select(shiny, drawn, 0.0) * (own.white + own.tinted)
            lit = (seen > 0.0) & (cos_o > 0.0)
            total += dr.select(lit, at.share * light, 0.0)
            density += dr.select(lit, at.share * chance, 0.0)
        above = wo.z > 0.0
        return dr.select(above, mi.Color3f(total), 0.0), dr.select(above, density, 0.0)

    def _beyond(self, wo: Any, points: list[LayerPoint]) -> tuple[Any, Any]:
        """``_terms`` of what passes to the far side."""
        total, density = mi.Vector3f(0.0), mi.Float(0.0)
        for layer, at in zip(self.layers, points, strict=True):
            if layer.transmits:
                cosine = -(wo.z if at.normal is None else dr.dot(wo, at.normal))
                chance = at.share * at.lobes.through * dr.maximum(cosine, 0.0) * dr.inv_pi
                total += at.lobes.color * chance
                density += chance
        below = wo.z < 0.0
        return dr.select(below, mi.Color3f(total), 0.0), dr.select(below, density, 0.0)

    def _draw(self, wi: Any, points: list[LayerPoint], which: Any, sample2: Any) -> Any:
        """A direction: of a layer, by its share, and of one of its lobes."""
        frame_normal = mi.Vector3f(0.0, 0.0, 1.0)
        normal, alpha = frame_normal, mi.Float(1.0)
        glossy = mi.Bool(False)
        beyond = mi.Bool(False)
        start = mi.Float(0.0)
        for layer, at in zip(self.layers, points, strict=True):
            here = which >= start
            normal = dr.select(here, frame_normal if at.normal is None else at.normal, normal)
            dull = at.share * at.lobes.dull
            if layer.transmits:
                beyond = dr.select(here, which >= start + dull, beyond)
                dull += at.share * at.lobes.through
            elif self.transmits:
                beyond = beyond & ~here
            if layer.glossy:
                alpha = dr.select(here, at.lobes.alpha, alpha)
                glossy = dr.select(here, which >= start + dull, glossy)
            elif self.glossy:
                glossy = glossy & ~here
            start = start + at.share
        local = mi.warp.square_to_cosine_hemisphere(sample2)
        if self.transmits:
            local.z = dr.select(beyond, -local.z, local.z)
        frame = mi.Frame3f(normal)
        if self.glossy:
            seen = frame.to_local(wi)
            distribution = mi.MicrofacetDistribution(mi.MicrofacetType.GGX, alpha, True)
            facet = distribution.sample(seen, sample2)[0]
            local = dr.select(glossy, mi.reflect(seen, facet), local)
        if all(at.normal is None for at in points):
            return local
        return frame.to_world(local)

    # What Mitsuba asks.

    def eval_pdf(self, ctx: Any, si: Any, wo: Any, active: Any = True) -> tuple[Any, Any]:
        at = self._at(si, active)
        # The path integrator goes on to ask ``sample`` about the same point.
        self.kept = (_key(si, active), at)
        return self._answer(at, si, wo, active)

    def _answer(self, at: Any, si: Any, wo: Any, active: Any) -> tuple[Any, Any]:
        wi, behind, found = at
        facing = mi.Vector3f(wo.x, wo.y, dr.select(behind, -wo.z, wo.z))
        light, density = self._terms(wi, facing, found)
        light = light & self._same_side(si, wo) & active
        if self.transmits:
            passed, chance = self._beyond(facing, found)
            light += passed & ~self._same_side(si, wo) & active
            density += chance
        if self.mask is not None:
            kept = self.mask.opaque(si.uv, active)
            light, density = light & kept, density & kept
        return light, density

    def eval(self, ctx: Any, si: Any, wo: Any, active: Any = True) -> Any:
        return self._answer(self._at(si, active), si, wo, active)[0]

    def pdf(self, ctx: Any, si: Any, wo: Any, active: Any = True) -> Any:
        return self._answer(self._at(si, active), si, wo, active)[1]

    def sample(
        self, ctx: Any, si: Any, sample1: Any, sample2: Any, active: Any = True
    ) -> tuple[Any, Any]:
        kept, self.kept = self.kept, None
        if kept is not None and kept[0] == _key(si, active):
            wi, behind, found = kept[1]
        else:
            wi, behind, found = self._at(si, active)
        wo = self._draw(wi, found, sample1, sample2)
        light, density = self._terms(wi, wo, found)
        bs = dr.zeros(mi.BSDFSample3f)
        bs.wo = mi.Vector3f(wo.x, wo.y, dr.select(behind, -wo.z, wo.z))
        bs.pdf = density
        bs.eta = 1.0
        bs.sampled_type = +mi.BSDFFlags.DiffuseReflection
        bs.sampled_component = 0
        stays = self._same_side(si, bs.wo)
        if self.transmits:
            passed, chance = self._beyond(wo, found)
            light, stays = dr.select(stays, light, passed), mi.Bool(True)
            density += chance
            bs.pdf = density
        sound = active & (density > 0.0) & stays
        value = dr.select(sound, light / density, 0.0)
        if self.mask is not None:
            kept = self.mask.opaque(si.uv, active)
            bs.wo, bs.pdf = dr.select(kept, bs.wo, -si.wi), dr.select(kept, bs.pdf, 1.0)
            bs.sampled_type = dr.select(kept, bs.sampled_type, +mi.BSDFFlags.Null)
            value = dr.select(kept, value, 1.0)
        return bs, value

    def eval_null_transmission(self, si: Any, active: Any = True) -> Any:
        if self.mask is None:
            return mi.Color3f(0.0)
        return mi.Color3f(dr.select(self.mask.opaque(si.uv, active), 0.0, 1.0))

    def eval_diffuse_reflectance(self, si: Any, active: Any = True) -> Any:
        # Of gloss, too: it is what a denoiser goes by.
        total = mi.Vector3f(0.0)
        for at in self._look(si, active):
            own = at.lobes
            total += (own.color * (own.dull + own.tinted) + own.white) * at.share
            if own.through is not None:
                total += own.color * own.through * at.share
        return mi.Color3f(total)

    def to_string(self) -> str:
        return f"Stack[{len(self.layers)}]"


mi.register_bsdf(PLUGIN, Stack)


def _where_needed(pictures: Pictures, share: Any, si: Any, active: Any) -> dict[str, Any]:
    """Maps; where no ray of a packet needs them they cost nothing."""
    kinds: dict[str, Any] = {}

    def looked_up() -> tuple[Any, ...]:
        found = pictures.look_up(si, active)
        kinds.update({kind: type(values) for kind, values in found.items()})
        return tuple(found.values())

    def skipped() -> tuple[Any, ...]:
        # A unit vector, so that nothing comes of it.
        return tuple(
            of(0.0, 0.0, 1.0) if kind == "normal" else of(0.0) for kind, of in kinds.items()
        )

    values = dr.if_stmt((), active & (share > 0.0), looked_up, skipped)
    return dict(zip(kinds, values, strict=True))


def _key(si: Any, active: Any) -> tuple[Any, ...]:
    """Returns a key that identifies a traced interaction while it is alive."""
    parts = (*si.p, *si.wi, si.prim_index, active)
    return tuple(getattr(part, "index", part) for part in parts)
