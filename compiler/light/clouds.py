"""Draws clouds into the pictures of a sky, and takes what they hide from its sun.

Clouds are seen from the middle of the world's ground, as the sky is. The one that is drawn before
the sun's disc is the one that shades that place. Where all the land has the same light, the sun of
a sample has what comes through of it; where shadows of cumulus cross the land, it shines through a
picture of them (``cloud_shadows``).
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.arithmetic import elementary
from scenec.compiler.light.cloud_fields import (
    Cirrus,
    CirrusField,
    Clouds,
    Cumulus,
    CumulusField,
    no_cirrus,
    no_cumulus,
)
from scenec.compiler.light.cloud_rays import Shine, beam_left, beams_left, draw_rows
from scenec.compiler.light.cloud_shadows import LandBox, Shadows, cloud_shadows
from scenec.compiler.light.latlong import directions_of_rows, horizontal_irradiance, resampled
from scenec.compiler.light.overcast import NIL
from scenec.compiler.scene.light import Gobo, SkyLight, SunDisc
from scenec.schemas.codec import Facts
from scenec.schemas.threads import over_threads

_RADIAN = elementary.PI / 180.0
#: Of the sun's disc: rings of points, and points on each.
_DISC = ((0.0, 1), (0.45, 6), (0.85, 12))
#: Angle below the horizon over which clouds come to shade the far ground.
_NEAR_RAD = 2.0 * _RADIAN


def add_clouds(
    plan: Clouds,
    sky: SkyLight,
    sun: SunDisc | None,
    ground_color: NDArray[np.float64],
    samples: int,
    land: LandBox | None = None,
) -> tuple[SkyLight, SunDisc | None, Facts]:
    """A sky with clouds, what is left of its sun, and facts of that at each sample.

    Samples that see the same clouds in the same light share a picture.

    Args:
        plan: The clouds.
        sky: Without them, in pictures that were made, not read.
        sun: As it is below clear sky.
        ground_color: Albedo of the far ground, [s, 3].
        samples: How many.
        land: Where shadows can fall; None: the whole land has the middle's light.
    """
    cumulus_field = None if plan.cumulus is None else CumulusField(plan.cumulus)
    cirrus_field = None if plan.cirrus is None else CirrusField(plan.cirrus)
    left = np.ones(samples)
    shadows: list[Shadows | None] = [None] * samples
    shadows_of: dict[bytes, Shadows | None] = {}
    pictures: dict[str, NDArray[np.float32]] = {}
    names: dict[bytes, str] = {}
    texture = []
    for i in range(samples):
        cumulus = no_cumulus() if cumulus_field is None else cumulus_field.at(i)
        cirrus = no_cirrus() if cirrus_field is None else cirrus_field.at(i)
        to_sun, beam = np.array([0.0, 0.0, -1.0]), np.zeros(3)
        if sun is not None:
            to_sun = np.array(sun.direction(i))
            beam = sun.color[i] * sun.irradiance[i]
            left[i] = _sun_left(sun, i, cumulus, cirrus)
            if land is not None:
                radius = 0.5 * float(sun.diameter_deg[i]) * _RADIAN
                same = np.array([*to_sun, radius, *_numbers(cumulus, cirrus)]).tobytes()
                if same not in shadows_of:
                    shadows_of[same] = cloud_shadows(to_sun, radius, cumulus, cirrus, land)
                shadows[i] = shadows_of[same]
        picture = sky.pictures[sky.texture[i]]
        assert isinstance(picture, np.ndarray), "clouds over a picture from a file"
        numbers = [*to_sun, *beam, *ground_color[i], sky.intensity[i], sky.rotation_deg[i]]
        key = sky.texture[i].encode() + np.array([*numbers, *_numbers(cumulus, cirrus)]).tobytes()
        if key not in names:
            names[key] = f"sky_{i:04d}.exr"
            clear = resampled(picture, max(plan.resolution, len(picture))) * sky.intensity[i]
            turn = float(sky.rotation_deg[i]) * _RADIAN
            draw_clouds(clear, turn, to_sun, beam, ground_color[i], cumulus, cirrus)
            pictures[names[key]] = clear.astype(np.float32)
        texture.append(names[key])
    shown = replace(sky, pictures={**pictures}, texture=tuple(texture), intensity=np.ones(samples))
    facts: dict[str, Any] = {"sun_transmittance": left.tolist()}
    if sun is None:
        return shown, None, facts
    gobo = _gobo(shadows)
    if gobo is not None:
        facts["shadows"] = {
            "mean_transmittance": gobo.mean.tolist(),
            "texel_m": [None if one is None else one.texel_m for one in shadows],
        }
    even = np.array([one is None for one in shadows])
    irradiance = np.where(even, sun.irradiance * left, sun.irradiance)
    return shown, replace(sun, irradiance=irradiance, gobo=gobo), facts


def _gobo(shadows: list[Shadows | None]) -> Gobo | None:
    """The shadows of all samples; those that are the same share a picture. None without any."""
    pictures: dict[str, NDArray[np.uint16]] = {}
    names: dict[tuple[tuple[int, ...], bytes], str] = {}
    texture, middles, sizes, means = [], [], [], []
    for i, one in enumerate(shadows):
        if one is None:
            texture.append("")
            middles.append(np.zeros(2))
            sizes.append(np.ones(2))
            means.append(1.0)
            continue
        content = one.picture.shape, one.picture.tobytes()
        name = names.setdefault(content, f"clouds_{i:04d}.png")
        pictures[name] = one.picture
        texture.append(name)
        middles.append(one.middle_m)
        sizes.append(one.size_m)
        means.append(float(one.picture.mean()) / 65535.0)
    if not pictures:
        return None
    return Gobo(pictures, tuple(texture), np.array(middles), np.array(sizes), np.array(means))


def draw_clouds(
    picture: NDArray[np.float64],
    turn: float,
    to_sun: NDArray[np.float64],
    beam: NDArray[np.float64],
    ground_color: NDArray[np.float64],
    cumulus: Cumulus,
    cirrus: Cirrus,
) -> None:
    """Draws clouds into one picture of a clear sky, float64 [h, 2h, 3].

    Args:
        picture: The sky.
        turn: Of the picture about the vertical, clockwise from above, radians.
        to_sun: Unit vector in the world.
        beam: The sun's irradiance below clear sky, [3].
        ground_color: Albedo of the ground, [3].
        cumulus, cirrus: The layers.
    """
    height, width = picture.shape[:2]
    rows = height // 2
    to = directions_of_rows(height, width, 0, rows)
    east, north = to[..., 0].copy(), to[..., 1].copy()
    cosine, sine = elementary.cos(turn), elementary.sin(turn)
    to[..., 0] = cosine * east + sine * north
    to[..., 1] = cosine * north - sine * east
    of_sky = horizontal_irradiance(picture)
    direct = beam * max(to_sun[2], 0.0)
    before = of_sky + direct
    direct = direct * _mean_left(to_sun, cumulus, cirrus)
    below_clouds = ground_color * (of_sky + direct) / elementary.PI
    shine = Shine(to_sun, beam, of_sky / elementary.PI, below_clouds)
    over_threads(draw_rows, rows, to, cumulus, cirrus, shine, picture)
    # The far ground lies in the shadows of as many clouds as it is under.
    share = horizontal_irradiance(picture) + direct
    share = np.where(before > 0.0, share / np.where(before > 0.0, before, 1.0), 1.0)
    below = elementary.PI * ((np.arange(rows, height) + 0.5) / height - 0.5)
    near = 1.0 - elementary.exp_array(-np.maximum(below, 0.0) / _NEAR_RAD)
    picture[rows:] *= (1.0 + near[:, None] * (share - 1.0))[:, None, :]


def _sun_left(sun: SunDisc, sample: int, cumulus: Cumulus, cirrus: Cirrus) -> float:
    """Share of the sun's light that comes through clouds, a mean over its disc."""
    center = np.array(sun.direction(sample))
    radius = 0.5 * float(sun.diameter_deg[sample]) * _RADIAN
    azimuth = float(sun.azimuth_deg[sample]) * _RADIAN
    across = np.array([elementary.cos(azimuth), -elementary.sin(azimuth), 0.0])
    upward = np.array(
        [
            across[1] * center[2],
            -across[0] * center[2],
            across[0] * center[1] - across[1] * center[0],
        ]
    )
    total, count = 0.0, 0
    for ring, points in _DISC:
        for k in range(points):
            angle = 2.0 * elementary.PI * k / points
            offset = elementary.cos(angle) * across + elementary.sin(angle) * upward
            way = center + ring * radius * offset
            way /= np.sqrt((way * way).sum())
            if way[2] > 0.0:
                total += beam_left(way, 0.0, 0.0, cumulus, cirrus)
                count += 1
    left = total / count if count else 1.0
    return left if left >= NIL else 0.0


def _mean_left(to_sun: NDArray[np.float64], cumulus: Cumulus, cirrus: Cirrus) -> float:
    """``beam_left`` where the sun stands, over places of the ground: a lattice of 32 x 32."""
    if to_sun[2] <= 0.0:
        return 1.0
    k = np.arange(1024)
    # Twice the golden section: the lattice of Korobov in two dimensions, of 16 clouds' width.
    lattice = np.stack([k / 1024.0 - 0.5, (k * 0.6180339887498949) % 1.0 - 0.5], axis=1)
    left = np.empty(1024)
    places = 16.0 * cumulus.size_m * lattice
    over_threads(beams_left, 1024, to_sun, places, cumulus, cirrus, left)
    return float(left.mean())


def _numbers(*layers: Cumulus | Cirrus) -> list[float]:
    """Lists the numbers of layers that samples do not share."""
    out = []
    for layer in layers:
        out += [value for value in layer if isinstance(value, float)]
        out += [value for value in layer.pattern if isinstance(value, float)]
    return out
