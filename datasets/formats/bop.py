"""BOP: poses of objects, one scene a sequence (a batch seen by a camera).

::

    sequences.csv                             what each scene is
    <split>/000000/rgb/000000.png             8-bit color, where there is the pass rgb
    <split>/000000/depth/000000.png           16 bits, depth_scale millimeters a step
    <split>/000000/mask_visib/000000_000000.png   pixels that show an instance: 255, others 0
    <split>/000000/mask/000000_000000.png     the same if nothing hid it, with the pass amodal
    <split>/000000/scene_camera.json          cam_K, depth_scale, cam_R_w2c, cam_t_w2c
    <split>/000000/scene_gt.json              obj_id, cam_R_m2c, cam_t_m2c
    <split>/000000/scene_gt_info.json         boxes, counts of pixels, visib_fract
    models/models_info.json                   boxes of the objects
    objects.json                              obj_id -> class, and whether its poses are rigid

As docs/bop_datasets_format.md of thodan/bop_toolkit describes it, with what its
scripts/calc_gt_info.py does where that says more: widths and heights of boxes are last less first
pixel, px_count_all goes on beyond the border (a picture's size on each side). Lengths are
millimeters, pixel (0, 0) has its center at (0, 0).

An ``obj_id`` is a class, numbered from 1 in order of names. BOP's poses are rigid; rocks and plants
are scattered in many sizes and from several shapes. Each entry of ``scene_gt`` therefore carries
``scale`` (along the object's axes, at this sample; below 0 where it is mirrored along one):
x_c = cam_R_m2c (scale * x_m) + cam_t_m2c. Where it is 1 the pose is BOP's own.
"""

from __future__ import annotations

import fnmatch
import itertools
import json
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from scenec.datasets.formats import trajectory
from scenec.datasets.formats.contract import Done, Format, Info, Option, Task, Written
from scenec.datasets.formats.depth_png import LARGEST, fitting_scale, to_16_bits
from scenec.datasets.formats.encode import number_option
from scenec.datasets.formats.poses import (
    inverse,
    opencv_intrinsics,
    require_pinhole,
    rotation_matrix,
)
from scenec.datasets.source import FrameRef, LoadedFrame, sequences
from scenec.schemas.amodal import amodal_path
from scenec.schemas.errors import FrameError, OutputError
from scenec.schemas.files import atomic, once_per_file, write_json
from scenec.schemas.instances import BATCH_TABLE, InstanceTable, read_table
from scenec.schemas.picture import write_png
from scenec.schemas.spelling import nearest

_FILES = {"camera": "scene_camera.json", "gt": "scene_gt.json", "info": "scene_gt_info.json"}
_COLUMNS = (
    "scene", "split", "batch", "camera", "frames", "instances", "depth_hits", "depth_beyond",
    "depth_under",
)  # fmt: skip
#: Scales and boxes are float32.
_SAME = 1e-5


class Bop(Format):
    """See the module."""

    name = "bop"
    summary = "BOP: poses of objects, visible and amodal masks, 16-bit depth"
    version = 2
    needs = ("depth", "instance")
    # Pictures are taken from the PNG.
    unused = ("rgb",)
    options: ClassVar = {
        "objects": Option("*", "classes to take: patterns as in */lander|*/rover"),
        "depth_scale": Option("1", "millimeters a step of depth"),
    }

    def __init__(self, info: Info) -> None:
        super().__init__(info)
        self._step_mm = number_option(self, "depth_scale")
        self._patterns = self.option("objects").split("|")

    def holds(self, name: str) -> bool:
        """Holds pictures, depth, and masks of instances."""
        return name in ("rgb", "depth", "instance", "amodal")

    def tasks(self, splits: Mapping[str, Sequence[FrameRef]]) -> Iterator[Task]:
        """One a frame, with the number of its scene."""
        number_of_task, scene = 0, 0
        for split, frames in splits.items():
            for members in sequences(frames):
                for ref in members:
                    yield Task(number_of_task, split, (ref,), (scene,))
                    number_of_task += 1
                scene += 1

    def write(
        self, task: Task, frames: Iterable[LoadedFrame], folder: Path, scratch: Path
    ) -> Written:
        """Write a frame's pictures, and its annotation for ``finish``."""
        (frame,) = frames
        place, name = _place(task), f"{frame.ref.sample:06d}"
        depth = to_16_bits(frame.passes["depth"], 1000.0 / self._step_mm)
        written = Written(narrowed=depth.narrowed)
        write_png(folder / place / "depth" / f"{name}.png", depth.steps)
        written.files.append(f"{place}/depth/{name}.png")
        if frame.png is not None:
            trajectory.copy_picture(frame, folder / place / "rgb" / f"{name}.png")
            written.files.append(f"{place}/rgb/{name}.png")
        lines = self._lines(frame)
        masks = _amodal_masks(frame, lines)
        infos = []
        for index, line in enumerate(lines.tolist()):
            number = int(frame.table["id"][line])
            visible = frame.passes["instance"] == np.uint32(number)
            whole = None if masks is None else masks[number]
            for kind, mask in (("mask_visib", visible), ("mask", whole)):
                if mask is not None:
                    path = f"{place}/{kind}/{name}_{index:06d}.png"
                    write_png(folder / path, mask.astype(np.uint8) * np.uint8(255))
                    written.files.append(path)
            infos.append(_info(frame, line, visible, whole, depth.steps))
        entry = {"camera": self._camera(frame), "gt": _poses(frame, lines), "info": infos}
        (scratch / f"{task.number:08d}.json").write_text(json.dumps(entry), encoding="utf-8")
        classes = sorted({str(frame.table["class"][line]) for line in lines.tolist()})
        others = sorted({*frame.table["class"].tolist()} - {*classes})
        written.record = {
            "classes": classes, "others": others, "instances": len(lines), **depth.counts()
        }  # fmt: skip
        return written

    def finish(self, done: Iterable[Done], folder: Path, scratch: Path) -> list[str]:
        """Write the annotation of each scene, and what the objects are."""
        classes: set[str] = set()
        skipped: set[str] = set()
        for one in done:
            classes.update((one.record or {}).get("classes", ()))
            skipped.update((one.record or {}).get("others", ()))
        if self.option("objects") != "*" and skipped and not classes:
            raise OutputError(
                f"format bop, option objects: no frame shows anything of {self.option('objects')}"
                f"{nearest(self.option('objects'), sorted(skipped))}"
            )
        ids = {name: number for number, name in enumerate(sorted(classes), 1)}
        written = [trajectory.SEQUENCES, "objects.json", "models/models_info.json"]
        table: list[list[object]] = []
        batches: dict[Path, None] = {}
        for place, group in itertools.groupby(done, lambda d: _place(d.task)):
            counts = np.zeros(5, np.int64)
            task = None
            with ExitStack() as stack:
                files = None
                for one in group:
                    if one.record is None:
                        continue
                    if files is None:
                        files = {
                            key: stack.enter_context(_JsonObject(folder / place / name))
                            for key, name in _FILES.items()
                        }
                    task, record = one.task, one.record
                    batches[_table_path(task.frames[0])] = None
                    entry = json.loads((scratch / f"{task.number:08d}.json").read_bytes())
                    for pose in entry["gt"]:
                        pose["obj_id"] = ids[pose.pop("class")]
                    for key, file in files.items():
                        file.add(str(task.frames[0].sample), entry[key])
                    counts += (1, record["instances"], record["hits"], record["beyond"],
                               record["under"])  # fmt: skip
            if task is not None:
                ref = task.frames[0]
                table.append([place, task.split, ref.batch_name, ref.camera, *counts.tolist()])
                written += [f"{place}/{name}" for name in _FILES.values()]
        trajectory.write_table(folder / trajectory.SEQUENCES, _COLUMNS, table)
        objects, models = _objects(ids, [path for path in batches if path.is_file()])
        write_json(folder / "objects.json", objects)
        write_json(folder / "models" / "models_info.json", models)
        return written

    def mend(self, most: float) -> str:
        """The step that holds all depth."""
        step = math.ceil(1e5 / fitting_scale(most)) / 100.0
        return f"--set depth_scale={step:g} holds the farthest, {most:.5g} m"

    def usage(self) -> str:
        """The layout, what is exact and what is not."""
        return (
            "BOP: `<split>/<scene>/` with `rgb`, `depth`, `mask_visib`, `mask` (where the frames "
            "have amodal masks; without them `px_count_valid`, `bbox_obj` and `mask` are left "
            "out), `scene_camera.json`, `scene_gt.json` and `scene_gt_info.json`; a scene is a "
            "batch seen by a camera (`sequences.csv`). Lengths are millimeters; depth is the "
            f"16-bit value * {self._step_mm:g} mm, to the nearest (off by at most "
            f"{0.5 * self._step_mm:g} mm), 0 where nothing was hit or farther than "
            f"{LARGEST * self._step_mm / 1000.0:.6g} m (`depth_beyond` in `sequences.csv` counts "
            "these pixels). An `obj_id` is a class (`objects.json`). Poses are exact; scattered "
            "objects also have a size of their own, the extra key `scale`: "
            "x_camera = cam_R_m2c (scale * x_model) + cam_t_m2c. A class whose `objects.json` "
            "says `rigid` has scale 1 and one shape throughout, and is BOP as it stands. Meshes "
            "are not part of frames: `models_info.json` has the boxes of all shapes of a class "
            "together at scale 1, its diameter is their diagonal (at least BOP's). Further extra "
            "keys are `inst_id` (the same over all frames of a batch) and `truncated`. "
            "`px_count_all` goes on beyond the border, `bbox_obj` does not. Only instances seen in "
            "at least one pixel are listed."
        )

    def _lines(self, frame: LoadedFrame) -> NDArray[np.int64]:
        """Lines of the frame's table that are taken."""
        kinds, inverse_of = np.unique(frame.table["class"], return_inverse=True)
        wanted = [any(fnmatch.fnmatchcase(k, p) for p in self._patterns) for k in kinds.tolist()]
        lines: NDArray[np.int64] = np.flatnonzero(
            np.array(wanted, np.bool_)[inverse_of] & ~frame.ignored
        )
        return lines

    def _camera(self, frame: LoadedFrame) -> dict[str, Any]:
        require_pinhole(frame)
        from_world = inverse(frame.camera_to_world)
        return {
            "cam_K": opencv_intrinsics(frame).ravel().tolist(),
            "depth_scale": self._step_mm,
            "cam_R_w2c": from_world[:3, :3].ravel().tolist(),
            "cam_t_w2c": (from_world[:3, 3] * 1000.0).tolist(),
        }


class _JsonObject:
    """A JSON object written one key after the other, one a line; appears by atomic rename."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._stack = ExitStack()
        self._first = True

    def __enter__(self) -> _JsonObject:
        temporary = self._stack.enter_context(atomic(self._path))
        self._file = self._stack.enter_context(temporary.open("w", encoding="utf-8"))
        self._file.write("{")
        return self

    def add(self, key: str, value: Any) -> None:
        """Add one."""
        self._file.write(f"{'' if self._first else ','}\n  {json.dumps(key)}: {json.dumps(value)}")
        self._first = False

    def __exit__(self, *error: Any) -> None:
        if error[0] is None:
            self._file.write("\n}\n")
        self._stack.__exit__(*error)


def _place(task: Task) -> str:
    return f"{task.split}/{int(task.place[0]):06d}"


def _table_path(ref: FrameRef) -> Path:
    """Returns the path of the batch's table: frames/<backend>/<camera>/<sample>."""
    return ref.stem.parents[2] / BATCH_TABLE


#: A batch's table, read once for all its frames.
_batch_table = once_per_file(most=2)(read_table)


def _amodal_masks(
    frame: LoadedFrame, lines: NDArray[np.int64]
) -> dict[int, NDArray[np.bool_]] | None:
    """Amodal masks of some lines, by id; None where the frame has none."""
    found = frame.amodal
    if found is None:
        return None
    at = {number: i for i, number in enumerate(found.ids.tolist())}
    wanted = frame.table["id"][lines].tolist()
    missing = [number for number in wanted if number not in at]
    if missing or found.size != (frame.height, frame.width):
        raise FrameError(
            f"{amodal_path(frame.ref.stem)}: is not of the frame beside it"
            + (f": has no instance {missing[0]}" if missing else "")
        )
    return {number: found.mask(at[number]) for number in wanted}


def _poses(frame: LoadedFrame, lines: NDArray[np.int64]) -> list[dict[str, Any]]:
    """Entries of ``scene_gt``, with the class in place of its number."""
    if not len(lines):
        return []
    table = _batch_table(_table_path(frame.ref))
    scales, _ = table.size(frame.ref.sample)
    found = []
    for line in lines.tolist():
        column = {name: values[line] for name, values in frame.table.items()}
        at = int(np.searchsorted(table.id, column["id"]))
        if at == len(table.id) or int(table.id[at]) != int(column["id"]):
            raise FrameError(
                f"{_table_path(frame.ref)}: has no instance {column['id']}, which "
                f"{frame.ref.name} shows; render again"
            )
        turn = rotation_matrix(np.array([column[f"cam_q{axis}"] for axis in "xyzw"]))
        place = np.array([column[f"cam_{axis}"] for axis in "xyz"]) * 1000.0
        found.append(
            {
                "cam_R_m2c": turn.ravel().tolist(),
                "cam_t_m2c": place.tolist(),
                "class": str(column["class"]),
                "scale": scales[at].astype(np.float64).tolist(),
                "inst_id": int(column["id"]),
            }
        )
    return found


def _info(
    frame: LoadedFrame,
    line: int,
    visible: NDArray[np.bool_],
    full_mask: NDArray[np.bool_] | None,
    steps: NDArray[np.uint16],
) -> dict[str, Any]:
    """An entry of ``scene_gt_info``: what can be said."""
    info: dict[str, Any] = {"bbox_visib": _box(visible), "px_count_visib": int(visible.sum())}
    if "amodal_full" in frame.table:
        info["px_count_all"] = int(frame.table["amodal_full"][line])
        info["visib_fract"] = info["px_count_visib"] / max(info["px_count_all"], 1)
    if full_mask is not None:
        info["bbox_obj"] = _box(full_mask)
        info["px_count_valid"] = int((full_mask & (steps > 0)).sum())
    if "truncated" in frame.table:
        info["truncated"] = bool(frame.table["truncated"][line])
    return info


def _box(mask: NDArray[np.bool_]) -> list[int]:
    """x, y, width, height as bop_toolkit's calc_2d_bbox has them: last less first pixel."""
    columns, rows = np.flatnonzero(mask.any(axis=0)), np.flatnonzero(mask.any(axis=1))
    if not len(columns):
        return [-1, -1, -1, -1]
    return [int(columns[0]), int(rows[0]), int(columns[-1] - columns[0]), int(rows[-1] - rows[0])]


def _resized(table: InstanceTable) -> NDArray[np.bool_]:
    """Tells which instances change their scales or boxes from sample to sample, bool [n]."""
    found = np.zeros(len(table.id), np.bool_)
    if table.moving_scale is not None and table.moving_box is not None:
        scale, box = table.scale[table.moving], table.box[table.moving]
        grown = np.abs(table.moving_scale - scale).max(axis=(0, 2))
        found[table.moving] = grown > _SAME * np.abs(scale).max(axis=1)
        grown = np.abs(table.moving_box - box).max(axis=(0, 2, 3))
        found[table.moving] |= grown > _SAME * np.abs(box).max(axis=(1, 2))
    return found


def _objects(
    ids: Mapping[str, int], tables: Sequence[Path]
) -> tuple[dict[str, Any], dict[str, Any]]:
    """``objects.json`` and ``models_info.json``."""
    boxes: dict[str, list[NDArray[np.float64]]] = {name: [] for name in ids}
    rigid = dict.fromkeys(ids, True)
    for path in tables:
        table = read_table(path)
        unit = table.box.astype(np.float64) / table.scale.astype(np.float64)[:, None, :]
        # A mirrored axis has its ends the other way round.
        unit = np.sort(unit, axis=1)
        resized = _resized(table)
        for index, name in enumerate(table.classes):
            mine = table.class_index == index
            if name not in ids or not mine.any():
                continue
            low, high = unit[mine, 0].min(axis=0), unit[mine, 1].max(axis=0)
            boxes[name].append(np.stack([low, high]))
            spread = np.abs(unit[mine] - np.stack([low, high])).max()
            one_size = np.abs(table.scale[mine] - 1.0).max() <= _SAME
            rigid[name] &= bool(one_size and spread <= _SAME * max(1.0, np.abs(unit[mine]).max()))
            # It may begin at its own size and shape, and leave them later.
            rigid[name] &= not (mine & resized).any()
    objects, models = {}, {}
    for name, number in ids.items():
        all_boxes = boxes[name]
        if all_boxes:
            low = np.min([box[0] for box in all_boxes], axis=0)
            high = np.max([box[1] for box in all_boxes], axis=0)
            spread = np.abs(np.array(all_boxes) - np.stack([low, high])).max()
            rigid[name] &= bool(spread <= _SAME * max(1.0, np.abs(all_boxes).max()))
            size, low = (high - low) * 1000.0, low * 1000.0
            models[str(number)] = {
                "diameter": float(np.sqrt((size * size).sum())),
                **{f"min_{axis}": float(low[i]) for i, axis in enumerate("xyz")},
                **{f"size_{axis}": float(size[i]) for i, axis in enumerate("xyz")},
            }
        objects[str(number)] = {"class": name, "rigid": bool(all_boxes) and rigid[name]}
    return objects, models
