"""Defines materials and their pictures, a part of the Scene's vocabulary."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class ImageFile:
    """A picture that came inside of another file, as it stood there.

    Attributes:
        suffix: Of a file that holds these bytes: ".png", ".jpg".
    """

    suffix: str
    data: bytes


@dataclass(frozen=True)
class TilingCells:
    """Pictures laid in cells, each turned and shifted, so that they do not repeat.

    Attributes:
        size_m: Side of the triangular lattice whose corners the cells stand on, meters.
        seed: Of the table of turns and shifts, below 2**31.
    """

    size_m: float
    seed: int


@dataclass(frozen=True)
class Far:
    """The picture of colors once more, larger, so that it varies over several scales.

    Attributes:
        share: c * (1 + share * (c_far / mean - 1)).
    """

    factor: float
    share: float


@dataclass(frozen=True)
class Cutout:
    """Cuts parts of a surface out by a picture of opacity.

    Attributes:
        threshold: Nothing is there where opacity is below it, in (0, 1].
        wrap: How the picture goes on beyond its sides, along u and v (``stage.WRAPS``).
    """

    threshold: float
    wrap: tuple[str, str] = ("repeat", "repeat")


@dataclass(frozen=True)
class MaterialMaps:
    """Pictures that vary a surface.

    Attributes:
        size_m: Side of one repeat, meters; of no meaning with the projection "uv".
        files: By kind (``schemas.maps.MAP_CHANNELS``).
        normal_convention: "opengl" (y up in the picture) or "directx".
        projection: "above" (along the world's z), "triplanar" (along its three axes, mixed by the
            normal) or "uv" (the mesh's texture coordinates).
        cells: How they are kept from repeating, or None: they do.
        far: The colors' larger scale, or None.
        lean: Mean sine of the angles by which the picture's normals lean, where they are a relief's
            whose facets hide each other; else 0.
        cutout: Where the picture of opacity cuts parts out, or None; projection "uv" alone.
    """

    size_m: float
    files: dict[str, Path | ImageFile]
    normal_convention: str
    projection: str = "above"
    cells: TilingCells | None = None
    far: Far | None = None
    lean: float = 0.0
    cutout: Cutout | None = None


@dataclass(frozen=True)
class Reflectance:
    """Describes how the diffuse part of a surface scatters, where not by Lambert's law.

    Attributes:
        model: "lommel_seeliger" or "hapke"; the color is r0, the reflectance of a half space of
            isotropic scatterers, from which w = 4 r0 / (1 + r0)**2 is their albedo.
        b, c: Of the double Henyey-Greenstein phase function: width and share of its lobes.
        opposition, opposition_width: B0 and h of the shadow-hiding opposition surge.
        roughness_deg: Mean slope, theta bar; Hapke's only.
    """

    model: str
    b: float
    c: float
    opposition: float
    opposition_width: float
    roughness_deg: float = 0.0


@dataclass(frozen=True)
class Material:
    """Shared surface model: (1-m) * ((1-s) * Lambert + s * GGX) + m * GGX of the color.

    Attributes:
        base_color: Albedo, linear Rec.709.
        roughness: GGX's alpha is its square.
        specular: s.
        variation: Albedo is base_color * (1 + variation * v), v in [-1, 1] given on the geometry.
        metallic: m.
        maps: Pictures that vary it, or None.
        roughness_variation: Roughness is roughness * (1 + roughness_variation * v), of the same v.
        reflectance: In place of Lambert, or None.
        emission: Radiance that it gives off itself, linear Rec.709, W/(m^2 sr); a map multiplies.
        diffuse_transmission: Share of Lambert's light that leaves a thin sheet on its far side.
    """

    base_color: tuple[float, float, float]
    roughness: float
    specular: float
    variation: float
    metallic: float = 0.0
    maps: MaterialMaps | None = None
    roughness_variation: float = 0.0
    reflectance: Reflectance | None = None
    emission: tuple[float, float, float] = (0.0, 0.0, 0.0)
    diffuse_transmission: float = 0.0

    @property
    def varies(self) -> bool:
        """Whether it shows the variation of vertices and instances."""
        return self.variation != 0.0 or self.roughness_variation != 0.0

    @property
    def needs_uv(self) -> bool:
        """Whether it shows pictures by texture coordinates."""
        return self.maps is not None and self.maps.projection == "uv"
