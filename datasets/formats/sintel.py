"""MPI Sintel's tree: pictures and what moves between them, as readers of optical flow know it.

::

    sequences.csv                          what each sequence is of
    training/final/NAME/frame_0001.png     the picture: of a sensor with imaging what it took
    training/clean/NAME/frame_0001.png     the same before noise, where it was asked for; else again
    training/flow/NAME/frame_0001.flo      Middlebury's: "PIEH", width, height, (u, v) in float32
    training/occlusions/NAME/frame_0001.png    255 where the next picture does not show the point
    training/invalid/NAME/frame_0001.png       255 where there is no flow at all

NAME is ``<split>_<batch>_<camera>``; frames count from 1 over those that are there. As in Sintel
(D. Butler and others, A naturalistic open source movie for optical flow evaluation, ECCV 2012) the
last frame of a sequence has no flow, nor has one whose next is missing. Flow is exact; 1e10 where
it is unknown (Baker and others 2011).
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from scenec.datasets import pictures
from scenec.datasets.formats import trajectory
from scenec.datasets.formats.contract import Done, Format, Task, Written
from scenec.datasets.formats.encode import file_bytes, picture_png, write_bytes
from scenec.datasets.source import FrameRef, LoadedFrame, sequences
from scenec.schemas.correspondence import VISIBLE
from scenec.schemas.errors import FrameError
from scenec.schemas.picture import write_png

#: What stands in a file for what is not known; readers take all beyond 1e9 for that.
UNKNOWN = 1e10
_MAGIC = b"PIEH"
_COLUMNS = ("sequence", "split", "batch", "camera", "frames", "width", "height")


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
    needs = ("rgb", "flow")
    # Pictures are taken from the PNG.
    unused = ("rgb",)
    beside = ("clean",)

    def tasks(self, splits: Mapping[str, Sequence[FrameRef]]) -> Iterator[Task]:
        """One a frame, with its number in its sequence, and the sample after it (-1: none)."""
        number = 0
        for split, frames in splits.items():
            for members in sequences(frames):
                after = [*(ref.sample for ref in members[1:]), -1]
                for place, (ref, following) in enumerate(zip(members, after, strict=True), 1):
                    yield Task(number, split, (ref,), (_name(split, ref), place, following))
                    number += 1

    def write(
        self, task: Task, frames: Iterable[LoadedFrame], folder: Path, scratch: Path
    ) -> Written:
        """Write a frame's files."""
        (frame,) = frames
        name, place, following = str(task.place[0]), int(task.place[1]), int(task.place[2])
        written = Written(record={"size": [frame.width, frame.height]})

        def path(kind: str, ending: str = "png") -> Path:
            written.files.append(f"training/{kind}/{name}/frame_{place:04d}.{ending}")
            return folder / written.files[-1]

        write_bytes(path("final"), picture_png(frame))
        clean = picture_png(frame)
        if "clean" in pictures.kinds(frame.sidecar):
            clean = file_bytes(pictures.beside_file(frame, "clean"))
        write_bytes(path("clean"), clean)
        flow = frame.passes["flow"]
        unknown = ~np.isfinite(flow).all(axis=2)
        write_png(path("invalid"), _mask(unknown))
        every = int(frame.sidecar.get("trigger", (1, 0))[0])
        if following != frame.ref.sample + every:
            # Flow to a picture that is not the next one here would be taken for that.
            return written
        write_bytes(path("flow", "flo"), flo_bytes(flow))
        if "occlusion" not in frame.passes:
            raise FrameError(
                f"{frame.ref.stem}.exr: has no occlusion; render with --passes "
                f"{','.join([*frame.sidecar['passes'], 'occlusion'])}"
            )
        write_png(path("occlusions"), _mask(frame.passes["occlusion"] != VISIBLE))
        return written

    def finish(self, done: Iterable[Done], folder: Path, scratch: Path) -> list[str]:
        """Write the list of sequences."""
        lines = []
        for name, group in itertools.groupby(done, lambda one: str(one.task.place[0])):
            there = [one for one in group if one.record is not None]
            if there:
                ref, record = there[0].task.frames[0], there[0].record or {}
                lines.append((name, there[0].task.split, ref.batch_name, ref.camera, len(there),
                              *record["size"]))  # fmt: skip
        trajectory.write_table(folder / trajectory.SEQUENCES, _COLUMNS, lines)
        return [trajectory.SEQUENCES]

    def usage(self) -> str:
        """The layout, and how to load it."""
        return (
            "The tree of MPI Sintel: `training/{final,clean}/NAME/frame_0001.png`, "
            "`training/flow/NAME/frame_0001.flo` (exact, in pixels right and down to the camera's "
            "next sample; 1e10 where it is unknown; none where "
            "the next sample has no frame here), "
            "`training/occlusions` (255: the next picture does not show the point) and "
            "`training/invalid` (255: no flow). `sequences.csv` says what NAME is of.\n\n"
            "```python\n"
            "import cv2\n\n"
            'flow = cv2.readOpticalFlow("training/flow/NAME/frame_0001.flo")   # [h, w, 2]\n'
            "```\n"
        )


def _name(split: str, ref: FrameRef) -> str:
    return f"{split}_{ref.batch_name}_{ref.camera}"


def _mask(pixels: NDArray[np.bool_]) -> NDArray[np.uint8]:
    return pixels.astype(np.uint8) * np.uint8(255)
