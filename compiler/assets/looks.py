"""Defines materials of models: as a file has them, and what becomes of them here.

A file's material has numbers and pictures, each picture with a channel, a factor, a set of texture
coordinates and a map of these. Here a material has numbers, at most one picture of each kind, and
one set of coordinates for all of them.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from scenec.compiler.arithmetic import elementary
from scenec.compiler.assets.parts import MeshFileError
from scenec.compiler.assets.pictures import Source, channel_of, pixels_of, plain
from scenec.compiler.scene.material import Cutout, ImageFile
from scenec.schemas.maps import MAP_CHANNELS
from scenec.schemas.stage import OPACITY_THRESHOLD
from scenec.schemas.udim import Place, grid_of, is_tiled

#: Rows of a map of texture coordinates: u' = a u + b v + c, v' = d u + e v + f.
UvMap = tuple[float, float, float, float, float, float]
SAME_UV: UvMap = (1.0, 0.0, 0.0, 0.0, 1.0, 0.0)
#: Reflectance at normal incidence of most of what is no metal: an index of refraction of 1.5.
DIELECTRIC = 0.04
Color = tuple[float, float, float]
#: Notes that are warnings, since a user who does not see them trusts a wrong picture.
OPACITY = "its opacity is not shown: it is drawn, and labeled, as if it were solid"
BLENDED = f"its opacity is no blend: what is below {OPACITY_THRESHOLD} is cut out"
NO_VERTEX_COLORS = "the colors of its vertices are left out"
VERTEX_ALPHA = "the alpha of its vertices cuts nothing out"
NO_FACE_COLORS = "the colors of its faces are left out"
NOT_FOLLOWED = "is not followed"
_WARNINGS = (OPACITY, BLENDED, VERTEX_ALPHA, NO_VERTEX_COLORS, NO_FACE_COLORS, NOT_FOLLOWED)
#: Of these, those that do not count where a cfg gives a material of its own.
OF_COLORS = (VERTEX_ALPHA, NO_VERTEX_COLORS, NO_FACE_COLORS)


@dataclass(frozen=True)
class ModelMaterial:
    """A material of a model, in the shared surface model (``scene.Material``).

    Attributes:
        name: As in the file; "" if it has none there.
        base_color: Linear Rec.709, in [0, 1]; multiplies its picture.
        roughness, metallic: In [0, 1]; beside their pictures, which hold all factors and stand in
            their places, the averages of these.
        specular: Share s of the glossy lobe of what is no metal: the reflectance at normal
            incidence.
        diffuse_transmission: Share of the dull part's light that leaves on the far side.
        pictures: By kind (``schemas.maps.MAP_CHANNELS``): beside the model, or inside of it.
        normal_convention: "opengl" or "directx".
        cutout: What the picture of opacity leaves of it, or None.
    """

    name: str
    base_color: Color
    roughness: float
    metallic: float
    specular: float
    pictures: dict[str, Source] = field(default_factory=dict)
    normal_convention: str = "opengl"
    diffuse_transmission: float = 0.0
    cutout: Cutout | None = None


@dataclass(frozen=True)
class Slot:
    """A picture as a material uses it.

    Attributes:
        label: What messages call it.
        channel: Of numbers: which one, from 0; 3 is alpha.
        scale, offset: Of numbers: value = channel * scale + offset.
        uv_set: Name of the texture coordinates; "" is the first set.
        uv_map: Done to them before the picture is looked up.
    """

    source: Source
    label: str
    channel: int = 0
    scale: float = 1.0
    offset: float = 0.0
    uv_set: str = ""
    uv_map: UvMap = SAME_UV


@dataclass(frozen=True)
class FileLook:
    """A material as a file has it; numbers as in ``ModelMaterial``.

    Attributes:
        slots: Pictures by kind.
        notes: What of it is left out.
        repeats: Whether its pictures repeat outside of the unit square.
        cutout: What its picture of opacity leaves of it, or None: that is solid.
    """

    name: str
    base_color: Color = (0.8, 0.8, 0.8)
    roughness: float = 0.5
    metallic: float = 0.0
    specular: float = DIELECTRIC
    slots: dict[str, Slot] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    repeats: bool = True
    normal_convention: str = "opengl"
    diffuse_transmission: float = 0.0
    cutout: Cutout | None = None

    @property
    def title(self) -> str:
        """Names the material in messages."""
        return f"material {self.name!r}" if self.name else "a material without a name"

    @property
    def grid(self) -> Place:
        """Columns and rows of UDIM tiles that its pictures fill together."""
        sources = (slot.source for slot in self.slots.values())
        return grid_of(source for source in sources if isinstance(source, Path))

    def coordinates(self) -> tuple[str, UvMap]:
        """The set of texture coordinates that its pictures share, and what brings it into them."""
        (name, (a, b, c, d, e, f)), (columns, rows) = self.shared(), self.grid
        return name, (a / columns, b / columns, c / columns, d / rows, e / rows, f / rows)

    def shared(self) -> tuple[str, UvMap]:
        """The set of texture coordinates that its pictures share, and what it does to it."""
        for kind in MAP_CHANNELS:
            if kind in self.slots:
                return self.slots[kind].uv_set, self.slots[kind].uv_map
        return "", SAME_UV


def finished_look(look: FileLook) -> tuple[ModelMaterial, list[str]]:
    """A material as it is used, and what is left out of it.

    Raises:
        MeshFileError: A number is not finite, or a picture cannot be read.
    """
    numbers: dict[str, float] = {
        "roughness": look.roughness, "metallic": look.metallic, "specular": look.specular,
        "diffuse transmission": look.diffuse_transmission,
    }  # fmt: skip
    for key, value in (*numbers.items(), *(("base color", c) for c in look.base_color)):
        if not math.isfinite(value):
            raise MeshFileError(f"{look.title}: its {key} is {value}: expected a finite number")
    numbers = {key: min(max(float(value), 0.0), 1.0) for key, value in numbers.items()}
    notes = [f"{look.title}: {note}" for note in look.notes]
    pictures: dict[str, Source] = {}
    shared, grid = look.shared(), look.grid
    for kind in MAP_CHANNELS:
        if kind not in look.slots or (kind == "opacity" and look.cutout is None):
            continue
        slot = look.slots[kind]
        if (slot.uv_set, slot.uv_map) != shared:
            notes.append(
                f"{look.title}: its {kind} picture {slot.label} is left out: it lies on other "
                "texture coordinates than the first picture"
            )
            continue
        pixels = pixels_of(slot.source, slot.label, slot.channel == 3, kind, grid)
        tiled = grid != (1, 1) or (isinstance(slot.source, Path) and is_tiled(slot.source))
        source = ImageFile("", b"") if tiled else slot.source
        if MAP_CHANNELS[kind] == 3:
            pictures[kind] = plain(source, pixels)
            continue
        numbers[kind], picture = channel_of(source, pixels, slot.channel, slot.scale, slot.offset)
        if picture is not None:
            pictures[kind] = picture
        elif kind == "opacity" and look.cutout and numbers[kind] < look.cutout.threshold:
            notes.append(f"{look.title}: {OPACITY}")
    red, green, blue = (min(max(float(c), 0.0), 1.0) for c in look.base_color)
    if (red, green, blue) != tuple(map(float, look.base_color)):
        notes.append(f"{look.title}: its base color is clipped to [0, 1]")
    material = ModelMaterial(
        look.name,
        (red, green, blue),
        numbers["roughness"],
        numbers["metallic"],
        numbers["specular"],
        pictures,
        look.normal_convention,
        numbers["diffuse transmission"],
        look.cutout if "opacity" in pictures else None,
    )
    return material, notes


def is_warning(note: str) -> bool:
    """Tells whether a note on a model is printed on the screen, too."""
    return note.endswith(_WARNINGS)


def reflectance(ior: float) -> float:
    """Returns an index of refraction's Fresnel reflectance against air, at normal incidence."""
    if not ior > 0.0:
        return 1.0
    ratio = (ior - 1.0) / (ior + 1.0)
    return ratio * ratio


def linear_array(codes: np.ndarray) -> np.ndarray:
    """Linear values of sRGB ones, which are clipped to [0, 1] (IEC 61966-2-1)."""
    codes = np.clip(codes, 0.0, 1.0).astype(np.float64)
    steep = elementary.exp_array(2.4 * elementary.log_array((codes + 0.055) / 1.055))
    return np.where(codes <= 0.04045, codes / 12.92, steep)
