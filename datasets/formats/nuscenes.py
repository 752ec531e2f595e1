"""nuScenes: its 13 tables, nuScenes-lidarseg, and their files, as its devkit reads them.

::

    v1.0-<split>/<table>.json                      the tables, those of ``TABLES``
    samples/CAM_LEFT/<batch>_<rig>__CAM_LEFT__<us>.png   pictures of the rig's camera ``left``
    samples/LIDAR_TOP/…__<us>.pcd.bin            scans: x, y, z, intensity, ring, float32
    lidarseg/v1.0-<split>/<token>_lidarseg.bin    label of each point, uint8
    maps/none.png                                  the mask that each map must have: empty

As the schema of the devkit describes it (docs/schema_nuscenes.md of nuscenes-devkit; H. Caesar and
others, nuScenes: a multimodal dataset for autonomous driving, CVPR 2020). A scene is a rig's
drive in a batch, a sample one of its samples, with all cameras and lidars (``scenec scan``) of
that; all are key frames. Tokens are digests of what they name.
"""

from __future__ import annotations

import hashlib
import itertools
import json
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from scenec.datasets.formats import trajectory
from scenec.datasets.formats.contract import Done, Format, Info, Option, Task, Written
from scenec.datasets.formats.lidar import read_cloud, scans_of
from scenec.datasets.formats.poses import (
    LINK_POSE,
    opencv_intrinsics,
    product,
    relative,
    require_pinhole,
)
from scenec.datasets.source import FrameRef, LoadedFrame
from scenec.schemas.errors import OutputError
from scenec.schemas.files import atomic, write_json
from scenec.schemas.picture import write_png
from scenec.schemas.quaternions import quaternion

_MICRO = 1_000_000
#: Tables, and their fields as the schema has them.
TABLES: Mapping[str, tuple[str, ...]] = {
    "attribute": ("token", "name", "description"),
    "calibrated_sensor": ("token", "sensor_token", "translation", "rotation", "camera_intrinsic"),
    "category": ("token", "name", "description", "index"),
    "ego_pose": ("token", "translation", "rotation", "timestamp"),
    "instance": (
        *("token", "category_token", "nbr_annotations"),
        *("first_annotation_token", "last_annotation_token"),
    ),
    "lidarseg": ("token", "sample_data_token", "filename"),
    "log": ("token", "logfile", "vehicle", "date_captured", "location"),
    "map": ("token", "log_tokens", "category", "filename"),
    "sample": ("token", "timestamp", "scene_token", "next", "prev"),
    "sample_annotation": (
        *("token", "sample_token", "instance_token", "attribute_tokens", "visibility_token"),
        *("translation", "size", "rotation", "num_lidar_pts", "num_radar_pts", "next", "prev"),
    ),
    "sample_data": (
        *("token", "sample_token", "ego_pose_token", "calibrated_sensor_token", "filename"),
        *("fileformat", "width", "height", "timestamp", "is_key_frame", "next", "prev"),
    ),
    "scene": (
        *("token", "name", "description", "log_token", "nbr_samples"),
        *("first_sample_token", "last_sample_token"),
    ),
    "sensor": ("token", "channel", "modality"),
    "visibility": ("token", "level", "description"),
}
#: Shares of an instance that are seen, and their names; a token is the number from 1 on.
_VISIBILITY = ((0.4, "v0-40"), (0.6, "v40-60"), (0.8, "v60-80"), (1.0, "v80-100"))
_MAP = "maps/none.png"
#: Attributes of annotations, as they are named, and what they say. Those of nuScenes itself
#: (``vehicle.moving``) go with its own categories.
_ATTRIBUTES = {
    "object.moving": "moves by 1 mm or turns by 1 mrad since the annotation before or to the next",
    "object.still": "neither moves nor turns since the annotation before and to the next",
}
_MOVED = 1e-3
#: Category of points without a label, as the devkit has it.
NOISE = "noise"


class Nuscenes(Format):
    """See the module."""

    name = "nuscenes"
    version = 2
    summary = "nuScenes tables: cameras, lidars, boxes, tracks of rigs (3D detection, tracking)"
    needs = ("rgb", "instance", "label")
    # Pictures are taken from the PNG.
    unused = ("rgb",)
    options: ClassVar = {
        "lidarseg": Option(
            "no",
            "the label of each lidar point, too; the devkit reads names of its own colors alone "
            "(flat.terrain, static.vegetation …): --remap gives them",
            ("no", "yes"),
        ),
        **trajectory.time_options(),
    }

    def __init__(self, info: Info) -> None:
        super().__init__(info)
        trajectory.start_ticks(self, _MICRO)
        self._segmented = self.option("lidarseg") == "yes"
        if self._segmented and max(_indices(info).values(), default=0) > 255:
            raise OutputError(
                f"format nuscenes, option lidarseg=yes: the level {info.level!r} has more than 255 "
                "labels; --remap makes fewer of them"
            )

    def holds(self, name: str) -> bool:
        """Holds pictures, and boxes of instances, whose class is a label."""
        return name in ("rgb", "instance", f"label.{self.info.level}")

    def tasks(self, splits: Mapping[str, Sequence[FrameRef]]) -> Iterator[Task]:
        """One a sample of a rig, with all of its cameras."""
        number = 0
        for split, frames in splits.items():
            for _, rig, cameras in trajectory.rigs(frames):
                every = sorted(itertools.chain(*cameras.values()), key=lambda ref: ref.sample)
                for _, refs in itertools.groupby(every, lambda ref: ref.sample):
                    yield Task(number, split, tuple(refs), (rig,))
                    number += 1

    def sources(self, task: Task) -> list[Path]:
        """Scans of the sample."""
        found = scans_of(task.frames[0], str(task.place[0]))
        return [path.with_suffix(".npz") for path in found]

    def write(
        self, task: Task, frames: Iterable[LoadedFrame], folder: Path, scratch: Path
    ) -> Written:
        """The pictures and scans of a sample; what tables say of it goes to ``scratch``."""
        written = Written()
        scene = f"{task.frames[0].batch_name}_{task.place[0]}"
        seen: dict[int, _Seen] = {}
        data: list[dict[str, Any]] = []
        ego, stamp, digest = None, 0, ""
        for frame in frames:
            require_pinhole(frame)
            if ego is None:
                ego = self._ego(task, frame)
                stamp = trajectory.stamp(self, frame, _MICRO)
                digest = frame.sidecar.stage_digest
            channel = _channel("CAM", frame.ref.camera, str(task.place[0]))
            name = _file(scene, channel, stamp, "png")
            trajectory.copy_picture(frame, folder / name)
            written.files.append(name)
            data.append(
                {
                    "channel": channel,
                    "modality": "camera",
                    "filename": name,
                    "fileformat": "png",
                    "width": frame.width,
                    "height": frame.height,
                    "pose": _pose(relative(ego, frame.camera_to_world)),
                    "intrinsic": opencv_intrinsics(frame).tolist(),
                }
            )
            self._see(frame, seen, written.left_out)
        if ego is None:
            return written
        hits: Counter[int] = Counter()
        index = _indices(self.info)
        for path in scans_of(task.frames[0], str(task.place[0])):
            cloud = read_cloud(path, self.info, digest)
            if cloud is None:
                _count(written.left_out, "scans of another stage; scan again", 1)
                continue
            channel = _channel("LIDAR", path.parent.name, str(task.place[0]))
            name = _file(scene, channel, stamp, "pcd.bin")
            hits.update(cloud.instances[cloud.instances > 0].tolist())
            row = np.column_stack([cloud.points, cloud.intensity * 255.0, cloud.ring])
            files = {name: row.astype("<f4")}
            if self._segmented:
                labels = [index.get(label, 0) for label in cloud.labels.tolist()]
                files[_segments(task.split, name)] = np.array(labels, "u1")
            for file, values in files.items():
                (folder / file).parent.mkdir(parents=True, exist_ok=True)
                with atomic(folder / file) as temporary:
                    temporary.write_bytes(values.tobytes())
                written.files.append(file)
            data.append(
                {
                    "channel": channel,
                    "modality": "lidar",
                    "filename": name,
                    "fileformat": "pcd",
                    "width": 0,
                    "height": 0,
                    "pose": _pose(relative(ego, cloud.to_world)),
                    "intrinsic": [],
                }
            )
        boxes = [one.entry(number, hits[number]) for number, one in sorted(seen.items())]
        entry = {"stamp": stamp, "ego": _pose(ego), "data": data, "boxes": boxes}
        write_json(scratch / f"{task.number:08d}.json", entry)
        written.record = {"scene": scene, "stamp": stamp}
        written.held = {"annotations": len(boxes)}
        return written

    def _ego(self, task: Task, frame: LoadedFrame) -> NDArray[np.float64]:
        """Pose of the rig, x ahead, y left, z up; of the first camera where the stage has none."""
        rig = self.info.rigs.of(frame.ref.batch_name).get(str(task.place[0]))
        pose = frame.camera_to_world if rig is None else rig.to_world[frame.ref.sample]
        return product(pose, LINK_POSE)

    def _see(self, frame: LoadedFrame, seen: dict[int, _Seen], left_out: dict[str, int]) -> None:
        """Adds what a camera sees of instances that are to be judged and have a label."""
        table = frame.table
        named = table[f"label.{self.info.level}"]
        for i in range(len(table["id"])):
            if frame.ignored[i] or not named[i]:
                what = "not to be judged" if frame.ignored[i] else "without one label"
                _count(left_out, f"instances {what}, each a picture", 1)
                continue
            number = int(table["id"][i])
            if number not in seen:
                seen[number] = _Seen({key: values[i] for key, values in table.items()}, named[i])
            whole = table["amodal_full"][i] if "amodal_full" in table else table["pixels"][i]
            seen[number].pixels += int(table["pixels"][i])
            seen[number].whole += int(whole)

    def finish(self, done: Iterable[Done], folder: Path, scratch: Path) -> list[str]:
        """Write the tables of each split, and the mask of their map."""
        written = []
        for split, group in itertools.groupby(done, lambda one: one.task.split):
            tables = _SplitTables(self.info, split)
            last: dict[str, tuple[int, str]] = {}
            for one in group:
                if one.record:
                    now = one.record["stamp"], one.task.frames[0].name
                    trajectory.check_rising(self, last.get(one.record["scene"]), now)
                    last[one.record["scene"]] = now
                    path = scratch / f"{one.task.number:08d}.json"
                    tables.add(one.record["scene"], json.loads(path.read_bytes()))
            for name, rows in tables.rows().items():
                write_json(folder / f"v1.0-{split}/{name}.json", rows)
                written.append(f"v1.0-{split}/{name}.json")
        if written:
            write_png(folder / _MAP, np.zeros((1, 1), np.uint8))
            written.append(_MAP)
        return written

    def usage(self) -> str:
        """The layout, and how to load it."""
        return (
            "nuScenes: tables in `v1.0-<split>/`, pictures and scans in `samples/<channel>/`. Load "
            'with nuscenes-devkit: `NuScenes("v1.0-all", dataroot=FOLDER)`. A scene is a rig\'s '
            "drive in a batch; `ego_pose` is the rig (x ahead, y left, z up) in the world (meters, "
            "Z up), a camera's axes are x right, y down, z forward, a lidar's x ahead, y left, z "
            "up. Boxes are the exact bounding boxes along each object's own axes, of all instances "
            "that a camera of the sample shows in a pixel; `size` is width (y), length (x), height "
            "(z). `visibility` is the share of its pixels that show it, over all cameras; "
            "`num_lidar_pts` counts the answers of all lidars by instance. Categories are the "
            f"labels of the level `{self.info.level}`; `lidarseg`, where it is asked for, has that "
            "of each point (0: none). Attributes say whether an object moves between its "
            f"annotations. There are no radar and no sweeps; the one map is empty (`{_MAP}`)."
        )


class _Seen:
    """Holds what the cameras of a sample show of an instance."""

    def __init__(self, row: Mapping[str, Any], label: str) -> None:
        self.row, self.label = row, str(label)
        self.pixels = self.whole = 0

    def entry(self, number: int, points: int) -> dict[str, Any]:
        """What ``sample_annotation`` says of it."""
        row = self.row
        x, y, z, w = (float(row[f"q{axis}"]) for axis in "xyzw")
        # The middle of the box: position + R(q) box.
        box = np.array([row[f"box_{axis}"] for axis in "xyz"], np.float64)
        turned = box + 2.0 * np.cross([x, y, z], np.cross([x, y, z], box) + w * box)
        share = self.pixels / max(self.whole, 1)
        level = next((i for i, (most, _) in enumerate(_VISIBILITY, 1) if share <= most), 4)
        length, width, height = (float(row[f"size_{axis}"]) for axis in "xyz")
        return {
            "number": number,
            "label": self.label,
            "visibility": str(level),
            "translation": [float(row[axis]) + float(turned[i]) for i, axis in enumerate("xyz")],
            "size": [width, length, height],
            "rotation": [w, x, y, z],
            "points": points,
        }


class _SplitTables:
    """Builds the tables of a split, row by row, in the order of its samples."""

    def __init__(self, info: Info, split: str) -> None:
        self._split = split
        self._rows: dict[str, dict[str, dict[str, Any]]] = {name: {} for name in TABLES}
        #: What a row follows: a scene's sample, a channel's data, an instance's annotation.
        self._last: dict[str, dict[str, Any]] = {}
        self._name = info.name
        self._segmented = info.options.get("lidarseg") == "yes"
        if self._segmented:
            # Points of no label have 0; the devkit counts categories from there.
            self._put("category", NOISE, name=NOISE, description="", index=0)
        for number, index in _indices(info).items():
            label = info.labels[info.level][number]
            self._put("category", label, name=label, description="", index=index)
        for i, (_, level) in enumerate(_VISIBILITY, 1):
            description = f"visibility of the whole object is {level[1:]} %"
            row = {"token": str(i), "level": level, "description": description}
            self._rows["visibility"][str(i)] = row

    def _put(self, table: str, named: str, **values: Any) -> dict[str, Any]:
        """A row by what it is named by, made if it is not there."""
        token = _token(table, self._split, named)
        made: dict[str, Any] = self._rows[table].setdefault(token, {"token": token, **values})
        return made

    def _follow(self, row: dict[str, Any], line: str) -> None:
        """Links a row to the one before it in its line."""
        before = self._last.get(line)
        row["prev"], row["next"] = "" if before is None else before["token"], ""
        if before is not None:
            before["next"] = row["token"]
        self._last[line] = row

    def add(self, name: str, entry: Mapping[str, Any]) -> None:
        """Adds a sample of the scene ``name``."""
        log = self._put(
            "log", "", logfile=self._name, vehicle="", date_captured="", location=self._name
        )
        self._put("map", "", log_tokens=[log["token"]], category="semantic_prior", filename=_MAP)
        scene = self._put(
            "scene", name, name=name, description="", log_token=log["token"], nbr_samples=0
        )
        stamp = entry["stamp"]
        sample = self._put("sample", f"{name} {stamp}", timestamp=stamp, scene_token=scene["token"])
        self._follow(sample, f"sample {name}")
        scene["nbr_samples"] += 1
        scene.setdefault("first_sample_token", sample["token"])
        scene["last_sample_token"] = sample["token"]
        ego = self._put("ego_pose", f"{name} {stamp}", **entry["ego"], timestamp=stamp)
        for one in entry["data"]:
            self._data(name, sample, ego, one)
        for one in entry["boxes"]:
            self._annotation(name, sample, one)

    def _data(
        self, scene: str, sample: Mapping[str, Any], ego: Mapping[str, Any], one: Mapping[str, Any]
    ) -> None:
        channel = one["channel"]
        sensor = self._put("sensor", channel, channel=channel, modality=one["modality"])
        values = {**one["pose"], "camera_intrinsic": one["intrinsic"]}
        # What is fixed to the rig is one to within the rounding of poses in the world.
        key = json.dumps({k: np.round(v, 6).tolist() for k, v in values.items()})
        calibrated = self._put(
            "calibrated_sensor", f"{scene} {channel} {key}", sensor_token=sensor["token"], **values
        )
        row = self._put(
            "sample_data",
            one["filename"],
            sample_token=sample["token"],
            ego_pose_token=ego["token"],
            calibrated_sensor_token=calibrated["token"],
            filename=one["filename"],
            fileformat=one["fileformat"],
            width=one["width"],
            height=one["height"],
            timestamp=sample["timestamp"],
            is_key_frame=True,
        )
        self._follow(row, f"data {scene} {channel}")
        if self._segmented and one["modality"] == "lidar":
            name = _segments(self._split, one["filename"])
            segments = self._put("lidarseg", name, sample_data_token=row["token"], filename=name)
            # The devkit looks for it by the token of the scan.
            segments["token"] = row["token"]

    def _annotation(self, scene: str, sample: Mapping[str, Any], one: Mapping[str, Any]) -> None:
        name = f"{scene} {one['number']}"
        category = self._put("category", one["label"])
        instance = self._put("instance", name, category_token=category["token"], nbr_annotations=0)
        row = self._put(
            "sample_annotation",
            f"{name} {sample['timestamp']}",
            sample_token=sample["token"],
            instance_token=instance["token"],
            attribute_tokens=[],
            visibility_token=one["visibility"],
            translation=one["translation"],
            size=one["size"],
            rotation=one["rotation"],
            num_lidar_pts=one["points"],
            num_radar_pts=0,
        )
        self._follow(row, f"annotation {name}")
        instance["nbr_annotations"] += 1
        instance.setdefault("first_annotation_token", row["token"])
        instance["last_annotation_token"] = row["token"]

    def rows(self) -> dict[str, list[dict[str, Any]]]:
        """Returns the tables, each row with the schema's fields in their order."""
        annotations = self._rows["sample_annotation"]
        for row in annotations.values():
            near = [annotations[row[side]] for side in ("prev", "next") if row[side]]
            # Of an object that is annotated once nobody knows.
            if near:
                place, attitude = row["translation"], row["rotation"]
                moves = (
                    moved(place, attitude, one["translation"], one["rotation"]) for one in near
                )
                name = "object.moving" if any(moves) else "object.still"
                made = self._put("attribute", name, name=name, description=_ATTRIBUTES[name])
                row["attribute_tokens"] = [made["token"]]
        return {
            table: [{field: row[field] for field in fields} for row in self._rows[table].values()]
            for table, fields in TABLES.items()
            if table != "lidarseg" or self._segmented
        }


def moved(
    place: Sequence[float],
    attitude: Sequence[float],
    other_place: Sequence[float],
    other_attitude: Sequence[float],
) -> bool:
    """Tells whether two annotations of an object differ in place or attitude (quaternions)."""
    off = np.subtract(place, other_place)
    # Half the angle's sine, of quaternions that may differ in sign.
    turn = min(
        np.abs(np.subtract(attitude, np.multiply(other_attitude, sign))).max()
        for sign in (1.0, -1.0)
    )
    return bool(np.abs(off).max() > _MOVED or turn > 0.5 * _MOVED)


def _token(table: str, split: str, named: str) -> str:
    """A row's token: a digest of what it is named by."""
    return hashlib.sha256(f"{table} {split} {named}".encode()).hexdigest()[:32]


def _segments(split: str, scan: str) -> str:
    """File of the labels of a scan's points, named by the token of its row in ``sample_data``."""
    return f"lidarseg/v1.0-{split}/{_token('sample_data', split, scan)}_lidarseg.bin"


def _indices(info: Info) -> dict[int, int]:
    """Label -> its category's index: from 1 on without gaps, as the devkit counts them."""
    names = info.labels.get(info.level, {})
    named = [number for number, name in names.items() if name != NOISE]
    return dict.fromkeys(names, 0) | {number: i for i, number in enumerate(named, 1)}


def _channel(kind: str, sensor: str, rig: str) -> str:
    """``CAM_LEFT`` of ``rover_left`` on the rig ``rover``."""
    return f"{kind}_{sensor.removeprefix(f'{rig}_').upper()}"


def _file(scene: str, channel: str, stamp: int, ending: str) -> str:
    return f"samples/{channel}/{scene}__{channel}__{stamp}.{ending}"


def _pose(pose: NDArray[np.float64]) -> dict[str, list[float]]:
    x, y, z, w = quaternion(pose[:3, :3]).tolist()
    return {"translation": pose[:3, 3].tolist(), "rotation": [w, x, y, z]}


def _count(left_out: dict[str, int], what: str, number: int) -> None:
    left_out[what] = left_out.get(what, 0) + number
