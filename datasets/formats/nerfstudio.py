"""nerfstudio: ``transforms.json`` of each batch, as nerfstudio, instant-ngp and splatting read it.

::

    <split>/<batch>/transforms.json
    <split>/<batch>/images/<camera>/000000.png
    <split>/<batch>/depth/<camera>/000000.npy    float32, millimeters, 0 where nothing was hit

Poses are camera to world with OpenGL's axes (x right, y up, z backward), in meters, Z up;
``cx``, ``cy`` count from the picture's corner, as scenec's do. The format:
https://docs.nerf.studio/quickstart/data_conventions.html.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import ClassVar

import numpy as np

from scenec.datasets.formats import trajectory
from scenec.datasets.formats.contract import Done, Format, Option, Task, Written
from scenec.datasets.formats.poses import (
    distortion,
    place_of_batch,
    require_no_skew,
    tasks_by_batch,
)
from scenec.datasets.source import FrameRef, LoadedFrame
from scenec.schemas.errors import OutputError
from scenec.schemas.files import atomic, write_json
from scenec.schemas.lens import BROWN_CONRADY, KANNALA_BRANDT

_LENSES = {BROWN_CONRADY: [("OPENCV", 5)], KANNALA_BRANDT: [("OPENCV_FISHEYE", 4)]}
#: Names of a model's coefficients, in OpenCV's order. (nerfstudio's k4 is another than OpenCV's.)
_NAMES = {"OPENCV": ("k1", "k2", "p1", "p2", "k3"), "OPENCV_FISHEYE": ("k1", "k2", "k3", "k4")}
#: Signs of the columns of a pose.
_OPENGL = np.array([1.0, -1.0, -1.0, 1.0])


class Nerfstudio(Format):
    """See the module."""

    name = "nerfstudio"
    summary = "nerfstudio transforms.json of each batch: pictures, poses, depth (NeRF, splatting)"
    needs = ("rgb",)
    # Pictures are taken from the PNG.
    unused = ("rgb",)
    options: ClassVar = {
        "depth": Option("no", "depth as float32 .npy in millimeters", ("no", "yes")),
    }

    def holds(self, name: str) -> bool:
        """Holds pictures, and depth where it is asked for."""
        return name == "rgb" or (name == "depth" and self.option("depth") == "yes")

    def tasks(self, splits: Mapping[str, Sequence[FrameRef]]) -> Iterator[Task]:
        """One a frame, batch by batch."""
        return tasks_by_batch(self, splits)

    def write(
        self, task: Task, frames: Iterable[LoadedFrame], folder: Path, scratch: Path
    ) -> Written:
        """The picture, its depth, and its entry."""
        (frame,) = frames
        name = f"{frame.ref.camera}/{frame.ref.sample:06d}"
        place = folder / place_of_batch(task)
        trajectory.copy_picture(frame, place / f"images/{name}.png")
        files = [f"images/{name}.png"]
        k = frame.intrinsics
        require_no_skew(frame)
        model, coefficients = distortion(frame, _LENSES) or ("OPENCV", [])
        entry = {
            "file_path": files[0],
            "camera_model": model,
            "w": frame.width,
            "h": frame.height,
            **dict(zip(("fl_x", "fl_y", "cx", "cy"), map(float, k[[0, 1, 0, 1], [0, 1, 2, 2]]),
                       strict=True)),
            **dict(zip(_NAMES[model], coefficients, strict=False)),
            "time": frame.time_s,
            "transform_matrix": (frame.camera_to_world * _OPENGL).tolist(),
        }  # fmt: skip
        if self.option("depth") == "yes":
            if "depth" not in frame.passes:
                raise OutputError(
                    "format nerfstudio, option depth=yes: the frames have no pass depth; render "
                    "with --passes rgb,depth"
                )
            files.append(f"depth/{name}.npy")
            depth = frame.passes["depth"]
            with atomic(place / files[1]) as temporary, temporary.open("wb") as file:
                np.save(file, np.where(np.isfinite(depth), depth * 1000.0, 0.0).astype(np.float32))
            entry["depth_file_path"] = files[1]
        return Written([f"{place_of_batch(task)}/{file}" for file in files], entry)

    def finish(self, done: Iterable[Done], folder: Path, scratch: Path) -> list[str]:
        """Write the file of each batch."""
        written = []
        for place, group in itertools.groupby(done, lambda one: place_of_batch(one.task)):
            entries = [one.record for one in group if one.record is not None]
            if entries:
                # nerfstudio takes one model for all where the file names one.
                models = {entry["camera_model"] for entry in entries}
                if len(models) > 1:
                    raise OutputError(
                        f"{place}: cameras of {' and '.join(sorted(models))}, and a "
                        "transforms.json has one model; choose cameras with --cameras"
                    )
                about = {"camera_model": entries[0]["camera_model"], "applied_scale": 1.0}
                write_json(folder / place / "transforms.json", {**about, "frames": entries})
                written.append(f"{place}/transforms.json")
        return written

    def usage(self) -> str:
        """The layout, and how to load it."""
        return (
            "nerfstudio: `<split>/<batch>/transforms.json` and its pictures. Poses are camera to "
            "world with OpenGL's axes, in meters; to keep meters and the world's axes train with "
            "`ns-train splatfacto --data <split>/<batch> nerfstudio-data --orientation-method none "
            "--center-method none --auto-scale-poses False`. Depth, where asked for, is float32 in "
            "millimeters along the view axis (nerfstudio's `depth_unit_scale_factor` of 0.001), 0 "
            "where nothing was hit."
        )
