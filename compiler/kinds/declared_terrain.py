"""Declares keys of terrain."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

from scenec.compiler.kinds.declare import Form, bounded, key
from scenec.compiler.kinds.finding import Finding
from scenec.compiler.kinds.forms import (
    CONSTANT,
    COUNT,
    FRACTION_PER_BATCH,
    GAIN,
    LACUNARITY,
    LENGTH_PER_BATCH,
    PER_BATCH,
    TEXT,
    WHOLE_PER_BATCH,
    an,
    list_of,
)
from scenec.compiler.kinds.node import Node

#: What is said of keys that the first layer cannot have.
_OF_LATER = "the first layer is the base and covers all; only later layers have this key"


@dataclass(frozen=True, kw_only=True)
class GroundBase:
    """The first layer: what is seen where no later layer lies."""

    EXAMPLE: ClassVar = {"material": "sand", "labels": {"class": "ground"}}

    KEYWORDS: ClassVar = {
        "x-unknown": {
            "noise": _OF_LATER,
            "sharpness": _OF_LATER,
            "threshold": _OF_LATER,
            "coverage": _OF_LATER,
        }
    }

    TITLE: ClassVar = "Ground: base layer"
    material: str = key(TEXT)
    """Name of a material."""
    labels: Mapping[str, Any] = key(an("label_choice"), default={})
    """The layer's label on every level."""


@dataclass(frozen=True, kw_only=True)
class GroundLayer:
    """A layer merged over those before it: where its noise passes the threshold and all its
    conditions hold, the label is this layer's. The color blends about the border.
    """

    EXAMPLE: ClassVar = {
        "material": "dust",
        "labels": {"class": "ground"},
        "noise": {"scale_m": 7, "octaves": 4},
        "coverage": 0.25,
    }

    TITLE: ClassVar = "Ground: later layer"
    material: str = key(TEXT)
    """Name of a material."""
    labels: Mapping[str, Any] = key(an("label_choice"), default={})
    """The layer's label on every level."""
    noise: Mapping[str, Any] = key(an("ground_noise"), default={})
    """The noise that says where the layer lies. Left out beside where, the layer lies wherever that
    says."""
    where: Any | None = key(list_of(an("ground_where"), "One condition.", least=1), optional=True)
    """Conditions that must all hold where the layer lies."""
    sharpness: float = key(PER_BATCH, default=5, above=0, at_most=1_000_000)
    """How fast the color changes across the border; larger is sharper."""
    threshold: float = key(PER_BATCH, default=0.5, above=0, below=1)
    """Weight of the color at the border: at 0.5 it runs along the conditions' bounds, above it
    within them. Not together with coverage."""
    coverage: float | None = key(FRACTION_PER_BATCH, optional=True)
    """Fraction of the area that the layer covers: moves the noise's border in place of threshold,
    within what the conditions leave."""
    height_blend: float = key(FRACTION_PER_BATCH, default=0)
    """Depth over which the height maps of the layer and of what lies below it decide which of the
    two is seen, as a share of the maps' range, so that stones stand out of sand; 0: the weights
    alone blend them. Labels never heed it."""

    @staticmethod
    def check(node: Node) -> Iterator[Finding]:
        """A finding where it blends by heights that neither it nor what it lies on has."""
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

    scale_m: float = key(LENGTH_PER_BATCH, default=10, above=0, at_most=1_000_000_000)
    """Size of the largest patches."""
    octaves: int = key(WHOLE_PER_BATCH, default=4, at_least=1, at_most=24)
    """Number of octaves."""
    gain: float = key(GAIN)
    lacunarity: float = key(LACUNARITY)
    distortion: float = key(PER_BATCH, default=0, at_least=0, at_most=10)
    """How far the patches are warped, as a fraction of their size."""


@dataclass(frozen=True, kw_only=True)
class Terrain:
    """A rectangle centered on the origin, with a relief and a ground cover."""

    EXAMPLE: ClassVar = {
        "size_m": [60, 60],
        "spacing_m": 0.15,
        "relief": [{"type": "plane"}],
        "ground": [{"material": "sand"}],
    }

    size_m: Any = key(
        list_of(
            bounded(LENGTH_PER_BATCH, above=0, at_most=10_000_000),
            "Extent along one axis.",
            least=2,
            most=2,
        )
    )
    """Extent in x (east) and y (north)."""
    spacing_m: float = key(LENGTH_PER_BATCH, above=0, at_most=1_000_000)
    """Largest distance between neighboring height samples."""
    relief: Any = key(list_of(an("relief"), "One relief operator.", least=1))
    """Operators that shape the terrain, in order; the first must be a base (plane or dem)."""
    ground: Any = key(
        Form(
            {
                "type": "array",
                "minItems": 1,
                "prefixItems": [{"description": "The base layer.", "$ref": "#/$defs/ground_base"}],
                "items": {"description": "A later layer.", "$ref": "#/$defs/ground_layer"},
            }
        )
    )
    """Layers of material: first the base layer, which has no noise, then later layers. Each of
    those is merged over what comes before it by noise: colors smoothly, labels sharply."""
    shades: Any = key(list_of(an("terrain_shade"), "One kind of place.", least=1), sparse=True)
    """Where the ground is darker or lighter by what it is there."""
    mesh: Mapping[str, Any] = key(an("terrain_mesh"), default={})
    """How fine the mesh is."""
    horizon: Mapping[str, Any] = key(an("terrain_horizon"), sparse=True)
    """Land beyond the terrain's border: hills, crater rims, mesas. Left out, the terrain ends
    there."""


@dataclass(frozen=True, kw_only=True)
class TerrainHorizon:
    """Land beyond the terrain's border, for the distance: one mesh, coarser the farther it is,
    without gap at the border. It is cast, labeled and lit as the terrain is; objects with beyond_m
    lie on it, and cameras stay on the terrain. Its mesh keeps the tolerance of the terrain's.
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

    reach_m: float = key(LENGTH_PER_BATCH, above=0, at_most=1_000_000)
    """How far it goes beyond the border."""
    spacing_m: float | None = key(LENGTH_PER_BATCH, optional=True, above=0, at_most=1_000_000)
    """Largest distance between height samples of its relief; left out, a 256th of what it spans.
    Noises show what is finer all the same."""
    blend_m: float = key(LENGTH_PER_BATCH, default=60, above=0, at_most=1_000_000)
    """Width over which heights and materials of the border give way to its own."""
    relief: Any = key(list_of(an("relief"), "One relief operator.", least=1))
    """Operators that shape it, in order, about the terrain's center; the first must be a base
    (plane or dem)."""
    material: str = key(TEXT)
    """Name of a material; its displacement does not show. Pictures of a size_m of some hundred
    meters give far slopes stones and hollows down to the pixel."""
    labels: Mapping[str, Any] = key(an("label_choice"), default={})
    """Its label on every level."""


@dataclass(frozen=True, kw_only=True)
class TerrainMesh:
    """Triangles are as large as they can be without an error of tolerance_px showing in any view of
    the batch: of height, of the lines between labels, and of shading where legs of triangles are
    longer than six times that. Near a camera they become finer than the grid.
    """

    EXAMPLE: ClassVar = {"tolerance_px": 0.5, "max_triangles": 2_000_000}

    tolerance_px: float = key(CONSTANT, default=0.5, at_least=0, at_most=1000, unit="px")
    """Error that may show; 0 keeps every height sample."""
    max_triangles: int = key(COUNT, default=8_000_000, at_least=2, at_most=1_000_000_000)
    """Budget, before the mesh is cut along label lines; where it binds, the tolerance is raised and
    the one reached is reported."""
    unseen: float = key(CONSTANT, default=0.125, at_least=0, at_most=1)
    """Part that a pixel counts where no view shows the ground, which may still cast shadows and
    light into one."""
    finest_m: float | None = key(CONSTANT, optional=True, above=0, at_most=1_000_000, unit="m")
    """Shortest leg of a triangle that is still halved; left out, a 32nd of the terrain's spacing.
    At spacing_m or above, nothing is finer than the grid."""


@dataclass(frozen=True, kw_only=True)
class TerrainShade:
    """Ground that is darker or lighter where conditions hold: coarse lag on crests, dust in
    hollows, fresh soil on steep faces and in tracks. It crosses the borders of layers and has no
    label.
    """

    EXAMPLE: ClassVar = {
        "by": -0.8,
        "where": [{"type": "slope", "min_deg": 20, "softness_deg": 15}],
    }

    by: float = key(PER_BATCH, at_least=-2, at_most=2)
    """Added to the v of the materials' variation, which stays within [-1, 1]: the albedo is
    base_color (1 + variation v). Below 0 is darker."""
    where: Any = key(list_of(an("ground_where"), "One condition.", least=1))
    """Conditions, whose weights multiply; taken at the grid's samples."""
