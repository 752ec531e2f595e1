"""Declares keys of surfaces."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

from scenec.compiler.kinds.declare import key
from scenec.compiler.kinds.forms import (
    FRACTION_PER_BATCH,
    LENGTH_PER_BATCH,
    SURFACE_CONTRAST,
    SURFACE_DISPLACEMENT,
    SURFACE_RELIEF_M,
    SURFACE_RESOLUTION,
)


@dataclass(frozen=True, kw_only=True)
class SurfaceBasalt:
    """Fine-grained lava with gas bubbles cut open and dust in the hollows. size_m, left out, is 0.6
    m.
    """

    EXAMPLE: ClassVar = {"type": "basalt", "vesicles": 0.4}

    grain_m: float = key(LENGTH_PER_BATCH, default=0.01, above=0, at_most=1_000_000)
    """Width of a bubble of middle size. A quarter of size_m at most; what is finer than the pixels
    fades."""
    relief_m: float | None = key(SURFACE_RELIEF_M, optional=True)
    contrast: float = key(SURFACE_CONTRAST)
    resolution: Any = key(SURFACE_RESOLUTION)
    vesicles: float = key(FRACTION_PER_BATCH, default=0.5)
    """Share of the places for bubbles that have one."""
    displacement: Any = key(SURFACE_DISPLACEMENT)


@dataclass(frozen=True, kw_only=True)
class SurfaceBreccia:
    """Angular pieces of several sizes and rocks in a fine matrix. size_m, left out, is 1.2 m."""

    EXAMPLE: ClassVar = {"type": "breccia"}

    grain_m: float = key(LENGTH_PER_BATCH, default=0.05, above=0, at_most=1_000_000)
    """Width of a piece of middle size. A quarter of size_m at most; what is finer than the pixels
    fades."""
    relief_m: float | None = key(SURFACE_RELIEF_M, optional=True)
    contrast: float = key(SURFACE_CONTRAST)
    resolution: Any = key(SURFACE_RESOLUTION)
    clasts: float = key(FRACTION_PER_BATCH, default=1)
    """Share of the places for pieces that have one."""
    displacement: Any = key(SURFACE_DISPLACEMENT)


@dataclass(frozen=True, kw_only=True)
class SurfaceGranite:
    """Interlocking crystals: feldspar, gray quartz and dark biotite. size_m, left out, is 0.6 m."""

    EXAMPLE: ClassVar = {"type": "granite", "grain_m": 0.004}

    grain_m: float = key(LENGTH_PER_BATCH, default=0.008, above=0, at_most=1_000_000)
    """Width of a crystal. A quarter of size_m at most; what is finer than the pixels fades."""
    relief_m: float | None = key(SURFACE_RELIEF_M, optional=True)
    contrast: float = key(SURFACE_CONTRAST)
    resolution: Any = key(SURFACE_RESOLUTION)
    displacement: Any = key(SURFACE_DISPLACEMENT)


@dataclass(frozen=True, kw_only=True)
class SurfaceGravel:
    """Rounded stones of three sizes, packed and overlapping, with grit between. size_m, left out,
    is 1.5 m.
    """

    EXAMPLE: ClassVar = {"type": "gravel", "displacement": True}

    grain_m: float = key(LENGTH_PER_BATCH, default=0.03, above=0, at_most=1_000_000)
    """Width of a stone of middle size. A quarter of size_m at most; what is finer than the pixels
    fades."""
    relief_m: float | None = key(SURFACE_RELIEF_M, optional=True)
    contrast: float = key(SURFACE_CONTRAST)
    resolution: Any = key(SURFACE_RESOLUTION)
    displacement: Any = key(SURFACE_DISPLACEMENT)


@dataclass(frozen=True, kw_only=True)
class SurfaceMudCracks:
    """Polygons of dried mud with curled rims between dark cracks. size_m, left out, is 2 m."""

    EXAMPLE: ClassVar = {"type": "mud_cracks", "grain_m": 0.3}

    TITLE: ClassVar = "Surface: mud_cracks"
    grain_m: float = key(LENGTH_PER_BATCH, default=0.2, above=0, at_most=1_000_000)
    """Width of a polygon. A quarter of size_m at most; what is finer than the pixels fades."""
    relief_m: float | None = key(SURFACE_RELIEF_M, optional=True)
    contrast: float = key(SURFACE_CONTRAST)
    resolution: Any = key(SURFACE_RESOLUTION)
    gape: float = key(FRACTION_PER_BATCH, default=0.06)
    """Width of the cracks, in widths of a polygon."""
    displacement: Any = key(SURFACE_DISPLACEMENT)


@dataclass(frozen=True, kw_only=True)
class SurfacePavement:
    """A lag of stones: fines with granules and pebbles of all sizes, crowded here and rare there,
    as many stones an octave of size as rocks have in nature (N(>D) ~ D^-2). size_m, left out, is 2
    m.
    """

    EXAMPLE: ClassVar = {"type": "pavement", "grain_m": 0.04, "darkness": 0.6}

    grain_m: float = key(LENGTH_PER_BATCH, default=0.03, above=0, at_most=1_000_000)
    """Width of what is of middle size: the largest stones are four times as wide, the smallest
    granules a tenth. A quarter of size_m at most; what is finer than the pixels fades."""
    relief_m: float | None = key(SURFACE_RELIEF_M, optional=True)
    contrast: float = key(SURFACE_CONTRAST)
    resolution: Any = key(SURFACE_RESOLUTION)
    stones: float = key(FRACTION_PER_BATCH, default=0.5)
    """Share of the places for stones that have one, on average."""
    darkness: float = key(FRACTION_PER_BATCH, default=0.5)
    """How much darker than the fines stones are: 0 not at all, 1 black."""
    displacement: Any = key(SURFACE_DISPLACEMENT)


@dataclass(frozen=True, kw_only=True)
class SurfaceRegolith:
    """Powder with small craters and fragments of all sizes. size_m, left out, is 2 m."""

    EXAMPLE: ClassVar = {"type": "regolith"}

    grain_m: float = key(LENGTH_PER_BATCH, default=0.04, above=0, at_most=1_000_000)
    """Size of what is of middle size: the largest craters are three times as wide, the smallest
    fragments a tenth. A quarter of size_m at most; what is finer than the pixels fades."""
    relief_m: float | None = key(SURFACE_RELIEF_M, optional=True)
    contrast: float = key(SURFACE_CONTRAST)
    resolution: Any = key(SURFACE_RESOLUTION)
    craters: float = key(FRACTION_PER_BATCH, default=0.5)
    """Share of the places for small craters that have one."""
    stones: float = key(FRACTION_PER_BATCH, default=0.6)
    """Share of the places for fragments that have one."""
    displacement: Any = key(SURFACE_DISPLACEMENT)


@dataclass(frozen=True, kw_only=True)
class SurfaceSand:
    """Grains, with faint ripples. size_m, left out, is 1.5 m."""

    EXAMPLE: ClassVar = {"type": "sand", "ripple_m": 0.08}

    grain_m: float = key(LENGTH_PER_BATCH, default=0.0015, above=0, at_most=1_000_000)
    """Width of a grain. A quarter of size_m at most; what is finer than the pixels fades."""
    relief_m: float | None = key(SURFACE_RELIEF_M, optional=True)
    contrast: float = key(SURFACE_CONTRAST)
    resolution: Any = key(SURFACE_RESOLUTION)
    ripple_m: float = key(LENGTH_PER_BATCH, default=0.09, at_least=0, at_most=1_000_000)
    """Wavelength of the ripples; 0: none."""
    displacement: Any = key(SURFACE_DISPLACEMENT)


@dataclass(frozen=True, kw_only=True)
class SurfaceSandstone:
    """Grains in faint beds, some harder than others, with rusty stains; beds lie level in the
    projection triplanar. size_m, left out, is 1 m.
    """

    EXAMPLE: ClassVar = {"type": "sandstone", "bed_m": 0.05}

    grain_m: float = key(LENGTH_PER_BATCH, default=0.0012, above=0, at_most=1_000_000)
    """Width of a grain. A quarter of size_m at most; what is finer than the pixels fades."""
    relief_m: float | None = key(SURFACE_RELIEF_M, optional=True)
    contrast: float = key(SURFACE_CONTRAST)
    resolution: Any = key(SURFACE_RESOLUTION)
    bedding: float = key(FRACTION_PER_BATCH, default=0.5)
    """How much beds differ: 0 not at all."""
    bed_m: float = key(LENGTH_PER_BATCH, default=0.15, above=0, at_most=1_000_000)
    """Thickness of the thickest beds."""
    displacement: Any = key(SURFACE_DISPLACEMENT)


@dataclass(frozen=True, kw_only=True)
class SurfaceSoil:
    """Crumbs and clods of earth, with bits of straw and bark. size_m, left out, is 1.5 m."""

    EXAMPLE: ClassVar = {"type": "soil", "litter": 0.3}

    grain_m: float = key(LENGTH_PER_BATCH, default=0.02, above=0, at_most=1_000_000)
    """Width of a clod of middle size. A quarter of size_m at most; what is finer than the pixels
    fades."""
    relief_m: float | None = key(SURFACE_RELIEF_M, optional=True)
    contrast: float = key(SURFACE_CONTRAST)
    resolution: Any = key(SURFACE_RESOLUTION)
    litter: float = key(FRACTION_PER_BATCH, default=0.3)
    """Share of the places for bits of plants that have one."""
    displacement: Any = key(SURFACE_DISPLACEMENT)


@dataclass(frozen=True, kw_only=True)
class SurfaceTurf:
    """Tufts of short blades, green and dead, over earth: what grass grows out of, and grass itself
    where it is far or short. size_m, left out, is 1.2 m.
    """

    EXAMPLE: ClassVar = {"type": "turf", "fresh": 0.3}

    grain_m: float = key(LENGTH_PER_BATCH, default=0.06, above=0, at_most=1_000_000)
    """Width of a tuft of middle size. A quarter of size_m at most; what is finer than the pixels
    fades."""
    relief_m: float | None = key(SURFACE_RELIEF_M, optional=True)
    contrast: float = key(SURFACE_CONTRAST)
    resolution: Any = key(SURFACE_RESOLUTION)
    fresh: float = key(FRACTION_PER_BATCH, default=0.6)
    """Share of the blades that are green; more and less of them in patches."""
    displacement: Any = key(SURFACE_DISPLACEMENT)


@dataclass(frozen=True, kw_only=True)
class SurfaceWeathered:
    """Any old rock: knobbly and cracked, with dark varnish in patches and dust in the hollows.
    size_m, left out, is 1.2 m.
    """

    EXAMPLE: ClassVar = {"type": "weathered", "contrast": 0.6}

    grain_m: float = key(LENGTH_PER_BATCH, default=0.05, above=0, at_most=1_000_000)
    """Width of a knob. A quarter of size_m at most; what is finer than the pixels fades."""
    relief_m: float | None = key(SURFACE_RELIEF_M, optional=True)
    contrast: float = key(SURFACE_CONTRAST)
    resolution: Any = key(SURFACE_RESOLUTION)
    cracks: float = key(FRACTION_PER_BATCH, default=0.6)
    """How much of its cracks is open."""
    displacement: Any = key(SURFACE_DISPLACEMENT)
