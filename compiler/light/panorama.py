"""Reads photographed skies, takes their sun out where asked, and reads their label maps."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, ClassVar, Literal

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.arithmetic import elementary
from scenec.compiler.assets.label_maps import LARGEST_ID, code_of, decode
from scenec.compiler.distributions.streams import Streams
from scenec.compiler.kinds import Array, Context, Finding, Form, an, file, forms, key, list_of
from scenec.compiler.kinds.node import Node, unknown
from scenec.compiler.light.latlong import horizontal_irradiance, luminance, read_picture
from scenec.compiler.light.picture_sun import DIAMETER_DEG, PictureSun, extract_sun
from scenec.compiler.light.sky import Sky, SkyAndSun
from scenec.compiler.scene.light import SkyLabelMaps, SkyLight, SunDisc
from scenec.schemas.codec import JsonObject
from scenec.schemas.spelling import shown


@dataclass(frozen=True, kw_only=True)
class LabelMap:
    """A picture whose pixels say what is seen there."""

    EXAMPLE: ClassVar = {"file": "overcast_labels.png", "values": {"7": "building"}}

    TITLE: ClassVar = "Label map of a panorama"
    file: Path = key(file("label_map"))
    """A PNG: gray of up to 16 bits, palette, or RGB. Row 0 is the zenith."""
    values: Any = key(
        Form(
            {
                "type": "object",
                "minProperties": 1,
                "additionalProperties": {
                    "description": "Name of a label of this level, or null.",
                    "type": ["string", "null"],
                },
                "x-name": "value",
            }
        )
    )
    """Label of each pixel value: a whole number as stored (gray, or palette index), or "#RRGGBB";
    null: no label. All values must be here."""

    @staticmethod
    def check(node: Node) -> Iterator[Finding]:
        """Yields levels and labels that there are not, and values that no picture has."""
        level, labels = str(node.path[-1]), node.whole().at("labels")
        if level not in labels:
            yield node.key_fault(unknown("label level", level, labels.entries))
            return
        values, table = node.at("values"), labels.at(level)
        for value in values.entries:
            if code_of(value) is None:
                yield values.key_fault(
                    f'{shown(value)}: expected a whole number from 0 to {LARGEST_ID}, or "#RRGGBB"',
                    value,
                )
            name = values[value]
            if name is not None and name not in table:
                where = f" on the level {shown(level)}"
                yield values.fault(unknown("label", name, table.entries, where), value)
            elif name is not None and (table[name] or 0) > LARGEST_ID:
                yield values.fault(
                    f"{shown(name)} has the id {table[name]}, and label maps hold ids up to "
                    f"{LARGEST_ID}: expected a smaller one in labels",
                    value,
                )


@dataclass(frozen=True, kw_only=True)
class LabelMaps:
    """Label maps of one picture, by level; a level left out has the sky's label everywhere."""

    EXAMPLE: ClassVar = {"class": {"file": "overcast_labels.png", "values": {"7": "building"}}}

    KEYWORDS: ClassVar = {
        "propertyNames": {**forms.NAME.keywords},
        "x-name": "level",
        "type": ["object", "null"],
        "additionalProperties": {
            "description": "The label map of a level.",
            "$ref": "#/$defs/sky_label_map",
        },
    }

    TITLE: ClassVar = "Label maps of a panorama"


@dataclass(frozen=True, kw_only=True)
class ImageSky(Sky):
    """Lat-long pictures."""

    EXAMPLE: ClassVar = {
        "type": "image",
        "files": ["overcast.exr", "noon.exr"],
        "pick": "shuffled",
        "sun": "extract",
    }

    files: tuple[Any, ...] = key(
        list_of(
            file("image"),
            'An OpenEXR file, relative to the cfg, or "package:NAME/path".',
            least=1,
        )
    )
    """Pictures, one of which is used in each sample."""
    pick: Literal["in_turn", "random", "shuffled"] = key(forms.CHOICE, default="in_turn")
    """Picture of a sample: the next, any, or any not yet shown, until all were; then anew in
    another order. Counted on over batches."""
    strength: Array = key(forms.PER_SAMPLE, default=1, above=0, at_most=1_000_000_000)
    """Factor on the picture's radiance."""
    rotation_deg: Array = key(forms.TURN_PER_SAMPLE, default=0)
    """Turn about the vertical, clockwise from above."""
    sun: Literal["keep", "extract"] = key(forms.CHOICE, default="keep")
    """keep: the sun stays in the picture. extract: it becomes a disc of the same irradiance, color
    and direction, for sharp shadows; light.sun must then be left out or null. Where no sun is
    found, the picture stays, and the report says so."""
    labels: JsonObject = key(forms.SKY_LABELS)
    labels_below: JsonObject = key(
        forms.SKY_LABELS_BELOW.but(
            description=f"{forms.SKY_LABELS_BELOW.keywords['description']} A level with a label "
            "map has the map's."
        )
    )
    label_maps: Any | None = key(
        list_of(an("sky_label_maps"), "Those of one picture.", least=1), optional=True
    )
    """What is where on the pictures, one entry for each of files in order, lat-long, any
    resolution, nearest texel. null: all of it has the sky's label."""

    @staticmethod
    def check(node: Node) -> Iterator[Finding]:
        """Yields label maps of no picture, and a sun beside the pictures'."""
        maps, files = node.at("label_maps"), node.at("files")
        if maps and files and len(maps.entries) != len(files.entries):
            yield maps.fault(
                f"{len(maps.entries)} entries for {len(files.entries)} files: expected one for "
                "each, null for none"
            )
        light = node.whole().at("light")
        if node["sun"] == "extract" and light.entries.get("sun") is not None:
            yield light.key_fault(
                'the sun is taken from the pictures ("sun": "extract" of light.sky): expected '
                "null, or no key; further suns go into light.more",
                "sun",
            )

    @staticmethod
    def usual_sun(sky: JsonObject) -> JsonObject | None:
        """Returns None where the pictures' sun is taken."""
        return None if sky["sun"] == "extract" else {}

    def draw(self, context: Context) -> ImageSky:
        """Returns the sky with the picture and the label maps of each sample."""
        picked = [self.pick_of(i, context) for i in range(context.samples)]
        maps = {
            level: tuple(self._label_map(index, level, context) for index in picked)
            for level in context.label_table
        }
        return replace(
            self,
            files=tuple(context.files[f"{context.path}/files/{index}"].path for index in picked),
            label_maps={level: of_level for level, of_level in maps.items() if any(of_level)},
            **context.sampled(self),
        )

    def pick_of(self, sample: int, context: Context) -> int:
        """Returns which of the pictures a sample gets."""
        count, path = len(self.files), f"{context.path}/pick"
        number = context.streams.batch * context.samples + sample
        if self.pick == "in_turn":
            return number % count
        if self.pick == "random":
            return int(context.streams.uniforms(path, 1, sample=sample)[0] * count)
        # Runs through the list go on over batches, so their streams are of none: of the first.
        of_first = Streams(context.streams.seed, 0)
        round_of_all = of_first.uniforms(path, count, sample=number // count)
        return int(np.argsort(round_of_all, kind="stable")[number % count])

    def _label_map(self, index: int, level: str, context: Context) -> LabelMap | None:
        node = (self.label_maps[index] or {}).get(level) if self.label_maps else None
        if node is None:
            return None
        file = context.files[f"{context.path}/label_maps/{index}/{level}/file"].path
        table = context.label_table[level]
        ids = ((value, table[name] if name else 0) for value, name in node["values"].items())
        return LabelMap(file=file, values=tuple(ids))

    def build(self, sun: SunDisc | None, samples: int) -> SkyAndSun:
        """Returns measured skies, copied byte for byte unless something about them is changed.

        Photographed panoramas hold negative radiances, by a little, where a color left the gamut;
        no renderer can sample them, so they become 0 and the change is reported.

        Returns:
            (sky, the sun that was taken out of the pictures, or the cfg's, what to report). At
            samples whose picture has none the sun's irradiance is 0.

        Raises:
            SceneError: A picture cannot be read.
        """
        names = _names(self.files)
        pictures: dict[str, NDArray[np.float32] | Path] = {}
        suns: dict[Path, PictureSun | None] = {}
        clipped, found = {}, {}
        for path, name in names.items():
            picture = read_picture(path)
            pictures[name] = path
            negative = picture < 0.0
            if negative.any():
                clipped[name] = {
                    "negative_fraction": float(negative.mean()),
                    "lowest_radiance": float(picture.min()),
                }
                pictures[name] = picture = np.maximum(picture, np.float32(0.0))
            if self.sun == "extract":
                left, suns[path], found[name] = extract_sun(picture)
                if suns[path] is not None:
                    pictures[name] = left
        report: dict[str, Any] = {}
        if clipped:
            report["set_to_zero"] = clipped
        if self.sun == "extract":
            report["suns"] = found
        texture = tuple(names[file] for file in self.files)
        sharp = any(map(_is_sharp, pictures.values()))
        sky = SkyLight(pictures, texture, self.strength, self.rotation_deg, sharp)
        return sky, self._sun(suns) or sun, report

    def _sun(self, suns: dict[Path, PictureSun | None]) -> SunDisc | None:
        """The pictures' suns as one light: turned and as strong as the pictures are."""
        of_samples = [suns.get(file) for file in self.files]
        if not any(of_samples):
            return None
        none = PictureSun(0.0, 90.0, 0.0, np.ones(3), DIAMETER_DEG)
        chosen = [sun or none for sun in of_samples]
        return SunDisc(
            azimuth_deg=np.array([sun.azimuth_deg for sun in chosen]) + self.rotation_deg,
            elevation_deg=np.array([sun.elevation_deg for sun in chosen]),
            irradiance=np.array([sun.irradiance for sun in chosen]) * self.strength,
            diameter_deg=np.array([sun.diameter_deg for sun in chosen]),
            color=np.stack([sun.color for sun in chosen]),
        )

    def build_label_maps(self) -> SkyLabelMaps | None:
        """Returns the panoramas' label maps, or None where no level has any.

        Raises:
            SceneError: A picture cannot be read, or has a value that its table lacks.
        """
        pictures: dict[str, NDArray[np.uint16]] = {}
        texture: dict[str, tuple[str | None, ...]] = {}
        for level, maps in (self.label_maps or {}).items():
            names = _names(tuple(one for one in maps if one is not None))
            for one, name in names.items():
                # No material has a dot in its name, so none of its maps has this one.
                names[one] = f"sky.{level}.{Path(name).stem}.png"
                pictures[names[one]] = decode(one.file, dict(one.values))
            texture[level] = tuple(None if one is None else names[one] for one in maps)
        if not texture:
            return None
        return SkyLabelMaps(pictures, texture, self.rotation_deg)


def _is_sharp(picture: NDArray[np.float32] | Path) -> bool:
    """Whether its brightest texel is far brighter than an even sky of the same irradiance."""
    # Imported here: a cfg's faults are told without it.
    from scenec.compiler.views.illumination import SHARP

    pixels = read_picture(picture) if isinstance(picture, Path) else picture
    even = float(luminance(horizontal_irradiance(pixels))) / elementary.PI
    return float(luminance(pixels).max()) > SHARP * even


def _names(files: tuple[Path | LabelMap, ...]) -> dict[Any, str]:
    """A file name for each: folders may hold files of one name, of which later get a number."""
    names: dict[Any, str] = {}
    for one in dict.fromkeys(files):
        file = one.file if isinstance(one, LabelMap) else one
        name, number = file.name, 1
        while name in names.values():
            number += 1
            name = f"{file.stem}_{number}{file.suffix}"
        names[one] = name
    return names
