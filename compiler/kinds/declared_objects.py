"""Declares keys of objects."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, Literal

from scenec.compiler.distributions.numbers import Number
from scenec.compiler.kinds.declare import Form, bounded, key
from scenec.compiler.kinds.forms import (
    CHOICE,
    CONSTANT,
    COUNT,
    FRACTION_PER_BATCH,
    FRACTION_PER_INSTANCE,
    LENGTH_PER_BATCH,
    LENGTH_PER_INSTANCE,
    PER_BATCH,
    PER_INSTANCE,
    TEXT,
    TRUTH,
    WHOLE_PER_BATCH,
    WORDS,
    an,
    file,
    list_of,
)


@dataclass(frozen=True, kw_only=True)
class ObjectsScattered:
    """Keys of every class of scattered objects: how many, where, and how they stand."""

    EXAMPLE: ClassVar = {
        "per_m2": 2,
        "labels": {"class": "rock"},
        "density": {"type": "noise", "scale_m": 10},
        "where": [{"type": "slope", "max_deg": 30}],
        "embed": 0.2,
    }

    SHARED: ClassVar = "objects_scattered"
    count: int | None = key(WHOLE_PER_BATCH, optional=True, at_least=0, at_most=100_000_000)
    """Number of instances, met exactly. One of count and per_m2 is given, or neither where size_m
    is drawn from golombek_rapp, which says itself how many there are."""
    per_m2: float | None = key(
        PER_BATCH, optional=True, at_least=0, at_most=1000000000000.0, unit="1/m^2"
    )
    """Number per square meter of the terrain in plan: the count is this times the terrain's area,
    times the part of the density that where leaves, rounded up or down at random."""
    labels: Mapping[str, Any] = key(an("label_choice"), default={})
    """The objects' label on every level."""
    instances: bool = key(TRUTH, default=True)
    """Whether each object has an instance id."""
    density: Mapping[str, Any] = key(an("density"), default={"type": "uniform"})
    """How many there are in one place compared with another."""
    where: Any = key(list_of(an("objects_where")), default=[])
    """Conditions on the place, multiplied with the density."""
    beyond_m: float | None = key(LENGTH_PER_BATCH, optional=True, above=0, at_most=1_000_000)
    """Where given, they lie on the land of terrain.horizon instead: from the terrain's border up to
    so far beyond it. per_m2 and size_m are then of that land, and conditions are of its heights; it
    has no materials or craters that a condition or density could ask for. At least a 46th of the
    terrain's longer side."""
    apart: Mapping[str, Any] | None = key(an("objects_apart"), optional=True)
    """Keeps objects from overlapping in plan; left out, they may."""
    shortfall: Literal["error", "fewer"] = key(CHOICE, default="error")
    """What to do where not all of them can be placed: error, or fewer, which leaves gaps in the
    ids."""
    clearance_m: float = key(CONSTANT, default=0, at_least=-1_000_000, at_most=1000000.0, unit="m")
    """Least distance from any camera of any sample to an object's geometry; an object that is
    nearer is put elsewhere, so at 0 no camera is inside of one, and may be under a tree's crown.
    Below 0, cameras may also be in the geometry, so far within the ball around it; -1000000:
    anywhere. The geometry counts as a 48th of its size larger at most."""
    orientation: Literal["random", "upright", "normal"] | None = key(CHOICE, optional=True)
    """random: any; upright: turned about the vertical only; normal: turned about the ground's
    normal only. Left out: normal for slabs, random for other rocks, upright for meshes."""
    lean_deg: Number | None = key(PER_INSTANCE, optional=True, at_least=0, at_most=180, unit="deg")
    """How far the axis that orientation keeps leans over, toward a random side; not for random,
    which is any already."""
    embed: Number = key(FRACTION_PER_INSTANCE, default={"type": "uniform", "min": 0.1, "max": 0.4})
    """Fraction of an object's own height that is below the surface."""
    lod_px: float = key(CONSTANT, default=0.5, at_least=0, at_most=1000)
    """Largest error of an object's shape (of plants, the root mean square by which corners of
    leaves move), in pixels of the nearest view: each gets the coarsest level that keeps to it. 0:
    always the finest level, as without cameras."""


@dataclass(frozen=True, kw_only=True)
class Model:
    """A mesh from a file, with its parts, materials and pictures."""

    EXAMPLE: ClassVar = {"file": "rock.obj", "unit_m": 0.01, "up": "y"}

    file: Path = key(file("model"))
    """A .glb, .gltf, .obj, .ply, .stl, .off, .usd, .usda, .usdc, .usdz or .blend file: relative to
    the cfg, or "package:NAME/path" in an installed Python package, where * stands for any part of a
    name. What it refers to (materials, pictures, buffers) lies beside or below it. .ply and .stl
    need the extra meshes, .blend the extra cycles, and no script in it is run."""
    part: str | None = key(WORDS, optional=True)
    """One of the file's meshes: a name, or a path down to it; what stands under that name comes
    along. Left out, all of them."""
    unit_m: float | None = key(CONSTANT, optional=True, above=0, at_most=1_000_000, unit="m")
    """Meters per unit of the file. Left out, what the file says: 1 in glTF, metersPerUnit in USD,
    the scene's unit in .blend; OBJ, PLY, STL and OFF say nothing."""
    up: Literal["x", "y", "z", "-x", "-y", "-z"] | None = key(CHOICE, optional=True)
    """The file's upward axis. Left out, what the file says: y in glTF, upAxis in USD, z in .blend;
    OBJ, PLY, STL and OFF say nothing."""
    origin: Any | None = key(
        Form(
            {
                "type": ["string", "array"],
                "if": {"type": "string"},
                "then": {"enum": ["base"]},
                "else": {
                    "minItems": 3,
                    "maxItems": 3,
                    "items": {
                        "description": "Along one axis.",
                        "type": "number",
                        "minimum": -1_000_000_000,
                        "maximum": 1_000_000_000,
                    },
                },
            }
        ),
        optional=True,
        unit="m",
    )
    """Which of its points stands on the pose, is what scales and turns leave in place. Left out,
    the file's own origin; base: the middle of its extent in plan, at its lowest height; or a point:
    x, y, z in meters with z up, once unit_m and up are applied. Vertices are moved by it in double
    precision: files in map coordinates need it."""
    weight: float = key(CONSTANT, default=1, at_least=0, at_most=1_000_000)
    """How often it is taken, beside the others."""


@dataclass(frozen=True, kw_only=True)
class ModelPart:
    """What one part of a class's models has of its own."""

    EXAMPLE: ClassVar = {"material": "rubber", "labels": {"surface": "wheel"}}

    TITLE: ClassVar = "Part of a model"
    material: str | None = key(TEXT, optional=True)
    """Name of a material, in place of the file's."""
    labels: Mapping[str, Any] = key(an("label_choice"), default={})
    """Its label on the levels where it differs from the class's."""


@dataclass(frozen=True, kw_only=True)
class ObjectDetail:
    """How much geometry all objects have together."""

    EXAMPLE: ClassVar = {"max_triangles": 20_000_000}

    TITLE: ClassVar = "Object detail"
    max_triangles: int | None = key(COUNT, optional=True, at_least=1, at_most=10_000_000_000)
    """Most triangles of all objects together, each instance counted as if it were written out, as
    some renderers do. Levels of detail are then chosen for errors larger than lod_px, by one factor
    for all classes; the report says by how much. Left out, lod_px alone decides."""


@dataclass(frozen=True, kw_only=True)
class ObjectPose:
    """Where one object is."""

    EXAMPLE: ClassVar = {"x_m": 0, "y_m": 4, "rotation_deg": [0, 0, 30]}

    TITLE: ClassVar = "Pose of an object"
    x_m: float = key(LENGTH_PER_BATCH, at_least=-1000000000.0, at_most=1000000000.0)
    """East."""
    y_m: float = key(LENGTH_PER_BATCH, at_least=-1000000000.0, at_most=1000000000.0)
    """North."""
    z_m: float = key(LENGTH_PER_BATCH, default=0, at_least=-1000000000.0, at_most=1000000000.0)
    """Height of the object's origin, see heights."""
    rotation_deg: Any = key(
        list_of(
            bounded(PER_BATCH, at_least=-360, at_most=360, unit="deg"),
            "About one axis.",
            least=3,
            most=3,
        ),
        default=[0, 0, 0],
        unit="deg",
    )
    """Turns about the world's x, y and z, in that order; the last is counterclockwise seen from
    above."""
    scale: float = key(PER_BATCH, default=1, above=0, at_most=1_000_000)
    """Factor on its size."""
    model: int = key(COUNT, default=0, at_least=0, at_most=999)
    """Which of the models: its index, from 0."""


@dataclass(frozen=True, kw_only=True)
class ObjectsApart:
    """Distances in plan between objects, as circles."""

    EXAMPLE: ClassVar = {"gap_m": 1, "radius": 0.3}

    gap_m: float = key(LENGTH_PER_BATCH, default=0, at_least=0, at_most=1000000.0)
    """Least gap between two circles."""
    radius: float = key(PER_BATCH, default=1, at_least=0, at_most=100)
    """A circle's radius, in radii of the ball around its object. Rocks are narrower than their
    ball: 1 keeps all apart, 0.7 lets some touch."""
    of: Any | None = key(list_of(TEXT, least=1, unique=True), optional=True)
    """Classes to keep apart from: this one, or earlier ones, whose own apart does not matter. Left
    out: this one."""


@dataclass(frozen=True, kw_only=True)
class ObjectsMeshes(ObjectsScattered):
    """Models from files, scattered over the terrain: plants, boulders, debris."""

    EXAMPLE: ClassVar = {
        "type": "meshes",
        "models": [{"file": "birch.glb"}],
        "labels": {"class": "tree"},
        "per_m2": 0.005,
        "apart": {"gap_m": 1},
    }

    models: Any = key(list_of(an("model"), "One model.", least=1, most=1000))
    """The models; each instance is one of them."""
    material: str | None = key(TEXT, optional=True)
    """Name of a material for all of it, in place of the files' own. Left out, each file's own
    materials; what has none is gray."""
    parts: Any = key(
        Form(
            {
                "type": "object",
                "additionalProperties": {"description": "One part.", "$ref": "#/$defs/model_part"},
                "x-name": "part",
            }
        ),
        default={},
    )
    """Parts of the models that differ from the class: by the name of a mesh, of what stands above
    it in the file, or of one of the file's materials. Of several that fit a face, the last counts.
    """
    scale: Number = key(PER_INSTANCE, default=1, above=0, at_most=1_000_000)
    """Factor on a model's size."""
    variation: float = key(FRACTION_PER_BATCH, default=0)
    """How much the albedo of the files' own materials varies from instance to instance: base_color
    (1 + variation v), v in [-1, 1]."""
    seat: Literal["origin", "touch"] = key(CHOICE, default="origin")
    """What stands on the ground: origin, the file's, where plants and made things have their foot;
    or touch, whichever vertex meets it first, as rocks do."""
    embed: Number = key(FRACTION_PER_INSTANCE, default=0)
    """Fraction of an object's own height that is below the surface."""


@dataclass(frozen=True, kw_only=True)
class ObjectsPlaced:
    """Single objects at given poses: a lander, a target, a calibration board.

    Their poses may change with time.
    """

    EXAMPLE: ClassVar = {
        "type": "placed",
        "models": [{"file": "lander.glb"}],
        "labels": {"class": "lander"},
        "poses": [{"x_m": 0, "y_m": 4}],
        "orientation": "normal",
    }

    models: Any = key(list_of(an("model"), "One model.", least=1, most=1000))
    """The models; each instance is one of them."""
    material: str | None = key(TEXT, optional=True)
    """Name of a material for all of it, in place of the files' own. Left out, each file's own
    materials; what has none is gray."""
    parts: Any = key(
        Form(
            {
                "type": "object",
                "additionalProperties": {"description": "One part.", "$ref": "#/$defs/model_part"},
                "x-name": "part",
            }
        ),
        default={},
    )
    """Parts of the models that differ from the class: by the name of a mesh, of what stands above
    it in the file, or of one of the file's materials. Of several that fit a face, the last counts.
    """
    labels: Mapping[str, Any] = key(an("label_choice"), default={})
    """The objects' label on every level."""
    instances: bool = key(TRUTH, default=True)
    """Whether each object has an instance id."""
    poses: Any | None = key(
        list_of(an("object_pose"), "One object.", least=1, most=100000), optional=True
    )
    """Where the objects are, one entry each; or give file."""
    file: Path | None = key(file("poses"), optional=True)
    """A CSV file of poses whose header names its columns: x_m, y_m; z_m (else 0); qw, qx, qy, qz
    (else not turned); scale (else 1); model (index into models, else 0); id (the object's local
    instance id, from 1); time_s. Rows of one id are one object at several times, between which it
    moves; without id, rows with time_s are one object and rows without are copies. Relative to the
    cfg."""
    heights: Literal["ground", "world"] = key(CHOICE, default="ground")
    """What heights are over: the ground below the object's origin, or the world's zero."""
    orientation: Literal["upright", "normal"] = key(CHOICE, default="upright")
    """upright: as the pose says; normal: the pose's turn, then tilted with the ground under the
    object."""


@dataclass(frozen=True, kw_only=True)
class ObjectsRocks(ObjectsScattered):
    """Procedural rocks scattered over the terrain."""

    EXAMPLE: ClassVar = {
        "type": "rocks",
        "count": 2000,
        "material": "basalt",
        "labels": {"class": "rock"},
        "family": "angular",
        "size_m": {"type": "log_uniform", "min": 0.05, "max": 0.8},
    }

    KEYWORDS: ClassVar = {"x-kinds": "family"}

    material: str = key(TEXT)
    """Name of a material."""
    family: Any = key(
        Form(
            {
                "x-open": "scenec.rocks",
                "enum": [
                    "weathered",
                    "angular",
                    "rounded",
                    "slab",
                    "vesicular",
                    "ventifact",
                    "bedded",
                    "breccia",
                ],
            }
        ),
        default="weathered",
    )
    """Kind of rock. weathered: worn blocks with spalls and pits, by angularity. angular: broken
    along planes, corners chipped, faces of fresh breaks lighter. rounded: cobbles. slab: layered
    plates with stepped sides, which lie flat unless orientation says otherwise. vesicular: basalt
    with bubbles, darker inside. ventifact: faces that blown sand has cut, meeting in keels; one
    face of each looks into the wind of the relief's dunes, barchans or ripples, or else into one
    that is drawn for the batch. bedded: blocks of layered rock, soft beds weathered back. breccia:
    angular pieces in a matrix that has weathered back. Ventifacts and bedded blocks stand upright
    on the ground unless orientation says otherwise."""
    prototypes: int = key(WHOLE_PER_BATCH, default=6, at_least=1, at_most=64)
    """Number of different shapes."""
    subdivisions: int = key(WHOLE_PER_BATCH, default=3, at_least=1, at_most=6)
    """Subdivisions of a shape's icosahedron: 20 * 4^n triangles at the finest level."""
    size_m: Number = key(LENGTH_PER_INSTANCE, above=0, at_most=1_000_000)
    """Diameter of a rock."""
    elongation: float | None = key(PER_BATCH, optional=True, at_least=0, at_most=0.9)
    """How much narrower than long a rock is: 1 - b/a, on average over the shapes. Left out, it is
    that of the family: weathered 0.18, angular 0.29, rounded 0.22, slab 0.25, vesicular 0.2,
    ventifact 0.28, bedded 0.25, breccia 0.22."""
    flatness: float | None = key(PER_BATCH, optional=True, at_least=0, at_most=0.9)
    """How much lower than long a rock is: 1 - c/a, on average over the shapes. Left out, it is that
    of the family: weathered 0.4, angular 0.5, rounded 0.45, slab 0.8, vesicular 0.35, ventifact
    0.5, bedded 0.45, breccia 0.4."""
    angularity: float = key(FRACTION_PER_BATCH, default=0.6)
    """From rounded (0) to broken along flat faces (1); of the family weathered only."""
    wear: float | None = key(FRACTION_PER_BATCH, optional=True)
    """How far edges are worn off: 0 is freshly broken; of all families but weathered. Left out, it
    is that of the family: angular 0.1, rounded 0.7, slab 0.15, vesicular 0.4, ventifact 0.12,
    bedded 0.35, breccia 0.4."""
    bumpiness: float = key(FRACTION_PER_BATCH, default=0.3)
    """Height of the small relief on a rock; 0 is smooth."""
    coatings: Any = key(list_of(an("objects_rocks_coating"), "One coating.", most=8), default=[])
    """What lies on the rocks, the lowest first: dust, snow, moss, a wet foot. Rocks turned at
    random have none, for they have no top in common."""
    fillet: Mapping[str, Any] | None = key(an("objects_rocks_fillet"), optional=True)
    """Fines heaped about the feet of the rocks; left out, there are none."""


@dataclass(frozen=True, kw_only=True)
class ObjectsRocksCoating:
    """A material on rocks as they rest: on what faces up, in hollows, and next to the ground.

    Labels do not heed it.
    """

    EXAMPLE: ClassVar = {"material": "dust", "tops": 0.7, "foot_height": 0.2}

    TITLE: ClassVar = "Objects: rocks: coating"
    material: str = key(TEXT)
    """Name of a material."""
    tops: float = key(FRACTION_PER_BATCH, default=0.8)
    """Share of what faces up that it covers; ridges stay bare."""
    max_slope_deg: float = key(PER_BATCH, default=35, at_least=0, at_most=180, unit="deg")
    """Steepest slope that it lies on; it thins out over 12 degrees to either side."""
    hollows: float = key(FRACTION_PER_BATCH, default=0.6)
    """Share that it covers of hollows, unless they face down."""
    foot: float = key(FRACTION_PER_BATCH, default=1)
    """Share that it covers of a rock next to the ground, where the mean embed of its class puts
    that."""
    foot_height: float = key(PER_BATCH, default=0.15, at_least=0.01, at_most=1)
    """How far up from the ground the foot reaches, in parts of a rock's height."""


@dataclass(frozen=True, kw_only=True)
class ObjectsRocksFillet:
    """A ramp of the ground about a rock's foot: highest where it meets the rock, level where it
    ends, higher and longer on some sides than on others (by up to 70 %). It is detail of the
    ground's mesh, as fine as cameras see it, and keeps the ground's material and labels. Rocks stay
    where they are, a little deeper in the ground, and of what stands out of it no more than 30 %
    counts as the height; classes after them are seated on it, poses of cameras do not heed it.
    Where the fillets of a class overlap, the highest counts. Rocks have none that is lower than
    twice the mesh's tolerance_px in the nearest view, and none where the terrain is a mesh, where
    its mesh is the plain grid (terrain.mesh.tolerance_px 0), or without cameras.
    """

    EXAMPLE: ClassVar = {"height": {"type": "uniform", "min": 0.04, "max": 0.1}, "reach": 0.4}

    TITLE: ClassVar = "Objects: rocks: fillet"
    height: Number = key(
        FRACTION_PER_INSTANCE, default={"type": "uniform", "min": 0.04, "max": 0.12}
    )
    """Height where it meets the rock, in parts of the rock's size."""
    reach: Number = key(
        PER_INSTANCE,
        default={"type": "uniform", "min": 0.25, "max": 0.6},
        at_least=0.01,
        at_most=10,
    )
    """How far from the rock it ends, in parts of the rock's size."""
