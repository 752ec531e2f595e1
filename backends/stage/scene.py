"""RenderScene: a stage as flat arrays, what every renderer and the resolver work on.

World frame: the stage's own, in meters, Z up, right-handed. Triangles only. Every renderer
addresses a surface point by (row, face): ``row`` indexes ``RenderScene.rows`` (one row for every
instance of every mesh), ``face`` indexes the triangles of that row's mesh.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenec.schemas import stage as names
from scenec.schemas.affine import box_around
from scenec.schemas.craters import CraterTable
from scenec.schemas.depth_camera import DepthCamera
from scenec.schemas.georeference import Georeference
from scenec.schemas.imaging import Imaging
from scenec.schemas.lens import Lens
from scenec.schemas.lidar import LidarDetection, LidarFootprint, LidarIntensity
from scenec.schemas.records import SolarTime
from scenec.schemas.shutter import Shutter
from scenec.schemas.vehicle import Vehicle

#: Passes of a camera that no RenderProduct says more about.
DEFAULT_OUTPUTS = ("rgb", "label", "instance", "depth")


@dataclass(frozen=True)
class Reading:
    """Decodes a picture's numbers where they are not as ``Maps`` says: UsdUVTexture's inputs.

    Attributes:
        channel: "r", "g", "b" or "a": where a single number stands.
        srgb: Whether they are in sRGB's transfer function; None: as ``Maps`` says.
        scale, bias: value * scale + bias is what is meant; of each channel, [3].
        tiles: Columns and rows of UDIM tiles that the material's texture coordinates span, which
            ``Maps.uv_transform`` brings into the unit square: a picture that is no tile repeats.
    """

    channel: str = "r"
    srgb: bool | None = None
    scale: tuple[float, float, float] = (1.0, 1.0, 1.0)
    bias: tuple[float, float, float] = (0.0, 0.0, 0.0)
    tiles: tuple[int, int] = (1, 1)


@dataclass(frozen=True)
class Cells:
    """Pictures laid in cells, each turned and shifted; ``surface.cells`` defines them.

    Attributes:
        size_m: Side of the lattice, meters.
        seed: Of the table of turns and shifts.
    """

    size_m: float
    seed: int


@dataclass(frozen=True)
class Maps:
    """Pictures that vary a surface; ``surface.maps`` loads them and defines projections.

    They repeat, (u, v) = (0, 0) is the picture's lower left corner, and between texel centers they
    are bilinear. Where (u, v) lie is the projection's matter:

    - "above": along the world's z, u = x / size_m, v = y / size_m.
    - "triplanar": along the world's x, y and z, (u, v) = (y, z), (x, z) and (x, y) / size_m, mixed
      by the shading normal (``projections.plane_shares``).
    - "uv": the mesh's texture coordinates, ``Mesh.uv``.

    Attributes:
        size_m: Side of one repeat, meters; of no meaning with the projection "uv".
        base_color: Multiplies ``Surface.base_color``; sRGB if 8 or 16 bits, linear if OpenEXR.
        roughness: Perceptual roughness, raw, takes the place of ``Surface.roughness`` and varies as
            that does.
        metallic: Raw, takes the place of ``Surface.metallic``.
        normal: Tangent-space normals n = 2 * rgb - 1, raw: x along +u, y along +v.
        flip_green: Whether ``normal`` has y along -v (DirectX's handedness).
        projection: "above", "triplanar" or "uv".
        readings: (kind, how its picture is meant), of those that are not as said here.
        primvar: Which texture coordinates ("uv").
        uv_transform: What they are multiplied with first, (a, b, c, d, e, f):
            u' = a u + b v + c, v' = d u + e v + f; done by the reader.
        emission: Multiplies ``Surface.emission``; color space as of ``base_color``.
        height: In [0, 1], raw: what ``Mesh.height_blends`` go by.
        cells: How they are kept from repeating ("above" only), or None.
        far: (factor, share): colors c become c * (1 + share * (c_far / mean - 1)), c_far the same
            picture factor times as large ("above" only); or None.
        lean: Mean sine of the angles by which normals of ``normal`` lean: its facets hide and shade
            each other (``surface.facets``); 0: they do not.
        opacity: Raw, by texture coordinates alone: where it is below ``opacity_threshold`` nothing
            is there (``surface.cutouts`` defines it).
        opacity_wrap: How that picture goes on beyond its sides, along u and v (``stage.WRAPS``).
    """

    size_m: float
    base_color: Path | None = None
    roughness: Path | None = None
    metallic: Path | None = None
    normal: Path | None = None
    flip_green: bool = False
    projection: str = "above"
    readings: tuple[tuple[str, Reading], ...] = ()
    primvar: str = "st"
    uv_transform: tuple[float, ...] = (1.0, 0.0, 0.0, 0.0, 1.0, 0.0)
    emission: Path | None = None
    height: Path | None = None
    cells: Cells | None = None
    far: tuple[float, float] | None = None
    lean: float = 0.0
    opacity: Path | None = None
    opacity_threshold: float = 0.0
    opacity_wrap: tuple[str, str] = ("repeat", "repeat")


@dataclass(frozen=True)
class Reflectance:
    """A law in place of Lambert's; ``scenec.backends.surface.reflectance`` defines it.

    Attributes:
        model: "lommel_seeliger" or "hapke".
        b, c: Of the double Henyey-Greenstein phase function.
        opposition, opposition_width: B0 and h.
        roughness: Mean slope theta bar, radians; 0 for Lommel and Seeliger's.
    """

    model: str
    b: float
    c: float
    opposition: float
    opposition_width: float
    roughness: float


@dataclass(frozen=True)
class Surface:
    """One material of the shared surface model.

    f = (1-m) * ((1-s) * Lambert(c) + s * GGX(white)) + m * GGX(c); ``surface.lobes`` defines them.

    Attributes:
        path: Prim path of the Material, or "" for the default one.
        base_color: c, linear Rec.709, shape [3].
        specular: s, in [0, 1].
        roughness: Perceptual roughness, in [0, 1].
        variation: c = base_color * (1 + variation * primvar) * (1 + variation * row's), clipped to
            [0, 1]; the primvar and the row's value in [-1, 1].
        metallic: m, in [0, 1].
        maps: Pictures that vary it, or None.
        roughness_variation: r = roughness * (1 + roughness_variation * primvar) *
            (1 + roughness_variation * row's), clipped to [0, 1]; both lobes have it.
        reflectance: What stands in place of Lambert(c), or None.
        emission: Radiance given off, linear Rec.709.
        diffuse_transmission: Share of Lambert's light that leaves on the far side, in [0, 1].
    """

    path: str
    base_color: tuple[float, float, float]
    specular: float
    roughness: float
    variation: float
    metallic: float = 0.0
    maps: Maps | None = None
    roughness_variation: float = 0.0
    reflectance: Reflectance | None = None
    emission: tuple[float, float, float] = (0.0, 0.0, 0.0)
    diffuse_transmission: float = 0.0

    @property
    def glossy(self) -> bool:
        """Whether it has a GGX lobe anywhere."""
        mapped = self.maps is not None and self.maps.metallic is not None
        return mapped or self.specular > 0.0 or self.metallic > 0.0

    @property
    def cutout(self) -> Maps | None:
        """The maps whose opacity cuts parts of it out, if any does."""
        maps = self.maps
        return maps if maps and maps.opacity and maps.opacity_threshold > 0.0 else None

    @property
    def emits(self) -> bool:
        """Whether it gives off light."""
        return any(self.emission)

    @property
    def transmits(self) -> bool:
        """Whether light passes through it."""
        return self.diffuse_transmission > 0.0

    @property
    def varies(self) -> bool:
        """Whether it looks different where the variation of vertices or rows is."""
        return self.variation != 0.0 or (self.glossy and self.roughness_variation != 0.0)


#: What UsdPreviewSurface shows without a color.
DEFAULT_SURFACE = Surface("", (0.18, 0.18, 0.18), 0.0, 0.5, 0.0)


@dataclass(frozen=True)
class Mesh:
    """Triangles in a local frame: a terrain tile, a rock prototype.

    Attributes:
        path: Prim path.
        points: Local positions as authored, float32 [n, 3], stage units already in meters.
        faces: Vertex indices, int32 [m, 3].
        authored_face: Index of the authored polygon each triangle comes from, int32 [m]; None
            where they are the same.
        normals: Shading normals at the vertices, float32 [n, 3], or None (flat).
        labels: Per level, the label id of each triangle, uint32 [m].
        layers: Indices into ``RenderScene.surfaces``; layer 0 is the base. Empty: a plain gray
            (``DEFAULT_SURFACE``).
        weights: Weight of merge i at the vertices, float32 [len(layers) - 1, n]: from the base up,
            each merge i mixes BSDFs, (1 - w_i) * what is below + w_i * layer i + 1.
        variation: Variation of albedo and roughness at the vertices, float32 [n], or None.
        uv: Texture coordinates at the corners of the triangles, v up, float32 [m, 3, 2], where a
            surface has maps that are projected by them; else None.
        color: Factors of the base color at the corners of the triangles, linear, float32 [m, 3, 3],
            linear between them; None: 1.
        height_blends: For each merge, the depth over which height maps decide (``scenec.backends.
            heights`` defines it), 0 where the weight alone does; empty: 0 for all.
    """

    path: str
    points: NDArray[np.float32]
    faces: NDArray[np.int32]
    authored_face: NDArray[np.int32] | None
    normals: NDArray[np.float32] | None
    labels: dict[str, NDArray[np.uint32]]
    layers: tuple[int, ...]
    weights: NDArray[np.float32]
    variation: NDArray[np.float32] | None = None
    uv: NDArray[np.float32] | None = None
    height_blends: tuple[float, ...] = ()
    color: NDArray[np.float32] | None = None

    @property
    def used_points(self) -> NDArray[np.float64]:
        """Points that faces have, float64 [k, 3]: stray ones are of no triangle."""
        used = np.zeros(len(self.points), bool)
        used[self.faces] = True
        return self.points[used].astype(np.float64)

    @cached_property
    def box(self) -> NDArray[np.float64]:
        """Corners of the box around the triangles, float64 [2, 3]; 0 where there are none."""
        points = self.used_points if len(self.faces) else np.zeros((1, 3))
        return box_around(points)


@dataclass(frozen=True)
class Motion:
    """Rows that are not where they were at the first sample.

    Attributes:
        rows: Which, ascending, int32 [k].
        to_world: Their matrices at each sample, float64 [samples, k, 3, 4]. Where a row is hidden
            its linear part is 0: a row scaled to a point has no surface.
        stand_ins: Which row is there for each of them at each sample, int32 [samples, k]: a shape
            that deforms has a row for each of its poses, with the same faces. None: each itself.
    """

    rows: NDArray[np.int32]
    to_world: NDArray[np.float64]
    stand_ins: NDArray[np.int32] | None = None

    def among(self, rows: NDArray[Any]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Returns which of some rows move, and their indices in ``self.rows``; both int64 [m]."""
        at = np.searchsorted(self.rows, rows)
        moves = np.flatnonzero(np.append(self.rows, -2)[at] == rows)
        return moves, at[moves]


@dataclass(frozen=True)
class Rows:
    """One row for every instance of every mesh, in the order that breaks ties.

    Attributes:
        mesh: Index into ``RenderScene.meshes``, int32 [r].
        to_world: Affine local-to-world matrices, column vectors, float64 [r, 3, 4]; of the first
            sample where they move.
        instance_id: Frame id, uint32 [r]; 0 is "no instance".
        variation: Variation of the whole instance, float32 [r].
        motion: Of the rows that move, or None where none does.
        part: Index into ``RenderScene.parts`` of the row's place within its instance, int32 [r]; -1
            where that changes over the samples. None: each row is its instance's frame.
    """

    mesh: NDArray[np.int32]
    to_world: NDArray[np.float64]
    instance_id: NDArray[np.uint32]
    variation: NDArray[np.float32]
    motion: Motion | None = None
    part: NDArray[np.int32] | None = None


@dataclass(frozen=True, eq=False)
class OpenShutter:
    """Describes the exposure of a picture's rows, and the camera's poses meanwhile.

    Attributes:
        shutter: When which row is exposed.
        times: Seconds from the sample's time, ascending, float64 [k]; they enclose all exposures.
        camera_to_world: Poses then, float64 [k, 4, 4]; between them
        ``scenec.backends.camera.shutter``.
    """

    shutter: Shutter
    times: NDArray[np.float64]
    camera_to_world: NDArray[np.float64]


@dataclass(frozen=True)
class Focus:
    """A lens of finite aperture.

    Attributes:
        distance_m: Of the plane that is sharp, along the optical axis.
        aperture_radius_m: Of the entrance pupil, a disk around the camera's origin.
    """

    distance_m: float
    aperture_radius_m: float


@dataclass(frozen=True)
class Camera:
    """A camera at one sample: a pinhole, or one with a lens.

    Attributes:
        name: Name in file paths: ``<rig>_<sensor>``.
        path: Prim path.
        width, height: Pixels.
        intrinsics: K, float64 [3, 3]: u = fx*X/Z + s*Y/Z + cx, v = fy*Y/Z + cy; pixel (0, 0) is
            the top-left one, its center is at (0.5, 0.5).
        camera_to_world: float64 [4, 4], camera axes x right, y down, z forward (OpenCV).
        exposure_ev: Pictures show radiance * 2**exposure_ev, unless ``exposure_per`` is set.
        outputs: Passes that its RenderProduct asks for.
        partner: Prim path of the camera that disparity goes to, or None.
        depth_camera: How it measures depth, or None.
        trigger: Of the samples it is triggered at, how many come from one to the next, and the
            first.
        lens: Which ray a point of the plane that K maps to pixels belongs to; None: a pinhole,
            as said above. Rays: ``scenec.backends.camera.rays``.
        imaging: What its sensor makes of radiance in pictures; None: they show it as it is.
        shutter: Where it is while the shutter is open; None: still. ``camera_to_world`` is where it
            is in the middle of the middle row's exposure.
        focus: What is sharp; None: everything.
        exposure_per: What ``picture.exposure`` finds one for: "batch" or "sample"; None: given.
        effects: What other packages do to its pictures (``scenec.backends.imaging.effects``).
        vehicle: Whom the pass ``traversable`` is for; None: ``Vehicle()``.
    """

    name: str
    path: str
    width: int
    height: int
    intrinsics: NDArray[np.float64]
    camera_to_world: NDArray[np.float64]
    exposure_ev: float = 0.0
    outputs: tuple[str, ...] = DEFAULT_OUTPUTS
    partner: str | None = None
    trigger: tuple[int, int] = (1, 0)
    depth_camera: DepthCamera | None = None

    def fires(self, sample: int) -> bool:
        """Whether it is triggered at a sample."""
        every, first = self.trigger
        return sample >= first and (sample - first) % every == 0

    lens: Lens | None = None
    imaging: Imaging | None = None
    shutter: OpenShutter | None = None
    focus: Focus | None = None
    exposure_per: str | None = None
    effects: tuple[str, ...] = ()
    vehicle: Vehicle | None = None


@dataclass(frozen=True, eq=False)
class Lidar:
    """A scanner at one sample; its frame is x ahead, y left, z up.

    Attributes:
        name: Name in file paths: ``<rig>_<lidar>``.
        path: Prim path.
        to_world: float64 [4, 4].
        elevations_deg: Of each beam, float64 [b], or of each ray, [b, a].
        azimuths_deg: Of each ray of a beam, counterclockwise from above, float64 [a]; or of each
            ray, [b, a].
        range_m: Nearest and farthest that is answered.
        range_noise_m, range_noise_ratio: Standard deviations of ranges, meters and as a share.
        angle_noise_deg: Of azimuth and of elevation.
        dropout, key: Share of answers lost; of the numbers drawn, below 2**64.
        intensity: How it tells intensities, or None: not at all.
        footprint: Width of its beams, or None: they have none.
        detection: Which returns are detected, or None: all.
    """

    name: str
    path: str
    to_world: NDArray[np.float64]
    elevations_deg: NDArray[np.float64]
    azimuths_deg: NDArray[np.float64]
    range_m: tuple[float, float]
    range_noise_m: float = 0.0
    range_noise_ratio: float = 0.0
    angle_noise_deg: float = 0.0
    dropout: float = 0.0
    key: int = 0
    intensity: LidarIntensity | None = None
    footprint: LidarFootprint | None = None
    detection: LidarDetection | None = None


@dataclass(frozen=True)
class Gobo:
    """A picture that a sun shines through: which share of its light arrives where.

    ``surface.gobo`` looks it up: bilinear between texel centers, mirrored beyond its borders.

    Attributes:
        file: One channel of 8 or 16 bits, raw.
        to_picture: From a place in the world to (u, v), float64 [2, 4]: (0, 0) is the picture's
            upper left corner, (1, 1) the lower right one.
    """

    file: Path
    to_picture: NDArray[np.float64]


@dataclass(frozen=True)
class Sun:
    """A distant disc light.

    Attributes:
        to_light: Unit vector from the scene to the light, float64 [3].
        irradiance: On a surface facing it, linear Rec.709, float64 [3].
        diameter_rad: Full angular diameter; 0 is a point.
        path, normalized: Of the prim; whether its intensity is an irradiance, not a radiance.
        gobo: What it shines through; None: nothing.
        time: What time it is there, of a sun that was computed for a place and a time.
    """

    to_light: NDArray[np.float64]
    irradiance: NDArray[np.float64]
    diameter_rad: float
    path: str = ""
    normalized: bool = True
    gobo: Gobo | None = None
    time: SolarTime | None = None


#: A dome's frame stood up: its pole, +Y, goes to +Z, as OrientToStageUpAxis does.
UPRIGHT = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])


@dataclass(frozen=True)
class Dome:
    """Light from all around, as a lat-long picture.

    Attributes:
        texture: File of the lat-long picture, or what makes it, float32 [h, w, 3]; None for a
            constant 1.
        scale: Radiance of a texel of 1, linear Rec.709, float64 [3].
        to_world: Rotation of the dome's frame (USD: pole +Y, center +Z) to world, float64 [3, 3].
    """

    texture: Path | Callable[[], NDArray[np.float32]] | None
    scale: NDArray[np.float64]
    to_world: NDArray[np.float64]


@dataclass(frozen=True)
class Lamp:
    """A spot light: a sphere that shines into a cone; cameras do not see it.

    Its intensity at an angle t from the axis is ``intensity`` * (1 - smoothstep(t0, cone, t)),
    t0 = cone * (1 - softness); the sphere's radiance is that over pi * radius**2.

    Attributes:
        position, axis: World, meters; unit vector that it shines along; float64 [3].
        intensity: On the axis, far away, linear Rec.709, W/sr, float64 [3].
        radius_m: Of the sphere; 0 is a point.
        cone, softness: Half the opening angle, radians, in (0, pi]; in [0, 1].
    """

    position: NDArray[np.float64]
    axis: NDArray[np.float64]
    intensity: NDArray[np.float64]
    radius_m: float
    cone: float
    softness: float


@dataclass(frozen=True)
class Lighting:
    """All light of one sample."""

    suns: tuple[Sun, ...]
    domes: tuple[Dome, ...]
    lamps: tuple[Lamp, ...] = ()


@dataclass(frozen=True)
class Haze:
    """Describes the haze between camera and surfaces at one sample; ``picture.haze`` applies it.

    Attributes:
        extinction: Per meter at the world's z = 0, linear Rec.709, float64 [3].
        scale_height_m: It is exp(-z / this) of that at z.
        airlight: Radiance through endless haze, float64 [3]; None: what it scatters of
            suns and sky.
        floor_m: Height of the ground below the horizon; None: the scene's lowest place.
        asymmetry: g of its phase function (Henyey and Greenstein 1941), -0.9 to 0.9: mean cosine
            of the angle by which it turns light.
        albedo: Part of the light it meets that it scatters, not absorbs, float64 [3].
    """

    extinction: NDArray[np.float64]
    scale_height_m: float = names.HAZE_SCALE_HEIGHT_M
    airlight: NDArray[np.float64] | None = None
    floor_m: float | None = None
    asymmetry: float = names.HAZE_ASYMMETRY
    albedo: NDArray[np.float64] = field(default_factory=lambda: np.ones(3))


@dataclass(frozen=True)
class SkyLabelMap:
    """Label ids of one level over all directions of the sky at one sample.

    Attributes:
        file: Lat-long picture of ids, one 8- or 16-bit channel, looked up at the nearest texel.
        to_world: Rotation of its frame (as of a dome) to world, float64 [3, 3].
    """

    file: Path
    to_world: NDArray[np.float64]


@dataclass(frozen=True)
class RenderScene:
    """Everything a backend needs of one stage.

    Attributes:
        source: The stage's file.
        digest: sha256 over the stage's root layer and everything composed from it, hex.
        samples: Number of samples (time codes 0 .. samples - 1).
        levels: Label levels, in alphabetical order.
        label_names: Per level, id -> name.
        sky_labels: Per level, the label id of pixels that hit nothing.
        cameras, lighting: Per sample; all cameras, in stage order.
        bounds: Axis-aligned world bounds of the geometry over all samples, float64 [2, 3].
        instance_paths: Prim path of the class (or object) and what is added to a local id to get
            the frame id; ascending.
        parts: Places of meshes within their instances, float64 [p, 3, 4]; see ``Rows.part``.
        origins: Paths of the shapes and instancers that the rows come from, and how many each has,
            in the order of the rows; prototypes count as their outermost instancer.
    """

    source: Path
    digest: str
    samples: int
    meshes: tuple[Mesh, ...]
    rows: Rows
    surfaces: tuple[Surface, ...]
    levels: tuple[str, ...]
    label_names: dict[str, dict[int, str]]
    sky_labels: dict[str, int]
    cameras: tuple[tuple[Camera, ...], ...]
    lighting: tuple[Lighting, ...]
    bounds: NDArray[np.float64]
    instance_paths: dict[str, int] = field(default_factory=dict)
    #: Real time of each sample in seconds, float64 [samples].
    times: NDArray[np.float64] = field(default_factory=lambda: np.zeros(1))
    parts: NDArray[np.float64] = field(default_factory=lambda: np.eye(4)[None, :3])
    origins: tuple[tuple[str, int], ...] = ()
    #: Per sample; None without haze. Empty: none at all.
    haze: tuple[Haze | None, ...] = ()
    #: Per sample, by level: labels of directions that hit nothing, in place of ``sky_labels``.
    sky_label_maps: tuple[dict[str, SkyLabelMap], ...] = ()
    #: Label ids of rays that go down and hit nothing, on levels where they are not the sky's.
    sky_labels_below: dict[str, int] = field(default_factory=dict)
    #: Per sample: those that scan then.
    lidars: tuple[tuple[Lidar, ...], ...] = ()
    #: Where on a body the world lies; None where the stage does not say.
    georeference: Georeference | None = None
    #: Of the relief; None where the stage tells of none.
    craters: CraterTable | None = None
    #: A line for each thing in the stage that was not read, whatever the backend and the pass.
    losses: tuple[str, ...] = ()

    def cutout_of(self, mesh: Mesh) -> Maps | None:
        """Returns the maps whose opacity cuts parts of a mesh out: its only surface's, or None."""
        return self.surfaces[mesh.layers[0]].cutout if len(mesh.layers) == 1 else None

    @property
    def vehicle(self) -> Vehicle | None:
        """The first vehicle that a camera rides on."""
        named = (camera.vehicle for camera in self.cameras[0]) if self.cameras else ()
        return next(filter(None, named), None)

    @property
    def has_cutouts(self) -> bool:
        """Whether parts of any mesh are cut out."""
        return any(self.cutout_of(mesh) is not None for mesh in self.meshes)

    def rows_at(self, sample: int) -> Rows:
        """The rows with the matrices of a sample; the very same object where nothing moves."""
        motion = self.rows.motion
        if motion is None:
            return self.rows
        to_world = self.rows.to_world.copy()
        to_world[motion.rows] = motion.to_world[sample]
        return replace(self.rows, to_world=to_world)
