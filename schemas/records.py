"""The record of a frame, which its sidecar holds, and its parts; ``schemas.codec`` reads them.

Fields without a default are in every sidecar. Earlier versions lack some of the others: what a
field says by default is then not known.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Annotated, Any

from scenec.schemas.codec import JSON, UNSET, Natural, Unset, is_number, omitted
from scenec.schemas.lidar import LidarDetection, LidarFootprint, LidarIntensity

Row3 = tuple[float, float, float]
Row4 = tuple[float, float, float, float]
Matrix3 = tuple[Row3, Row3, Row3]
Matrix4 = tuple[Row4, Row4, Row4, Row4]


def _above_0(value: Any) -> str | None:
    return None if type(value) is int and 0 < value < 1 << 20 else "a whole number above 0"


def _names_by_id(value: Any) -> str | None:
    fine = isinstance(value, dict) and all(
        key.isascii() and key.isdigit() and len(key) < 20 and isinstance(name, str)
        for key, name in value.items()
    )
    return None if fine else "ids and their names"


def _lens(value: Any) -> str | None:
    # Imported here: with it comes numba, and few sidecars have a lens.
    from scenec.schemas.lens import COEFFICIENTS

    if value is None:
        return None
    if not isinstance(value, dict) or value.get("model") not in list(COEFFICIENTS):
        return f"a lens of model {' or '.join(COEFFICIENTS)}"
    numbers = value.get("coefficients")
    if not isinstance(numbers, list) or len(numbers) != len(COEFFICIENTS[value["model"]]):
        return f"a lens with {len(COEFFICIENTS[value['model']])} coefficients"
    fine = all(is_number(number) for number in [*numbers, value.get("max_angle_deg", 0.0)])
    return None if fine else "a lens whose values are finite numbers"


Above0 = Annotated[int, _above_0]
NamesById = Annotated[Mapping[str, str], _names_by_id]


@dataclass(frozen=True, kw_only=True)
class FileDigest:
    """Tells whether a file is still the one that was written."""

    bytes: Natural | Unset = UNSET
    sha256: str


#: Of a file that is not there yet.
NOT_WRITTEN = FileDigest(bytes=0, sha256="")


@dataclass(frozen=True, kw_only=True)
class LensRecord:
    """A lens: ``schemas.lens`` says what its numbers mean, and makes a ``Lens`` of it."""

    model: str
    coefficients: tuple[float, ...]
    convention: str | Unset = UNSET
    max_angle_deg: float | Unset = UNSET


@dataclass(frozen=True, kw_only=True)
class ShutterRecord:
    """A shutter, and where the camera is while it is open: see its ``convention``."""

    exposure_s: float
    readout_s: float
    direction: str
    first_row: Matrix4
    last_row: Matrix4
    times_s: tuple[float, ...]
    camera_to_world: tuple[Matrix4, ...]
    convention: str | Unset = UNSET


@dataclass(frozen=True, kw_only=True)
class SolarTime:
    """Says what time it is at the place of a sun that was computed.

    Attributes:
        body: On which the place is: "earth", "moon" or "mars".
        time_utc: As ISO 8601 writes it.
        solar_time_h: True solar time, in twenty-fourths of a day: 12 when the sun is due south or
            north.
        mean_solar_time_h: That of a sun that goes evenly: UT of Earth, MTC of Mars (Allison and
            McEwen 2000), the mean elongation of the Moon, plus the eastern longitude.
        ls_deg: Solar longitude, Mars's season; None elsewhere.
    """

    body: str
    time_utc: str
    solar_time_h: float
    mean_solar_time_h: float
    ls_deg: float | None = omitted()


@dataclass(frozen=True, kw_only=True)
class SunRecord:
    """The brightest sun: its direction, and irradiance on a surface facing it, W/m^2."""

    elevation_deg: float
    azimuth_deg: float
    irradiance: Row3
    time: SolarTime | None = omitted()


@dataclass(frozen=True, kw_only=True)
class SunLight:
    """A sun among all light: luminance of its irradiance, W/m^2."""

    prim: str
    irradiance: float
    angle_deg: float
    normalized: bool


@dataclass(frozen=True, kw_only=True)
class LightRecord:
    """Records the light at a sample, by luminance: W/m^2, W/(m^2 sr) and W/sr."""

    suns: tuple[SunLight, ...]
    sky_radiance: float
    lamps_w_sr: tuple[float, ...]


@dataclass(frozen=True, kw_only=True)
class PictureRecord:
    """Records how bright a picture shows surfaces: pixels, and mean luminance, W/(m^2 sr).

    Attributes:
        surfaces: Pixels that show any.
        black, burnt: How many of these are.
        mean_luminance: Of the surfaces.
        light: What there is, where the picture is black or burnt out.
    """

    surfaces: Natural
    black: Natural
    burnt: Natural
    mean_luminance: float
    light: LightRecord | None = omitted()


@dataclass(frozen=True, kw_only=True)
class ImagingRecord:
    """A sensor and its exposure, and the pictures beside its picture (``schemas.imaging``)."""

    exposure_time_s: float | None = omitted()
    iso: float | None = omitted()
    f_number: float | None = omitted()
    base_iso: float | None = omitted()
    gain_e_per_dn: float | None = omitted()
    electrons_per_value: tuple[float, ...] | None = omitted()
    headroom_stops: float | None = omitted()
    stages: tuple[str, ...] | None = omitted()
    parameters: Mapping[str, JSON] | None = omitted()
    clean: FileDigest | Unset | None = UNSET
    raw: FileDigest | Unset | None = UNSET


@dataclass(frozen=True, kw_only=True)
class Rectification:
    """Describes the pinhole that a camera is taken to: its axes and its K.

    Attributes:
        turn: From the camera's axes to the pinhole's.
        intrinsics: K, pixel centers at (0.5, 0.5) as in sidecars.
        paired: Whether it is one of a rectified pair, and so has disparity.
    """

    turn: Matrix3
    intrinsics: Matrix3
    paired: bool = False


@dataclass(frozen=True, kw_only=True)
class RectifiedRecord:
    """Records that a frame is a camera's, taken to a pinhole (``backends.run.rectify``).

    Attributes:
        turn: As of ``Rectification``.
        kernel: What the picture was resampled with; annotation is the pinhole's own.
        unseen_pixels: Those that the camera's picture does not reach: black, and annotated.
    """

    turn: Matrix3
    kernel: str
    unseen_pixels: Natural


@dataclass(frozen=True, kw_only=True)
class LensRadiance:
    """Records how a backend drew through a lens: by its own ``rays`` or ``resampled`` pinholes."""

    way: str
    views: int | None = omitted()
    view_pixels: int | None = omitted()
    pixels_per_pixel_side: float | None = omitted()
    interpolation_px: float | None = omitted()


@dataclass(frozen=True, kw_only=True)
class BlurRecord:
    """Records approximations of a shutter and an aperture (``backends.picture.subframes``)."""

    exposure_s: float | None = None
    readout_s: float | None = None
    exposure_drawn_s: float | None = None
    exposure_widened_px: float | None = None
    motion_px: float | None = None
    aperture_radius_m: float | None = None
    focus_distance_m: float | None = None
    circle_of_confusion_px: float | None = None
    nearest_m: float | None = None
    gap_px: float | None = None
    sub_frames: int = 0
    sub_frames_per_row: int = 0
    sub_frames_wanted_per_row: int = 0
    spacing_px: float | None = None
    timing_px: float | None = None
    samples_per_sub_frame: int | None = None


@dataclass(frozen=True, kw_only=True)
class SkyPixels:
    """Pixels that show no surface, and how many of them look down."""

    pixels: Natural
    below_horizon: Natural


@dataclass(frozen=True, kw_only=True)
class HazePixels:
    """Pixels that had rays of their own through haze, of those over which it changes."""

    subsampled_pixels: int
    changing_pixels: int | None = omitted()


@dataclass(frozen=True, kw_only=True)
class HalfRecord:
    """Counts values of ``rgb`` that half floats do not hold to 11 bits.

    Attributes:
        clamped: Finite ones beyond 65504, written as that.
        subnormal: Those below 2^-14 that are not 0, written to the next multiple of 2^-24.
    """

    clamped: Natural
    subnormal: Natural


@dataclass(frozen=True)
class ErrorEstimate:
    """Estimates of a picture's Monte Carlo error; None where it is unknown.

    Attributes:
        relative_rms: See ``backends.picture.noise.estimate``.
        relative_rms_bound_95: What the true relative rms error is below in 95 % of pictures.
        relative_mse: As ``relative_rms``.
    """

    relative_rms: float | None = None
    relative_rms_bound_95: float | None = None
    relative_mse: float | None = None


@dataclass(frozen=True)
class Round:
    """One round of adaptive sampling, and the picture's estimates after it."""

    spp: int
    seed: int
    seconds: float
    relative_rms: float | None
    relative_rms_bound_95: float | None


@dataclass(frozen=True, kw_only=True)
class RoundsRecord:
    """Records the target of a picture rendered in rounds, and how it ended."""

    target_relative_rms: float | None = None
    target_seconds: float | None = None
    most_samples_per_pixel: int | None = None
    target_met: bool | None = None
    stopped_by: str | None = None
    seconds: float | None = None
    reproducible: bool | None = None
    rounds: tuple[Round, ...] = ()


@dataclass(frozen=True, kw_only=True)
class ExposureRecord:
    """Records the origin of an exposure.

    Attributes:
        rule: "given", "picture" (a sensor meters each), or "auto", which has all that follows.
        per: "batch" or "sample".
        metered_samples: How many.
        luminance, luminance_p99, luminance_p95_with_sky: What the meter found, W/(m^2 sr).
        of: "surfaces", "sky" or "nothing".
    """

    rule: str | None = omitted()
    per: str | None = omitted()
    metered_samples: int | None = omitted()
    luminance: float | None = omitted()
    luminance_p99: float | None = omitted()
    luminance_p95_with_sky: float | None = omitted()
    of: str | None = omitted()


@dataclass(frozen=True)
class BackendChoice:
    """A backend that was chosen, and why it.

    Attributes:
        backend: Name.
        order: Names in the order of preference, and what that stands on.
        left_out: Those before it that do not work here for what is asked, and why.
    """

    backend: str
    order: str = ""
    left_out: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class RendererFacts:
    """Identifies the renderer of pictures, for sidecars, resume keys and messages."""

    backend: str
    version: str
    device: str
    denoiser: str | None
    warning: str | None


@dataclass(frozen=True, kw_only=True)
class FrameRecord:
    """Records the facts of a frame: ``conventions`` says what the values mean.

    Attributes:
        partner: Name of the camera that disparity goes to; None where that is not rendered, unset
            without one.
        sun: None without a sun.
        visibility_m: Through haze, at z = 0 (``schemas.picture.visibility_m``); None without any.
        png: Whether there is a picture.
        half: Where ``rgb`` is written as half floats.
        instances: Prim path of each class, and the id before its first.
        device: Where ``rgb`` was rendered.
        denoised: What denoised it.
        seconds: By step; some may have been another frame's, too, as two may overlap.
        annotation: What made it: versions of scenec, and of other packages by pass.
        height_above_surface_m: None where nothing is below; unset without annotation.
        choice: Why this backend, where none was named.
    """

    version: str | None = None
    camera: str
    camera_prim: str | None = None
    partner: str | Unset | None = UNSET
    sample: Natural
    time_s: float | None = None
    resolution: tuple[Above0, Above0]
    intrinsics: Matrix3
    lens: Annotated[LensRecord | None, _lens] = omitted()
    camera_to_world: Matrix4
    shutter: ShutterRecord | None = omitted()
    exposure_ev: float
    trigger: tuple[Above0, Natural] | None = None
    tone_curve: str | None = None
    passes: tuple[str, ...]
    conventions: Mapping[str, str] | None = None
    labels: Mapping[str, NamesById]
    sky_labels: Mapping[str, Natural] | None = None
    sun: SunRecord | Unset | None = UNSET
    instances: Mapping[str, int] | None = None
    backend: str
    backend_version: str | None = None
    spp: int | None = None
    noise_seed: int | None = None
    stage_digest: str
    resume_key: str | None = None
    exr: FileDigest
    png: bool = False
    picture: PictureRecord | None = None
    half: HalfRecord | None = omitted()
    instance_table: FileDigest | None = None
    amodal: FileDigest | None = None
    imaging: ImagingRecord | None = omitted()
    effects: tuple[JSON, ...] | None = omitted()
    device: str | None = None
    denoised: str | None = None
    losses: tuple[str, ...] = ()
    seconds: Mapping[str, float] | None = None
    lens_radiance: LensRadiance | None = omitted()
    blur: BlurRecord | None = omitted()
    rectified: RectifiedRecord | None = omitted()
    annotation: Mapping[str, str | None] | None = omitted()
    height_above_surface_m: float | Unset | None = UNSET
    sky: SkyPixels | None = omitted()
    visibility_m: float | None = omitted()
    haze: HazePixels | None = omitted()
    samples_per_pixel: Natural | None = omitted()
    samples_dropped: int | None = omitted()
    estimated_error: ErrorEstimate | None = omitted()
    estimated_error_before_denoising: ErrorEstimate | None = omitted()
    rounds: RoundsRecord | None = omitted()
    exposure: ExposureRecord | None = omitted()
    peak_memory_gb: float | None = None
    choice: BackendChoice | None = omitted()

    @property
    def error(self) -> ErrorEstimate:
        """Estimates of the error of ``rgb``; unknown ones where there are none."""
        return self.estimated_error or ErrorEstimate()

    @property
    def firing(self) -> tuple[int, int]:
        """Samples from one frame of the camera to the next, and its first one."""
        return self.trigger or (1, 0)


@dataclass(frozen=True, kw_only=True)
class LidarNoise:
    """Standard deviations of a lidar's answers, the share that it drops, and its key."""

    range_m: float
    range_ratio: float
    angle_deg: float
    dropout: float
    key: int


@dataclass(frozen=True, kw_only=True)
class ScanRecord:
    """Records the facts of a lidar's scan (``schemas.scans``)."""

    version: str | Unset = UNSET
    lidar: str | Unset = UNSET
    lidar_prim: str | Unset = UNSET
    sample: Natural | Unset = UNSET
    time_s: float | None = None
    lidar_to_world: Matrix4 | Unset = UNSET
    range_m: tuple[float, ...] | Unset = UNSET
    noise: LidarNoise | Unset = UNSET
    intensity: LidarIntensity | None = omitted()
    footprint: LidarFootprint | None = omitted()
    detection: LidarDetection | None = omitted()
    labels: Mapping[str, Mapping[str, str]] | Unset = UNSET
    instances: Mapping[str, int] | Unset = UNSET
    losses: tuple[str, ...] | Unset = UNSET
    stage_digest: str | Unset = UNSET
    resume_key: str | Unset = UNSET
    conventions: Mapping[str, str] | Unset = UNSET
    npz: FileDigest
    ply: bool | Unset = UNSET
