"""Declares keys of cameras."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, Literal

from scenec.compiler.distributions.numbers import Number
from scenec.compiler.kinds.declare import bounded, key
from scenec.compiler.kinds.forms import (
    ANGLE_PER_BATCH,
    CHOICE,
    CONSTANT,
    COUNT,
    FRACTION_PER_BATCH,
    ISO_RANGE,
    LENGTH_PER_BATCH,
    LENGTH_PER_SAMPLE,
    MOUNT_POSITION_M,
    MOUNT_ROTATION_DEG,
    OUTPUT,
    PER_BATCH,
    PER_SAMPLE,
    TEXT,
    TIME_RANGE_S,
    TRUTH,
    an,
    list_of,
    named,
)


@dataclass(frozen=True, kw_only=True)
class DepthCameraStereo:
    """Depth from a pair: the sensor's camera and another one to the right.

    No answer where the other one does not see the point.
    """

    EXAMPLE: ClassVar = {
        "type": "stereo",
        "baseline_m": 0.055,
        "noise_px": 0.1,
        "step_px": 0.125,
        "range_m": [0.4, 10],
    }

    TITLE: ClassVar = "Stereo depth"
    baseline_m: float = key(LENGTH_PER_BATCH, above=0, at_most=1000000.0)
    """Distance of the two cameras."""
    noise_px: float = key(PER_BATCH, default=0.2, at_least=0, at_most=1000, unit="px")
    """Standard deviation of disparities."""
    step_px: float = key(PER_BATCH, default=0.0625, at_least=0, at_most=1000, unit="px")
    """Disparities are multiples of it; 0: any number."""
    range_m: Any = key(
        list_of(
            bounded(CONSTANT, at_least=0, at_most=1000000000.0, unit="m"),
            "A bound.",
            least=2,
            most=2,
        ),
        default=[0.3, 50],
    )
    """Nearest and farthest depth that is answered."""


@dataclass(frozen=True, kw_only=True)
class DepthCameraTimeOfFlight:
    """Depth from the phase of modulated light, in sunlight: noise grows with the square of the
    range and with slant.
    """

    EXAMPLE: ClassVar = {
        "type": "time_of_flight",
        "noise_m": 0.005,
        "ambiguity_m": 7.5,
        "range_m": [0.3, 6],
    }

    TITLE: ClassVar = "Time-of-flight depth"
    noise_m: float = key(LENGTH_PER_BATCH, default=0.01, at_least=0, at_most=1000)
    """Standard deviation of ranges at at_m, of a surface that faces the camera."""
    at_m: float = key(LENGTH_PER_BATCH, default=2, above=0, at_most=1000000.0)
    """Range of that."""
    ambiguity_m: float = key(LENGTH_PER_BATCH, default=15, above=0, at_most=1000000000.0)
    """Ranges are told modulo this, c / (2 f): 15 m at 10 MHz."""
    blur_px: float = key(PER_BATCH, default=0.4, at_least=0, at_most=16, unit="px")
    """Standard deviation of the spot that a pixel gathers light from; at outlines ranges mix."""
    range_m: Any = key(
        list_of(
            bounded(CONSTANT, at_least=0, at_most=1000000000.0, unit="m"),
            "A bound.",
            least=2,
            most=2,
        ),
        default=[0.1, 15],
    )
    """Nearest and farthest range that is answered."""


@dataclass(frozen=True, kw_only=True)
class ExposureAuto:
    """As a camera's own meter finds it, from what the camera sees: the mean luminance of surfaces
    is shown as 0.18, unless the brightest hundredth of them would then be shown above 1. Where more
    than a twentieth of all that is seen, sky included, would be shown above 1, as against the
    light, it is half of those stops less, three at most; the sun's disc never counts. The same in
    all backends, whichever frames are rendered; each frame's sidecar states it.
    """

    EXAMPLE: ClassVar = {"type": "auto", "per": "sample"}

    per: Literal["batch", "sample"] = key(CHOICE, default="batch")
    """What has one exposure: the batch, so that a sequence does not flicker (a dark sample among
    bright ones stays dark), or each sample."""


@dataclass(frozen=True, kw_only=True)
class ExposureFixed:
    """The same for all light."""

    EXAMPLE: ClassVar = {"type": "fixed", "ev": -8}

    ev: Number = key(PER_SAMPLE, at_least=-64, at_most=64, unit="EV")
    """Radiance times 2^ev is shown."""


@dataclass(frozen=True, kw_only=True)
class ExposureIncident:
    """Follows the light that falls on the scene, as an incident light meter does: that of suns and
    sky on level ground, and that of lamps on a surface that faces them where the middle of the
    picture meets the ground, or the first lit place below that. Where no light arrives, radiance is
    shown as it is (EV 0 and the offset).
    """

    EXAMPLE: ClassVar = {"type": "incident", "ev_offset": 0.5}

    ev_offset: Number = key(PER_SAMPLE, default=0, at_least=-64, at_most=64, unit="EV")
    """Correction; +1 is twice as bright."""


@dataclass(frozen=True, kw_only=True)
class Focus:
    """A lens of finite aperture: rgb is sharp at one distance and blurred before and behind it.

    Field of view and annotation stay those of the pinhole in the aperture's middle. Not with
    lens.
    """

    EXAMPLE: ClassVar = {"distance_m": 4, "f_number": 2.8, "focal_length_mm": 35}

    distance_m: Number = key(LENGTH_PER_SAMPLE, above=0, at_most=1_000_000_000)
    """Distance along the optical axis of the plane that is sharp; beyond the focal length."""
    f_number: Number | None = key(PER_SAMPLE, optional=True, at_least=0.5, at_most=1000)
    """Focal length over diameter of the aperture. With imaging its f_number stands for it; without,
    it must be given."""
    focal_length_mm: float | None = key(
        PER_BATCH, optional=True, above=0, at_most=1_000_000, unit="mm"
    )
    """Focal length. With imaging it follows from pixel_um and the field of view; without, it must
    be given."""


@dataclass(frozen=True, kw_only=True)
class Imaging:
    """What the sensor makes of the light: its picture is then 000000.png, with a real camera's
    optics, noise and processing; rgb stays clean linear radiance. The defaults are typical of an
    industrial camera with pixels of 3.45 µm. A stage is left out by 0 or null.
    """

    EXAMPLE: ClassVar = {
        "clean": True,
        "read_noise_e": 4,
        "vignetting": {},
        "bloom": {},
        "jpeg": {"quality": 90},
    }

    exposure: Mapping[str, Any] = key(an("imaging_exposure"), default={"type": "metered"})
    """Exposure time and speed."""
    f_number: Number = key(PER_SAMPLE, default=4, at_least=0.5, at_most=1000)
    """Focal length over aperture."""
    headroom_stops: float = key(PER_BATCH, default=1, at_least=-8, at_most=16, unit="EV")
    """Stops between a value of 1 (what sensor.exposure shows as 1) and the brightest that is told
    apart; more keeps highlights, and shows more noise."""
    pixel_um: float = key(PER_BATCH, default=3.45, at_least=0.1, at_most=1000, unit="µm")
    """Side of a pixel."""
    quantum_efficiency: Any = key(
        list_of(bounded(PER_BATCH, above=0, at_most=1), "One color.", least=3, most=3),
        default=[0.5, 0.6, 0.5],
    )
    """Electrons a photon in 600-700, 500-600 and 400-500 nm: red, green, blue."""
    full_well_e: float = key(
        PER_BATCH, default=10_500, at_least=1, at_most=1_000_000_000, unit="e-"
    )
    """Electrons that a pixel holds."""
    bits: int = key(COUNT, default=12, at_least=8, at_most=16)
    """Of the converter."""
    black_level: int = key(COUNT, default=64, at_least=0, at_most=65_534, unit="DN")
    """Number that the converter gives for no electrons."""
    shot_noise: bool = key(TRUTH, default=True)
    """Whether electrons come one by one (Poisson)."""
    read_noise_e: float = key(PER_BATCH, default=2.3, at_least=0, at_most=1_000_000, unit="e-")
    """Standard deviation of what reading adds."""
    dark_current: Mapping[str, Any] = key(an("imaging_dark_current"), default={})
    """Electrons without light."""
    prnu: float = key(FRACTION_PER_BATCH, default=0.006)
    """Standard deviation of the pixels' sensitivity (photo response non-uniformity), relative."""
    dsnu_e: float = key(PER_BATCH, default=0.6, at_least=0, at_most=1_000_000, unit="e-")
    """Standard deviation of the pixels' offset (dark signal non-uniformity)."""
    defects: Mapping[str, Any] = key(an("imaging_defects"), default={})
    """Hot and dead pixels."""
    mosaic: Literal["rggb", "bggr", "grbg", "gbrg", "none"] = key(CHOICE, default="rggb")
    """Colors of the first two rows of pixels; none: each pixel sees all three. Pictures of one row
    or column have none."""
    demosaic: Literal["malvar", "bilinear"] = key(CHOICE, default="malvar")
    """How missing colors are guessed: Malvar, He and Cutler 2004, or the mean of the nearest."""
    color_matrix: Any | None = key(
        list_of(
            list_of(
                bounded(PER_BATCH, at_least=-10, at_most=10),
                "Of red, green or blue light.",
                least=3,
                most=3,
            ),
            "One color of pixels.",
            least=3,
            most=3,
        ),
        optional=True,
    )
    """What red, green and blue pixels see of linear Rec.709, a row each; the picture undoes it,
    which makes noise larger. Left out, they see Rec.709."""
    white_balance: Any = key(
        list_of(bounded(PER_BATCH, above=0, at_most=100), "Red, green or blue.", least=3, most=3),
        default=[1, 1, 1],
    )
    """Factors on top of those that show white light as white."""
    vignetting: Mapping[str, Any] | None = key(an("imaging_vignetting"), optional=True)
    """How the picture darkens towards its corners; left out, it does not."""
    bloom: Mapping[str, Any] | None = key(an("imaging_bloom"), optional=True)
    """Light that lens and glass scatter; left out, none."""
    jpeg: Mapping[str, Any] | None = key(an("imaging_jpeg"), optional=True)
    """Compression that the picture has gone through; left out, none."""
    clean: bool = key(TRUTH, default=False)
    """Also write 000000.clean.png: same light, optics and exposure, without noise, fixed pattern,
    defects, mosaic, rounding and JPEG."""
    raw: bool = key(TRUTH, default=False)
    """Also write 000000.raw.png: the converter's numbers behind the mosaic, 16 bits."""


@dataclass(frozen=True, kw_only=True)
class ImagingBloom:
    """A share of the light is spread by three Gaussians (60, 30 and 10 % by radius_px, 3 and 9
    times that); its sum stays.
    """

    EXAMPLE: ClassVar = {"share": 0.02, "radius_px": 6}

    share: float = key(FRACTION_PER_BATCH, default=0.02)
    """Share of the light."""
    radius_px: float = key(PER_BATCH, default=8, at_least=0.5, at_most=10_000, unit="px")
    """Standard deviation of the narrowest."""


@dataclass(frozen=True, kw_only=True)
class ImagingDarkCurrent:
    """Electrons that heat sets free."""

    EXAMPLE: ClassVar = {"rate_e_s": 2, "temperature_c": 35}

    rate_e_s: float = key(PER_BATCH, default=2, at_least=0, at_most=1_000_000_000, unit="e-/s")
    """At the reference temperature, a second."""
    reference_c: float = key(PER_BATCH, default=25, at_least=-273, at_most=1000, unit="°C")
    """Reference temperature."""
    doubling_c: float = key(PER_BATCH, default=7, at_least=0.1, at_most=1000, unit="K")
    """It doubles every so many degrees."""
    temperature_c: Number = key(PER_SAMPLE, default=25, at_least=-273, at_most=1000, unit="°C")
    """Of the sensor; hot pixels follow it, too."""


@dataclass(frozen=True, kw_only=True)
class ImagingDefects:
    """Pixels that are the same in all pictures of the sensor."""

    EXAMPLE: ClassVar = {"hot": 0.0001, "dead": 5e-05}

    hot: float = key(PER_BATCH, default=0.0001, at_least=0, at_most=0.5)
    """Share of pixels with more dark current."""
    hot_rate_e_s: float = key(
        PER_BATCH, default=500, at_least=0, at_most=1_000_000_000, unit="e-/s"
    )
    """What it is more on average (exponentially distributed), at the reference temperature."""
    dead: float = key(PER_BATCH, default=1e-05, at_least=0, at_most=0.5)
    """Share of pixels that see nothing."""


@dataclass(frozen=True, kw_only=True)
class ImagingExposureAuto:
    """From each picture alone, whatever is rendered before it: the logarithmic mean of the
    luminance of what is lit, or a percentile of all, is shown as target (in steps of 1/64 EV). Time
    first, then speed; without light the longest. sensor.exposure has no say.
    """

    EXAMPLE: ClassVar = {"type": "auto", "target": 0.18}

    target: float = key(PER_BATCH, default=0.18, above=0, at_most=1000)
    """What it is shown as; white is 1."""
    percentile: float | None = key(PER_BATCH, optional=True, at_least=0, at_most=100, unit="%")
    """Percentile of luminance that is metered; left out, the logarithmic mean."""
    time_range_s: Any = key(TIME_RANGE_S)
    iso_range: Any = key(ISO_RANGE)


@dataclass(frozen=True, kw_only=True)
class ImagingExposureManual:
    """As given; sensor.exposure has no say."""

    EXAMPLE: ClassVar = {"type": "manual", "time_s": 0.002, "iso": 100}

    time_s: Number = key(PER_SAMPLE, above=0, at_most=1_000_000, unit="s")
    """Exposure time."""
    iso: Number | None = key(PER_SAMPLE, optional=True, above=0, at_most=1_000_000_000)
    """ISO speed (ISO 12232, saturation-based): 78 / iso lux seconds make the largest number. Below
    the base speed (in sidecars), where pixels are full before, highlights clip sooner. Either this
    or gain_e."""
    gain_e: Number | None = key(
        PER_SAMPLE, optional=True, above=0, at_most=1_000_000_000, unit="e-/DN"
    )
    """Electrons that make one step of the converter, in place of iso."""


@dataclass(frozen=True, kw_only=True)
class ImagingExposureMetered:
    """Shows what sensor.exposure says, by time and speed: the lowest speed while the time is long
    enough, then more speed. Where the limits bind, the picture is darker or brighter.
    """

    EXAMPLE: ClassVar = {"type": "metered"}

    time_range_s: Any = key(TIME_RANGE_S)
    iso_range: Any = key(ISO_RANGE)


@dataclass(frozen=True, kw_only=True)
class ImagingJpeg:
    """The picture is compressed and decoded; it is stored without further loss."""

    EXAMPLE: ClassVar = {"quality": 90}

    TITLE: ClassVar = "Imaging: JPEG"
    quality: int = key(COUNT, default=90, at_least=1, at_most=100)
    """As libjpeg has it."""
    subsampling: Literal["4:4:4", "4:2:2", "4:2:0"] = key(CHOICE, default="4:2:0")
    """Of colors."""


@dataclass(frozen=True, kw_only=True)
class ImagingVignetting:
    """cos(t)^power · (1 + a r² + b r⁴ + c r⁶), t the angle to the axis, r = 1 in the corner
    farthest from the principal point.
    """

    EXAMPLE: ClassVar = {"power": 4}

    power: int = key(COUNT, default=4, at_least=0, at_most=8)
    """4 is a thin lens's; wide lenses are made to have less."""
    polynomial: Any = key(
        list_of(bounded(PER_BATCH, at_least=-10, at_most=10), "A coefficient.", least=3, most=3),
        default=[0, 0, 0],
    )
    """a, b, c."""


@dataclass(frozen=True, kw_only=True)
class Intrinsics:
    """u = fx X/Z + skew Y/Z + cx, v = fy Y/Z + cy; the center of the top left pixel is
    (0.5, 0.5).
    """

    EXAMPLE: ClassVar = {"fx": 520, "fy": 520, "cx": 320, "cy": 240}

    KEYWORDS: ClassVar = {"x-whole": True}

    fx: float = key(PER_BATCH, at_least=0.001, at_most=1_000_000_000, unit="px")
    """Focal length in x."""
    fy: float = key(PER_BATCH, at_least=0.001, at_most=1_000_000_000, unit="px")
    """Focal length in y."""
    cx: float = key(PER_BATCH, at_least=-10_000_000, at_most=10_000_000, unit="px")
    """Principal point in x."""
    cy: float = key(PER_BATCH, at_least=-10_000_000, at_most=10_000_000, unit="px")
    """Principal point in y."""
    skew: float = key(PER_BATCH, default=0, at_least=-10_000_000, at_most=10_000_000, unit="px")
    """Skew."""


@dataclass(frozen=True, kw_only=True)
class LensBrownConrady:
    """Radial and tangential distortion of a pinhole's picture (Brown 1966; OpenCV's rational
    model): radii are multiplied by (1 + k1 r^2 + k2 r^4 + k3 r^6) / (1 + k4 r^2 + k5 r^4 + k6 r^6).
    It must be one-to-one over the whole picture. The sensor's fov_deg counts radial distortion in,
    tangential not.
    """

    EXAMPLE: ClassVar = {"type": "brown_conrady", "k1": -0.28, "k2": 0.07, "p1": 0.0002}

    TITLE: ClassVar = "Lens: brown_conrady"
    k1: float = key(PER_BATCH, default=0, at_least=-10_000, at_most=10_000)
    """Coefficient of r^2 above the fraction line."""
    k2: float = key(PER_BATCH, default=0, at_least=-10_000, at_most=10_000)
    """Coefficient of r^4 above the fraction line."""
    p1: float = key(PER_BATCH, default=0, at_least=-10, at_most=10)
    """Tangential: y gets p1 (r^2 + 2 y^2), x 2 p1 x y."""
    p2: float = key(PER_BATCH, default=0, at_least=-10, at_most=10)
    """Tangential: x gets p2 (r^2 + 2 x^2), y 2 p2 x y."""
    k3: float = key(PER_BATCH, default=0, at_least=-10_000, at_most=10_000)
    """Coefficient of r^6 above the fraction line."""
    k4: float = key(PER_BATCH, default=0, at_least=-10_000, at_most=10_000)
    """Coefficient of r^2 below the fraction line."""
    k5: float = key(PER_BATCH, default=0, at_least=-10_000, at_most=10_000)
    """Coefficient of r^4 below the fraction line."""
    k6: float = key(PER_BATCH, default=0, at_least=-10_000, at_most=10_000)
    """Coefficient of r^6 below the fraction line."""


@dataclass(frozen=True, kw_only=True)
class LensEquirectangular:
    """A panorama: columns are longitudes around the camera's y axis, rows latitudes.

    Without fov_deg and intrinsics it is the whole sphere; with fov_deg it has square pixels,
    with intrinsics fx and fy pixels per radian. What lies beyond the poles, or beyond 180° to
    the left and right, shows nothing.
    """

    EXAMPLE: ClassVar = {"type": "equirectangular"}


@dataclass(frozen=True, kw_only=True)
class LensKannalaBrandt:
    """A fisheye: a ray at the angle t to the axis lies t (1 + k1 t^2 + k2 t^4 + k3 t^6 + k4 t^8)
    focal lengths from the principal point (Kannala and Brandt 2006; OpenCV's fisheye). Without
    coefficients it is equidistant. Here fx and fy are pixels per radian, and fov_deg may be up to
    360.
    """

    EXAMPLE: ClassVar = {"type": "kannala_brandt", "k1": -0.01, "max_angle_deg": 95}

    TITLE: ClassVar = "Lens: kannala_brandt"
    k1: float = key(PER_BATCH, default=0, at_least=-1000, at_most=1000)
    """Coefficient of t^3."""
    k2: float = key(PER_BATCH, default=0, at_least=-1000, at_most=1000)
    """Coefficient of t^5."""
    k3: float = key(PER_BATCH, default=0, at_least=-1000, at_most=1000)
    """Coefficient of t^7."""
    k4: float = key(PER_BATCH, default=0, at_least=-1000, at_most=1000)
    """Coefficient of t^9."""
    max_angle_deg: float = key(ANGLE_PER_BATCH, default=180, above=0, at_most=180)
    """Largest angle of a ray to the axis, the border of the image circle: what the picture has
    beyond it shows nothing."""


@dataclass(frozen=True, kw_only=True)
class Lidar:
    """A scanner of beams at fixed elevations that turns about its upward axis.

    A scan is taken at one instant. It has either beams or elevations_deg.
    """

    EXAMPLE: ClassVar = {
        "beams": 32,
        "elevation_deg": [10, -30],
        "azimuths": 900,
        "range_m": [0.5, 100],
    }

    mount: Mapping[str, Any] = key(an("mount"), default={})
    """Where the lidar sits on the rig; unturned it looks ahead, as a camera does."""
    beams: int | None = key(COUNT, optional=True, at_least=1, at_most=65_536)
    """Number of beams, evenly spaced over elevation_deg."""
    elevation_deg: Any = key(
        list_of(bounded(CONSTANT, at_least=-90, at_most=90, unit="°"), "Upward.", least=2, most=2),
        default=[15, -15],
    )
    """Elevations of the first and the last beam."""
    elevations_deg: Any | None = key(
        list_of(
            bounded(CONSTANT, at_least=-90, at_most=90, unit="°"), "Upward.", least=1, most=65536
        ),
        optional=True,
    )
    """Elevation of each beam."""
    azimuths: int = key(COUNT, at_least=1, at_most=1_048_576)
    """Directions of each beam in a scan, evenly spaced over azimuth_deg."""
    azimuth_deg: Any = key(
        list_of(
            bounded(CONSTANT, at_least=-720, at_most=720, unit="°"),
            "Counterclockwise from above.",
            least=2,
            most=2,
        ),
        default=[180, -180],
    )
    """First azimuth, and where the next scan would begin; 0 is ahead, 90 left."""
    range_m: Any = key(
        list_of(
            bounded(CONSTANT, at_least=0, at_most=1_000_000_000, unit="m"),
            "Along the beam.",
            least=2,
            most=2,
        ),
        default=[0.5, 120],
    )
    """Nearest and farthest range that is answered."""
    noise: Mapping[str, Any] = key(an("lidar_noise"), default={})
    """What is wrong with its answers."""
    trigger: Mapping[str, Any] = key(an("trigger"), default={})
    """At which samples it scans."""


@dataclass(frozen=True, kw_only=True)
class LidarNoise:
    """What is wrong with a lidar's answers.

    Its numbers depend on seed, batch, sample and the lidar's name alone.
    """

    EXAMPLE: ClassVar = {"range_m": 0.02, "dropout": 0.01}

    TITLE: ClassVar = "Lidar's noise"
    range_m: float = key(LENGTH_PER_BATCH, default=0.02, at_least=0, at_most=1000)
    """Standard deviation of ranges, whatever the range."""
    range_ratio: float = key(FRACTION_PER_BATCH, default=0)
    """Standard deviation of ranges as a share of the range, added in square to range_m."""
    angle_deg: float = key(ANGLE_PER_BATCH, default=0, at_least=0, at_most=10)
    """Standard deviation of azimuth and of elevation: a beam meets what lies that far beside the
    direction that is told."""
    dropout: float = key(FRACTION_PER_BATCH, default=0)
    """Share of answers that are lost."""


@dataclass(frozen=True, kw_only=True)
class Mount:
    """Pose of a sensor in its rig's frame (x right, y down, z forward)."""

    EXAMPLE: ClassVar = {"position_m": [0.12, 0, 0], "rotation_deg": [0, 5, 0]}

    position_m: Any = key(MOUNT_POSITION_M)
    rotation_deg: Any = key(MOUNT_ROTATION_DEG)


@dataclass(frozen=True, kw_only=True)
class Rig:
    """A body that moves through the scene with sensors mounted on it.

    Its frame is that of a camera that looks ahead: x right, y down, z forward.
    """

    EXAMPLE: ClassVar = {
        "pose": {"type": "orbit", "radius_m": 8, "height_m": 2},
        "sensors": {"front": {"resolution": [640, 480], "fov_deg": 65}},
    }

    pose: Mapping[str, Any] = key(an("pose"))
    """Where the rig is in each sample."""
    sensors: Mapping[str, Any] = key(named(an("sensor"), "One sensor.", by="sensor", least=1))
    """Sensors by name."""
    lidars: Mapping[str, Any] = key(
        named(an("lidar"), "One lidar.", by="lidar", least=1), sparse=True
    )
    """Lidars by name."""
    allow_below: bool = key(TRUTH, default=False, sparse=True)
    """Whether its sensors may be below the ground, inside of objects or off the terrain. Otherwise
    a sensor that is there at any sample, or while its shutter is open, is an error of compile."""


@dataclass(frozen=True, kw_only=True)
class Sensor:
    """A camera.

    It has either fov_deg or intrinsics; a panorama of the whole sphere needs neither.
    """

    EXAMPLE: ClassVar = {"resolution": [640, 480], "fov_deg": 65}

    KEYWORDS: ClassVar = {
        "if": {
            "properties": {
                "lens": {
                    "properties": {"type": {"enum": ["kannala_brandt", "equirectangular"]}},
                    "required": ["type"],
                }
            },
            "required": ["lens"],
        },
        "else": {
            "properties": {
                "fov_deg": {
                    **ANGLE_PER_BATCH.keywords,
                    "description": "Horizontal field of view, with square pixels and a centered "
                    "principal point.",
                    "exclusiveMinimum": 0,
                    "exclusiveMaximum": 180,
                }
            }
        },
    }

    resolution: Any = key(
        list_of(
            bounded(COUNT, at_least=1, at_most=65_535), "Pixels along one axis.", least=2, most=2
        ),
        unit="px",
    )
    """Width and height of the picture."""
    fov_deg: Any | None = key(
        ANGLE_PER_BATCH.but(**{"x-usual-minimum": 4}), optional=True, above=0, at_most=360
    )
    """Horizontal field of view, with square pixels and a centered principal point; up to 360 with
    the lenses kannala_brandt and equirectangular."""
    intrinsics: Mapping[str, Any] | None = key(an("intrinsics"), optional=True)
    """Intrinsics."""
    lens: Mapping[str, Any] = key(an("lens"), sparse=True)
    """How the lens bends the picture; left out, it does not: a pinhole."""
    mount: Mapping[str, Any] = key(an("mount"), default={})
    """Where the sensor sits on the rig."""
    exposure: Mapping[str, Any] = key(an("exposure"), default={"type": "auto"})
    """Exposure of the 8-bit picture."""
    imaging: Mapping[str, Any] = key(an("imaging"), sparse=True)
    """Optics, noise and processing of a real camera; left out, the picture shows the radiance as it
    is."""
    effects: Any = key(list_of(an("effect"), least=1), sparse=True)
    """What other packages do to the picture after all else, in order; rgb stays as it is."""
    focus: Mapping[str, Any] = key(an("focus"), sparse=True)
    """What is sharp, and how shallow; left out, everything is sharp."""
    shutter: Mapping[str, Any] = key(an("shutter"), sparse=True)
    """When each row is exposed: motion blur and rolling shutter; left out, the whole picture is of
    one instant."""
    trigger: Mapping[str, Any] = key(an("trigger"), sparse=True)
    """At which samples it takes a frame; left out, at all."""
    depth_camera: Mapping[str, Any] = key(an("depth_camera"), sparse=True)
    """How the sensor measures depth, for the output depth_measured."""
    partner: str = key(TEXT, sparse=True)
    """Another sensor of the rig, to whose picture disparity goes: a rectified pair, alike but for
    its place along the picture's rows and its principal point's column."""
    outputs: Any | None = key(list_of(OUTPUT, least=1, unique=True), optional=True)
    """This sensor's channels; left out, those of the cfg."""


@dataclass(frozen=True, kw_only=True)
class Shutter:
    """When the rows of a picture are exposed, while the rig goes on moving: motion blur, and a
    rolling shutter's slant. A sample's pose and time are those of the middle of the picture in the
    middle of its exposure. Before a motion begins and after it ends the rig stands still. Only on
    rigs that move over time: not beside random poses.
    """

    EXAMPLE: ClassVar = {"exposure_s": 0.01, "readout_s": 0.02, "direction": "down"}

    exposure_s: float | None = key(PER_BATCH, optional=True, at_least=0, at_most=1000, unit="s")
    """How long each row is exposed; 0: an instant. Left out, the time_s of imaging's manual
    exposure."""
    readout_s: float = key(PER_BATCH, default=0, at_least=0, at_most=1000, unit="s")
    """How much later the last row's border is exposed than the first row's; 0: all rows at once (a
    global shutter)."""
    direction: Literal["down", "up"] = key(CHOICE, default="down")
    """Whether the top row is exposed first, or the lowest."""


@dataclass(frozen=True, kw_only=True)
class Trigger:
    """At which samples a sensor is triggered: first, first + every, first + 2 every and so on.

    With samples at 30 Hz, every 3 is 10 Hz.
    """

    EXAMPLE: ClassVar = {"every": 5, "first": 2}

    every: int = key(COUNT, default=1, at_least=1, at_most=1_000_000_000)
    """Samples from one to the next."""
    first: int = key(COUNT, default=0, at_least=0, at_most=1_000_000_000)
    """The first one."""
