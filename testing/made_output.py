"""Output folders with frames made up by hand: any ids, any depth, no renderer, in milliseconds."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenec.datasets.export import Choice, export
from scenec.schemas.exr import write_exr
from scenec.schemas.files import sha256, tree
from scenec.schemas.frames import CONVENTIONS, FRAME_VERSION, frame_stem
from scenec.schemas.instances import (
    AMODAL_COLUMNS,
    BOX_COLUMNS,
    DEPTH_COLUMNS,
    PIXEL_COLUMNS,
    POSE_COLUMNS,
    frame_table_path,
    write_frame_table,
)
from scenec.schemas.manifest import read_manifest, stage_digest
from scenec.schemas.picture import develop, write_png

Passes = dict[str, NDArray[Any]]

LABELS = {
    "class": {1: "sky", 2: "ground", 3: "rock"},
    "surface": {7: "Himmel über uns", 20: "sand", 300: "stone"},
}
SKY = {"class": 1, "surface": 7}
EXPOSURE_EV = -1.0


def some_passes(seed: int, width: int = 12, height: int = 8, rgb: bool = True) -> Passes:
    """Sky above, ground below, a few blocks of rock with ids of all sizes."""
    rng = np.random.default_rng(seed)
    depth = rng.uniform(1.0, 90.0, (height, width)).astype(np.float32)
    labels = np.full((height, width), 2, np.uint32)
    surface = np.full((height, width), 20, np.uint32)
    ids = np.zeros((height, width), np.uint32)
    sky = height // 4
    depth[:sky], labels[:sky], surface[:sky] = np.inf, 1, 7
    for number in (5, 70_000, 3_000_000_000 + seed):
        y, x = int(rng.integers(sky, height)), int(rng.integers(0, width))
        block = np.s_[y : y + 2, x : x + 3]
        ids[block], labels[block], surface[block] = number, 3, 300
    passes: Passes = (
        {"rgb": rng.uniform(0, 3, (height, width, 3)).astype(np.float32)} if rgb else {}
    )
    return passes | {
        "label.class": labels,
        "label.surface": surface,
        "instance": ids,
        "depth": depth,
    }


def frame_table(
    passes: Mapping[str, NDArray[Any]], labels: Mapping[str, Mapping[int, str]] = LABELS
) -> dict[str, NDArray[Any]]:
    """A table that is true of the pixels; poses and sizes are made up from the ids."""
    ids = passes["instance"]
    depth = passes.get("depth", np.ones(ids.shape, np.float32))
    levels = [name for name in passes if name.startswith("label.")]
    names = ["id", "class", "local_id", *levels, *PIXEL_COLUMNS, *DEPTH_COLUMNS, *AMODAL_COLUMNS]
    names += [*POSE_COLUMNS, *BOX_COLUMNS]
    rows: list[list[Any]] = []
    for number in np.unique(ids[ids > 0]).tolist():
        y, x = np.nonzero(ids == number)
        seen = depth[y, x]
        found = []
        for level in levels:
            kinds = np.unique(passes[level][y, x]).tolist()
            known = labels[level.removeprefix("label.")]
            found.append(known.get(kinds[0], "") if len(kinds) == 1 else "")
        edge = x.min() == 0 or y.min() == 0
        edge = edge or x.max() == ids.shape[1] - 1 or y.max() == ids.shape[0] - 1
        pose = [number % 97 / 7.0, -1.5, 4.0, 0.5, -0.5, 0.5, 0.5]
        rows.append(
            [
                *(number, "/World/Objects/rocks", number % 1000, *found),
                *(len(x), x.min(), y.min(), x.max(), y.max(), int(edge)),
                *(seen.min(), seen.mean(), seen.max(), len(x) + 1, len(x) + 2, 1),
                *(*pose, *pose, 1.0, 2.0, 3.0, 0.0, 0.25, 0.0),
            ]
        )
    text = ("class", *levels)
    whole = ("id", "local_id", *PIXEL_COLUMNS, *AMODAL_COLUMNS)
    return {
        name: np.array(
            [row[i] for row in rows],
            np.str_ if name in text else np.int64 if name in whole else np.float64,
        )
        for i, name in enumerate(names)
    }


def make_output(
    folder: Path,
    make: Callable[[int], Passes] = some_passes,
    *,
    batches: int = 2,
    cameras: tuple[str, ...] = ("rover_left", "rover_right"),
    samples: int = 2,
    labels: Mapping[str, Mapping[int, str]] | None = None,
    name: str = "made",
) -> Path:
    """An output folder as ``compile`` and ``render`` leave it, with stages that are mere files.

    Args:
        folder: To be made.
        make: Number of a frame, from 0, to its passes.
        batches: How many.
        cameras: Names.
        samples: How many a batch.
        labels: Names of labels; None takes ``LABELS``.
        name: Of the cfg.
    """
    folder.mkdir(parents=True)
    manifest: dict[str, Any] = {"name": name, "seed": 0, "batches": [], "files": {}}
    for batch in range(batches):
        path = f"batch_{batch:04d}"
        (folder / path).mkdir()
        stage = folder / path / "stage.usda"
        stage.write_text(f"#usda 1.0\n# {batch}\n", encoding="utf-8")
        manifest["files"][f"{path}/stage.usda"] = {"sha256": sha256(stage)}
        manifest["batches"].append(
            {"index": batch, "path": path, "stage": f"{path}/stage.usda", "samples": samples}
        )
    (folder / "manifest.json").write_text(json.dumps(manifest), encoding="utf-8")
    number = 0
    for batch in range(batches):
        path = f"batch_{batch:04d}"
        for camera in cameras:
            for sample in range(samples):
                stem = frame_stem(folder / path, "annotation", camera, sample)
                digest = stage_digest(read_manifest(folder), path)
                _write(stem, make(number), camera, sample, digest, labels or LABELS)
                number += 1
    return folder


def pose_of(camera: str, sample: int) -> NDArray[np.float64]:
    """Camera to world of a made-up frame: level, looking along a heading that turns by sample."""
    angle = 0.3 + 0.5 * sample + 0.1 * len(camera)
    c, s = np.cos(angle), np.sin(angle)
    pose = np.eye(4)
    pose[:3, 0], pose[:3, 1], pose[:3, 2] = (s, -c, 0.0), (0.0, 0.0, -1.0), (c, s, 0.0)
    pose[:3, 3] = (1.0 + sample, -2.0, 1.25)
    return pose


def _write(
    stem: Path,
    passes: Passes,
    camera: str,
    sample: int,
    digest: str,
    labels: Mapping[str, Mapping[int, str]],
) -> None:
    stem.parent.mkdir(parents=True, exist_ok=True)
    exr = stem.with_suffix(".exr")
    write_exr(exr, passes)
    if "rgb" in passes:
        write_png(stem.with_suffix(".png"), develop(passes["rgb"], EXPOSURE_EV))
    if "instance" in passes:
        write_frame_table(frame_table_path(stem), frame_table(passes, labels))
    height, width = next(iter(passes.values())).shape[:2]
    sidecar = {
        "version": FRAME_VERSION,
        "camera": camera,
        "sample": sample,
        "time_s": 0.5 * sample,
        "resolution": [width, height],
        "intrinsics": [[10.0, 0.0, width / 2], [0.0, 11.0, height / 2], [0.0, 0.0, 1.0]],
        "camera_to_world": pose_of(camera, sample).tolist(),
        "exposure_ev": EXPOSURE_EV,
        "passes": list(passes),
        "conventions": CONVENTIONS,
        "labels": {
            level: {str(i): text for i, text in names.items()} for level, names in labels.items()
        },
        "sky_labels": SKY,
        "backend": "annotation",
        "stage_digest": digest,
        "exr": {"bytes": exr.stat().st_size, "sha256": sha256(exr)},
        "png": "rgb" in passes,
    }
    stem.with_suffix(".json").write_text(json.dumps(sidecar, indent=1), encoding="utf-8")


def small_ids(number: int) -> Passes:
    """``some_passes`` with ids that every format can hold."""
    passes = some_passes(number)
    return passes | {"instance": passes["instance"] % np.uint32(1000)}


def exported(out: Path, form: str, folder: Path, **options: str) -> Path:
    """Exports with options of the format; returns the dataset's folder."""
    return export(out, form, folder, Choice(options=options)).folder


def edit(path: Path, **values: Any) -> None:
    """Puts values into a JSON file, such as a sidecar."""
    path.write_text(json.dumps(json.loads(path.read_bytes()) | values), encoding="utf-8")


def same_tree(a: Path, b: Path) -> bool:
    """Whether two folders hold the same files with the same bytes."""
    files = tree(a)
    return files == tree(b) and all(sha256(a / path) == sha256(b / path) for path in files)
