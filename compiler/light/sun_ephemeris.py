"""Draws the sun of a place and a time, and the Earth over the Moon."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, ClassVar, Literal

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.distributions.numbers import Number
from scenec.compiler.kinds import Context, Finding, Node, bounded, forms, key
from scenec.compiler.light.suns import SunTrack, check_color, of_luminance_one
from scenec.schemas.errors import SceneError
from scenec.schemas.records import SolarTime
from scenec.schemas.spelling import shown

if TYPE_CHECKING:
    # A cfg is checked without what shines.
    from scenec.compiler.light.ephemeris import InSky, Overhead
    from scenec.compiler.scene.light import SunDisc

#: Irradiance of the Sun at 1 au, W/m^2 (Kopp and Lean 2011, Geophys. Res. Lett. 38:L01706).
SOLAR_IRRADIANCE = 1361.0
#: Times that are taken; within 1980 to 2050 errors are measured.
YEARS = (1900, 2100)
_TIME = f"a time in UTC of the years {YEARS[0]} to {YEARS[1]}, such as 2027-10-15T06:00:00Z"


@dataclass(frozen=True, kw_only=True)
class SunEphemeris:
    """The Sun at a place and a time, within 0.03°, without refraction; its diameter follows from
    its distance. Each sample is step_s later.
    """

    EXAMPLE: ClassVar = {
        "type": "ephemeris",
        "body": "moon",
        "latitude_deg": -89.5,
        "longitude_deg": 222,
        "time_utc": "2027-10-15T06:00:00Z",
        "step_s": 3600,
    }

    body: Literal["moon", "mars", "earth"] = key(forms.CHOICE)
    """On which the scene lies."""
    time_utc: str = key(forms.TEXT)
    """UTC of the first sample, ISO 8601: 2027-10-15T06:00:00Z. Years 1900 to 2100."""
    step_s: float = key(
        forms.CONSTANT, default=0, at_least=-1_000_000_000, at_most=1_000_000_000, unit="s"
    )
    """From one sample to the next."""
    offset_s: Number = key(
        forms.PER_SAMPLE, default=0, at_least=-1_000_000_000, at_most=1_000_000_000, unit="s"
    )
    """Added to the time; a distribution draws other hours."""
    latitude_deg: Number | None = key(
        forms.ANGLE_PER_SAMPLE, optional=True, at_least=-90, at_most=90
    )
    """Geodetic (planetographic) latitude of the scene, north positive. Left out with longitude_deg:
    the DEM's."""
    longitude_deg: Number | None = key(
        forms.ANGLE_PER_SAMPLE, optional=True, at_least=-360, at_most=360
    )
    """Longitude, east positive. With it +Y is north; at a pole, north is along this meridian."""
    irradiance: Number | None = key(
        bounded(forms.PER_SAMPLE, above=0, at_most=1_000_000_000_000, unit="W/m²"), optional=True
    )
    """On a surface facing the sun; above the atmosphere or the overcast cloud where there is one.
    Left out: 1361 W/m² over the squared distance in au."""
    color: Any = key(forms.COLOR, default=[1, 0.94, 0.86])
    """Color, scaled so that the irradiance is as said; not black. With an atmosphere sky, a factor
    on sunlight, left out none."""
    earthshine: bool = key(forms.TRUTH, default=False)
    """Whether the Earth shines on the Moon, too, from its true direction and phase: a further disc
    named Earth, as light.more's earthshine."""

    @staticmethod
    def check(node: Node) -> Iterator[Finding]:
        """Yields times that are none, places that are half there, and what other bodies have."""
        yield from check_color(node)
        if isinstance(node["time_utc"], str) and _parsed(node["time_utc"]) is None:
            yield node.fault(f"{shown(node['time_utc'])}: expected {_TIME}", "time_utc")
        given = [name in node for name in ("latitude_deg", "longitude_deg")]
        if given[0] != given[1]:
            yield node.fault("expected both of the keys latitude_deg and longitude_deg, or none")
        relief = node.whole().each("terrain", "relief", "*")
        if not any(given) and not any(step["type"] == "dem" for step in relief):
            yield node.fault("expected the keys latitude_deg and longitude_deg")
        body = node["body"]
        if node["earthshine"] and body in ("mars", "earth"):
            yield node.fault("the Earth shines on the Moon alone", "earthshine")
        sky = node.whole().at("light", "sky")
        planet = sky["planet"] if sky["type"] == "atmosphere" else None
        if body is not None and planet is not None and planet != body:
            yield node.fault(
                f"{shown(body)} has another sky than that of {planet} (light/sky/planet): expected "
                f"{shown(planet)}",
                "body",
            )

    def draw(self, context: Context) -> SunTrack:
        """Returns the sun at every sample, and the Earth; facts are lists over samples.

        Raises:
            SceneError: No place is given, and the terrain has none; or a time is out of range.
        """
        from scenec.compiler.light import ephemeris
        from scenec.compiler.light.earthshine import Earthshine, earthshine_irradiance

        drawn = context.sampled(self)
        latitudes, longitudes, axes = self._place(drawn, context)
        times = self._times(drawn["offset_s"])
        places = [*zip(latitudes.tolist(), longitudes.tolist(), strict=True)]
        radius = ephemeris.BODY_RADII_KM[self.body]

        def in_sky(over: list[Overhead]) -> list[InSky]:
            pairs = zip(over, places, strict=True)
            return [ephemeris.in_sky(at, north, east, radius) for at, (north, east) in pairs]

        def turned(found: list[InSky]) -> list[InSky]:
            return [replace(s, azimuth_deg=ephemeris.turned(s.azimuth_deg, axes)) for s in found]

        suns = [ephemeris.sun_over(self.body, time) for time in times]
        overhead = [one.overhead for one in suns]
        au = np.array([one.distance_km / ephemeris.AU_KM for one in overhead])
        given = drawn.get("irradiance", SOLAR_IRRADIANCE / (au * au))
        color = drawn.get("color", np.ones((context.samples, 3)))
        of_sun = in_sky(overhead)
        disc = _disc(turned(of_sun), ephemeris.SUN_RADIUS_KM, given, color)
        clocks = tuple(
            SolarTime(
                body=self.body,
                time_utc=f"{np.datetime_as_string(time, unit='ms')}Z",
                solar_time_h=ephemeris.solar_time_h(sun.overhead, east),
                mean_solar_time_h=ephemeris.mean_solar_time_h(sun, east),
                ls_deg=sun.ls_deg,
            )
            for time, sun, east in zip(times, suns, longitudes.tolist(), strict=True)
        )
        disc = replace(disc, times=clocks)
        facts: dict[str, Any] = {
            "body": self.body,
            "time_utc": [clock.time_utc for clock in clocks],
            "latitude_deg": latitudes.tolist(),
            "longitude_deg": longitudes.tolist(),
            **_facts(disc, of_sun, overhead),
            "distance_au": au.tolist(),
            "solar_time_h": [clock.solar_time_h for clock in clocks],
            "mean_solar_time_h": [clock.mean_solar_time_h for clock in clocks],
        }
        if self.body == "mars":
            facts["ls_deg"] = [clock.ls_deg for clock in clocks]
        if not self.earthshine:
            return SunTrack(disc, {}, facts)
        usual, earths = Earthshine(), [ephemeris.earth_over_moon(time) for time in times]
        phase = np.array([one.phase_deg for one in earths])
        of_earth = in_sky([one.overhead for one in earths])
        far = np.array([one.distance_km for one in of_earth])
        albedo = np.full(context.samples, usual.geometric_albedo)
        given = earthshine_irradiance(phase, SOLAR_IRRADIANCE / (au * au), albedo, far)
        color = np.tile(np.array(usual.color, np.float64), (context.samples, 1))
        earth = _disc(turned(of_earth), ephemeris.EARTH_RADIUS_KM, given, color)
        facts["earth"] = {
            **_facts(earth, of_earth, [one.overhead for one in earths]),
            "phase_deg": phase.tolist(),
            "irradiance": given.tolist(),
        }
        return SunTrack(disc, {"Earth": earth}, facts)

    def _place(
        self, drawn: dict[str, Any], context: Context
    ) -> tuple[NDArray[np.float64], NDArray[np.float64], tuple[float, float, float, float]]:
        """Latitudes and longitudes at every sample, and ``Georeference.east_north``."""
        if "latitude_deg" in drawn:
            return drawn["latitude_deg"], drawn["longitude_deg"], (1.0, 0.0, 0.0, 1.0)
        place = context.georeference()
        if place is None:
            raise SceneError(
                f"{context.path}: the terrain's DEM says no latitude and longitude: expected the "
                "keys latitude_deg and longitude_deg"
            )
        if place.body.lower() not in ("", self.body):
            raise SceneError(
                f"{context.path}/body: {shown(self.body)}: the terrain's DEM lies on "
                f"{place.body}: expected {shown(place.body.lower())}, or another place by "
                "latitude_deg and longitude_deg"
            )
        once = np.ones(context.samples)
        return place.latitude_deg * once, place.longitude_deg * once, place.east_north

    def _times(self, offset_s: NDArray[np.float64]) -> list[np.datetime64]:
        """The time of every sample, to the microsecond."""
        first, times = _parsed(self.time_utc), []
        assert first is not None, "a time that no check took"
        for i, offset in enumerate(offset_s.tolist()):
            seconds = i * self.step_s + offset
            # A thousand years; microseconds of more do not fit 64 bits.
            time = first + np.timedelta64(round(1e6 * min(max(seconds, -3e10), 3e10)), "us")
            if not _in_range(time):
                raise SceneError(
                    f"light/sun: sample {i} is {seconds:.17g} s after {self.time_utc}: expected "
                    f"{_TIME}"
                )
            times.append(time)
        return times


def _disc(
    seen: list[InSky], radius_km: float, irradiance: NDArray[np.float64], color: NDArray[np.float64]
) -> SunDisc:
    from scenec.compiler.light.ephemeris import diameter_deg
    from scenec.compiler.scene.light import SunDisc

    return SunDisc(
        azimuth_deg=np.array([one.azimuth_deg for one in seen]),
        elevation_deg=np.array([one.elevation_deg for one in seen]),
        irradiance=irradiance,
        diameter_deg=np.array([diameter_deg(radius_km, one.distance_km) for one in seen]),
        color=of_luminance_one(color),
    )


def _facts(disc: SunDisc, in_sky: list[InSky], overhead: list[Overhead]) -> dict[str, list[float]]:
    """Says where a disc stands, and over which place it is in the zenith."""
    return {
        "elevation_deg": disc.elevation_deg.tolist(),
        "azimuth_deg": disc.azimuth_deg.tolist(),
        "azimuth_from_north_deg": [one.azimuth_deg for one in in_sky],
        "diameter_deg": disc.diameter_deg.tolist(),
        "overhead_latitude_deg": [one.latitude_deg for one in overhead],
        "overhead_longitude_deg": [one.longitude_deg for one in overhead],
    }


def _parsed(text: str) -> np.datetime64 | None:
    """A time to the microsecond; None where it is none, or out of range."""
    if not re.fullmatch(r"\d{4}-\d\d-\d\dT\d\d:\d\d(:\d\d(\.\d{1,6})?)?Z?", text, re.ASCII):
        return None
    try:
        time = np.datetime64(text.removesuffix("Z"), "us")
    except ValueError:
        return None
    return time if _in_range(time) else None


def _in_range(time: np.datetime64) -> bool:
    first, last = (np.datetime64(f"{year}-01-01") for year in (YEARS[0], YEARS[1] + 1))
    return bool(first <= time < last)
