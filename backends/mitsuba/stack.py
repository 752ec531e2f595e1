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

Both sides of a face are alike, and no light passes through it. Mitsuba's ``twosided`` goes by the
shading normal alone: at smooth normals, directions that lie above it but below the face itself pass
through the ground and meet the sky under it (up to a quarter of the sky's light on coarse drawn
relief, measured). Which side is seen is the face's matter too: at the rim of a smooth thing of few
faces the shading normal leans away from the viewer, who sees the face all the same, and counts as
at the horizon, where dull lobes are as bright as ever; ``twosided`` draws a black rim.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenec.backends.mitsuba import mix
from scenec.backends.mitsuba.functions import drjit_functions
from scenec.backends.mitsuba.geometry import FlatMesh
from scenec.backends.mitsuba.pictures import Pictures
from scenec.backends.stage.scene import Surface
from scenec.backends.surface.heights import FLAT, LEAST_DEPTH, needed
from scenec.backends.surface.reflectance import Numbers, numbers_of, terms, value

PLUGIN = "scenec_stack"
#: GGX in float32 loses its digits below this; roughness under 0.032 is drawn as 0.032.
MIN_ALPHA = 1e-3
#: Cosine at which viewers stand whom the shading normal leans away from,
GRAZING = 1e-5
#: and below which there is no gloss, as in Cycles.
SEEN = 1.01 * GRAZING


@dataclass(frozen=True)
class Look:
    """What a flattened mesh is made of.

    Attributes:
        bsdf: Mitsuba's.
        attributes: Vertex attributes that it reads, name -> float32 [n, channels].
        glow: What it gives off, or None.
    """

    bsdf: Any
    attributes: dict[str, NDArray[np.float32]]
    glow: Glow | None


@dataclass(frozen=True)
class Layer:
    """One layer's numbers, opaque: another scene's are no other kernel to compile.

    Attributes:
        surface: What they are of; of it only is looked at what decides the kernel.
        pictures: Its maps, or None.
        color: [3].
        variation, roughness, swing, specular, metallic: As of ``Surface``.
        law: In place of Lambert's, or None.
    """

    surface: Surface
    pictures: Pictures | None
    color: list[Any]
    variation: Any
    roughness: Any
    swing: Any
    specular: Any
    metallic: Any
    law: Numbers | None

    def has(self, kind: str) -> bool:
        """Whether there is a map of that kind."""
        return self.pictures is not None and kind in self.pictures.kinds

    @property
    def metal(self) -> bool:
        """Whether any of it may be metal."""
        return self.surface.metallic > 0.0 or self.has("metallic")

    @property
    def glossy(self) -> bool:
        """Whether it has a GGX lobe."""
        return self.surface.specular > 0.0 or self.metal


@dataclass
class Found:
    """What a layer is at a point.

    Attributes:
        share: Of the whole.
        color: Base color.
        normal: In the local frame; None: the shading normal.
        alpha, white, tinted: Of the GGX lobe: its parameter, and the weights of its white and of
            its tinted part; None where there is none.
        height: For merges that heed it.
    """

    share: Any
    color: Any
    normal: Any
    alpha: Any
    white: Any
    tinted: Any
    height: Any

    @property
    def dull(self) -> Any:
        """Weight of the lobe of Lambert or the law in its place."""
        return 1.0 if self.alpha is None else 1.0 - self.white - self.tinted


class Glow:
    """The light that the layers of a surface give off."""

    def __init__(self, stack: Any, shining: Sequence[tuple[list[Any], Pictures | None]]) -> None:
        """Takes a ``Stack``, and of each layer the factor [3] of its map of emission, if any."""
        self._stack, self._shining = stack, shining

    def eval(self, si: Any, active: Any = True) -> Any:
        """Radiance at points, W m^-2 sr^-1."""
        return self._stack.glow(self._shining, si, active)


def make_look(
    mi: Any, surfaces: Sequence[Surface], flat: FlatMesh, center: NDArray[np.float64]
) -> Look:
    """The merge of layers on a mesh.

    Args:
        mi: Mitsuba.
        surfaces: The layers, base first.
        flat: The mesh; its texture coordinates are x and y relative to ``center``, unless a surface
            has maps by the mesh's own.
        center: Of the scene, meters.
    """
    import drjit as dr

    def number(amount: float) -> Any:
        return dr.opaque(mi.Float, float(amount))

    heeded = needed(flat.height_blends)
    layers = []
    for index, surface in enumerate(surfaces):
        kinds = ["base_color", "normal", "metallic"]
        metal = surface.maps is not None and surface.maps.metallic is not None
        if surface.glossy or metal:
            kinds.append("roughness")
        if index < heeded:
            kinds.append("height")
        law = None
        if surface.reflectance is not None:
            plain = numbers_of(surface.reflectance)
            law = Numbers(
                plain.multiple,
                number(plain.b),
                number(plain.c),
                number(plain.opposition),
                number(plain.opposition_width),
                None if plain.slope is None else number(plain.slope),
            )
        layers.append(
            Layer(
                surface,
                None if surface.maps is None else Pictures(mi, surface.maps, kinds, center),
                [number(channel) for channel in surface.base_color],
                number(surface.variation),
                number(surface.roughness),
                number(surface.roughness_variation),
                number(surface.specular),
                number(surface.metallic),
                law,
            )
        )
    packed, attributes = mix.pack(flat)
    made = mi.load_dict({"type": register(mi)})
    made.prepare(packed, layers, flat.height_blends[: max(heeded - 1, 0)])
    glow = None
    if any(surface.emits for surface in surfaces):
        shining = []
        for surface in surfaces:
            pictures = None
            if surface.emits and surface.maps is not None and surface.maps.emission is not None:
                pictures = Pictures(mi, surface.maps, ("emission",), center)
            shining.append(([number(channel) for channel in surface.emission], pictures))
        glow = Glow(made, shining)
    return Look(made, attributes, glow)


@lru_cache(maxsize=1)
def register(mi: Any) -> str:
    """Define the BSDF for the variant that is set, and register it; returns its name."""
    import drjit as dr

    functions = drjit_functions()

    class Stack(mi.BSDF):
        """See the module. Set up by ``prepare``, never by Mitsuba's own parameters."""

        def __init__(self, props: Any) -> None:
            super().__init__(props)
            flags = mi.BSDFFlags.DiffuseReflection | mi.BSDFFlags.GlossyReflection
            flags |= mi.BSDFFlags.FrontSide | mi.BSDFFlags.BackSide
            self.m_components = [flags | mi.BSDFFlags.SpatiallyVarying]
            self.m_flags = self.m_components[0]
            self.kept: tuple[Any, Any] | None = None

        def prepare(
            self, packed: mix.Mix, layers: list[Layer], height_blends: Sequence[float]
        ) -> None:
            self.mix, self.layers = packed, layers
            self.weights = [
                weight if isinstance(weight, int) else dr.opaque(mi.Float, float(weight))
                for weight in packed.weights
            ]
            # Factors of the weight and of the heights, of merges that heed these.
            deep = [max(depth, LEAST_DEPTH) for depth in height_blends]
            self.slopes = [
                tuple(dr.opaque(mi.Float, n) for n in ((1.0 + d) / d, 0.5 / d)) if own else None
                for own, d in zip(height_blends, deep, strict=True)
            ]
            self.glossy = any(layer.glossy for layer in layers)

        # What a surface is at a point.

        def _look(self, si: Any, active: Any) -> list[Found]:
            channels = mix.channels_of(mi, self.mix, si, active)
            weights = self._weights(channels)
            shares = _shares(weights)
            found = [
                self._layer(layer, share, channels, si, active)
                for layer, share in zip(self.layers, shares, strict=True)
            ]
            if self.slopes:
                self._heed(weights, [layer.height for layer in found])
                for layer, share in zip(found, _shares(weights), strict=True):
                    layer.share = share
            return found

        def _layer(
            self, layer: Layer, share: Any, channels: list[Any], si: Any, active: Any
        ) -> Found:
            pictured: dict[str, list[Any]] = {}
            if layer.pictures is not None and layer.pictures.kinds:
                pictured = _where_needed(layer.pictures, share, si, active)
            color = mi.Color3f(*layer.color) * self._factor(
                layer.variation if layer.surface.variation != 0.0 else None, channels
            )
            if "base_color" in pictured:
                # Above 1 it is clipped, but after the map.
                color = dr.maximum(color, 0.0) * mi.Color3f(*pictured["base_color"])
            color = dr.clip(color, 0.0, 1.0)
            normal = mi.Vector3f(*pictured["normal"]) if "normal" in pictured else None
            height = pictured["height"][0] if "height" in pictured else mi.Float(FLAT)
            if not layer.glossy:
                return Found(share, color, normal, None, None, None, height)
            rough = pictured["roughness"][0] if "roughness" in pictured else layer.roughness
            varies = layer.surface.glossy and layer.surface.roughness_variation != 0.0
            rough = rough * self._factor(layer.swing if varies else None, channels)
            alpha = dr.maximum(dr.square(dr.clip(rough, 0.0, 1.0)), MIN_ALPHA)
            tinted = layer.metallic
            if "metallic" in pictured:
                tinted = dr.clip(pictured["metallic"][0], 0.0, 1.0)
            white = (1.0 - tinted) * layer.specular
            return Found(share, color, normal, alpha, white, tinted, height)

        def _factor(self, amount: Any | None, channels: list[Any]) -> Any:
            factor = mi.Float(1.0)
            if amount is not None:
                for place in (self.mix.own, self.mix.row):
                    if place is not None:
                        factor *= 1.0 + amount * channels[place]
            return factor

        def glow(self, shining: Any, si: Any, active: Any) -> Any:
            """Radiance that the layers give off; see ``Glow``."""
            channels = mix.channels_of(mi, self.mix, si, active)
            weights = self._weights(channels)
            if self.slopes:
                heights = []
                for layer in self.layers[: len(self.slopes) + 1]:
                    height = mi.Float(FLAT)
                    if layer.pictures is not None and layer.has("height"):
                        height = layer.pictures.look_up(si, active)["height"][0]
                    heights.append(height)
                self._heed(weights, heights)
            total = mi.Color3f(0.0)
            for share, (factor, pictures) in zip(_shares(weights), shining, strict=True):
                light = mi.Color3f(*factor)
                if pictures is not None:
                    light *= mi.Color3f(*pictures.look_up(si, active)["emission"])
                total += share * light
            return total

        def _weights(self, channels: list[Any]) -> list[Any]:
            return [
                dr.clip(channels[w] if isinstance(w, int) else w, 0.0, 1.0) for w in self.weights
            ]

        def _heed(self, weights: list[Any], heights: list[Any]) -> None:
            """The formula of ``surface.heights``."""
            below = heights[0]
            for index, slopes in enumerate(self.slopes):
                above = heights[index + 1]
                if slopes is not None:
                    steep, half = slopes
                    weights[index] = dr.clip(
                        weights[index] * steep + (above - below - 1.0) * half, 0.0, 1.0
                    )
                below = below + weights[index] * (above - below)

        # Directions.

        def _turned(self, si: Any) -> tuple[Any, Any]:
            """The viewer's direction as from the front, and whether it was from behind."""
            frame = si.sh_frame
            behind = dr.dot(si.n, frame.to_world(si.wi)) * dr.dot(si.n, frame.n) < 0.0
            height = dr.maximum(dr.select(behind, -si.wi.z, si.wi.z), GRAZING)
            return dr.normalize(mi.Vector3f(si.wi.x, si.wi.y, height)), behind

        def _same_side(self, si: Any, wo: Any) -> Any:
            """Whether both directions, in the local frame, lie on one side of the face."""
            to_world = si.sh_frame.to_world
            return dr.dot(si.n, to_world(si.wi)) * dr.dot(si.n, to_world(wo)) > 0.0

        def _at(self, si: Any, active: Any) -> tuple[Any, Any, list[Found]]:
            wi, behind = self._turned(si)
            found = self._look(si, active)
            for layer in found:
                if layer.normal is not None:
                    layer.normal = _towards(layer.normal, wi)
            return wi, behind, found

        # The lobes.

        def _terms(self, wi: Any, wo: Any, found: list[Found]) -> tuple[Any, Any]:
            """BRDF times cosine, and the density with which ``wo`` is drawn."""
            total, density = mi.Color3f(0.0), mi.Float(0.0)
            both = wi + wo
            length = dr.norm(both)
            half = both / length
            for layer, at in zip(self.layers, found, strict=True):
                cos_i, cos_o = (
                    w.z if at.normal is None else dr.dot(w, at.normal) for w in (wi, wo)
                )
                lambert = at.dull * cos_o * dr.inv_pi
                light, chance = at.color * lambert, lambert
                if layer.law is not None:
                    tangent = dr.norm(wi - wo) / dr.maximum(length, 1e-6)
                    law = terms(functions, layer.law, cos_o, cos_i, tangent)
                    light = value(law, at.color) * (at.dull * cos_o)
                if at.alpha is not None:
                    gloss, drawn = _ggx(at.alpha, cos_i, cos_o, half, at.normal)
                    light += gloss * (at.white + at.tinted * at.color)
                    chance += drawn * (at.white + at.tinted)
                lit = (cos_i > 0.0) & (cos_o > 0.0)
                total += dr.select(lit, at.share * light, 0.0)
                density += dr.select(lit, at.share * chance, 0.0)
            above = wo.z > 0.0
            return dr.select(above, total, 0.0), dr.select(above, density, 0.0)

        def _draw(self, wi: Any, found: list[Found], which: Any, sample2: Any) -> Any:
            """A direction: of a layer, by its share, and of one of its lobes."""
            frame_normal = mi.Vector3f(0.0, 0.0, 1.0)
            normal, alpha = frame_normal, mi.Float(1.0)
            glossy = mi.Bool(False)
            start = mi.Float(0.0)
            for at in found:
                here = which >= start
                normal = dr.select(here, frame_normal if at.normal is None else at.normal, normal)
                if at.alpha is not None:
                    alpha = dr.select(here, at.alpha, alpha)
                    glossy = dr.select(here, which >= start + at.share * at.dull, glossy)
                elif self.glossy:
                    glossy = glossy & ~here
                start = start + at.share
            local = mi.warp.square_to_cosine_hemisphere(sample2)
            frame = mi.Frame3f(normal)
            if self.glossy:
                seen = frame.to_local(wi)
                distribution = mi.MicrofacetDistribution(mi.MicrofacetType.GGX, alpha, True)
                facet = distribution.sample(seen, sample2)[0]
                local = dr.select(glossy, mi.reflect(seen, facet), local)
            if all(at.normal is None for at in found):
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
            return light & self._same_side(si, wo) & active, density

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
            sound = active & (density > 0.0) & self._same_side(si, bs.wo)
            return bs, dr.select(sound, light / density, 0.0)

        def eval_diffuse_reflectance(self, si: Any, active: Any = True) -> Any:
            return sum(
                (at.color * (at.share * at.dull) for at in self._look(si, active)), mi.Color3f(0.0)
            )

        def to_string(self) -> str:
            return f"Stack[{len(self.layers)}]"

    def _shares(weights: list[Any]) -> list[Any]:
        shares: list[Any] = []
        rest = mi.Float(1.0)
        for weight in reversed(weights):
            shares.append(weight * rest)
            rest = (1.0 - weight) * rest
        return [rest, *reversed(shares)]

    def _where_needed(pictures: Pictures, share: Any, si: Any, active: Any) -> dict[str, list[Any]]:
        """Maps; where no ray of a packet needs them they cost nothing."""
        sizes: dict[str, int] = {}

        def looked_up() -> tuple[Any, ...]:
            found = pictures.look_up(si, active)
            sizes.update({kind: len(values) for kind, values in found.items()})
            return tuple(v for values in found.values() for v in values)

        def skipped() -> tuple[Any, ...]:
            # A unit vector, so that nothing comes of it.
            return tuple(
                mi.Float(1.0 if kind == "normal" and channel == 2 else 0.0)
                for kind, size in sizes.items()
                for channel in range(size)
            )

        values = dr.if_stmt((), active & (share > 0.0), looked_up, skipped)
        found, first = {}, 0
        for kind, size in sizes.items():
            found[kind] = list(values[first : first + size])
            first += size
        return found

    def _towards(normal: Any, wi: Any) -> Any:
        """A normal as a unit vector; leaned the other way where it faces away from the viewer.

        As Mitsuba's ``normalmap`` has it.
        """
        away = dr.dot(wi, normal) <= 0.0
        normal = mi.Vector3f(
            dr.select(away, -normal.x, normal.x), dr.select(away, -normal.y, normal.y), normal.z
        )
        inverse = dr.rsqrt(dr.squared_norm(normal))
        sound = (inverse > 0.0) & dr.isfinite(inverse)
        return dr.select(sound, normal * inverse, mi.Vector3f(0.0, 0.0, 1.0))

    def _ggx(alpha: Any, cos_i: Any, cos_o: Any, half: Any, normal: Any) -> tuple[Any, Any]:
        """BRDF times cosine of a white lobe, and its density."""
        if normal is None:
            across = dr.square(half.x) + dr.square(half.y)
            cosine = half.z
        else:
            cosine = dr.dot(half, normal)
            across = dr.squared_norm(half - normal * cosine)
        square = dr.square(alpha)
        spread = square / (dr.pi * dr.square(across + square * dr.square(cosine)))
        # sqrt(1 + (alpha tan)^2) = 1 + 2 L = 2 / G1 - 1 of both directions.
        hidden = [dr.sqrt(1.0 + square * (1.0 / dr.square(c) - 1.0)) for c in (cos_i, cos_o)]
        scale = dr.select(cos_i > SEEN, spread / (2.0 * cos_i), 0.0)
        return scale / (hidden[0] + hidden[1]), scale / (1.0 + hidden[0])

    def _key(si: Any, active: Any) -> tuple[Any, ...]:
        """What tells one traced interaction from others while it is kept alive."""
        parts = (*si.p, *si.wi, si.prim_index, active)
        return tuple(getattr(part, "index", part) for part in parts)

    mi.register_bsdf(PLUGIN, Stack)
    return PLUGIN
