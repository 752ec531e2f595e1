"""TUM RGB-D: pictures, depth and a trajectory, one folder a sequence (a batch seen by a camera).

::

    sequences.csv                             what each sequence is, and what depth lost
    <split>/<batch>_<camera>/rgb/<t>.png      8-bit color
    <split>/<batch>_<camera>/depth/<t>.png    16 bits, 5000 steps a meter, 0 where there is none
    <split>/<batch>_<camera>/rgb.txt          "timestamp filename", likewise depth.txt
    <split>/<batch>_<camera>/associations.txt "timestamp filename timestamp filename"
    <split>/<batch>_<camera>/groundtruth.txt  "timestamp tx ty tz qx qy qz qw", camera to world
    <split>/<batch>_<camera>/calibration.txt  "fx fy cx cy"

As the authors describe it (J. Sturm and others, A benchmark for the evaluation of RGB-D SLAM
systems, IROS 2012; file formats on the pages of their dataset). Time stamps are seconds with six
digits behind the point.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from scenec.datasets.formats import trajectory
from scenec.datasets.formats.contract import Done, Format, Info, Option, Task, Written
from scenec.datasets.formats.depth_png import LARGEST, fitting_scale, to_16_bits
from scenec.datasets.formats.encode import number_option
from scenec.datasets.formats.poses import number, numbers, pinhole, require_pinhole
from scenec.datasets.source import FrameRef, LoadedFrame, sequences
from scenec.schemas.errors import OutputError
from scenec.schemas.files import atomic
from scenec.schemas.picture import write_png
from scenec.schemas.quaternions import quaternion

_MICRO = 1_000_000

_HEADS = {
    "rgb.txt": "# color images\n# sequence: {name}\n# timestamp filename\n",
    "depth.txt": "# depth maps\n# sequence: {name}\n# timestamp filename\n",
    # Readers of this one know no comments.
    "associations.txt": "",
    "groundtruth.txt": "# ground truth trajectory\n# sequence: {name}\n"
    "# timestamp tx ty tz qx qy qz qw\n",
}
_COLUMNS = (
    "sequence", "split", "batch", "camera", "frames", "width", "height", "fx", "fy", "cx", "cy",
    "depth_scale", "depth_hits", "depth_beyond", "depth_under",
)  # fmt: skip


class Tum(Format):
    """See the module."""

    name = "tum"
    summary = "TUM RGB-D: color, 16-bit depth, trajectory; for visual odometry and RGB-D SLAM"
    needs = ("rgb", "depth")
    # Pictures are taken from the PNG.
    unused = ("rgb",)
    options: ClassVar = {
        "depth_scale": Option("5000", "steps of depth a meter"),
        **trajectory.time_options(),
    }

    def __init__(self, info: Info) -> None:
        super().__init__(info)
        self._scale = number_option(self, "depth_scale")
        trajectory.start_ticks(self, _MICRO)

    def holds(self, name: str) -> bool:
        """Holds pictures and depth."""
        return name in ("rgb", "depth")

    def tasks(self, splits: Mapping[str, Sequence[FrameRef]]) -> Iterator[Task]:
        """One a frame, with the number of the sample before."""
        number_of_task = 0
        for split, frames in splits.items():
            for members in sequences(frames):
                before = -1
                for ref in members:
                    yield Task(number_of_task, split, (ref,), (before,))
                    number_of_task, before = number_of_task + 1, ref.sample

    def write(
        self, task: Task, frames: Iterable[LoadedFrame], folder: Path, scratch: Path
    ) -> Written:
        """Write a frame's two pictures."""
        (frame,) = frames
        trajectory.check_after(self, frame, int(task.place[0]), _MICRO)
        micros = trajectory.stamp(self, frame, _MICRO)
        text = trajectory.as_seconds(micros, _MICRO)
        place = _place(task.split, frame.ref)
        color, depth = f"rgb/{text}.png", f"depth/{text}.png"
        require_pinhole(frame)
        intrinsics = pinhole(frame)
        steps = to_16_bits(frame.passes["depth"], self._scale)
        trajectory.copy_picture(frame, folder / place / color)
        write_png(folder / place / depth, steps.steps)
        pose = frame.camera_to_world
        pose_text = f"{numbers(pose[:3, 3])} {numbers(quaternion(pose[:3, :3]))}"
        record = {
            "stamp": micros,
            "time": text,
            "color": color,
            "depth": depth,
            "pose": pose_text,
            "camera": [frame.width, frame.height, *map(number, intrinsics)],
            **steps.counts(),
        }
        return Written([f"{place}/{color}", f"{place}/{depth}"], record, narrowed=steps.narrowed)

    def finish(self, done: Iterable[Done], folder: Path, scratch: Path) -> list[str]:
        """Write the lists and the trajectory of each sequence."""
        written = [trajectory.SEQUENCES]
        table: list[list[object]] = []
        for place, group in itertools.groupby(done, _place_of):
            records = ((d.task, d.record) for d in group if d.record is not None)
            line = self._sequence(place, records, folder)
            if line is not None:
                table.append(line)
                written += [f"{place}/{name}" for name in (*_HEADS, "calibration.txt")]
        trajectory.write_table(folder / trajectory.SEQUENCES, _COLUMNS, table)
        return written

    def _sequence(
        self, place: str, records: Iterator[tuple[Task, dict[str, Any]]], folder: Path
    ) -> list[object] | None:
        first = next(records, None)
        if first is None:
            return None
        ref, split, camera = first[0].frames[0], first[0].split, first[1]["camera"]
        counts = np.zeros(4, np.int64)
        with ExitStack() as stack:
            files = {}
            for name, head in _HEADS.items():
                temporary = stack.enter_context(atomic(folder / place / name))
                files[name] = stack.enter_context(temporary.open("w", encoding="utf-8"))
                files[name].write(head.format(name=place))
            before = None
            for task, record in itertools.chain([first], records):
                now = record["stamp"], task.frames[0].name
                trajectory.check_rising(self, before, now)
                before = now
                if record["camera"] != camera:
                    raise OutputError(
                        f"{now[1]}: its resolution or intrinsics are not those of the frames "
                        "before, and format tum has one of each a sequence"
                    )
                time, color, depth = record["time"], record["color"], record["depth"]
                files["rgb.txt"].write(f"{time} {color}\n")
                files["depth.txt"].write(f"{time} {depth}\n")
                files["associations.txt"].write(f"{time} {color} {time} {depth}\n")
                files["groundtruth.txt"].write(f"{time} {record['pose']}\n")
                counts += 1, record["hits"], record["beyond"], record["under"]
        with atomic(folder / place / "calibration.txt") as temporary:
            temporary.write_text(
                "# fx fy cx cy, pixels; the top-left pixel's center is (0, 0); no distortion\n"
                f"{' '.join(camera[2:])}\n",
                encoding="utf-8",
            )
        frames, *lost = counts.tolist()
        return [place, split, ref.batch_name, ref.camera, frames, *camera, number(self._scale),
                *lost]  # fmt: skip

    def mend(self, most: float) -> str:
        """The scale that holds all depth."""
        return f"--set depth_scale={fitting_scale(most):g} holds the farthest, {most:.5g} m"

    def usage(self) -> str:
        """The layout, the convention of depth and its error."""
        return (
            "TUM RGB-D: one folder a sequence, `<split>/<batch>_<camera>/`, with `rgb/`, `depth/`, "
            "`rgb.txt`, `depth.txt`, `associations.txt` and `groundtruth.txt` (camera to world, "
            "optical axes: x right, y down, z forward; world in meters, Z up). Depth in meters is "
            f"the 16-bit value / {self._scale:g}, to the nearest: off by at most "
            f"{0.5e3 / self._scale:g} mm; 0 is no depth: nothing was hit, or it lies farther than "
            f"{LARGEST / self._scale:.6g} m (`depth_beyond` in `sequences.csv` counts these pixels "
            "of `depth_hits`; the option `depth_scale` moves the limit). Intrinsics (no "
            "distortion) stand in `calibration.txt`. Load the trajectory with evo: "
            "`evo_traj tum groundtruth.txt`."
        )


def _place(split: str, ref: FrameRef) -> str:
    return f"{split}/{ref.batch_name}_{ref.camera}"


def _place_of(done: Done) -> str:
    return _place(done.task.split, done.task.frames[0])
