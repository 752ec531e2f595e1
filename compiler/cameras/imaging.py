"""Declares what sensors make of light, and draws it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import chain
from typing import Any, ClassVar, Literal

from scenec.compiler.arithmetic import elementary
from scenec.compiler.distributions.numbers import Number
from scenec.compiler.distributions.resolve import resolve
from scenec.compiler.distributions.streams import Streams
from scenec.compiler.kinds import Context, Finding, Node, bounded, forms, key, kind_of
from scenec.compiler.kinds.forms import an, list_of, one_of
from scenec.schemas import imaging as formulas
from scenec.schemas.codec import JsonObject
from scenec.schemas.errors import SceneError
from scenec.schemas.imaging import MAX_JPEG_SIDE, MIN_DETERMINANT, MIN_WHITE, determinant
from scenec.schemas.spelling import shown

_ROW = list_of(
    bounded(forms.PER_BATCH, at_least=-10, at_most=10), "Of red, green or blue light.", count=3
)


@dataclass(frozen=True)
class ImagingPlan:
    """A sensor's parameters as drawn.

    Attributes:
        samples: At each sample. Of metered ones time and speed are still missing, and what they
            have to be between is there.
        metered: Whether they follow the sensor's exposure.
    """

    samples: tuple[formulas.Imaging, ...]
    metered: bool


@dataclass(frozen=True, kw_only=True)
class ImagingKeys:
    """Makes 000000.png the picture of a real camera, with its optics, noise and processing; rgb
    stays clean radiance. Defaults are those of an industrial camera with 3.45 µm pixels. 0 or null
    leaves a stage out.
    """

    EXAMPLE: ClassVar = {
        "clean": True,
        "read_noise_e": 4,
        "vignetting": {},
        "bloom": {},
        "jpeg": {"quality": 90},
    }

    exposure: JsonObject = key(an("imaging_exposure"), default={"type": "metered"})
    """Exposure time and speed."""
    f_number: Number = key(forms.PER_SAMPLE, default=4, at_least=0.5, at_most=1000)
    """Focal length over aperture."""
    headroom_stops: float = key(forms.PER_BATCH, default=1, at_least=-8, at_most=16, unit="EV")
    """Stops between the value 1 of sensor.exposure and saturation; more keeps highlights and shows
    more noise."""
    pixel_um: float = key(forms.PER_BATCH, default=3.45, at_least=0.1, at_most=1000, unit="µm")
    """Side of a pixel."""
    quantum_efficiency: Any = key(
        list_of(bounded(forms.PER_BATCH, above=0, at_most=1), "One color.", count=3),
        default=[0.5, 0.6, 0.5],
    )
    """Electrons a photon in 600-700, 500-600 and 400-500 nm: red, green, blue."""
    full_well_e: float = key(
        forms.PER_BATCH, default=10_500, at_least=1, at_most=1_000_000_000, unit="e-"
    )
    """Electrons that a pixel holds."""
    bits: int = key(forms.COUNT, default=12, at_least=8, at_most=16)
    """Of the converter."""
    black_level: int = key(forms.COUNT, default=64, at_least=0, at_most=65_534, unit="DN")
    """Number that the converter gives for no electrons."""
    shot_noise: bool = key(forms.TRUTH, default=True)
    """Whether electrons come one by one (Poisson)."""
    read_noise_e: float = key(
        forms.PER_BATCH, default=2.3, at_least=0, at_most=1_000_000, unit="e-"
    )
    """Standard deviation of what reading adds."""
    dark_current: JsonObject = key(an("imaging_dark_current"), default={})
    """Electrons without light."""
    prnu: float = key(forms.FRACTION_PER_BATCH, default=0.006)
    """Relative standard deviation of pixels' sensitivity (photo response non-uniformity)."""
    dsnu_e: float = key(forms.PER_BATCH, default=0.6, at_least=0, at_most=1_000_000, unit="e-")
    """Standard deviation of the pixels' offset (dark signal non-uniformity)."""
    defects: JsonObject = key(an("imaging_defects"), default={})
    """Hot and dead pixels."""
    mosaic: Literal["rggb", "bggr", "grbg", "gbrg", "none"] = key(forms.CHOICE, default="rggb")
    """Colors of the first two rows of pixels; none: each pixel sees all three. Pictures of one row
    or column have none."""
    demosaic: str = key(one_of(*formulas.DEMOSAICS), default="malvar")
    """Malvar, He and Cutler 2004, or the mean of the nearest."""
    color_matrix: Any | None = key(list_of(_ROW, "One color of pixels.", count=3), optional=True)
    """What red, green and blue pixels see of linear Rec.709, a row each. The picture undoes it,
    which amplifies noise. Left out: Rec.709."""
    white_balance: Any = key(
        list_of(bounded(forms.PER_BATCH, above=0, at_most=100), "Red, green or blue.", count=3),
        default=[1, 1, 1],
    )
    """Factors on top of those that show white light as white."""
    vignetting: JsonObject | None = key(an("imaging_vignetting"), optional=True)
    """How the picture darkens towards its corners; left out, not."""
    bloom: JsonObject | None = key(an("imaging_bloom"), optional=True)
    """Light that lens and glass scatter; left out, none."""
    jpeg: JsonObject | None = key(an("imaging_jpeg"), optional=True)
    """Compression of the picture; left out, none."""
    clean: bool = key(forms.TRUTH, default=False)
    """Also write 000000.clean.png: same light, optics and exposure; no noise, defects, mosaic,
    rounding or JPEG."""
    raw: bool = key(forms.TRUTH, default=False)
    """Also write 000000.raw.png: the converter's numbers behind the mosaic, 16 bits."""

    @staticmethod
    def check(node: Node) -> Iterator[Finding]:
        """Finds what does not go together, and with the sensor."""
        yield from _check_numbers(node)
        yield from _check_matrix(node)

    def draw(self, context: Context) -> ImagingPlan:
        """Returns its parameters at each sample.

        Raises:
            SceneError: Drawn numbers do not go together.
        """
        # A sensor is one thing through all batches: its pattern is drawn for the first.
        pattern = Streams(context.streams.seed, 0).key(f"{context.path}/pattern")
        noise = context.key("noise")
        made = tuple(
            _at_sample(resolve(vars(self), context.streams, context.path, sample=i), pattern, noise)
            for i in range(context.samples)
        )
        for imaging in made:
            # Metered ones have their time and speed only when there is light.
            faults = formulas.faults(replace(imaging, time_s=1.0, iso=1.0))
            low_high = imaging.time_range_s, imaging.iso_range
            if any(low > high for low, high in low_high):
                faults.append(f"ranges {low_high}: expected the smaller one first")
            if faults:
                raise SceneError(f"{context.path}: {faults[0]}")
        return ImagingPlan(made, self.exposure["type"] == "metered")


@dataclass(frozen=True, kw_only=True)
class Metered:
    """Shows what sensor.exposure says: the lowest speed while the time suffices, then more speed.
    Beyond the limits the picture is darker or brighter.
    """

    EXAMPLE: ClassVar = {"type": "metered"}

    time_range_s: tuple[float, float] = key(forms.TIME_RANGE_S)
    iso_range: tuple[float, float] = key(forms.ISO_RANGE)

    @staticmethod
    def check(node: Node) -> Iterator[Finding]:
        """Finds ranges that end before they begin."""
        for name in ("time_range_s", "iso_range"):
            low, high = map(node.at(name).span, (0, 1))
            if low and high and low[1] > high[0]:
                yield node.fault(
                    f"{low[1]:g} is above {high[0]:g}: expected the smaller one first", name
                )

    def of(self, imaging: formulas.Imaging) -> formulas.Imaging:
        """Returns a sensor's parameters with this exposure."""
        return replace(imaging, **vars(self))


@dataclass(frozen=True, kw_only=True)
class Manual:
    """As given; sensor.exposure has no say."""

    EXAMPLE: ClassVar = {"type": "manual", "time_s": 0.002, "iso": 100}

    time_s: float = key(forms.PER_SAMPLE, above=0, at_most=1_000_000, unit="s")
    """Exposure time."""
    iso: float | None = key(forms.PER_SAMPLE, optional=True, above=0, at_most=1_000_000_000)
    """ISO speed (ISO 12232, saturation-based): 78 / iso lux seconds give the largest number. Below
    the base speed (in sidecars) pixels are full first. Or give gain_e."""
    gain_e: float | None = key(
        forms.PER_SAMPLE, optional=True, above=0, at_most=1_000_000_000, unit="e-/DN"
    )
    """Electrons that make one step of the converter, in place of iso."""

    @staticmethod
    def check(node: Node) -> Iterator[Finding]:
        """Finds an exposure of the sensor beside it, and two speeds or none."""
        yield from _check_alone(node)
        if ("iso" in node) == ("gain_e" in node):
            yield node.fault("expected either the key iso or the key gain_e")

    def of(self, imaging: formulas.Imaging) -> formulas.Imaging:
        """Returns a sensor's parameters with this exposure."""
        iso = self.iso
        if iso is None:
            assert self.gain_e is not None
            iso = formulas.iso_of_gain(imaging, self.gain_e)
        return replace(imaging, time_s=self.time_s, iso=iso)


@dataclass(frozen=True, kw_only=True)
class AutoImaging:
    """Meters each picture alone: the logarithmic mean of the lit luminance, or a percentile of all,
    is shown as target, in steps of 1/64 EV. Time first, then speed. Ignores sensor.exposure.
    """

    EXAMPLE: ClassVar = {"type": "auto", "target": 0.18}

    target: float = key(forms.PER_BATCH, default=0.18, above=0, at_most=1000)
    """What it is shown as; white is 1."""
    percentile: float | None = key(
        forms.PER_BATCH, optional=True, at_least=0, at_most=100, unit="%"
    )
    """Percentile of luminance that is metered; left out, the logarithmic mean."""
    time_range_s: tuple[float, float] = key(forms.TIME_RANGE_S)
    iso_range: tuple[float, float] = key(forms.ISO_RANGE)

    @staticmethod
    def check(node: Node) -> Iterator[Finding]:
        """Finds an exposure of the sensor beside it, and ranges that end before they begin."""
        yield from _check_alone(node)
        yield from Metered.check(node)

    def of(self, imaging: formulas.Imaging) -> formulas.Imaging:
        """Returns a sensor's parameters with this exposure."""
        own = {name: value for name, value in vars(self).items() if value is not None}
        return replace(imaging, rule="auto", **own)


@dataclass(frozen=True, kw_only=True)
class Vignetting:
    """Factor cos(t)^power · (1 + a r² + b r⁴ + c r⁶), with t the angle to the axis and r = 1 in the
    farthest corner.
    """

    EXAMPLE: ClassVar = {"power": 4}

    power: int = key(forms.COUNT, default=4, at_least=0, at_most=8)
    """4 is a thin lens's; wide lenses are made to have less."""
    polynomial: Any = key(
        list_of(bounded(forms.PER_BATCH, at_least=-10, at_most=10), "A coefficient.", count=3),
        default=[0, 0, 0],
    )
    """a, b, c."""


@dataclass(frozen=True, kw_only=True)
class Bloom:
    """Spreads a share of the light by three Gaussians (60, 30 and 10 % by radius_px, 3 and 9 times
    that); the sum stays.
    """

    EXAMPLE: ClassVar = {"share": 0.02, "radius_px": 6}

    share: float = key(forms.FRACTION_PER_BATCH, default=0.02)
    """Share of the light."""
    radius_px: float = key(forms.PER_BATCH, default=8, at_least=0.5, at_most=10_000, unit="px")
    """Standard deviation of the narrowest."""


@dataclass(frozen=True, kw_only=True)
class Jpeg:
    """The picture is compressed and decoded; it is stored without further loss."""

    EXAMPLE: ClassVar = {"quality": 90}

    TITLE: ClassVar = "Imaging: JPEG"
    quality: int = key(forms.COUNT, default=90, at_least=1, at_most=100)
    """As libjpeg has it."""
    subsampling: str = key(one_of(*formulas.SUBSAMPLINGS), default="4:2:0")
    """Of colors."""


@dataclass(frozen=True, kw_only=True)
class DarkCurrent:
    """Electrons that heat sets free."""

    EXAMPLE: ClassVar = {"rate_e_s": 2, "temperature_c": 35}

    rate_e_s: float = key(
        forms.PER_BATCH, default=2, at_least=0, at_most=1_000_000_000, unit="e-/s"
    )
    """At the reference temperature, a second."""
    reference_c: float = key(forms.PER_BATCH, default=25, at_least=-273, at_most=1000, unit="°C")
    """Reference temperature."""
    doubling_c: float = key(forms.PER_BATCH, default=7, at_least=0.1, at_most=1000, unit="K")
    """It doubles every so many degrees."""
    temperature_c: Number = key(
        forms.PER_SAMPLE, default=25, at_least=-273, at_most=1000, unit="°C"
    )
    """Of the sensor; hot pixels follow it, too."""


@dataclass(frozen=True, kw_only=True)
class Defects:
    """Pixels that are the same in all pictures of the sensor."""

    EXAMPLE: ClassVar = {"hot": 0.0001, "dead": 5e-05}

    hot: float = key(forms.PER_BATCH, default=0.0001, at_least=0, at_most=0.5)
    """Share of pixels with more dark current."""
    hot_rate_e_s: float = key(
        forms.PER_BATCH, default=500, at_least=0, at_most=1_000_000_000, unit="e-/s"
    )
    """Their mean excess (exponentially distributed) at the reference temperature."""
    dead: float = key(forms.PER_BATCH, default=1e-05, at_least=0, at_most=0.5)
    """Share of pixels that see nothing."""


def _at_sample(cfg: JsonObject, pattern: int, noise: int) -> formulas.Imaging:
    dark, defects = cfg["dark_current"], cfg["defects"]
    warmer = (dark["temperature_c"] - dark["reference_c"]) / dark["doubling_c"]
    # Within what a double holds; hotter than that all pixels are full anyway.
    heat = two_to(min(max(warmer, -100.0), 60.0))
    numbers: dict[str, Any] = {
        "pattern_seed": pattern,
        "noise_seed": noise,
        "headroom": cfg["headroom_stops"],
        "quantum_efficiency": tuple(cfg["quantum_efficiency"]),
        "white_balance": tuple(cfg["white_balance"]),
        "dark_current_e_s": min(dark["rate_e_s"] * heat, 1e11),
        "hot": defects["hot"],
        "hot_rate_e_s": min(defects["hot_rate_e_s"] * heat, 1e11),
        "dead": defects["dead"],
    }
    if (matrix := cfg["color_matrix"]) is not None:
        numbers["color_matrix"] = tuple(chain(*matrix))
    if (vignetting := cfg["vignetting"]) is not None:
        numbers["vignetting_power"] = vignetting["power"]
        numbers["vignetting_polynomial"] = tuple(vignetting["polynomial"])
    if (bloom := cfg["bloom"]) is not None:
        numbers |= {"bloom": bloom["share"], "bloom_sigma_px": bloom["radius_px"]}
    if (jpeg := cfg["jpeg"]) is not None:
        numbers |= {"jpeg_quality": jpeg["quality"], "jpeg_subsampling": jpeg["subsampling"]}
    # The other fields are keys by name.
    given = {name: cfg[name] for name in formulas.TYPES if cfg.get(name) is not None}
    exposure = {
        name: tuple(value) if isinstance(value, list) else value
        for name, value in cfg["exposure"].items()
        if name != "type"
    }
    kind = kind_of("imaging_exposure", cfg["exposure"]["type"])
    result: formulas.Imaging = kind(**exposure).of(formulas.Imaging(**{**given, **numbers}))
    return result


def two_to(x: float) -> float:
    """2**x, of the compiler's own elementary functions."""
    return float(elementary.exp(x * elementary.log(2.0)))


def _check_alone(exposure: Node) -> Iterator[Finding]:
    sensor = exposure.whole().at(*exposure.path[:-2])
    if "exposure" in sensor:
        yield sensor.key_fault(
            f'nothing reads it beside an imaging/exposure of type "{exposure["type"]}": take it '
            'away, or make that "metered"',
            "exposure",
        )


def _check_numbers(imaging: Node) -> Iterator[Finding]:
    bits, black = imaging["bits"], imaging["black_level"]
    sides = imaging.whole().at(*imaging.path[:-1])["resolution"] or ()
    if bits is not None and black is not None and black >= 2**bits - 1:
        yield imaging.fault(
            f"a black level of {black} leaves no numbers of {bits} bits: expected less than "
            f"{2**bits - 1}",
            "black_level" if "black_level" in imaging else "bits",
        )
    if "jpeg" in imaging and max(sides, default=0) > MAX_JPEG_SIDE:
        yield imaging.fault(
            f"a JPEG has at most {MAX_JPEG_SIDE} pixels a side, this sensor {max(sides)}: take it "
            "away",
            "jpeg",
        )
    if imaging["raw"] and (1 in sides or imaging["mosaic"] == "none"):
        yield imaging.fault(
            "raw numbers are those behind a mosaic, and there is none: take it away", "raw"
        )


def _check_matrix(imaging: Node) -> Iterator[Finding]:
    matrix = imaging.at("color_matrix")
    # Drawn ones are looked at when they are drawn.
    numbers = [row.constant(column) for row in matrix.each("*") for column in range(3)]
    known = tuple(number for number in numbers if number is not None)
    if len(known) != 9:
        return
    for row in range(3):
        total = sum(known[3 * row : 3 * row + 3])
        if total < MIN_WHITE:
            yield matrix.fault(
                f"adds up to {total:g}, so white light looks black to such pixels: expected more "
                f"than {MIN_WHITE:g}",
                row,
            )
    if abs(determinant(known)) < MIN_DETERMINANT:
        yield matrix.fault(
            f"{shown(imaging['color_matrix'])} cannot be inverted: expected colors that can be "
            "told apart"
        )
