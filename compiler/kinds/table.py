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


def kinds(prefix: str, names: str, **others: str) -> dict[str, str]:
    """Returns names in ``CLASSES`` by ``type``: prefix and ``type``, but for some."""
    return {name: prefix + name for name in names.split()} | others


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
        kinds=kinds(
            "relief_",
            "plane dem mesh multifractal worley polygons crust craters dunes barchans ripples "
            "terraces stream_power thermal diffusion smooth tracks footprints",
        ),
    ),
    "relief_mask": Choice(
        title="Relief mask",
        description="One condition on where an operator acts; several multiply. A masked operator "
        "is a blend of before and after, so it conserves nothing.",
        of="Kind of condition.",
        group="scenec.conditions",
        shared="of_conditions",
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
    "depth_camera_stereo": "kinds.declared_cameras:DepthCameraStereo",
    "depth_camera_time_of_flight": "kinds.declared_cameras:DepthCameraTimeOfFlight",
    "displacement_crust": "kinds.declared_relief:DisplacementCrust",
    "displacement_multifractal": "terrain.operators.multifractal:Multifractal",
    "displacement_terraces": "kinds.declared_relief:DisplacementTerraces",
    "displacement_worley": "kinds.declared_relief:DisplacementWorley",
    "exposure_auto": "kinds.declared_cameras:ExposureAuto",
    "exposure_fixed": "kinds.declared_cameras:ExposureFixed",
    "exposure_incident": "kinds.declared_cameras:ExposureIncident",
    "focus": "kinds.declared_cameras:Focus",
    "ground_base": "kinds.declared_terrain:GroundBase",
    "ground_layer": "kinds.declared_terrain:GroundLayer",
    "ground_noise": "kinds.declared_terrain:GroundNoise",
    "imaging": "kinds.declared_cameras:Imaging",
    "imaging_bloom": "kinds.declared_cameras:ImagingBloom",
    "imaging_dark_current": "kinds.declared_cameras:ImagingDarkCurrent",
    "imaging_defects": "kinds.declared_cameras:ImagingDefects",
    "imaging_exposure_auto": "kinds.declared_cameras:ImagingExposureAuto",
    "imaging_exposure_manual": "kinds.declared_cameras:ImagingExposureManual",
    "imaging_exposure_metered": "kinds.declared_cameras:ImagingExposureMetered",
    "imaging_jpeg": "kinds.declared_cameras:ImagingJpeg",
    "imaging_vignetting": "kinds.declared_cameras:ImagingVignetting",
    "intrinsics": "kinds.declared_cameras:Intrinsics",
    "label_choice": "cfg.whole:LabelChoice",
    "labels": "cfg.whole:Labels",
    "lens_brown_conrady": "kinds.declared_cameras:LensBrownConrady",
    "lens_equirectangular": "kinds.declared_cameras:LensEquirectangular",
    "lens_kannala_brandt": "kinds.declared_cameras:LensKannalaBrandt",
    "lidar": "kinds.declared_cameras:Lidar",
    "lidar_noise": "kinds.declared_cameras:LidarNoise",
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
    "model": "kinds.declared_objects:Model",
    "model_part": "kinds.declared_objects:ModelPart",
    "mount": "kinds.declared_cameras:Mount",
    "object_detail": "kinds.declared_objects:ObjectDetail",
    "object_pose": "kinds.declared_objects:ObjectPose",
    "objects_apart": "kinds.declared_objects:ObjectsApart",
    "objects_meshes": "kinds.declared_objects:ObjectsMeshes",
    "objects_placed": "kinds.declared_objects:ObjectsPlaced",
    "objects_rocks": "kinds.declared_objects:ObjectsRocks",
    "objects_rocks_coating": "kinds.declared_objects:ObjectsRocksCoating",
    "objects_rocks_fillet": "kinds.declared_objects:ObjectsRocksFillet",
    "objects_scattered": "kinds.declared_objects:ObjectsScattered",
    "pose_center_object": "kinds.declared_poses:PoseCenterObject",
    "pose_center_point": "kinds.declared_poses:PoseCenterPoint",
    "pose_descent": "kinds.declared_poses:PoseDescent",
    "pose_lawn_mower": "kinds.declared_poses:PoseLawnMower",
    "pose_limits": "kinds.declared_poses:PoseLimits",
    "pose_look_direction": "kinds.declared_poses:PoseLookDirection",
    "pose_look_object": "kinds.declared_poses:PoseLookObject",
    "pose_look_point": "kinds.declared_poses:PoseLookPoint",
    "pose_mav": "kinds.declared_poses:PoseMav",
    "pose_orbit": "kinds.declared_poses:PoseOrbit",
    "pose_random": "kinds.declared_poses:PoseRandom",
    "pose_random_target": "kinds.declared_poses:PoseRandomTarget",
    "pose_rover": "kinds.declared_poses:PoseRover",
    "pose_sampling": "kinds.declared_poses:PoseSampling",
    "pose_track": "kinds.declared_poses:PoseTrack",
    "reflectance_hapke": "materials.reflectance:Hapke",
    "reflectance_lambert": "materials.reflectance:Lambert",
    "reflectance_lommel_seeliger": "materials.reflectance:LommelSeeliger",
    "relief_barchans": "kinds.declared_relief:ReliefBarchans",
    "relief_craters": "terrain.operators.craters:CraterLaw",
    "relief_crust": "kinds.declared_relief:ReliefCrust",
    "relief_dem": "kinds.declared_relief:ReliefDem",
    "relief_diffusion": "kinds.declared_relief:ReliefDiffusion",
    "relief_dunes": "kinds.declared_relief:ReliefDunes",
    "relief_footprints": "kinds.declared_relief:ReliefFootprints",
    "relief_mask_material": "mesh.cover:Showing",
    "relief_mesh": "kinds.declared_relief:ReliefMesh",
    "relief_mesh_roughness": "kinds.declared_relief:ReliefMeshRoughness",
    "relief_multifractal": "terrain.operators.multifractal:Multifractal",
    "relief_plane": "kinds.declared_relief:ReliefPlane",
    "relief_polygons": "kinds.declared_relief:ReliefPolygons",
    "relief_ripples": "kinds.declared_relief:ReliefRipples",
    "relief_smooth": "kinds.declared_relief:ReliefSmooth",
    "relief_stream_power": "kinds.declared_relief:ReliefStreamPower",
    "relief_terraces": "kinds.declared_relief:ReliefTerraces",
    "relief_thermal": "kinds.declared_relief:ReliefThermal",
    "relief_tracks": "kinds.declared_relief:ReliefTracks",
    "relief_worley": "kinds.declared_relief:ReliefWorley",
    "rig": "kinds.declared_cameras:Rig",
    "sensor": "kinds.declared_cameras:Sensor",
    "shutter": "kinds.declared_cameras:Shutter",
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
    "terrain": "kinds.declared_terrain:Terrain",
    "terrain_horizon": "kinds.declared_terrain:TerrainHorizon",
    "terrain_mesh": "kinds.declared_terrain:TerrainMesh",
    "terrain_shade": "kinds.declared_terrain:TerrainShade",
    "trigger": "kinds.declared_cameras:Trigger",
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
