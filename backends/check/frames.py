"""Checks of frames: whole, of this stage, and consistent in themselves."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from scenec.backends.check.finding import Finding
from scenec.backends.check.instances import check_batch_table, table_faults
from scenec.backends.picture.brightness import brief, told
from scenec.schemas.errors import FrameError
from scenec.schemas.frames import Frame, read_frame
from scenec.schemas.manifest import FRAMES
from scenec.schemas.strays import Firing, strays

_NO_FACE = 0xFFFFFFFF


def check_frames(
    folder: Path, digest: str | None, firing: Firing | None = None
) -> Iterator[Finding]:
    """Findings on all frames of a batch.

    Args:
        folder: The batch's folder.
        digest: Digest of its stage; None where that cannot be read.
        firing: When its cameras are triggered; None likewise.
    """
    frames = folder / FRAMES
    astray = {} if firing is None else dict(strays(folder, firing))
    yield from check_batch_table(frames, digest, _name(frames, folder))
    for exr in sorted(frames.glob("*/*/*.exr")):
        if not exr.with_suffix(".json").is_file():
            yield Finding("frames", "error", _name(exr, folder), "has no sidecar: cut short?")
    pictures: dict[Path, list[dict[str, Any]]] = {}
    for path in sorted(frames.glob("*/*/*.json")):
        where = _name(path, folder)
        if path in astray:
            message = (
                f"not of this stage: {astray[path]}; no render replaces it and exports pass it "
                f"over: delete {path.stem}.*"
            )
            yield Finding("frames", "warning", where, message)
            continue
        try:
            frame = read_frame(path)
        except FrameError as error:
            yield Finding("frames", "error", where, str(error))
            continue
        pictures.setdefault(path.parent, []).append(brief(frame.sidecar))
        if digest is not None and frame.sidecar.get("stage_digest") != digest:
            message = "was rendered from another stage; render again"
            yield Finding("frames", "warning", where, message)
        for message in (*inconsistencies(frame), *table_faults(frame)):
            yield Finding("frames", "error", where, message)
    for camera, sidecars in pictures.items():
        line = told(sidecars)
        if line is not None:
            yield Finding("brightness", "warning", _name(camera, folder), line)


def _name(path: Path, folder: Path) -> str:
    return path.relative_to(folder.parent).as_posix()


def inconsistencies(frame: Frame) -> Iterator[str]:
    """What a frame's passes say against its sidecar and each other."""
    width, height = frame.sidecar["resolution"]
    passes = frame.passes
    for name, array in passes.items():
        if array.shape[:2] != (height, width):
            yield f"{name} is {array.shape[1]} x {array.shape[0]}, expected {width} x {height}"
            return
    missing = [name for name in frame.sidecar["passes"] if name not in passes]
    if missing:
        yield f"lacks {', '.join(missing)}"
    if "rgb" in passes and not (np.isfinite(passes["rgb"]).all() and passes["rgb"].min() >= 0.0):
        yield "rgb holds values that are negative or not finite"
    if "depth" in passes:
        depth = passes["depth"]
        if np.isnan(depth).any() or depth.min(initial=1.0) <= 0.0:
            yield "depth holds NaN, or values that are not above 0"
        for name in ("instance", "face"):
            if name in passes:
                nothing = 0 if name == "instance" else _NO_FACE
                count = int((np.isinf(depth) & (passes[name] != nothing)).sum())
                if count:
                    yield f"{count} pixels have a {name} but no depth"
    yield from _unknown_labels(passes, frame.sidecar)


def _unknown_labels(passes: dict[str, Any], sidecar: dict[str, Any]) -> Iterator[str]:
    for name, array in passes.items():
        if not name.startswith("label."):
            continue
        known = {0, *map(int, sidecar["labels"].get(name.removeprefix("label."), {}))}
        unknown = sorted(set(np.unique(array).tolist()) - known)
        if unknown:
            yield f"{name} holds ids {unknown[:5]} that the table lacks"
