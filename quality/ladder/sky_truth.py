"""Radiance of skies along single directions, without pictures: what pictures are held against."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.arithmetic import elementary
from scenec.compiler.light.atmosphere import _EYE_M
from scenec.compiler.light.atmosphere_multiple import (
    Observer,
    Optics,
    _again,
    _both,
    _forward_again,
    make_table,
    mean_cosine,
    reduced,
    spectral_albedo,
)
from scenec.compiler.light.atmosphere_planets import MEDIA
from scenec.compiler.light.atmosphere_rays import (
    SightLine,
    aerosol_phase,
    gas_phase,
    gather,
    lobe,
    prepare,
)
from scenec.compiler.light.atmosphere_sky import AtmosphereSky
from scenec.compiler.light.atmosphere_spectra import wavelengths, weights
from scenec.compiler.light.clear_sky import ClearSky
from scenec.compiler.light.latlong import luminance
from scenec.compiler.scene.light import SunDisc
from scenec.quality.ladder.points import Floats
from scenec.schemas.kernels import kernel
from scenec.schemas.threads import over_threads

_RADIAN = elementary.PI / 180.0


def bilinear(picture: NDArray, to: Floats) -> Floats:
    """A lat-long picture read along directions as renderers read it, float64 [n, 3].

    Args:
        picture: [h, w, 3]; columns wrap around, rows beyond the first and last repeat these.
        to: Unit vectors, [n, 3].
    """
    height, width = picture.shape[:2]
    bearing = np.array([elementary.atan2(x, y) for x, y in to[:, :2].tolist()])
    polar = elementary.acos_array(np.clip(to[:, 2], -1.0, 1.0))
    u = bearing / (2.0 * elementary.PI) * width - 0.5
    v = np.clip(polar / elementary.PI * height - 0.5, 0.0, height - 1.0)
    left, top = np.floor(u), np.floor(v)
    s, t = (u - left)[:, None], (v - top)[:, None]
    i, j = left.astype(np.int64) % width, top.astype(np.int64)
    below = np.minimum(j + 1, height - 1)
    right = (i + 1) % width
    texels = picture.astype(np.float64)
    upper = texels[j, i] + s * (texels[j, right] - texels[j, i])
    lower = texels[below, i] + s * (texels[below, right] - texels[below, i])
    found: Floats = upper + t * (lower - upper)
    return found


def atmosphere_along(
    plan: AtmosphereSky, sun: SunDisc, to: Floats, steps: int, count: int
) -> Floats:
    """An atmosphere's light along directions above the horizon, at the first sample.

    The same physics as the baked picture's, evaluated for each direction: every direction has a ray
    of its own, at its own bearing.

    Args:
        plan: The sky.
        sun: Above the atmosphere.
        to: Unit vectors in the picture's frame (the sun at the bearing of 180 degrees), [n, 3].
        steps: Of each ray.
        count: Wavelengths.

    Returns:
        Linear Rec.709, W/(m^2 sr), float64 [n, 3].
    """
    factors = (plan.air_density[0], plan.dust_density[0], plan.ozone_density[0])
    medium = MEDIA[plan.planet](count, *map(float, factors))
    nodes = weights(count)
    spectra = medium.spectra()
    g = mean_cosine(medium.phase)
    even = reduced(spectra, g)
    sizes = medium.planet.sizes()
    albedo = spectral_albedo(wavelengths(count), plan.ground_color[0])
    r0 = float(sizes[0] + plan.altitude_m[0])
    elevation = float(sun.elevation_deg[0]) * _RADIAN
    toward = np.array([elementary.cos(elevation), elementary.sin(elevation)])
    look = Observer(r0, float(min(sizes[0], r0 - _EYE_M)), toward, steps, nodes)
    air = Optics(sizes, spectra, even, g, medium.phase, make_table(sizes, even, albedo))
    found = np.zeros((len(to), 3))
    over_threads(_along, len(to), to, look, air, plan.scattering == "multiple", found)
    white = nodes.sum(axis=0)
    above = sun.color[0] / luminance(sun.color[0] * white) * sun.irradiance[0]
    lit: Floats = found * above
    return lit


@kernel
def _along(first, last, to, look, air, multiple, out):  # type: ignore[no-untyped-def]
    r0, ground, sun, steps, weights = look
    sizes, spectra, phase = air.sizes, air.spectra, air.phase
    nodes = spectra.shape[1]
    for n in range(first, last):
        full, less = _both(air, steps)
        part, total, forward = np.empty((2, nodes)), np.zeros(nodes), np.zeros(nodes)
        sine = to[n, 2]
        cosine = np.sqrt(max((1.0 - sine) * (1.0 + sine), 0.0))
        # The sun stands in the south.
        toward = min(max(sun[1] * sine - sun[0] * to[n, 1], -1.0), 1.0)
        sight = SightLine(r0, sine, toward, sun[1])
        prepare(r0, sine, cosine, ground, sizes, air.even, less)
        count, _hits = prepare(r0, sine, cosine, ground, sizes, spectra, full)
        if multiple:
            _again(count, sight, air, full, less, part, total)
            _forward_again(count, sight, air, full, forward)
        gather(count, sight, sizes, spectra, full, part[0], part[1])
        more = np.zeros(3)
        for w in range(nodes):
            once = gas_phase(toward) * part[0, w]
            once += aerosol_phase(toward, phase, w, 1.0) * part[1, w]
            again = max(total[w], 0.0)
            again += max(forward[w], 0.0) * lobe(toward, phase[1, w] * phase[1, w])
            for i in range(3):
                out[n, i] += weights[w, i] * once
                more[i] += weights[w, i] * again
        for i in range(3):
            out[n, i] = max(out[n, i], 0.0) + max(more[i], 0.0)


def clear_along(plan: ClearSky, sun: SunDisc | None, to: Floats, fine: Floats) -> Floats:
    """A clear sky's light along directions above the horizon, at the first sample.

    Type 12 of ISO 15469:2004, from its formula, with colors and irradiance as the cfg has them.

    Args:
        plan: The sky.
        sun: Or None: at the zenith.
        to: Unit vectors, [n, 3].
        fine: Many, even in solid angle, which the irradiance is summed over, [m, 3].

    Returns:
        Linear Rec.709, W/(m^2 sr), float64 [n, 3].
    """
    toward = np.array(sun.direction(0) if sun is not None else (0.0, 0.0, 1.0))
    toward[2] = max(toward[2], 0.0)
    toward = toward / np.sqrt((toward * toward).sum())
    over_all = _cie(fine, toward, plan.zenith_color[0], plan.horizon_color[0])
    level = 2.0 * elementary.PI * float((luminance(over_all) * fine[:, 2]).mean())
    scale = float(plan.irradiance[0]) / level if level > 0.0 else 0.0
    return scale * _cie(to, toward, plan.zenith_color[0], plan.horizon_color[0])


def _cie(to: Floats, sun: Floats, zenith: Floats, horizon: Floats) -> Floats:
    up = to[:, 2]
    cosine = np.clip((to * sun).sum(axis=1), -1.0, 1.0)
    apart = elementary.acos_array(cosine)
    gradation = 1.0 - elementary.exp_array(-0.32 / np.maximum(up, 1e-3))
    right = elementary.exp(-1.5 * elementary.PI)
    indicatrix = 1.0 + 10.0 * (elementary.exp_array(-3.0 * apart) - right) + 0.45 * cosine * cosine
    mix = np.sqrt(up)[:, None]
    relative: Floats = (gradation * indicatrix)[:, None] * (horizon + mix * (zenith - horizon))
    return relative
