"""COCO documents: the truth, from a file or from frames, and detections; held against their form.

pycocotools trusts what it is given: bad run lengths end the process, and the id of a picture that
there is not raises a bare assertion. So all is checked here before.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenec.datasets.evaluate.instances import NEEDED, Coco, quiet
from scenec.datasets.formats.coco import instance_annotations
from scenec.datasets.formats.coco_parts import NO_LEVEL, image_entry
from scenec.datasets.source import Source
from scenec.schemas.codec import JsonObject, Natural, decode, is_number, natural
from scenec.schemas.errors import FrameError, OutputError
from scenec.schemas.files import read_json
from scenec.schemas.records import Row4
from scenec.schemas.spelling import nearest, shown

ANNOTATIONS = "annotations"
#: A corner of a polygon may lie this many times a picture's side outside of it.
_FAR = 16.0
#: Pixels: sides of boxes whose areas add up.
_MOST = 1e9


@dataclass(frozen=True)
class _Image:
    id: Natural
    width: Natural
    height: Natural


@dataclass(frozen=True)
class _Annotation:
    image_id: Natural
    category_id: Natural
    bbox: Row4


@dataclass(frozen=True)
class _Category:
    id: Natural
    name: str


@dataclass(frozen=True)
class _Document:
    images: tuple[_Image, ...]
    annotations: tuple[_Annotation, ...]
    categories: tuple[_Category, ...]


def read_truth(path: Path, split: str | None = None) -> tuple[Path, Coco]:
    """A COCO file's document, or that of a dataset.

    Args:
        path: ``instances_<split>.json``, or the folder of a dataset of ``export coco``.
        split: Of several in a dataset.

    Raises:
        FrameError: It is none; names file and place.
        OutputError: There is none, or there are several splits and none was chosen.
    """
    file = path
    if path.is_dir():
        files = {
            one.stem.removeprefix("instances_"): one
            for one in sorted((path / ANNOTATIONS).glob("instances_*.json"))
        }
        if not files:
            raise OutputError(f"{path}: has no {ANNOTATIONS}/instances_*.json")
        if split is None and len(files) > 1:
            raise OutputError(f"{path}: has the splits {', '.join(files)}; choose one by --split")
        if split is not None and split not in files:
            raise OutputError(f"{path}: has no split {split!r}{nearest(split, files)}")
        file = files[split] if split is not None else next(iter(files.values()))
    document = read_json(file, FrameError, "a COCO file")
    decode(document, _Document, FrameError, str(file))
    images = {one["id"]: one for one in document["images"]}
    categories = {one["id"] for one in document["categories"]}
    found = []
    for number, one in enumerate(document[ANNOTATIONS]):
        where = f"{file}: /{ANNOTATIONS}/{number}"
        _require(one["image_id"] in images, where, "image_id", one, "the id of an image")
        _require(one["category_id"] in categories, where, "category_id", one, "a category's id")
        _require(is_number(one.get("area", 0)), where, "area", one, "a number")
        _require(one.get("iscrowd", 0) in (0, 1), where, "iscrowd", one, "0 or 1")
        entry = {"area": one["bbox"][2] * one["bbox"][3], **one}
        if "segmentation" in one:
            image = images[one["image_id"]]
            entry["segmentation"] = _masked(one["segmentation"], image, where)["segmentation"]
        found.append(entry)
    return file, {**document, ANNOTATIONS: found}


def truth_of(source: Source, level: str | None = None) -> Coco:
    """The document that ``export coco`` would write of these frames.

    Raises:
        FrameError: A frame cannot be read, or has no instances.
        OutputError: There is no such label level.
    """
    known = source.labels()
    if level is not None and level not in known:
        raise OutputError(f"--level {level}: no such label level{nearest(level, known)}")
    level = level or next(iter(known), "")
    names = known[level] if level else {1: NO_LEVEL}
    images, found = [], []
    for ref in source.frames:
        frame = source.load(ref, ["instance"], ["rgb"])
        images.append(image_entry(frame, ref.index + 1, f"{ref.key}.png"))
        found += instance_annotations(frame, level)[0]
    categories = [{"id": number, "name": name} for number, name in sorted(names.items())]
    return {"images": images, ANNOTATIONS: found, "categories": categories}


def read_detections(path: Path, truth: Coco) -> list[JsonObject]:
    """Detections as COCO's results have them, held against the truth that they are for.

    Each is ``{"image_id", "category_id", "score"}`` with ``bbox``, ``segmentation`` or both.

    Returns:
        The same, masks as run lengths, with ``box_area`` and, with masks, ``mask_area``.

    Raises:
        FrameError: It is none; names file, place, value and what was expected.
    """
    values = read_json(path, FrameError, "a COCO file of results")
    if not isinstance(values, list):
        raise FrameError(
            f"{path}: expected a list of detections, each with image_id, category_id, score and "
            f"bbox or segmentation, not {shown(values)}"
        )
    images = {one["id"]: one for one in truth["images"]}
    names = {one["id"]: one["name"] for one in truth["categories"]}
    known = ", ".join(f"{number} {name}" for number, name in names.items())
    detections: list[dict[str, Any]] = []
    for number, one in enumerate(values):
        where = f"{path}: /{number}"
        if not isinstance(one, dict):
            raise FrameError(f"{where}: expected an object, not {shown(one)}")
        _require(_among(one.get("image_id"), images), where, "image_id", one,
                 f"the id of one of the {len(images)} images")  # fmt: skip
        _require(_among(one.get("category_id"), names), where, "category_id", one,
                 f"a category: {known}")  # fmt: skip
        _require(is_number(one.get("score")), where, "score", one, "a finite number")
        _require("bbox" in one or "segmentation" in one, where, "bbox", one,
                 "a box or a segmentation")  # fmt: skip
        entry = {key: one[key] for key in ("image_id", "category_id", "score")}
        if "segmentation" in one:
            entry |= _masked(one["segmentation"], images[one["image_id"]], where)
        if "bbox" in one:
            _require(
                _is_box(one["bbox"]),
                where,
                "bbox",
                one,
                f"[x, y, width, height], at most {_MOST:g}",
            )
            entry["bbox"] = one["bbox"]
        entry["box_area"] = float(entry["bbox"][2] * entry["bbox"][3])
        detections.append(entry)
    return detections


def _among(value: Any, valid: Mapping[int, Any]) -> bool:
    return type(value) is int and value in valid


def _is_box(value: Any) -> bool:
    whole = isinstance(value, list) and len(value) == 4 and all(map(is_number, value))
    return whole and max(map(abs, value)) <= _MOST and value[2] >= 0 and value[3] >= 0


def _require(holds: bool, where: str, key: str, one: Mapping[str, Any], expected: str) -> None:
    if not holds:
        value = shown(one[key]) if key in one else "nothing"
        raise FrameError(f"{where}/{key}: expected {expected}, not {value}")


def _masked(mask: Any, image: Mapping[str, Any], where: str) -> dict[str, Any]:
    """A mask as compressed run lengths, its area and its box."""
    try:
        from pycocotools import mask as coco_mask
    except ImportError as error:
        raise OutputError(f"{NEEDED} ({error})") from error
    height, width = image["height"], image["width"]
    fault = _fault_of_mask(mask, height, width)
    if fault:
        raise FrameError(f"{where}/segmentation: {fault}")
    if isinstance(mask, list):
        runs = coco_mask.merge(coco_mask.frPyObjects(mask, height, width))
    elif isinstance(mask["counts"], list):
        runs = coco_mask.frPyObjects(mask, height, width)
    else:
        runs = mask
    return {
        "segmentation": runs,
        "mask_area": float(coco_mask.area(runs)),
        "bbox": coco_mask.toBbox(runs).tolist(),
    }


def _fault_of_mask(mask: Any, height: int, width: int) -> str:
    """Returns the fault of a mask; "" for none."""
    if isinstance(mask, list):
        far = _FAR * max(height, width)
        sound = bool(mask) and all(
            isinstance(one, list) and len(one) >= 6 and len(one) % 2 == 0
            and all(is_number(value) and abs(value) <= far for value in one)
            for one in mask
        )  # fmt: skip
        return "" if sound else "expected polygons [x, y, x, y, …] of three corners at least"
    if not isinstance(mask, dict) or not {"size", "counts"} <= mask.keys():
        return f"expected run lengths with size and counts, or polygons, not {shown(mask)}"
    if mask["size"] != [height, width]:
        return f"its size is {shown(mask['size'])}, and its image [{height}, {width}]"
    counts = mask["counts"]
    if isinstance(counts, str):
        lengths = _lengths(counts)
    elif isinstance(counts, list) and all(natural(one) is None for one in counts):
        lengths = np.array(counts, np.float64)
    else:
        lengths = None
    if lengths is None or (lengths < 0).any():
        return "its counts are no run lengths"
    if lengths.sum() != height * width:
        return f"its runs cover {lengths.sum():.0f} pixels, and its image has {height * width}"
    return ""


def _lengths(text: str) -> NDArray[np.float64] | None:
    """Run lengths of COCO's compressed text; None where it is none.

    Characters from 48 on hold five bits each, the sixth says that more follow; from the fourth
    number on, differences to the number two before.
    """
    try:
        codes = np.frombuffer(text.encode("ascii"), np.uint8).astype(np.int64) - 48
    except UnicodeEncodeError:
        return None
    if not len(codes) or (codes < 0).any() or (codes > 63).any() or codes[-1] & 32:
        return None
    last = np.flatnonzero(codes & 32 == 0)
    first = np.concatenate([[0], last[:-1] + 1])
    if (last - first).max() > 6:
        return None
    place = np.arange(len(codes)) - np.repeat(first, last - first + 1)
    values = np.add.reduceat((codes & 31) << (5 * place), first)
    values -= np.where(codes[last] & 16, np.int64(1) << (5 * (last - first + 1)), 0)
    values[1::2] = np.cumsum(values[1::2])
    values[2::2] = np.cumsum(values[2::2])
    return values.astype(np.float64)


def flaws_of(file: Path) -> Sequence[str]:
    """Lists the flaws that pycocotools finds in a COCO file of instances; empty for a sound one.

    Each annotation's mask is decoded by pycocotools and its area and box held against those stated.

    Raises:
        FrameError: The file is no COCO file.
        OutputError: pycocotools is not installed.
    """
    _, document = read_truth(file)
    try:
        from pycocotools import mask as coco_mask
        from pycocotools.coco import COCO
    except ImportError as error:
        raise OutputError(f"{NEEDED} ({error})") from error
    with quiet():
        coco = COCO(file)
    flaws = []
    if len(coco.anns) != len(document[ANNOTATIONS]):
        flaws.append("two annotations have one id")
    for one in coco.anns.values():
        if "segmentation" not in one:
            continue
        runs = coco.annToRLE(one)
        area, box = float(coco_mask.area(runs)), coco_mask.toBbox(runs).tolist()
        if area != one["area"] or box != one["bbox"]:
            flaws.append(
                f"annotation {one['id']}: its mask has area {area:g} and box {shown(box)}, and it "
                f"says {one['area']:g} and {shown(one['bbox'])}"
            )
    return flaws
