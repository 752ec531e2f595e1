"""COLMAP: cameras, poses and points of each batch, as its own text or binary files.

::

    <split>/<batch>/images/<camera>/000000.png
    <split>/<batch>/sparse/0/cameras.txt      model, size and parameters of each camera
    <split>/<batch>/sparse/0/images.txt       pose (world to camera) of each picture, its points
    <split>/<batch>/sparse/0/points3D.txt     points on surfaces, each seen by one picture

or ``.bin`` of the same names (option ``model``). As COLMAP's pages describe it
(https://colmap.github.io/format.html): quaternions have w first, axes are x right, y down, z
forward, and the top-left pixel's center is (0.5, 0.5). Points are the exact hits of a grid of
pixels: what Gaussian splatting starts from.
"""

from __future__ import annotations

import itertools
import struct
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from scenec.datasets.formats import trajectory
from scenec.datasets.formats.contract import Done, Format, Info, Option, Task, Written
from scenec.datasets.formats.encode import integer_option
from scenec.datasets.formats.poses import (
    distortion,
    inverse,
    numbers,
    place_of_batch,
    product,
    require_no_skew,
    tasks_by_batch,
)
from scenec.datasets.source import FrameRef, LoadedFrame
from scenec.schemas.files import atomic
from scenec.schemas.lens import BROWN_CONRADY, KANNALA_BRANDT, directions, to_plane
from scenec.schemas.quaternions import quaternion

_LENSES = {
    BROWN_CONRADY: [("OPENCV", 4), ("FULL_OPENCV", 8)],
    KANNALA_BRANDT: [("OPENCV_FISHEYE", 4)],
}
#: Numbers of the models in binary files.
_MODELS = {"PINHOLE": 1, "OPENCV": 4, "OPENCV_FISHEYE": 5, "FULL_OPENCV": 6}
_HEADS = {
    "cameras": "# CAMERA_ID MODEL WIDTH HEIGHT PARAMS[]\n",
    "images": "# IMAGE_ID QW QX QY QZ TX TY TZ CAMERA_ID NAME\n# X Y POINT3D_ID ...\n",
    "points3D": "# POINT3D_ID X Y Z R G B ERROR IMAGE_ID POINT2D_IDX\n",
}


class Colmap(Format):
    """See the module."""

    name = "colmap"
    summary = "COLMAP model of each batch: cameras, poses, points (3D reconstruction, splatting)"
    needs = ("rgb",)
    # Pictures are taken from the PNG.
    unused = ("rgb",)
    options: ClassVar = {
        "model": Option("text", "cameras, images and points as text, or binary", ("text", "bin")),
        "points": Option("1000", "points of each picture, at most; they need the pass depth"),
    }

    def __init__(self, info: Info) -> None:
        super().__init__(info)
        self._points = integer_option(self, "points")

    def holds(self, name: str) -> bool:
        """Holds pictures, and points at some depths."""
        return name in ("rgb", "depth")

    def tasks(self, splits: Mapping[str, Sequence[FrameRef]]) -> Iterator[Task]:
        """One a frame, batch by batch."""
        return tasks_by_batch(self, splits)

    def write(
        self, task: Task, frames: Iterable[LoadedFrame], folder: Path, scratch: Path
    ) -> Written:
        """The picture, and its points."""
        (frame,) = frames
        name = f"{frame.ref.camera}/{frame.ref.sample:06d}.png"
        path = f"{place_of_batch(task)}/images/{name}"
        trajectory.copy_picture(frame, folder / path)
        pose = inverse(frame.camera_to_world)
        model, coefficients = distortion(frame, _LENSES) or ("PINHOLE", [])
        k = frame.intrinsics
        require_no_skew(frame)
        parameters = [float(k[0, 0]), float(k[1, 1]), float(k[0, 2]), float(k[1, 2])]
        places, colors, pixels = self._surface_points(frame)
        np.savez(scratch / f"{task.number:08d}", points=places, colors=colors, pixels=pixels)
        record = {
            "name": name,
            "camera": [model, frame.width, frame.height, [*parameters, *coefficients]],
            "rotation": np.roll(quaternion(pose[:3, :3]), 1).tolist(),
            "translation": pose[:3, 3].tolist(),
        }
        return Written([path], record, held={"points": len(places)})

    def finish(self, done: Iterable[Done], folder: Path, scratch: Path) -> list[str]:
        """Write the model of each batch."""
        written = []
        write = _write_text if self.option("model") == "text" else _write_binary
        suffix = ".txt" if self.option("model") == "text" else ".bin"
        for place, group in itertools.groupby(done, lambda one: place_of_batch(one.task)):
            pictures = [
                (one.record, np.load(scratch / f"{one.task.number:08d}.npz"))
                for one in group
                if one.record is not None
            ]
            if not pictures:
                continue
            there = folder / place / "sparse" / "0"
            there.mkdir(parents=True, exist_ok=True)
            write({name: there / f"{name}{suffix}" for name in _HEADS}, pictures)
            written += [f"{place}/sparse/0/{name}{suffix}" for name in _HEADS]
        return written

    def usage(self) -> str:
        """The layout, and how to load it."""
        return (
            "COLMAP: one model a batch, `<split>/<batch>/sparse/0/`, of the pictures "
            "`<split>/<batch>/images/<camera>/`. Poses are exact (world to camera, w first; world "
            "in meters, Z up), and so are points: the hits of a grid of pixels, each seen by one "
            "picture, its error 0. Load it with pycolmap: "
            '`pycolmap.Reconstruction("train/batch_0000/sparse/0")`, or give '
            "`<split>/<batch>` to a Gaussian splatting as its source."
        )

    def _surface_points(
        self, frame: LoadedFrame
    ) -> tuple[NDArray[np.float64], NDArray[np.uint8], NDArray[np.float64]]:
        """Points [n, 3] on surfaces, their colors [n, 3] and pixels [n, 2]."""
        depth = frame.passes.get("depth")
        if depth is None or not self._points:
            return np.zeros((0, 3)), np.zeros((0, 3), np.uint8), np.zeros((0, 2))
        step = max(1, int(np.ceil(np.sqrt(depth.size / self._points))))
        rows, columns = (
            index.ravel() for index in np.mgrid[step // 2 : frame.height : step,
                                                step // 2 : frame.width : step]
        )  # fmt: skip
        hit = np.isfinite(depth[rows, columns])
        rows, columns = rows[hit], columns[hit]
        pixels = np.stack([columns + 0.5, rows + 0.5], axis=1)
        rays, _ = directions(frame.lens, *to_plane(frame.intrinsics, pixels[:, 0], pixels[:, 1]))
        local = rays * (depth[rows, columns].astype(np.float64) / rays[:, 2])[:, None]
        pose = frame.camera_to_world
        places = product(local, pose[:3, :3].T) + pose[:3, 3]
        return places, trajectory.color_pixels(frame)[rows, columns], pixels


def _numbered(pictures: Sequence[tuple[dict[str, Any], Any]]) -> tuple[list[Any], list[int]]:
    """The cameras that differ, and the number of each picture's, from 1."""
    cameras: list[Any] = []
    of = []
    for record, _ in pictures:
        one = [record["name"].partition("/")[0], record["camera"]]
        if one not in cameras:
            cameras.append(one)
        of.append(1 + cameras.index(one))
    return [camera for _, camera in cameras], of


def _write_text(paths: Mapping[str, Path], pictures: Sequence[tuple[dict[str, Any], Any]]) -> None:
    cameras, camera_of = _numbered(pictures)
    lines: dict[str, list[str]] = {name: [] for name in _HEADS}
    for number, (model, width, height, parameters) in enumerate(cameras, 1):
        values = numbers(np.array(parameters))
        lines["cameras"].append(f"{number} {model} {width} {height} {values}")
    point = 1
    for at, (record, held) in enumerate(pictures, 1):
        pose = numbers(np.array([*record["rotation"], *record["translation"]]))
        lines["images"].append(f"{at} {pose} {camera_of[at - 1]} {record['name']}")
        seen = []
        of_each = zip(
            *(held[name].tolist() for name in ("points", "colors", "pixels")), strict=True
        )
        for index, (place, color, pixel) in enumerate(of_each):
            seen.append(f"{numbers(np.array(pixel))} {point}")
            text = f"{numbers(np.array(place))} {color[0]} {color[1]} {color[2]}"
            lines["points3D"].append(f"{point} {text} 0 {at} {index}")
            point += 1
        lines["images"].append(" ".join(seen))
    for name, head in _HEADS.items():
        with atomic(paths[name]) as temporary:
            temporary.write_text(head + "".join(f"{line}\n" for line in lines[name]), "utf-8")


def _write_binary(
    paths: Mapping[str, Path], pictures: Sequence[tuple[dict[str, Any], Any]]
) -> None:
    cameras, camera_of = _numbered(pictures)
    parts: dict[str, list[bytes]] = {name: [] for name in _HEADS}
    for number, (model, width, height, values) in enumerate(cameras, 1):
        head = struct.pack("<iiQQ", number, _MODELS[model], width, height)
        parts["cameras"].append(head + struct.pack(f"<{len(values)}d", *values))
    point = 1
    for at, (record, held) in enumerate(pictures, 1):
        pose = struct.pack("<7d", *record["rotation"], *record["translation"])
        pixels, count = held["pixels"], len(held["pixels"])
        name = record["name"].encode() + b"\0"
        table = np.zeros(count, [("at", "<f8", 2), ("point", "<u8")])
        table["at"], table["point"] = pixels, np.arange(point, point + count)
        head = struct.pack("<I", at) + pose + struct.pack("<I", camera_of[at - 1])
        parts["images"].append(head + name + struct.pack("<Q", count) + table.tobytes())
        for index, (place, color) in enumerate(zip(held["points"], held["colors"], strict=True)):
            shown = struct.pack("<dQII", 0.0, 1, at, index)
            parts["points3D"].append(struct.pack("<Q3d3B", point, *place, *color) + shown)
            point += 1
    counts = {"cameras": len(cameras), "images": len(pictures), "points3D": point - 1}
    for name, path in paths.items():
        with atomic(path) as temporary:
            temporary.write_bytes(struct.pack("<Q", counts[name]) + b"".join(parts[name]))
