"""Knows the rigs of a ROS 2 bag: frames, pairs, and what is measured beside pictures."""

from __future__ import annotations

import heapq
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenec.datasets.formats import trajectory
from scenec.datasets.formats.contract import Format
from scenec.datasets.formats.poses import LINK_POSE, inverse, product
from scenec.datasets.formats.rectify import Rectified, rectified_partners
from scenec.datasets.formats.rosbag2_messages import NANO, Messages, RigMotionAt
from scenec.datasets.formats.rosbag2_names import (
    BODY,
    IN_LEFT_FRAME,
    LAYOUTS,
    TRUTH,
    Topics,
    rig_frames,
    ros_names,
)
from scenec.datasets.formats.stereo import baseline, pair_up, partner_of
from scenec.datasets.source import FrameRef, LoadedFrame, record_of
from scenec.schemas.georeference import Georeference
from scenec.schemas.imu import Imu, RigState
from scenec.schemas.scans import SCANS, read_scan

#: What is stamped: when (nanoseconds), on which topic, the message.
type Stamped = tuple[int, str, Any]


class RigsOfBag:
    """Holds the rigs of a batch and what they carry, under the names of a bag.

    Attributes:
        pairs: Left camera of each rectified pair -> the right one, and meters between.
        right: Right camera of each -> these meters.
        rectified: Camera of another pair -> how it becomes one of a rectified one.
        topics: Names of topics.
    """

    def __init__(
        self,
        form: Format,
        cameras: Mapping[str, str],
        frames: Sequence[FrameRef],
        left_out: Counter[str],
    ) -> None:
        """The rigs of frames.

        Args:
            form: With its options.
            cameras: Names in the stage, and in the bag.
            frames: Of one batch.
            left_out: What is not in the bag -> how many; added to.
        """
        self.pairs: dict[str, tuple[str, float]] = {}
        self.right: dict[str, float] = {}
        self.rectified: dict[str, Rectified] = {}
        self._form, self._cameras, self._left_out = form, cameras, left_out
        self._scans = scan_folder(frames)
        self._states = form.info.rigs.of(frames[0].batch_name)
        self._place_of_scene = self._on_earth(frames[0].batch_name)
        #: Rig -> its frame; camera on one -> rig and pose there.
        self._frames: dict[str, str] = {}
        self._mounts: dict[str, tuple[str, NDArray[np.float64]]] = {}
        #: First camera of a rig that is not known -> the rig.
        self._firsts: dict[str, str] = {}
        self._posed: set[tuple[str, int]] = set()
        rigs = trajectory.rigs(sorted(frames, key=lambda ref: (ref.camera, ref.sample)))
        for _, _, members in rigs:
            self._pair(members)
        self._place([(rig, members) for _, rig, members in rigs])
        self.topics = Topics(form.option("topics"), self._roles(rigs))

    def _on_earth(self, batch: str) -> Georeference | None:
        """Where the batch lies, if that is on Earth: NavSatFix is of WGS 84."""
        place = self._form.info.georeferences.get(batch)
        if place is None or place.body == "Earth":
            return place
        self._left_out[
            f"latitudes and longitudes on {place.body or 'a body without a name'}: NavSatFix is of "
            "Earth alone"
        ] += 1
        return None

    def _pair(self, members: Mapping[str, Sequence[FrameRef]]) -> None:
        for pair in pair_up(members):
            partner = partner_of(members[pair[0]])
            if len(pair) == 2:
                apart = baseline(*(members[name] for name in pair))
                self.pairs[pair[0]], self.right[pair[1]] = (pair[1], apart), apart
            elif partner and partner in members and not self._rectify(pair[0], partner, members):
                self._left_out[
                    "cameras that make no rectified pair with their partner: P does not say where "
                    "that is"
                ] += 1

    def _rectify(self, name: str, partner: str, members: Mapping[str, Sequence[FrameRef]]) -> bool:
        """Notes how two cameras become a rectified pair; whether they do."""
        if name not in self.rectified:
            self.rectified.update(rectified_partners(name, partner, members) or {})
        return name in self.rectified

    def _place(self, rigs: Sequence[tuple[str, Mapping[str, Sequence[FrameRef]]]]) -> None:
        """Finds frames of rigs, and which cameras are fixed to them."""
        named = []
        for rig, members in rigs:
            state = self._states.get(rig)
            if rig not in members:
                named.append(rig)
                if state is None:
                    self._firsts[next(iter(members))] = rig
            for camera, refs in members.items():
                record = next((one for one in map(record_of, refs) if one is not None), None)
                mount = None
                if state is not None and record is not None:
                    mount = state.mounts.get(record.camera_prim or "")
                if mount is not None:
                    self._mounts[camera] = rig, product(_from_rig(mount), LINK_POSE)
        others = [f"{name}_{end}" for name in self._cameras.values() for end in ("optical", "link")]
        self._frames = rig_frames(named, others)
        self._carried = ros_names(
            [f"{r}_{one}" for r in named if r in self._states for one in self._instruments(r)],
            "sensor",
        )

    def _instruments(self, rig: str) -> dict[str, NDArray[np.float64]]:
        """Poses of IMUs and lidars on a rig, by name: from their axes to those of its frame."""
        state = self._states[rig]
        found = {imu.name: _from_rig(imu.to_rig) for imu in self._imus(state)}
        for path, mount in state.mounts.items():
            name = path.rpartition("/")[2]
            if (self._scans / f"{rig}_{name}").is_dir():
                found[name] = _from_rig(mount)
        return found

    def _imus(self, state: RigState) -> tuple[Imu, ...]:
        return () if self._form.option("times") == "samples" else state.imus

    def _roles(
        self, rigs: Sequence[tuple[str, str, Mapping[str, Sequence[FrameRef]]]]
    ) -> dict[str, str]:
        """Roles of the first rig with a pair, or of the first, in a layout of another package."""
        if not LAYOUTS[self._form.option("topics")]:
            return {}
        lefts = {**self.pairs, **{n: (m, 0.0) for n, m in self._rectified_pairs()}}
        chosen = next((r for r in rigs if set(r[2]) & set(lefts)), rigs[0])
        rig, members = chosen[1], chosen[2]
        left = next((name for name in members if name in lefts), None)
        roles = {self._cameras[next(iter(members))]: "single"}
        if left is not None:
            roles = {self._cameras[left]: "left", self._cameras[lefts[left][0]]: "right"}
        if rig in self._states and rig in self._frames:
            self._frames[rig] = BODY
            imus = [imu.name for imu in self._imus(self._states[rig])]
            lidars = [name for name in self._instruments(rig) if name not in imus]
            for names, role in ((imus, "imu"), (lidars, "lidar")):
                roles.update({self._carried[f"{rig}_{name}"]: role for name in names[:1]})
        return roles

    def optical(self, camera: str) -> str:
        """Returns the frame of a camera's pictures: its own, or its left partner's."""
        if self._form.option("topics") in IN_LEFT_FRAME:
            rights = {right: left for left, (right, _) in self.pairs.items()}
            rights.update({right: left for left, right in self._rectified_pairs()})
            camera = rights.get(camera, camera)
        return f"{self._cameras[camera]}_optical"

    def _rectified_pairs(self) -> list[tuple[str, str]]:
        names = [*self.rectified]
        return [(names[i], names[i + 1]) for i in range(0, len(names), 2)]

    def latched(self, make: Messages, stamp: int) -> Iterator[tuple[str, Any]]:
        """Yields what reaches those who come late: what is fixed to what, and paths."""
        links = []
        for name, camera in self._cameras.items():
            links.append((f"{camera}_link", f"{camera}_optical", inverse(LINK_POSE)))
            if name in self._mounts:
                rig, pose = self._mounts[name]
                links.append((self._frames[rig], f"{camera}_link", pose))
        for rig, frame in self._frames.items():
            if rig in self._states:
                links += [
                    (frame, self._carried[f"{rig}_{name}"], pose)
                    for name, pose in self._instruments(rig).items()
                ]
        yield "/tf_static", make.tf(links, stamp)
        for rig in self._frames:
            state = self._states.get(rig)
            if state is not None:
                stamps = [self._ticks(state, k) for k in range(len(state.time_s))]
                if min(stamps) < 0:
                    continue
                poses = [product(pose, LINK_POSE) for pose in state.to_world]
                yield f"/{ros_names([rig], 'rig')[rig]}/path", make.path(poses, stamps)

    def _ticks(self, state: RigState, sample: int) -> int:
        at = float(sample) if self._form.option("times") == "samples" else state.time_s[sample]
        return trajectory.ticks_of(self._form, float(at), NANO)

    def at(self, frame: LoadedFrame, make: Messages, stamp: int) -> Iterator[tuple[str, Any]]:
        """Yields where a frame's camera and its rig are, the rig once a sample."""
        name, sample = frame.ref.camera, frame.ref.sample
        link = product(frame.camera_to_world, LINK_POSE)
        links = []
        if name in self._firsts:
            links.append(("world", self._frames[self._firsts[name]], link))
        if name not in self._mounts:
            links.append(("world", f"{self._cameras[name]}_link", link))
        else:
            rig = self._mounts[name][0]
            if (rig, sample) not in self._posed:
                self._posed.add((rig, sample))
                body = self._frames[rig] if self._frames[rig] != BODY else TRUTH
                motion = RigMotionAt(self._states[rig], sample)
                links.append(("world", body, motion.pose))
                topic = f"/{ros_names([rig], 'rig')[rig]}/odom"
                yield topic, make.odometry(motion, body, stamp)
                if self._place_of_scene is not None:
                    at = motion.pose[:3, 3]
                    altitude = float(at[2]) - self._states[rig].height_offset_m
                    fix = make.fix(self._place_of_scene, at, altitude, body, stamp)
                    yield f"/{ros_names([rig], 'rig')[rig]}/fix", fix
        if links:
            yield "/tf", make.tf(links, stamp)

    def readings(self, make: Messages, stage_digest: str) -> Iterator[Stamped]:
        """Returns what IMUs and lidars of the rigs measured, in time.

        Args:
            make: Makes messages.
            stage_digest: Of the stage that the frames show: scans of another one are left out.
        """
        series = []
        for rig, state in self._states.items():
            if rig in self._frames:
                series += [self._of_imu(make, rig, imu) for imu in self._imus(state)]
                lidars = {path.rpartition("/")[2] for path in state.mounts}
                found = [name for name in self._instruments(rig) if name in lidars]
                series += [self._of_lidar(make, f"{rig}_{n}", stage_digest) for n in found]
        return heapq.merge(*series, key=lambda one: one[0])

    def _of_imu(self, make: Messages, rig: str, imu: Imu) -> Iterator[Stamped]:
        name = self._carried[f"{rig}_{imu.name}"]
        topic = self.topics.of(name)
        for k, seconds in enumerate(imu.time_s.tolist()):
            stamp = trajectory.ticks_of(self._form, seconds, NANO)
            if stamp < 0:
                self._left_out["readings of IMUs before the time 0, which ROS does not know"] += 1
                continue
            yield stamp, topic, make.imu(imu, k, name, stamp)

    def _of_lidar(self, make: Messages, lidar: str, stage_digest: str) -> Iterator[Stamped]:
        name = self._carried[lidar]
        topic = self.topics.of(name)
        for path in sorted((self._scans / lidar).glob("*.json")):
            scan = read_scan(path)
            record = scan.sidecar
            if record.stage_digest != stage_digest or not isinstance(record.sample, int):
                self._left_out["scans of another stage; scan again"] += 1
                continue
            at = record.time_s
            if at is None or self._form.option("times") == "samples":
                at = float(record.sample)
            stamp = trajectory.ticks_of(self._form, at, NANO)
            yield stamp, topic, make.cloud(scan, name, stamp)


def scan_folder(frames: Sequence[FrameRef]) -> Path:
    """Returns the folder of the scans of a batch."""
    # Of batch_0000/frames/<backend>/<camera>/000000.
    return frames[0].stem.parents[3] / SCANS


def _from_rig(pose: NDArray[np.float64]) -> NDArray[np.float64]:
    """A pose on a rig (axes x right, y down, z forward) in its frame (x forward, y left, z up)."""
    return product(inverse(LINK_POSE), pose)
