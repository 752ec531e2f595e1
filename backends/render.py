"""Render what was compiled: every batch, camera and sample, each once."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

from scenec.backends.pool import FrameLostError, WorkerProcess
from scenec.backends.registry import require_name
from scenec.schemas.errors import BackendError, StageError
from scenec.schemas.frames import FrameKey, frame_stem, is_done
from scenec.schemas.manifest import Batch, find_batches

#: ``progress(done, total, text)``, called after each frame.
Progress = Callable[[int, int, str], None]


@dataclass
class RenderReport:
    """What came of a render.

    Attributes:
        frames: Paths of all sidecars asked for, without suffix ``.json``, in order.
        rendered: Frames made now.
        skipped: Frames that were there already, made with the same key.
        deaths: Worker processes that died and were replaced.
        failed: A line about each frame that was given up; the others are there.
        seconds: Per step (load, radiance, compose, visibility, resolve, write), summed.
        warnings: Lines a user should see, each once.
    """

    frames: list[Path] = field(default_factory=list)
    rendered: int = 0
    skipped: int = 0
    deaths: int = 0
    failed: list[str] = field(default_factory=list)
    seconds: dict[str, float] = field(default_factory=dict)
    warnings: list[str] = field(default_factory=list)


def render(
    out: Path | str,
    backend: str,
    *,
    spp: int = 64,
    passes: Sequence[str] | None = None,
    samples: Collection[int] | None = None,
    batches: Collection[int] | None = None,
    noise_seed: int = 0,
    folder: Path | None = None,
    progress: Progress | None = None,
    warn: Callable[[str], None] | None = None,
) -> RenderReport:
    """Render to ``<batch>/frames/<backend>/<camera>/<sample>.{exr,png,json}``.

    Frames that are there and were made from the same stage with the same passes, samples per pixel,
    noise seed and backend are not made again.

    Args:
        out: Output folder of a compile, or a USD file (its frames go beside it).
        backend: Name, see ``registry``.
        spp: Samples per pixel of ``rgb``.
        passes: ``rgb``, ``depth``, ``range``, ``label`` (all levels) or ``label.<level>``,
            ``instance``, ``normal``, ``position``, ``face``; None takes the stage's own choice.
        samples: Only these time codes.
        batches: Only these batches.
        noise_seed: Renderings with different ones have independent noise.
        folder: Where frames go (``<folder>/frames``; for several batches, a folder each in it);
            None puts them into the batches' own.
        progress: Called after each frame.
        warn: Called with lines worth showing at once.

    A frame that kills its worker again and again is given up, said in ``failed``, and costs no
    other.

    Raises:
        StageError: Nothing to render, or a stage that cannot be read.
        BackendError: The backend is not there, or cannot do what is asked.
        OutputError: No manifest, or a frame cannot be written.
    """
    require_name(backend)
    if spp < 1:
        raise BackendError(f"samples per pixel must be at least 1, not {spp}")
    report = RenderReport()

    def note(line: str) -> None:
        if line not in report.warnings:
            report.warnings.append(line)
            if warn:
                warn(line)

    chosen = find_batches(Path(out), batches)
    for number, batch in enumerate(chosen):
        if folder is not None:
            batch = replace(batch, folder=folder if len(chosen) == 1 else folder / batch.name)
        # A process per batch: memory goes back, whatever the renderer keeps.
        with WorkerProcess(on_death=note) as worker:
            jobs = _Jobs(batch, backend, spp, passes, samples, noise_seed)
            opened = jobs.open(worker)
            if opened["warning"]:
                note(opened["warning"])
            for index, job in enumerate(jobs):
                report.frames.append(job.stem)
                if is_done(job.stem, job.key):
                    report.skipped += 1
                    text = f"{job.what}: there already"
                else:
                    text = _render_one(worker, job, report, note)
                if progress:
                    before = number * jobs.count
                    progress(before + index + 1, len(chosen) * jobs.count, text)
            report.deaths += worker.deaths
    if not report.frames:
        raise StageError(f"{out}: no frame to render: no camera, or no sample in the range asked")
    return report


def _render_one(
    worker: WorkerProcess, job: _Job, report: RenderReport, note: Callable[[str], None]
) -> str:
    """Makes one frame; what a renderer cannot survive costs that frame and no other."""
    try:
        answer = worker.ask(job.request, job.what)
    except FrameLostError as error:
        report.failed.append(str(error))
        note(str(error))
        return f"{job.what}: given up"
    report.rendered += 1
    for step, seconds in answer["seconds"].items():
        report.seconds[step] = report.seconds.get(step, 0.0) + seconds
    return f"{job.what}: {describe(answer)}"


def frame_seed(noise_seed: int, batch: str, camera: str, sample: int) -> int:
    """Seed of one frame's noise, 32 bits: no two frames share their noise."""
    text = f"{noise_seed}/{batch}/{camera}/{sample}"
    return int.from_bytes(hashlib.blake2b(text.encode(), digest_size=4).digest(), "little")


def describe(answer: dict[str, Any]) -> str:
    """One line about a frame: seconds by step, and how far ``rgb`` is from converged."""
    seconds = answer["seconds"]
    parts = [f"{sum(seconds.values()):.2f} s"]
    parts += [f"{step} {value:.2f}" for step, value in seconds.items() if value >= 0.005]
    if answer.get("estimated_error"):
        error = answer["estimated_error"]["relative_rms"]
        parts.append("error unknown" if error is None else f"error {100 * error:.1f} %")
    return ", ".join(parts)


@dataclass(frozen=True)
class _Job:
    stem: Path
    what: str
    key: FrameKey
    request: dict[str, Any]


class _Jobs:
    """The frames of one batch, once its stage has been opened."""

    def __init__(
        self,
        batch: Batch,
        backend: str,
        spp: int,
        passes: Sequence[str] | None,
        samples: Collection[int] | None,
        noise_seed: int,
    ) -> None:
        self._batch = batch
        self._backend = backend
        self._spp = spp
        self._passes = passes
        self._wanted = samples
        self._noise_seed = noise_seed
        self._places: list[tuple[int, int]] = []
        self._opened: dict[str, Any] = {}

    @property
    def count(self) -> int:
        return len(self._places)

    def open(self, worker: WorkerProcess) -> dict[str, Any]:
        opened = worker.open(
            {
                "op": "open",
                "stage": str(self._batch.stage.resolve()),
                "backend": self._backend,
                "passes": None if self._passes is None else list(self._passes),
            }
        )
        self._opened = opened
        there = range(opened["samples"])
        beyond = [sample for sample in self._wanted or () if sample not in there]
        if beyond:
            raise StageError(
                f"{self._batch.stage}: has samples 0 to {len(there) - 1}, not {beyond[0]}"
            )
        self._places = [
            (sample, index)
            for sample in (there if self._wanted is None else sorted(self._wanted))
            for index in range(len(opened["cameras"][sample]))
        ]
        for sample, index in self._places:
            if not opened["cameras"][sample][index]["passes"]:
                raise StageError(f"{self._batch.stage}: no passes asked for, and none in the stage")
        return opened

    def _key(self, passes: Sequence[str]) -> FrameKey:
        pictures = "rgb" in passes
        return FrameKey(
            stage_digest=self._opened["digest"],
            passes=tuple(passes),
            spp=self._spp if pictures else 0,
            noise_seed=self._noise_seed if pictures else 0,
            backend=self._backend,
            backend_version=self._opened["version"],
        )

    def __iter__(self) -> Iterator[_Job]:
        for sample, index in self._places:
            camera = self._opened["cameras"][sample][index]["name"]
            key = self._key(self._opened["cameras"][sample][index]["passes"])
            stem = frame_stem(self._batch.folder, self._backend, camera, sample)
            request = {
                "op": "render",
                "stem": str(stem.resolve()),
                "camera": index,
                "sample": sample,
                "key": asdict(key),
                "seed": frame_seed(self._noise_seed, self._batch.name, camera, sample),
            }
            yield _Job(stem, f"{self._batch.name}/{camera}/{sample:06d}", key, request)
