"""An output folder whose frames hold given arrays, written as renderers' frames are."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenec.backends.frames import write_frame
from scenec.backends.render_scene import Camera, RenderScene, Rows
from scenec.schemas import rle
from scenec.schemas.files import write_json
from scenec.schemas.frames import FrameKey, frame_stem
from scenec.schemas.manifest import stage_digest

LABELS = {
    "class": {1: "sky", 2: "ground", 3: "rock", 4: "plant"},
    "surface": {7: "air", 20: "sand", 30: "stone", 31: "gravel", 40: "leaf"},
}


def table_of(
    instance: NDArray[np.uint32], labels: Mapping[int, Mapping[str, str]]
) -> dict[str, NDArray[Any]]:
    """The table of a frame's instances, as far as it follows from pixels.

    Args:
        instance: Ids [h, w].
        labels: Id -> level -> name of the label that all its faces share; "" where not given.
    """
    ids = np.unique(instance[instance > 0])
    areas, boxes = rle.boxes(instance, ids)
    far = boxes[:, :2] + boxes[:, 2:] - 1
    h, w = instance.shape
    at_border = (boxes[:, :2] == 0).any(axis=1) | (far == [w - 1, h - 1]).any(axis=1)
    return {
        "id": ids.astype(np.int64),
        "class": np.full(len(ids), "/World/Objects/rocks", np.str_),
        "local_id": ids.astype(np.int64),
        **{
            f"label.{level}": np.array(
                [labels.get(i, {}).get(level, "") for i in ids.tolist()], np.str_
            )
            for level in LABELS
        },
        "pixels": areas,
        "x_min": boxes[:, 0],
        "y_min": boxes[:, 1],
        "x_max": far[:, 0],
        "y_max": far[:, 1],
        "truncated": at_border.astype(np.int64),
        "depth_min": ids % 7 + 1.5,
        "depth_mean": ids % 7 + 2.5,
    }


def made_output(
    out: Path,
    frames: Sequence[tuple[Mapping[str, NDArray[Any]], dict[str, NDArray[Any]] | None]],
    *,
    batches: int = 1,
    camera: str = "cam",
    labels: Mapping[str, Mapping[int, str]] | None = None,
) -> Path:
    """Write an output: batch by batch the same number of samples.

    Args:
        out: Folder.
        frames: Passes and table of each frame, in order of batch and sample.
        batches: How many; each gets as many of the frames.
        camera: Its name.
        labels: Level -> id -> name; None takes ``LABELS``.
    """
    names = [f"batch_{i:04d}" for i in range(batches)]
    samples = len(frames) // batches
    manifest: dict[str, Any] = {
        "name": "made",
        "batches": [
            {"index": i, "path": name, "stage": f"{name}/stage.usda", "samples": samples}
            for i, name in enumerate(names)
        ],
        "files": {
            f"{name}/stage.usda": {"sha256": hashlib.sha256(name.encode()).hexdigest()}
            for name in names
        },
    }
    write_json(out / "manifest.json", manifest)
    for number, (passes, table) in enumerate(frames):
        batch, sample = divmod(number, samples)
        _write(out / names[batch], stage_digest(manifest, names[batch]), camera, sample, samples,
               passes, table, LABELS if labels is None else labels)  # fmt: skip
    return out


def _write(
    folder: Path,
    digest: str,
    camera_name: str,
    sample: int,
    samples: int,
    passes: Mapping[str, NDArray[Any]],
    table: dict[str, NDArray[Any]] | None,
    labels: Mapping[str, Mapping[int, str]],
) -> None:
    h, w = next(iter(passes.values())).shape[:2]
    intrinsics = np.array([[w, 0, w / 2], [0, w, h / 2], [0, 0, 1]], np.float64)
    pose = np.eye(4)
    pose[0, 3] = 0.5 * sample
    camera = Camera(camera_name, f"/World/Rigs/{camera_name}", w, h, intrinsics, pose)
    nothing = np.zeros(0)
    scene = RenderScene(
        source=folder / "stage.usda",
        digest=digest,
        samples=samples,
        meshes=(),
        rows=Rows(nothing.astype("i4"), np.zeros((0, 3, 4)), nothing.astype("u4"), nothing),
        surfaces=(),
        levels=tuple(labels),
        label_names={level: dict(names) for level, names in labels.items()},
        sky_labels={level: min(names, default=0) for level, names in labels.items()},
        cameras=((camera,),) * samples,
        lighting=(),
        bounds=np.zeros((2, 3)),
        instance_paths={"/World/Objects/rocks": 0},
        times=0.1 * np.arange(samples),
    )
    key = FrameKey(digest, tuple(passes), 0, 0, "reference", "1")
    stem = frame_stem(folder, "reference", camera_name, sample)
    write_frame(stem, passes, key, scene, camera, sample, {}, table=table)
