"""What pruning needs to know of a batch's light: where shadows fall, how much of it there is."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.arithmetic import elementary
from scenec.compiler.light.latlong import directions_of_rows, luminance, read_picture
from scenec.compiler.light.sky import sky_irradiance, sun_direction
from scenec.compiler.materials.values import raw
from scenec.compiler.scene.scene import Lamp, Material, Scene, SunLight
from scenec.compiler.views.faint import TOLERANCE, Factors
from scenec.compiler.views.horizon import Relief
from scenec.compiler.views.shadows import Sweep

_DEGREE = elementary.PI / 180.0
#: Light of lamps counts as where it is brightest, so near to them, and beside that of suns and sky
#: as where it is dim, so far; meters.
_NEAR_M, _FAR_M = 0.5, 5.0
#: Albedos count as no less, where gloss is weighed against them, and as no more.
_DARKEST, _BRIGHTEST = 0.04, 0.95
#: What the laws that are not Lambert's may send on in their favorite directions, compared to it.
_PEAKED = 2.0
#: Roughness of pictures: the part of texels that may be smoother than what counts.
_SMOOTHEST = 0.01
#: Half of the part of the sky around a sun that counts as part of it, at most.
_HALO_DEG = 20.0


def sweep_of(scene: Scene, relief: Relief, *, halo: bool) -> Sweep:
    """The directions in which shadows of suns and other discs fall, at every sample.

    Args:
        scene: The scene.
        relief: Its terrain; of no cells where it has overhangs.
        halo: Whether the brightest part of the sky, around a sun, counts as part of it: what casts
            no such shadow on anything seen stands before none of it.
    """
    ways, widenings, samples = [], [], []
    for sun in _discs(scene):
        for i in range(len(sun.irradiance)):
            half = 0.5 * float(sun.diameter_deg[i])
            if not sun.irradiance[i] > 0.0 or float(sun.elevation_deg[i]) + half <= 0.0:
                continue
            # More than a quarter of all directions has no shadow to speak of.
            half = min(max(half, _halo_deg(sun, i) if halo else 0.0), 60.0) * _DEGREE
            ways.append([-part for part in sun_direction(sun, i)])
            cosine = elementary.cos(half)
            widenings.append((cosine, elementary.sin(half) / cosine))
            samples.append(i)
    return Sweep(
        np.array(ways, np.float64).reshape(-1, 3),
        np.array(widenings, np.float64).reshape(-1, 2),
        np.array(samples, np.int64),
        scene.bounds,
        relief,
    )


def factors_of(scene: Scene) -> Factors:
    """How much light there is to take or to send, at the sample where that is most.

    Args:
        scene: With materials.
    """
    albedo = max((_albedo(material) for material in scene.materials.values()), default=0.0)
    again = albedo / (1.0 - albedo)
    gloss = max((_gloss(material) for material in scene.materials.values()), default=1.0)
    sky = sky_irradiance(scene.sky, scene.samples)
    brightest = _brightest(scene)
    around, shadow = 0.0, 0.0
    for i in range(scene.samples):
        facing, level = 0.0, float(sky[i])
        for sun in _discs(scene):
            if float(sun.elevation_deg[i]) + 0.5 * float(sun.diameter_deg[i]) > 0.0:
                power = float(luminance(sun.color[i]) * sun.irradiance[i])
                facing += power
                level += power * max(sun_direction(sun, i)[2], 0.0)
        for lamp in scene.lamps:
            power = float(luminance(lamp.intensity[i]))
            facing += power / (_NEAR_M * _NEAR_M)
            level += power / (_FAR_M * _FAR_M)
        if not level > 0.0:
            if facing > 0.0:
                return Factors(np.inf, np.inf)
            continue
        held = float(sky[i])
        sent = max(again * (facing + held), elementary.PI * brightest[i]) + 4.0 * again * held
        around = max(around, gloss * sent / level)
        shadow = max(shadow, gloss * again * facing / level)
    return Factors(float(around), float(shadow))


def lit_by_lamps(
    scene: Scene, middles: NDArray[np.float64], radii: NDArray[np.float64], sample: int = -1
) -> NDArray[np.bool_]:
    """Which balls may be in the light of a lamp, where that is no less than what counts at all.

    Args:
        scene: The scene.
        middles, radii: The balls, float64 [n, 3] and [n].
        sample: Only at this sample; -1: at any.
    """
    out = np.zeros(len(middles), np.bool_)
    if not scene.lamps:
        return out
    sky = sky_irradiance(scene.sky, scene.samples)
    for i in range(scene.samples) if sample < 0 else (sample,):
        level = float(sky[i])
        for sun in _discs(scene):
            level += float(luminance(sun.color[i]) * sun.irradiance[i]) * max(
                sun_direction(sun, i)[2], 0.0
            )
        for lamp in scene.lamps:
            out |= _in_cone(lamp, i, middles, radii, level)
    return out


def _in_cone(
    lamp: Lamp, i: int, middles: NDArray[np.float64], radii: NDArray[np.float64], level: float
) -> NDArray[np.bool_]:
    power = float(luminance(lamp.intensity[i]))
    if not power > 0.0:
        return np.zeros(len(middles), np.bool_)
    matrix = lamp.to_world[i]
    way = middles - matrix[:3, 3]
    distance = np.sqrt((way * way).sum(axis=1))
    reach = radii + float(lamp.radius_m[i])
    near = np.maximum(distance - reach, 0.0)
    # All that is left out shares the tolerance: one lamp's part of it is much less.
    bright = power > 0.01 * TOLERANCE * level * near * near
    half = float(lamp.cone_deg[i]) * _DEGREE
    if half >= 0.5 * elementary.PI:
        return bright
    axis = -matrix[:3, 2] / np.sqrt((matrix[:3, 2] * matrix[:3, 2]).sum())
    along = (way * axis).sum(axis=1)
    across = np.sqrt(np.maximum(distance * distance - along * along, 0.0))
    beside = across * elementary.cos(half) - along * elementary.sin(half)
    return bright & ((distance <= reach) | (beside <= reach + 1e-6 * distance))


def _discs(scene: Scene) -> Iterable[SunLight]:
    return (*((scene.sun,) if scene.sun is not None else ()), *scene.more_suns.values())


def _albedo(material: Material) -> float:
    """The most of the light that a material sends on."""
    color = float(luminance(np.array(material.base_color)))
    color *= 1.0 + abs(material.variation)
    return min(color + material.specular, _BRIGHTEST)


def _gloss(material: Material) -> float:
    """How much more a change shows in a material than in a dull one: see ``faint``."""
    color = max(float(luminance(np.array(material.base_color))), _DARKEST)
    roughness = material.roughness * (1.0 - min(abs(material.roughness_variation), 1.0))
    metallic = material.metallic
    files = material.maps.files if material.maps is not None else {}
    if "roughness" in files:
        values = np.sort(raw(files["roughness"]).ravel(), kind="stable")
        roughness = min(roughness, float(values[int(_SMOOTHEST * (len(values) - 1))]))
    if "metallic" in files:
        metallic = 1.0
    lobe = material.specular + metallic * min(color, 1.0)
    peaked = _PEAKED if material.reflectance is not None else 1.0
    if lobe == 0.0:
        return peaked
    alpha = roughness * roughness
    return peaked + lobe / max(4.0 * color * alpha * alpha, 1e-12)


def _halo_deg(sun: SunLight, sample: int) -> float:
    """Half of the part of the sky around a sun that counts as part of it; little of low ones."""
    return min(_HALO_DEG, 0.5 * max(float(sun.elevation_deg[sample]), 0.0))


def _brightest(scene: Scene) -> NDArray[np.float64]:
    """Largest luminance of the sky's radiance outside of the halos of suns, at every sample."""
    sky = scene.sky
    out = np.zeros(scene.samples)
    if sky is None:
        return out
    levels: dict[str, NDArray[np.float64]] = {}
    for name, picture in sky.pictures.items():
        pixels = read_picture(picture) if isinstance(picture, Path) else picture
        levels[name] = luminance(pixels.astype(np.float64))
    known: dict[tuple[object, ...], float] = {}
    for i, name in enumerate(sky.texture):
        level = levels[name]
        turn = float(sky.rotation_deg[i])
        halos = tuple(
            (float(sun.azimuth_deg[i]) - turn, float(sun.elevation_deg[i]), _halo_deg(sun, i))
            for sun in _discs(scene)
            if sun.irradiance[i] > 0.0
        )
        if (name, *halos) not in known:
            known[name, *halos] = _outside(level, halos)
        out[i] = known[name, *halos] * sky.intensity[i]
    return out


def _outside(level: NDArray[np.float64], halos: tuple[tuple[float, float, float], ...]) -> float:
    """The largest of a lat-long picture's values outside of cones: azimuth, elevation, half."""
    counts = np.ones(level.shape, np.bool_)
    height, width = level.shape
    ways = directions_of_rows(height, width, 0, height)
    # Texels count as inside only if they are as a whole.
    texel = elementary.PI / height
    for azimuth, elevation, half in halos:
        flat = elementary.cos(elevation * _DEGREE)
        way = (
            flat * elementary.sin(azimuth * _DEGREE),
            flat * elementary.cos(azimuth * _DEGREE),
            elementary.sin(elevation * _DEGREE),
        )
        cosine = ways[..., 0] * way[0] + ways[..., 1] * way[1] + ways[..., 2] * way[2]
        inside = half * _DEGREE - texel
        if inside > 0.0:
            counts &= cosine < elementary.cos(inside)
    return float(level[counts].max(initial=0.0))
