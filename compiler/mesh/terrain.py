"""Declares the terrain: what a cfg says of it and its ground, and what must hold between keys."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, ClassVar

from scenec.compiler.kinds import Finding, Form, Node, an, bounded, forms, key, list_of, unknown
from scenec.schemas.codec import JsonObject
from scenec.schemas.spelling import shown

#: Height samples of a terrain at most (2 GiB of float64).
MAX_HEIGHT_SAMPLES = 2**28
_BASES = ("plane", "dem", "mesh")
#: What is said of keys that the first layer cannot have.
_OF_LATER = "the first layer is the base and covers all; only later layers have this key"


@dataclass(frozen=True, kw_only=True)
class Terrain:
    """A rectangle centered on the origin, with a relief and a ground cover."""

    EXAMPLE: ClassVar = {
        "size_m": [60, 60],
        "spacing_m": 0.15,
        "relief": [{"type": "plane"}],
        "ground": [{"material": "sand"}],
    }

    size_m: tuple[float, float] = key(
        list_of(
            bounded(forms.LENGTH_PER_BATCH, above=0, at_most=10_000_000),
            "Extent along one axis.",
            least=2,
            most=2,
        )
    )
    """Extent in x (east) and y (north)."""
    spacing_m: float = key(forms.LENGTH_PER_BATCH, above=0, at_most=1_000_000)
    """Largest distance between neighboring height samples."""
    relief: tuple[Any, ...] = key(list_of(an("relief"), "One relief operator.", least=1))
    """Operators that shape the terrain, in order, the first a base (plane, dem or mesh)."""
    ground: tuple[Any, ...] = key(
        Form(
            {
                "type": "array",
                "minItems": 1,
                "prefixItems": [{"description": "The base layer.", "$ref": "#/$defs/ground_base"}],
                "items": {"description": "A later layer.", "$ref": "#/$defs/ground_layer"},
            }
        )
    )
    """Layers of material: the base layer, without noise, then later layers, each merged by noise
    over those before: colors smoothly, labels sharply."""
    shades: tuple[Any, ...] = key(
        list_of(an("terrain_shade"), "One kind of place.", least=1), sparse=True
    )
    """Where the ground is darker or lighter."""
    mesh: JsonObject = key(an("terrain_mesh"), default={})
    """How fine the mesh is."""
    horizon: JsonObject = key(an("terrain_horizon"), sparse=True)
    """Land beyond the border: hills, crater rims, mesas. Left out, the terrain ends there."""
    planet: JsonObject = key(an("terrain_planet"), sparse=True)
    """The sphere that the ground curves as. Left out, it lies on a plane."""

    @staticmethod
    def check(node: Node) -> Iterator[Finding]:
        """Yields a relief without a base, too many samples, a horizon that has no border."""
        yield from _without_base(node)
        spacing = node.span("spacing_m")
        x, y = (node.at("size_m").span(axis) for axis in (0, 1))
        if spacing is not None and x is not None and y is not None:
            counts = [math.ceil(min(size[1] / spacing[0], 1e18)) + 1 for size in (x, y)]
            if counts[0] * counts[1] > MAX_HEIGHT_SAMPLES:
                enough = math.sqrt(x[1] * y[1] / MAX_HEIGHT_SAMPLES)
                yield node.fault(
                    f"{spacing[0]:g} m on {x[1]:g} m by {y[1]:g} m makes "
                    f"{counts[0] * counts[1]:.3g} height samples, at most "
                    f"{MAX_HEIGHT_SAMPLES:.3g} are taken: expected a spacing of "
                    f"{1.01 * enough:.3g} m or more, or a smaller terrain",
                    "spacing_m",
                )
        if "horizon" in node and any(o["surface"] == "mesh" for o in node.each("relief", "*")):
            yield node.key_fault(
                "it begins at the terrain's border, and a mesh that is kept has none: take it "
                'away, or say "surface": "heights" of the mesh',
                "horizon",
            )


@dataclass(frozen=True, kw_only=True)
class TerrainHorizon:
    """Land beyond the terrain's border: one mesh without a gap, coarser with distance, cast,
    labeled and lit as the terrain, to the same tolerance. Objects with beyond_m lie on it; cameras
    stay on the terrain.
    """

    EXAMPLE: ClassVar = {
        "reach_m": 6000,
        "relief": [
            {"type": "plane"},
            {
                "type": "multifractal",
                "variant": "ridged",
                "amplitude_m": 300,
                "scale_m": 2500,
                "mask": [{"type": "point", "x_m": 0, "y_m": 0, "min_m": 2500, "softness_m": 3000}],
            },
        ],
        "material": "sand",
        "labels": {"class": "ground"},
    }

    reach_m: float = key(forms.LENGTH_PER_BATCH, above=0, at_most=1_000_000)
    """How far it goes beyond the border."""
    spacing_m: float | None = key(forms.LENGTH_PER_BATCH, optional=True, above=0, at_most=1_000_000)
    """Largest distance of its height samples; left out, a 256th of its extent. Noises show what is
    finer all the same."""
    blend_m: float = key(forms.LENGTH_PER_BATCH, default=60, above=0, at_most=1_000_000)
    """Width over which heights and materials of the border give way to its own."""
    relief: tuple[Any, ...] = key(list_of(an("relief"), "One relief operator.", least=1))
    """Its operators, in order, about the terrain's center, the first a base (plane or dem)."""
    material: str = key(forms.TEXT)
    """Name of a material, whose displacement does not show. Pictures with size_m of hundreds of
    meters give far slopes detail."""
    labels: JsonObject = key(an("label_choice"), default={})
    """Its label on every level."""

    @staticmethod
    def check(node: Node) -> Iterator[Finding]:
        """Yields a relief without a base, a mesh that is kept, too many samples."""
        yield from _without_base(node)
        for operator in node.each("relief", "*"):
            if operator["type"] == "mesh" and operator["surface"] == "mesh":
                yield operator.fault('a horizon keeps no mesh: expected "surface": "heights"')
        spacing, reach = node.span("spacing_m"), node.span("reach_m")
        terrain = node.whole().at("terrain", "size_m")
        sizes = [terrain.span(axis) for axis in (0, 1)]
        if spacing is None or reach is None or None in sizes:
            return
        counts = [(size[1] + 2.0 * reach[1]) / spacing[0] + 2.0 for size in sizes if size]
        if counts[0] * counts[1] > MAX_HEIGHT_SAMPLES:
            enough = spacing[0] * math.sqrt(counts[0] * counts[1] / MAX_HEIGHT_SAMPLES)
            yield node.fault(
                f"{spacing[0]:g} m up to {reach[1]:g} m beyond the border makes "
                f"{counts[0] * counts[1]:.3g} height samples, at most {MAX_HEIGHT_SAMPLES:.3g} "
                f"are taken: expected a spacing of {1.01 * enough:.3g} m or more",
                "spacing_m",
            )


@dataclass(frozen=True, kw_only=True)
class GroundBase:
    """The first layer: what is seen where no later layer lies."""

    EXAMPLE: ClassVar = {"material": "sand", "labels": {"class": "ground"}}
    TITLE: ClassVar = "Ground: base layer"
    KEYWORDS: ClassVar = {
        "x-unknown": dict.fromkeys(("noise", "sharpness", "threshold", "coverage"), _OF_LATER)
    }

    material: str = key(forms.TEXT)
    """Name of a material."""
    labels: JsonObject = key(an("label_choice"), default={})
    """The layer's label on every level."""


@dataclass(frozen=True, kw_only=True)
class GroundLayerKeys:
    """A layer over those before it: where its noise passes the threshold and all conditions hold,
    the label is this layer's. The color blends about the border.
    """

    EXAMPLE: ClassVar = {
        "material": "dust",
        "labels": {"class": "ground"},
        "noise": {"scale_m": 7, "octaves": 4},
        "coverage": 0.25,
    }
    TITLE: ClassVar = "Ground: later layer"

    material: str = key(forms.TEXT)
    """Name of a material."""
    labels: JsonObject = key(an("label_choice"), default={})
    """The layer's label on every level."""
    noise: JsonObject = key(an("ground_noise"), default={})
    """Noise that says where the layer lies. Left out beside where, that alone says it."""
    where: Any | None = key(list_of(an("ground_where"), "One condition.", least=1), optional=True)
    """Conditions that must all hold where the layer lies."""
    sharpness: float = key(forms.PER_BATCH, default=5, above=0, at_most=1_000_000)
    """How fast the color changes across the border; larger is sharper."""
    threshold: float = key(forms.PER_BATCH, default=0.5, above=0, below=1)
    """Weight of the color at the border: at 0.5 it runs along the conditions' bounds, above it
    within them. Not with coverage."""
    coverage: float | None = key(forms.FRACTION_PER_BATCH, optional=True)
    """Fraction of the area that the layer covers, within its conditions; in place of threshold."""
    height_blend: float = key(forms.FRACTION_PER_BATCH, default=0)
    """Depth, as a share of the maps' range, over which height maps decide whether this layer or the
    one below is seen, so that stones stand out of sand. 0: the weights alone. Labels ignore it."""

    @staticmethod
    def check(node: Node) -> Iterator[Finding]:
        """Yields keys that do not go together, and a blend by heights where nothing has any."""
        yield from node.both("threshold", "coverage", "where the border lies")
        if "where" in node and "noise" not in node:
            for key in ("sharpness", "coverage"):
                if key in node:
                    yield node.key_fault(
                        f"{key} is of the noise, and a layer with where has none of its own: give "
                        "noise, too, or take it away",
                        key,
                    )
        span, cfg = node.span("height_blend"), node.whole()
        if span is None or span[1] <= 0.0:
            return
        maps = [
            cfg.at("materials", layer["material"], "maps")
            for layer in cfg.each("terrain", "ground", "*")
            if int(layer.path[-1]) <= int(node.path[-1])
        ]
        # What a folder holds is not known here.
        if not any(key in m for m in maps for key in ("displacement", "procedural", "folder")):
            yield node.fault(
                "neither the layer's material nor one below it has heights: expected maps with "
                "procedural, displacement or a folder that has one, or 0",
                "height_blend",
            )


@dataclass(frozen=True, kw_only=True)
class GroundNoise:
    """Fractal Perlin noise."""

    EXAMPLE: ClassVar = {"scale_m": 9, "octaves": 4, "gain": 0.45}

    scale_m: float = key(forms.LENGTH_PER_BATCH, default=10, above=0, at_most=1_000_000_000)
    """Size of the largest patches."""
    octaves: int = key(forms.WHOLE_PER_BATCH, default=4, at_least=1, at_most=24)
    """Number of octaves."""
    gain: float = key(forms.GAIN)
    lacunarity: float = key(forms.LACUNARITY)
    distortion: float = key(forms.PER_BATCH, default=0, at_least=0, at_most=10)
    """How far the patches are warped, as a fraction of their size."""


@dataclass(frozen=True, kw_only=True)
class Showing:
    """Where a ground material shows on the heights before the operator, by its color's weight."""

    EXAMPLE: ClassVar = {"type": "material", "material": "lava"}
    TITLE: ClassVar = "Mask: material"

    material: str = key(forms.TEXT)
    """Material of a ground layer; all layers of it count."""
    layer: int | None = key(forms.COUNT, optional=True, at_least=0, at_most=1000)
    """The one layer of it that counts: its index in ground, 0 for the base. Left out, all."""

    @staticmethod
    def check(node: Node) -> Iterator[Finding]:
        """Yields a material that does not lie on the ground, or a layer that is not of it."""
        ground = node.whole().each("terrain", "ground", "*")
        lies = {layer.path[-1]: layer["material"] for layer in ground}
        name, layer = node["material"], node["layer"]
        if name is None or not lies:
            return
        known = list(dict.fromkeys(filter(None, lies.values())))
        own = [i for i, other in lies.items() if other == name]
        if name not in known:
            yield node.fault(unknown("ground layer of the material", name, known), "material")
        elif layer is not None and layer not in own:
            expected = " or ".join(map(str, own))
            yield node.fault(
                f"{shown(layer)} is no layer of {shown(name)}: expected {expected}", "layer"
            )


def _without_base(node: Node) -> Iterator[Finding]:
    """Yields the first operator of a relief if it is no base."""
    first = node.at("relief", 0)
    if first["type"] not in (None, *_BASES):
        yield first.fault(
            f"{shown(first['type'])}: the first operator is the base: expected one of "
            f"{', '.join(_BASES)}",
            "type",
        )
