"""Follows rays through clouds: what they hide, and the light of sun, sky and ground they scatter.

Along a ray through cumulus the light that a point scatters toward the eye is that of the
delta-Eddington approximation (Joseph, Wiscombe and Weinman 1976) in the slab that a point finds
itself in: it lies so deep below the sunlit side, and so far above the other, as the optical depths
toward the sun and away from it say. The sun falls on that side as obliquely as the depth straight
up is smaller than the one toward the sun: on the top of a cloud as it stands, on its flanks
upright. What is scattered once or by the forward peak alone has its own lobes, which is the bright
edge of a cloud before the sun.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.arithmetic import elementary
from scenec.compiler.light.cloud_fields import (
    Cirrus,
    Cumulus,
    cirrus_depth_at,
    density_at,
    dome,
    rise_at,
)
from scenec.schemas.kernels import inlined, kernel

#: Mean cosines of what droplets and ice scatter (Hu and Stamnes 1993; Baran 2012).
_DROPLETS, _ICE = 0.85, 0.76
_LOG_DROPLETS = elementary.log(_DROPLETS)
_PLANET_M = 6.371e6
#: Extinction of clear air at the ground by color, 1/m, and over which height it falls by 1/e.
_AIR = (2.6e-5, 3.3e-5, 5.3e-5)
_AIR_M = 8000.0
#: Steps through a layer at its thinnest, and the most of a ray.
_STEPS, _MOST = 40, 700
#: Where it enters a cloud steps are so much shorter; after so many without any it has left it.
_FINE, _SEARCHED = 0.25, 4
#: A ray ends where less is left.
_OPAQUE = 0.02
#: Steps toward the sun and away from it; each is longer than the one before.
_SUNWARD, _BEYOND = 9, 5
_LONGER = 1.55
#: They end at the layer's, or after so many thicknesses.
_REACH = 6.0
#: Steps of the sun's own way through a layer.
_BEAM = 200
#: Optical depth beyond which a beam is followed no further: less than 1e-8 is left.
_DARK = 20.0


class Shine(NamedTuple):
    """Holds the light that falls on clouds.

    Attributes:
        to_sun: Unit vector, float64 [3].
        sun: Irradiance on what faces it, float64 [3], W/m^2.
        sky, ground: Mean radiance from above and from below, float64 [3], W/(m^2 sr).
    """

    to_sun: NDArray[np.float64]
    sun: NDArray[np.float64]
    sky: NDArray[np.float64]
    ground: NDArray[np.float64]


@inlined
def _henyey_greenstein(cosine: float, g: float) -> float:
    """Phase function, 1/sr."""
    below = 1.0 + g * g - 2.0 * g * cosine
    return (1.0 - g * g) / (4.0 * elementary.PI * below * np.sqrt(below))


@inlined
def _distance(height: float, sine: float) -> float:
    """Along a ray from the ground to a height, over a round planet, meters."""
    level = 1.0 - sine * sine
    return 2.0 * height / (sine + np.sqrt(sine * sine + 2.0 * level * height / _PLANET_M))


@kernel
def _depth_along(layer, at, way, steps):  # type: ignore[no-untyped-def]
    """Optical depth of a layer from a point (east, north, height) along a unit vector."""
    end = layer.base_m + layer.thickness_m if way[2] > 0.0 else layer.base_m
    rising = max(abs(way[2]), 1.0 / (_REACH * _REACH))
    reach = min(abs(end - at[2]) / rising, _REACH * layer.thickness_m)
    last = 1.0
    for _ in range(steps):
        last *= _LONGER
    length = reach * (_LONGER - 1.0) / (last - 1.0)
    along = 0.0
    depth = 0.0
    for _ in range(steps):
        t = along + 0.5 * length
        east, north = at[0] + t * way[0], at[1] + t * way[1]
        above = at[2] + t * way[2] - layer.base_m
        if above <= 0.0 or above >= layer.thickness_m:
            break
        rise = rise_at(layer, east, north)
        depth += length * density_at(layer, rise, east, north, above, 0.5 * length)
        along += length
        length *= _LONGER
    return depth * layer.extinction


@kernel
def _scattered(sunward, beyond, up, cosine):  # type: ignore[no-untyped-def]
    """Radiance that a point scatters a unit of extinction, under a beam of irradiance 1, 1/sr.

    Args:
        sunward, beyond: Optical depths toward the sun and away from it.
        up: Optical depth straight up.
        cosine: Of the angle by which light is turned.
    """
    g = _DROPLETS
    mu = min(max(up / max(sunward, 1e-6), 0.2), 1.0)
    # In terms of what would scatter evenly: (1 - g) of all depths, along the slab's normal.
    a = (1.0 - g) * sunward * mu
    b = a + (1.0 - g) * beyond * mu
    beam, last = elementary.exp(-a / mu), elementary.exp(-b / mu)
    flux = mu * (2.0 + 3.0 * mu + (2.0 - 3.0 * mu) * last) / (4.0 + 3.0 * b)
    mean = flux * (3.0 * (b - a) + 2.0) + mu * (3.0 * mu - 2.0) * last - 3.0 * mu * mu * beam
    onward = 3.0 * g * (flux - mu * beam) * cosine
    once = elementary.exp(-sunward)
    out = max(mean + onward, 0.0) / (4.0 * elementary.PI)
    out += _henyey_greenstein(cosine, g) * once
    # The lobe of the rest is as wide as after as many turns as there are free paths behind.
    turned = elementary.exp(_LOG_DROPLETS * (1.0 + sunward))
    return out + _henyey_greenstein(cosine, turned) * max(beam - once, 0.0)


@kernel
def through_cumulus(layer, shine, way, texel, out):  # type: ignore[no-untyped-def]
    """Follows a ray from the ground.

    Args:
        layer: The cumulus.
        shine: What shines on it.
        way: Unit vector, above the horizon.
        texel: Radians between rays.
        out: Where radiance goes, float64 [3].

    Returns:
        Share of the light from behind that is left, and mean distance of what hides it, meters.
    """
    out[:] = 0.0
    sine = way[2]
    start = _distance(layer.base_m, sine)
    end = _distance(layer.base_m + layer.thickness_m, sine)
    cosine = way[0] * shine.to_sun[0] + way[1] * shine.to_sun[1] + sine * shine.to_sun[2]
    back = -shine.to_sun
    coarse = max((end - start) / _MOST, max(layer.thickness_m / _STEPS, start * texel))
    at = np.empty(3)
    left, far, weight = 1.0, 0.0, 0.0
    t, step, empty = start, coarse, _SEARCHED + 1
    while t < end and left > _OPAQUE:
        middle = t + 0.5 * step
        at[0], at[1] = way[0] * middle, way[1] * middle
        at[2] = middle * sine + middle * middle * (1.0 - sine * sine) / (2.0 * _PLANET_M)
        above = at[2] - layer.base_m
        rise = rise_at(layer, at[0], at[1])
        density = 0.0
        if rise > -0.5:
            density = density_at(layer, rise, at[0], at[1], above, middle * texel)
        if density <= 0.0:
            t += step
            empty += 1
            if empty > _SEARCHED:
                step = coarse
            continue
        if empty > _SEARCHED:
            # Its edge is somewhere within this step: go over it again, finely.
            step, empty = _FINE * coarse, 0
            continue
        empty = 0
        depth = density * layer.extinction * step
        sunward = _depth_along(layer, at, shine.to_sun, _SUNWARD)
        beyond = _depth_along(layer, at, back, _BEYOND)
        top = layer.thickness_m * np.sqrt(max(dome(rise), 0.0))
        up = layer.extinction * max(top - above, 0.0)
        down = layer.extinction * above
        of_sun = _scattered(sunward, beyond, up, cosine)
        # Even light from above and below spreads by diffusion: half of it at the edges.
        of_sky = 0.5 / (1.0 + 0.75 * (1.0 - _DROPLETS) * up)
        of_ground = 0.5 / (1.0 + 0.75 * (1.0 - _DROPLETS) * down)
        passed = elementary.exp(-depth)
        hidden = left * (1.0 - passed)
        for c in range(3):
            source = of_sun * shine.sun[c] + of_sky * shine.sky[c] + of_ground * shine.ground[c]
            out[c] += hidden * source
        far += hidden * middle
        weight += hidden
        left *= passed
        t += step
        # The less is left to see, the longer the steps.
        step = min(_FINE / left, 1.0) * coarse
    if left <= _OPAQUE:
        # What would have followed is as what was seen last.
        out[:] = out / (1.0 - left)
        left = 0.0
    return left, far / weight if weight > 0.0 else start


@kernel
def through_cirrus(sheet, shine, way, out):  # type: ignore[no-untyped-def]
    """Traces a ray through a thin sheet, as ``through_cumulus``: single scattering, even light."""
    sine = way[2]
    far = _distance(sheet.height_m, sine)
    depth = cirrus_depth_at(sheet, way[0] * far, way[1] * far)
    # Over a round planet a level ray meets the sheet at an angle.
    slant = sine + far * (1.0 - sine * sine) / _PLANET_M
    passed = elementary.exp(-depth / slant)
    cosine = way[0] * shine.to_sun[0] + way[1] * shine.to_sun[1] + sine * shine.to_sun[2]
    lit = 0.0
    if shine.to_sun[2] > 0.0:
        lit = elementary.exp(-0.5 * depth / max(shine.to_sun[2], 0.05))
        lit *= 0.85 * _henyey_greenstein(cosine, _ICE) + 0.15 / (4.0 * elementary.PI)
    for c in range(3):
        even = 0.5 * (shine.sky[c] + shine.ground[c])
        out[c] = (1.0 - passed) * (lit * shine.sun[c] + even)
    return passed, far


@kernel
def _through_air(height, far, c):  # type: ignore[no-untyped-def]
    """Transmittance of clear air from the ground to a distance, in a color."""
    share = max(height, 1.0) / _AIR_M
    thin = (1.0 - elementary.exp(-share)) / share
    return elementary.exp(-_AIR[c] * far * thin)


@kernel
def draw_rows(first, last, turned, cumulus, cirrus, shine, picture):  # type: ignore[no-untyped-def]
    """Draws clouds over a picture's rows above the horizon.

    What lies between eye and cloud is clear air, of which as much shows as its own light has in
    the sky behind.

    Args:
        turned: Unit vectors of the texels, in the world, float64 [rows, w, 3].
        cumulus, cirrus: The layers; those of no extinction are left out.
        shine: What shines on them.
        picture: The sky, float64 [h, w, 3].
    """
    texel = elementary.PI / len(picture)
    color = np.empty(3)
    for j in range(first, last):
        for i in range(picture.shape[1]):
            way = turned[j, i]
            if cirrus.depth > 0.0:
                left, far = through_cirrus(cirrus, shine, way, color)
                if left < 1.0:
                    for c in range(3):
                        air = _through_air(cirrus.height_m, far, c)
                        behind = picture[j, i, c] * (1.0 - air * (1.0 - left))
                        picture[j, i, c] = behind + air * color[c]
            if cumulus.extinction > 0.0:
                left, far = through_cumulus(cumulus, shine, way, texel, color)
                if left < 1.0:
                    for c in range(3):
                        air = _through_air(cumulus.base_m, far, c)
                        behind = picture[j, i, c] * (1.0 - air * (1.0 - left))
                        picture[j, i, c] = behind + air * color[c]


@kernel
def beam_left(way: NDArray, east: float, north: float, cumulus: Cumulus, cirrus: Cirrus) -> float:
    """Share of a beam from a direction above the horizon that reaches a place directly.

    Args:
        way: Unit vector to where it comes from.
        east, north: The place, at z = 0, meters.
        cumulus, cirrus: The layers.
    """
    depth = 0.0
    if cirrus.depth > 0.0:
        far = _distance(cirrus.height_m, way[2])
        slant = way[2] + far * (1.0 - way[2] * way[2]) / _PLANET_M
        depth += cirrus_depth_at(cirrus, east + way[0] * far, north + way[1] * far) / slant
    if cumulus.extinction > 0.0:
        start = _distance(cumulus.base_m, way[2])
        end = _distance(cumulus.base_m + cumulus.thickness_m, way[2])
        step = (end - start) / _BEAM
        bent = (1.0 - way[2] * way[2]) / (2.0 * _PLANET_M)
        for k in range(_BEAM):
            t = start + (k + 0.5) * step
            x, y = east + way[0] * t, north + way[1] * t
            above = t * way[2] + t * t * bent - cumulus.base_m
            rise = rise_at(cumulus, x, y)
            if rise > -0.5:
                density = density_at(cumulus, rise, x, y, above, 0.0)
                depth += density * cumulus.extinction * step
                if depth > _DARK:
                    break
    return elementary.exp(-depth)


@kernel
def beams_left(first, last, way, places, cumulus, cirrus, out):  # type: ignore[no-untyped-def]
    """``beam_left`` at places, float64 [n, 2], of some of them."""
    for k in range(first, last):
        out[k] = beam_left(way, places[k, 0], places[k, 1], cumulus, cirrus)
