"""Declares keys of materials."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, Literal

from scenec.compiler.kinds.declare import Form, bounded, key
from scenec.compiler.kinds.forms import (
    ANGLE_PER_BATCH,
    CHOICE,
    FRACTION_PER_BATCH,
    LENGTH_PER_BATCH,
    PER_BATCH,
    an,
    file,
    list_of,
)


@dataclass(frozen=True, kw_only=True)
class Material:
    """A surface: (1 - m) ((1 - s) Lambert + s GGX) + m GGX tinted by the color, with m = metallic,
    s = specular and alpha = roughness squared.
    """

    EXAMPLE: ClassVar = {
        "base_color": [0.42, 0.29, 0.18],
        "roughness": 0.9,
        "variation": 0.25,
        "maps": {"procedural": {"type": "sand"}, "cells": {}},
    }

    base_color: Any | None = key(
        Form(
            {
                "x-color": True,
                "type": "array",
                "minItems": 3,
                "maxItems": 3,
                "items": {
                    **FRACTION_PER_BATCH.keywords,
                    "description": "Linear Rec.709 red, green or blue.",
                },
            }
        ),
        optional=True,
    )
    """Albedo in linear Rec.709; required unless maps give a base_color, which it multiplies (left
    out: 1)."""
    roughness: float = key(FRACTION_PER_BATCH, default=0.9)
    """Roughness of the specular part. Its facets light each other: a white metal reflects all light
    at any roughness."""
    specular: float = key(FRACTION_PER_BATCH, default=0.02)
    """Share of the specular part."""
    metallic: float = key(FRACTION_PER_BATCH, default=0)
    """Share of the metallic part."""
    variation: float = key(FRACTION_PER_BATCH, default=0)
    """How much the albedo varies from place to place: base_color (1 + variation v) with v in [-1,
    1]."""
    roughness_variation: float = key(PER_BATCH, default=0, at_least=-1, at_most=1)
    """How much the roughness varies from place to place: roughness (1 + roughness_variation v),
    clipped to [0, 1], a roughness map's value likewise. v is that of variation, so that color and
    roughness change together, as where ground is damp or trodden; below 0, lighter places are
    smoother."""
    reflectance: Mapping[str, Any] | None = key(an("reflectance"), optional=True)
    """How the dull part scatters light, where it is not Lambert's law; moons and dusty planets do
    otherwise."""
    emission: Any | None = key(
        list_of(
            bounded(PER_BATCH, at_least=0, at_most=1_000_000_000, unit="W/(m² sr)"),
            "Linear Rec.709 red, green or blue.",
            least=3,
            most=3,
        ),
        optional=True,
    )
    """Radiance that it gives off, linear Rec.709; left out: none."""
    diffuse_transmission: float = key(FRACTION_PER_BATCH, default=0)
    """For thin sheets such as leaves and cloth: share of the dull part's light that leaves on the
    far side, of the same color; the rest is reflected."""
    maps: Mapping[str, Any] | None = key(an("material_maps"), optional=True)
    """Pictures that vary the surface."""
    displacement: Any | None = key(list_of(an("displacement"), "One small relief."), optional=True)
    """Small reliefs of the surface, added up, which become geometry where a camera is near enough
    to see them; for materials of the ground."""


@dataclass(frozen=True, kw_only=True)
class MaterialCells:
    """Pictures laid in cells of a square lattice, each turned and shifted by chance and blended
    into the next, so that they do not repeat.
    """

    EXAMPLE: ClassVar = {"size_m": 1.5}

    size_m: float | None = key(LENGTH_PER_BATCH, optional=True, above=0, at_most=1_000_000)
    """Side of the lattice; left out, size_m of the maps, so that hardly a cell shows one place of
    the picture twice. Larger cells keep larger forms whole."""


@dataclass(frozen=True, kw_only=True)
class MaterialFar:
    """The picture of colors once more, larger: colors c become c (1 + share (c_far / mean - 1)), so
    that they vary over several scales.
    """

    EXAMPLE: ClassVar = {"factor": 7, "share": 0.5}

    factor: float = key(PER_BATCH, default=7.3, at_least=1, at_most=1000)
    """How much larger; not a whole number, or the two repeat together."""
    share: float = key(FRACTION_PER_BATCH, default=0.5)
    """How much of it shows."""


@dataclass(frozen=True, kw_only=True)
class MaterialMaps:
    """Pictures that vary a surface, laid over it in the world or by a mesh's texture coordinates:
    made by the compiler (procedural), or from files: PNG, JPEG, TIFF (8 bits, or 16 bits gray) or
    OpenEXR, relative to the cfg, or "package:NAME/path" in an installed Python package, where *
    stands for any part of a name.
    """

    EXAMPLE: ClassVar = {"folder": "textures/gravel", "size_m": 1.2, "cells": {}}

    projection: Literal["above", "triplanar", "uv"] | None = key(CHOICE, optional=True)
    """Where the pictures lie: along the vertical (above), along the world's three axes, mixed by
    the surface's normal (triplanar), or by the texture coordinates of a mesh from a file (uv). Left
    out: triplanar for a material that objects have, else above."""
    size_m: float | None = key(LENGTH_PER_BATCH, optional=True, above=0, at_most=1_000_000)
    """Side of one repeat, of above and triplanar; required, but of procedural pictures, whose kinds
    have their own."""
    folder: Path | None = key(file("texture_set"), optional=True)
    """A folder with a set of pictures, relative to the cfg or "package:NAME/path": which is what,
    its files' names say, as ambientCG, Poly Haven, cgbookcase, 3dtextures, Quixel, textures.com and
    OAISYS name theirs (Color, diff, albedo; rough, gloss; nor_gl, NormalDX; AO, disp, height,
    metal, arm, emission ...). A key beside it takes the place of the file in it. What in it is not
    understood is reported."""
    resolution: Literal["seen", "as_is"] = key(CHOICE, default="seen")
    """seen: a picture that has more texels than pixels wherever a camera of the batch sees it is
    made smaller, by powers of two; one that no camera sees becomes its mean. as_is: files stay as
    they are."""
    procedural: Mapping[str, Any] | None = key(an("surface"), optional=True)
    """Pictures that the compiler makes, another pattern in each batch. A file beside it takes the
    place of one of them. Not with the projection uv."""
    base_color: Path | None = key(file("map"), optional=True)
    """Albedo: sRGB, or linear Rec.709 in OpenEXR."""
    roughness: Path | None = key(file("map"), optional=True)
    """Roughness, raw, in place of the number."""
    gloss: Path | None = key(file("map"), optional=True)
    """Gloss, raw: the roughness is 1 less it. Not together with roughness."""
    metallic: Path | None = key(file("map"), optional=True)
    """Metallic part, raw, in place of the number."""
    normal: Path | None = key(file("map"), optional=True)
    """Normals n = 2 rgb - 1, raw, x to the right in the picture."""
    normal_convention: Literal["opengl", "directx"] = key(CHOICE, default="opengl")
    """Where the normals' y points: up in the picture (opengl) or down (directx)."""
    ambient_occlusion: Path | None = key(file("map"), optional=True)
    """What of the sky small hollows see, raw: multiplies the albedo, at compile time."""
    ambient_occlusion_strength: float = key(FRACTION_PER_BATCH, default=1)
    """How much it does: albedo (1 - strength (1 - picture))."""
    displacement: Path | None = key(file("heights"), optional=True)
    """Heights, raw, about their mean: become geometry, with displacement_m, where a camera is near
    enough to see them; and what height_blend of the ground's layers goes by. Of materials of the
    ground, projected from above."""
    displacement_m: float | None = key(
        LENGTH_PER_BATCH, optional=True, at_least=0, at_most=1_000_000
    )
    """Height of white above black in the picture of displacement, the key's or the folder's; left
    out, it stays flat."""
    emission: Path | None = key(file("map"), optional=True)
    """Colors that multiply the material's emission: sRGB, or linear Rec.709 in OpenEXR."""
    cells: Mapping[str, Any] | None = key(an("material_cells"), optional=True)
    """Keeps pictures that are projected from above from repeating. {} takes the usual size; left
    out, they repeat."""
    far: Mapping[str, Any] | None = key(an("material_far"), optional=True)
    """Varies the colors of pictures that are projected from above over a larger scale, too."""


@dataclass(frozen=True, kw_only=True)
class ReflectanceHapke:
    """Hapke's law (2012), of ground of rough grains, with the opposition surge.

    The color is r0, the diffusive reflectance, and w = 4 r0/(1 + r0)^2 the grains' albedo. Left
    out, the numbers are those of Mare Tranquillitatis at 643 nm (Sato et al. 2014, the map's
    cell of Tranquility Base, where w is 0.222: a color of 0.063). Mars, Meridiani Planum at 800
    nm (CRISM over the Opportunity rover, AGU 2010, P51D-1469): b 0.26, c 1, w 0.47, a color of
    0.16.
    """

    EXAMPLE: ClassVar = {"type": "hapke", "roughness_deg": 15}

    b: float = key(PER_BATCH, default=0.254, at_least=0, at_most=0.9)
    """How pointed the lobes of a grain's phase function are (double Henyey-Greenstein, Hapke 2012,
    eq. 6.7a)."""
    c: float = key(PER_BATCH, default=0.16, at_least=-1, at_most=1)
    """Which way a grain scatters: 1 back to the light, -1 forth. Hapke's relation to b: c = 3.29
    exp(-17.4 b^2) - 0.908."""
    opposition: float = key(PER_BATCH, default=1.993, at_least=0, at_most=3)
    """B0: how much brighter grains are with the light behind the viewer, where they hide their
    shadows."""
    opposition_width: float = key(PER_BATCH, default=0.06, at_least=0.002, at_most=0.5)
    """h: that rise has fallen to half at a phase angle of 2 arctan(h)."""
    roughness_deg: float = key(ANGLE_PER_BATCH, default=23.657, at_least=0, at_most=60)
    """Mean slope of what is too small to be drawn (theta bar, Hapke 1984). Measured values hold for
    relief up to the size of the instrument's pixels: what the scene's relief and displacement draw
    themselves counts twice."""


@dataclass(frozen=True, kw_only=True)
class ReflectanceLambert:
    """The same brightness from everywhere."""

    EXAMPLE: ClassVar = {"type": "lambert"}


@dataclass(frozen=True, kw_only=True)
class ReflectanceLommelSeeliger:
    """Lommel and Seeliger's law, of dark grains that scatter light once: w/(4 pi (mu0 + mu)) P(g)
    (1 + B(g)), with w = 4 r0/(1 + r0)^2 of the color r0. Left out, P is 1 and B 0: the classic law.
    """

    EXAMPLE: ClassVar = {"type": "lommel_seeliger", "opposition": 1, "opposition_width": 0.05}

    TITLE: ClassVar = "Reflectance: lommel_seeliger"
    b: float = key(PER_BATCH, default=0, at_least=0, at_most=0.9)
    """How pointed the lobes of a grain's phase function are (double Henyey-Greenstein, Hapke 2012,
    eq. 6.7a)."""
    c: float = key(PER_BATCH, default=0, at_least=-1, at_most=1)
    """Which way a grain scatters: 1 back to the light, -1 forth. Hapke's relation to b: c = 3.29
    exp(-17.4 b^2) - 0.908."""
    opposition: float = key(PER_BATCH, default=0, at_least=0, at_most=3)
    """B0: how much brighter grains are with the light behind the viewer, where they hide their
    shadows."""
    opposition_width: float = key(PER_BATCH, default=0.06, at_least=0.002, at_most=0.5)
    """h: that rise has fallen to half at a phase angle of 2 arctan(h)."""
