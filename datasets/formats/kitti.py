"""KITTI odometry: numbered sequences of one camera, or of a rectified stereo pair.

::

    sequences.csv                     what each sequence is, and its first pose in the world
    sequences/00/image_2/000000.png   color, the (left) camera; image_3 the right one
    sequences/00/image_0/000000.png   the same in shades of gray, and image_1 (option ``pictures``)
    sequences/00/depth_2/000000.png   16 bits, 256 steps a meter (option ``depth``); depth_3
    sequences/00/flow_2/000000.png    16 bits, to the next picture (option ``flow``); flow_3
    sequences/00/disp_2/000000.png    16 bits, pairs alone (option ``disparity``); disp_3
    sequences/00/velodyne/000000.bin  scans (``scenec scan``): x, y, z, intensity, float32
    sequences/00/labels/000000.label  of each point: label + 65536 instance, uint32
    sequences/00/calib.txt            P0 ... P3, Tr
    sequences/00/times.txt            seconds
    poses/00.txt                      3x4 a line: left camera in the frame of its first pose

As the development kits of the benchmark describe it (A. Geiger and others, Are we ready for
autonomous driving?, CVPR 2012); depth as in the kit of the depth benchmark (J. Uhrig and others,
Sparsity invariant CNNs, 3DV 2017), flow and disparity as in those of the stereo and flow
benchmarks (``motion_png``).

Two cameras of a rig are a pair where they have the same resolution and intrinsics, look the same
way, and lie apart along x alone: those first of which one is the other's partner, to which its
disparity goes. Cameras in no pair are sequences of their own. Points of the rig's
first lidar and their labels are as in SemanticKITTI (J. Behley and others, ICCV 2019), and Tr is
its place in the left camera. Flow leads to the sample that the
camera is triggered at next; where the next picture of the sequence is another, none is valid.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from scenec.datasets.formats import trajectory
from scenec.datasets.formats.contract import (
    Done,
    Format,
    Info,
    Narrowed,
    Option,
    Settled,
    Task,
    Written,
)
from scenec.datasets.formats.depth_png import LARGEST, to_16_bits
from scenec.datasets.formats.lidar import read_cloud, scans_of
from scenec.datasets.formats.motion_png import encode_disparity, encode_flow, write_rgb16
from scenec.datasets.formats.poses import (
    RIGID,
    number,
    numbers,
    opencv_intrinsics,
    relative,
    require_pinhole,
)
from scenec.datasets.formats.stereo import before_partners, pair_up, partner_of
from scenec.datasets.source import FrameRef, LoadedFrame
from scenec.schemas.codec import UNSET
from scenec.schemas.correspondence import VISIBLE
from scenec.schemas.errors import FrameError, OutputError
from scenec.schemas.files import atomic
from scenec.schemas.picture import write_png

#: Of the depth benchmark.
DEPTH_SCALE = 256.0
_MICRO = 1_000_000
#: A laser scanner's axes (x forward, y left, z up) in those of a camera, where there is none.
_TR = np.array([[0.0, -1.0, 0.0, 0.0], [0.0, 0.0, -1.0, 0.0], [1.0, 0.0, 0.0, 0.0]])
#: What can be written of motion -> the pass that says which pixels the other picture shows.
_SHOWN = {"flow": "occlusion", "disparity": "disparity_occlusion"}
_FLOW_TEXT = (
    "`flow_2` (and `flow_3`) hold flow to the next picture of the sequence: u = (red - 32768) / "
    "64, v = (green - 32768) / 64 pixels where blue is 1; nowhere in the last picture, nor before "
    "frames that were left out"
)
_DISPARITY_TEXT = (
    "`disp_2` (and `disp_3`, where the right camera has the pass) hold disparity * 256 of pairs, 0 "
    "where there is none"
)
_ASTRAY = "pictures of flow that does not lead to the next picture here: written without any"
_COLUMNS = (
    "sequence", "split", "batch", "left", "right", "frames", "width", "height", "baseline_m",
    "first_sample", "depth_hits", "depth_beyond", "depth_under", "first_camera_to_world",
)  # fmt: skip


class Kitti(Format):
    """See the module."""

    name = "kitti"
    summary = "KITTI odometry: color (stereo where a rig has a pair), calibration, poses"
    needs = ("rgb",)
    # Pictures are taken from the PNG.
    unused = ("rgb",)
    options: ClassVar = {
        "pictures": Option(
            "color",
            "image_2 and image_3 in color, image_0 and image_1 in gray, or both",
            ("color", "gray", "both"),
        ),
        "depth": Option(
            "no", "depth_2 and depth_3 as 16-bit PNG, 256 steps a meter", ("no", "yes")
        ),
        "flow": Option(
            "no",
            "flow_2 and flow_3 as 16-bit PNG: of all pixels (as flow_occ), or of those that the "
            "next picture shows (as flow_noc)",
            ("no", "all", "visible"),
        ),
        "disparity": Option(
            "no",
            "disp_2 and disp_3 of stereo pairs as 16-bit PNG, likewise",
            ("no", "all", "visible"),
        ),
        **trajectory.time_options(),
    }

    def __init__(self, info: Info) -> None:
        super().__init__(info)
        self._depth = self.option("depth") == "yes"
        if self._depth and "depth" not in info.passes:
            raise OutputError(
                "format kitti, option depth=yes: the frames have no pass depth; render with "
                f"--passes {','.join([*info.passes, 'depth'])}"
            )
        for name, shown in _SHOWN.items():
            needed = {"no": (), "all": (name,), "visible": (name, shown)}[self.option(name)]
            for one in needed:
                there = info.passes if name == "flow" else (*info.passes, *info.anywhere)
                if one not in there:
                    raise OutputError(
                        f"format kitti, option {name}={self.option(name)}: the frames have no pass "
                        f"{one}; render with --passes {','.join([*info.passes, one])}"
                    )
        trajectory.start_ticks(self, _MICRO)

    def holds(self, name: str) -> bool:
        """Holds pictures, and what options ask for."""
        return name == "rgb" or (name in ("depth", *_SHOWN) and self.option(name) != "no")

    def tasks(self, splits: Mapping[str, Sequence[FrameRef]]) -> Iterator[Task]:
        """One a sample: a frame, or the two of a pair, left first; with the sample after it."""
        number_of_task, sequence = 0, 0
        for split, frames in splits.items():
            for _batch, rig, cameras in trajectory.rigs(frames):
                for names in pair_up(cameras):
                    members = [{ref.sample: ref for ref in cameras[name]} for name in names]
                    common = sorted(set.intersection(*map(set, members)))
                    for index, (sample, following) in enumerate(
                        zip(common, [*common[1:], -1], strict=True)
                    ):
                        refs = tuple(member[sample] for member in members)
                        yield Task(number_of_task, split, refs, (sequence, index, following, rig))
                        number_of_task += 1
                    sequence += bool(common)

    def remarks(self, splits: Mapping[str, Sequence[FrameRef]]) -> Iterator[str]:
        """Lines about partners that are no pair, and pairs that do not say where disparity goes."""
        assumed: list[tuple[str, str]] = []
        alone: dict[str, str] = {}
        for frames in splits.values():
            for _batch, _rig, cameras in trajectory.rigs(frames):
                for names in pair_up(cameras):
                    of_both = [cameras[name] for name in names]
                    if len(names) < 2 and (partner := partner_of(of_both[0])) in cameras:
                        alone[names[0]] = str(partner)
                    if len(names) < 2 or any(partner_of(refs) for refs in of_both):
                        continue
                    if any(before_partners(refs) for refs in of_both):
                        assumed.append((names[0], names[1]))
        for name, partner in alone.items():
            yield f"{name} and its partner {partner} are no rectified pair; --rectify makes one"
        if assumed:
            left, right = assumed[0]
            more = len(set(assumed)) - 1
            rest = f" (and {more} more pairs)" if more else ""
            yield (
                f"{left} and {right}{rest} are a pair by where they stand: their frames have "
                "disparity and were rendered before sidecars said to which camera it goes; render "
                "again if it goes to another one"
            )

    def write(
        self, task: Task, frames: Iterable[LoadedFrame], folder: Path, scratch: Path
    ) -> Written:
        """Write the pictures of a sample; nothing where one of a pair cannot be read."""
        sequence, index, following = map(int, task.place[:3])
        written = Written()
        poses: list[list[list[float]]] = []
        counts = np.zeros(3, np.int64)
        place, name = f"sequences/{sequence:02d}", f"{index:06d}.png"
        flows: list[bool] = []
        for frame in frames:
            side = next(i for i, ref in enumerate(task.frames) if ref.index == frame.ref.index)
            if side != len(poses):
                break
            folders = {
                f"image_{side}": self.option("pictures") != "color",
                f"image_{side + 2}": self.option("pictures") != "gray",
            }
            for kind, wanted in folders.items():
                if wanted:
                    path = f"{place}/{kind}/{name}"
                    trajectory.copy_picture(frame, folder / path, gray=kind == f"image_{side}")
                    written.files.append(path)
            if self._depth:
                depth = to_16_bits(frame.passes["depth"], DEPTH_SCALE)
                path = f"{place}/depth_{side + 2}/{name}"
                write_png(folder / path, depth.steps)
                written.files.append(path)
                counts += depth.hits, depth.beyond, depth.under
                for what, lost in depth.narrowed.items():
                    written.narrowed[what] = written.narrowed.get(what, Narrowed()) + lost
            if self.option("flow") != "no":
                path = f"{place}/flow_{side + 2}/{name}"
                flows.append(self._flow(frame, following, folder, path, written))
            if self.option("disparity") != "no" and len(task.frames) > 1:
                other = task.frames[1 - side].camera
                path = f"{place}/disp_{side + 2}/{name}"
                self._disparity(frame, side, other, folder, path, written)
            require_pinhole(frame)
            if side == 0:
                micros = trajectory.stamp(self, frame, _MICRO)
                written.record = {
                    "stamp": micros,
                    "time": trajectory.as_seconds(micros, _MICRO),
                    "size": [frame.width, frame.height],
                    "intrinsics": opencv_intrinsics(frame).tolist(),
                }
                self._scan(task, frame, folder, written)
            poses.append(frame.camera_to_world.tolist())
        if len(poses) != len(task.frames):
            for name in written.files:
                (folder / name).unlink()
            return Written()
        written.record["poses"] = poses
        written.record["depth"] = counts.tolist()
        written.record["flows"] = flows
        return written

    def sources(self, task: Task) -> list[Path]:
        """The scan of the sample."""
        found = scans_of(task.frames[0], str(task.place[3]))
        return [path.with_suffix(".npz") for path in found[:1]]

    def _scan(self, task: Task, frame: LoadedFrame, folder: Path, written: Written) -> None:
        """Writes the points of the rig's first lidar, and their labels."""
        found = scans_of(frame.ref, str(task.place[3]))
        _count(written.left_out, "scans of a rig's second lidar and others", len(found[1:]))
        cloud = read_cloud(found[0], self.info, frame.sidecar.stage_digest) if found else None
        if cloud is None:
            _count(written.left_out, "scans of another stage; scan again", len(found[:1]))
            return
        most = max(int(cloud.labels.max(initial=0)), int(cloud.instances.max(initial=0)))
        if most >= 2**16:
            raise OutputError(
                f"{found[0]}: a point has the label or instance {most}, and SemanticKITTI's labels "
                "hold those below 65536"
            )
        written.record["lidar"] = relative(frame.camera_to_world, cloud.to_world).tolist()
        files = {
            "velodyne/{}.bin": np.column_stack([cloud.points, cloud.intensity]).astype("<f4"),
            "labels/{}.label": (cloud.labels | cloud.instances << np.uint32(16)).astype("<u4"),
        }
        for pattern, values in files.items():
            name = f"{int(task.place[0]):02d}/{pattern.format(f'{int(task.place[1]):06d}')}"
            path = folder / "sequences" / name
            path.parent.mkdir(parents=True, exist_ok=True)
            with atomic(path) as temporary:
                temporary.write_bytes(values.tobytes())
            written.files.append(f"sequences/{name}")

    def _flow(
        self, frame: LoadedFrame, following: int, folder: Path, path: str, written: Written
    ) -> bool:
        """Write flow; returns whether any of it leads to the following sample."""
        values = _pass(frame, "flow")
        known = bool(np.isfinite(values).all(axis=2).any())
        every = frame.sidecar.firing[0]
        leads = following == frame.ref.sample + every
        if known and not leads:
            _count(written.left_out, _ASTRAY, 1)
        values = values if leads else np.full_like(values, np.nan)
        coded, lost = encode_flow(values, self._valid(frame, "flow"))
        write_rgb16(folder / path, coded)
        written.files.append(path)
        _count(written.left_out, "pixels of flow that KITTI's 16 bits do not hold", lost)
        return known and leads

    def _disparity(
        self, frame: LoadedFrame, side: int, other: str, folder: Path, path: str, written: Written
    ) -> None:
        """Write disparity to the pair's other camera, where the frame has any.

        Raises:
            OutputError: The frame has disparity to another camera.
        """
        if "disparity" not in frame.passes:
            # Of most pairs one camera alone names the other as its partner.
            if not side:
                _count(written.left_out, "left pictures of pairs without the pass disparity", 1)
            return
        partner = frame.sidecar.partner
        if partner is not UNSET and partner != other:
            raise OutputError(
                f"{frame.ref.name}: its disparity goes to {partner or 'a camera without frames'}, "
                f"and format kitti has it beside {other}; choose one pair with --cameras, or give "
                "disparity=no"
            )
        values = frame.passes["disparity"]
        # To the left in the other picture, or of the right camera to the right.
        values = -values if side else values
        coded, lost = encode_disparity(values, self._valid(frame, "disparity"))
        write_png(folder / path, coded)
        written.files.append(path)
        _count(written.left_out, "pixels of disparity that KITTI's 16 bits do not hold", lost)

    def _valid(self, frame: LoadedFrame, kind: str) -> NDArray[np.bool_] | None:
        """Pixels that may have any."""
        return _pass(frame, _SHOWN[kind]) == VISIBLE if self.option(kind) == "visible" else None

    def settle(self, done: Iterable[Done]) -> Settled:
        """Flow to a frame that could not be read is taken away."""
        gone = dict.fromkeys(path for path, _ in self._blinded(done))
        return Settled(dict(gone), {_ASTRAY: len(gone)} if gone else {})

    @staticmethod
    def _blinded(done: Iterable[Done]) -> Iterator[tuple[str, list[int]]]:
        """Pictures of flow to a frame that could not be read, with their sizes."""
        for one, after in itertools.pairwise(itertools.chain(done, (None,))):
            # A record without a stamp is half a pair: nothing was written.
            if one is None or not one.record or after is None or after.record:
                continue
            place, index = map(int, one.task.place[:2])
            if int(after.task.place[0]) != place:
                continue
            for side, leads in enumerate(one.record["flows"]):
                if leads:
                    path = f"sequences/{place:02d}/flow_{side + 2}/{index:06d}.png"
                    yield path, one.record["size"]

    def finish(self, done: Iterable[Done], folder: Path, scratch: Path) -> list[str]:
        """Write calibration, times and poses of each sequence."""
        written = [trajectory.SEQUENCES]
        table: list[list[object]] = []
        for place, group in itertools.groupby(done, lambda d: int(d.task.place[0])):
            # A record without a stamp is half a pair: nothing was written.
            records = ((d.task, d.record) for d in group if d.record)
            line = self._sequence(place, records, folder)
            if line is not None:
                table.append(line)
                name = f"{place:02d}"
                written += [f"sequences/{name}/calib.txt", f"sequences/{name}/times.txt",
                            f"poses/{name}.txt"]  # fmt: skip
        trajectory.write_table(folder / trajectory.SEQUENCES, _COLUMNS, table)
        for path, (width, height) in self._blinded(done):
            write_rgb16(folder / path, np.zeros((height, width, 3), np.uint16))
            written.append(path)
        return written

    def _sequence(
        self, place: int, records: Iterator[tuple[Task, dict[str, Any]]], folder: Path
    ) -> list[object] | None:
        head = next(records, None)
        if head is None:
            return None
        task, first = head
        start = np.array(first["poses"][0])
        offset = relative(start, np.array(first["poses"][-1]))
        name, lidar = f"{place:02d}", first.get("lidar")
        counts = np.zeros(4, np.int64)
        with ExitStack() as stack:
            times, poses = (
                stack.enter_context(stack.enter_context(atomic(path)).open("w", encoding="utf-8"))
                for path in (
                    folder / "sequences" / name / "times.txt",
                    folder / "poses" / f"{name}.txt",
                )
            )
            before = None
            for this, record in itertools.chain([head], records):
                now = record["stamp"], this.frames[0].name
                trajectory.check_rising(self, before, now)
                before = now
                self._check_same(now[1], first, record, offset)
                lidar = lidar or record.get("lidar")
                if "lidar" in record and _apart(record["lidar"], lidar) > RIGID:
                    raise OutputError(f"{now[1]}: the lidar is not where it was on the rig")
                times.write(f"{record['time']}\n")
                poses.write(f"{numbers(relative(start, np.array(record['poses'][0]))[:3])}\n")
                counts += 1, *record["depth"]
        baseline = float(offset[0, 3])
        with atomic(folder / "sequences" / name / "calib.txt") as temporary:
            temporary.write_text(_calibration(np.array(first["intrinsics"]), baseline, lidar))
        cameras = [ref.camera for ref in task.frames]
        frames, *lost = counts.tolist()
        return [name, task.split, task.frames[0].batch_name, cameras[0],
                cameras[1] if len(cameras) > 1 else "", frames, *first["size"], number(baseline),
                task.frames[0].sample, *lost, numbers(start[:3])]  # fmt: skip

    @staticmethod
    def _check_same(
        name: str, first: dict[str, Any], record: dict[str, Any], offset: NDArray[np.float64]
    ) -> None:
        same = record["size"] == first["size"] and record["intrinsics"] == first["intrinsics"]
        now = relative(np.array(record["poses"][0]), np.array(record["poses"][-1]))
        if not same or np.abs(now - offset).max() > RIGID:
            raise OutputError(
                f"{name}: its resolution, intrinsics or the place of the second camera are not "
                "those of the frames before, and format kitti has one of each a sequence"
            )

    def mend(self, most: float) -> str:
        """The benchmark has one scale."""
        return f"the farthest is {most:.5g} m, and KITTI has one scale: --format tum has a free one"

    def usage(self) -> str:
        """The layout, the conventions."""
        depth = (
            "`depth_2` (and `depth_3`) hold meters * 256, to the nearest (off by at most 1.95 mm), "
            f"0 where nothing was hit or farther than {LARGEST / DEPTH_SCALE:.6g} m "
            "(`depth_beyond` in `sequences.csv` counts these pixels). "
            if self._depth
            else ""
        )
        for kind, text in (("flow", _FLOW_TEXT), ("disparity", _DISPARITY_TEXT)):
            if self.option(kind) != "no":
                depth += f"{text} ({self.option(kind)} pixels). "
        return (
            "KITTI odometry: `sequences/NN/` with `image_2` (and `image_3` where a rig has a "
            "rectified pair), `calib.txt`, `times.txt`, and `poses/NN.txt`: the left camera "
            "(x right, y down, z forward) in the frame of its first pose, meters; "
            "`sequences.csv` says which batch and cameras a sequence is of, its split, and where "
            "its first pose lies in the world. Cameras 0 and 2 are one, as are 1 and 3; without a "
            "pair P1 and P3 repeat P0. Where the rig has a lidar that `scenec scan` scanned with, "
            "`velodyne` and `labels` hold its points as SemanticKITTI has them, and `Tr` is its "
            "place in the left camera; without one `Tr` only turns axes (x forward, y left, z up). "
            f"{depth}Where frames were left out, numbers of "
            "pictures have gaps, and line i of times and poses belongs to picture i in order of "
            "names. Load with `pykitti.odometry(FOLDER, '00')`."
        )


def _pass(frame: LoadedFrame, name: str) -> NDArray[Any]:
    if name not in frame.passes:
        raise FrameError(
            f"{frame.ref.stem}.exr: has no {name}; render with --passes "
            f"{','.join([*frame.sidecar.passes, name])}"
        )
    return frame.passes[name]


def _count(left_out: dict[str, int], what: str, number: int) -> None:
    if number:
        left_out[what] = left_out.get(what, 0) + number


def _apart(one: object, other: object) -> float:
    return float(np.abs(np.array(one) - np.array(other)).max())


def _calibration(k: NDArray[np.float64], baseline: float, lidar: list[list[float]] | None) -> str:
    left, right = np.zeros((3, 4)), np.zeros((3, 4))
    left[:, :3] = right[:, :3] = k
    # A point of the left camera's frame lies this much to the left in the right one's.
    right[0, 3] = -k[0, 0] * baseline
    rows = {
        "P0": left,
        "P1": right,
        "P2": left,
        "P3": right,
        "Tr": _TR if lidar is None else np.array(lidar)[:3],
    }
    return "".join(f"{name}: {numbers(matrix)}\n" for name, matrix in rows.items())
