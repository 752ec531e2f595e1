"""Adds what is scattered twice or more to a single-scattered sky: an approximation.

After Hillaire (2020, A Scalable and Production Ready Sky and Atmosphere Rendering Technique, EGSR):
light that has been scattered before arrives from all sides alike, and each further time the same
share of it is scattered again, so that the orders sum up to a geometric series, from a table over
height and the sun's. Forward lobes, which hardly scatter, are taken out first by the similarity
relation (van de Hulst 1980, ch. 14): coefficients are reduced by the mean cosine g of the phase
function and the rest is even. What the single-scattered sky lacks is then

- light scattered once in the reduced medium, less what of it the whole medium let through,
- in each place the reduced scattering times the table's light, and
- light scattered forward alone, n times with the chance exp(-x) x^n / n! where x is the depth of
  forward scattering along the way: orders from 2 on are (exp(x) - 1 - x) / x of the first, in a
  lobe whose mean cosine is the square of its own.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.arithmetic import elementary
from scenec.compiler.light.atmosphere_columns import columns
from scenec.compiler.light.atmosphere_planets import AirMedium
from scenec.compiler.light.atmosphere_rays import (
    SightLine,
    Steps,
    angle_to_sun,
    cubic,
    gather,
    lobe,
    prepare,
    room,
    shadow,
)
from scenec.compiler.light.atmosphere_spectra import wavelengths
from scenec.schemas.kernels import inlined, kernel
from scenec.schemas.threads import over_threads

#: Nodes of the table over height and the sun's elevation.
HEIGHTS, SUNS = 12, 25
#: Directions in which a node looks, up and around, and steps of each ray.
_UP, _AROUND, _STEPS = 12, 4, 16
#: Bearings from the sun's to the opposite one, heights of the sun over ground in sight, and lines
#: of a row that the horizon crosses.
_BEARINGS, _GROUND_SUNS, _LINES = 9, 9, 8
#: The sun's lowest elevation in the table, as a share of a right angle, squared: -22.5 degrees.
_LOWEST = -0.5
#: Optical depths beyond which nothing is left; sharpest mean cosine that few directions can show.
_DEEPEST, _SHARPEST = 80.0, 0.7
#: A share of light that is scattered again and again is less than this.
_MOST_AGAIN = 0.995


def mean_cosine(phase: NDArray[np.float64]) -> NDArray[np.float64]:
    """Mean cosine g of an aerosol's phase function (``AirMedium.phase``), [wavelengths].

    Of Cornette and Shanks' lobe: 3 g (4 + g^2) / (5 (2 + g^2)).
    """
    share, g, wide, shanks = phase
    square = g * g
    forward = np.where(shanks > 0.0, 0.6 * g * (4.0 + square) / (2.0 + square), g)
    return np.asarray(share * forward + (1.0 - share) * wide, np.float64)


def reduced(spectra: NDArray[np.float64], g: NDArray[np.float64]) -> NDArray[np.float64]:
    """Coefficients of a medium that scatters evenly, and like it at a distance.

    Args:
        spectra: Gas, aerosol, loss by the aerosol, absorption, [4, wavelengths].
    """
    gas, aerosol, loss, layer = spectra
    return np.stack([gas, aerosol * (1.0 - g), loss - aerosol * g, layer])


def spectral_albedo(nm: NDArray[np.float64], color: NDArray[np.float64]) -> NDArray[np.float64]:
    """A color's albedo at wavelengths: red's at 610 nm, green's at 550, blue's at 465."""
    return np.interp(nm, [465.0, 550.0, 610.0], color[::-1])


class Observer(NamedTuple):
    """An eye under a sky.

    Attributes:
        r0: Its distance from the planet's center.
        ground: Radius of the ground that is seen.
        sun: Cosine and sine of its elevation, [2].
        steps: Of each ray up or down.
        weights: Of the wavelengths, [wavelengths, 3].
    """

    r0: float
    ground: float
    sun: NDArray[np.float64]
    steps: int
    weights: NDArray[np.float64]


class Optics(NamedTuple):
    """An atmosphere, and what light that is scattered again needs of it.

    Attributes:
        sizes: ``Planet.sizes``.
        spectra, even: Coefficients of the medium and of the reduced one (``reduced``).
        g: The aerosol's mean cosine.
        phase: ``AirMedium.phase``.
        table: Of ``make_table``.
    """

    sizes: NDArray[np.float64]
    spectra: NDArray[np.float64]
    even: NDArray[np.float64]
    g: NDArray[np.float64]
    phase: NDArray[np.float64]
    table: NDArray[np.float64]


class FarGround(NamedTuple):
    """Light on the ground in sight.

    Attributes:
        low, high: Sines of the sun's elevation over it, least and greatest.
        light: At sines evenly between these, [n, wavelengths].
        albedo: Linear Rec.709, [3].
    """

    low: float
    high: float
    light: NDArray[np.float64]
    albedo: NDArray[np.float64]


def far_suns(look: Observer) -> tuple[float, float]:
    """Sines of the sun's elevation over ground in sight: up to the horizon's dip away."""
    horizon = elementary.acos(look.ground / look.r0)
    elevation = elementary.atan2(look.sun[1], look.sun[0])
    return (
        elementary.sin(max(elevation - horizon, -0.5 * elementary.PI)),
        elementary.sin(min(elevation + horizon, 0.5 * elementary.PI)),
    )


def make_table(
    sizes: NDArray[np.float64], spectra: NDArray[np.float64], albedo: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Light scattered twice or more, mean over all directions, by height and the sun's elevation.

    Args:
        albedo: Of the ground, [wavelengths].

    Returns:
        Radiance over the sun's irradiance, float64 [HEIGHTS, SUNS, wavelengths], 1/sr.
    """
    out = np.zeros((HEIGHTS, SUNS, spectra.shape[1]))
    over_threads(_table_part, HEIGHTS, sizes, spectra, albedo, out)
    return out


@kernel
def _table_part(
    first: int, last: int, sizes: NDArray, spectra: NDArray, albedo: NDArray, out: NDArray
) -> None:
    nodes = spectra.shape[1]
    for i in range(first, last):
        share = i / (HEIGHTS - 1.0)
        # Not on the ground itself: rays down would have no length.
        r0 = sizes[0] + max(sizes[1] * share * share * 0.9, 1.0)
        steps = room(_STEPS, nodes)
        of_gas, of_aerosol = np.empty(nodes), np.empty(nodes)
        again = np.zeros(nodes)
        for k in range(_UP):
            # Even in solid angle, on both sides of the horizon.
            sine = (k + 0.5) / _UP * 2.0 - 1.0
            cosine = np.sqrt((1.0 - sine) * (1.0 + sine))
            count, hits = prepare(r0, sine, cosine, sizes[0], sizes, spectra, steps)
            for n in range(count):
                for w in range(nodes):
                    again[w] += (steps.scattered[0, n, w] + steps.scattered[1, n, w]) / _UP
            for j in range(SUNS):
                sun_sine, sun_cosine = _sun_of(j)
                for a in range(_AROUND):
                    bearing = elementary.PI * (a + 0.5) / _AROUND
                    toward = cosine * sun_cosine * elementary.cos(bearing) + sine * sun_sine
                    sight = SightLine(r0, sine, toward, sun_sine)
                    gather(count, sight, sizes, spectra, steps, of_gas, of_aerosol)
                    for w in range(nodes):
                        light = 0.25 / elementary.PI * (of_gas[w] + of_aerosol[w])
                        out[i, j, w] += light / (_UP * _AROUND)
                    if hits:
                        on_ground = (r0 * sun_sine + steps.t[count] * toward) / sizes[0]
                        if on_ground > 0.0:
                            gas, aerosol, layer = columns(sizes[0], min(on_ground, 1.0), sizes)
                            for w in range(nodes):
                                depth = spectra[0, w] * gas + spectra[2, w] * aerosol
                                depth += spectra[3, w] * layer
                                light = albedo[w] / elementary.PI * on_ground * steps.arriving[w]
                                light *= elementary.exp(-depth)
                                out[i, j, w] += light / (_UP * _AROUND)
        for j in range(SUNS):
            for w in range(nodes):
                out[i, j, w] /= 1.0 - min(again[w], _MOST_AGAIN)


@kernel
def _sun_of(j: int) -> tuple[float, float]:
    """Sine and cosine of the sun's elevation at a node: denser about the horizon."""
    s = _LOWEST + (1.0 - _LOWEST) * j / (SUNS - 1.0)
    elevation = 0.5 * elementary.PI * s * abs(s)
    return elementary.sin(elevation), elementary.cos(elevation)


@kernel
def add_again(
    count: int, sight: SightLine, sizes: NDArray, table: NDArray, steps: Steps, total: NDArray
) -> None:
    """Adds what a prepared ray of the reduced medium sends of the table's light, [wavelengths].

    Args:
        steps: Of ``prepare`` in the reduced medium.
    """
    r0, sine, toward, sun_sine = sight
    middle, scattered = steps.middle, steps.scattered
    for k in range(count):
        at = middle[k]
        r = np.sqrt(r0 * r0 + at * (2.0 * r0 * sine + at))
        up = min(max((r - sizes[0]) / (0.9 * sizes[1]), 0.0), 1.0)
        y = np.sqrt(up) * (HEIGHTS - 1.0)
        i = min(int(y), HEIGHTS - 2)
        y -= i
        here = min(max((r0 * sun_sine + at * toward) / r, -1.0), 1.0)
        elevation = elementary.asin(here) / (0.5 * elementary.PI)
        s = np.sqrt(abs(elevation))
        x = ((s if elevation >= 0.0 else -s) - _LOWEST) / (1.0 - _LOWEST) * (SUNS - 1.0)
        if x <= 0.0:
            continue
        j = min(int(x), SUNS - 2)
        x = min(x - j, 1.0)
        for w in range(table.shape[2]):
            low = table[i, j, w] + x * (table[i, j + 1, w] - table[i, j, w])
            high = table[i + 1, j, w] + x * (table[i + 1, j + 1, w] - table[i + 1, j, w])
            total[w] += (scattered[0, k, w] + scattered[1, k, w]) * (low + y * (high - low))


def bake_again(
    medium: AirMedium, look: Observer, ground_color: NDArray[np.float64], height: int
) -> NDArray[np.float64]:
    """Bakes the multiple scattering that ``atmosphere.bake`` lacks, in the same shape and unit."""
    sizes, spectra, g = medium.planet.sizes(), medium.spectra(), mean_cosine(medium.phase)
    even = reduced(spectra, g)
    albedo = spectral_albedo(wavelengths(len(medium.gas)), ground_color)
    air = Optics(sizes, spectra, even, g, medium.phase, make_table(sizes, even, albedo))
    low, high = far_suns(look)
    light = np.zeros((_GROUND_SUNS, len(g)))
    over_threads(_on_far_ground, _GROUND_SUNS, low, high, air, light)
    half = np.zeros((height, height, 3))
    over_threads(_again_rows, height, look, air, FarGround(low, high, light, ground_color), half)
    return np.maximum(np.concatenate([half, half[:, ::-1]], axis=1), 0.0)


@kernel
def _again(
    count: int,
    sight: SightLine,
    air: Optics,
    full: Steps,
    less: Steps,
    part: NDArray,
    total: NDArray,
) -> None:
    """Fills ``total`` [wavelengths] with the multiple scattering along a ray.

    Args:
        full, less: The ray, prepared in the medium and in the reduced one.
        part: Room for two spectra.
    """
    gather(count, sight, air.sizes, air.even, less, part[0], part[1])
    for w in range(total.size):
        total[w] = part[0, w] + part[1, w]
    gather(count, sight, air.sizes, air.spectra, full, part[0], part[1])
    for w in range(total.size):
        total[w] -= part[0, w] + (1.0 - air.g[w]) * part[1, w]
        total[w] = max(total[w], 0.0) * (0.25 / elementary.PI)
    add_again(count, sight, air.sizes, air.table, less, total)


@kernel
def _forward_again(count: int, sight: SightLine, air: Optics, full: Steps, out: NDArray) -> None:
    """Light scattered forward twice or more, over the phase function and sunlight.

    Args:
        full: The ray, prepared.
        out: Receives it, [wavelengths].
    """
    r0, sine, toward, sun_sine = sight
    sizes, t, middle = air.sizes, full.t, full.middle
    for w in range(out.size):
        out[w] = 0.0
    enter, leave = shadow(sight, sizes[0])
    behind = 0.0
    for k in range(count):
        at, length = middle[k], t[k + 1] - t[k]
        r = np.sqrt(r0 * r0 + at * (2.0 * r0 * sine + at))
        here = elementary.exp(-(r - sizes[0]) / sizes[3]) * length
        if not enter < at < leave:
            cosine = min(max((r0 * sun_sine + at * toward) / r, -1.0), 1.0)
            gas, aerosol, layer = columns(r, cosine, sizes)
            way = aerosol + behind + 0.5 * here
            _add_forward(air, (gas, aerosol, layer), way, full.scattered[1, k], out)
        behind += here


@inlined
def _add_forward(
    air: Optics, behind: tuple[float, float, float], way: float, scattered: NDArray, out: NDArray
) -> None:
    """A step's part of ``_forward_again``.

    Args:
        behind: Columns of gas, aerosol and absorber toward the sun.
        way: Aerosol along all of the way.
        scattered: By the aerosol of the step, [wavelengths].
    """
    g = air.g
    gas, forward, loss, layer = air.spectra[0], air.spectra[1], air.spectra[2], air.spectra[3]
    for w in range(out.size):
        depth = (gas[w] * behind[0] + loss[w] * behind[1]) + layer[w] * behind[2]
        x = g[w] * forward[w] * way
        x = _DEEPEST if x > _DEEPEST else x
        few = 0.5 * x + x * x / 6.0
        many = (elementary.exp(x) - 1.0 - x) / x
        more = elementary.exp(-depth) * scattered[w] * g[w] * (many if x > 1e-2 else few)
        out[w] += 0.0 if (depth > _DEEPEST) | (x <= 0.0) else more


@kernel
def _both(air: Optics, steps: int) -> tuple[Steps, Steps]:
    """Room for a ray in the medium and in the reduced one, whose steps have the same places."""
    nodes = air.spectra.shape[1]
    full = room(steps, nodes)
    scattered, arriving = np.empty(full.scattered.shape), np.empty(nodes)
    less = Steps(full.t, full.middle, scattered, arriving, full.suns, full.light)
    return full, less


@kernel
def _on_level_ground(sun_sine: float, air: Optics, out: NDArray) -> None:
    """Irradiance over the sun's of what single scattering lacks, [wavelengths], into ``out``."""
    sizes, phase, nodes = air.sizes, air.phase, air.spectra.shape[1]
    full, less = _both(air, _STEPS)
    part, total, forward = np.empty((2, nodes)), np.empty(nodes), np.empty(nodes)
    sun = np.array([np.sqrt(max((1.0 - sun_sine) * (1.0 + sun_sine), 0.0)), sun_sine])
    for w in range(nodes):
        out[w] = 0.0
    for k in range(_UP // 2):
        sine = (k + 0.5) / (_UP // 2)
        cosine = np.sqrt((1.0 - sine) * (1.0 + sine))
        r0 = sizes[0]
        prepare(r0, sine, cosine, r0, sizes, air.spectra, full)
        count, _ = prepare(r0, sine, cosine, r0, sizes, air.even, less)
        for a in range(_AROUND):
            toward = angle_to_sun(sine, cosine, (a + 0.5) / _AROUND, sun)
            sight = SightLine(r0, sine, toward, sun_sine)
            _again(count, sight, air, full, less, part, total)
            _forward_again(count, sight, air, full, forward)
            for w in range(nodes):
                # Few directions, which a narrow lobe would slip through.
                total[w] += forward[w] * lobe(toward, min(phase[1, w] * phase[1, w], _SHARPEST))
                out[w] += total[w] * sine * 2.0 * elementary.PI / ((_UP // 2) * _AROUND)


@kernel
def _on_far_ground(
    first: int, last: int, low: float, high: float, air: Optics, out: NDArray
) -> None:
    """Light on the ground at heights of the sun, [_GROUND_SUNS, wavelengths]."""
    for n in range(first, last):
        sine = low + (high - low) * n / (_GROUND_SUNS - 1.0)
        _on_level_ground(sine, air, out[n])


@kernel
def _again_rows(
    first: int, last: int, look: Observer, air: Optics, far: FarGround, out: NDArray
) -> None:
    """Fills rows of multiple scattering's left half, linear Rec.709, [height, height, 3]."""
    r0, ground, sun, steps, weights = look
    low, high, on_ground, albedo = far
    sizes, phase = air.sizes, air.phase
    nodes, height = air.spectra.shape[1], out.shape[0]
    horizon = elementary.acos(ground / r0)
    for row in range(first, last):
        full, less = _both(air, steps)
        part, total = np.empty((2, nodes)), np.empty((_BEARINGS, nodes))
        forward = np.empty((_BEARINGS, nodes))
        upper = elementary.PI * (0.5 - row / height)
        crossed = upper > -horizon and upper - elementary.PI / height < -horizon
        lines = _LINES if crossed else 1
        for line in range(lines):
            elevation = upper - elementary.PI / height * (line + 0.5) / lines
            sine, cosine = elementary.sin(elevation), elementary.cos(elevation)
            prepare(r0, sine, cosine, ground, sizes, air.even, less)
            count, hits = prepare(r0, sine, cosine, ground, sizes, air.spectra, full)
            for n in range(_BEARINGS):
                toward = angle_to_sun(sine, cosine, n / (_BEARINGS - 1.0), sun)
                sight = SightLine(r0, sine, toward, sun[1])
                _again(count, sight, air, full, less, part, total[n])
                _forward_again(count, sight, air, full, forward[n])
            for column in range(height):
                share = 1.0 - (column + 0.5) / height
                place = share * (_BEARINGS - 1)
                near = min(int(place), _BEARINGS - 2)
                a, b, c, d = cubic(place - near)
                before, after = abs(near - 1), _BEARINGS - 1 - abs(_BEARINGS - 3 - near)
                lit, at = 0.0, 0
                toward = angle_to_sun(sine, cosine, share, sun)
                if hits and high > low:
                    lit = ((r0 * sun[1] + full.t[count] * toward) / ground - low) / (high - low)
                    lit = min(max(lit, 0.0), 1.0) * (_GROUND_SUNS - 1.0)
                    at = min(int(lit), _GROUND_SUNS - 2)
                    lit -= at
                for w in range(nodes):
                    light = a * total[before, w] + b * total[near, w]
                    light = max(light + c * total[near + 1, w] + d * total[after, w], 0.0)
                    ahead = a * forward[before, w] + b * forward[near, w]
                    ahead = max(ahead + c * forward[near + 1, w] + d * forward[after, w], 0.0)
                    light += ahead * lobe(toward, phase[1, w] * phase[1, w])
                    given = 0.0
                    if hits:
                        given = on_ground[at, w] + lit * (on_ground[at + 1, w] - on_ground[at, w])
                        given *= full.arriving[w] / elementary.PI
                    for i in range(3):
                        more = weights[w, i] * (light + albedo[i] * given)
                        out[row, column, i] += more / lines
