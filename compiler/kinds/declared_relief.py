"""Declares keys of relief."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, Literal

from scenec.compiler.distributions.numbers import Number
from scenec.compiler.kinds.declare import Form, bounded, key
from scenec.compiler.kinds.forms import (
    ANGLE_PER_BATCH,
    CHOICE,
    CONSTANT,
    COUNT,
    FRACTION_PER_BATCH,
    GAIN,
    LACUNARITY,
    LENGTH_PER_BATCH,
    LENGTH_PER_INSTANCE,
    NOISE_SCALE_M,
    PER_BATCH,
    WHOLE_PER_BATCH,
    WIND_DEG,
    WORDS,
    an,
    file,
    list_of,
    one_of,
)


@dataclass(frozen=True, kw_only=True)
class DisplacementCrust:
    """A cemented crust on loose soil (duricrust), broken into plates.

    It ends where the layer does: a high sharpness of that makes a steep border.
    """

    EXAMPLE: ClassVar = {"type": "crust", "height_m": 0.02, "plate_m": 0.3}

    height_m: float = key(LENGTH_PER_BATCH, default=0.02, above=0, at_most=1_000_000)
    """Thickness: how high plates stand above the loose soil."""
    plate_m: float = key(LENGTH_PER_BATCH, default=0.3, above=0, at_most=1_000_000_000)
    """Width of a plate."""
    missing: float = key(FRACTION_PER_BATCH, default=0.25)
    """Share of the plates that are gone, in gaps of several."""


@dataclass(frozen=True, kw_only=True)
class DisplacementTerraces:
    """Cuts the ground, with what stands before it in the list, into steps, as layered rock
    weathers: level ledges as sharp as the mesh is fine.
    """

    EXAMPLE: ClassVar = {"type": "terraces", "step_m": 0.08, "riser": 0.2, "irregularity": 0.8}

    step_m: float = key(LENGTH_PER_BATCH, above=0, at_most=1_000_000_000)
    """Mean thickness of a layer."""
    riser: float = key(PER_BATCH, default=0.3, above=0, at_most=1)
    """Part of a layer's thickness that is steep."""
    tread_slope: float = key(FRACTION_PER_BATCH, default=0.2)
    """Part of their slope that the treads between the steep parts keep; 1 changes nothing."""
    irregularity: float = key(FRACTION_PER_BATCH, default=0.5)
    """How uneven the thicknesses of layers are."""
    bend_m: float = key(LENGTH_PER_BATCH, default=0, at_least=0, at_most=1_000_000_000)
    """How far layers bend up and down."""
    bend_scale_m: float = key(LENGTH_PER_BATCH, default=100, above=0, at_most=1_000_000_000)
    """Size of the bends."""


@dataclass(frozen=True, kw_only=True)
class DisplacementWorley:
    """Cellular relief: grains, pits or cracks around scattered points (Worley 1996)."""

    EXAMPLE: ClassVar = {"type": "worley", "amplitude_m": -0.012, "scale_m": 0.05}

    TITLE: ClassVar = "Displacement: Worley"
    amplitude_m: float = key(LENGTH_PER_BATCH, at_least=-1_000_000_000, at_most=1_000_000_000)
    """Height a cell's width away from a feature point (f1) or a border (f2-f1), or of a block as
    high as a cell is wide; below 0 for pits and ridges."""
    scale_m: float = key(LENGTH_PER_BATCH, above=0, at_most=1_000_000_000)
    """Width of a cell."""
    distance: Literal["f1", "f2-f1", "blocks"] = key(CHOICE, default="f1")
    """f1: distance to the nearest feature point; f2-f1: how much farther the second nearest is,
    which is 0 on the cells' borders. blocks: no distance, but the height of the highest of angular
    blocks with sloping sides and tilted tops, one a cell, and 0 between them: rubble, the clinker
    of lava."""
    jitter: float = key(FRACTION_PER_BATCH, default=1)
    """How far feature points are from a square lattice: 0 on it, 1 anywhere in their cells."""
    octaves: int = key(WHOLE_PER_BATCH, default=1, at_least=0, at_most=24)
    """Number of octaves."""
    lacunarity: float = key(LACUNARITY)
    gain: float = key(GAIN)


@dataclass(frozen=True, kw_only=True)
class ReliefBarchans:
    """Single crescent dunes with horns downwind, added to what is there."""

    EXAMPLE: ClassVar = {
        "type": "barchans",
        "count": 12,
        "height_m": {"type": "uniform", "min": 0.5, "max": 2},
        "wind_deg": 45,
    }

    count: int = key(WHOLE_PER_BATCH, at_least=0, at_most=100_000)
    """Number of dunes."""
    height_m: Number = key(LENGTH_PER_INSTANCE, above=0, at_most=1_000_000)
    """Height of a dune; it is ten heights wide."""
    wind_deg: float = key(WIND_DEG)
    repose_deg: float = key(ANGLE_PER_BATCH, default=33, at_least=15, at_most=60)
    """Slope of the slip faces: the angle of repose."""


@dataclass(frozen=True, kw_only=True)
class ReliefCrust:
    """A cemented crust on loose soil (duricrust), broken into plates, added to what is there.

    As a displacement of a ground material it lies where that material does.
    """

    EXAMPLE: ClassVar = {"type": "crust", "height_m": 0.02, "plate_m": 0.3}

    height_m: float = key(LENGTH_PER_BATCH, default=0.02, above=0, at_most=1_000_000)
    """Thickness: how high plates stand above the loose soil."""
    plate_m: float = key(LENGTH_PER_BATCH, default=0.3, above=0, at_most=1_000_000_000)
    """Width of a plate."""
    missing: float = key(FRACTION_PER_BATCH, default=0.25)
    """Share of the plates that are gone, in gaps of several."""


@dataclass(frozen=True, kw_only=True)
class ReliefDem:
    """A measured height field, laid over the terrain at a scale of one's choice.

    A base.
    """

    EXAMPLE: ClassVar = {
        "type": "dem",
        "file": "package:matplotlib/mpl-data/sample_data/jacksboro_fault_dem.npz",
        "array": "elevation",
        "pixel_m": [0.25, 0.31],
        "height_scale": 0.006,
    }

    TITLE: ClassVar = "Relief: DEM"
    file: Path = key(file("dem"))
    """A .npz or .npy file, a GeoTIFF that lies upright in its coordinates, or a gray picture of 8
    or 16 bits: relative to the cfg, or "package:NAME/path" in an installed Python package, where *
    stands for any part of a name."""
    array: str | None = key(WORDS, optional=True)
    """Member of an .npz file; left out, its only two-dimensional one."""
    pixel_m: Any | None = key(
        Form(
            {
                "type": ["number", "object", "array"],
                "if": {"type": "array"},
                "then": {
                    "minItems": 2,
                    "maxItems": 2,
                    "items": {
                        **LENGTH_PER_BATCH.keywords,
                        "description": "Size along one axis.",
                        "exclusiveMinimum": 0,
                        "maximum": 1_000_000,
                    },
                },
                "else": {
                    **LENGTH_PER_BATCH.keywords,
                    "description": "Size along both axes.",
                    "exclusiveMinimum": 0,
                    "maximum": 1_000_000,
                },
            }
        ),
        optional=True,
        unit="m",
    )
    """Size that a pixel gets: one number, or [x, y]. Left out, that of a GeoTIFF whose coordinates
    are lengths."""
    height_scale: float = key(PER_BATCH, default=1, at_least=-1_000_000_000, at_most=1_000_000_000)
    """Factor on the file's heights."""
    height_offset_m: Any = key(
        Form(
            {
                "type": ["number", "object", "null"],
                "if": {"type": ["number", "object"]},
                "then": {
                    **LENGTH_PER_BATCH.keywords,
                    "description": "Added to the scaled heights.",
                    "minimum": -1_000_000_000,
                    "maximum": 1_000_000_000,
                },
            }
        ),
        default=0,
        unit="m",
    )
    """Added to the scaled heights; null puts their mean at 0."""
    first_row: Literal["north", "south"] = key(CHOICE, default="north")
    """Whether the file's first row is its northern or its southern one."""
    center: Any = key(
        list_of(FRACTION_PER_BATCH, "Fraction along one axis.", least=2, most=2), default=[0.5, 0.5]
    )
    """Which point of the DEM lies at the terrain's center, as fractions of its width (from the
    west) and height (from the south)."""
    nodata: Any | None = key(Form({"type": ["number", "null"]}), optional=True)
    """Value in the file that marks holes, besides NaN and what the file itself declares. Values
    that look like an undeclared mark (-32768, -9999 …, far from all other heights) are refused
    without it, and 0 far from all other samples is warned of; null says that they are heights."""
    band: int | None = key(COUNT, optional=True, at_least=1, at_most=65_535)
    """Band of a GeoTIFF that holds the heights, counted from 1. Left out, its only one, not
    counting alpha."""
    unit_m: float | None = key(CONSTANT, optional=True, above=0, at_most=1_000_000, unit="m")
    """Meters per unit of the file's heights. Left out, what a GeoTIFF says (m, km, ft, us-ft …, of
    its band or its vertical axis), else 1. Its own scale and offset are applied before."""
    edge: Literal["error", "clamp"] = key(CHOICE, default="error")
    """What happens where the terrain is larger than the DEM: an error, or the border's heights go
    on."""
    holes: Literal["error", "fill"] = key(CHOICE, default="error")
    """What happens where there is no data under the terrain: an error, or a membrane stretched over
    the hole (Laplace's equation)."""
    height_range_m: Any | None = key(
        list_of(
            bounded(LENGTH_PER_BATCH, at_least=-1_000_000_000, at_most=1_000_000_000),
            "Height.",
            least=2,
            most=2,
        ),
        optional=True,
        unit="m",
    )
    """For pictures: heights of black and of white."""


@dataclass(frozen=True, kw_only=True)
class ReliefDiffusion:
    """Hillslope diffusion of what is there: creep that rounds crests and fills hollows, ∂h/∂t =
    κ∇²h with insulated borders. Exact for any duration; keeps the mean.
    """

    EXAMPLE: ClassVar = {"type": "diffusion", "diffusivity_m2_per_a": 0.001, "duration_a": 500}

    diffusivity_m2_per_a: float = key(PER_BATCH, at_least=0, at_most=1_000_000_000, unit="m²/a")
    """Diffusivity κ: about 0.01 for soil on Earth, 5e-6 for lunar regolith."""
    duration_a: float = key(PER_BATCH, at_least=0, at_most=100_000_000_000, unit="a")
    """For how long."""


@dataclass(frozen=True, kw_only=True)
class ReliefDunes:
    """Transverse dunes, added to what is there: long crests across the wind, gentle to windward,
    with slip faces at the angle of repose.
    """

    EXAMPLE: ClassVar = {
        "type": "dunes",
        "height_m": 0.7,
        "wavelength_m": 9,
        "wind_deg": {"type": "uniform", "min": 20, "max": 70},
        "order": 0.2,
    }

    height_m: float = key(LENGTH_PER_BATCH, above=0, at_most=1_000_000)
    """Height of a crest."""
    wavelength_m: float = key(LENGTH_PER_BATCH, above=0, at_most=1_000_000_000)
    """Mean distance of crests. Below four spacings there are none."""
    wind_deg: float = key(WIND_DEG)
    repose_deg: float = key(ANGLE_PER_BATCH, default=33, at_least=1, at_most=60)
    """Slope of the slip faces: the angle of repose."""
    order: float = key(PER_BATCH, default=0.3, at_least=0, at_most=100)
    """How regular the crests are: at 0 they end and fork most often, above 1 they only wind."""


@dataclass(frozen=True, kw_only=True)
class ReliefFootprints:
    """Prints of ribbed boots, of walks across the terrain, with rims of displaced soil, added to
    what is there.
    """

    EXAMPLE: ClassVar = {"type": "footprints", "walks": 4, "depth_m": 0.03}

    walks: int = key(WHOLE_PER_BATCH, default=1, at_least=0, at_most=10_000)
    """Number of walks. Each crosses the terrain through a point of its inner half."""
    stride_m: float = key(LENGTH_PER_BATCH, default=1.3, above=0, at_most=1_000_000)
    """Distance between prints of the same foot; the other foot's are half way."""
    length_m: float = key(LENGTH_PER_BATCH, default=0.33, above=0, at_most=1_000_000)
    """Length of a sole; it is two fifths as wide. Grids with fewer than three samples a rib (16 on
    a sole) show prints near cameras only, where the mesh is finer than they are."""
    depth_m: float = key(LENGTH_PER_BATCH, default=0.025, at_least=0, at_most=1_000_000)
    """How deep boots sink; prints scatter by three tenths of it."""
    tread_m: float = key(LENGTH_PER_BATCH, default=0.006, at_least=0, at_most=1_000_000)
    """Height of the ribs that soles leave; 0 for smooth soles."""


@dataclass(frozen=True, kw_only=True)
class ReliefMesh:
    """A mesh from a file: the ground itself, overhangs and caves included, or what is seen of it
    from above. A base. It is scaled, turned, then moved.
    """

    EXAMPLE: ClassVar = {"type": "mesh", "file": "photogrammetry.obj", "unit_m": 1, "up": "z"}

    file: Path = key(file("mesh"))
    """A .obj, .ply, .stl, .off, .glb, .gltf, .usd, .usda, .usdc or .usdz file; what a model looks
    like is not read, buffers beside a .gltf are: relative to the cfg, or "package:NAME/path" in an
    installed Python package, where * stands for any part of a name."""
    surface: Literal["mesh", "heights"] = key(CHOICE, default="mesh")
    """What becomes of it. mesh: its triangles are the ground, halved until no edge is longer than
    the spacing; relief after it moves them up and down, and objects lie on every floor. heights:
    its topmost surface, sampled on the grid; what is under an overhang is lost, and reported."""
    part: str | None = key(WORDS, optional=True)
    """One of the file's meshes: a name, or a path down to it; what stands under that name comes
    along. Left out, all of them."""
    unit_m: float | None = key(CONSTANT, optional=True, above=0, at_most=1_000_000, unit="m")
    """Meters per unit of the file. Left out, what the file says: 1 in glTF, metersPerUnit in USD;
    OBJ, PLY, STL and OFF say nothing."""
    up: Literal["x", "y", "z", "-x", "-y", "-z"] | None = key(CHOICE, optional=True)
    """The file's upward axis. Left out, what the file says: y in glTF, upAxis in USD; OBJ, PLY, STL
    and OFF say nothing."""
    scale: float = key(PER_BATCH, default=1, above=0, at_most=1_000_000_000)
    """Factor on its size."""
    rotation_deg: float = key(PER_BATCH, default=0, at_least=-360, at_most=360, unit="deg")
    """Turn about the vertical, counterclockwise seen from above."""
    place: Literal["center", "keep"] = key(CHOICE, default="center")
    """center: the middle of its extent in plan lies at the terrain's center. keep: its coordinates
    are the terrain's."""
    position_m: Any = key(
        list_of(
            bounded(LENGTH_PER_BATCH, at_least=-1_000_000_000, at_most=1_000_000_000),
            "Along one axis.",
            least=3,
            most=3,
        ),
        default=[0, 0, 0],
        unit="m",
    )
    """Moved by this: x, y, z."""
    holes: Literal["error", "fill"] = key(CHOICE, default="error")
    """What happens where there is no mesh over or under the terrain: an error; or fill: heights
    become a membrane there (Laplace's equation). Where surface is mesh, the ground has a hole there
    all the same."""
    roughness: Mapping[str, Any] | None = key(an("relief_mesh_roughness"), optional=True)
    """Moves the surface along its normals, on walls and ceilings too. Where surface is mesh only.
    """
    mask: Any | None = key(list_of(an("relief_mask"), "One condition.", least=1), optional=True)
    """Where the operator acts: conditions whose product is the mask. Left out, everywhere. Where
    surface is heights only."""


@dataclass(frozen=True, kw_only=True)
class ReliefMeshRoughness:
    """Displacement along the surface's normals by three-dimensional fBm."""

    EXAMPLE: ClassVar = {"amplitude_m": 0.02, "scale_m": 0.5}

    TITLE: ClassVar = "Relief: mesh, roughness"
    amplitude_m: float = key(LENGTH_PER_BATCH, at_least=0, at_most=1_000_000)
    """Of the first octave. Where it is larger than the surface's radius of curvature, the surface
    can cross itself."""
    scale_m: float = key(NOISE_SCALE_M)
    octaves: int = key(WHOLE_PER_BATCH, default=8, at_least=0, at_most=24)
    """Number of octaves at most; those finer than two edges of the mesh are left out. Each is half
    the size of the one before."""
    gain: float = key(GAIN)


@dataclass(frozen=True, kw_only=True)
class ReliefPlane:
    """A flat or inclined plane.

    A base.
    """

    EXAMPLE: ClassVar = {"type": "plane", "slope": [0.05, 0]}

    height_m: float = key(
        LENGTH_PER_BATCH, default=0, at_least=-1_000_000_000, at_most=1_000_000_000
    )
    """Height at the terrain's center."""
    slope: Any = key(
        list_of(
            bounded(PER_BATCH, at_least=-1_000_000, at_most=1_000_000),
            "Rise over run along one axis.",
            least=2,
            most=2,
        ),
        default=[0, 0],
    )
    """dz/dx and dz/dy."""


@dataclass(frozen=True, kw_only=True)
class ReliefPolygons:
    """Patterned ground, as over ice: polygons between troughs with raised shoulders, added to what
    is there (Mellon et al. 2008).
    """

    EXAMPLE: ClassVar = {"type": "polygons", "scale_m": 5, "depth_m": 0.25, "width_m": 0.9}

    scale_m: float = key(LENGTH_PER_BATCH, above=0, at_most=1_000_000_000)
    """Width of a polygon."""
    depth_m: float = key(LENGTH_PER_BATCH, default=0.2, at_least=0, at_most=1_000_000)
    """How deep the middles of the troughs are."""
    width_m: float = key(LENGTH_PER_BATCH, default=0.8, above=0, at_most=1_000_000)
    """Width of the troughs. Those narrower than three spacings are left out."""
    shoulder_m: float = key(LENGTH_PER_BATCH, default=0.05, at_least=0, at_most=1_000_000)
    """Height of the shoulders beside them."""
    irregularity: float = key(FRACTION_PER_BATCH, default=0.6)
    """How irregular the polygons are and their sides are bent."""


@dataclass(frozen=True, kw_only=True)
class ReliefRipples:
    """Wind ripples, added to what is there: like dunes, but round."""

    EXAMPLE: ClassVar = {"type": "ripples", "height_m": 0.05, "wavelength_m": 0.7, "wind_deg": 45}

    height_m: float = key(LENGTH_PER_BATCH, above=0, at_most=1_000_000)
    """Height of a crest."""
    wavelength_m: float = key(LENGTH_PER_BATCH, above=0, at_most=1_000_000_000)
    """Mean distance of crests. Below four spacings there are none."""
    wind_deg: float = key(WIND_DEG)
    repose_deg: float = key(ANGLE_PER_BATCH, default=28, at_least=1, at_most=60)
    """Steepest slope of the lee sides."""
    order: float = key(PER_BATCH, default=0.4, at_least=0, at_most=100)
    """How regular the crests are: at 0 they end and fork most often, above 1 they only wind."""


@dataclass(frozen=True, kw_only=True)
class ReliefSmooth:
    """Smoothing by diffusion of what is there."""

    EXAMPLE: ClassVar = {"type": "smooth", "length_m": 0.5}

    length_m: float = key(LENGTH_PER_BATCH, at_least=0, at_most=1_000_000_000)
    """Standard deviation of the equivalent Gaussian."""


@dataclass(frozen=True, kw_only=True)
class ReliefStreamPower:
    """Hydraulic erosion of what is there: ∂h/∂t = U − K·A^m·S^n + D∇²h with A the drainage area and
    S the slope. Implicit: any step is stable. Fills depressions.
    """

    EXAMPLE: ClassVar = {
        "type": "stream_power",
        "erodibility": 5e-05,
        "duration_a": 3000,
        "diffusivity_m2_per_a": 0.0001,
        "outlets": ["south"],
    }

    erodibility: float = key(PER_BATCH, at_least=0, at_most=1_000_000_000)
    """K, in m^(1−2m) a year: 1e-7 for hard to 1e-4 for soft rock with the default exponents."""
    duration_a: float = key(PER_BATCH, at_least=0, at_most=100_000_000_000, unit="a")
    """For how long."""
    steps: int | None = key(WHOLE_PER_BATCH, optional=True, at_least=1, at_most=100_000)
    """Number of equal steps; in each, water finds its way anew. What they err is estimated and
    reported. With error_m, so many at most (left out, 1024)."""
    error_m: float = key(LENGTH_PER_BATCH, sparse=True, at_least=0, at_most=1_000_000_000)
    """Error of the steps to aim at, root mean square over the terrain: their number is doubled
    until the estimate is met. Where neither is given, 5 % of the change that the operator makes, in
    at most 64 steps."""
    area_exponent: float = key(PER_BATCH, default=0.5, at_least=0, at_most=2)
    """m, of the drainage area."""
    slope_exponent: float = key(PER_BATCH, default=1, at_least=0.2, at_most=5)
    """n, of the slope."""
    channel_area_m2: float = key(
        PER_BATCH, default=0, at_least=0, at_most=1_000_000_000_000, unit="m²"
    )
    """Drainage area from which on water cuts; with a diffusivity, slopes above it stay round."""
    diffusivity_m2_per_a: float = key(
        PER_BATCH, default=0, at_least=0, at_most=1_000_000_000, unit="m²/a"
    )
    """D, of the hillslopes."""
    uplift_m_per_a: float = key(PER_BATCH, default=0, at_least=0, at_most=1_000_000, unit="m/a")
    """U, everywhere but at the outlets."""
    outlets: Any = key(
        list_of(one_of("west", "east", "south", "north"), "One side.", least=1, unique=True),
        default=["west", "east", "south", "north"],
    )
    """Sides of the terrain that water leaves by, and whose heights stay."""


@dataclass(frozen=True, kw_only=True)
class ReliefTerraces:
    """Cuts what is there into steps, as layered rock weathers."""

    EXAMPLE: ClassVar = {"type": "terraces", "step_m": 0.3, "riser": 0.75, "irregularity": 0.8}

    step_m: float = key(LENGTH_PER_BATCH, above=0, at_most=1_000_000_000)
    """Mean thickness of a layer."""
    riser: float = key(PER_BATCH, default=0.3, above=0, at_most=1)
    """Part of a layer's thickness that is steep."""
    tread_slope: float = key(FRACTION_PER_BATCH, default=0.2)
    """Part of their slope that the treads between the steep parts keep; 1 changes nothing."""
    irregularity: float = key(FRACTION_PER_BATCH, default=0.5)
    """How uneven the thicknesses of layers are."""
    bend_m: float = key(LENGTH_PER_BATCH, default=0, at_least=0, at_most=1_000_000_000)
    """How far layers bend up and down."""
    bend_scale_m: float = key(LENGTH_PER_BATCH, default=100, above=0, at_most=1_000_000_000)
    """Size of the bends."""


@dataclass(frozen=True, kw_only=True)
class ReliefThermal:
    """Slopes steeper than the angle of repose slide until they hold, at once and to the end: cliffs
    become ramps, steep cones flatter ones. Keeps the mean.
    """

    EXAMPLE: ClassVar = {"type": "thermal", "angle_deg": 32}

    TITLE: ClassVar = "Relief: thermal erosion"
    angle_deg: float = key(ANGLE_PER_BATCH, default=33, at_least=1, at_most=89)
    """The angle of repose."""


@dataclass(frozen=True, kw_only=True)
class ReliefTracks:
    """Wheel tracks of a rover along a given path, pressed into what is there."""

    EXAMPLE: ClassVar = {
        "type": "tracks",
        "file": "track.csv",
        "wheel_distance_m": 1.7,
        "wheel_width_m": 0.4,
        "depth_m": 0.03,
    }

    file: Path = key(file("polyline"))
    """CSV of the path of the rover's middle, columns x_m and y_m: relative to the cfg, or
    "package:NAME/path"."""
    wheel_distance_m: float = key(LENGTH_PER_BATCH, default=2, above=0, at_most=1000)
    """Between the middles of the left and the right wheels."""
    wheel_width_m: float = key(LENGTH_PER_BATCH, default=0.4, above=0, at_most=1000)
    """Width of a wheel. Wheels narrower than three spacings leave no track."""
    depth_m: float = key(LENGTH_PER_BATCH, default=0.04, at_least=0, at_most=1000)
    """How deep wheels sink."""
    grouser_spacing_m: float = key(LENGTH_PER_BATCH, default=0.12, above=0, at_most=1000)
    """Distance of grousers along the track. Closer than three spacings they leave none of their
    own."""
    grouser_depth_m: float = key(LENGTH_PER_BATCH, default=0.012, at_least=0, at_most=1000)
    """How much deeper grousers press; 0 for smooth wheels."""
    pattern: Literal["bars", "chevrons"] = key(CHOICE, default="bars")
    """Straight bars across the track, or chevrons."""


@dataclass(frozen=True, kw_only=True)
class ReliefWorley:
    """Cellular relief, added to what is there: bumps, pits or polygons around scattered points
    (Worley 1996).
    """

    EXAMPLE: ClassVar = {"type": "worley", "amplitude_m": 0.4, "scale_m": 3, "distance": "f2-f1"}

    TITLE: ClassVar = "Relief: Worley"
    amplitude_m: float = key(LENGTH_PER_BATCH, at_least=-1_000_000_000, at_most=1_000_000_000)
    """Height a cell's width away from a feature point (f1) or a border (f2-f1), or of a block as
    high as a cell is wide; below 0 for pits and ridges."""
    scale_m: float = key(LENGTH_PER_BATCH, above=0, at_most=1_000_000_000)
    """Width of a cell."""
    distance: Literal["f1", "f2-f1", "blocks"] = key(CHOICE, default="f1")
    """f1: distance to the nearest feature point; f2-f1: how much farther the second nearest is,
    which is 0 on the cells' borders. blocks: no distance, but the height of the highest of angular
    blocks with sloping sides and tilted tops, one a cell, and 0 between them: rubble, the clinker
    of lava."""
    jitter: float = key(FRACTION_PER_BATCH, default=1)
    """How far feature points are from a square lattice: 0 on it, 1 anywhere in their cells."""
    octaves: int = key(WHOLE_PER_BATCH, default=1, at_least=0, at_most=24)
    """Number of octaves at most; those finer than the spacing can show are left out."""
    lacunarity: float = key(LACUNARITY)
    gain: float = key(GAIN)
