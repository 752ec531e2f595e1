"""ROS 2 bags (MCAP): one a batch, all its cameras in it.

::

    bags.csv                                   what each bag is
    <split>/<batch>/metadata.yaml, <batch>.mcap

======================================  ===========================  ===============================
topic                                   type                         what
======================================  ===========================  ===============================
``/<camera>/image_raw``                 ``sensor_msgs/Image``        ``rgb8``
``/<camera>/camera_info``               ``sensor_msgs/CameraInfo``   K, D, R, P
``/<camera>/clean/image_raw``           ``sensor_msgs/Image``        ``rgb8``, without noise
``/<camera>/mosaic/image_raw``          ``sensor_msgs/Image``        ``bayer_rggb16`` and its like
``/<camera>/depth/image_raw``           ``sensor_msgs/Image``        ``32FC1``, meters, +inf: no hit
``/<camera>/label/<level>/image_raw``   ``sensor_msgs/Image``        ``16UC1``; ``32SC1`` if too few
``/<camera>/instance/image_raw``        ``sensor_msgs/Image``        ``32SC1``, 0: none
``/<camera>/disparity``                 ``stereo_msgs/DisparityImage``  of a pair's left camera
``/<camera>/pose``                      ``geometry_msgs/PoseStamped``  of the camera in the world
``/<rig>_<imu>``                        ``sensor_msgs/Imu``          at the IMU's own rate
``/<rig>_<lidar>``                      ``sensor_msgs/PointCloud2``  x, y, z, ring, time (0); also
                                                                     intensity, return if the scan
                                                                     has them
``/<rig>/odom``, ``/<rig>/path``        ``nav_msgs/Odometry, Path``  where the rig truly is
``/tf``                                 ``tf2_msgs/TFMessage``       world to ``<rig>``
``/tf_static``                          ``tf2_msgs/TFMessage``       ``<rig>`` to what it carries
======================================  ===========================  ===============================

Where the stage says so, ``<rig>`` is the rig's frame, and ``<camera>_link`` (both x forward, y
left, z up; REP 103), ``<rig>_<imu>`` and ``<rig>_<lidar>`` are fixed to it; ``<camera>_optical``
(x right, y down, z forward) is fixed to the camera's link. Of a camera that is on no rig of the
stage, or moves on it, ``/tf`` has the link itself; a rig that the stage does not tell of is where
the link of its first camera by name is. Depth without a hit is +inf (REP 118). Label names stand in
the bag's custom data, as JSON under ``labels``.

Two cameras of a rig that are a rectified pair (``formats.stereo``) have one K; the right one's P
has -fx B in its fourth column. Others that are partners have the R and P of the rectified pair that
they make (``formats.rectify``). Disparity is d = x_left - x_right, so depth is f T / d; -1 where
the right camera has the point behind it.

The option ``topics`` names those of one rig as a SLAM package looks for them (``rosbag2_names``).
That package places the rig itself: what it carries is then fixed to ``base_link``, which is in no
world, and where it truly is has the frame ``ground_truth``.

Time stamps are the stage's, to the nanosecond. Time 0 means "the latest" to tf: a bag that begins
there is warned of; the option ``start_s`` moves all stamps.
"""

from __future__ import annotations

import importlib.util
import itertools
import json
import os
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
from scenec.datasets.formats.rosbag2_messages import NANO, Messages
from scenec.datasets.formats.rosbag2_names import BODY, LAYOUTS, TRUTH, ros_names
from scenec.datasets.formats.rosbag2_rigs import RigsOfBag, Stamped, scan_folder
from scenec.datasets.source import FrameRef, LoadedFrame
from scenec.schemas.codec import UNSET
from scenec.schemas.errors import FrameError, OutputError
from scenec.schemas.files import temporary_folder
from scenec.schemas.frames import BESIDE

_NANO = NANO
#: builtin_interfaces/Time counts seconds in 32 bits with sign.
_LAST = 2**31 * _NANO
#: The oldest one whose messages these are; later ones read them alike.
_METADATA_VERSION: Literal[8] = 8
_COLUMNS = ("bag", "split", "batch", "cameras", "frames", "messages")


class Rosbag2(Format):
    """See the module."""

    name = "rosbag2"
    summary = "ROS 2 bags (MCAP): images, depth, labels, camera info, tf, poses; one a batch"
    version = 5
    # Pictures are taken from the PNG.
    unused = ("rgb",)
    beside = BESIDE
    options: ClassVar = {
        "topics": Option(
            "scenec", "names of topics: scenec's, or those that a package looks for", (*LAYOUTS,)
        ),
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
        """Warns of bags that begin at the time 0, and of IMUs whose stamps would be no times."""
        if self.option("times") == "samples":
            yield trajectory.NO_IMUS
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

    def sources(self, task: Task) -> list[Path]:
        """The sidecars of a batch's scans, which state the digests of these."""
        return sorted(scan_folder(task.frames).glob("*/*.json"))

    def write(
        self, task: Task, frames: Iterable[LoadedFrame], folder: Path, scratch: Path
    ) -> Written:
        """Write a batch's bag, frame by frame."""
        name = task.frames[0].batch_name
        place = f"{task.split}/{name}"
        cameras = ros_names(sorted({ref.camera for ref in task.frames}), "camera")
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
            "(`stereo_msgs/DisparityImage`, of the left camera of a pair); `/<rig>_<imu>`, "
            "`/<rig>_<lidar>`, `/<rig>/odom`, `/<rig>/path`; `/tf` has world to `<rig>`, "
            "`/tf_static` from there to `<camera>_link` (x forward, y left, z up), `<rig>_<imu>` "
            "and `<rig>_<lidar>`, and from a link to `<camera>_optical` (x right, y down, z "
            f"forward). {self._layout()}The world is in meters, Z up. Time stamps are the stage's, "
            f"{self.option('start_s')} s added. Names of labels: `custom_data` in `metadata.yaml`."
        )

    def _layout(self) -> str:
        if self.option("topics") == "scenec":
            return ""
        return (
            f"Topics of the first rig are named as {self.option('topics')} looks for them; what it "
            f"carries is fixed to `{BODY}`, and `{TRUTH}` is where that is in the world. "
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
        self.left_out: Counter[str] = Counter()
        self._cameras = cameras
        self._levels = ros_names(sorted(form.info.labels), "label level")
        self._store = get_typestore(Stores.ROS2_HUMBLE)
        self._make = Messages(self._store.types)
        self._writer = Writer(path, version=_METADATA_VERSION, storage_plugin=StoragePlugin.MCAP)
        if form.option("compression") == "zstd":
            self._writer.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
        self._connections: dict[str, Any] = {}
        self._rigs = RigsOfBag(form, cameras, frames, self.left_out)

    def write(self, frames: Iterable[LoadedFrame]) -> int:
        """Write all frames, and what else the rigs measure, in time; returns the frames' number.

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
        readings: Iterator[Stamped] = iter(())
        waiting: Stamped | None = None
        with self._writer:
            for frame in frames:
                now = self._stamp(frame), frame.ref.name
                trajectory.check_rising(self.form, before.get(frame.ref.camera), now)
                if not before:
                    for topic, message in self._rigs.latched(self._make, now[0]):
                        self._put(topic, message, now[0], latched=True)
                    readings = self._rigs.readings(self._make, frame.sidecar.stage_digest)
                    waiting = next(readings, None)
                waiting = self._put_until(now[0], waiting, readings)
                before[frame.ref.camera] = now
                self._frame(frame, now[0])
                count += 1
            self._put_until(_LAST, waiting, readings)
        return count

    def _put_until(
        self, stamp: int, waiting: Stamped | None, readings: Iterator[Stamped]
    ) -> Stamped | None:
        """Writes readings up to a time; returns the first one after it."""
        while waiting is not None and waiting[0] <= stamp:
            self._put(waiting[1], waiting[2], waiting[0])
            waiting = next(readings, None)
        return waiting

    def _stamp(self, frame: LoadedFrame) -> int:
        stamp = trajectory.stamp(self.form, frame, _NANO)
        if stamp >= _LAST:
            raise OutputError(
                f"{frame.ref.name}: its time stamp is {trajectory.as_seconds(stamp, _NANO)} s, and "
                "ROS knows those below 2147483648 s; give the option start_s, or times=samples"
            )
        return stamp

    def _frame(self, frame: LoadedFrame, stamp: int) -> None:
        name, make = frame.ref.camera, self._make
        camera = self._cameras[name]
        optical = self._rigs.optical(name)
        for topic, message in self._rigs.at(frame, make, stamp):
            self._put(topic, message, stamp)
        right, pair = self._rigs.right.get(name, 0.0), self._rigs.rectified.get(name)
        info = make.camera_info(frame, right, pair, optical, stamp)
        self._below(camera, "camera_info", info, stamp)
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
            self._below(camera, topic, make.image(pixels, encoding, optical, stamp), stamp)
        if "disparity" in frame.passes:
            self._disparity(frame, optical, stamp)
        self._below(camera, "pose", make.pose(frame.camera_to_world, stamp), stamp)

    def _disparity(self, frame: LoadedFrame, optical: str, stamp: int) -> None:
        """Writes disparity of a pair's left camera, the only one that there is a message for."""
        name = frame.ref.camera
        other, apart = self._rigs.pairs.get(name, ("", 0.0))
        if not apart or frame.lens is not None or frame.sidecar.partner not in (UNSET, other):
            right = name in self._rigs.right
            what = "of right cameras" if right else "to no camera of a rectified pair"
            self.left_out[f"pictures of disparity {what}, for which ROS has no message"] += 1
            return
        message = self._make.disparity(frame, apart, optical, stamp)
        self._below(self._cameras[name], "disparity", message, stamp)

    def _below(self, camera: str, topic: str, message: Any, stamp: int) -> None:
        self._put(self._rigs.topics.of(camera, topic), message, stamp)

    def _put(self, topic: str, message: Any, stamp: int, latched: bool = False) -> None:
        kind = message.__msgtype__
        if topic not in self._connections:
            self._connections[topic] = self._writer.add_connection(
                topic, kind, typestore=self._store, offered_qos_profiles=[_qos(latched)]
            )
        data = self._store.serialize_cdr(message, kind)
        self._writer.write(self._connections[topic], stamp, data)
        self.messages += 1


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
