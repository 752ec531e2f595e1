"""Pictures of colors over their texels, as the pixels of the nearest view see them."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.emit.maps import copy_maps
from scenec.compiler.light.latlong import luminance
from scenec.compiler.materials.bake import baked
from scenec.compiler.materials.footprint import Footprint, footprints
from scenec.compiler.materials.heights import forget_looks
from scenec.compiler.materials.pictures import with_pictures
from scenec.compiler.materials.plan import MaterialPlan
from scenec.compiler.materials.reduce import halvings, reduced
from scenec.compiler.materials.values import Source, colors, forget_pixels, stored
from scenec.compiler.mesh.tiles import build_tiles
from scenec.compiler.scene.ground import Ground, MeshTile
from scenec.compiler.scene.material import Material
from scenec.quality.ladder.base import Base
from scenec.quality.ladder.cost import Clock, written
from scenec.quality.ladder.pixel_means import pixel_means
from scenec.quality.ladder.points import Floats, square
from scenec.quality.ladder.results import Ladder, Rung, split

#: Pixels that are looked through, of each material.
_PIXELS = 8_000


@dataclass(frozen=True)
class _Picture:
    """A material's colors as they were drawn, and how they are seen.

    Attributes:
        material: With its pictures.
        source: Of the colors.
        pixels: That a repeat takes in the nearest view.
        halved: How often the cfg's is halved.
        truth: Luminance that each pixel shows, [n], over the mean.
        mean: Luminance of the whole picture.
    """

    name: str
    material: Material
    source: Source
    pixels: float
    halved: int
    truth: Floats
    mean: float


def textures(base: Base, rungs: int) -> list[Ladder] | str:
    """The ladder of the pictures' texels, or why there is none."""
    if not base.color:
        return "no output shows color, so there are no pictures"
    objects = base.built["objects"]
    pictured = {
        name: drawn
        for name, drawn in base.built["material_plans"].items()
        if drawn.material.maps is not None
    }
    if not pictured:
        return "no material has pictures"
    views = base.picture_views
    if views is None:
        return "without cameras, or with --keep all, all pictures stay as they are drawn"
    ground = Ground(base.plan.terrain.layers, _tiles(base))
    materials = {name: drawn.material for name, drawn in pictured.items()}
    seen = footprints(materials, ground, objects, views, base.unseen)
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
            "pixels of the nearest view that shows color, as the reduced ones are (exactly, "
            "however many texels a pixel covers); luminance over its mean, which is radiance "
            "under even light",
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


def _tiles(base: Base) -> tuple[MeshTile, ...]:
    """The mesh of the ground as the cfg asks for it."""
    if base.tiles is None:
        terrain = base.plan.terrain
        base.tiles, _ = build_tiles(
            base.built["surface"], terrain.variation_key, terrain.meshing, base.near, base.views,
            color=base.color, cut_labels=base.labels,
        )  # fmt: skip
    return base.tiles


def _pictures(materials: dict[str, MaterialPlan], seen: dict[str, Footprint]) -> list[_Picture]:
    """Pictures of colors that a camera sees and that the compiler may make smaller."""
    found = []
    for name, drawn in materials.items():
        if seen[name].seen <= 0.0 or (drawn.sources and drawn.sources.as_is):
            continue
        made, _ = baked(with_pictures(drawn)[0], drawn.sources)
        source = made.maps.files.get("base_color") if made.maps is not None else None
        if source is None:
            continue
        planes = colors(source)
        high, wide = stored(source).shape[:2]
        pixels = seen[name].seen
        mean = float(luminance(planes.astype(np.float64)).mean())
        found.append(
            _Picture(
                name,
                made,
                source,
                pixels,
                halvings(high, wide, seen[name].counted),
                _through(planes, pixels) / mean,
                mean,
            )
        )
    return [one for one in found if one.mean > 0.0]


def _through(planes: NDArray, pixels: float) -> Floats:
    """Luminance that pixels show which are spread over a repeat, float64 [n].

    Args:
        planes: Colors, [h, w, 3].
        pixels: That a repeat takes, across.
    """
    level = luminance(planes.astype(np.float64))
    return pixel_means(level, np.stack(square(_PIXELS), axis=1), 1.0 / pixels)


def _possible(one: _Picture, times: int) -> bool:
    """Whether a picture can be halved so often: not at all it always can."""
    if times <= 0:
        return times == 0
    high, wide = stored(one.source).shape[:2]
    return high % (1 << times) == 0 and wide % (1 << times) == 0 and min(high, wide) >> times >= 2


def _nearest(one: _Picture, times: int) -> int:
    """How often a picture is halved on a rung: as often as it can be, at most so often."""
    return next(own for own in range(max(times, 0), -1, -1) if _possible(one, own))


def _smaller(one: _Picture, times: int) -> tuple[Source, tuple[float, float, float], int]:
    """A picture on a rung, what its colors are multiplied with, and its bytes in the stage."""
    small = reduced(one.source, "base_color", times) if times else None
    source = one.source if small is None else small.picture
    size = written(lambda folder: copy_maps(folder, one.name, _only(one, source)))
    return source, (1.0, 1.0, 1.0) if small is None else small.factor, size


def _rung(pictures: list[_Picture], times: int) -> Rung:
    clock = Clock()
    made = clock.mean(
        lambda: [_smaller(one, _nearest(one, one.halved + times)) for one in pictures]
    )
    errors, texels, least = [], [], np.inf
    for one, (source, factor, _) in zip(pictures, made, strict=True):
        planes = colors(source) * np.array(factor)
        errors.append(np.abs(_through(planes, one.pixels) / one.mean - one.truth))
        texels.append(min(planes.shape[:2]))
        least = min(least, texels[-1] / one.pixels)
    away = np.concatenate(errors)
    rung = Rung.of(
        away,
        clock,
        sum(size for _, _, size in made),
        texels_per_pixel_least=float(least),
        texels_across_least=min(texels),
        texels_across_most=max(texels),
        pixels=len(away),
    )
    return replace(rung, value=2.0**-times, used=times == 0)


def _only(one: _Picture, source: Source) -> Material:
    """A material with no picture but that of its colors."""
    assert one.material.maps is not None
    return replace(one.material, maps=replace(one.material.maps, files={"base_color": source}))
