"""Pictures of colors over their texels, as the pixels of the nearest view see them."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.emit.maps import copy_maps
from scenec.compiler.ground.tiles import build_tiles
from scenec.compiler.ladder.base import Base
from scenec.compiler.ladder.cost import Clock, written
from scenec.compiler.ladder.points import rms, square, worst
from scenec.compiler.ladder.results import Ladder, Rung, split
from scenec.compiler.light.latlong import luminance
from scenec.compiler.scene import Ground, Material, Tile
from scenec.compiler.surfaces.bake import baked
from scenec.compiler.surfaces.footprint import Footprint, footprints
from scenec.compiler.surfaces.heights import forget_looks
from scenec.compiler.surfaces.pictures import with_pictures
from scenec.compiler.surfaces.reduce import halvings, reduced
from scenec.compiler.surfaces.values import Source, colors, forget_pixels, stored

#: Pixels that are looked through, of each material; samples of a pixel in each direction, at most.
_PIXELS, _ACROSS = 8_000, 8


@dataclass(frozen=True)
class _Picture:
    """A material's colors as they were drawn, and how they are seen.

    Attributes:
        material: With its pictures.
        source: Of the colors.
        pixels: That a repeat takes in the nearest view.
        halved: How often the cfg's is halved.
        truth: Luminance that each pixel shows, [n], its mean 1.
        at: Where in the picture the pixels' samples lie, [n, samples, 2] in repeats.
        mean: Luminance of the whole picture.
    """

    name: str
    material: Material
    source: Source
    pixels: float
    halved: int
    truth: NDArray[np.float64]
    at: NDArray[np.float64]
    mean: float


def textures(base: Base, rungs: int) -> list[Ladder] | str:
    """The ladder of the pictures' texels, or why there is none.

    Args:
        base: The scene.
        rungs: How many.
    """
    if base.looks is None:
        return "no output shows color, so there are no pictures"
    objects = base.finest_objects
    pictured = {
        name: material
        for name, material in base.looks.materials.items()
        if material.maps is not None
    }
    if not pictured:
        return "no material has pictures"
    if not base.rigs:
        return "without cameras all pictures stay as they are drawn"
    ground = Ground(base.plan.terrain.layers, _tiles(base))
    seen = footprints(pictured, ground, objects, (base.views, base.object_views), base.unseen)
    clock = Clock()
    with clock.running():
        pictures = _pictures(pictured, seen)
    if not pictures:
        return "no camera sees a picture of colors"
    finer, coarser = split(rungs)
    found = [
        _rung(pictures, times)
        for times in range(coarser, -finer - 1, -1)
        if any(_possible(one, one.halved + times) for one in pictures)
    ]
    forget_looks()
    forget_pixels()
    names = ", ".join(one.name for one in pictures)
    return [
        Ladder(
            name="textures",
            what="texels across the pictures of colors, relative to the cfg's",
            unit="relative",
            reference="the pictures as drawn, read linearly between texels and averaged over "
            "pixels of the nearest view, as the reduced ones are; luminance over its mean, which "
            "is radiance under even light",
            claim="none: report.json states texels_per_pixel and the error of rounding, not what a "
            "pixel loses",
            claim_of="worst",
            rungs=tuple(found),
            notes=(
                f"colors of {names}; drawing the pictures takes {clock.seconds:.3g} s, the same "
                "on all rungs",
            ),
        )
    ]


def _tiles(base: Base) -> tuple[Tile, ...]:
    """The mesh of the ground as the cfg asks for it."""
    if base.tiles is None:
        terrain = base.plan.terrain
        base.tiles, _ = build_tiles(
            base.surface, terrain.variation_key, terrain.meshing, base.near, base.views,
            color=base.color, cut_labels=base.labels,
        )  # fmt: skip
    return base.tiles


def _pictures(materials: dict[str, Material], seen: dict[str, Footprint]) -> list[_Picture]:
    """Pictures of colors that a camera sees and that the compiler may make smaller."""
    found = []
    for name, material in materials.items():
        maps = material.maps
        if maps is None or seen[name].seen <= 0.0 or (maps.sources and maps.sources.as_is):
            continue
        made, _ = baked(with_pictures({name: material})[0][name])
        source = made.maps.files.get("base_color") if made.maps is not None else None
        if source is None:
            continue
        planes = colors(source)
        high, wide = stored(source).shape[:2]
        pixels = seen[name].seen
        at = _samples(pixels, min(high, wide))
        mean = float(luminance(planes.astype(np.float64)).mean())
        found.append(
            _Picture(
                name,
                made,
                source,
                pixels,
                halvings(high, wide, seen[name].counted),
                _through(planes, at) / mean,
                at,
                mean,
            )
        )
    return [one for one in found if one.mean > 0.0]


def _samples(pixels: float, texels: int) -> NDArray[np.float64]:
    """Samples of pixels spread over a repeat, float64 [n, samples, 2]."""
    across = min(max(int(np.ceil(2.0 * texels / pixels)), 2), _ACROSS)
    inside = (np.arange(across) + 0.5) / across - 0.5
    dv, du = np.meshgrid(inside, inside, indexing="ij")
    offset = np.stack([du.ravel(), dv.ravel()], axis=1) / pixels
    u, v = square(_PIXELS)
    return np.stack([u, v], axis=1)[:, None, :] + offset[None]


def _through(planes: NDArray, at: NDArray[np.float64]) -> NDArray[np.float64]:
    """Luminance of pixels: means over samples read linearly between texels, which repeat."""
    level = luminance(planes.astype(np.float64))
    high, wide = level.shape
    x, y = at[..., 0] * wide - 0.5, at[..., 1] * high - 0.5
    left, top = np.floor(x), np.floor(y)
    s, t = x - left, y - top
    i, j = left.astype(np.int64) % wide, top.astype(np.int64) % high
    right, below = (i + 1) % wide, (j + 1) % high
    upper = level[j, i] + s * (level[j, right] - level[j, i])
    lower = level[below, i] + s * (level[below, right] - level[below, i])
    found: NDArray[np.float64] = (upper + t * (lower - upper)).mean(axis=1)
    return found


def _possible(one: _Picture, times: int) -> bool:
    """Whether a picture can be halved so often."""
    if times < 0:
        return False
    high, wide = stored(one.source).shape[:2]
    return high % (1 << times) == 0 and wide % (1 << times) == 0 and min(high, wide) >> times >= 2


def _rung(pictures: list[_Picture], times: int) -> Rung:
    size, errors, texels, least = 0, [], [], np.inf
    clock = Clock()
    for one in pictures:
        own = one.halved + times
        while not _possible(one, own):
            own += 1 if own < 0 else -1
        with clock.running():
            small = reduced(one.source, "base_color", own) if own else None
            source = one.source if small is None else small.picture
            size += written(lambda folder, o=one, s=source: copy_maps(folder, o.name, _only(o, s)))  # type: ignore[misc]
        planes = colors(source) * np.array((1.0, 1.0, 1.0) if small is None else small.factor)
        errors.append(np.abs(_through(planes, one.at) / one.mean - one.truth))
        texels.append(min(planes.shape[:2]))
        least = min(least, texels[-1] / one.pixels)
    away = np.concatenate(errors)
    return Rung(
        value=2.0**-times,
        used=times == 0,
        worst=worst(away),
        rms=rms(away),
        claimed=None,
        seconds=clock.seconds,
        bytes=size,
        details={
            "texels_per_pixel_least": float(least),
            "texels_across_least": min(texels),
            "texels_across_most": max(texels),
            "pixels": len(away),
        },
    )


def _only(one: _Picture, source: Source) -> Material:
    """A material with no picture but that of its colors."""
    assert one.material.maps is not None
    return replace(one.material, maps=replace(one.material.maps, files={"base_color": source}))
