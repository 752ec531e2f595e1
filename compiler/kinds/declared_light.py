"""Declares keys of light."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, Literal

from scenec.compiler.distributions.numbers import Number
from scenec.compiler.kinds.declare import Form, bounded, key
from scenec.compiler.kinds.forms import (
    ANGLE_PER_SAMPLE,
    CHOICE,
    COLOR,
    COUNT,
    FRACTION_PER_SAMPLE,
    GROUND_COLOR,
    LENGTH_PER_BATCH,
    LENGTH_PER_SAMPLE,
    MOUNT_POSITION_M,
    MOUNT_ROTATION_DEG,
    NAME,
    PER_SAMPLE,
    SUN_ELEVATION_DEG,
    TEXT,
    an,
    file,
    list_of,
    named,
)


@dataclass(frozen=True, kw_only=True)
class CloudsCirrus:
    """Thin streaks of ice, high up."""

    EXAMPLE: ClassVar = {
        "coverage": 0.7,
        "optical_depth": 0.3,
        "bearing_deg": {"type": "uniform", "min": 0, "max": 360},
    }

    KEYWORDS: ClassVar = {"type": ["object", "null"]}

    coverage: Number = key(FRACTION_PER_SAMPLE, default=0.5)
    """Share of the sky, straight down, that has any."""
    optical_depth: Number = key(PER_SAMPLE, default=0.5, at_least=0, at_most=10)
    """Where it is thickest, straight down: 0.03 can hardly be seen, 0.3 is usual, 3 veils the sun.
    """
    height_m: Number = key(LENGTH_PER_SAMPLE, default=9000, at_least=1000, at_most=20_000)
    """Over the world's z = 0."""
    size_m: float = key(LENGTH_PER_BATCH, default=4000, at_least=100, at_most=100_000)
    """Width of streaks; they are five times as long."""
    bearing_deg: Number = key(ANGLE_PER_SAMPLE, default=60, at_least=-100_000, at_most=100_000)
    """Compass bearing that streaks run along."""
    offset_m: Any = key(
        list_of(
            bounded(LENGTH_PER_SAMPLE, at_least=-1_000_000_000, at_most=1_000_000_000),
            "Along one axis.",
            least=2,
            most=2,
        ),
        default=[0, 0],
    )
    """Where the pattern is moved: to the east, to the north. If it is drawn for each sample, each
    has other clouds."""


@dataclass(frozen=True, kw_only=True)
class CloudsCumulus:
    """Heaps of cloud on a level base, as on a fine day."""

    EXAMPLE: ClassVar = {
        "coverage": {"type": "uniform", "min": 0.1, "max": 0.6},
        "offset_m": [{"type": "uniform", "min": -20_000, "max": 20_000}, 0],
    }

    KEYWORDS: ClassVar = {"type": ["object", "null"]}

    coverage: Number = key(FRACTION_PER_SAMPLE, default=0.35)
    """Share of the ground that lies below clouds."""
    optical_depth: Number = key(PER_SAMPLE, default=40, at_least=0, at_most=1000)
    """Of the tallest cloud, straight down."""
    base_m: Number = key(LENGTH_PER_SAMPLE, default=1200, at_least=50, at_most=10_000)
    """Height of the base over the world's z = 0."""
    thickness_m: Number = key(LENGTH_PER_SAMPLE, default=900, at_least=10, at_most=10_000)
    """Height of the tallest cloud over the base."""
    size_m: float = key(LENGTH_PER_BATCH, default=1800, at_least=10, at_most=100_000)
    """Width of a cloud and the gap beside it; groups of clouds are three times as wide."""
    offset_m: Any = key(
        list_of(
            bounded(LENGTH_PER_SAMPLE, at_least=-1_000_000_000, at_most=1_000_000_000),
            "Along one axis.",
            least=2,
            most=2,
        ),
        default=[0, 0],
    )
    """Where the pattern is moved: to the east, to the north. If it is drawn for each sample, each
    has other clouds."""


@dataclass(frozen=True, kw_only=True)
class Light:
    """Sun, sky, clouds, lamps and haze."""

    EXAMPLE: ClassVar = {
        "sun": {"elevation_deg": 35},
        "sky": {"type": "atmosphere", "planet": "earth"},
        "haze": {"visibility_m": 4000},
    }

    sun: Mapping[str, Any] = key(an("sun"), default={})
    """The sun; null for none."""
    sky: Mapping[str, Any] = key(an("sky"), default={"type": "clear"})
    """The sky."""
    more: Mapping[str, Any] = key(named(an("light_more"), "One disc.", by="disc"), default={})
    """Further distant discs by name: earthshine, a second sun."""
    lamps: Mapping[str, Any] = key(named(an("light_lamp"), "One lamp.", by="lamp"), default={})
    """Spot lights by name. Metered exposures count their light where they fall on what the middle
    of a picture shows."""
    clouds: Mapping[str, Any] = key(an("light_clouds"), sparse=True)
    """Clouds in the sky, which shade the scene; left out: none."""
    haze: Mapping[str, Any] | None = key(an("light_haze"), optional=True)
    """Dust or mist between the cameras and what they see; left out or null: none."""


@dataclass(frozen=True, kw_only=True)
class LightClouds:
    """Clouds in a sky of the type atmosphere (Earth's) or clear, drawn into its picture as they are
    seen from the middle of the ground. The sun loses, at each sample, what the clouds before it
    hide; shadows of cumulus lie on the land where they fall.
    """

    EXAMPLE: ClassVar = {"cumulus": {"coverage": 0.4}, "cirrus": {"optical_depth": 0.2}}

    TITLE: ClassVar = "Clouds"
    cumulus: Mapping[str, Any] = key(an("clouds_cumulus"), default=None)
    """Cumulus; null for none."""
    cirrus: Mapping[str, Any] = key(an("clouds_cirrus"), default=None)
    """Cirrus; null for none."""
    resolution: int = key(COUNT, default=768, at_least=8, at_most=8192, unit="px")
    """Height of the sky's lat-long picture with clouds, in pixels; its width is twice that. One
    that light.sky makes larger keeps its own."""


@dataclass(frozen=True, kw_only=True)
class LightEarthshine:
    """The Earth as it shines on the Moon.

    Its irradiance is (6371 km / 384400 km)² times geometric albedo, solar irradiance and (sin a
    + (pi - a) cos a) / pi, a Lambert sphere's phase law in the phase angle a: 0.137 W/m² of a
    full Earth by default, 1e-4 of the Sun's. The light comes from a full disc of the Earth's
    size, whatever the phase.
    """

    EXAMPLE: ClassVar = {
        "type": "earthshine",
        "phase_deg": 60,
        "elevation_deg": 40,
        "azimuth_deg": 200,
    }

    phase_deg: Number = key(ANGLE_PER_SAMPLE, default=0, at_least=0, at_most=180)
    """Phase angle: that between the Sun and the Moon, seen from the Earth. 0 is a full Earth, 90
    half of one, 180 a dark one."""
    elevation_deg: Any = key(SUN_ELEVATION_DEG)
    azimuth_deg: Number = key(ANGLE_PER_SAMPLE, default=135, at_least=-100_000, at_most=100_000)
    """Compass bearing of the Earth, clockwise from +Y (north)."""
    solar_irradiance: Number = key(
        PER_SAMPLE, default=1361, above=0, at_most=1_000_000_000_000, unit="W/m²"
    )
    """What the Sun gives the Earth on a surface that faces it; in the units of the sun's
    irradiance."""
    geometric_albedo: Number = key(PER_SAMPLE, default=0.367, above=0, at_most=1)
    """The Earth's: 0.367 for visible light (Cox 2000). Of all solar light it is about 0.22, which
    with as much thermal infrared, that no camera sees, makes the 0.15 W/m² of Glenar et al. (2019).
    """
    diameter_deg: Number = key(ANGLE_PER_SAMPLE, default=1.9, at_least=0, at_most=90)
    """Angular diameter."""
    color: Any = key(COLOR, default=[0.63, 0.74, 1])
    """Color, scaled so that the irradiance is as said; not black. Bluish by default: the Earth's
    B-V is 0.2, the Sun's 0.65 (Cox 2000)."""


@dataclass(frozen=True, kw_only=True)
class LightHaze:
    """A layer of air that scatters.

    Light of surfaces and of the sky is weakened on its way to the camera by exp(-optical
    depth), and the light of suns and sky that the layer scatters toward the camera, the
    airlight, is added. Surfaces receive suns weakened and their sky brightened by as much as
    the layer does at their height, so shadows soften. Said once for all renderers, from exact
    depth. What a sky's picture shows below the horizon is taken as ground at the height of the
    scene's lowest point. Haze throws no shadows, none fall into it, and lamps make no beams in
    it.
    """

    EXAMPLE: ClassVar = {
        "visibility_m": {"type": "uniform", "min": 200, "max": 2000},
        "scale_height_m": 50,
    }

    KEYWORDS: ClassVar = {"type": ["object", "null"]}

    TITLE: ClassVar = "Haze"
    visibility_m: Number | None = key(
        LENGTH_PER_SAMPLE, optional=True, at_least=0.001, at_most=1_000_000_000_000
    )
    """Distance at which 2 % of a black thing's contrast to the horizon are left (Koschmieder 1924):
    the extinction of luminance is 3.912 / visibility."""
    color: Any = key(
        list_of(
            bounded(PER_SAMPLE, at_least=0, at_most=1000),
            "Linear Rec.709 red, green or blue.",
            least=3,
            most=3,
        ),
        default=[1, 1, 1],
    )
    """Extinction by color, relative: more blue, as of small droplets, turns dark hills blue and
    bright snow yellow. Scaled so that the extinction of luminance is as said."""
    extinction_per_m: Any | None = key(
        list_of(
            bounded(PER_SAMPLE, at_least=0, at_most=1_000_000, unit="1/m"),
            "Linear Rec.709 red, green or blue.",
            least=3,
            most=3,
        ),
        optional=True,
    )
    """Extinction itself, in place of visibility_m and color."""
    scale_height_m: Number = key(
        LENGTH_PER_SAMPLE, default=1000, at_least=0.001, at_most=1_000_000_000
    )
    """Height over which it thins out by a factor e, from the world's z = 0, where it is as said:
    some meters for morning fog on meadows, 1 km for haze over land, 11 km for dust on Mars.
    Straight up, its optical depth is the extinction at z = 0 times this."""
    asymmetry: Number = key(PER_SAMPLE, default=0.7, at_least=-0.9, at_most=0.9)
    """g of the phase function (Henyey and Greenstein 1941), the mean cosine of the angle by which
    light is turned: 0 in all directions alike, 0.65 dust, 0.7 haze, 0.85 fog, whose droplets glow
    around the sun."""
    albedo: Any = key(
        list_of(
            bounded(PER_SAMPLE, at_least=0, at_most=1),
            "Linear Rec.709 red, green or blue.",
            least=3,
            most=3,
        ),
        default=[1, 1, 1],
    )
    """Part of the light it meets that it scatters and does not absorb, by color: 1 water, [0.97,
    0.92, 0.78] dust on Mars."""
    airlight: Any = key(
        Form(
            {
                "type": ["string", "array"],
                "if": {"type": "string"},
                "then": {"enum": ["sky"]},
                "else": {
                    "minItems": 3,
                    "maxItems": 3,
                    "items": {
                        **PER_SAMPLE.keywords,
                        "description": "Radiance, linear Rec.709 red, green or blue.",
                        "minimum": 0,
                        "maximum": 1_000_000_000,
                        "x-unit": "W/(m² sr)",
                    },
                },
            }
        ),
        default="sky",
    )
    """Radiance that endless haze shows. "sky": what haze scatters of suns and sky. Or, in all
    directions, linear Rec.709 radiance, [red, green, blue] in W/(m² sr)."""


@dataclass(frozen=True, kw_only=True)
class LightLamp:
    """A spot light: a sphere that shines into a cone.

    At an angle t from its axis its intensity is intensity · (1 - smoothstep(t)) between
    cone_deg · (1 - softness) and cone_deg, smoothstep(x) = 3x² - 2x³. Cameras do not see the
    lamp itself.
    """

    EXAMPLE: ClassVar = {
        "mount": {"type": "rig", "rig": "rover"},
        "intensity": 400,
        "cone_deg": 60,
        "radius_m": 0.05,
    }

    TITLE: ClassVar = "Lamp"
    mount: Mapping[str, Any] = key(an("light_mount"))
    """Where it is and where it shines."""
    intensity: Number = key(PER_SAMPLE, at_least=0, at_most=1_000_000_000_000, unit="W/sr")
    """On the axis, far away. An LED of F lumens that shines evenly into a cone of half angle a has
    about F / (300 · 2 pi (1 - cos a))."""
    color: Any = key(COLOR, default=[1, 0.95, 0.88])
    """Color, scaled so that the intensity is as said; not black."""
    radius_m: Number = key(LENGTH_PER_SAMPLE, default=0.03, at_least=0, at_most=1000)
    """Radius of the sphere; 0 is a point, whose shadows are sharp."""
    cone_deg: Any = key(
        ANGLE_PER_SAMPLE.but(**{"x-usual-minimum": 4}), default=30, above=0, at_most=180
    )
    """Angle between the axis and the cone's border; 180 shines everywhere."""
    softness: Number = key(FRACTION_PER_SAMPLE, default=0.5)
    """Share of the cone's angle over which it fades to 0 at the border."""


@dataclass(frozen=True, kw_only=True)
class LightMountRig:
    """On a rig, with which it moves; without a rotation it shines ahead, along the rig's z axis."""

    EXAMPLE: ClassVar = {"type": "rig", "rig": "rover", "position_m": [0.2, 0, 0]}

    rig: str = key(TEXT)
    """Name of the rig."""
    position_m: Any = key(MOUNT_POSITION_M)
    rotation_deg: Any = key(MOUNT_ROTATION_DEG)


@dataclass(frozen=True, kw_only=True)
class LightMountWorld:
    """Standing in the world."""

    EXAMPLE: ClassVar = {
        "type": "world",
        "x_m": 0,
        "y_m": 0,
        "z_m": 6,
        "target": {"x_m": 4, "y_m": 0},
    }

    x_m: Number = key(LENGTH_PER_SAMPLE, at_least=-1_000_000_000, at_most=1_000_000_000)
    """East."""
    y_m: Number = key(LENGTH_PER_SAMPLE, at_least=-1_000_000_000, at_most=1_000_000_000)
    """North."""
    z_m: Number = key(LENGTH_PER_SAMPLE, default=0, at_least=-1_000_000_000, at_most=1_000_000_000)
    """Height, see heights."""
    heights: Literal["ground", "world"] = key(CHOICE, default="ground")
    """What heights are over: the ground below, or the world's zero."""
    bearing_deg: Number = key(ANGLE_PER_SAMPLE, default=0, at_least=-100_000, at_most=100_000)
    """Compass bearing that it shines to, clockwise from +Y (north). Not with a target."""
    elevation_deg: Number = key(ANGLE_PER_SAMPLE, default=-90, at_least=-90, at_most=90)
    """Angle above the horizon that it shines to. Not with a target."""
    target: Mapping[str, Any] | None = key(an("light_target"), optional=True)
    """A place that it shines to."""


@dataclass(frozen=True, kw_only=True)
class LightSun:
    """A second sun; its keys are those of the sun."""

    EXAMPLE: ClassVar = {"type": "sun", "irradiance": 150, "elevation_deg": 12, "azimuth_deg": 300}

    irradiance: Number = key(
        PER_SAMPLE, default=1000, above=0, at_most=1_000_000_000_000, unit="W/m²"
    )
    """On a surface that faces the sun."""
    elevation_deg: Any = key(SUN_ELEVATION_DEG)
    azimuth_deg: Number = key(ANGLE_PER_SAMPLE, default=135, at_least=-100_000, at_most=100_000)
    """Compass bearing of the sun, clockwise from +Y (north)."""
    diameter_deg: Number = key(ANGLE_PER_SAMPLE, default=0.53, at_least=0, at_most=90)
    """Angular diameter."""
    color: Any = key(COLOR, default=[1, 0.94, 0.86])
    """Color, scaled so that the irradiance is as said; not black."""


@dataclass(frozen=True, kw_only=True)
class LightTarget:
    """A place that a lamp shines to."""

    EXAMPLE: ClassVar = {"x_m": 4, "y_m": 0, "z_m": 0.5}

    TITLE: ClassVar = "Lamp's target"
    x_m: Number = key(LENGTH_PER_SAMPLE, at_least=-1_000_000_000, at_most=1_000_000_000)
    """East."""
    y_m: Number = key(LENGTH_PER_SAMPLE, at_least=-1_000_000_000, at_most=1_000_000_000)
    """North."""
    z_m: Number = key(LENGTH_PER_SAMPLE, default=0, at_least=-1_000_000_000, at_most=1_000_000_000)
    """Height, over the same as the lamp's."""


@dataclass(frozen=True, kw_only=True)
class SkyAtmosphere:
    """The sky of a planet, by scattering in its air.

    Where the sun stands and what it gives above the atmosphere is said in light.sun; what of
    its light comes through is computed.
    """

    EXAMPLE: ClassVar = {
        "type": "atmosphere",
        "planet": "mars",
        "scattering": "multiple",
        "dust_density": {"type": "uniform", "min": 0.5, "max": 2},
        "labels": {"class": "sky"},
    }

    planet: Literal["earth", "mars", "moon"] = key(CHOICE, default="earth")
    """Whose: "moon" has no air, so its sky is black."""
    scattering: Literal["single", "multiple"] = key(CHOICE, default="single")
    """How often light is scattered. "single" is Nishita's sky: exact for what is scattered once.
    "multiple" adds all further orders by an approximation, without which thick air and dust are too
    dark, black where the sun is low."""
    air_density: Number = key(PER_SAMPLE, default=1, at_least=0, at_most=10)
    """Factor on the gas."""
    dust_density: Number = key(PER_SAMPLE, default=1, at_least=0, at_most=10)
    """Factor on dust and haze. 1 is clear air on Earth, and an optical depth of 0.5 on Mars."""
    ozone_density: Number = key(PER_SAMPLE, default=1, at_least=0, at_most=10)
    """Factor on Earth's ozone; 1 is 300 Dobson units. Mars has too little to be seen."""
    altitude_m: Number = key(LENGTH_PER_SAMPLE, default=0, at_least=0, at_most=60_000)
    """Height of the scene above the planet's mean level."""
    ground_color: Any = key(GROUND_COLOR)
    resolution: int = key(COUNT, default=128, at_least=8, at_most=4096, unit="px")
    """Height of the lat-long picture that is made, in pixels; its width is twice that."""
    labels: Mapping[str, Any] = key(an("label_choice"), default={})
    """The sky's label; a level left out has label 0."""
    labels_below: Mapping[str, Any] = key(an("label_choice"), default={}, sparse=True)
    """The label of what lies below the horizontal plane through the camera and is no surface: the
    ground of the sky's picture. A level left out has the sky's label there."""


@dataclass(frozen=True, kw_only=True)
class SkyClear:
    """A smooth gradient from zenith to horizon."""

    EXAMPLE: ClassVar = {
        "type": "clear",
        "irradiance": 220,
        "zenith_color": [0.12, 0.3, 0.9],
        "horizon_color": [0.45, 0.65, 0.95],
    }

    irradiance: Number = key(
        PER_SAMPLE, default=200, above=0, at_most=1_000_000_000_000, unit="W/m²"
    )
    """Diffuse irradiance on a horizontal surface."""
    zenith_color: Any = key(COLOR, default=[0.12, 0.3, 0.9])
    """Color overhead, relative to the others. Not black together with the horizon."""
    horizon_color: Any = key(COLOR, default=[0.45, 0.65, 0.95])
    """Color at the horizon, relative to the others."""
    ground_color: Any = key(GROUND_COLOR)
    resolution: int = key(COUNT, default=128, at_least=8, at_most=4096, unit="px")
    """Height of the lat-long picture that is made, in pixels; its width is twice that."""
    labels: Mapping[str, Any] = key(an("label_choice"), default={})
    """The sky's label; a level left out has label 0."""
    labels_below: Mapping[str, Any] = key(an("label_choice"), default={}, sparse=True)
    """The label of what lies below the horizontal plane through the camera and is no surface: the
    ground of the sky's picture. A level left out has the sky's label there."""


@dataclass(frozen=True, kw_only=True)
class SkyImage:
    """Lat-long pictures."""

    EXAMPLE: ClassVar = {
        "type": "image",
        "files": ["overcast.exr", "noon.exr"],
        "pick": "shuffled",
        "sun": "extract",
    }

    files: Any = key(
        list_of(
            file("image"),
            'An OpenEXR file: relative to the cfg, or "package:NAME/path" in an installed Python '
            "package, where * stands for any part of a name.",
            least=1,
        )
    )
    """Pictures, one of which is used in each sample."""
    pick: Literal["in_turn", "random", "shuffled"] = key(CHOICE, default="in_turn")
    """Which picture a sample gets: the next one, any, or any of those that were not shown yet,
    until all of the list were; then it begins anew in another order. Samples are counted on over
    batches."""
    strength: Number = key(PER_SAMPLE, default=1, above=0, at_most=1_000_000_000)
    """Factor on the picture's radiance."""
    rotation_deg: Number = key(ANGLE_PER_SAMPLE, default=0, at_least=-100_000, at_most=100_000)
    """Turn about the vertical, clockwise seen from above, as compass bearings grow."""
    sun: Literal["keep", "extract"] = key(CHOICE, default="keep")
    """keep: the sun stays in the picture. extract: it is taken out of it and becomes a disc with
    the same irradiance, color and direction, so that its shadows do not depend on the picture's
    resolution; light.sun must be left out or null then. A picture in which no sun is found
    (overcast, indoors) stays as it is, which the report says."""
    labels: Mapping[str, Any] = key(an("label_choice"), default={})
    """The sky's label; a level left out has label 0."""
    labels_below: Mapping[str, Any] = key(an("label_choice"), default={}, sparse=True)
    """The label of what lies below the horizontal plane through the camera and is no surface: the
    ground of the sky's picture. A level left out has the sky's label there. A level with a label
    map has the map's."""
    label_maps: Any | None = key(
        list_of(an("sky_label_maps"), "Those of one picture.", least=1), optional=True
    )
    """What is seen where on the pictures: one entry for each of files, in their order; null: all of
    that picture has the sky's label. Lat-long like the pictures, of any resolution, looked up at
    the nearest texel."""


@dataclass(frozen=True, kw_only=True)
class SkyLabelMap:
    """A picture whose pixels say what is seen there."""

    EXAMPLE: ClassVar = {"file": "overcast_labels.png", "values": {"7": "building"}}

    TITLE: ClassVar = "Label map of a panorama"
    file: Path = key(file("label_map"))
    """A PNG file: gray of up to 16 bits, with a palette, or RGB. Row 0 is the zenith."""
    values: Any = key(
        Form(
            {
                "type": "object",
                "minProperties": 1,
                "additionalProperties": {
                    "description": "Name of a label of this level, or null.",
                    "type": ["string", "null"],
                },
                "x-name": "value",
            }
        )
    )
    """The label of each pixel value: a whole number as it is stored (gray, or the index in the
    palette), or "#RRGGBB"; null: no label. All values of the picture must be here."""


@dataclass(frozen=True, kw_only=True)
class SkyLabelMaps:
    """Label maps of one picture, by level; a level left out has the sky's label everywhere."""

    EXAMPLE: ClassVar = {"class": {"file": "overcast_labels.png", "values": {"7": "building"}}}

    KEYWORDS: ClassVar = {
        "propertyNames": {**NAME.keywords},
        "x-name": "level",
        "type": ["object", "null"],
        "additionalProperties": {
            "description": "The label map of a level.",
            "$ref": "#/$defs/sky_label_map",
        },
    }

    TITLE: ClassVar = "Label maps of a panorama"


@dataclass(frozen=True, kw_only=True)
class SkyNone:
    """A black sky, which can have labels all the same."""

    EXAMPLE: ClassVar = {"type": "none"}

    labels: Mapping[str, Any] = key(an("label_choice"), default={})
    """The sky's label; a level left out has label 0."""
    labels_below: Mapping[str, Any] = key(an("label_choice"), default={}, sparse=True)
    """The label of what lies below the horizontal plane through the camera and is no surface: the
    ground of the sky's picture. A level left out has the sky's label there."""


@dataclass(frozen=True, kw_only=True)
class SkyOvercast:
    """A sky behind one even layer of cloud: the CIE's standard overcast sky, three times as bright
    overhead as at the horizon, all around alike. light.sun is the sun above the cloud; what comes
    through of it makes the sky as bright as it is, and its beam is gone but behind thin cloud under
    a high sun.
    """

    EXAMPLE: ClassVar = {
        "type": "overcast",
        "optical_depth": {"type": "log_uniform", "min": 10, "max": 60},
    }

    optical_depth: Number = key(PER_SAMPLE, default=40, at_least=5, at_most=1000)
    """Of the cloud, straight down: 10 is bright, 40 usual, 100 the cloud of a thunderstorm."""
    irradiance: Number | None = key(
        PER_SAMPLE, optional=True, above=0, at_most=1_000_000_000_000, unit="W/m²"
    )
    """Diffuse irradiance on a horizontal surface, in place of what the cloud lets through of
    light.sun."""
    color: Any = key(COLOR, default=[0.92, 0.96, 1])
    """Color of the sky, relative. Not black."""
    ground_color: Any = key(GROUND_COLOR)
    resolution: int = key(COUNT, default=128, at_least=8, at_most=4096, unit="px")
    """Height of the lat-long picture that is made, in pixels; its width is twice that."""
    labels: Mapping[str, Any] = key(an("label_choice"), default={})
    """The sky's label; a level left out has label 0."""
    labels_below: Mapping[str, Any] = key(an("label_choice"), default={}, sparse=True)
    """The label of what lies below the horizontal plane through the camera and is no surface: the
    ground of the sky's picture. A level left out has the sky's label there."""


@dataclass(frozen=True, kw_only=True)
class Sun:
    """A disc far away."""

    EXAMPLE: ClassVar = {
        "elevation_deg": {"type": "uniform", "min": 15, "max": 60},
        "azimuth_deg": {"type": "uniform", "min": 0, "max": 360},
    }

    KEYWORDS: ClassVar = {"type": ["object", "null"]}

    irradiance: Number = key(
        PER_SAMPLE, default=1000, above=0, at_most=1_000_000_000_000, unit="W/m²"
    )
    """On a surface that faces the sun. With a sky of the type atmosphere: above the atmosphere, and
    if left out 1361 (Earth, Moon) or 590 (Mars). With an overcast one: above the cloud."""
    elevation_deg: Any = key(SUN_ELEVATION_DEG)
    azimuth_deg: Number = key(ANGLE_PER_SAMPLE, default=135, at_least=-100_000, at_most=100_000)
    """Compass bearing of the sun, clockwise from +Y (north)."""
    diameter_deg: Number = key(ANGLE_PER_SAMPLE, default=0.53, at_least=0, at_most=90)
    """Angular diameter. With a sky of the type atmosphere on Mars: if left out, 0.35."""
    color: Any = key(COLOR, default=[1, 0.94, 0.86])
    """Color, scaled so that the irradiance is as said; not black. With a sky of the type
    atmosphere, a factor on the color of sunlight: if left out, none."""
