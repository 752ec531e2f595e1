"""Lists the classes that entries may hold: data, made by their constructors alone."""

from __future__ import annotations

_OF: dict[str, tuple[str, ...]] = {
    "cameras.paths.motion": ("Bodies",),
    "mesh.cover": ("MaterialCondition",),
    "mesh.signed_bound": ("SignedBound",),
    "mesh.merge": ("Merge",),
    "light.build": ("Light",),
    "views.prune": ("Pruned",),
    "objects.lod": ("Levels",),
    "scene.rig": ("Between", "Focus", "Lidar", "LidarNoise", "OpenShutter", "Rig", "Sensor"),
    "scene.ground": ("Ground", "GroundLayer", "Tile"),
    "scene.light": ("Gobo", "Haze", "Lamp", "SkyLabelMaps", "SkyLight", "SunLight"),
    "scene.material": ("Cells", "Far", "Material", "MaterialMaps", "Picture", "Reflectance"),
    "scene.objects": ("MeshPart", "Placed", "Prototype", "Scatter"),
    "scene.scene": ("Georeference", "Scene"),
    "materials.finish": ("Finished",),
    "materials.footprint": ("Footprint",),
    "materials.plan": ("Sources",),
    "materials.reduce": ("Reduced",),
    "materials.tile": ("Look",),
    "terrain.bins": ("Bins",),
    "terrain.condition": (
        "Curvature", "Flow", "Freshness", "FromPath", "FromPoint", "Height", "Interval", "Noise",
        "Ragged", "Slope",
    ),
    "terrain.detail": ("Spectrum", "Sum", "Weighted"),
    "terrain.fillets": ("Feet", "Fillets"),
    "terrain.grid": ("Grid", "HeightField"),
    "terrain.sources.mesh_surface": ("MeshSurface",),
    "terrain.operators.crust": ("Crust", "CrustDetail"),
    "terrain.operators.footprints": ("Footprints", "FootprintsDetail", "Sole"),
    "terrain.operators.multifractal": ("Multifractal", "MultifractalDetail"),
    "terrain.program": ("Relief",),
    "terrain.operators.worley": ("Worley", "WorleyDetail"),
}  # fmt: skip

#: By full name, ``module:class``.
KINDS: frozenset[str] = frozenset(
    [f"scenec.compiler.{module}:{name}" for module, names in _OF.items() for name in names]
    + [f"scenec.schemas.left_out:{name}" for name in ("ClassRecord", "Reason", "Record")]
    + ["scenec.schemas.lens:Lens", "scenec.schemas.imaging:Imaging"]
    + ["scenec.schemas.shutter:Shutter"]
    + [
        f"scenec.schemas.depth_camera:{name}"
        for name in ("DepthCamera", "StereoDepth", "TimeOfFlightDepth")
    ]
)

#: Classes that are no dataclasses: what their constructors take, which they keep by these names.
PLAIN: dict[str, tuple[str, ...]] = {
    "scenec.compiler.terrain.quantities:Quantities": ("grid", "height"),
    "scenec.compiler.terrain.quantities:Samples": ("x", "y"),
}
