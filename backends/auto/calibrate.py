"""A short calibration on the spot: what a few coarse pictures of one frame tell of each backend."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenec.backends.auto.curves import USUAL_WIDENING, Curve, Light, line, slope_of
from scenec.backends.converge.measure import NOT_ANNOTATION
from scenec.backends.converge.metrics import Reference, errors, root
from scenec.backends.jobs import Job, Jobs, Wanted
from scenec.backends.pool import WorkerProcess
from scenec.backends.watch import Limits
from scenec.schemas.errors import BackendError
from scenec.schemas.frames import read_frame
from scenec.schemas.manifest import Batch

Say = Callable[[str], None]

#: Samples per pixel of the pictures after the first, which does not count. Each twice: a renderer
#: may compile kernels for the first of them, and the last two together are what a backend without
#: noise is compared with.
RUNGS = (4, 4, 16, 16)
#: Of the first.
_FIRST = 2
#: Seconds that a backend draws, once it has started: no picture is begun after these.
SECONDS = 10.0


@dataclass(frozen=True)
class Measured:
    """One backend's.

    Attributes:
        curve: Its floor is not known yet if it has no noise.
        pictures: ``rgb`` of the last rung, [h, w, 3] each.
        covered: Pixels whose center a surface covers, [h, w].
    """

    curve: Curve
    pictures: tuple[NDArray[np.float32], ...]
    covered: NDArray[np.bool_] | None


def calibrate(
    batch: Batch, names: Sequence[str], wanted: Wanted, rgb: bool, limits: Limits, say: Say
) -> tuple[list[Curve], dict[str, str]]:
    """Measure backends on the first frame that is asked for.

    Args:
        batch: Whose first frame.
        names: Of the backends.
        wanted: Passes, samples, cameras and device.
        rgb: Whether light is asked for.
        limits: What a worker may take.
        say: Told what is done.

    Returns:
        (curves; for each backend that does not work here, or cannot do what is asked, why).

    Raises:
        StageError: The stage cannot be read, or has no such frame.
        OutputError: A frame cannot be written.
    """
    found: list[Measured] = []
    failed: dict[str, str] = {}
    for name in names:
        try:
            with (
                tempfile.TemporaryDirectory() as folder,
                WorkerProcess(limits=limits, on_death=say) as worker,
            ):
                aside = replace(batch, folder=Path(folder))
                found.append(_Calibration(aside, replace(wanted, backend=name), worker).all(rgb))
        except BackendError as error:
            failed[name] = str(error)
    return [_with_floor(one, found) for one in found], failed


class _Calibration:
    """One backend, one frame."""

    def __init__(self, batch: Batch, wanted: Wanted, worker: WorkerProcess) -> None:
        self._batch = batch
        self._wanted = replace(wanted, annotate_with=None, error=None, seconds=None, denoise=False)
        self._denoise = wanted.denoise
        self._worker = worker
        self._opened: dict[str, Any] = {}
        self._flat_s = 0.0

    def all(self, rgb: bool) -> Measured:
        """Start it, and draw."""
        wanted = self._wanted
        start = time.perf_counter()
        opened = self._opened = Jobs(self._batch, wanted).open(self._worker, None)
        if self._denoise and opened["denoiser"] is None:
            raise BackendError(f"backend {wanted.backend} has no denoiser")
        first = self._job(_FIRST, 0, None)
        pixels = opened["cameras"][first.request["sample"]][first.request["camera"]]["pixels"]
        annotation = [name for name in first.key.passes if name != "rgb"]
        # Depth says which pixels surfaces cover.
        seen = list(dict.fromkeys([*annotation, "depth"]))
        self._ask(self._job(_FIRST, 0, ["rgb", *seen] if rgb else seen))
        start_s = time.perf_counter() - start
        covered = None
        annotation_s = 0.0
        if annotation or rgb:
            answer = self._ask(job := self._job(_FIRST, 0, seen))
            annotation_s = sum(v for k, v in answer["seconds"].items() if k not in NOT_ANNOTATION)
            covered = np.isfinite(read_frame(job.stem).passes["depth"])
        facts = (wanted.backend, opened["version"], opened["device"])
        if not rgb:
            curve = Curve(*facts, False, start_s, annotation_s, pixels, None, None)
            return Measured(curve, (), covered)
        light, pictures = self._light()
        return Measured(
            Curve(
                *facts, light is not None, start_s, annotation_s, pixels,
                light or Light(self._flat_s, 0.0, 0.0, 0.0, 1.0),
                None if light is None else 0.0,
            ),
            pictures,
            covered,
        )  # fmt: skip

    def _light(self) -> tuple[Light | None, tuple[NDArray[np.float32], ...]]:
        """Pictures until all rungs are drawn or the seconds are used; None without noise."""
        begin = time.perf_counter()
        seconds: dict[int, float] = {}
        sizes: dict[int, float] = {}
        squares: list[float] = []
        widening: list[float] = []
        pictures: list[NDArray[np.float32]] = []
        for seed, count in enumerate(RUNGS):
            if seed and time.perf_counter() - begin > SECONDS:
                break
            answer = self._ask(job := self._job(count, seed + 1, ["rgb"]))
            took = answer["seconds"]
            spent = float(took["radiance"]) + float(took.get("haze", 0.0))
            noise = answer["estimated_error"]["relative_rms"]
            picture = read_frame(job.stem).passes["rgb"]
            if noise is None:
                self._flat_s = spent
                return None, (picture,)
            drawn = int(answer["samples_per_pixel"])
            if drawn not in seconds:
                squares, pictures = [], []
            else:
                sizes[drawn] = max(0.0, seconds[drawn] - spent)
            seconds[drawn] = min(spent, seconds.get(drawn, spent))
            squares.append(noise**2)
            pictures.append(picture)
            if noise > 0.0:
                widening.append(answer["estimated_error"]["relative_rms_bound_95"] / noise)
        slope = slope_of(self._wanted.backend)
        spp = list(seconds)
        error = float(np.sqrt(np.mean(squares))) / spp[-1] ** slope
        wide = float(np.median(widening)) if widening else USUAL_WIDENING
        size_s = float(np.median(list(sizes.values()))) if sizes else 0.0
        light = Light(*line(spp, list(seconds.values())), error, slope, wide, size_s)
        return light, tuple(pictures)

    def _ask(self, job: Job) -> dict[str, Any]:
        return self._worker.ask(job.request, f"{self._wanted.backend} {job.what}")

    def _job(self, spp: int, seed: int, passes: Sequence[str] | None) -> Job:
        """The first frame of all, with passes of its own."""
        opened = self._opened
        if passes is not None:
            cameras = [
                [{**camera, "passes": list(passes)} for camera in cameras]
                for cameras in opened["cameras"]
            ]
            opened = {**opened, "cameras": cameras}
        jobs = Jobs(self._batch, replace(self._wanted, spp=spp, noise_seed=seed))
        jobs.take(opened)
        return next(iter(jobs))


def _with_floor(one: Measured, all_: Sequence[Measured]) -> Curve:
    """The distance of one without noise to the farthest of those with."""
    curve = one.curve
    if curve.light is None or curve.stochastic:
        return curve
    floors = []
    for other in all_:
        if other.curve.stochastic and len(other.pictures) == 2 and other.covered is not None:
            a, b = (picture[other.covered] for picture in other.pictures)
            picture = one.pictures[0][other.covered]
            square = errors(picture, Reference.of_two(a, b)).relative_ms
            floors.append(root(square) or 0.0)
    return replace(curve, floor=max(floors, default=None))
