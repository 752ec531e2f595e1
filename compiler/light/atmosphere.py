"""Computes a planet's sky by single scattering, after Nishita et al. (1993), in physical units.

Sunlight is scattered once, by gas and aerosol, and lost to both and to an absorbing layer, along
the way from the sun and to the eye, at several wavelengths; the planet is a sphere, whose shadow
makes twilight. What is scattered twice or more, refraction, and the sun's size within the air are
left out. Pictures are baked with the sun at the bearing of 180 degrees, so that they are the same
on both sides of their middle and one serves every bearing.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.arithmetic import elementary
from scenec.compiler.light.atmosphere_columns import columns
from scenec.compiler.light.atmosphere_multiple import FarGround, Observer, bake_again, far_suns
from scenec.compiler.light.atmosphere_planets import AirMedium
from scenec.compiler.light.atmosphere_rays import (
    SightLine,
    aerosol_phase,
    angle_to_sun,
    cubic,
    gas_phase,
    gather,
    prepare,
    room,
)
from scenec.schemas.kernels import kernel
from scenec.schemas.threads import over_threads

#: Steps of a ray up or down.
STEPS = 32
#: Wavelengths.
WAVELENGTHS = 17
#: Bearings from the sun's to the opposite one at which rays are followed. Between them goes a
#: cubic: only phase functions change fast with the bearing, and those are exact.
BEARINGS = 33
#: The far ground lies at least so far below the eye, meters: from on the ground it would reach to
#: the horizon without air before it.
_EYE_M = 100.0
#: Rows of the picture that the horizon crosses are means over so many lines.
_LINES = 8
#: Of the light that the sky throws on far ground: heights of the sun, directions, steps.
_SUNS, _UP, _AROUND, _COARSE = 17, 12, 16, 16
#: Light for the ground is gathered over few directions, which no lobe may slip through.
_SHARPEST = 0.7


class _Air(NamedTuple):
    """An atmosphere.

    Attributes:
        sizes: ``Planet.sizes``.
        spectra: Gas, aerosol, loss by the aerosol, absorption, float64 [4, wavelengths].
        phase: ``AirMedium.phase``.
    """

    sizes: NDArray[np.float64]
    spectra: NDArray[np.float64]
    phase: NDArray[np.float64]


def bake(
    medium: AirMedium,
    weights: NDArray[np.float64],
    altitude_m: float,
    sun_elevation: float,
    ground_color: NDArray[np.float64],
    height: int,
    steps: int = STEPS,
    bearings: int = BEARINGS,
    multiple: bool = False,
) -> NDArray[np.float64]:
    """Radiance of a sky without the sun's disc, and of far ground below the horizon.

    The ground is a diffuse sphere of albedo ``ground_color`` under sun and sky, seen through the
    air before it. It lies at height 0, or 100 m below an observer who is lower than that.

    Args:
        weights: Of its wavelengths (``atmosphere_spectra.weights``), [wavelengths, 3].
        altitude_m: Of the observer, at least 0 and below the atmosphere's top.
        sun_elevation: Radians; the sun's bearing is 180 degrees.
        ground_color: Albedo, linear Rec.709, [3].
        height: Rows of the picture; it is twice as wide.
        steps: Of each ray up or down.
        bearings: At which rays are followed, 3 or more.
        multiple: Whether to add light that is scattered more than once (``atmosphere_multiple``).

    Returns:
        float64 [height, 2 * height, 3], 1/sr: radiance under sunlight whose irradiance above the
        atmosphere has the luminance 1. Never negative: colors outside of Rec.709 are clipped.
    """
    sizes = medium.planet.sizes()
    spectra = medium.spectra()
    r0 = sizes[0] + altitude_m
    ground = min(sizes[0], r0 - _EYE_M)
    sun = np.array([elementary.cos(sun_elevation), elementary.sin(sun_elevation)])
    look = Observer(r0, ground, sun, steps, weights)
    low, high = far_suns(look)
    skylight = np.empty((_SUNS, spectra.shape[1]))
    air = _Air(sizes, spectra, medium.phase)
    over_threads(_skylights, _SUNS, low, high, air, skylight)
    far = FarGround(low, high, skylight, ground_color)
    half = np.zeros((height, height, 3))
    over_threads(_rows, height, look, bearings, air, far, half)
    picture = np.concatenate([half, half[:, ::-1]], axis=1)
    if multiple:
        picture += bake_again(medium, look, ground_color, height)
    return picture


def direct(
    medium: AirMedium,
    weights: NDArray[np.float64],
    altitude_m: float,
    sun_elevation: float,
    diameter: float,
) -> NDArray[np.float64]:
    """Share of the sun's disc above the horizon times what the air leaves of its light.

    Args:
        medium, weights, altitude_m, sun_elevation: As for ``bake``.
        diameter: Of the sun, radians.

    Returns:
        Irradiance on a surface facing the sun where it is of luminance 1 above the atmosphere,
        linear Rec.709, [3].
    """
    sizes = medium.planet.sizes()
    r0 = sizes[0] + altitude_m
    dip = elementary.acos(min(sizes[0] / r0, 1.0))
    above = sun_elevation + dip
    seen = _disc_above(above, 0.5 * diameter)
    if seen == 0.0:
        return np.zeros(3)
    # What is seen of a setting disc lies at the horizon or above.
    gas, aerosol, layer = columns(r0, elementary.sin(max(sun_elevation, -dip)), sizes)
    depth = medium.gas * gas + medium.aerosol_loss * aerosol + medium.layer * layer
    rgb = (weights * elementary.exp_array(-depth)[:, None]).sum(axis=0)
    return np.maximum(rgb, 0.0) * seen


def _disc_above(center: float, radius: float) -> float:
    """Share of a disc above a line, its center so far above it."""
    if center >= radius:
        return 1.0
    if center <= -radius:
        return 0.0
    x = center / radius
    half_chord = np.sqrt((1.0 - x) * (1.0 + x))
    return float((elementary.acos(-x) + x * half_chord) / elementary.PI)


def zenith_depth(
    medium: AirMedium, altitude_m: float, nm: float, nodes: NDArray
) -> dict[str, float]:
    """Optical depth at a wavelength straight up from the observer, by what makes it."""
    sizes = medium.planet.sizes()
    gas, aerosol, layer = columns(sizes[0] + altitude_m, 1.0, sizes)
    parts = {"air": medium.gas * gas, "dust": medium.aerosol_loss * aerosol}
    parts["ozone"] = medium.layer * layer
    return {name: float(np.interp(nm, nodes, depth)) for name, depth in parts.items()}


@kernel
def _skylight(sun_sine: float, air: _Air) -> NDArray[np.float64]:
    """Irradiance of the sky on level ground over that of the sun, by wavelength."""
    sizes, spectra, phase = air
    wavelengths = spectra.shape[1]
    steps = room(_COARSE, wavelengths)
    of_gas, of_aerosol = np.empty(wavelengths), np.empty(wavelengths)
    total = np.zeros(wavelengths)
    sun_cosine = np.sqrt(max((1.0 - sun_sine) * (1.0 + sun_sine), 0.0))
    for j in range(_UP):
        sine = (j + 0.5) / _UP
        cosine = np.sqrt((1.0 - sine) * (1.0 + sine))
        count, _ = prepare(sizes[0], sine, cosine, sizes[0], sizes, spectra, steps)
        for i in range(_AROUND):
            bearing = elementary.PI * (i + 0.5) / _AROUND
            toward = cosine * sun_cosine * elementary.cos(bearing) + sine * sun_sine
            sight = SightLine(sizes[0], sine, toward, sun_sine)
            gather(count, sight, sizes, spectra, steps, of_gas, of_aerosol)
            solid_angle = 2.0 * elementary.PI / (_UP * _AROUND)
            for w in range(wavelengths):
                radiance = gas_phase(toward) * of_gas[w]
                radiance += aerosol_phase(toward, phase, w, _SHARPEST) * of_aerosol[w]
                total[w] += radiance * sine * solid_angle
    return total


@kernel
def _skylights(first: int, last: int, low: float, high: float, air: _Air, out: NDArray) -> None:
    for n in range(first, last):
        out[n] = _skylight(low + (high - low) * n / (_SUNS - 1), air)


@kernel
def _rows(
    first: int, last: int, look: Observer, bearings: int, air: _Air, far: FarGround, out: NDArray
) -> None:
    """The left half of the picture: bearings from 180 degrees off the sun to the sun."""
    r0, ground, sun, _, weights = look
    sizes, spectra, phase = air
    low, high, skylight, albedo = far
    wavelengths, height = spectra.shape[1], out.shape[0]
    horizon = elementary.acos(ground / r0)
    for row in range(first, last):
        steps = room(look.steps, wavelengths)
        of_gas, of_aerosol = np.empty((2, bearings, wavelengths))
        color = np.empty(3)
        upper = elementary.PI * (0.5 - row / height)
        crossed = upper > -horizon and upper - elementary.PI / height < -horizon
        lines = _LINES if crossed else 1
        for line in range(lines):
            elevation = upper - elementary.PI / height * (line + 0.5) / lines
            sine, cosine = elementary.sin(elevation), elementary.cos(elevation)
            count, hits = prepare(r0, sine, cosine, ground, sizes, spectra, steps)
            for n in range(bearings):
                toward = angle_to_sun(sine, cosine, n / (bearings - 1), sun)
                sight = SightLine(r0, sine, toward, sun[1])
                gather(count, sight, sizes, spectra, steps, of_gas[n], of_aerosol[n])
            for column in range(height):
                share = 1.0 - (column + 0.5) / height
                toward = angle_to_sun(sine, cosine, share, sun)
                place = share * (bearings - 1)
                near = min(int(place), bearings - 2)
                a, b, c, d = cubic(place - near)
                # Beyond the sun's meridian things repeat.
                before, after = abs(near - 1), bearings - 1 - abs(bearings - 3 - near)
                rayleigh = gas_phase(toward)
                color[:] = 0.0
                for w in range(wavelengths):
                    gas = a * of_gas[before, w] + b * of_gas[near, w]
                    gas += c * of_gas[near + 1, w] + d * of_gas[after, w]
                    aerosol = a * of_aerosol[before, w] + b * of_aerosol[near, w]
                    aerosol += c * of_aerosol[near + 1, w] + d * of_aerosol[after, w]
                    radiance = rayleigh * max(gas, 0.0)
                    radiance += aerosol_phase(toward, phase, w, 1.0) * max(aerosol, 0.0)
                    for i in range(3):
                        color[i] += weights[w, i] * radiance
                if hits:
                    sun_sine = (r0 * sun[1] + steps.t[count] * toward) / ground
                    color += albedo * _ground(
                        sun_sine, low, high, skylight, steps.arriving, sizes, spectra, weights
                    )
                for i in range(3):
                    out[row, column, i] += max(color[i], 0.0) / lines


@kernel
def _ground(sun_sine, low, high, skylight, arriving, sizes, spectra, weights):  # type: ignore[no-untyped-def]
    """Radiance of white ground as it arrives, linear Rec.709.

    Args:
        sun_sine: Of the sun's elevation over the ground that is seen.
        low, high, skylight: Light of the sky over that sine, evenly from low to high.
        arriving: Transmission of the air between.
        sizes, spectra: As in ``_Air``.
        weights: Of the wavelengths, [wavelengths, 3].
    """
    place = 0.0
    if high > low:
        place = min(max((sun_sine - low) / (high - low), 0.0), 1.0) * (len(skylight) - 1)
    first = min(int(place), len(skylight) - 2)
    gas, aerosol, layer = columns(sizes[0], min(max(sun_sine, 0.0), 1.0), sizes)
    color = np.zeros(3)
    for w in range(len(arriving)):
        light = skylight[first, w] + (place - first) * (skylight[first + 1, w] - skylight[first, w])
        if sun_sine > 0.0:
            depth = (spectra[0, w] * gas + spectra[2, w] * aerosol) + spectra[3, w] * layer
            light += sun_sine * elementary.exp(-depth)
        for c in range(3):
            color[c] += weights[w, c] * arriving[w] * light / elementary.PI
    return color
