"""Frames whose pictures a sensor took: no picture here can be made from radiance."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from scenec.schemas.files import sha256
from scenec.schemas.frames import BESIDE, extra_path
from scenec.schemas.picture import write_png


def add_sensor(
    out: Path, cameras: Sequence[str] | None = None, kinds: Sequence[str] = BESIDE
) -> None:
    """Gives frames other pictures than their radiance has, and pictures beside them.

    Args:
        out: An output folder.
        cameras: Whose frames; None: all.
        kinds: What lies beside the pictures.
    """
    for number, path in enumerate(sorted(out.glob("batch_*/frames/*/*/*.json"))):
        told = json.loads(path.read_bytes())
        if cameras is not None and told["camera"] not in cameras:
            continue
        width, height = told["resolution"]
        rng = np.random.default_rng(number)
        stem = path.with_suffix("")
        write_png(stem.with_suffix(".png"), _smooth(rng, width, height))
        beside: dict[str, Any] = {}
        for kind in kinds:
            file = extra_path(stem, kind)
            raw = rng.integers(0, 2**16, (height, width), np.uint16)
            write_png(file, raw if kind == "raw" else _smooth(rng, width, height))
            beside[kind] = {"bytes": file.stat().st_size, "sha256": sha256(file)}
        told["imaging"] = {"parameters": {"mosaic": "grbg"}} | {k: beside.get(k) for k in BESIDE}
        path.write_text(json.dumps(told), encoding="utf-8")


def _smooth(rng: np.random.Generator, width: int, height: int) -> NDArray[np.uint8]:
    """Gradients of any color, which JPEG keeps."""
    y, x = np.mgrid[0:height, 0:width]
    corner, along, down = rng.uniform(40, 120, (3, 3))
    colors = corner + along * (x / width)[..., None] + down * (y / height)[..., None]
    return np.clip(colors, 0, 255).astype(np.uint8)


def on_disk(out: Path, camera: str, sample: int, batch: int = 0) -> dict[str, NDArray[Any]]:
    """What Pillow reads of a frame's pictures: ``picture``, and what lies beside it."""
    folder = next(out.glob(f"batch_{batch:04d}/frames/*/{camera}"))
    stem = folder / f"{sample:06d}"
    files = {"picture": stem.with_suffix(".png")}
    files |= {kind: extra_path(stem, kind) for kind in BESIDE}
    return {kind: np.asarray(Image.open(f)) for kind, f in files.items() if f.is_file()}
