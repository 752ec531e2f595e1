"""Integrates light that an atmosphere scatters once into a ray, by wavelength.

A ray is cut into steps whose ends have exact columns behind them (``atmosphere_columns``). Within a
step only the sunlight's own loss is taken to be even, so that what scatters is exact however thick
or thin the medium is, and never more than what arrives. ``sizes`` are ``Planet.sizes``.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.arithmetic import elementary
from scenec.compiler.light.atmosphere_columns import columns_along, columns_up
from scenec.schemas.kernels import inlined, kernel

#: Steps go with height - lowest height ~ u^2: even in distance along the horizon, finer below than
#: above in the vertical.
_INV_PI = 1.0 / elementary.PI


class SightLine(NamedTuple):
    """A ray, and where the sun is.

    Attributes:
        r0: The observer's distance from the planet's center.
        sine: Of the ray's elevation.
        toward: Cosine between the ray and the direction to the sun.
        sun_sine: Of the sun's elevation.
    """

    r0: float
    sine: float
    toward: float
    sun_sine: float


class Steps(NamedTuple):
    """Holds a ray's steps, for any direction of the sun; ``prepare`` fills it.

    Attributes:
        t: Their ends, distances from the observer, float64 [2 * steps + 1].
        middle: Their middles, float64 [2 * steps].
        scattered: What gas and aerosol of each would send to the observer under full sunlight and a
            phase function of 1, float64 [2, 2 * steps, wavelengths].
        arriving: Transmission of the whole ray, float64 [wavelengths].
        suns: Room for what is noted of each step under a sun, float64 [6, 2 * steps].
        light: Room for a spectrum, float64 [wavelengths].
    """

    t: NDArray[np.float64]
    middle: NDArray[np.float64]
    scattered: NDArray[np.float64]
    arriving: NDArray[np.float64]
    suns: NDArray[np.float64]
    light: NDArray[np.float64]


@kernel
def room(steps: int, wavelengths: int) -> Steps:
    """Room for a ray that goes down and up again in so many steps each."""
    scattered, arriving = np.empty((2, 2 * steps, wavelengths)), np.empty(wavelengths)
    suns, light = np.empty((6, 2 * steps)), np.empty(wavelengths)
    return Steps(np.empty(2 * steps + 1), np.empty(2 * steps), scattered, arriving, suns, light)


@kernel
def gas_phase(cosine: float) -> float:
    """Rayleigh's phase function, 1/sr."""
    return 3.0 / 16.0 * _INV_PI * (1.0 + cosine * cosine)


@kernel
def lobe(cosine: float, g: float) -> float:
    """Henyey and Greenstein's phase function, 1/sr."""
    width = 1.0 + g * g - 2.0 * g * cosine
    return 0.25 * _INV_PI * (1.0 - g * g) / (width * np.sqrt(width))


@kernel
def aerosol_phase(cosine: float, phase: NDArray, k: int, sharpest: float) -> float:
    """The aerosol's phase function at wavelength ``k``, 1/sr.

    Args:
        sharpest: g is taken to be at most this; 1 for as it is.
    """
    share, g = phase[0, k], min(phase[1, k], sharpest)
    forward = lobe(cosine, g)
    if phase[3, k] > 0.0:
        forward *= 1.5 * (1.0 + cosine * cosine) / (2.0 + g * g)
    if share >= 1.0:
        return forward
    return share * forward + (1.0 - share) * lobe(cosine, phase[2, k])


@kernel
def _mean_transmission(depth: float) -> float:
    """(1 - exp(-x)) / x."""
    if depth < 1e-3:
        return 1.0 - 0.5 * depth + depth * depth / 6.0
    return (1.0 - elementary.exp(-depth)) / depth


@kernel
def _climb(steps, first, count, closest, low, high, shift, down):  # type: ignore[no-untyped-def]
    """Step ends and middles of a piece of a ray between two heights, along which it only climbs.

    Fills ``t[first : first + count + 1]`` and ``middle[first : first + count]`` with distances from
    the observer, who is ``shift`` beyond the ray's closest point; on the way down in reverse.
    """
    t, middle = steps.t, steps.middle
    base = (low - closest) * (low + closest)
    for k in range(2 * count + 1):
        u = k / (2.0 * count)
        rise = (high - low) * u * u
        distance = np.sqrt(max(base + rise * (2.0 * low + rise), 0.0))
        place = (-distance if down else distance) - shift
        at = 2 * count - k if down else k
        if at % 2 == 0:
            t[first + at // 2] = place
        else:
            middle[first + at // 2] = place


@kernel
def prepare(r0, sine, cosine, ground, sizes, spectra, out):  # type: ignore[no-untyped-def]
    """Fills a ray's steps, for any direction of the sun.

    Args:
        r0: The observer's distance from the planet's center.
        sine, cosine: Of the ray's elevation.
        ground: Radius of the ground that ends a ray.
        spectra: Gas, aerosol, loss by the aerosol, absorption, [4, wavelengths].

    Returns:
        Number of steps, and whether the ray ends on the ground.
    """
    t, middle, scattered, arriving = out.t, out.middle, out.scattered, out.arriving
    steps = len(middle) // 2
    closest = r0 * cosine
    shift = r0 * sine
    top = sizes[0] + sizes[1]
    hits = sine < 0.0 and closest < ground
    count = steps
    if hits:
        _climb(out, 0, steps, closest, ground, r0, shift, True)
    elif sine < 0.0:
        count = 2 * steps
        _climb(out, 0, steps, closest, closest, r0, shift, True)
        _climb(out, steps, steps, closest, closest, top, shift, False)
    else:
        _climb(out, 0, steps, closest, r0, top, shift, False)
    t[0] = 0.0
    wavelengths = spectra.shape[1]
    for w in range(wavelengths):
        arriving[w] = 1.0
    square = closest * closest
    past = (0.0, 0.0, 0.0)
    weight = 0.0
    half = wavelengths // 2
    for k in range(count + 1):
        along = t[k] + shift
        r = np.sqrt(square + along * along)
        here = columns_up(r, min(closest, r), min(abs(along) / r, 1.0), sizes)
        if k > 0:
            gas, aerosol, layer = (
                abs(here[0] - past[0]),
                abs(here[1] - past[1]),
                abs(here[2] - past[2]),
            )
            for w in range(wavelengths):
                depth = (spectra[0, w] * gas + spectra[2, w] * aerosol) + spectra[3, w] * layer
                share = arriving[w] * _mean_transmission(depth)
                scattered[0, k - 1, w] = share * spectra[0, w] * gas
                scattered[1, k - 1, w] = share * spectra[1, w] * aerosol
                arriving[w] *= elementary.exp(-depth)
        height = r - sizes[0]
        now = spectra[0, half] * elementary.exp(-height / sizes[2])
        now = arriving[half] * (now + spectra[1, half] * elementary.exp(-height / sizes[3]))
        if k > 0 and weight + now > 0.0:
            middle[k - 1] = t[k - 1] + (t[k] - t[k - 1]) * (weight + 2.0 * now) / (
                3.0 * (weight + now)
            )
        weight = now
        past = here
    return count, hits


@kernel
def shadow(sight: SightLine, radius: float) -> tuple[float, float]:
    """Distances between which a ray is in the planet's shadow; if never, the first is larger."""
    r0, sine, toward, sun_sine = sight
    # The shadow is a half cylinder: square distance from its axis below that of the planet.
    a = (1.0 - toward) * (1.0 + toward)
    b = r0 * (sine - sun_sine * toward)
    level = r0 * np.sqrt(max((1.0 - sun_sine) * (1.0 + sun_sine), 0.0))
    c = (level - radius) * (level + radius)
    if a < 1e-12:
        enter, leave = (-np.inf, np.inf) if c < 0.0 else (np.inf, -np.inf)
    else:
        inside = b * b - a * c
        if inside <= 0.0:
            return np.inf, -np.inf
        root = np.sqrt(inside)
        enter, leave = (-b - root) / a, (-b + root) / a
    along = r0 * sun_sine
    if abs(toward) < 1e-12:
        return (enter, leave) if along < 0.0 else (np.inf, -np.inf)
    edge = -along / toward
    if toward > 0.0:
        return enter, min(leave, edge)
    return max(enter, edge), leave


@kernel
def gather(count, sight, sizes, spectra, steps, of_gas, of_aerosol):  # type: ignore[no-untyped-def]
    """Sums what a prepared ray's steps send to the observer under the sun.

    Args:
        of_gas, of_aerosol: Receive radiance over phase function and sunlight, [wavelengths].
    """
    r0, sine, toward, sun_sine = sight
    t, middle, scattered = steps.t, steps.middle, steps.scattered
    for w in range(spectra.shape[1]):
        of_gas[w] = 0.0
        of_aerosol[w] = 0.0
    enter, leave = shadow(sight, sizes[0])
    # Step by step in passes, each a loop that has lanes.
    r, cosine, lit = steps.suns[0, :count], steps.suns[1, :count], steps.suns[2, :count]
    for k in range(count):
        start, end = t[k], t[k + 1]
        dark = min(end, leave) - max(start, enter)
        at, lit[k] = middle[k], 1.0
        if dark > 0.0:
            lit[k] = 1.0 - dark / (end - start)
            before, after = max(enter - start, 0.0), max(end - leave, 0.0)
            at = start + 0.5 * before if before >= after else end - 0.5 * after
        r[k] = np.sqrt(r0 * r0 + at * (2.0 * r0 * sine + at))
        cosine[k] = min(max((r0 * sun_sine + at * toward) / r[k], -1.0), 1.0)
    of = steps.suns[3, :count], steps.suns[4, :count], steps.suns[5, :count]
    columns_along(r, cosine, sizes, of[0], of[1], of[2])
    for k in range(count):
        if lit[k] <= 0.0:
            continue
        _dim(spectra, (of[0][k], of[1][k], of[2][k]), lit[k], steps.light)
        _add_product(steps.light, scattered[0, k], of_gas)
        _add_product(steps.light, scattered[1, k], of_aerosol)


@inlined
def _dim(spectra: NDArray, behind: tuple[float, float, float], lit: float, out: NDArray) -> None:
    """Sunlight behind columns of gas, aerosol and absorber, [wavelengths].

    Args:
        spectra: As of ``prepare``.
        behind: The columns.
        lit: Factor on it.
    """
    gas, loss, layer = spectra[0], spectra[2], spectra[3]
    for w in range(out.size):
        depth = (gas[w] * behind[0] + loss[w] * behind[1]) + layer[w] * behind[2]
        light = lit * elementary.exp(-depth)
        out[w] = 0.0 if depth > 80.0 else light


@inlined
def _add_product(one: NDArray, other: NDArray, out: NDArray) -> None:
    for w in range(out.size):
        out[w] += one[w] * other[w]


@kernel
def angle_to_sun(sine: float, cosine: float, bearing: float, sun: NDArray) -> float:
    """Cosine of the angle to the sun.

    Args:
        sine, cosine: Of the direction's elevation.
        bearing: From the sun's, in half turns.
        sun: Cosine and sine of its elevation.
    """
    toward = cosine * sun[0] * elementary.cos(elementary.PI * bearing) + sine * sun[1]
    return min(max(toward, -1.0), 1.0)


@kernel
def cubic(x: float) -> tuple[float, float, float, float]:
    """Weights of four values at -1, 0, 1, 2 for the point x in [0, 1], after Catmull and Rom."""
    y = 1.0 - x
    return (
        -0.5 * x * y * y,
        1.0 + x * x * (1.5 * x - 2.5),
        1.0 + y * y * (1.5 * y - 2.5),
        -0.5 * y * x * x,
    )
