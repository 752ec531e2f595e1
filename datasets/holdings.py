"""Compares what two datasets hold: settings that decide it, each annotation of COCO files."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from scenec.datasets.evaluate.coco_files import ANNOTATIONS
from scenec.datasets.export_records import ExportRecord
from scenec.datasets.formats.registry import find_format
from scenec.schemas.errors import FrameError, OutputError
from scenec.schemas.files import read_json
from scenec.schemas.spelling import shown

#: Of COCO's entries, what numbers them within one file; ids of categories are compared as names.
_NUMBERS = ("id", "image_id", "category_id")


def setting_differences(first: ExportRecord, second: ExportRecord) -> Iterator[str]:
    """Yields a line for each setting by which two datasets hold other things.

    Args:
        first: Its ``export.json``.
        second: Likewise.
    """
    keys = ["labels", "remap"]
    if any(first.instances.rejected.values()) or any(second.instances.rejected.values()):
        keys += ["keep", "rejected"]
    one, two = first.settings, second.settings
    if first.format == second.format:
        keys.append("level")
        neutral = _neutral(first.format)
        for name in sorted({*first.options, *second.options} - neutral):
            a, b = (given.options.get(name, "its default") for given in (first, second))
            if a != b:
                yield f"option {name}: {a} against {b}"
    for key in keys:
        if one.get(key) != two.get(key):
            yield f"{key}: {shown(one.get(key))} against {shown(two.get(key))}"


def _neutral(name: str) -> set[str]:
    """Lists options of a format that decide how it is written, not what it holds."""
    try:
        options = find_format(name).options
    except OutputError:
        return set()
    return {key for key, option in options.items() if option.neutral}


def coco_differences(first: Path, second: Path, masks: bool) -> Iterator[str]:
    """Yields a line for each image whose annotations differ between two COCO datasets.

    Args:
        first: Folder of a dataset.
        second: Likewise.
        masks: Whether masks are written in the same way, and so can be compared.

    Raises:
        FrameError: A file is no COCO file.
    """
    one, two = _images(first), _images(second)
    for name in sorted({*one} & {*two}):
        (image, a), (other, b) = one[name], two[name]
        if image["id"] != other["id"]:
            yield f"{name}: image id {image['id']} against {other['id']}"
        if len(a) != len(b):
            yield f"{name}: {len(a):,} against {len(b):,} annotations"
            continue
        told = next(
            (text for pair in zip(a, b, strict=True) if (text := _difference(*pair, masks))), ""
        )
        if told:
            yield f"{name}: {told}"


def _difference(a: Mapping[str, Any], b: Mapping[str, Any], masks: bool) -> str:
    """Names what two annotations differ in first; "" where they are the same."""
    keys = dict.fromkeys([*a, *b])
    for key in keys if masks else [key for key in keys if "segmentation" not in key]:
        if a.get(key) != b.get(key):
            who = f"annotation of instance {a.get('instance_id')}"
            if "segmentation" in key:
                return f"{who}: another {key}"
            return f"{who}: {key} {shown(a.get(key))} against {shown(b.get(key))}"
    return ""


def _images(folder: Path) -> dict[str, tuple[dict[str, Any], list[dict[str, Any]]]]:
    """Maps each image's file name to its entry and its annotations, in order."""
    images: dict[str, tuple[dict[str, Any], list[dict[str, Any]]]] = {}
    for path in sorted((folder / ANNOTATIONS).glob("instances_*.json")):
        document = read_json(path, FrameError, "a COCO file")
        try:
            names = {one["id"]: one["name"] for one in document["categories"]}
            of_id: dict[Any, tuple[dict[str, Any], list[dict[str, Any]]]] = {
                one["id"]: (one, []) for one in document["images"]
            }
            for one in document[ANNOTATIONS]:
                plain = {key: value for key, value in one.items() if key not in _NUMBERS}
                of_id[one["image_id"]][1].append({"category": names[one["category_id"]], **plain})
            for image, listed in of_id.values():
                listed.sort(key=lambda one: (str(one.get("instance_id")), one["category"]))
                images[image["file_name"]] = image, listed
        except (KeyError, TypeError, AttributeError) as error:
            raise FrameError(f"{path}: is no COCO file of scenec: {error!r}") from error
    return images
