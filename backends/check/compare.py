"""Do backends agree: annotation, pixel by pixel."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from scenec.backends.reader import read_stage
from scenec.backends.render import render
from scenec.backends.render_scene import Camera, RenderScene
from scenec.backends.resolver import pass_names
from scenec.schemas.errors import BackendError, FrameError
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

    Frames that are there and made from this very stage are taken, whatever else they hold. Samples
    that a backend has no frames of are rendered into the output, annotation only; where frames are
    there but do not serve (stale, or without a pass), annotation is rendered aside: nothing that
    is there is touched.

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
    for batch in find_batches(out):
        scene = read_stage(batch.stage)
        with tempfile.TemporaryDirectory() as aside:
            stems = [_ready(batch, name, scene, Path(aside) / name, say) for name in backends]
            for of_frame in zip(*stems, strict=True):
                frames = [read_frame(stem) for stem in of_frame]
                count += 1
                for backend, frame in zip(backends, frames, strict=True):
                    raw[backend] += int(frame.sidecar.get("resolver", {}).get("changed", 0))
                for backend, frame in zip(backends[1:], frames[1:], strict=True):
                    for channel in (n for n in frames[0].passes if n in frame.passes):
                        if channel != "rgb":
                            pair = Comparison(channel, backends[0], backend)
                            entry = comparisons.setdefault((backend, channel), pair)
                            _count(entry, frames[0], frame)
    return Agreement(tuple(comparisons.values()), raw, count)


def _ready(
    batch: Batch, backend: str, scene: RenderScene, aside: Path, say: Callable[[str], None]
) -> list[Path]:
    """Frames of one backend that can be compared, in order; missing ones are rendered first."""
    missing, unusable = [], []
    for sample, cameras in enumerate(scene.cameras):
        stems = [frame_stem(batch.folder, backend, camera.name, sample) for camera in cameras]
        if not any(stem.with_suffix(".json").is_file() for stem in stems):
            missing.append(sample)
        elif not all(
            _usable(stem, scene, camera) for stem, camera in zip(stems, cameras, strict=True)
        ):
            unusable.append(sample)
    wanted = _annotation(scene)
    for samples, folder in ((missing, batch.folder), (unusable, aside)):
        if samples:
            say(
                f"rendering the annotation of {len(samples)} samples of {batch.name} with {backend}"
            )
            # The stage itself, so that the folder is the one we say.
            report = render(batch.stage, backend, passes=wanted, samples=samples, folder=folder)
            if report.failed:
                raise BackendError(report.failed[0])
    found: list[Path] = []
    for sample, cameras in enumerate(scene.cameras):
        folder = aside if sample in unusable else batch.folder
        found.extend(frame_stem(folder, backend, camera.name, sample) for camera in cameras)
    return found


def _annotation(scene: RenderScene) -> tuple[str, ...]:
    """All annotation that any camera asks for."""
    asked = [name for cameras in scene.cameras for camera in cameras for name in camera.outputs]
    return tuple(dict.fromkeys(name for name in asked if name != "rgb")) or ANNOTATION


def _usable(stem: Path, scene: RenderScene, camera: Camera) -> bool:
    wanted = [name for name in camera.outputs if name != "rgb"] or ANNOTATION
    try:
        frame = read_frame(stem, pass_names(scene, wanted))
    except FrameError:
        return False
    return bool(frame.sidecar.get("stage_digest") == scene.digest)


def _count(entry: Comparison, first: Frame, second: Frame) -> None:
    a, b = first.passes[entry.channel], second.passes[entry.channel]
    entry.pixels += int(a.shape[0] * a.shape[1])
    entry.differing += int(differing(a, b).sum())


def differing(a: NDArray, b: NDArray) -> NDArray[np.bool_]:
    """Pixels whose bits differ, bool [h, w]; NaN equals NaN."""
    same = a.view(np.uint32) == b.view(np.uint32)
    return ~(same.all(axis=2) if same.ndim == 3 else same)
