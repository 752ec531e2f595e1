"""MPI Sintel's tree: pictures and what moves between them, as readers of optical flow know it.

::

    sequences.csv                          what each sequence is of
    training/final/NAME/frame_0001.png     the picture: of a sensor with imaging what it took
    training/clean/NAME/frame_0001.png     the same before noise, where it was asked for; else again
    training/flow/NAME/frame_0001.flo      Middlebury's: "PIEH", width, height, (u, v) in float32
    training/occlusions/NAME/frame_0001.png    255 where the next picture does not show the point
    training/invalid/NAME/frame_0001.png       255 where there is no flow at all

NAME is ``<split>_<batch>_<camera>``; after a gap, where frames were left out, another one begins:
``<split>_<batch>_<camera>-<sample>``. Frames count from 1. So the k-th flow of a sequence leads
from its k-th picture to its next, and as in Sintel (D. Butler and others, A naturalistic open
source movie for optical flow evaluation, ECCV 2012) the last frame has none. Flow is exact; 1e10
where it is unknown (Baker and others 2011).
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from scenec.datasets import pictures
from scenec.datasets.formats import trajectory
from scenec.datasets.formats.contract import Done, Format, Settled, Task, Written
from scenec.datasets.formats.encode import file_bytes, picture_png, write_bytes
from scenec.datasets.source import FrameRef, LoadedFrame, one_of_each, sequences
from scenec.schemas.correspondence import VISIBLE
from scenec.schemas.picture import write_png

#: What stands in a file for what is not known; readers take all beyond 1e9 for that.
UNKNOWN = 1e10
_MAGIC = b"PIEH"
_COLUMNS = ("sequence", "split", "batch", "camera", "frames", "width", "height", "first_sample")


#: Folders of what all frames have, and of what those have whose flow leads to the next.
_PICTURES = ("final", "clean", "invalid")
_MOTION = ("flow", "occlusions")


def flo_bytes(flow: NDArray[np.floating]) -> bytes:
    """A ``.flo`` file of flow [h, w, 2]; NaN is unknown."""
    height, width = flow.shape[:2]
    known = np.isfinite(flow).all(axis=2, keepdims=True)
    values = np.where(known, flow, UNKNOWN).astype("<f4")
    return _MAGIC + np.array([width, height], "<i4").tobytes() + values.tobytes()


class Sintel(Format):
    """See the module."""

    name = "sintel"
    summary = "MPI Sintel: pictures, clean ones, optical flow (.flo), occlusions, invalid pixels"
    needs = ("rgb", "flow", "occlusion")
    # Pictures are taken from the PNG.
    unused = ("rgb",)
    beside = ("clean",)

    def holds(self, name: str) -> bool:
        """Holds pictures, and flow to the next."""
        return name in ("rgb", "flow", "occlusion")

    def tasks(self, splits: Mapping[str, Sequence[FrameRef]]) -> Iterator[Task]:
        """One a frame: its sequence, its number there, and 1 where its flow leads to the next."""
        number = 0
        for split, frames in splits.items():
            for members in sequences(frames):
                name = _name(split, members[0])
                for run in _runs(members):
                    if run[0] is not members[0]:
                        name = _name(split, run[0], later=True)
                    for place, ref in enumerate(run, 1):
                        yield Task(number, split, (ref,), (name, place, int(place < len(run))))
                        number += 1

    def write(
        self, task: Task, frames: Iterable[LoadedFrame], folder: Path, scratch: Path
    ) -> Written:
        """Write a frame's files."""
        (frame,) = frames
        written = Written(record={"size": [frame.width, frame.height]})

        def path(kind: str) -> Path:
            written.files.append(_path(kind, str(task.place[0]), int(task.place[1])))
            return folder / written.files[-1]

        write_bytes(path("final"), picture_png(frame))
        clean = picture_png(frame)
        if "clean" in pictures.kinds(frame.sidecar):
            clean = file_bytes(pictures.beside_file(frame, "clean"))
        write_bytes(path("clean"), clean)
        flow = frame.passes["flow"]
        unknown = ~np.isfinite(flow).all(axis=2)
        write_png(path("invalid"), _mask(unknown))
        if task.place[2]:
            write_bytes(path("flow"), flo_bytes(flow))
            write_png(path("occlusions"), _mask(frame.passes["occlusion"] != VISIBLE))
        return written

    def settle(self, done: Iterable[Done]) -> Settled:
        """Frames after one that could not be read are a sequence of their own."""
        moved: dict[str, str | None] = {}
        for one, name, number, leads in _settled(done):
            planned, place, led = str(one.task.place[0]), int(one.task.place[1]), one.task.place[2]
            for kind in (*_PICTURES, *(_MOTION if led else ())):
                old, new = _path(kind, planned, place), _path(kind, name, number)
                if kind in _MOTION and not leads:
                    moved[old] = None
                elif new != old:
                    moved[old] = new
        return Settled(moved)

    def finish(self, done: Iterable[Done], folder: Path, scratch: Path) -> list[str]:
        """Write the list of sequences."""
        lines = []
        for name, group in itertools.groupby(_settled(done), lambda one: one[1]):
            there = [one for one, *_ in group]
            ref, record = there[0].task.frames[0], there[0].record or {}
            lines.append((name, there[0].task.split, ref.batch_name, ref.camera, len(there),
                          *record["size"], ref.sample))  # fmt: skip
        trajectory.write_table(folder / trajectory.SEQUENCES, _COLUMNS, lines)
        return [trajectory.SEQUENCES]

    def usage(self) -> str:
        """The layout, and how to load it."""
        return (
            "The tree of MPI Sintel: `training/{final,clean}/NAME/frame_0001.png`, "
            "`training/flow/NAME/frame_0001.flo` (exact, in pixels right and down to the next "
            "picture; 1e10 where it is unknown; none of the last; where frames were left out, a "
            "new sequence begins), "
            "`training/occlusions` (255: the next picture does not show the point) and "
            "`training/invalid` (255: no flow). `sequences.csv` says what NAME is of.\n\n"
            "```python\n"
            "import cv2\n\n"
            'flow = cv2.readOpticalFlow("training/flow/NAME/frame_0001.flo")   # [h, w, 2]\n'
            "```\n"
        )


def _name(split: str, ref: FrameRef, later: bool = False) -> str:
    """Of the sequence that a frame is the first of; ``later``: after a gap."""
    name = f"{split}_{ref.batch_name}_{ref.camera}"
    return f"{name}-{ref.sample:06d}" if later else name


def _path(kind: str, name: str, number: int) -> str:
    ending = "flo" if kind == "flow" else "png"
    return f"training/{kind}/{name}/frame_{number:04d}.{ending}"


def _runs(members: Sequence[FrameRef]) -> Iterator[list[FrameRef]]:
    """Frames of a camera, parted where the next is not the one that flow leads to."""
    record = one_of_each(members).get(members[0].camera)
    every = 1 if record is None else record.firing[0]
    run: list[FrameRef] = []
    for ref in members:
        if run and ref.sample != run[-1].sample + every:
            yield run
            run = []
        run.append(ref)
    yield run


def _settled(done: Iterable[Done]) -> Iterator[tuple[Done, str, int, bool]]:
    """Frames that are there: sequence, number in it, and whether flow leads to the next one of it.

    A sequence that begins after a frame that could not be read has a name that no task has, for
    that is the sample's that it begins with.
    """
    for planned, group in itertools.groupby(done, lambda one: str(one.task.place[0])):
        name, number = planned, 0
        for one, after in itertools.pairwise(itertools.chain(group, (None,))):
            if one is None or one.record is None:
                name = ""
                continue
            if not name:
                name, number = _name(one.task.split, one.task.frames[0], later=True), 0
            number += 1
            yield one, name, number, after is not None and after.record is not None


def _mask(pixels: NDArray[np.bool_]) -> NDArray[np.uint8]:
    return pixels.astype(np.uint8) * np.uint8(255)
