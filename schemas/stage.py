"""Names in the stage that are ours: the one place where compiler and reader agree on them.

Where USD has a schema the stage uses it, and its names are not repeated here. What stands here is
documented for other writers in ``docs/stage.md``.
"""

from __future__ import annotations

#: Version of this stage schema, authored on the root; a reader refuses a newer major one.
SCHEMA_VERSION = "1.3"

ATTR_SCHEMA_VERSION = "scenec:schemaVersion"
#: double, time-sampled: real time of a sample in seconds.
ATTR_TIME = "scenec:time"
#: token[] and uint[]: the table name <-> id of one label level, on the root prim.
ATTR_LABEL_NAMES = "scenec:labels:{level}:names"
ATTR_LABEL_IDS = "scenec:labels:{level}:ids"
#: uint on a PointInstancer (authored in the root layer): frame id = base + local id.
ATTR_INSTANCE_ID_BASE = "scenec:instanceIdBase"
#: bool on a PointInstancer: false leaves its range of ids free and resolves to 0.
ATTR_INSTANCE_IDS_ENABLED = "scenec:instanceIdsEnabled"
#: uint on an object that is not scattered: its frame id.
ATTR_INSTANCE_ID = "scenec:instanceId"
#: uint on an object below a prim that has an instanceIdBase: frame id = base + this, from 1.
ATTR_LOCAL_INSTANCE_ID = "scenec:localInstanceId"
#: double[9], row-major, pixels: the authoritative intrinsics of a camera.
ATTR_INTRINSICS = "scenec:intrinsics"

#: On the root, where a DEM says on which place of a planet it lies. Nothing reads it: no number of
#: the scene depends on it. string: coordinate reference system, an authority's code or WKT.
ATTR_GEOREFERENCE_CRS = "scenec:georeference:crs"
#: double2: the stage's origin in that system, first axis first (easting, northing).
ATTR_GEOREFERENCE_CENTER = "scenec:georeference:center"
#: double: what was added to the DEM's (scaled) heights, meters.
ATTR_GEOREFERENCE_HEIGHT_OFFSET = "scenec:georeference:heightOffset"

#: Relationship of a mesh to its ordered ground materials; layer 0 is the base.
REL_LAYERS = "scenec:layers"
#: Vertex primvar: weight of merge i (layer i over all before it), i from 1.
PRIMVAR_WEIGHT = "scenec_weight_{merge}"
#: Vertex primvar in [-1, 1]: albedo of every material is base * (1 + variation * this).
#: On a PointInstancer the same name is one value an instance.
PRIMVAR_VARIATION = "scenec_variation"
#: Uniform (or constant) int primvar: label id of each face, per level; 0 is "no label".
PRIMVAR_LABEL = "scenec_label_{level}"

#: Surface model on a Material, alpha = roughness**2 for both lobes:
#: (1-m) * ((1-s) * Lambert(base color) + s * GGX(white)) + m * GGX(base color).
ATTR_BASE_COLOR = "scenec:surface:baseColor"
ATTR_SPECULAR = "scenec:surface:specular"
ATTR_ROUGHNESS = "scenec:surface:roughness"
ATTR_METALLIC = "scenec:surface:metallic"
ATTR_COLOR_VARIATION = "scenec:surface:variation"
#: float, 0 where not authored: roughness at a point is roughness * (1 + this * the same primvar).
ATTR_ROUGHNESS_VARIATION = "scenec:surface:roughnessVariation"
#: asset: pictures that vary a surface; base color multiplies, the others take the place of the
#: number. Keys as in ``schemas.maps.MAP_CHANNELS``.
ATTR_MAPS = {
    "base_color": "scenec:surface:maps:baseColor",
    "roughness": "scenec:surface:maps:roughness",
    "metallic": "scenec:surface:maps:metallic",
    "normal": "scenec:surface:maps:normal",
}
#: token, "above" where not authored: along the world's z (u = x / size, v = y / size), along its
#: three axes, mixed by the shading normal's fourth powers, or by the mesh's primvar ``st``.
ATTR_MAP_PROJECTION = "scenec:surface:maps:projection"
MAP_PROJECTIONS = ("above", "triplanar", "uv")
#: Texture coordinates of a mesh, texCoord2f[], v up: vertex or faceVarying.
PRIMVAR_UV = "st"
#: double: side of one repeat, in stage units; not authored with the projection "uv".
ATTR_MAP_SIZE = "scenec:surface:maps:size"
#: token: "opengl" (the normals' y points up in the picture) or "directx".
ATTR_NORMAL_CONVENTION = "scenec:surface:maps:normalConvention"

#: A UsdGeomCamera looks down -z with y up, the contract's camera (OpenCV) down +z with y down: they
#: differ by a half turn about x, which gives the columns of a rotation these signs.
HALF_TURN = (1.0, -1.0, -1.0)

ROOT = "/World"
SKY_PRIM = "/World/Sky"
RENDER_SCOPE = "/Render"


def label_primvar(level: str) -> str:
    """Name (without ``primvars:``) of the label primvar of one level."""
    return PRIMVAR_LABEL.format(level=level)


def weight_primvar(merge: int) -> str:
    """Name (without ``primvars:``) of the weight primvar of merge ``merge`` (from 1)."""
    return PRIMVAR_WEIGHT.format(merge=merge)
