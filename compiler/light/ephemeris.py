"""Computes where the Sun stands over places on Earth, Moon and Mars, and the Earth over the Moon.

Earth: the Sun's apparent place and sidereal time after Meeus 1998 (Astronomical Algorithms, 2nd
ed., ch. 12 and 25), with aberration and the largest term of nutation. Moon: its place after ch. 47,
cut off at 0.004 degrees, and selenographic places of Sun and Earth after ch. 53 with optical and
physical librations, cut off at 0.001 degrees. Mars: Allison and McEwen 2000 (Planet. Space Sci.
48:215) with the corrections of Mars24. Perturbations by planets but for those of Mars, polar motion
and refraction are left out, and UT1 is UTC. Angles are in degrees here.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np

from scenec.compiler.arithmetic import elementary

AU_KM = 149_597_870.7
SUN_RADIUS_KM = 695_700.0
EARTH_RADIUS_KM = 6371.0
#: Mean radii (IAU 2015), by which a place is off its body's center.
BODY_RADII_KM = {"earth": EARTH_RADIUS_KM, "moon": 1737.4, "mars": 3389.5}
#: Seconds of light on the way from the Sun, as degrees that the Earth goes on.
_ABERRATION = 0.00569
_J2000 = np.datetime64("2000-01-01T12:00:00")
#: Months with whose first day TAI - UTC became a second more than the 10 of 1972 (IERS Bulletin C).
_LEAPS = np.array(
    # A list by month, as the bulletins have it.
    (  # noqa: SIM905
        "1972-07 1973-01 1974-01 1975-01 1976-01 1977-01 1978-01 1979-01 1980-01 1981-07 1982-07 "
        "1983-07 1985-07 1988-01 1990-01 1991-01 1992-07 1993-07 1994-07 1996-01 1997-07 1999-01 "
        "2006-01 2009-01 2012-07 2015-07 2017-01"
    ).split(),
    "datetime64[M]",
)
#: Of the Moon's place: multiples of D, M, M', F; degrees of sin in longitude; kilometers of cos.
_LONGITUDE = (
    (0, 0, 1, 0, 6.288774, -20905.4), (2, 0, -1, 0, 1.274027, -3699.1),
    (2, 0, 0, 0, 0.658314, -2956.0), (0, 0, 2, 0, 0.213618, -569.9),
    (0, 1, 0, 0, -0.185116, 48.9), (0, 0, 0, 2, -0.114332, -3.1), (2, 0, -2, 0, 0.058793, 246.2),
    (2, -1, -1, 0, 0.057066, -152.1), (2, 0, 1, 0, 0.053322, -170.7),
    (2, -1, 0, 0, 0.045758, -204.6), (0, 1, -1, 0, -0.040923, -129.6),
    (1, 0, 0, 0, -0.034720, 108.7), (0, 1, 1, 0, -0.030383, 104.8), (2, 0, 0, -2, 0.015327, 10.3),
    (0, 0, 1, 2, -0.012528, 0.0), (0, 0, 1, -2, 0.010980, 79.7), (4, 0, -1, 0, 0.010675, -34.8),
    (0, 0, 3, 0, 0.010034, -23.2), (4, 0, -2, 0, 0.008548, -21.6), (2, 1, -1, 0, -0.007888, 24.2),
    (2, 1, 0, 0, -0.006766, 30.8), (1, 0, -1, 0, -0.005163, -8.4), (1, 1, 0, 0, 0.004987, -16.7),
    (2, -1, 1, 0, 0.004036, -12.8),
)  # fmt: skip
#: The same of its latitude.
_LATITUDE = (
    (0, 0, 0, 1, 5.128122), (0, 0, 1, 1, 0.280602), (0, 0, 1, -1, 0.277693),
    (2, 0, 0, -1, 0.173237), (2, 0, -1, 1, 0.055413), (2, 0, -1, -1, 0.046271),
    (2, 0, 0, 1, 0.032573), (0, 0, 2, 1, 0.017198), (2, 0, 1, -1, 0.009266),
    (0, 0, 2, -1, 0.008822), (2, -1, 0, -1, 0.008216), (2, 0, -2, -1, 0.004324),
    (2, 0, 1, 1, 0.004200),
)  # fmt: skip
#: Inclination of the Moon's mean equator to the ecliptic.
_MOON_TILT = 1.54242
#: Of the Sun seen from Mars: degrees, period in years, phase.
_MARS_PERTURBERS = (
    (0.0071, 2.2353, 49.409), (0.0057, 2.7543, 168.173), (0.0039, 1.1177, 191.837),
    (0.0037, 15.7866, 21.736), (0.0021, 2.1354, 15.704), (0.0020, 2.4694, 95.528),
    (0.0018, 32.8493, 49.095),
)  # fmt: skip


@dataclass(frozen=True)
class Overhead:
    """A place on a body that has another body in its zenith.

    Attributes:
        latitude_deg, longitude_deg: Of the line of centers: its declination, and east.
        distance_km: Of the centers.
    """

    latitude_deg: float
    longitude_deg: float
    distance_km: float


@dataclass(frozen=True)
class InSky:
    """Where a body stands over a place, azimuth clockwise from north, and how far it is."""

    elevation_deg: float
    azimuth_deg: float
    distance_km: float


@dataclass(frozen=True)
class SunOverBody:
    """Where the Sun is, and what its time is called.

    Attributes:
        overhead: The place below it.
        ls_deg: Areocentric longitude of the Sun, Mars's season; None elsewhere.
        mean_time_h: Mean solar time at longitude 0: UT of Earth, MTC of Mars; of the Moon by its
            mean elongation D, that of a mean sun over longitude 180 - D.
    """

    overhead: Overhead
    mean_time_h: float
    ls_deg: float | None = None


@dataclass(frozen=True)
class EarthOverMoon:
    """Where the Earth is in the lunar sky; the phase angle is that at it between Sun and Moon."""

    overhead: Overhead
    phase_deg: float


def days_since_j2000(time: np.datetime64) -> tuple[float, float]:
    """Returns days of universal and of terrestrial time since noon of 2000-01-01.

    TT - UTC is 32.184 s, 10 s and the leap seconds since 1972; after the last one known none is
    added, before 1972 none is taken away.
    """
    days = float((time - _J2000) / np.timedelta64(1, "s")) / 86400.0
    leaps = int(np.searchsorted(_LEAPS, time.astype("datetime64[M]"), side="right"))
    return days, days + (42.184 + leaps) / 86400.0


def sun_over(body: str, time: np.datetime64) -> SunOverBody:
    """Returns where the Sun is over a body (of ``BODY_RADII_KM``) at a time, UTC."""
    ut, tt = days_since_j2000(time)
    return _SUNS[body](ut, tt)


def in_sky(seen: Overhead, latitude_deg: float, longitude_deg: float, radius_km: float) -> InSky:
    """Returns where a body stands over a place.

    At a pole, north is the way along the meridian of the longitude that is given.

    Args:
        latitude_deg: Of the vertical: geodetic.
        radius_km: Of the body on which the place is: parallax is that of a sphere.
    """
    hour = seen.longitude_deg - longitude_deg
    east = _cos(seen.latitude_deg) * _sin(hour)
    toward = _cos(seen.latitude_deg) * _cos(hour)
    above = _sin(seen.latitude_deg)
    sine, cosine = _sin(latitude_deg), _cos(latitude_deg)
    north = above * cosine - toward * sine
    up = above * sine + toward * cosine - radius_km / seen.distance_km
    level = _norm(east, north)
    distance = seen.distance_km * _norm(level, up)
    return InSky(_atan2(up, level), _turn(_atan2(east, north)), distance)


def solar_time_h(sun: Overhead, longitude_deg: float) -> float:
    """Returns the true solar time of a place: 12 at noon, in twenty-fourths of its day."""
    return _turn(longitude_deg - sun.longitude_deg + 180.0) / 15.0


def mean_solar_time_h(sun: SunOverBody, longitude_deg: float) -> float:
    """Returns the mean solar time of a place: that of a sun that goes evenly."""
    return _turn(15.0 * sun.mean_time_h + longitude_deg) / 15.0


def turned(azimuth_deg: float, east_north: tuple[float, float, float, float]) -> float:
    """Returns the bearing from +y of an azimuth from north.

    Args:
        east_north: As in ``Georeference``.
    """
    (ex, ey, nx, ny), east, north = east_north, _sin(azimuth_deg), _cos(azimuth_deg)
    sign = 1.0 if ex * ny - ey * nx > 0.0 else -1.0
    return _turn(_atan2(sign * (ny * east - ey * north), sign * (ex * north - nx * east)))


def diameter_deg(radius_km: float, distance_km: float) -> float:
    """Returns the angle that a ball spans."""
    ratio = radius_km / distance_km
    return 2.0 * _atan2(ratio, float(np.sqrt(1.0 - ratio * ratio)))


def _sun_of_earth(ut: float, tt: float) -> SunOverBody:
    t = tt / 36525.0
    longitude, distance = _solar_longitude(t)
    node = 125.04 - 1934.136 * t
    nutation = -0.00478 * _sin(node)
    longitude += nutation - _ABERRATION
    tilt = 23.439291 - 0.0130042 * t + 0.00256 * _cos(node)
    x, y, z = _cos(longitude), _sin(longitude) * _cos(tilt), _sin(longitude) * _sin(tilt)
    of_ut = ut / 36525.0
    sidereal = 280.46061837 + 360.98564736629 * ut + 0.000387933 * of_ut * of_ut
    east = _turn(_atan2(y, x) - (sidereal + nutation * _cos(tilt)))
    declination = _atan2(z, _norm(x, y))
    mean_time = 24.0 * (ut + 0.5 - float(np.floor(ut + 0.5)))
    return SunOverBody(Overhead(declination, east, distance * AU_KM), mean_time)


def _solar_longitude(t: float) -> tuple[float, float]:
    """The Sun's true longitude, of the mean equinox of date, and its distance in au."""
    mean = 280.46646 + 36000.76983 * t + 0.0003032 * t * t
    anomaly = 357.52911 + 35999.05029 * t - 0.0001537 * t * t
    center = (1.914602 - 0.004817 * t - 0.000014 * t * t) * _sin(anomaly)
    center += (0.019993 - 0.000101 * t) * _sin(2.0 * anomaly) + 0.000289 * _sin(3.0 * anomaly)
    e = 0.016708634 - 0.000042037 * t - 0.0000001267 * t * t
    distance = 1.000001018 * (1.0 - e * e) / (1.0 + e * _cos(anomaly + center))
    return mean + center, distance


@dataclass(frozen=True)
class _Moon:
    """The Moon's place, of the mean equinox of date, and the arguments that it is made of."""

    longitude: float
    latitude: float
    distance_km: float
    d: float
    m: float
    mp: float
    f: float
    node: float
    e: float


def _moon(t: float) -> _Moon:
    mean = 218.3164477 + 481267.88123421 * t - 0.0015786 * t * t
    d = 297.8501921 + 445267.1114034 * t - 0.0018819 * t * t
    m = 357.5291092 + 35999.0502909 * t - 0.0001536 * t * t
    mp = 134.9633964 + 477198.8675055 * t + 0.0087414 * t * t
    f = 93.2720950 + 483202.0175233 * t - 0.0036539 * t * t
    node = 125.0445479 - 1934.1362891 * t + 0.0020754 * t * t
    e = 1.0 - 0.002516 * t - 0.0000074 * t * t
    longitude, latitude, distance = mean, 0.0, 385000.56
    for a, b, c, g, degrees, kilometers in _LONGITUDE:
        angle, factor = a * d + b * m + c * mp + g * f, e if b else 1.0
        longitude += degrees * factor * _sin(angle)
        distance += kilometers * factor * _cos(angle)
    for a, b, c, g, degrees in _LATITUDE:
        latitude += degrees * (e if b else 1.0) * _sin(a * d + b * m + c * mp + g * f)
    return _Moon(longitude, latitude, distance, d, m, mp, f, node, e)


def _sun_of_moon(ut: float, tt: float) -> SunOverBody:
    t = tt / 36525.0
    moon = _moon(t)
    sun, distance = _solar_longitude(t)
    away = distance * AU_KM
    # The Earth's place as the Sun sees it, and the Moon's beside it.
    x = away + moon.distance_km * _cos(moon.latitude) * _cos(moon.longitude - sun - 180.0)
    y = moon.distance_km * _cos(moon.latitude) * _sin(moon.longitude - sun - 180.0)
    z = moon.distance_km * _sin(moon.latitude)
    level = _norm(x, y)
    longitude = sun + 180.0 - _ABERRATION + _atan2(y, x)
    below = _selenographic(moon, t, longitude, _atan2(z, level))
    return SunOverBody(replace(below, distance_km=_norm(level, z)), _turn(moon.d) / 15.0)


def earth_over_moon(time: np.datetime64) -> EarthOverMoon:
    """Returns where the Earth is over the Moon at a time, UTC, and its phase."""
    t = days_since_j2000(time)[1] / 36525.0
    moon = _moon(t)
    sun, _ = _solar_longitude(t)
    cosine = _cos(moon.latitude) * _cos(moon.longitude - sun)
    sine = float(np.sqrt(max((1.0 - cosine) * (1.0 + cosine), 0.0)))
    overhead = _selenographic(moon, t, moon.longitude, moon.latitude)
    return EarthOverMoon(overhead, _atan2(sine, cosine))


def _selenographic(moon: _Moon, t: float, longitude: float, latitude: float) -> Overhead:
    """The place on the Moon below a body, from which it is seen at an ecliptic place."""
    d, m, mp, f = moon.d, moon.m, moon.mp, moon.f
    w = longitude - moon.node
    x, y, z = _cos(w) * _cos(latitude), _sin(w) * _cos(latitude), _sin(latitude)
    a = _atan2(y * _cos(_MOON_TILT) - z * _sin(_MOON_TILT), x)
    up = -y * _sin(_MOON_TILT) - z * _cos(_MOON_TILT)
    b = _atan2(up, float(np.sqrt(max((1.0 - up) * (1.0 + up), 0.0))))
    # Without the terms in the sine and cosine of F alone, which tilt the mean axes of maps by 80
    # arc seconds to the principal ones.
    rho = -0.02752 * _cos(mp) + 0.00684 * _cos(mp - 2.0 * f) - 0.00293 * _cos(2.0 * f)
    sigma = -0.02816 * _sin(mp) - 0.00682 * _sin(mp - 2.0 * f) - 0.00279 * _sin(2.0 * f)
    tau = 0.02520 * moon.e * _sin(m) + 0.00473 * _sin(2.0 * (mp - f)) - 0.00467 * _sin(mp)
    tau += 0.00396 * _sin(119.75 + 131.849 * t) + 0.00276 * _sin(2.0 * (mp - d))
    tau += 0.00196 * _sin(moon.node) - 0.00183 * _cos(mp - f) + 0.00115 * _sin(mp - 2.0 * d)
    libration = -tau + (rho * _cos(a) + sigma * _sin(a)) * (_sin(b) / _cos(b))
    nodding = sigma * _cos(a) - rho * _sin(a)
    return Overhead(b + nodding, _turn(a - f + libration), moon.distance_km)


def _sun_of_mars(ut: float, tt: float) -> SunOverBody:
    anomaly = 19.3871 + 0.52402073 * tt
    fictitious = 270.3871 + 0.524038496 * tt
    center = (10.691 + 3.0e-7 * tt) * _sin(anomaly) + 0.623 * _sin(2.0 * anomaly)
    center += 0.050 * _sin(3.0 * anomaly) + 0.005 * _sin(4.0 * anomaly)
    center += 0.0005 * _sin(5.0 * anomaly)
    center += _sum(a * _cos(0.985626 * tt / tau + phi) for a, tau, phi in _MARS_PERTURBERS)
    ls = _turn(fictitious + center)
    equation = 2.861 * _sin(2.0 * ls) - 0.071 * _sin(4.0 * ls) + 0.002 * _sin(6.0 * ls) - center
    sols = (tt - 4.5) / 1.0274912517 + 44796.0 - 0.0009626
    mean_time = 24.0 * (sols - float(np.floor(sols)))
    sine = 0.42565 * _sin(ls)
    # Mars24 adds 0.25 sin(ls): the latitude of a vertical where the line of centers meets the
    # ground, which is not the direction of the Sun.
    declination = _atan2(sine, float(np.sqrt((1.0 - sine) * (1.0 + sine))))
    distance = 1.00436 - 0.09309 * _cos(anomaly) - 0.004336 * _cos(2.0 * anomaly)
    distance -= 0.00031 * _cos(3.0 * anomaly) + 0.00003 * _cos(4.0 * anomaly)
    west = mean_time * 15.0 + equation + 180.0
    return SunOverBody(
        Overhead(declination, _turn(-west), 1.52367934 * distance * AU_KM), mean_time, ls
    )


_SUNS = {"earth": _sun_of_earth, "moon": _sun_of_moon, "mars": _sun_of_mars}


def _norm(x: float, y: float) -> float:
    return float(np.sqrt(x * x + y * y))


def _sum(terms: Iterable[float]) -> float:
    total = 0.0
    for term in terms:
        total += term
    return total


def _turn(degrees: float) -> float:
    """The same direction in [0, 360)."""
    turned = degrees - 360.0 * float(np.floor(degrees / 360.0))
    return turned if turned < 360.0 else 0.0


def _sin(degrees: float) -> float:
    return float(elementary.sin(_turn(degrees) * (elementary.PI / 180.0)))


def _cos(degrees: float) -> float:
    return float(elementary.cos(_turn(degrees) * (elementary.PI / 180.0)))


def _atan2(y: float, x: float) -> float:
    return float(elementary.atan2(y, x)) * (180.0 / elementary.PI)
