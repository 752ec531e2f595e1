"""Names in the stage that are ours: the one place where compiler and reader agree on them.

Where USD has a schema the stage uses it, and its names are not repeated here. What stands here is
documented for other writers in ``docs/stage.md``.
"""

from __future__ import annotations

#: Version of this stage schema, authored on the root; a reader refuses a newer major one.
SCHEMA_VERSION = "1.12"

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
#: On a camera. token, double[], double: a lens by the formulas of ``schemas.lens``, which then tell
#: the plane that K maps to pixels: "brown_conrady", "kannala_brandt" or "equirectangular" (a
#: pinhole where not authored); its coefficients in OpenCV's order; and of kannala_brandt the angle
#: to the axis, radians, beyond which there are no rays (pi where not authored). Constant over time.
#: The camera's focal length and apertures are those of the pinhole with the same K, which shows the
#: same at the axis.
ATTR_LENS_MODEL = "scenec:lens:model"
ATTR_LENS_COEFFICIENTS = "scenec:lens:coefficients"
ATTR_LENS_MAX_ANGLE = "scenec:lens:maxAngle"

#: On the root, where a DEM says on which place of a planet it lies. No number of the scene depends
#: on it. string: coordinate reference system, an authority's code or WKT.
ATTR_GEOREFERENCE_CRS = "scenec:georeference:crs"
#: double2: the stage's origin in that system, first axis first (easting, northing).
ATTR_GEOREFERENCE_CENTER = "scenec:georeference:center"
#: double: what was added to the DEM's (scaled) heights, meters.
ATTR_GEOREFERENCE_HEIGHT_OFFSET = "scenec:georeference:heightOffset"
#: Further fields of ``schemas.georeference.Georeference``, where the body is known: the attribute,
#: and its type. Those that have their default are left out.
GEOREFERENCE = {
    "semi_major_m": ("scenec:georeference:semiMajor", "Double"),
    "semi_minor_m": ("scenec:georeference:semiMinor", "Double"),
    "latitude_deg": ("scenec:georeference:latitude", "Double"),
    "longitude_deg": ("scenec:georeference:longitude", "Double"),
    "body": ("scenec:georeference:body", "String"),
    "east_north": ("scenec:georeference:eastNorth", "DoubleArray"),
    "to_crs": ("scenec:georeference:toCrs", "DoubleArray"),
    "error_m": ("scenec:georeference:error", "Double"),
}

#: On a DistantLight that was computed for a place and a time: fields of
#: ``schemas.records.SolarTime``: the attribute, and its type. None is left out.
SOLAR_TIME = {
    "body": ("scenec:solarTime:body", "Token"),
    "time_utc": ("scenec:solarTime:utc", "String"),
    "solar_time_h": ("scenec:solarTime:true", "Double"),
    "mean_solar_time_h": ("scenec:solarTime:mean", "Double"),
    "ls_deg": ("scenec:solarTime:ls", "Double"),
}

#: On TERRAIN, where its relief has craters: fields of ``schemas.craters.CraterTable``, [n] each, in
#: the world's meters: the attribute, and its type.
CRATERS = {
    "x_m": ("scenec:craters:x", "DoubleArray"),
    "y_m": ("scenec:craters:y", "DoubleArray"),
    "diameter_m": ("scenec:craters:diameter", "FloatArray"),
    "depth_m": ("scenec:craters:depth", "FloatArray"),
    "age": ("scenec:craters:age", "FloatArray"),
    "wear": ("scenec:craters:wear", "FloatArray"),
}

#: Relationship of a mesh to its ordered ground materials; layer 0 is the base.
REL_LAYERS = "scenec:layers"
#: Vertex primvar: weight of merge i (layer i over all before it), i from 1.
PRIMVAR_WEIGHT = "scenec_weight_{merge}"
#: Vertex primvar in [-1, 1]: albedo of every material is base * (1 + variation * this).
#: On a PointInstancer the same name is one value an instance.
PRIMVAR_VARIATION = "scenec_variation"
#: color3f primvar, linear: multiplies the base color; of vertices, or of faces' corners.
PRIMVAR_COLOR = "scenec_color"
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
#: float, 0 where not authored: share of the dull part's light that leaves a sheet on its far side.
ATTR_DIFFUSE_TRANSMISSION = "scenec:surface:diffuseTransmission"
#: asset: pictures that vary a surface; base color multiplies, the others take the place of the
#: number. Keys as in ``schemas.maps.MAP_CHANNELS``.
ATTR_MAPS = {
    "base_color": "scenec:surface:maps:baseColor",
    "roughness": "scenec:surface:maps:roughness",
    "metallic": "scenec:surface:maps:metallic",
    "normal": "scenec:surface:maps:normal",
    "emission": "scenec:surface:maps:emission",
    "height": "scenec:surface:maps:height",
    "opacity": "scenec:surface:maps:opacity",
}
#: float, 0 where not authored: faces are cut out where the map of opacity, which lies by ``st``, is
#: below this. token[2], "repeat" where not authored: how that map goes on along u and along v.
ATTR_OPACITY_THRESHOLD = "scenec:surface:maps:opacityThreshold"
ATTR_OPACITY_WRAP = "scenec:surface:maps:opacityWrap"
WRAPS = ("repeat", "clamp", "mirror")
#: Of opacity that a file means to be blended.
OPACITY_THRESHOLD = 0.5
#: Of a translated material's custom data: lines of what of it is not read.
LOSSES = "scenec_losses"
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
#: float, 0 where not authored: mean sine of the angles by which the map's normals lean; above 0 its
#: facets hide and shade each other (docs/stage.md).
ATTR_MAP_LEAN = "scenec:surface:maps:lean"

#: double (stage units) and uint (0 where not authored): pictures from above lie in cells of
#: a triangular lattice of this side, each turned and shifted by a table that the seed gives
#: (docs/stage.md).
ATTR_MAP_CELL_SIZE = "scenec:surface:maps:cellSize"
ATTR_MAP_CELL_SEED = "scenec:surface:maps:cellSeed"
#: float2, (factor, share): colors c become c * (1 + share * (c_far / mean - 1)), c_far the same
#: picture factor times as large.
ATTR_MAP_FAR = "scenec:surface:maps:far"
#: token, "lambert" where not authored: how the dull part scatters; and the numbers of the others.
ATTR_REFLECTANCE = "scenec:surface:reflectance"
REFLECTANCES = ("lambert", "lommel_seeliger", "hapke")
#: float: b and c of the double Henyey-Greenstein phase function; B0 and h of the opposition surge;
#: mean slope in degrees (hapke).
ATTR_PHASE_B = "scenec:surface:phase:b"
ATTR_PHASE_C = "scenec:surface:phase:c"
ATTR_OPPOSITION = "scenec:surface:opposition"
ATTR_OPPOSITION_WIDTH = "scenec:surface:oppositionWidth"
ATTR_MEAN_SLOPE = "scenec:surface:meanSlope"
#: color3f, 0 where not authored: radiance given off, W/(m^2 sr); its map multiplies.
ATTR_EMISSION = "scenec:surface:emission"
#: float[] on a mesh with layers, one a merge: depth over which height maps decide which of two
#: layers is seen, as a share of the maps' range; 0 where not authored.
ATTR_HEIGHT_BLENDS = "scenec:layers:heightBlends"

#: On the Sky prim. color3f, double, color3f, time-sampled: extinction per stage unit at z = 0, the
#: height over which it falls to 1/e, stage units, and what endless haze shows (not authored: what
#: it scatters of suns and sky).
ATTR_HAZE_EXTINCTION = "scenec:haze:extinction"
ATTR_HAZE_SCALE_HEIGHT = "scenec:haze:scaleHeight"
ATTR_HAZE_AIRLIGHT = "scenec:haze:airlight"
#: double, color3f, time-sampled: g of the phase function (Henyey and Greenstein 1941), and the part
#: of the light it meets that haze scatters; 1 where not authored.
ATTR_HAZE_ASYMMETRY = "scenec:haze:asymmetry"
ATTR_HAZE_ALBEDO = "scenec:haze:albedo"
#: What they are where not authored, and their widest.
HAZE_SCALE_HEIGHT_M = 1000.0
HAZE_ASYMMETRY = 0.7
HAZE_MOST_ASYMMETRY = 0.9
#: double, stage units: height of the ground that endless haze below the horizon lies over; not
#: authored: the lowest place of what is in the stage.
ATTR_HAZE_FLOOR = "scenec:haze:floor"
#: On the Sky prim. asset, time-sampled: lat-long picture of label ids, one 8- or 16-bit channel,
#: raw; and double: its turn about the vertical, degrees, clockwise from above, as of the dome.
ATTR_SKY_LABEL_MAP = "scenec:sky:labelMap:{level}"
ATTR_SKY_ROTATION = "scenec:sky:rotation"
#: On the Sky prim. int: label id of directions below the horizontal plane that meet nothing.
ATTR_SKY_LABEL_BELOW = "scenec:sky:labelBelow:{level}"

#: On the LightFilter in the ``light:filters`` of a DistantLight. asset, time-sampled: picture of
#: the share of the light that comes through, one 8- or 16-bit channel, raw; empty: all of it.
#: double2, time-sampled: its width and height, stage units. It lies in the filter's plane z = 0,
#: its middle at the origin, its top row toward +Y, and holds for all that lies along Z from there;
#: bilinear between texel centers, mirrored beyond its borders.
ATTR_GOBO_FILE = "scenec:gobo:file"
ATTR_GOBO_SIZE = "scenec:gobo:size"

#: On a camera or a lidar. int2, (1, 0) where not authored: of the samples it is triggered at, how
#: many come from one to the next, and the first.
ATTR_TRIGGER = "scenec:trigger"

#: A lidar is an Xform with these: x ahead, y left, z up. double[]: elevation of each beam, degrees;
#: double2: first azimuth and where the next scan begins, degrees, counterclockwise from above;
#: int: azimuths in a scan; double2, stage units: nearest and farthest range that is answered.
ATTR_LIDAR_ELEVATIONS = "scenec:lidar:elevations"
ATTR_LIDAR_AZIMUTH = "scenec:lidar:azimuth"
ATTR_LIDAR_AZIMUTHS = "scenec:lidar:azimuths"
ATTR_LIDAR_RANGE = "scenec:lidar:range"
#: In place of elevations and azimuth. double2[], beam by beam, so many each as azimuths says:
#: elevation and azimuth of each ray, degrees.
ATTR_LIDAR_RAYS = "scenec:lidar:rays"
#: double, 0 where not authored: standard deviation of ranges in stage units, of ranges as a share
#: of the range, of both angles in degrees; share of answers lost; uint64: key of the numbers drawn.
ATTR_LIDAR_RANGE_NOISE = "scenec:lidar:noise:range"
ATTR_LIDAR_RATIO_NOISE = "scenec:lidar:noise:rangeRatio"
ATTR_LIDAR_ANGLE_NOISE = "scenec:lidar:noise:angle"
ATTR_LIDAR_DROPOUT = "scenec:lidar:noise:dropout"
ATTR_LIDAR_KEY = "scenec:lidar:noise:key"
#: double4 each, meters and degrees, not authored where there is no such thing: the fields of
#: ``schemas.lidar``'s models in their order (how intensities are told, how wide beams are, which
#: returns are detected).
ATTR_LIDAR_INTENSITY = "scenec:lidar:intensity"
ATTR_LIDAR_FOOTPRINT = "scenec:lidar:footprint"
ATTR_LIDAR_DETECTION = "scenec:lidar:detection"

#: An IMU is an Xform with these: x ahead, y left, z up; all in meters, seconds, radians and the
#: stage's world, whose z is up, whatever the units of the stage. double: readings a second; double:
#: gravity along -z; double[6]: ``schemas.imu.ImuNoise``'s fields in their order, 0 where absent.
ATTR_IMU_RATE = "scenec:imu:rate"
ATTR_IMU_GRAVITY = "scenec:imu:gravity"
ATTR_IMU_NOISE = "scenec:imu:noise"
#: One value a reading. double[]: by the clock of scenec:time; double3[]: what the gyroscope and the
#: accelerometer read, in its axes.
ATTR_IMU_TIMES = "scenec:imu:times"
ATTR_IMU_GYROSCOPE = "scenec:imu:gyroscope"
ATTR_IMU_ACCELEROMETER = "scenec:imu:accelerometer"
#: The truth at each reading. double3[] in the world, double4[]: a quaternion w, x, y, z, double3[].
ATTR_IMU_POSITIONS = "scenec:imu:truth:positions"
ATTR_IMU_ORIENTATIONS = "scenec:imu:truth:orientations"
ATTR_IMU_VELOCITIES = "scenec:imu:truth:velocities"
#: double3[], where there is noise: what would be read without it, and the slow part of it.
ATTR_IMU_ANGULAR_VELOCITY = "scenec:imu:truth:angularVelocity"
ATTR_IMU_SPECIFIC_FORCE = "scenec:imu:truth:specificForce"
ATTR_IMU_GYROSCOPE_BIAS = "scenec:imu:truth:gyroscopeBias"
ATTR_IMU_ACCELEROMETER_BIAS = "scenec:imu:truth:accelerometerBias"

#: On a camera that measures depth. token: "stereo" or "time_of_flight"; double[]: its numbers in
#: the order of ``schemas.depth_camera``'s fields, lengths in meters; uint64: the key of its noise.
ATTR_DEPTH_MODEL = "scenec:depthCamera:model"
ATTR_DEPTH_NUMBERS = "scenec:depthCamera:numbers"
ATTR_DEPTH_KEY = "scenec:depthCamera:noise:key"

#: On a camera with the pass ``traversable``. double[]: its vehicle, in the order of
#: ``schemas.vehicle.Vehicle``'s fields; not authored: that one's defaults.
ATTR_VEHICLE = "scenec:vehicle"

#: On a camera. token: renderers find its exposure, one for the "batch" or each "sample", and what
#: UsdGeomCamera's attributes of exposure say is for viewers; not authored: they are followed, and
#: where none of them is authored either it is "batch".
ATTR_EFFECTS = "scenec:effects"
ATTR_EXPOSURE_PER = "scenec:exposure:per"
EXPOSURES_PER = ("batch", "sample")

#: On a camera whose picture is not of one instant. double, time-sampled: how long each row is
#: exposed, seconds; double, 0 where not authored: how much later the last row's border is exposed
#: than the first row's; token, "down" where not authored, or "up": where the first row is. Time
#: counts from the sample's (``scenec:time``), at which the middle of the picture is in the middle
#: of its exposure.
ATTR_SHUTTER_EXPOSURE = "scenec:shutter:exposure"
ATTR_SHUTTER_READOUT = "scenec:shutter:readout"
ATTR_SHUTTER_DIRECTION = "scenec:shutter:direction"
#: double[], seconds, rising, 0 among them; matrix4d[], time-sampled: where the camera is then, from
#: its own frame at the sample (the identity at 0); between them as ``schemas.shutter.between``.
#: They enclose all exposures. Not authored: it stands still. For viewers, UsdGeomCamera's
#: shutter:open and shutter:close, and fractional time codes of the rig, say the same.
ATTR_SHUTTER_TIMES = "scenec:shutter:times"
ATTR_SHUTTER_POSES = "scenec:shutter:poses"

#: On a camera. rel: the camera whose picture disparity goes to, a rectified pair.
REL_PARTNER = "scenec:stereo:partner"

#: A UsdGeomCamera looks down -z with y up, the contract's camera (OpenCV) down +z with y down: they
#: differ by a half turn about x, which gives the columns of a rotation these signs.
HALF_TURN = (1.0, -1.0, -1.0)

ROOT = "/World"
#: Mesh of the land beyond the terrain's border.
TERRAIN = f"{ROOT}/Terrain"
HORIZON = f"{TERRAIN}/horizon"
SKY_PRIM = "/World/Sky"
RENDER_SCOPE = "/Render"


def label_primvar(level: str) -> str:
    """Name (without ``primvars:``) of the label primvar of one level."""
    return PRIMVAR_LABEL.format(level=level)


def weight_primvar(merge: int) -> str:
    """Name (without ``primvars:``) of the weight primvar of merge ``merge`` (from 1)."""
    return PRIMVAR_WEIGHT.format(merge=merge)
