"""The sky's picture over its rows, and what it is made of over steps, bearings and wavelengths."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import fields, replace
from functools import partial
from pathlib import Path

import numpy as np

from scenec.compiler.arithmetic import elementary
from scenec.compiler.emit.lights import write_lights
from scenec.compiler.light import atmosphere
from scenec.compiler.light.atmosphere_planets import MEDIA
from scenec.compiler.light.atmosphere_sky import AtmosphereSky
from scenec.compiler.light.atmosphere_spectra import weights
from scenec.compiler.light.clear_sky import ClearSky
from scenec.compiler.light.latlong import directions, horizontal_irradiance, luminance
from scenec.compiler.light.sky import SkyAndSun
from scenec.compiler.scene.ground import Ground
from scenec.compiler.scene.light import SkyLight, SunDisc
from scenec.compiler.scene.scene import Scene
from scenec.quality.ladder.base import Base
from scenec.quality.ladder.cost import Clock, written
from scenec.quality.ladder.points import Floats, Integers, rms, upper_half, worst
from scenec.quality.ladder.results import Ladder, Rung, split, steps
from scenec.quality.ladder.sky_truth import atmosphere_along, bilinear, clear_along
from scenec.schemas.codec import Facts, read_facts
from scenec.schemas.exr import write_rgb
from scenec.schemas.report import SkyFacts

#: Directions that are looked along; those that an irradiance is summed over.
_DIRECTIONS, _MANY = 5_000, 200_000
#: Of references: how many times as many steps, and intervals between wavelengths, as the finest
#: rung has. Steps err with the square of their length.
_STEPS, _WAVELENGTHS = 8, 4
#: Rows of the pictures that constants of the atmosphere are varied for.
_ROWS = 64
#: Rows that a picture of the sky can have.
_LEAST, _MOST = 8, 4096
#: Blocks of directions whose sums say how far a sum errs.
_BLOCKS = 8

type _SkyOfRows = Callable[[int], SkyAndSun]


def sky(base: Base, rungs: int) -> list[Ladder] | str:
    """The ladders of the sky's first picture, or why there are none."""
    plan, sun = base.plan.light.sky, base.plan.light.sun
    sun = None if sun is None else replace(_first(sun), gobo=None)
    if plan is None:
        return "the scene has no sky"
    if not base.color:
        return "no output shows color, so there is no sky"
    if isinstance(plan, ClearSky):
        return [_clear(_first(plan), sun, rungs)]
    if isinstance(plan, AtmosphereSky):
        assert sun is not None
        if plan.planet == "moon":
            return "the sky is black: there is no air"
        one = _first(plan)
        return [_rows(one, sun, rungs), *_constants(one, sun, rungs)]
    return "the sky is a picture from a file, which is taken as it is"


def _first[S: (ClearSky, AtmosphereSky, SunDisc)](light: S) -> S:
    """Returns the first of all samples."""
    of_samples = {
        one.name: getattr(light, one.name)[:1]
        for one in fields(light)
        if isinstance(getattr(light, one.name), np.ndarray)
    }
    return replace(light, **of_samples)


def _sizes(resolution: int, rungs: int) -> list[tuple[int, bool]]:
    """Rows of the rungs, and whether they are the cfg's."""
    found = [(round(resolution / factor), factor == 1.0) for factor in steps(*split(rungs))]
    # Rounded, two rungs could be one.
    sizes = {rows: used for rows, used in found if used or _LEAST <= rows <= _MOST}
    return sorted(sizes.items())


def _clear(plan: ClearSky, sun: SunDisc | None, rungs: int) -> Ladder:
    to, many = upper_half(_DIRECTIONS), upper_half(_MANY)
    truth = clear_along(plan, sun, to, many)
    level = irradiance(clear_along(plan, sun, many, many), many)

    def build(rows: int) -> SkyAndSun:
        return replace(plan, resolution=rows).build(sun, 1)

    return Ladder(
        name="sky",
        what="light.sky.resolution",
        unit="relative",
        reference="the formula of the sky (CIE standard clear sky), evaluated along directions "
        "even in solid angle above the horizon; errors of luminance over its mean",
        claim="none: report.json states no error of a clear sky",
        claim_of="rms",
        rungs=tuple(_of_rows(_sizes(plan.resolution, rungs), build, to, truth, level)),
        notes=("of the first sample's picture",),
    )


def _rows(plan: AtmosphereSky, sun: SunDisc, rungs: int) -> Ladder:
    to = upper_half(_DIRECTIONS)
    # Steps and wavelengths as of the pictures: these have ladders of their own.
    truth = atmosphere_along(plan, sun, to, atmosphere.STEPS, atmosphere.WAVELENGTHS)
    return Ladder(
        name="sky",
        what="light.sky.resolution",
        unit="relative",
        reference=f"the atmosphere evaluated along directions even in solid angle above the "
        f"horizon, a ray each, of the picture's {atmosphere.STEPS} steps and "
        f"{atmosphere.WAVELENGTHS} wavelengths; errors of luminance over its mean",
        claim="sky.*.resolution_error of report.json: rms of luminance over its mean, without the "
        "rows at the zenith and the horizon",
        claim_of="rms",
        rungs=tuple(
            _of_rows(
                _sizes(plan.resolution, rungs),
                lambda rows: replace(plan, resolution=rows).build(sun, 1),
                to,
                truth,
                irradiance(truth, to),
            )
        ),
        notes=("of the first sample's picture",),
    )


def _of_rows(
    sizes: list[tuple[int, bool]],
    build: _SkyOfRows,
    to: Floats,
    truth: Floats,
    level: tuple[float, float],
) -> list[Rung]:
    # A night without light is shown without error.
    mean = float(luminance(truth).mean()) or 1.0
    _picture(build, sizes[0][0])
    found = []
    for rows, used in sizes:
        clock = Clock()
        (light, facts), size = clock.mean(partial(_picture, build, rows))
        picture = light.pictures[light.texture[0]]
        assert not isinstance(picture, Path)
        away = np.abs(luminance(bilinear(picture, to) - truth)) / mean
        # What a texel of the horizon's row or the zenith's has a part in is apart.
        texel = elementary.PI / rows
        inner = (to[:, 2] > elementary.sin(min(1.5 * texel, 1.5))) & (
            to[:, 2] < elementary.cos(min(1.5 * texel, 1.5))
        )
        shown = read_facts(facts, SkyFacts).pictures.get(light.texture[0])
        arriving = float(luminance(horizontal_irradiance(picture)))
        rung = Rung.of(
            away,
            clock,
            size,
            rms_off_horizon=rms(away[inner]),
            worst_off_horizon=worst(away[inner]),
            irradiance_error=off(arriving, level[0]),
            # Of the sum that it is held against.
            irradiance_noise=level[1],
            directions=len(to),
        )
        claimed = shown.resolution_error if shown else None
        found.append(replace(rung, value=float(rows), used=used, claimed=claimed))
    return found


def off(value: float, truth: float) -> float:
    """Relative error of an irradiance; 1 where there is light and should be none."""
    if truth > 0.0:
        return abs(value / truth - 1.0)
    return 1.0 if value > 0.0 else 0.0


def irradiance(light: Floats, to: Floats) -> tuple[float, float]:
    """Luminance that reaches level ground, and how far a sum over so many directions may err.

    Args:
        light: Along directions, linear Rec.709, [n, 3].
        to: The directions, even in solid angle, [n, 3].

    Returns:
        The irradiance, and the relative standard error of its mean over blocks of directions, each
        of which is even in itself (all together are evener, so that it errs rather less).
    """
    each = 2.0 * elementary.PI * luminance(light) * to[:, 2]
    level = float(each.mean())
    blocks = np.array([float(block.mean()) for block in np.array_split(each, _BLOCKS)])
    away = blocks - blocks.mean()
    error = float(np.sqrt((away * away).sum() / (_BLOCKS * (_BLOCKS - 1))))
    return level, error / level if level > 0.0 else 0.0


def _picture(build: _SkyOfRows, rows: int) -> tuple[tuple[SkyLight, Facts], int]:
    """A sky of so many rows, its facts, and its bytes in the stage."""
    light, sun, facts = build(rows)
    assert light is not None
    return (light, facts), _bytes(light, sun)


def _bytes(light: SkyLight, sun: SunDisc | None) -> int:
    """Measures the bytes of the layer of lights and its picture."""
    bare = Scene(
        name="",
        samples=1,
        times=np.zeros(1),
        label_table={},
        sky_labels={},
        materials={},
        ground=Ground((), ()),
        objects=(),
        sun=sun,
        sky=light,
        rigs=(),
        outputs=(),
        bounds=np.zeros((2, 3)),
    )
    return written(lambda folder: write_lights(folder / "lights.usdc", bare))


def _constants(plan: AtmosphereSky, sun: SunDisc, rungs: int) -> list[Ladder]:
    """Constants of the code, at texels of small pictures: apart from the pictures' resolution.

    A ladder's reference shares the two other constants with its rungs, so that these err by the one
    that is varied alone. More bearings than any are a ray for each texel.
    """
    to, row, column = _texels(_ROWS)
    usual = {
        "steps": atmosphere.STEPS,
        "bearings": atmosphere.BEARINGS,
        "count": atmosphere.WAVELENGTHS,
    }
    finer, coarser = split(rungs)
    finest = 1 << finer
    factors = steps(finer, min(coarser, 2))
    fine_steps = _STEPS * finest * atmosphere.STEPS
    fine_count = _WAVELENGTHS * finest * (atmosphere.WAVELENGTHS - 1) + 1
    found = []
    for key, text in (
        ("steps", "steps of a ray (atmosphere.STEPS, a constant)"),
        ("bearings", "bearings at which rays are followed (atmosphere.BEARINGS, a constant)"),
        ("count", "wavelengths (atmosphere.WAVELENGTHS, a constant)"),
    ):
        if key == "bearings":
            truth = atmosphere_along(plan, sun, to, usual["steps"], usual["count"])
            reference = "the atmosphere evaluated along the directions of texels, a ray each, of "
            reference += f"as many steps and wavelengths ({usual['steps']} and {usual['count']})"
        else:
            fine = fine_steps if key == "steps" else fine_count
            truth = _baked(plan, sun, **{**usual, key: fine})[row, column]
            reference = f"the same picture of {fine} {text.split(' (')[0]}"
        mean = float(luminance(truth).mean()) or 1.0
        rung_list = []
        for factor in factors:
            # 17 and 33 are intervals and their ends.
            ends = 0 if key == "steps" else 1
            value = max(round((usual[key] - ends) / factor) + ends, 5)
            clock = Clock()
            picture, size = clock.mean(partial(_written, plan, sun, {**usual, key: value}))
            away = np.abs(luminance(picture[row, column] - truth)) / mean
            rung = Rung.of(away, clock, size, directions=len(to))
            rung_list.append(replace(rung, value=float(value), used=value == usual[key]))
        found.append(
            Ladder(
                name="sky",
                what=text,
                unit="relative",
                reference=reference,
                claim="none: report.json does not state it",
                claim_of="rms",
                rungs=tuple(rung_list),
                notes=(f"of pictures of {_ROWS} rows; the picture's bytes do not depend on it",),
            )
        )
    return found


def _written(plan: AtmosphereSky, sun: SunDisc, numbers: dict[str, int]) -> tuple[Floats, int]:
    """A picture and the bytes of its file."""
    picture = _baked(plan, sun, **numbers)
    single = picture.astype(np.float32)
    return picture, written(lambda folder: write_rgb(folder / "sky.exr", single))


def _texels(rows: int) -> tuple[Floats, Integers, Integers]:
    """Directions of all texels above the horizon's rows; their rows and columns."""
    to = directions(rows)[: rows // 2 - 1]
    row, column = np.indices(to.shape[:2])
    # Left and right half are the same.
    half = column.ravel() < rows
    return (np.ascontiguousarray(to.reshape(-1, 3)[half]), row.ravel()[half], column.ravel()[half])


def _baked(plan: AtmosphereSky, sun: SunDisc, steps: int, bearings: int, count: int) -> Floats:
    of_nodes = weights(count)
    medium = MEDIA[plan.planet](
        count, float(plan.air_density[0]), float(plan.dust_density[0]), float(plan.ozone_density[0])
    )
    above = sun.color[0] / luminance(sun.color[0] * of_nodes.sum(axis=0)) * sun.irradiance[0]
    picture: Floats = above * atmosphere.bake(
        medium,
        of_nodes,
        float(plan.altitude_m[0]),
        float(sun.elevation_deg[0]) * elementary.PI / 180.0,
        plan.ground_color[0],
        _ROWS,
        steps,
        bearings,
        multiple=plan.scattering == "multiple",
    )
    return picture
