"""Defines the Scene: one batch as arrays, the vocabulary of all passes and of the emitter.

World frame: meters, Z up, x east, y north, the terrain's center at the origin. Everything is plain
data; nothing here draws, reads files or knows of USD.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.arithmetic import elementary
from scenec.compiler.scene.rig import Rig

if TYPE_CHECKING:
    from scenec.compiler.materials.surface import Surface

#: Label id per level.
Labels = dict[str, int]


@dataclass(frozen=True)
class Picture:
    """A picture that came inside of another file, as it stood there.

    Attributes:
        suffix: Of a file that holds these bytes: ".png", ".jpg".
    """

    suffix: str
    data: bytes


@dataclass(frozen=True)
class Cells:
    """Pictures laid in cells, each turned and shifted, so that they do not repeat.

    Attributes:
        size_m: Side of the triangular lattice whose corners the cells stand on, meters.
        seed: Of the table of turns and shifts, below 2**31.
    """

    size_m: float
    seed: int


@dataclass(frozen=True)
class Far:
    """The picture of colors once more, larger, so that it varies over several scales.

    Attributes:
        share: c * (1 + share * (c_far / mean - 1)).
    """

    factor: float
    share: float


@dataclass(frozen=True)
class Sources:
    """Further files that a cfg names for a material, which its pictures are made of.

    Attributes:
        gloss: Roughness is 1 less it; None: there is none.
        occlusion: Ambient occlusion, which the albedo is multiplied with.
        occlusion_strength: albedo * (1 - strength * (1 - occlusion)).
        packed: Occlusion, roughness and metallic part as red, green and blue.
        unpacked: Kinds that ``packed`` is used for.
        heights: Of the relief, as a picture.
        heights_m: White above black in it; None: it stays flat.
        as_is: Whether files keep their resolution, whoever sees them.
        unused: Files of a folder whose names are understood, and which nothing is made of.
        unknown: Files of a folder whose names are not understood.
    """

    gloss: Path | None = None
    occlusion: Path | None = None
    occlusion_strength: float = 1.0
    packed: Path | None = None
    unpacked: tuple[str, ...] = ()
    heights: Path | None = None
    heights_m: float | None = None
    as_is: bool = False
    unused: tuple[str, ...] = ()
    unknown: tuple[str, ...] = ()


@dataclass(frozen=True)
class MaterialMaps:
    """Pictures that vary a surface.

    Attributes:
        size_m: Side of one repeat, meters; of no meaning with the projection "uv".
        files: By kind (``schemas.maps.MAP_CHANNELS``).
        normal_convention: "opengl" (y up in the picture) or "directx".
        projection: "above" (along the world's z), "triplanar" (along its three axes, mixed by the
            normal) or "uv" (the mesh's texture coordinates).
        procedural: What makes those pictures that ``files`` does not have; None in a Scene, where
            all are made.
        cells: How they are kept from repeating, or None: they do.
        far: The colors' larger scale, or None.
        sources: Further pictures that some are made of; None in a Scene, where all are made.
        lean: Mean sine of the angles by which the picture's normals lean, where they are a relief's
            whose facets hide each other; else 0.
    """

    size_m: float
    files: dict[str, Path | Picture]
    normal_convention: str
    projection: str = "above"
    procedural: Surface | None = None
    cells: Cells | None = None
    far: Far | None = None
    sources: Sources | None = None
    lean: float = 0.0


@dataclass(frozen=True)
class Reflectance:
    """How the dull part of a surface scatters, where it is not Lambert's law.

    Attributes:
        model: "lommel_seeliger" or "hapke"; the color is r0, the reflectance of a half space of
            isotropic scatterers, from which w = 4 r0 / (1 + r0)**2 is their albedo.
        b, c: Of the double Henyey-Greenstein phase function: width and share of its lobes.
        opposition, opposition_width: B0 and h of the shadow-hiding opposition surge.
        roughness_deg: Mean slope, theta bar; Hapke's only.
    """

    model: str
    b: float
    c: float
    opposition: float
    opposition_width: float
    roughness_deg: float


@dataclass(frozen=True)
class Material:
    """Shared surface model: (1-m) * ((1-s) * Lambert + s * GGX) + m * GGX of the color.

    Attributes:
        base_color: Albedo, linear Rec.709.
        roughness: GGX's alpha is its square.
        specular: s.
        variation: Albedo is base_color * (1 + variation * v), v in [-1, 1] given on the geometry.
        metallic: m.
        maps: Pictures that vary it, or None.
        roughness_variation: Roughness is roughness * (1 + roughness_variation * v), of the same v.
        reflectance: In place of Lambert, or None.
        emission: Radiance that it gives off itself, linear Rec.709, W/(m^2 sr); a map multiplies.
        diffuse_transmission: Share of Lambert's light that leaves a thin sheet on its far side.
    """

    base_color: tuple[float, float, float]
    roughness: float
    specular: float
    variation: float
    metallic: float = 0.0
    maps: MaterialMaps | None = None
    roughness_variation: float = 0.0
    reflectance: Reflectance | None = None
    emission: tuple[float, float, float] = (0.0, 0.0, 0.0)
    diffuse_transmission: float = 0.0

    @property
    def varies(self) -> bool:
        """Whether it shows the variation of vertices and instances."""
        return self.variation != 0.0 or self.roughness_variation != 0.0

    @property
    def needs_uv(self) -> bool:
        """Whether it shows pictures by texture coordinates."""
        return self.maps is not None and self.maps.projection == "uv"


@dataclass(frozen=True)
class GroundLayer:
    """One ground material and what it is called.

    Attributes:
        height_blend: Depth over which it and what is below it cover each other by their height
            maps, as a share of the maps' range; 0 blends by the weight alone. Labels never heed it.
    """

    material: str
    labels: Labels
    height_blend: float = 0.0


@dataclass(frozen=True)
class Tile:
    """A piece of terrain.

    Attributes:
        translate: World position of the local origin, float64 [3].
        points: Local, float32 [n, 3]; translate + points is exact in float64, and equal for a
            vertex that two tiles share.
        faces: int32 [m, 3].
        normals: Shading normals, float32 [n, 3].
        layer: Index of the ground layer that labels each face, int32 [m].
        weights: Weight of each merge at the vertices, float32 [layers - 1, n].
        variation: In [-1, 1], float32 [n].
    """

    name: str
    translate: NDArray[np.float64]
    points: NDArray[np.float32]
    faces: NDArray[np.int32]
    normals: NDArray[np.float32]
    layer: NDArray[np.int32]
    weights: NDArray[np.float32]
    variation: NDArray[np.float32]


@dataclass(frozen=True)
class Horizon:
    """The land beyond the terrain's border.

    Attributes:
        layer: Its own, above all the terrain's.
        tile: Its mesh; weights are of the terrain's merges and, last, of its own layer.
    """

    layer: GroundLayer
    tile: Tile


@dataclass(frozen=True)
class Ground:
    """The terrain: layers from the base up, and tiles that are cut along their label lines.

    Attributes:
        horizon: What lies around it, or None.
    """

    layers: tuple[GroundLayer, ...]
    tiles: tuple[Tile, ...]
    horizon: Horizon | None = None

    @property
    def parts(self) -> tuple[Ground, ...]:
        """Layers with what tiles are made of them: the terrain, and what lies around it."""
        own = Ground(self.layers, self.tiles)
        if self.horizon is None:
            return (own,)
        return own, Ground((*self.layers, self.horizon.layer), (self.horizon.tile,))

    @property
    def meshes(self) -> tuple[Tile, ...]:
        """All tiles, and the horizon's."""
        return tuple(tile for part in self.parts for tile in part.tiles)


@dataclass(frozen=True)
class MeshPart:
    """Faces of a prototype that have a material or labels of their own.

    Attributes:
        name: Of the part, a prim name.
        faces: Indices, ascending, int32 [k]; no face is in two parts.
        material: Name of the material; None: the class's.
        labels: Label id per level; None: the class's.
    """

    name: str
    faces: NDArray[np.int32]
    material: str | None
    labels: Labels | None


@dataclass(frozen=True)
class Coating:
    """A material that lies over a prototype's own.

    Attributes:
        weights: Its share at the vertices, over what is below it, float32 [n].
    """

    material: str
    weights: NDArray[np.float32]


@dataclass(frozen=True)
class Prototype:
    """A mesh that instances share; arrays as in ``Tile``.

    Attributes:
        error: How far it is from the finest mesh of its shape, in its own unit.
        radius: Of a ball around its origin that holds it, in its own unit: procedural rocks fit
            into one of radius 1/2, so that an instance's scale is its diameter; meshes of files
            are in meters.
        uv: Texture coordinates of the faces' corners, float32 [m, 3, 2], or None.
        parts: What differs from the class; empty where nothing does.
        coatings: What lies over the class's material, the lowest first; only without parts.
        rounding: How far float32 moved its vertices at most, in its own unit.
    """

    name: str
    points: NDArray[np.float32]
    faces: NDArray[np.int32]
    normals: NDArray[np.float32]
    variation: NDArray[np.float32]
    error: float = 0.0
    radius: float = 0.5
    uv: NDArray[np.float32] | None = None
    parts: tuple[MeshPart, ...] = ()
    coatings: tuple[Coating, ...] = ()
    rounding: float = 0.0


@dataclass(frozen=True)
class ObjectClass:
    """What objects of one class have, scattered or placed.

    Attributes:
        material: Name of the material; None where each prototype's parts have theirs.
        instances: Whether instance ids are shown (off: they stay reserved).
        prototype: Which one, int32 [n].
        ids: Local instance ids, ascending, int64 [n]: gaps where something could not be placed.
        drawn: How many ids are reserved, at least the largest one.
    """

    name: str
    material: str | None
    labels: Labels
    instances: bool
    prototypes: tuple[Prototype, ...]
    prototype: NDArray[np.int32]
    ids: NDArray[np.int64]
    drawn: int

    @property
    def count(self) -> int:
        """Number of objects."""
        return len(self.ids)

    @property
    def materials(self) -> set[str]:
        """Names of the materials that it shows: none where there is no prototype."""
        if not self.prototypes:
            return set()
        own = {part.material for mesh in self.prototypes for part in mesh.parts}
        own |= {coating.material for mesh in self.prototypes for coating in mesh.coatings}
        return {name for name in (self.material, *own) if name is not None}


@dataclass(frozen=True)
class Scatter(ObjectClass):
    """Many instances of a few prototypes.

    Attributes:
        positions: float32 [n, 3], meters.
        orientations: Quaternions (x, y, z, w), float16 [n, 4]: half precision, as USD stores them.
        scales: float32 [n, 3].
        variation: Albedo variation, float32 [n].
    """

    positions: NDArray[np.float32]
    orientations: NDArray[np.float16]
    scales: NDArray[np.float32]
    variation: NDArray[np.float32]

    def radii(self) -> NDArray[np.float64]:
        """Radius of a ball around each instance's position that holds it, meters, [n]."""
        of_prototype = np.array([p.radius for p in self.prototypes], np.float64)
        return of_prototype[self.prototype] * self.scales.max(axis=1, initial=0.0)

    def balls(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Balls that hold the instances: middles [n, 3] and radii [n], meters."""
        return self.positions.astype(np.float64), self.radii()


@dataclass(frozen=True)
class Placed(ObjectClass):
    """Single objects, each where it is told to be; they may move.

    Attributes:
        to_world: Local-to-world matrices, column vectors, float64 [n, s, 3, 4]: s is 1 where
            nothing moves, else the number of samples.
    """

    to_world: NDArray[np.float64]

    def balls(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Balls that hold the objects at any sample: middles [n * s, 3], radii [n * s], meters."""
        of_prototype = np.array([p.radius for p in self.prototypes], np.float64)[self.prototype]
        columns = self.to_world[:, :, :, :3]
        stretch = np.sqrt((columns * columns).sum(axis=2)).max(axis=2, initial=0.0)
        return self.to_world[:, :, :, 3].reshape(-1, 3), (of_prototype[:, None] * stretch).ravel()


@dataclass(frozen=True)
class Gobo:
    """Shadows that clouds throw: pictures over the plane square to the sun, at every sample.

    Attributes:
        pictures: By file name, shares of the sun's light that come through, uint16 [h, w] from 0
            to 65535; as seen from the sun, the top row toward the second axis of
            ``poses.facing``. Mirrored beyond their borders.
        texture: File name in ``pictures`` for each sample; "": all of the light comes through.
        middle_m: Of the picture, along both axes from the world's origin, [s, 2].
        size_m: Width and height of the picture, [s, 2].
        mean: Of the picture, [s].
    """

    pictures: dict[str, NDArray[np.uint16]]
    texture: tuple[str, ...]
    middle_m: NDArray[np.float64]
    size_m: NDArray[np.float64]
    mean: NDArray[np.float64]


@dataclass(frozen=True)
class SunLight:
    """The sun at every sample.

    Attributes:
        azimuth_deg, elevation_deg: Compass bearing (clockwise from north, +y) and height, [s].
        irradiance: On a surface facing it, W/m^2, [s].
        diameter_deg: Full angular diameter, [s].
        color: Linear Rec.709, [s, 3], of luminance 1.
        gobo: What it shines through, or None.
    """

    azimuth_deg: NDArray[np.float64]
    elevation_deg: NDArray[np.float64]
    irradiance: NDArray[np.float64]
    diameter_deg: NDArray[np.float64]
    color: NDArray[np.float64]
    gobo: Gobo | None = None

    def direction(self, sample: int) -> tuple[float, float, float]:
        """Unit vector to the sun."""
        azimuth = float(self.azimuth_deg[sample]) * elementary.PI / 180.0
        elevation = float(self.elevation_deg[sample]) * elementary.PI / 180.0
        level = elementary.cos(elevation)
        return (
            level * elementary.sin(azimuth),
            level * elementary.cos(azimuth),
            elementary.sin(elevation),
        )


@dataclass(frozen=True)
class SkyLight:
    """The sky at every sample.

    Attributes:
        pictures: Lat-long pictures by file name: float32 [h, w, 3] made by us, or a file to copy.
        texture: File name in ``pictures`` for each sample.
        intensity: Factor on the picture, [s].
        rotation_deg: Turn of the picture about the vertical, clockwise from above, [s].
        sharp: Whether places in the pictures are so bright that single objects cast shadows of
            them: a sun that was left in, lamps.
    """

    pictures: dict[str, NDArray[np.float32] | Path]
    texture: tuple[str, ...]
    intensity: NDArray[np.float64]
    rotation_deg: NDArray[np.float64]
    sharp: bool = False


@dataclass(frozen=True)
class SkyLabelMaps:
    """Labels of a panorama's pixels: the sky's, and the hills' that are on it.

    Attributes:
        pictures: Lat-long pictures of label ids by file name, uint16 [h, w].
        texture: Per level, the file name for each sample, or None: the sky's one label.
        rotation_deg: As in ``SkyLight``, [s].
    """

    pictures: dict[str, NDArray[np.uint16]]
    texture: dict[str, tuple[str | None, ...]]
    rotation_deg: NDArray[np.float64]


@dataclass(frozen=True)
class Haze:
    """Dust or mist between the camera and what it sees, at every sample.

    Attributes:
        extinction: Per meter, at the world's z = 0, linear Rec.709, [s, 3].
        scale_height_m: It thins out as exp(-z / this), [s].
        asymmetry: g of its phase function, [s].
        albedo: Part of the light it meets that it scatters, linear Rec.709, [s, 3].
        airlight: Radiance that a ray through endless haze shows, [s, 3]; None: what it scatters of
            suns and sky.
    """

    extinction: NDArray[np.float64]
    scale_height_m: NDArray[np.float64]
    asymmetry: NDArray[np.float64]
    albedo: NDArray[np.float64]
    airlight: NDArray[np.float64] | None


@dataclass(frozen=True, kw_only=True)
class SpotLight:
    """A sphere that shines into a cone, at every sample.

    Attributes:
        name: Prim name.
        intensity: On the axis, far away, linear Rec.709, W/sr, [s, 3].
        radius_m: Of the sphere, [s].
        cone_deg: Half the cone's opening angle, [s].
        softness: Share of that angle over which it fades to 0, [s].
    """

    name: str
    intensity: NDArray[np.float64]
    radius_m: NDArray[np.float64]
    cone_deg: NDArray[np.float64]
    softness: NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class Lamp(SpotLight):
    """A spot light at its place.

    Attributes:
        to_world: Matrices, column vectors, [s, 4, 4]: it stands at the origin and shines along -z.
    """

    to_world: NDArray[np.float64]


@dataclass(frozen=True)
class Georeference:
    """Where on a planet the terrain lies; recorded, and never part of any arithmetic.

    Attributes:
        crs: Coordinate reference system: an authority's code, or WKT.
        center: The world's origin in it, in its units.
        height_offset_m: Added to the (scaled) heights of the DEM.
    """

    crs: str
    center: tuple[float, float]
    height_offset_m: float


@dataclass(frozen=True)
class Scene:
    """One batch.

    Attributes:
        times: Real time of each sample, seconds, [samples].
        label_table: Per level, name -> id.
        sky_labels: Label id of the sky per level.
        sky_labels_below: Of its picture's ground, on levels that give that a label of its own.
        materials: By name; only those in use.
        objects: Object classes in the cfg's order.
        sun, sky: Light; None where there is none.
        more_suns: Further distant discs by prim name: earthshine, a second sun.
        sky_label_maps: Labels of a panorama, or None.
        outputs: Union of all sensors' outputs.
        bounds: World bounds of the geometry but for the horizon, float64 [2, 3].
        georeference: Of the first DEM that has one; None without.
    """

    name: str
    samples: int
    times: NDArray[np.float64]
    label_table: dict[str, dict[str, int]]
    sky_labels: Labels
    materials: dict[str, Material]
    ground: Ground
    objects: tuple[Scatter | Placed, ...]
    sun: SunLight | None
    sky: SkyLight | None
    rigs: tuple[Rig, ...]
    outputs: tuple[str, ...]
    bounds: NDArray[np.float64]
    georeference: Georeference | None = None
    more_suns: dict[str, SunLight] = field(default_factory=dict)
    lamps: tuple[Lamp, ...] = ()
    haze: Haze | None = None
    sky_label_maps: SkyLabelMaps | None = None
    sky_labels_below: Labels = field(default_factory=dict)

    @property
    def reach(self) -> NDArray[np.float64]:
        """World bounds of all geometry, float64 [2, 3]."""
        if self.ground.horizon is None:
            return self.bounds
        tile = self.ground.horizon.tile
        low, high = (tile.translate + pick(tile.points, axis=0) for pick in (np.min, np.max))
        return np.stack([np.minimum(self.bounds[0], low), np.maximum(self.bounds[1], high)])
