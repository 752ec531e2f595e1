"""EuRoC MAV (ASL): one folder a sequence, all cameras of a rig in it.

::

    sequences.csv                           what each sequence is, and which camera is which
    <split>/<batch>_<rig>/mav0/body.yaml
    .../mav0/cam0/data/<ns>.png             8-bit gray, or color (option ``pictures``)
    .../mav0/cam0/data.csv                  "#timestamp [ns],filename"
    .../mav0/cam0/sensor.yaml               T_BS, resolution, intrinsics, distortion
    .../mav0/imu0/{data.csv,sensor.yaml}    what the IMUs of the rig read
    .../mav0/state_groundtruth_estimate0/{data.csv,sensor.yaml}

As M. Burri and others describe it (The EuRoC micro aerial vehicle datasets, IJRR 2016). The body
frame B is that of imu0, x ahead, y left, z up, and the ground truth its state at each reading:
exact poses, velocities and biases. A rig without an IMU has the body frame of cam0, x right, y
down, z forward; velocities are then central differences of its positions (one-sided at the ends),
biases 0.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any, ClassVar, TextIO

import numpy as np
from numpy.typing import NDArray

from scenec.datasets.formats import trajectory
from scenec.datasets.formats.contract import Done, Format, Info, Option, Task, Written
from scenec.datasets.formats.poses import (
    RIGID,
    distortion,
    number,
    numbers,
    pinhole,
    product,
    relative,
)
from scenec.datasets.source import FrameRef, LoadedFrame
from scenec.schemas.errors import OutputError
from scenec.schemas.files import atomic
from scenec.schemas.imu import Imu, RigState
from scenec.schemas.lens import BROWN_CONRADY, KANNALA_BRANDT
from scenec.schemas.quaternions import quaternion

_NANO = 1_000_000_000
#: What ASL calls lenses of ours: k1, k2, p1, p2, or Kannala and Brandt's four.
_LENSES = {
    BROWN_CONRADY: [("radial-tangential", 4)],
    KANNALA_BRANDT: [("equidistant", 4)],
}
_TRUTH = "state_groundtruth_estimate0"
_TRUTH_HEAD = (
    "#timestamp, p_RS_R_x [m], p_RS_R_y [m], p_RS_R_z [m], q_RS_w [], q_RS_x [], q_RS_y [], "
    "q_RS_z [], v_RS_R_x [m s^-1], v_RS_R_y [m s^-1], v_RS_R_z [m s^-1], b_w_RS_S_x [rad s^-1], "
    "b_w_RS_S_y [rad s^-1], b_w_RS_S_z [rad s^-1], b_a_RS_S_x [m s^-2], b_a_RS_S_y [m s^-2], "
    "b_a_RS_S_z [m s^-2]\n"
)
_IMU_HEAD = (
    "#timestamp [ns],w_RS_S_x [rad s^-1],w_RS_S_y [rad s^-1],w_RS_S_z [rad s^-1],"
    "a_RS_S_x [m s^-2],a_RS_S_y [m s^-2],a_RS_S_z [m s^-2]\n"
)
#: What ASL says of an IMU's noise; there is no place for bias instability.
_IMU_NOISE = ("gyroscope_noise_density", "gyroscope_random_walk",
              "accelerometer_noise_density", "accelerometer_random_walk")  # fmt: skip
_COLUMNS = ("sequence", "split", "batch", "rig", "camera", "name", "frames")


class Euroc(Format):
    """See the module."""

    name = "euroc"
    summary = "EuRoC MAV (ASL): pictures of all cameras of a rig, calibration, ground truth"
    version = 3
    needs = ("rgb",)
    # Pictures are taken from the PNG.
    unused = ("rgb",)
    options: ClassVar = {
        "pictures": Option(
            "gray", "8-bit gray, as the original has it, or color", ("gray", "color")
        ),
        "velocity": Option(
            "differences", "of the ground truth: central differences, or 0", ("differences", "zero")
        ),
        **trajectory.time_options(),
    }

    def __init__(self, info: Info) -> None:
        super().__init__(info)
        trajectory.start_ticks(self, _NANO)

    def holds(self, name: str) -> bool:
        """Holds pictures."""
        return name == "rgb"

    def tasks(self, splits: Mapping[str, Sequence[FrameRef]]) -> Iterator[Task]:
        """One a frame; of a rig, the cameras of a sample follow each other."""
        number_of_task = 0
        for split, frames in splits.items():
            for _batch, rig, cameras in trajectory.rigs(frames):
                order = {camera: i for i, camera in enumerate(cameras)}
                refs = [ref for members in cameras.values() for ref in members]
                before = dict.fromkeys(cameras, -1)
                for ref in sorted(refs, key=lambda r: (r.sample, order[r.camera])):
                    place = (rig, order[ref.camera], before[ref.camera])
                    yield Task(number_of_task, split, (ref,), place)
                    number_of_task, before[ref.camera] = number_of_task + 1, ref.sample

    def write(
        self, task: Task, frames: Iterable[LoadedFrame], folder: Path, scratch: Path
    ) -> Written:
        """Write a frame's picture."""
        (frame,) = frames
        trajectory.check_after(self, frame, int(task.place[2]), _NANO)
        nanos = trajectory.stamp(self, frame, _NANO)
        path = f"{_place(task)}/cam{task.place[1]}/data/{nanos}.png"
        gray = self.option("pictures") == "gray"
        intrinsics = pinhole(frame)
        lens = distortion(frame, _LENSES)
        trajectory.copy_picture(frame, folder / path, gray)
        record = {
            "stamp": nanos,
            "pose": frame.camera_to_world.tolist(),
            "size": [frame.width, frame.height],
            "intrinsics": list(intrinsics),
            "lens": ["radial-tangential", [0.0] * 4] if lens is None else list(lens),
        }
        return Written([path], record)

    def finish(self, done: Iterable[Done], folder: Path, scratch: Path) -> list[str]:
        """Write lists, calibration and ground truth of each sequence."""
        written = [trajectory.SEQUENCES]
        table: list[list[object]] = []
        for place, group in itertools.groupby(done, lambda d: _place(d.task)):
            tasks = list(group)
            records = ((d.task, d.record) for d in tasks if d.record is not None)
            sequence = _Sequence(self, folder / place, self._rig(tasks[0].task))
            sequence.write(records)
            written += [
                f"{place}/imu{i}/{name}"
                for i in range(len(sequence.imus))
                for name in ("data.csv", "sensor.yaml")
            ]
            for camera, state in sorted(sequence.cameras.items()):
                written += [f"{place}/cam{camera}/{name}" for name in ("data.csv", "sensor.yaml")]
                ref = state.task.frames[0]
                table.append(
                    [place.removesuffix("/mav0"), state.task.split, ref.batch_name,
                     state.task.place[0], f"cam{camera}", ref.camera, state.frames]
                )  # fmt: skip
            if sequence.cameras:
                written.append(f"{place}/body.yaml")
                written += [f"{place}/{_TRUTH}/{name}" for name in ("data.csv", "sensor.yaml")]
        trajectory.write_table(folder / trajectory.SEQUENCES, _COLUMNS, table)
        return written

    def _rig(self, task: Task) -> RigState | None:
        """Returns the rig of a sequence, of a stage that has times; None: its frames are known."""
        if self.option("times") == "samples":
            return None
        return self.info.rigs.of(task.frames[0].batch_name).get(str(task.place[0]))

    def remarks(self, splits: Mapping[str, Sequence[FrameRef]]) -> Iterator[str]:
        """Says that pictures turn gray, and that IMUs are left out where stamps are no times."""
        if self.option("pictures") == "gray":
            yield "pictures are written in gray, as EuRoC's are; --set pictures=color keeps color"
        if self.option("times") == "samples":
            yield trajectory.NO_IMUS

    def usage(self) -> str:
        """The layout, the frames, what is made up."""
        velocity = (
            "central differences of the positions (one-sided at the ends): right to second order "
            "in the time between frames for a smooth track, without meaning where each sample's "
            "pose was drawn for itself"
            if self.option("velocity") == "differences"
            else "0"
        )
        return (
            "EuRoC MAV (ASL): one folder a sequence, `<split>/<batch>_<rig>/mav0/`, with `camN/` "
            "(`data.csv`, `data/<ns>.png`, `sensor.yaml`) and `state_groundtruth_estimate0/`; "
            "`sequences.csv` says which camera camN is, `T_BS` is the pose of a sensor in the body "
            "frame. Rigs with an IMU have `imuN/`; the body frame is imu0's (x ahead, y left, z "
            "up), and the ground truth its exact state at each reading, biases included. Else the "
            "body frame is cam0's (x right, y down, "
            f"z forward), velocities are {velocity}, and biases 0. Time stamps are nanoseconds, "
            f"{self.option('start_s')} s added. Load the trajectory with evo: "
            "`evo_traj euroc state_groundtruth_estimate0/data.csv`."
        )


class _Camera:
    """Holds the state of a camera while its sequence is written."""

    def __init__(self, task: Task, record: dict[str, Any], list_file: TextIO) -> None:
        self.task = task
        self.first = record
        self.list = list_file
        self.frames = 0
        self.in_body: NDArray[np.float64] | None = None
        self.before: tuple[int, str] | None = None
        self.least_step = 0


class _Sequence:
    """The text files of a sequence, written in one go through its frames."""

    def __init__(self, form: Euroc, folder: Path, rig: RigState | None) -> None:
        self.form = form
        self.folder = folder
        self.rig = rig
        self.imus = () if rig is None else rig.imus
        self.cameras: dict[int, _Camera] = {}
        self._truth: list[tuple[int, NDArray[np.float64]]] = []

    def write(self, records: Iterator[tuple[Task, dict[str, Any]]]) -> None:
        """Write them; nothing where there are no frames.

        Raises:
            OutputError: Time stamps do not rise, or a camera changes.
        """
        first = next(records, None)
        if first is None:
            return
        with ExitStack() as stack:
            truth = self._open(stack, f"{_TRUTH}/data.csv")
            truth.write(_TRUTH_HEAD)
            for i, imu in enumerate(self.imus):
                readings = self._open(stack, f"imu{i}/data.csv")
                readings.write(_IMU_HEAD)
                self._lines(readings, imu, np.hstack([imu.gyroscope, imu.accelerometer]))
            if self.imus:
                imu = self.imus[0]
                biases = [imu.gyroscope_bias, imu.accelerometer_bias]
                state = [imu.position_m, imu.orientation, imu.velocity_m_s, *biases]
                self._lines(truth, imu, np.hstack(state))
            both = itertools.chain([first], records)
            for _, sample in itertools.groupby(both, lambda r: r[0].frames[0].sample):
                body: NDArray[np.float64] | None = None
                for task, record in sample:
                    camera = self._camera(stack, task, record)
                    pose = np.array(record["pose"])
                    if self.rig is not None and self.imus:
                        of_rig = self.rig.to_world[task.frames[0].sample]
                        body = product(of_rig, self.imus[0].to_rig)
                    elif task.place[1] == 0:
                        body = pose
                        self._add_truth(truth, record["stamp"], pose)
                    if body is not None:
                        self._place_camera(camera, relative(body, pose), task)
            self._add_truth(truth, None, None)
        self._write_yaml()

    def _lines(self, file: TextIO, imu: Imu, values: NDArray[np.float64]) -> None:
        """A line of time stamp and values [n, k] for each of an IMU's readings.

        Raises:
            OutputError: Two have one time stamp, or there is none for one.
        """
        before = -1
        for seconds, row in zip(imu.time_s.tolist(), values, strict=True):
            nanos = trajectory.ticks_of(self.form, seconds, _NANO)
            if nanos <= before:
                raise OutputError(
                    f"format euroc: the IMU {imu.name} of {self.folder.parent.name} reads at "
                    f"{trajectory.as_seconds(nanos, _NANO)} s after "
                    f"{trajectory.as_seconds(max(before, 0), _NANO)} s: expected time stamps of "
                    "nanoseconds that rise from 0; give the option start_s, or times=samples"
                )
            before = nanos
            file.write(f"{nanos},{numbers(row, ',')}\n")

    def _open(self, stack: ExitStack, name: str) -> TextIO:
        temporary = stack.enter_context(atomic(self.folder / name))
        return stack.enter_context(temporary.open("w", encoding="utf-8"))

    def _camera(self, stack: ExitStack, task: Task, record: dict[str, Any]) -> _Camera:
        number_of_camera = int(task.place[1])
        if number_of_camera not in self.cameras:
            list_file = self._open(stack, f"cam{number_of_camera}/data.csv")
            list_file.write("#timestamp [ns],filename\n")
            self.cameras[number_of_camera] = _Camera(task, record, list_file)
        camera = self.cameras[number_of_camera]
        now = record["stamp"], task.frames[0].name
        trajectory.check_rising(self.form, camera.before, now)
        if camera.before is not None:
            step = now[0] - camera.before[0]
            camera.least_step = min(camera.least_step or step, step)
        camera.before = now
        camera.frames += 1
        if any(record[key] != camera.first[key] for key in ("size", "intrinsics", "lens")):
            raise OutputError(
                f"{now[1]}: its resolution or intrinsics are not those of the frames before, and "
                "format euroc has one of each a camera"
            )
        camera.list.write(f"{now[0]},{now[0]}.png\n")
        return camera

    @staticmethod
    def _place_camera(camera: _Camera, in_body: NDArray[np.float64], task: Task) -> None:
        if camera.in_body is None:
            camera.in_body = in_body
        elif np.abs(in_body - camera.in_body).max() > RIGID:
            raise OutputError(
                f"{task.frames[0].name}: the camera has moved on its rig {task.place[0]}, and "
                "format euroc has one place a sequence; export its cameras apart with --cameras"
            )

    def _add_truth(self, file: TextIO, now: int | None, pose: NDArray[np.float64] | None) -> None:
        """A line of ground truth, one later than its pose is known: velocity needs the next."""
        kept = self._truth
        if now is not None and pose is not None:
            kept.append((now, pose))
            if len(kept) > 1:
                # Of two, the first has none before it and is that itself.
                self._truth_line(file, kept[-2], kept[0], kept[-1])
        elif kept:
            self._truth_line(file, kept[-1], kept[0], kept[-1])
        del kept[:-2]

    def _truth_line(
        self,
        file: TextIO,
        stamped: tuple[int, NDArray[np.float64]],
        before: tuple[int, NDArray[np.float64]],
        after: tuple[int, NDArray[np.float64]],
    ) -> None:
        nanos, pose = stamped
        seconds = (after[0] - before[0]) / _NANO
        velocity = np.zeros(3)
        if seconds > 0.0 and self.form.option("velocity") == "differences":
            velocity = (after[1][:3, 3] - before[1][:3, 3]) / seconds
        x, y, z, w = quaternion(pose[:3, :3])
        values = np.concatenate([pose[:3, 3], [w, x, y, z], velocity, np.zeros(6)])
        file.write(f"{nanos},{numbers(values, ',')}\n")

    def _write_yaml(self) -> None:
        identity = _matrix(np.eye(4))
        body = "imu0" if self.imus else "cam0"
        _text(self.folder / "body.yaml", f"comment: body frame B is that of {body}\n")
        for i, imu in enumerate(self.imus):
            in_body = relative(self.imus[0].to_rig, imu.to_rig)
            noise = "".join(f"{n}: {number(getattr(imu.noise, n))}\n" for n in _IMU_NOISE)
            _text(
                self.folder / f"imu{i}" / "sensor.yaml",
                f"sensor_type: imu\ncomment: {imu.name}, gravity {number(imu.gravity_m_s2)} m/s^2\n"
                "# Pose of the sensor in the body frame.\n"
                f"T_BS:\n{_matrix(in_body)}"
                f"rate_hz: {number(imu.rate_hz)}\n"
                "# rad/s/sqrt(Hz), rad/s^2/sqrt(Hz), m/s^2/sqrt(Hz), m/s^3/sqrt(Hz)\n"
                f"{noise}",
            )
        _text(
            self.folder / _TRUTH / "sensor.yaml",
            "sensor_type: state_estimate\n"
            "comment: exact poses of the body frame, in the world (meters, Z up)\n"
            f"T_BS:\n{identity}",
        )
        for number_of_camera, camera in self.cameras.items():
            if camera.in_body is None:
                raise OutputError(
                    f"{camera.task.frames[0].name}: cam0 of rig {camera.task.place[0]} has no "
                    "frame at any of this camera's samples, and format euroc needs one; export "
                    "its cameras apart with --cameras"
                )
            width, height = camera.first["size"]
            model, coefficients = camera.first["lens"]
            rate = _NANO / camera.least_step if camera.least_step else 0.0
            _text(
                self.folder / f"cam{number_of_camera}" / "sensor.yaml",
                f"sensor_type: camera\ncomment: {camera.task.frames[0].camera}\n"
                "# Pose of the sensor in the body frame.\n"
                f"T_BS:\n{_matrix(camera.in_body)}"
                f"rate_hz: {number(rate)}\n"
                f"resolution: [{width}, {height}]\n"
                "camera_model: pinhole\n"
                "# fu, fv, cu, cv; the top-left pixel's center is (0, 0)\n"
                f"intrinsics: [{numbers(np.array(camera.first['intrinsics']), ', ')}]\n"
                f"distortion_model: {model}\n"
                f"distortion_coefficients: [{numbers(np.array(coefficients), ', ')}]\n",
            )


def _place(task: Task) -> str:
    return f"{task.split}/{task.frames[0].batch_name}_{task.place[0]}/mav0"


def _matrix(pose: NDArray[np.float64]) -> str:
    return f"  cols: 4\n  rows: 4\n  data: [{numbers(pose, ', ')}]\n"


def _text(path: Path, text: str) -> None:
    with atomic(path) as temporary:
        temporary.write_text(text, encoding="utf-8")
