"""Merged ground layers as textures: what of the lobes' sums lies at a point, computed there.

Weights and variation are interpolated over a triangle; the sums are products of them, so they are
taken at the point, as every renderer does, and not at the vertices (which was off by up to 0.4 % of
mean radiance where metals and gloss meet dull ground in one triangle, measured).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from scenec.backends.mitsuba.geometry import FlatMesh
from scenec.backends.stage.scene import Surface

PLUGIN = "scenec_layer_mix"
#: Largest number of channels that one mesh attribute holds.
_PACK = 3
#: GGX in float32 loses its digits below this; roughness under 0.032 is drawn as 0.032.
MIN_ALPHA = 1e-3


class Gloss(NamedTuple):
    """What tells GGX lobes apart: layers of one share a lobe.

    Attributes:
        roughness: As authored.
        variation: ``Surface.roughness_variation``, or 0 where nothing varies.
    """

    roughness: float
    variation: float

    @property
    def alpha(self) -> float:
        """GGX's, where nothing varies."""
        return max(self.roughness**2, MIN_ALPHA)


@dataclass(frozen=True)
class Mix:
    """A group's layers, and where their inputs stand on its vertices.

    Attributes:
        surfaces: The layers, base first; without maps.
        weights: For each merge, its channel, or the weight itself where it is the same everywhere.
        own, row: Channel of the vertices' and of the rows' variation; None where it is 0.
        attributes: Names of the mesh attributes; channel c is component c % 3 of number c // 3.
        lanes: In their place ``kept.Lanes``, and which of its channels each is.
    """

    surfaces: tuple[Surface, ...]
    weights: tuple[int | float, ...]
    own: int | None
    row: int | None
    attributes: tuple[str, ...]
    lanes: tuple[Any, tuple[int, ...]] | None = None

    @property
    def constant(self) -> bool:
        """Whether nothing varies over the surface."""
        return not (self.attributes or (self.lanes and self.lanes[1]))


def pack(surfaces: Sequence[Surface], flat: FlatMesh) -> tuple[Mix, dict[str, NDArray[np.float32]]]:
    """Put what varies into as few attributes as hold it; of kept instances it is in ``flat.lanes``.

    Args:
        surfaces: The layers.
        flat: Their mesh.

    Returns:
        The mix, and the attributes by name, float32 [n, channels].
    """
    channels: list[NDArray[np.float32]] = []
    lane_of: list[int] = []

    def channel(values: NDArray[np.float32], lane: int) -> int:
        channels.append(values)
        lane_of.append(lane)
        return len(channels) - 1

    places: list[int | float] = []
    for merge, values in enumerate(flat.weights):
        same = bool(np.all(values == values[:1]))
        places.append(float(values[0]) if same else channel(values, 2 + merge))
    own, row = flat.variation, flat.row_variation
    at_own = channel(own, 0) if own is not None and own.any() else None
    at_row = channel(row, 1) if row is not None and row.any() else None
    attributes = {}
    for first in range(0, len(channels) if flat.lanes is None else 0, _PACK):
        columns = channels[first : first + _PACK]
        if len(columns) > 1:
            # Attributes have one channel or three.
            columns = [*columns, *[np.zeros_like(columns[0])] * (_PACK - len(columns))]
        attributes[f"vertex_mix_{first // _PACK}"] = np.stack(columns, axis=1)
    lanes = None if flat.lanes is None else (flat.lanes, tuple(lane_of))
    return Mix(tuple(surfaces), tuple(places), at_own, at_row, tuple(attributes), lanes), attributes


def glosses_of(mix: Mix) -> list[Gloss]:
    """Kind of lobe of each layer."""
    varies = mix.own is not None or mix.row is not None
    return [Gloss(s.roughness, s.roughness_variation * varies) for s in mix.surfaces]


def texture(mi: Any, mix: Mix, kind: str, lobe: int = 0) -> Any:
    """One quantity of a mix as a texture object.

    Args:
        mi: Mitsuba.
        mix: The layers.
        kind: "diffuse": albedo of the Lambert lobe, as a share of what the GGX lobes leave.
            "gloss": weight of all GGX lobes. "part": weight of lobe ``lobe`` among those up to it.
            "tint": its color. "alpha": its GGX's.
        lobe: Number of a lobe, in the order in which layers first have them.
    """
    made = mi.load_dict({"type": register(mi)})
    made.prepare(mix, kind, lobe)
    return made


def lobes_of(mix: Mix) -> list[Gloss]:
    """Distinct GGX lobes of the layers that have one, in order."""
    kinds = zip(mix.surfaces, glosses_of(mix), strict=True)
    return list(dict.fromkeys(gloss for surface, gloss in kinds if surface.glossy))


def channels_of(mi: Any, mix: Mix, si: Any, active: Any) -> list[Any]:
    """What varies, at a point of the surface."""
    if mix.lanes is not None:
        lanes, which = mix.lanes
        return [lanes.at(mi, channel, si.prim_index, active) for channel in which]
    found: list[Any] = []
    count = 1 + max((c for c in (*mix.weights, mix.own, mix.row) if isinstance(c, int)), default=-1)
    for index, name in enumerate(mix.attributes):
        if count - _PACK * index == 1:
            found.append(si.shape.eval_attribute_1(name, si, active))
        else:
            value = si.shape.eval_attribute_3(name, si, active)
            found.extend([value.x, value.y, value.z])
    return found


@lru_cache(maxsize=1)
def register(mi: Any) -> str:
    """Define the texture for the variant that is set, and register it; returns its name."""
    import drjit as dr

    class LayerMix(mi.Texture):
        """See the module. Set up by ``prepare``, never by Mitsuba's own parameters."""

        def prepare(self, mix: Mix, kind: str, lobe: int) -> None:
            self.mix, self.kind = mix, kind
            lobes = lobes_of(mix)
            self.lobe_of = [
                lobes.index(gloss) if surface.glossy else -1
                for surface, gloss in zip(mix.surfaces, glosses_of(mix), strict=True)
            ]
            self.lobe = lobe

            def number(value: float) -> Any:
                # Opaque: another scene's numbers are no other kernel to compile.
                return dr.opaque(mi.Float, float(value))

            self.weights = [w if isinstance(w, int) else number(w) for w in mix.weights]
            self.colors = [[number(v) for v in s.base_color] for s in mix.surfaces]
            self.amounts = [number(s.variation) for s in mix.surfaces]
            self.metals = [number(s.metallic) for s in mix.surfaces]
            self.whites = [number((1.0 - s.metallic) * s.specular) for s in mix.surfaces]
            if kind == "alpha":
                self.roughness, self.swing = (number(value) for value in lobes[lobe])

        def _shares(self, channels: list[Any]) -> list[Any]:
            shares: list[Any] = []
            rest = mi.Float(1.0)
            for merge in reversed(range(len(self.weights))):
                weight = self.weights[merge]
                weight = channels[weight] if isinstance(weight, int) else weight
                shares.append(weight * rest)
                rest = (1.0 - weight) * rest
            return [rest, *reversed(shares)]

        def _color(self, layer: int, channels: list[Any]) -> Any:
            factor = mi.Float(1.0)
            if self.mix.surfaces[layer].variation != 0.0:
                factor = self._factor(self.amounts[layer], channels)
            red, green, blue = self.colors[layer]
            return dr.clip(mi.Color3f(red, green, blue) * factor, 0.0, 1.0)

        def _factor(self, amount: Any, channels: list[Any]) -> Any:
            factor = mi.Float(1.0)
            for place in (self.mix.own, self.mix.row):
                if place is not None:
                    factor *= 1.0 + amount * channels[place]
            return factor

        def _gloss(self, layer: int, shares: list[Any]) -> Any:
            return shares[layer] * (self.whites[layer] + self.metals[layer])

        def _sum(self, shares: list[Any], upto: int, only: bool = False) -> Any:
            """Weight of the lobes up to one (or of that one alone)."""
            total = mi.Float(0.0)
            for layer, lobe in enumerate(self.lobe_of):
                if lobe == upto or (0 <= lobe < upto and not only):
                    total += self._gloss(layer, shares)
            return total

        def eval(self, si: Any, active: Any = True) -> Any:
            channels = channels_of(mi, self.mix, si, active)
            shares = self._shares(channels)
            if self.kind == "diffuse":
                color = mi.Color3f(0.0)
                for layer, share in enumerate(shares):
                    dull = 1.0 - self.metals[layer] - self.whites[layer]
                    color += share * dull * self._color(layer, channels)
                left = 1.0 - self._sum(shares, len(self.lobe_of))
                return dr.clip(color / dr.maximum(left, 1e-6), 0.0, 1.0) & active
            if self.kind == "tint":
                color = mi.Color3f(0.0)
                for layer, lobe in enumerate(self.lobe_of):
                    if lobe == self.lobe:
                        metal = self.metals[layer]
                        tint = self.whites[layer] + metal * self._color(layer, channels)
                        color += shares[layer] * tint
                weight = self._sum(shares, self.lobe, only=True)
                tinted = dr.clip(color / dr.maximum(weight, 1e-12), 0.0, 1.0)
                return dr.select(weight > 0.0, tinted, 1.0) & active
            return mi.Color3f(self.eval_1(si, active))

        def eval_1(self, si: Any, active: Any = True) -> Any:
            channels = channels_of(mi, self.mix, si, active)
            if self.kind == "alpha":
                varied = self.roughness * self._factor(self.swing, channels)
                return dr.maximum(dr.square(dr.clip(varied, 0.0, 1.0)), MIN_ALPHA)
            shares = self._shares(channels)
            if self.kind == "gloss":
                return dr.clip(self._sum(shares, len(self.lobe_of)), 0.0, 1.0) & active
            below = self._sum(shares, self.lobe)
            own = self._sum(shares, self.lobe, only=True)
            return dr.select(below > 0.0, own / dr.maximum(below, 1e-12), 0.0) & active

        def mean(self) -> Any:
            return mi.Float(0.5)

        def is_spatially_varying(self) -> bool:
            return True

        def to_string(self) -> str:
            return "LayerMix[]"

    mi.register_texture(PLUGIN, LayerMix)
    return PLUGIN
