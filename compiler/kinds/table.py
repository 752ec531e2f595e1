"""Names the kinds that a cfg can give, and the classes that declare them.

Nothing is imported before it is named. Kinds of other packages come in by entry points
(``scenec.schemas.plugins``), into the choices that have a group.
"""

from __future__ import annotations

import importlib
import inspect
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cache
from typing import Any

from scenec.schemas.codec import JsonObject
from scenec.schemas.errors import ScenecError
from scenec.schemas.plugins import load_kind, named, plugin_name


@dataclass(frozen=True)
class KindChoice:
    """One of several kinds, which the key ``type`` tells.

    Attributes:
        title, description: Of the choice.
        of: What the key ``type`` is.
        each: The same in the tables of its kinds, where they say otherwise.
        prefix: Of the titles of its kinds; "": the title.
        kinds: By ``type``: the name in ``CLASSES``.
        group: Of the entry points by which other packages add kinds; "" without.
        says: What each kind says after its description, of the class {0}.
        shared: Which function of ``shared`` says what keys each kind has after its own; "" none.
        keywords: More that JSON Schema says of it.
        check: Whose check holds for kinds that have none of their own, as in ``CLASSES``.
        usual: The ``type`` of what says none; "": it has to.
    """

    title: str
    description: str
    of: str
    kinds: Mapping[str, str]
    prefix: str = ""
    group: str = ""
    each: str = ""
    says: str = ""
    shared: str = ""
    keywords: JsonObject = field(default_factory=dict)
    check: str = ""
    usual: str = ""


#: What declares each kind, within ``scenec.compiler``; the order is that of messages and schema.
#: Their names in ``CLASSES`` begin with that of the group: "relief_plane".
_KINDS = {
    "relief": {
        "plane": "terrain.sources.plane:Plane",
        "dem": "terrain.sources.dem:Dem",
        "mesh": "terrain.sources.mesh_base:MeshBase",
        "downscale": "terrain.operators.downscale:Downscale",
        "multifractal": "terrain.operators.multifractal:Multifractal",
        "worley": "terrain.operators.worley:Worley",
        "polygons": "terrain.operators.polygons:Polygons",
        "crust": "terrain.operators.crust:Crust",
        "craters": "terrain.operators.craters:CraterLaw",
        "dunes": "terrain.operators.dunes:Dunes",
        "barchans": "terrain.operators.barchans:BarchanField",
        "ripples": "terrain.operators.dunes:Ripples",
        "terraces": "terrain.operators.terraces:Terraces",
        "stream_power": "terrain.operators.stream_power:StreamPower",
        "thermal": "terrain.operators.thermal:Thermal",
        "diffusion": "terrain.operators.smooth:Diffusion",
        "smooth": "terrain.operators.smooth:Smooth",
        "tracks": "terrain.operators.tracks:Tracks",
        "footprints": "terrain.operators.footprints:Walks",
    },
    "displacement": {
        "multifractal": "terrain.operators.multifractal:Multifractal",
        "worley": "terrain.operators.worley:Worley",
        "crust": "terrain.operators.crust:Crust",
        "terraces": "terrain.operators.terraces:Terraces",
    },
    "condition": {
        "height": "terrain.condition:Height",
        "slope": "terrain.condition:Slope",
        "curvature": "terrain.condition:Curvature",
        "flow": "terrain.condition:Flow",
        "crater_freshness": "terrain.freshness:Freshness",
        "noise": "terrain.condition:Noise",
        "point": "terrain.condition:FromPoint",
        "path": "terrain.condition:FromPath",
        "camera": "objects.conditions:FromCameras",
        "object": "objects.conditions:FromObjects",
    },
    "density": {
        "uniform": "objects.density:UniformDensity",
        "noise": "objects.density:NoiseDensity",
        "worley": "objects.density:WorleyDensity",
        "image": "objects.density:ImageDensity",
        "clusters": "objects.density:Clusters",
        "path": "objects.density:PathDensity",
        "rings": "objects.rings:RingDensity",
        "around": "objects.density:AroundDensity",
    },
    "surface": {
        "granite": "materials.rocks:Granite",
        "basalt": "materials.rocks:Basalt",
        "sandstone": "materials.rocks:Sandstone",
        "breccia": "materials.rocks:Breccia",
        "weathered": "materials.rocks:Weathered",
        "sand": "materials.grounds:Sand",
        "gravel": "materials.grounds:Gravel",
        "mud_cracks": "materials.grounds:MudCracks",
        "regolith": "materials.grounds:Regolith",
        "soil": "materials.grounds:Soil",
        "pavement": "materials.grounds:Pavement",
        "turf": "materials.turf:Turf",
    },
    "reflectance": {
        "lambert": "materials.reflectance:Lambert",
        "lommel_seeliger": "materials.reflectance:LommelSeeliger",
        "hapke": "materials.reflectance:Hapke",
    },
    "objects": {
        "rocks": "objects.families.rocks:Rocks",
        "meshes": "objects.meshes:Meshes",
        "placed": "objects.poses:PlacedKeys",
    },
    "pose": {
        "random_target": "cameras.paths.random_target:RandomTarget",
        "track": "cameras.tracks:TrackFile",
        "random": "cameras.paths.random_pose:RandomPose",
        "orbit": "cameras.paths.orbit:Orbit",
        "lawn_mower": "cameras.paths.lawn_mower:LawnMower",
        "rover": "cameras.paths.rover:Rover",
        "mav": "cameras.paths.mav:Mav",
        "descent": "cameras.paths.descent:Descent",
    },
    "pose_center": {
        "point": "cameras.paths.orbit:PointAim",
        "object": "cameras.paths.orbit:ObjectAim",
    },
    "pose_look": {
        "direction": "cameras.paths.looks:LookDirection",
        "point": "cameras.paths.looks:LookPoint",
        "object": "cameras.paths.orbit:ObjectAim",
    },
    "lens": {
        "brown_conrady": "cameras.lens:BrownConrady",
        "kannala_brandt": "cameras.lens:KannalaBrandt",
        "equirectangular": "cameras.lens:Equirectangular",
    },
    "depth_camera": {
        "stereo": "cameras.ranging:Stereo",
        "time_of_flight": "cameras.ranging:TimeOfFlight",
    },
    "exposure": {
        "auto": "cameras.exposure:AutoExposure",
        "incident": "cameras.exposure:Incident",
        "fixed": "cameras.exposure:Fixed",
    },
    "imaging_exposure": {
        "metered": "cameras.imaging:Metered",
        "manual": "cameras.imaging:Manual",
        "auto": "cameras.imaging:AutoImaging",
    },
    "sky": {
        "atmosphere": "light.atmosphere_sky:AtmosphereSky",
        "clear": "light.clear_sky:ClearSky",
        "image": "light.panorama:ImageSky",
        "none": "light.sky:BlackSky",
        "overcast": "light.overcast:OvercastSky",
    },
    "light": {"sun": "light.suns:SunKeys", "earthshine": "light.earthshine:Earthshine"},
    "light_mount": {"rig": "light.lamp:RigMount", "world": "light.lamp:WorldMount"},
}
#: Families of rocks: each is the ``Carved`` of that name in a module of that name.
ROCKS = ("weathered", "angular", "rounded", "slab", "vesicular", "ventifact", "bedded", "breccia")
#: Objects of a cfg that have no ``type``.
_OBJECTS = {
    "cfg": "cfg.root:Cfg",
    "clouds_cirrus": "light.cloud_fields:CirrusClouds",
    "clouds_cumulus": "light.cloud_fields:CumulusClouds",
    "dem_window": "terrain.sources.dem:DemWindow",
    "condition_ragged": "terrain.condition:Ragged",
    "focus": "cameras.lens:FocusKeys",
    "ground_base": "mesh.terrain:GroundBase",
    "ground_layer": "mesh.terrain:GroundLayerKeys",
    "ground_noise": "mesh.terrain:GroundNoise",
    "imaging": "cameras.imaging:ImagingKeys",
    "imaging_bloom": "cameras.imaging:Bloom",
    "imaging_dark_current": "cameras.imaging:DarkCurrent",
    "imaging_defects": "cameras.imaging:Defects",
    "imaging_jpeg": "cameras.imaging:Jpeg",
    "imaging_vignetting": "cameras.imaging:Vignetting",
    "intrinsics": "cameras.sensor:Intrinsics",
    "label_choice": "cfg.root:LabelChoice",
    "imu": "cameras.imu:ImuKeys",
    "imu_noise": "cameras.imu:ImuNoiseKeys",
    "labels": "cfg.root:LabelKeys",
    "lidar": "cameras.ranging:LidarKeys",
    "lidar_noise": "cameras.ranging:LidarNoiseKeys",
    "lidar_intensity": "cameras.ranging:LidarIntensityKeys",
    "lidar_footprint": "cameras.ranging:LidarFootprintKeys",
    "lidar_detection": "cameras.ranging:LidarDetectionKeys",
    "light": "light.plan:Lights",
    "light_clouds": "light.cloud_fields:Clouds",
    "light_haze": "light.haze:HazeLayer",
    "light_lamp": "light.lamp:SpotLamp",
    "light_target": "light.lamp:LampTarget",
    "material": "materials.material:MaterialKeys",
    "material_cells": "materials.maps:CellsKeys",
    "material_far": "materials.maps:FarKeys",
    "material_maps": "materials.maps:MapsKeys",
    "model": "objects.models:ModelKeys",
    "model_part": "objects.models:ModelPart",
    "mount": "cameras.mount:Mount",
    "object_detail": "objects.lod:ObjectDetail",
    "object_pose": "objects.poses:ObjectPose",
    "objects_apart": "objects.scattered:Spacing",
    "objects_rocks_coating": "objects.coatings:CoatingPlan",
    "objects_rocks_fillet": "objects.feet:Fillet",
    "objects_scattered": "objects.scattered:Scattered",
    "pose_limits": "cameras.paths.looks:PoseLimits",
    "pose_sampling": "cameras.tracks:Sampling",
    "relief_mask_material": "mesh.terrain:Showing",
    "relief_mesh_roughness": "terrain.sources.mesh_base:Roughness",
    "rig": "cameras.plan:RigKeys",
    "sensor": "cameras.sensor:SensorKeys",
    "shutter": "cameras.exposure:ShutterKeys",
    "sky_label_map": "light.panorama:LabelMap",
    "sky_label_maps": "light.panorama:LabelMaps",
    "sun": "light.suns:SunKeys",
    "sun_ephemeris": "light.sun_ephemeris:SunEphemeris",
    "terrain": "mesh.terrain:Terrain",
    "terrain_horizon": "mesh.terrain:TerrainHorizon",
    "terrain_mesh": "mesh.mesh:Meshing",
    "terrain_planet": "terrain.planet:TerrainPlanet",
    "terrain_shade": "terrain.shade:Shade",
    "trigger": "cameras.mount:Trigger",
    "vehicle": "cameras.vehicle:VehicleKeys",
}
#: Objects and kinds of a cfg by name: what declares each, within ``scenec.compiler``.
CLASSES = _OBJECTS | {
    f"{of}_{name}": place for of, kinds in _KINDS.items() for name, place in kinds.items()
}


def _of(group: str, names: str = "") -> dict[str, str]:
    """Returns the names in ``CLASSES`` of a group's kinds, or of some, by ``type``."""
    return {name: f"{group}_{name}" for name in names.split() or _KINDS[group]}


#: Conditions of objects alone, and those on a place.
_OF_OBJECTS = _of("condition", "camera object")
_PLACES = {name: kind for name, kind in _of("condition").items() if name not in _OF_OBJECTS}
_CONDITIONS: dict[str, Any] = {
    "of": "Kind of condition.",
    "group": "scenec.conditions",
    "shared": "of_conditions",
    "check": "terrain.bounds:Bounds",
    "prefix": "Condition",
}
CHOICES = {
    "clouds_layer": KindChoice(
        title="Clouds: layer",
        description="Clouds that another package draws into the sky: see docs/plugins.md.",
        of="Name that a package offers it under.",
        group="scenec.clouds",
        prefix="Clouds",
        kinds={},
    ),
    "density": KindChoice(
        title="Density",
        description="How likely each place is to hold an object.",
        of="Kind of density.",
        group="scenec.densities",
        kinds=_of("density"),
    ),
    "depth_camera": KindChoice(
        title="Depth camera",
        description="How the sensor measures depth, for the output depth_measured; depth stays "
        "exact.",
        of="Way of measuring.",
        each="Kind.",
        prefix="",
        kinds=_of("depth_camera"),
    ),
    "displacement": KindChoice(
        title="Displacement",
        description="One small relief of a material, in meters along the vertical.",
        of="Kind of relief.",
        each="Kind of operator.",
        kinds=_of("displacement"),
    ),
    "effect": KindChoice(
        title="Effect",
        description="What another package does to a camera's 8-bit picture last: see "
        "docs/plugins.md.",
        of="Name that a package offers it under.",
        group="scenec.effects",
        kinds={},
    ),
    "exposure": KindChoice(
        title="Exposure",
        description="How radiance becomes an 8-bit picture; the radiance itself is not touched.",
        of="Kind of exposure.",
        kinds=_of("exposure"),
    ),
    "ground_where": KindChoice(
        title="Ground: where",
        description="Where a layer lies. Its border runs along the bound; the color fades over "
        "the softness.",
        **_CONDITIONS,
        kinds=_PLACES,
    ),
    "imaging_exposure": KindChoice(
        title="Imaging: exposure",
        description="Exposure time and speed of the sensor.",
        of="Kind.",
        prefix="Imaging exposure",
        kinds=_of("imaging_exposure"),
    ),
    "lens": KindChoice(
        title="Lens",
        description="How the lens bends the picture. Parameters are OpenCV's, but the center of "
        "the top left pixel is (0.5, 0.5): add 0.5 to OpenCV's cx and cy.",
        of="Kind of lens.",
        kinds=_of("lens"),
        keywords={"x-whole": True},
    ),
    "light_more": KindChoice(
        title="Further sun",
        description="A disc far away, beside the sun.",
        of="Kind of disc.",
        kinds=_of("light"),
    ),
    "light_mount": KindChoice(
        title="Lamp's mount",
        description="What a lamp is fixed to.",
        of="Kind of mount.",
        kinds=_of("light_mount"),
    ),
    "objects": KindChoice(
        title="Objects",
        description="One class of objects.",
        of="Kind of objects.",
        kinds=_of("objects"),
    ),
    "objects_where": KindChoice(
        title="Objects: where",
        description="One condition on where objects lie; several multiply.",
        **_CONDITIONS,
        kinds={**_PLACES, "material": "relief_mask_material", **_OF_OBJECTS},
    ),
    "pose": KindChoice(
        title="Pose",
        description="Where a rig is in each sample.",
        of="Kind of pose.",
        group="scenec.poses",
        shared="of_poses",
        kinds=_of("pose"),
    ),
    "pose_center": KindChoice(
        title="Pose: center",
        description="What an orbit goes around.",
        of="Kind of center.",
        prefix="Center",
        kinds=_of("pose_center"),
    ),
    "pose_look": KindChoice(
        title="Pose: look",
        description="What a random pose looks at.",
        of="Kind of look.",
        prefix="Look",
        kinds=_of("pose_look"),
    ),
    "reflectance": KindChoice(
        title="Reflectance",
        description="How the dull part of a surface scatters light.",
        of="Kind of reflectance.",
        kinds=_of("reflectance"),
    ),
    "relief": KindChoice(
        title="Relief operator",
        description="One step in shaping the terrain.",
        of="Kind of operator.",
        group="scenec.relief",
        shared="of_relief",
        prefix="Relief",
        kinds=_of("relief"),
    ),
    "relief_mask": KindChoice(
        title="Relief mask",
        description="Where an operator acts; several conditions multiply. A masked operator "
        "blends before and after, so it conserves nothing.",
        **_CONDITIONS,
        kinds={**_PLACES, "material": "relief_mask_material"},
    ),
    "scan_pattern": KindChoice(
        title="Scan pattern",
        description="Where the rays of a lidar go, by another package: see docs/plugins.md.",
        of="Name that a package offers it under.",
        group="scenec.scans",
        kinds={},
    ),
    "sky": KindChoice(
        title="Sky",
        description="What surrounds the scene.",
        of="Kind of sky.",
        group="scenec.skies",
        shared="of_skies",
        kinds=_of("sky"),
    ),
    "suns": KindChoice(
        title="Sun",
        description="The sun: where the cfg says, or where it stands at a place and a time.",
        of="Kind of sun; left out: disc.",
        kinds={"disc": "sun", "ephemeris": "sun_ephemeris"},
        keywords={"type": ["object", "null"]},
        usual="disc",
    ),
    "surface": KindChoice(
        title="Surface",
        description="Pictures of color, roughness and normals that the compiler makes, without "
        "seams; their means are the material's base_color and roughness. grain_m is at most a "
        "quarter of size_m; what is finer than pixels fades.",
        of="Kind of surface.",
        group="scenec.surfaces",
        shared="of_surfaces",
        says="size_m, left out, is {0.SIZE_M:g} m.",
        kinds=_of("surface"),
    ),
}
#: What kinds of other packages have to derive from, by group, as in ``CLASSES``.
BASES = {
    "scenec.clouds": "light.sky:CloudLayer",
    "scenec.conditions": "terrain.condition:Quantity",
    "scenec.densities": "objects.density:Density",
    "scenec.rocks": "objects.families.shape:Shape",
    "scenec.scans": "cameras.ranging:ScanPattern",
    "scenec.skies": "light.sky:Sky",
    "scenec.surfaces": "materials.surface:Surface",
}
#: What they, or what they draw, have beside what is abstract there.
NEEDS = {
    "scenec.effects": ("apply(picture, random)",),
    "scenec.poses": ("built(context)", "needs_objects"),
    "scenec.relief": ("apply(grid, height)",),
    "scenec.surfaces": ("SIZE_M", "RELIEF"),
}


def class_of(name: str) -> type[Any]:
    """Returns the class that declares an object or a kind, by its name in ``CLASSES``."""
    kind: type[Any] = loaded(CLASSES[name])
    return kind


def kind_of(choice: str, name: str) -> type[Any]:
    """Returns the class of a kind by its ``type``; another package's where it is no own one.

    Raises:
        ScenecError: No package offers it, or what it offers is no kind.
    """
    found = CHOICES[choice]
    return class_of(found.kinds[name]) if name in found.kinds else offered_kind(found.group, name)


def offered_kind(group: str, name: str) -> type[Any]:
    """Returns the class of a kind that another package offers.

    Raises:
        ScenecError: No package offers it, or what it offers is no kind of its group.
    """
    kind = load_kind(group, name)
    draws = group not in BASES and hasattr(kind, "draw") and not hasattr(kind, "SCHEMA")
    lacks = "" if draws else lacking(group, kind)
    if not lacks and hasattr(kind, "check") and not _answers(kind, "check(node)"):
        lacks = "a static method check(node)"
    if lacks:
        raise ScenecError(f"{named(group, name)}: expected {lacks}")
    return kind


def base_of(group: str) -> type[Any]:
    """Returns what kinds of other packages have to derive from."""
    return loaded(BASES[group]) if group in BASES else object


def lacking(group: str, kind: type[Any]) -> str:
    """Returns what another package's class, or what its kind draws, lacks; "": nothing."""
    base = base_of(group)
    if not issubclass(kind, base):
        return f"a subclass of {base.__module__}.{base.__qualname__}"
    abstract = (
        f"{name}({', '.join([*inspect.signature(getattr(of, name)).parameters][1:])})"
        for of in filter(is_builtin, kind.__mro__)
        for name in sorted(getattr(of, "__abstractmethods__", ()))
    )
    needed = (*abstract, *NEEDS.get(group, ()))
    lacks = next((need for need in needed if not _answers(kind, need)), "")
    return lacks and f"{'a method' if '(' in lacks else 'an attribute'} {lacks}"


def _answers(kind: type[Any], need: str) -> bool:
    """Whether a class has an attribute, or a method that takes such arguments."""
    name, is_method, arguments = need.rstrip(")").partition("(")
    found = inspect.getattr_static(kind, name, None)
    if not is_method or found is None or getattr(found, "__isabstractmethod__", False):
        return not is_method and hasattr(kind, name)
    own = [] if isinstance(found, staticmethod | classmethod) or name == "check" else [kind]
    try:
        inspect.signature(getattr(kind, name)).bind(*own, *filter(None, arguments.split(", ")))
    except TypeError:
        return False
    except ValueError:
        # Compiled, without a signature.
        return True
    return True


def name_of(choice: str, kind: type[Any]) -> str:
    """Returns the ``type`` that a class goes by; what an own kind draws says it by its ``KIND``."""
    if not is_builtin(kind):
        return plugin_name(CHOICES[choice].group, kind)
    if "KIND" in vars(kind):
        return str(kind.KIND)
    place = f"{kind.__module__.removeprefix('scenec.compiler.')}:{kind.__qualname__}"
    own = (name for name, of in CHOICES[choice].kinds.items() if CLASSES[of] == place)
    return next(own, kind.__name__)


def is_builtin(kind: type[Any]) -> bool:
    """Whether a kind is one of this package."""
    return kind.__module__.startswith("scenec.compiler.")


@cache
def loaded(place: str) -> Any:
    """Returns what stands at a place of the compiler, ``module:name``."""
    module, _, name = place.partition(":")
    return getattr(importlib.import_module(f"scenec.compiler.{module}"), name)
