"""Do backends agree: annotation, pixel by pixel."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from scenec.backends.reader import read_stage
from scenec.backends.render import render
from scenec.backends.resolver import pass_names
from scenec.schemas.errors import FrameError
from scenec.schemas.frames import Frame, frame_stem, read_frame
from scenec.schemas.manifest import Batch, find_batches

#: What is compared where the stage does not say what it wants.
ANNOTATION = ("label", "instance", "depth")


@dataclass
class Comparison:
    """One channel of two backends, over all frames.

    Attributes:
        channel: Pass name.
        first, second: Backends.
        pixels: Compared.
        differing: With different bits.
    """

    channel: str
    first: str
    second: str
    pixels: int = 0
    differing: int = 0


@dataclass(frozen=True)
class Agreement:
    """What comparing found.

    Attributes:
        comparisons: One a channel and pair.
        raw: Per backend, pixels that the renderer itself had wrong before they were resolved.
        frames: Frames compared.
    """

    comparisons: tuple[Comparison, ...]
    raw: dict[str, int]
    frames: int


def compare(
    out: Path, backends: Sequence[str], say: Callable[[str], None] = lambda _text: None
) -> Agreement:
    """Compares the annotation of the first backend with that of each other.

    Frames that are there and made from this very stage are taken, whatever else they hold; missing
    ones are rendered, annotation only.

    Args:
        out: Output folder, or a USD file.
        backends: Two or more names.
        say: Told what is rendered.

    Raises:
        ScenecError: A stage cannot be read, or a backend fails.
    """
    comparisons: dict[tuple[str, str], Comparison] = {}
    raw = dict.fromkeys(backends, 0)
    count = 0
    for index, batch in enumerate(find_batches(out)):
        scene = read_stage(batch.stage)
        wanted = tuple(name for name in scene.outputs if name != "rgb") or ANNOTATION
        channels = pass_names(scene, wanted)
        for backend in backends:
            stems = _stems(batch, backend, scene.cameras)
            if not all(_usable(stem, scene.digest, channels) for stem in stems):
                say(f"rendering the annotation of {batch.name} with {backend}")
                render(
                    batch.stage if out.is_file() else out,
                    backend,
                    passes=wanted,
                    batches=None if out.is_file() else range(index, index + 1),
                )
        for of_frame in zip(*(_stems(batch, b, scene.cameras) for b in backends), strict=True):
            frames = [read_frame(stem, channels) for stem in of_frame]
            count += 1
            for backend, frame in zip(backends, frames, strict=True):
                raw[backend] += int(frame.sidecar.get("resolver", {}).get("changed", 0))
            for backend, frame in zip(backends[1:], frames[1:], strict=True):
                for channel in channels:
                    key = (backend, channel)
                    entry = comparisons.setdefault(key, Comparison(channel, backends[0], backend))
                    _count(entry, frames[0], frame)
    return Agreement(tuple(comparisons.values()), raw, count)


def _stems(batch: Batch, backend: str, cameras: tuple) -> list[Path]:
    return [
        frame_stem(batch.folder, backend, camera.name, sample)
        for sample, of_sample in enumerate(cameras)
        for camera in of_sample
    ]


def _usable(stem: Path, digest: str, channels: Sequence[str]) -> bool:
    try:
        return bool(read_frame(stem, channels).sidecar.get("stage_digest") == digest)
    except FrameError:
        return False


def _count(entry: Comparison, first: Frame, second: Frame) -> None:
    a, b = first.passes[entry.channel], second.passes[entry.channel]
    entry.pixels += int(a.shape[0] * a.shape[1])
    entry.differing += int(differing(a, b).sum())


def differing(a: NDArray, b: NDArray) -> NDArray[np.bool_]:
    """Pixels whose bits differ, bool [h, w]; NaN equals NaN."""
    same = a.view(np.uint32) == b.view(np.uint32)
    return ~(same.all(axis=2) if same.ndim == 3 else same)
