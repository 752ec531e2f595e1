"""Names the kinds that a cfg can give, and the classes that declare them.

Nothing is imported before it is named. Kinds of other packages come in by entry points
(``scenec.schemas.plugins``), into the choices that have a group.
"""

from __future__ import annotations

import importlib
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cache
from typing import Any

from scenec.schemas.plugins import load_kind, plugin_name


@dataclass(frozen=True)
class Choice:
    """One of several kinds, which the key ``type`` tells.

    Attributes:
        title, description: Of the choice.
        of: What the key ``type`` is.
        each: The same in the tables of its kinds, where they say otherwise.
        prefix: Of the titles of its kinds.
        kinds: By ``type``: the name in ``CLASSES``.
        group: Of the entry points by which other packages add kinds; "" without.
        says: What each kind says after its description, of the class {0}.
        shared: Which function of ``shared`` says what keys each kind has after its own; "" none.
        keywords: More that JSON Schema says of it.
        check: Whose check holds for kinds that have none of their own, as in ``CLASSES``.
    """

    title: str
    description: str
    of: str
    prefix: str
    kinds: Mapping[str, str]
    group: str = ""
    each: str = ""
    says: str = ""
    shared: str = ""
    keywords: Mapping[str, Any] = field(default_factory=dict)
    check: str = ""


def kinds(prefix: str, names: str, **others: str) -> dict[str, str]:
    """Returns names in ``CLASSES`` by ``type``: prefix and ``type``, but for some."""
    return {name: prefix + name for name in names.split()} | others


#: Relief operators: what declares each, within ``scenec.compiler``.
_RELIEF = {
    "plane": "terrain.sources.plane:Plane",
    "dem": "terrain.sources.dem:Dem",
    "mesh": "terrain.sources.mesh_base:MeshBase",
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
}
CHOICES = {
    "clouds_layer": Choice(
        title="Clouds: layer",
        description="Clouds that another package draws into the sky: see docs/plugins.md.",
        of="Name that a package offers it under.",
        group="scenec.clouds",
        prefix="Clouds",
        kinds=kinds("clouds_", ""),
    ),
    "density": Choice(
        title="Density",
        description="How likely each place is to hold an object.",
        of="Kind of density.",
        group="scenec.densities",
        prefix="Density",
        kinds=kinds("density_", "uniform noise worley image clusters path rings around"),
    ),
    "depth_camera": Choice(
        title="Depth camera",
        description="How the sensor measures depth, for the output depth_measured. The output "
        "depth stays exact.",
        of="Way of measuring.",
        each="Kind.",
        prefix="",
        kinds=kinds("depth_camera_", "stereo time_of_flight"),
    ),
    "displacement": Choice(
        title="Displacement",
        description="One small relief of a material, in meters along the vertical.",
        of="Kind of relief.",
        each="Kind of operator.",
        prefix="Displacement",
        kinds=kinds("displacement_", "multifractal worley crust terraces"),
    ),
    "effect": Choice(
        title="Effect",
        description="What is done to a camera's 8-bit picture after all else, by another package: "
        "see docs/plugins.md.",
        of="Name that a package offers it under.",
        group="scenec.effects",
        prefix="Effect",
        kinds=kinds("effect_", ""),
    ),
    "exposure": Choice(
        title="Exposure",
        description="How radiance becomes an 8-bit picture; the radiance itself is not touched.",
        of="Kind of exposure.",
        prefix="Exposure",
        kinds=kinds("exposure_", "auto incident fixed"),
    ),
    "ground_where": Choice(
        title="Ground: where",
        description="One condition on where a layer lies. Its border runs along the bound; the "
        "color fades over the softness about it.",
        of="Kind of condition.",
        group="scenec.conditions",
        shared="of_conditions",
        check="terrain.bounds:Bounds",
        prefix="Condition",
        kinds=kinds("condition_", "height slope curvature flow crater_freshness noise point path"),
    ),
    "imaging_exposure": Choice(
        title="Imaging: exposure",
        description="Exposure time and speed of the sensor.",
        of="Kind.",
        prefix="Imaging exposure",
        kinds=kinds("imaging_exposure_", "metered manual auto"),
    ),
    "lens": Choice(
        title="Lens",
        description="How the lens bends the picture. The parameters are OpenCV's, so that its "
        "calibrations can be pasted; but the center of the top left pixel is (0.5, 0.5), OpenCV's "
        "(0, 0): its cx and cy are less by a half.",
        of="Kind of lens.",
        prefix="Lens",
        kinds=kinds("lens_", "brown_conrady kannala_brandt equirectangular"),
        keywords={"x-whole": True},
    ),
    "light_more": Choice(
        title="Further sun",
        description="A disc far away, beside the sun.",
        of="Kind of disc.",
        prefix="Further sun",
        kinds=kinds("light_", "sun earthshine"),
    ),
    "light_mount": Choice(
        title="Lamp's mount",
        description="What a lamp is fixed to.",
        of="Kind of mount.",
        prefix="Lamp's mount",
        kinds=kinds("light_mount_", "rig world"),
    ),
    "objects": Choice(
        title="Objects",
        description="One class of objects.",
        of="Kind of objects.",
        prefix="Objects",
        kinds=kinds("objects_", "rocks meshes placed"),
    ),
    "objects_where": Choice(
        title="Objects: where",
        description="One condition on where objects lie; several multiply.",
        of="Kind of condition.",
        group="scenec.conditions",
        shared="of_conditions",
        check="terrain.bounds:Bounds",
        prefix="Condition",
        kinds=kinds(
            "condition_",
            "height slope curvature flow crater_freshness noise point path",
            material="relief_mask_material",
        )
        | kinds("condition_", "camera object"),
    ),
    "pose": Choice(
        title="Pose",
        description="Where a rig is in each sample.",
        of="Kind of pose.",
        group="scenec.poses",
        shared="of_poses",
        prefix="Pose",
        kinds=kinds("pose_", "random_target track random orbit lawn_mower rover mav descent"),
    ),
    "pose_center": Choice(
        title="Pose: center",
        description="What an orbit goes around.",
        of="Kind of center.",
        prefix="Center",
        kinds=kinds("pose_center_", "point object"),
    ),
    "pose_look": Choice(
        title="Pose: look",
        description="What a random pose looks at.",
        of="Kind of look.",
        prefix="Look",
        kinds=kinds("pose_look_", "direction point object"),
    ),
    "reflectance": Choice(
        title="Reflectance",
        description="How the dull part of a surface scatters light.",
        of="Kind of reflectance.",
        prefix="Reflectance",
        kinds=kinds("reflectance_", "lambert lommel_seeliger hapke"),
    ),
    "relief": Choice(
        title="Relief operator",
        description="One step in shaping the terrain.",
        of="Kind of operator.",
        group="scenec.relief",
        shared="of_relief",
        prefix="Relief",
        kinds=kinds("relief_", " ".join(_RELIEF)),
    ),
    "relief_mask": Choice(
        title="Relief mask",
        description="One condition on where an operator acts; several multiply. A masked operator "
        "is a blend of before and after, so it conserves nothing.",
        of="Kind of condition.",
        group="scenec.conditions",
        shared="of_conditions",
        check="terrain.bounds:Bounds",
        prefix="Condition",
        kinds=kinds(
            "condition_",
            "height slope curvature flow crater_freshness noise point path",
            material="relief_mask_material",
        ),
    ),
    "sky": Choice(
        title="Sky",
        description="What surrounds the scene.",
        of="Kind of sky.",
        group="scenec.skies",
        shared="of_skies",
        prefix="Sky",
        kinds=kinds("sky_", "atmosphere clear image none overcast"),
    ),
    "surface": Choice(
        title="Surface",
        description="Pictures of color, roughness and normals that the compiler makes, without "
        "seams; base_color and roughness of the material are their means.",
        of="Kind of surface.",
        group="scenec.surfaces",
        shared="of_surfaces",
        says="size_m, left out, is {0.SIZE_M:g} m.",
        prefix="Surface",
        kinds=kinds(
            "surface_",
            "granite basalt sandstone breccia weathered sand gravel mud_cracks regolith soil "
            "pavement turf",
        ),
    ),
}
#: Objects and kinds of a cfg by name: what declares each, within ``scenec.compiler``.
CLASSES = {
    **{f"relief_{name}": place for name, place in _RELIEF.items()},
    "cfg": "cfg.whole:Cfg",
    "clouds_cirrus": "light.cloud_fields:CirrusClouds",
    "clouds_cumulus": "light.cloud_fields:CumulusClouds",
    "condition_camera": "objects.conditions:FromCameras",
    "condition_crater_freshness": "terrain.freshness:Freshness",
    "condition_curvature": "terrain.condition:Curvature",
    "condition_flow": "terrain.condition:Flow",
    "condition_height": "terrain.condition:Height",
    "condition_noise": "terrain.condition:Noise",
    "condition_object": "objects.conditions:FromObjects",
    "condition_path": "terrain.condition:FromPath",
    "condition_point": "terrain.condition:FromPoint",
    "condition_ragged": "terrain.condition:Ragged",
    "condition_slope": "terrain.condition:Slope",
    "density_around": "objects.density:AroundDensity",
    "density_clusters": "objects.density:Clusters",
    "density_image": "objects.density:ImageDensity",
    "density_noise": "objects.density:NoiseDensity",
    "density_path": "objects.density:PathDensity",
    "density_rings": "objects.rings:RingDensity",
    "density_uniform": "objects.density:UniformDensity",
    "density_worley": "objects.density:WorleyDensity",
    "depth_camera_stereo": "cameras.ranging:Stereo",
    "depth_camera_time_of_flight": "cameras.ranging:TimeOfFlight",
    "displacement_crust": "terrain.operators.crust:Crust",
    "displacement_multifractal": "terrain.operators.multifractal:Multifractal",
    "displacement_terraces": "terrain.operators.terraces:Terraces",
    "displacement_worley": "terrain.operators.worley:Worley",
    "exposure_auto": "cameras.exposure:Auto",
    "exposure_fixed": "cameras.exposure:Fixed",
    "exposure_incident": "cameras.exposure:Incident",
    "focus": "cameras.lens:Focus",
    "ground_base": "mesh.terrain:GroundBase",
    "ground_layer": "mesh.terrain:GroundLayer",
    "ground_noise": "mesh.terrain:GroundNoise",
    "imaging": "cameras.imaging:Imaging",
    "imaging_bloom": "cameras.imaging:Bloom",
    "imaging_dark_current": "cameras.imaging:DarkCurrent",
    "imaging_defects": "cameras.imaging:Defects",
    "imaging_exposure_auto": "cameras.imaging:Auto",
    "imaging_exposure_manual": "cameras.imaging:Manual",
    "imaging_exposure_metered": "cameras.imaging:Metered",
    "imaging_jpeg": "cameras.imaging:Jpeg",
    "imaging_vignetting": "cameras.imaging:Vignetting",
    "intrinsics": "cameras.sensor:Intrinsics",
    "label_choice": "cfg.whole:LabelChoice",
    "labels": "cfg.whole:Labels",
    "lens_brown_conrady": "cameras.lens:BrownConrady",
    "lens_equirectangular": "cameras.lens:Equirectangular",
    "lens_kannala_brandt": "cameras.lens:KannalaBrandt",
    "lidar": "cameras.ranging:Lidar",
    "lidar_noise": "cameras.ranging:LidarNoise",
    "light": "light.plan:Lights",
    "light_clouds": "light.cloud_fields:Clouds",
    "light_earthshine": "light.earthshine:Earthshine",
    "light_haze": "light.haze:HazeLayer",
    "light_lamp": "light.lamp:SpotLamp",
    "light_mount_rig": "light.lamp:RigMount",
    "light_mount_world": "light.lamp:WorldMount",
    "light_sun": "light.suns:Sun",
    "light_target": "light.lamp:Target",
    "material": "materials.material:MaterialKeys",
    "material_cells": "materials.maps:CellsKeys",
    "material_far": "materials.maps:FarKeys",
    "material_maps": "materials.maps:MapsKeys",
    "model": "objects.models:ModelFile",
    "model_part": "objects.models:ModelPart",
    "mount": "cameras.mount:Mount",
    "object_detail": "objects.lod:ObjectDetail",
    "object_pose": "objects.poses:ObjectPose",
    "objects_apart": "objects.scattered:Spacing",
    "objects_meshes": "objects.meshes:Meshes",
    "objects_placed": "objects.poses:Placed",
    "objects_rocks": "objects.families.rocks:Rocks",
    "objects_rocks_coating": "objects.coatings:CoatingPlan",
    "objects_rocks_fillet": "objects.feet:Fillet",
    "objects_scattered": "objects.scattered:Scattered",
    "pose_center_object": "cameras.paths.orbit:ObjectAim",
    "pose_center_point": "cameras.paths.orbit:PointAim",
    "pose_descent": "cameras.paths.descent:Descent",
    "pose_lawn_mower": "cameras.paths.lawn_mower:LawnMower",
    "pose_limits": "cameras.paths.looks:Limits",
    "pose_look_direction": "cameras.paths.looks:LookDirection",
    "pose_look_object": "cameras.paths.orbit:ObjectAim",
    "pose_look_point": "cameras.paths.looks:LookPoint",
    "pose_mav": "cameras.paths.mav:Mav",
    "pose_orbit": "cameras.paths.orbit:Orbit",
    "pose_random": "cameras.paths.random_pose:RandomPose",
    "pose_random_target": "cameras.paths.random_target:RandomTarget",
    "pose_rover": "cameras.paths.rover:Rover",
    "pose_sampling": "cameras.tracks:Sampling",
    "pose_track": "cameras.tracks:TrackFile",
    "reflectance_hapke": "materials.reflectance:Hapke",
    "reflectance_lambert": "materials.reflectance:Lambert",
    "reflectance_lommel_seeliger": "materials.reflectance:LommelSeeliger",
    "relief_mask_material": "mesh.terrain:Showing",
    "relief_mesh_roughness": "terrain.sources.mesh_base:Roughness",
    "rig": "cameras.plan:Rig",
    "sensor": "cameras.sensor:Sensor",
    "shutter": "cameras.exposure:Shutter",
    "sky_atmosphere": "light.atmosphere_sky:AtmosphereSky",
    "sky_clear": "light.clear_sky:ClearSky",
    "sky_image": "light.panorama:ImageSky",
    "sky_label_map": "light.panorama:LabelMap",
    "sky_label_maps": "light.panorama:LabelMaps",
    "sky_none": "light.sky:BlackSky",
    "sky_overcast": "light.overcast:OvercastSky",
    "sun": "light.suns:Sun",
    "surface_basalt": "materials.rocks:Basalt",
    "surface_breccia": "materials.rocks:Breccia",
    "surface_granite": "materials.rocks:Granite",
    "surface_gravel": "materials.grounds:Gravel",
    "surface_mud_cracks": "materials.grounds:MudCracks",
    "surface_pavement": "materials.pavement:Pavement",
    "surface_regolith": "materials.grounds:Regolith",
    "surface_sand": "materials.grounds:Sand",
    "surface_sandstone": "materials.rocks:Sandstone",
    "surface_soil": "materials.grounds:Soil",
    "surface_turf": "materials.turf:Turf",
    "surface_weathered": "materials.rocks:Weathered",
    "terrain": "mesh.terrain:Terrain",
    "terrain_horizon": "mesh.terrain:TerrainHorizon",
    "terrain_mesh": "mesh.mesh:Meshing",
    "terrain_shade": "terrain.shade:Shade",
    "trigger": "cameras.mount:Trigger",
}


def class_of(name: str) -> type[Any]:
    """Returns the class that declares an object or a kind, by its name in ``CLASSES``."""
    made: type[Any] = loaded(CLASSES[name])
    return made


def kind_of(choice: str, name: str) -> type[Any]:
    """Returns the class of a kind by its ``type``; another package's where it is no own one.

    Raises:
        ScenecError: No package offers it, or what it offers is no kind.
    """
    found = CHOICES[choice]
    return class_of(found.kinds[name]) if name in found.kinds else load_kind(found.group, name)


def name_of(choice: str, kind: type[Any]) -> str:
    """Returns the ``type`` that a class goes by; what a kind draws says it by its ``KIND``."""
    if "KIND" in vars(kind):
        return str(kind.KIND)
    place = f"{kind.__module__.removeprefix('scenec.compiler.')}:{kind.__qualname__}"
    own = (name for name, of in CHOICES[choice].kinds.items() if CLASSES[of] == place)
    return next(own, "") or plugin_name(CHOICES[choice].group, kind)


@cache
def loaded(place: str) -> Any:
    """Returns what stands at a place of the compiler, ``module:name``."""
    module, _, name = place.partition(":")
    return getattr(importlib.import_module(f"scenec.compiler.{module}"), name)
