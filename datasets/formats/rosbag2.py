"""ROS 2 bags (MCAP): one a batch, all its cameras in it.

::

    bags.csv                                   what each bag is
    <split>/<batch>/metadata.yaml, <batch>.mcap

======================================  ===========================  ===============================
topic                                   type                         what
======================================  ===========================  ===============================
``/<camera>/image_raw``                 ``sensor_msgs/Image``        ``rgb8``
``/<camera>/camera_info``               ``sensor_msgs/CameraInfo``   K, D, R = 1, P
``/<camera>/clean/image_raw``           ``sensor_msgs/Image``        ``rgb8``, without noise
``/<camera>/mosaic/image_raw``          ``sensor_msgs/Image``        ``bayer_rggb16`` and its like
``/<camera>/depth/image_raw``           ``sensor_msgs/Image``        ``32FC1``, meters, +inf: no hit
``/<camera>/label/<level>/image_raw``   ``sensor_msgs/Image``        ``16UC1``; ``32SC1`` if too few
``/<camera>/instance/image_raw``        ``sensor_msgs/Image``        ``32SC1``, 0: none
``/<camera>/disparity``                 ``stereo_msgs/DisparityImage``  of a pair's left camera
``/<camera>/pose``                      ``geometry_msgs/PoseStamped``  of the camera in the world
``/tf``                                 ``tf2_msgs/TFMessage``       world to ``<camera>_optical``,
                                                                     and to ``<rig>``
``/tf_static``                          ``tf2_msgs/TFMessage``       to ``<camera>_link``
======================================  ===========================  ===============================

``<camera>_optical`` has x right, y down, z forward; ``<camera>_link`` x forward, y left, z up
(REP 103). Frames know the poses of cameras alone, so ``<rig>`` is where the ``<camera>_link`` of
its first camera by name is. Depth without a hit is +inf (REP 118). Label names stand in the bag's
custom data, as JSON under ``labels``.

Two cameras of a rig that are a rectified pair (``formats.stereo``) have one K; the right one's P
has -fx B in its fourth column. Disparity is d = x_left - x_right, so depth is f T / d; -1 where the
right camera has the point behind it.

Time stamps are the stage's, to the nanosecond. Time 0 means "the latest" to tf: a bag that begins
there is warned of; the option ``start_s`` moves all stamps.
"""

from __future__ import annotations

import importlib.util
import itertools
import json
import os
import re
import shutil
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, ClassVar, Literal

import numpy as np
from numpy.typing import NDArray

from scenec.datasets import pictures
from scenec.datasets.formats import trajectory
from scenec.datasets.formats.contract import Done, Format, Info, Option, Task, Written
from scenec.datasets.formats.poses import distortion, opencv_intrinsics, product
from scenec.datasets.formats.stereo import baseline, pair_up, partner_of
from scenec.datasets.source import FrameRef, LoadedFrame
from scenec.schemas.codec import UNSET
from scenec.schemas.errors import FrameError, OutputError
from scenec.schemas.files import temporary_folder
from scenec.schemas.frames import BESIDE
from scenec.schemas.lens import BROWN_CONRADY, KANNALA_BRANDT
from scenec.schemas.quaternions import quaternion

#: What sensor_msgs/CameraInfo calls lenses of ours, and how many of their coefficients it takes.
_LENSES = {
    BROWN_CONRADY: [("plumb_bob", 5), ("rational_polynomial", 8)],
    KANNALA_BRANDT: [("equidistant", 4)],
}
_NANO = 1_000_000_000
#: builtin_interfaces/Time counts seconds in 32 bits with sign.
_LAST = 2**31 * _NANO
#: The oldest one whose messages these are; later ones read them alike.
_METADATA_VERSION: Literal[8] = 8
#: x forward, y left, z up in the axes of a camera (x right, y down, z forward).
_LINK_POSE = np.array([[0.0, -1, 0, 0], [0, 0, -1, 0], [1, 0, 0, 0], [0, 0, 0, 1]])
_COLUMNS = ("bag", "split", "batch", "cameras", "frames", "messages")


class Rosbag2(Format):
    """See the module."""

    name = "rosbag2"
    summary = "ROS 2 bags (MCAP): images, depth, labels, camera info, tf, poses; one a batch"
    version = 2
    # Pictures are taken from the PNG.
    unused = ("rgb",)
    beside = BESIDE
    options: ClassVar = {
        "compression": Option("zstd", "of the MCAP's chunks", ("zstd", "none"), neutral=True),
        **trajectory.time_options(),
    }

    def __init__(self, info: Info) -> None:
        super().__init__(info)
        if importlib.util.find_spec("rosbags") is None:
            raise OutputError("format rosbag2 needs rosbags: pip install 'scenec[ros]'")
        trajectory.start_ticks(self, _NANO)

    def holds(self, name: str) -> bool:
        """Holds what there are messages for."""
        return name.partition(".")[0] in ("rgb", "depth", "label", "instance", "disparity")

    def tasks(self, splits: Mapping[str, Sequence[FrameRef]]) -> Iterator[Task]:
        """One a batch, its frames in order of samples."""
        number = 0
        for split, frames in splits.items():
            for _, members in itertools.groupby(frames, lambda ref: ref.batch_name):
                in_time = sorted(members, key=lambda ref: (ref.sample, ref.camera))
                yield Task(number, split, tuple(in_time))
                number += 1

    def remarks(self, splits: Mapping[str, Sequence[FrameRef]]) -> Iterator[str]:
        """Warns of bags that begin at the time 0."""
        found = [
            task.frames[0].batch_name
            for task in self.tasks(splits)
            if trajectory.stamp_on_disk(self, task.frames[0], _NANO) == 0
        ]
        if found:
            more = f" (and {len(found) - 1} more bags)" if found[1:] else ""
            yield (
                f"{found[0]}{more}: begins at 0 s, which tf takes for the latest time there is; "
                "--set start_s=1 adds a second to all time stamps"
            )

    def write(
        self, task: Task, frames: Iterable[LoadedFrame], folder: Path, scratch: Path
    ) -> Written:
        """Write a batch's bag, frame by frame."""
        name = task.frames[0].batch_name
        place = f"{task.split}/{name}"
        cameras = _ros_names(sorted({ref.camera for ref in task.frames}), "camera")
        # In scratch: a bag that was cut short must not stay in the dataset.
        with temporary_folder(scratch) as temporary:
            # Of the same name: the writer puts it into the bag.
            bag = _Bag(self, temporary / name, cameras, task.frames)
            count = bag.write(frames)
            (folder / place).parent.mkdir(parents=True, exist_ok=True)
            # What an export that was cut short left: nothing vouches for it.
            shutil.rmtree(folder / place, ignore_errors=True)
            os.rename(temporary / name, folder / place)
        return Written(
            [f"{place}/metadata.yaml", f"{place}/{name}.mcap"],
            {"cameras": " ".join(cameras.values()), "frames": count, "messages": bag.messages},
            bag.left_out,
        )

    def finish(self, done: Iterable[Done], folder: Path, scratch: Path) -> list[str]:
        """Write the list of bags."""
        lines = [
            (
                f"{one.task.split}/{one.task.frames[0].batch_name}",
                one.task.split,
                one.task.frames[0].batch_name,
                *(one.record[key] for key in _COLUMNS[3:]),
            )
            for one in done
            if one.record is not None
        ]
        trajectory.write_table(folder / "bags.csv", _COLUMNS, lines)
        return ["bags.csv"]

    def usage(self) -> str:
        """Topics and conventions."""
        return (
            "ROS 2 bags (MCAP), one a batch: `ros2 bag play <split>/<batch>`. Per camera: "
            "`/<camera>/image_raw` (rgb8), `/<camera>/camera_info`, `/<camera>/depth/image_raw` "
            "(32FC1, meters along the optical axis, +inf without a hit), "
            "`/<camera>/label/<level>/image_raw` (16UC1, or 32SC1 where ids need it), "
            "`/<camera>/instance/image_raw` (32SC1), `/<camera>/pose`, `/<camera>/disparity` "
            "(`stereo_msgs/DisparityImage`, of the left camera of a pair); `/tf` has world to "
            "`<camera>_optical` (x right, y down, z forward), `/tf_static` from there to "
            "`<camera>_link` (x forward, y left, z up); `<rig>` in `/tf` is where the link of its "
            "first camera by name is. The world is in meters, Z up. Time stamps are the stage's, "
            f"{self.option('start_s')} s added. Names of labels: `custom_data` in `metadata.yaml`."
        )


class _Bag:
    """A bag while it is written."""

    def __init__(
        self,
        form: Rosbag2,
        path: Path,
        cameras: Mapping[str, str],
        frames: Sequence[FrameRef],
    ) -> None:
        from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
        from rosbags.typesys import Stores, get_typestore

        self.form = form
        self.messages = 0
        self._path = path
        self._cameras = cameras
        self._levels = _ros_names(sorted(form.info.labels), "label level")
        self._store = get_typestore(Stores.ROS2_HUMBLE)
        self._types = self._store.types
        self._writer = Writer(path, version=_METADATA_VERSION, storage_plugin=StoragePlugin.MCAP)
        if form.option("compression") == "zstd":
            self._writer.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
        self._topics: dict[str, Any] = {}
        self.left_out: Counter[str] = Counter()
        #: Left camera of each pair -> right one and meters between; right one -> these meters.
        self._pairs: dict[str, tuple[str, float]] = {}
        self._right: dict[str, float] = {}
        #: First camera of each rig -> its name as a frame.
        self._rigs: dict[str, str] = {}
        self._look_at_rigs(frames)

    def _look_at_rigs(self, frames: Sequence[FrameRef]) -> None:
        rigs = trajectory.rigs(sorted(frames, key=lambda ref: (ref.camera, ref.sample)))
        names = _rig_frames([r for _, r, members in rigs if r not in members], self._cameras)
        for _, rig, members in rigs:
            if rig in names:
                self._rigs[next(iter(members))] = names[rig]
            for pair in pair_up(members):
                if len(pair) == 2:
                    apart = baseline(*(members[name] for name in pair))
                    self._pairs[pair[0]], self._right[pair[1]] = (pair[1], apart), apart
                elif partner_of(members[pair[0]]) in members:
                    self.left_out["cameras that make no rectified pair with their partner: P "
                                  "does not say where that is"] += 1  # fmt: skip

    def write(self, frames: Iterable[LoadedFrame]) -> int:
        """Write all frames; returns their number.

        Raises:
            OutputError: Something does not fit into a message.
        """
        labels = {
            level: {str(number): text for number, text in names.items()}
            for level, names in self.form.info.labels.items()
        }
        self._writer.set_custom_data("labels", json.dumps(labels, sort_keys=True))
        before: dict[str, tuple[int, str]] = {}
        count = 0
        with self._writer:
            for frame in frames:
                now = self._stamp(frame), frame.ref.name
                trajectory.check_rising(self.form, before.get(frame.ref.camera), now)
                if not before:
                    self._static(now[0])
                before[frame.ref.camera] = now
                self._frame(frame, now[0])
                count += 1
        return count

    def _stamp(self, frame: LoadedFrame) -> int:
        stamp = trajectory.stamp(self.form, frame, _NANO)
        if stamp >= _LAST:
            raise OutputError(
                f"{frame.ref.name}: its time stamp is {trajectory.as_seconds(stamp, _NANO)} s, and "
                "ROS knows those below 2147483648 s; give the option start_s, or times=samples"
            )
        return stamp

    def _frame(self, frame: LoadedFrame, stamp: int) -> None:
        camera = self._cameras[frame.ref.camera]
        optical = f"{camera}_optical"
        pose = frame.camera_to_world
        links = [("world", optical, pose)]
        if frame.ref.camera in self._rigs:
            links.append(("world", self._rigs[frame.ref.camera], product(pose, _LINK_POSE)))
        self._put("/tf", self._tf(links, stamp), stamp)
        self._put(f"/{camera}/camera_info", self._info(frame, optical, stamp), stamp)
        images: list[tuple[str, str, NDArray[Any]]] = []
        if frame.png is not None:
            images.append(("image_raw", "rgb8", trajectory.color_pixels(frame)))
        for kind in pictures.kinds(frame.sidecar):
            beside = pictures.beside(frame, kind)
            if kind == "raw":
                bayer = f"bayer_{pictures.mosaic(frame.sidecar)}16"
                images.append(("mosaic/image_raw", bayer, beside.astype("<u2")))
            else:
                images.append((f"{kind}/image_raw", "rgb8", beside))
        if "depth" in frame.passes:
            depth = frame.passes["depth"].astype("<f4")
            images.append(("depth/image_raw", "32FC1", depth))
        for level, topic in self._levels.items():
            ids = frame.passes.get(f"label.{level}")
            if ids is not None:
                largest = max(self.form.info.labels[level], default=0)
                encoding = "16UC1" if largest < 2**16 else "32SC1"
                images.append((f"label/{topic}/image_raw", encoding, _ids(frame, ids, encoding)))
        if "instance" in frame.passes:
            ids = _ids(frame, frame.passes["instance"], "32SC1")
            images.append(("instance/image_raw", "32SC1", ids))
        for topic, encoding, pixels in images:
            self._put(f"/{camera}/{topic}", self._image(pixels, encoding, optical, stamp), stamp)
        if "disparity" in frame.passes:
            self._disparity(frame, optical, stamp)
        self._put(f"/{camera}/pose", self._pose(pose, stamp), stamp)

    def _disparity(self, frame: LoadedFrame, optical: str, stamp: int) -> None:
        """Writes disparity of a pair's left camera, the only one that there is a message for."""
        name = frame.ref.camera
        other, apart = self._pairs.get(name, ("", 0.0))
        if not apart or frame.lens is not None or frame.sidecar.partner not in (UNSET, other):
            what = "of right cameras" if name in self._right else "to no camera of a rectified pair"
            self.left_out[f"pictures of disparity {what}, for which ROS has no message"] += 1
            return
        values = frame.passes["disparity"].astype("<f4")
        known = np.isfinite(values)
        values = np.where(known, np.maximum(values, np.float32(0.0)), np.float32(-1.0))
        kind = self._types["stereo_msgs/msg/DisparityImage"]
        region = self._types["sensor_msgs/msg/RegionOfInterest"]
        message = kind(
            header=self._header(optical, stamp),
            image=self._image(values, "32FC1", optical, stamp),
            f=float(frame.intrinsics[0, 0]),
            t=apart,
            valid_window=region(0, 0, frame.height, frame.width, False),
            min_disparity=0.0,
            max_disparity=max(float(values.max()), 0.0),
            delta_d=0.0,
        )
        self._put(f"/{self._cameras[name]}/disparity", message, stamp)

    def _static(self, stamp: int) -> None:
        links = [(f"{c}_optical", f"{c}_link", _LINK_POSE) for c in self._cameras.values()]
        self._put("/tf_static", self._tf(links, stamp), stamp, latched=True)

    def _put(self, topic: str, message: Any, stamp: int, latched: bool = False) -> None:
        kind = message.__msgtype__
        if topic not in self._topics:
            self._topics[topic] = self._writer.add_connection(
                topic, kind, typestore=self._store, offered_qos_profiles=[_qos(latched)]
            )
        data = self._store.serialize_cdr(message, kind)
        self._writer.write(self._topics[topic], stamp, data)
        self.messages += 1

    def _header(self, frame_id: str, stamp: int) -> Any:
        time = self._types["builtin_interfaces/msg/Time"](stamp // _NANO, stamp % _NANO)
        return self._types["std_msgs/msg/Header"](time, frame_id)

    def _image(self, pixels: NDArray[Any], encoding: str, frame_id: str, stamp: int) -> Any:
        rows = np.ascontiguousarray(pixels)
        return self._types["sensor_msgs/msg/Image"](
            header=self._header(frame_id, stamp),
            height=rows.shape[0],
            width=rows.shape[1],
            encoding=encoding,
            is_bigendian=0,
            step=rows.strides[0],
            data=rows.view(np.uint8).reshape(-1),
        )

    def _info(self, frame: LoadedFrame, frame_id: str, stamp: int) -> Any:
        k = opencv_intrinsics(frame)
        lens = distortion(frame, _LENSES)
        model, coefficients = ("plumb_bob", [0.0] * 5) if lens is None else lens
        p = np.zeros((3, 4))
        p[:, :3] = k
        if frame.ref.camera in self._right:
            p[0, 3] = -k[0, 0] * self._right[frame.ref.camera]
        region = self._types["sensor_msgs/msg/RegionOfInterest"](0, 0, 0, 0, False)
        return self._types["sensor_msgs/msg/CameraInfo"](
            header=self._header(frame_id, stamp),
            height=frame.height,
            width=frame.width,
            distortion_model=model,
            d=np.array(coefficients, np.float64),
            k=k.reshape(-1),
            r=np.eye(3).reshape(-1),
            p=p.reshape(-1),
            binning_x=0,
            binning_y=0,
            roi=region,
        )

    def _pose(self, pose: NDArray[np.float64], stamp: int) -> Any:
        place, turn = self._place(pose)
        point = self._types["geometry_msgs/msg/Point"](*place)
        value = self._types["geometry_msgs/msg/Pose"](point, turn)
        header = self._header("world", stamp)
        return self._types["geometry_msgs/msg/PoseStamped"](header, value)

    def _tf(self, links: Sequence[tuple[str, str, NDArray[np.float64]]], stamp: int) -> Any:
        found = []
        for parent, child, pose in links:
            place, turn = self._place(pose)
            vector = self._types["geometry_msgs/msg/Vector3"](*place)
            transform = self._types["geometry_msgs/msg/Transform"](vector, turn)
            found.append(
                self._types["geometry_msgs/msg/TransformStamped"](
                    self._header(parent, stamp), child, transform
                )
            )
        return self._types["tf2_msgs/msg/TFMessage"](found)

    def _place(self, pose: NDArray[np.float64]) -> tuple[list[float], Any]:
        turn = self._types["geometry_msgs/msg/Quaternion"](*quaternion(pose[:3, :3]).tolist())
        return pose[:3, 3].tolist(), turn


def _qos(latched: bool) -> Any:
    """Reliable; ``/tf_static`` reaches those that come late, too."""
    from rosbags.interfaces import (
        Qos,
        QosDurability,
        QosHistory,
        QosLiveliness,
        QosReliability,
        QosTime,
    )

    forever = QosTime(9223372036, 854775807)
    return Qos(
        QosHistory.KEEP_LAST,
        1 if latched else 10,
        QosReliability.RELIABLE,
        QosDurability.TRANSIENT_LOCAL if latched else QosDurability.VOLATILE,
        forever,
        forever,
        QosLiveliness.AUTOMATIC,
        forever,
        False,
    )


def _ids(frame: LoadedFrame, ids: NDArray[Any], encoding: str) -> NDArray[Any]:
    """Ids in as many bits as an encoding has.

    Raises:
        FrameError: One needs more.
    """
    kind = "<u2" if encoding == "16UC1" else "<i4"
    largest = int(ids.max(initial=0))
    if largest > np.iinfo(kind).max:
        raise FrameError(
            f"{frame.ref.stem}.exr: has the id {largest}, and {encoding} holds at most "
            f"{np.iinfo(kind).max}"
        )
    return ids.astype(kind)


def _rig_frames(rigs: Sequence[str], cameras: Mapping[str, str]) -> dict[str, str]:
    """Names the frames of rigs, none as the world or as a frame of a camera.

    Args:
        rigs: Names in the stage.
        cameras: Names in the stage, and in the bag.
    """
    taken = {
        "world",
        *(f"{name}_{end}" for name in cameras.values() for end in ("optical", "link")),
    }
    named = _ros_names(rigs, "rig")
    return {rig: f"{name}_rig" if name in taken else name for rig, name in named.items()}


def _ros_names(names: Sequence[str], what: str) -> dict[str, str]:
    """Names as a ROS topic may have them: letters, digits, single underscores, no digit first.

    Raises:
        OutputError: Two become one.
    """
    found: dict[str, str] = {}
    for name in names:
        text = re.sub(r"_+", "_", re.sub(r"[^A-Za-z0-9_]", "_", name)).strip("_") or what[0]
        text = f"{what[0]}{text}" if text[0].isdigit() else text
        for other, taken in found.items():
            if taken == text:
                raise OutputError(
                    f"format rosbag2: {what} {name!r} and {other!r} would both be {text!r} as a "
                    "ROS topic; export them apart with --cameras"
                )
        found[name] = text
    return found
