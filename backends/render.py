"""Render what was compiled: every batch, camera and sample, each once."""

from __future__ import annotations

import time
from collections.abc import Callable, Collection, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from scenec.backends import brightness
from scenec.backends.asked import (
    check_backend,
    check_rgb,
    check_words,
    no_denoiser,
    unasked,
)
from scenec.backends.auto import choose
from scenec.backends.jobs import Job, Jobs, Wanted, frame_seed
from scenec.backends.memory import default_limit
from scenec.backends.pool import FrameLostError, WorkerProcess
from scenec.backends.registry import AUTO
from scenec.backends.rounds import MOST_SPP
from scenec.backends.watch import Limits
from scenec.schemas.errors import CameraRefusedError, FrameError, StageError
from scenec.schemas.files import check_writable, sweep
from scenec.schemas.frames import is_done
from scenec.schemas.lock import LOCK, BusyError, Lock
from scenec.schemas.manifest import FRAMES, Batch, find_batches, gaps, read_manifest
from scenec.schemas.sidecars import read_sidecar
from scenec.schemas.strays import strays, told
from scenec.schemas.update import reading

__all__ = ["Limits", "RenderReport", "check_backend", "frame_seed", "render"]

#: ``progress(done, total, text)``, called after each frame.
Progress = Callable[[int, int, str], None]
Say = Callable[[str], None]

#: Samples per pixel where a user says nothing.
USUAL_SPP = 64
#: Seconds between two looks at a frame that another process is making.
_LOOK_S = 0.1


@dataclass
class RenderReport:
    """What came of a render.

    Attributes:
        frames: Paths of all sidecars asked for, without suffix ``.json``, in order.
        rendered: Frames made now.
        skipped: Frames that were there already, made with the same key.
        deaths: Worker processes that died (or hung, or took too much, and were ended) amid a frame
            and were replaced.
        replaced: Worker processes replaced between two frames, before they grew too large.
        failed: A line about each frame that was given up; the others are there.
        refused: How many of these are of cameras that the backend cannot draw.
        seconds: Per step (load, radiance, compose, annotate, write), summed.
        warnings: Lines a user should see, each once.
        backend_version: Renderer, version and variant.
        device: Where it ran.
        denoiser: What denoised ``rgb``, or None.
        losses: A line for each thing in the stages that was not read, or that ``rgb`` leaves out.
        backend: The backend's name.
        choice: Why this one, where none was named (``auto.Choice.as_json``); None otherwise.
        peak_memory_gb: The most that a worker held amid a frame made now, in 10^9 bytes; None if no
            frame was made or the system does not say.
    """

    frames: list[Path] = field(default_factory=list)
    rendered: int = 0
    skipped: int = 0
    deaths: int = 0
    replaced: int = 0
    failed: list[str] = field(default_factory=list)
    refused: int = 0
    seconds: dict[str, float] = field(default_factory=dict)
    warnings: list[str] = field(default_factory=list)
    backend_version: str = ""
    device: str = ""
    denoiser: str | None = None
    losses: list[str] = field(default_factory=list)
    backend: str = ""
    choice: dict[str, Any] | None = None
    peak_memory_gb: float | None = None


def render(
    out: Path | str,
    backend: str,
    *,
    spp: int | None = None,
    passes: Sequence[str] | None = None,
    samples: Collection[int] | None = None,
    batches: Collection[int] | None = None,
    noise_seed: int = 0,
    folder: Path | None = None,
    device: str = "auto",
    denoise: bool = False,
    error: float | None = None,
    seconds: float | None = None,
    cameras: Collection[str] | None = None,
    allow_missing: bool = False,
    limits: Limits | None = None,
    progress: Progress | None = None,
    warn: Say | None = None,
    say: Say | None = None,
) -> RenderReport:
    """Render to ``<batch>/frames/<backend>/<camera>/<sample>.{exr,png,json}``.

    Frames that are there and were made from the same stage with the same passes, samples per pixel
    (or target), noise seed, denoising and backend are not made again.

    Args:
        out: Output folder of a compile, or a USD file (its frames go beside it).
        backend: Name, see ``registry``; "auto" for the first that works (``scenec.backends.auto``).
            Without ``rgb`` no renderer starts, and frames go to ``frames/annotation``.
        spp: Samples per pixel of ``rgb``; None is 64. With ``error`` or ``seconds`` it is the most
            there may be; None is 4096 then.
        passes: ``rgb``, ``depth``, ``range``, ``label`` (all levels) or ``label.<level>``,
            ``instance``, ``normal``, ``position``, ``face``, ``amodal`` (masks, a file of their
            own; it brings ``instance`` with it); None takes the stage's own choice.
        samples: Only these time codes.
        batches: Only these batches.
        noise_seed: Renderings with different ones have independent noise.
        folder: Where frames go (``<folder>/frames``; for several batches, a folder each in it);
            None puts them into the batches' own.
        device: One of the backend's devices, or "auto" for the fastest that works here.
        denoise: Whether to denoise ``rgb``; the error that remains is then unknown.
        error: Render ``rgb`` in rounds until its relative rms error is below this by its 95 % bound
            (``noise.estimate``).
        seconds: Render ``rgb`` in rounds for as long as this, a frame; loading and annotation do
            not count. Such frames depend on the machine's speed; those that are there still count
            as made.
        cameras: Only these, by name.
        allow_missing: Whether to render what is there of a stage that is not whole (layers, prims,
            pictures that are missing, files that are not those of the manifest): sidecars then say
            what was missing, under ``losses``, and a later render of the whole stage makes these
            frames again.
        limits: What a worker may take: seconds without progress, seconds a frame, memory.
        progress: Called after each frame.
        warn: Called with lines worth showing at once.
        say: Called with lines about what is being done.

    Several processes may render one output at once, with one backend or several: what one is making
    the others leave to it, and look at it again in the end. While one renders nobody compiles.

    A batch whose stage cannot be read costs no other; it is said in ``failed``. A frame that kills
    its worker again and again is given up, said in ``failed``, and costs no
    other. One that the backend refuses (a camera it cannot draw, a pass the camera has not what it
    takes for) costs the other frames of that camera in the batch, which are not tried, and no other
    camera's.

    Raises:
        StageError: Nothing to render, or no stage can be read, or is whole.
        BackendError: The backend is not there, or cannot do what is asked: it refuses every camera,
            or is to denoise the picture of one with an aperture or an open shutter, which is said
            before anything is rendered.
        OutputError: No manifest, a frame cannot be written, or a compilation is at work.
    """
    if spp is None:
        spp = USUAL_SPP if error is None and seconds is None else MOST_SPP
    wanted = Wanted(
        backend, spp, passes, samples, noise_seed, device, denoise, error, seconds, cameras,
        allow_missing=allow_missing,
    )  # fmt: skip
    check_words(wanted, rgb=passes is None or "rgb" in passes)
    with reading(Path(out)):
        chosen = find_batches(Path(out), batches)
        check_writable(folder or chosen[0].folder)
        if backend == AUTO:
            choice = choose(Path(out), wanted, say or (lambda _line: None))
            wanted = replace(wanted, backend=choice.backend, choice=choice.as_json())
        in_output = folder is None and Path(out).is_dir()
        run = _Run(wanted, limits or Limits(), len(chosen), in_output, progress, warn, say)
        if batches is None and Path(out).is_dir():
            run.note(gaps(read_manifest(Path(out))))
        # Said once another batch can be read: what is wrong with all is one error.
        unread: list[tuple[str, StageError]] = []
        for number, batch in enumerate(chosen):
            if folder is not None:
                batch = replace(batch, folder=folder if len(chosen) == 1 else folder / batch.name)
            try:
                run.render(number, batch)
            except StageError as error:
                unread.append((f"{batch.name}: {error}", error))
            if run.report.frames:
                for line, _ in unread:
                    run.fail(line)
                unread.clear()
    if unread:
        raise unread[0][1]
    if not run.report.frames:
        raise StageError(f"{out}: no frame to render: no camera, or no sample in the range asked")
    return run.report


def describe(answer: dict[str, Any]) -> str:
    """One line about a frame: seconds by step, and how far ``rgb`` is from converged."""
    seconds = answer["seconds"]
    parts = [f"{sum(seconds.values()):.2f} s"]
    parts += [f"{step} {value:.2f}" for step, value in seconds.items() if value >= 0.005]
    if answer.get("estimated_error"):
        error = answer["estimated_error"]["relative_rms"]
        parts.append("error unknown" if error is None else f"error {100 * error:.1f} %")
        before = (answer.get("estimated_error_before_denoising") or {}).get("relative_rms")
        if before is not None:
            parts[-1] += f" ({100 * before:.1f} % before denoising)"
    if answer.get("rounds"):
        made = len(answer["rounds"]["rounds"])
        parts.append(f"{answer['samples_per_pixel']} samples per pixel in {made} rounds")
        if answer["rounds"]["target_met"] is False:
            parts.append("target not met")
    return ", ".join(parts)


class _Run:
    """One call of ``render``: what it wants, whom it tells, what came of it."""

    def __init__(
        self,
        wanted: Wanted,
        limits: Limits,
        batches: int,
        in_output: bool,
        progress: Progress | None,
        warn: Say | None,
        say: Say | None,
    ) -> None:
        # Beside a USD file there may be the frames of another.
        self._in_output = in_output
        self.report = RenderReport(backend=wanted.backend, choice=wanted.choice)
        self._wanted = wanted
        self._batches = batches
        self._progress = progress
        self._warn = warn
        self._say = say or (lambda line: None)
        # Of the batch that is being rendered: by camera, the frame that was refused.
        self._refused: dict[str, str] = {}
        self._said: set[tuple[str, str]] = set()
        if limits.memory_bytes is None:
            limits = replace(limits, memory_bytes=default_limit())
        self._limits = limits

    def note(self, lines: Sequence[str]) -> None:
        """Warns of some things."""
        for line in lines:
            self._note(line)

    def fail(self, line: str) -> None:
        """Notes what cannot be made."""
        self.report.failed.append(line)
        self._note(line)

    def render(self, number: int, batch: Batch) -> None:
        """Renders one batch.

        Raises:
            StageError: It cannot be read, or does not hold what is asked for.
        """
        report = self.report
        # A process per batch: memory goes back, whatever the renderer keeps.
        with WorkerProcess(self._note, self._limits, self._say) as worker:
            self._refused = {}
            jobs = Jobs(batch, self._wanted)
            opened = jobs.open(worker)
            self._opened(opened, rgb=jobs.rgb)
            self._table(worker, jobs)
            if self._in_output:
                self._strays(batch, jobs)
            frames = batch.folder / FRAMES
            sweep([frames, *sorted((frames / opened["backend"]).glob("*"))])
            done = 0
            busy: list[Job] = []
            for wait, some in ((False, jobs), (True, busy)):
                for job in some:
                    if not wait:
                        report.frames.append(job.stem)
                    text = self._one(worker, job, jobs.cameras, wait)
                    if text is None:
                        busy.append(job)
                        continue
                    done += 1
                    if self._progress:
                        before = number * jobs.count
                        total = self._batches * jobs.count
                        self._progress(before + done, total, f"{job.what}: {text}")
            self._brightness(batch, jobs)
            report.deaths += worker.deaths
            report.replaced += worker.replaced

    def _one(self, worker: WorkerProcess, job: Job, cameras: set[str], wait: bool) -> str | None:
        """Sees to it that a frame is there; returns what came of it, in words.

        Returns:
            None: Another process is making it (never with ``wait``).
        """
        said = False
        while not is_done(job.stem, job.key):
            try:
                job.stem.parent.mkdir(parents=True, exist_ok=True)
                with Lock(job.stem.with_name(f"{LOCK}-{job.stem.name}"), what=job.what):
                    # It may have come while nobody looked.
                    if not is_done(job.stem, job.key):
                        return self._frame(worker, job, cameras)
            except BusyError as error:
                if not wait:
                    return None
                if not said:
                    said = True
                    self._say(f"waiting: {error}")
                time.sleep(_LOOK_S)
        self.report.skipped += 1
        return "there already"

    def _table(self, worker: WorkerProcess, jobs: Jobs) -> None:
        """Has the batch's table of instances written, where it is asked for and not there."""
        if jobs.table is None:
            return
        try:
            worker.ask(jobs.table, "the table of instances")
        except FrameLostError as error:
            self.fail(str(error))

    def _strays(self, batch: Batch, jobs: Jobs) -> None:
        """Notes frames of an earlier stage that this one does not replace."""
        # Of all backends: who renders with another one now may not come back to the first.
        found = list(strays(batch.folder, jobs.firing))
        if found:
            # Once a render: other batches have them for the same reason.
            self._in_output = False
            self._note(told(found))

    def _brightness(self, batch: Batch, jobs: Jobs) -> None:
        """Notes cameras whose pictures are black or burnt out."""
        if not jobs.rgb:
            return
        sidecars: dict[str, list[dict[str, Any]]] = {}
        for job in jobs:
            # What was given up, or was deleted meanwhile, shows nothing.
            with suppress(FrameError):
                sidecar = read_sidecar(job.stem.with_suffix(".json"))
                sidecars.setdefault(job.camera, []).append(brightness.brief(sidecar))
        for camera, found in sidecars.items():
            line = brightness.told(found)
            if line is not None:
                self._note(f"{batch.name}/{camera}: {line}")

    def _opened(self, opened: dict[str, Any], rgb: bool) -> None:
        """Tells what will render, and what it cannot."""
        wanted, report = self._wanted, self.report
        check_rgb(wanted, rgb)
        if wanted.denoise and opened["denoiser"] is None:
            raise no_denoiser(wanted.backend)
        if not report.backend_version:
            report.backend, report.backend_version = opened["backend"], opened["version"]
            report.device = opened["device"]
            report.denoiser = opened["denoiser"] if wanted.denoise else None
            parts = [f"rgb: {_quality(wanted)}"] if rgb else []
            parts += [f"denoised by {report.denoiser}"] if report.denoiser else []
            more = f" ({', '.join(parts)})" if parts else ""
            self._say(f"rendering with {opened['version']} on {opened['device']}{more}")
        if opened["warning"]:
            self._note(opened["warning"])
        for line in unasked(opened["cameras"][0] if opened["cameras"] else []):
            self._note(line)
        for line in opened["losses"]:
            if line not in report.losses:
                report.losses.append(line)
            self._note(line)

    def _frame(self, worker: WorkerProcess, job: Job, cameras: set[str]) -> str:
        """Makes one frame; what a renderer cannot survive costs that frame and no other.

        Raises:
            CameraRefusedError: Nothing has been made, and the last of the batch's cameras is
                refused.
        """
        report = self.report
        if job.camera in self._refused:
            report.refused += 1
            first = self._refused[job.camera]
            report.failed.append(f"{job.what}: not tried, as {first} was refused")
            return "not tried"
        whole = False
        try:
            deaths = worker.deaths
            answer = worker.ask(job.request, job.what)
            whole = worker.deaths == deaths
        except FrameLostError as error:
            self.fail(str(error))
            return "given up"
        except CameraRefusedError as error:
            self._refused[job.camera] = job.what
            if report.rendered + report.skipped == 0 and cameras <= self._refused.keys():
                raise
            report.refused += 1
            report.failed.append(f"{job.what}: {error}")
            if (job.camera, str(error)) not in self._said:
                # Once a render: it holds for the other batches, too.
                self._said.add((job.camera, str(error)))
                self._note(f"{job.what}: {error}; other frames of this camera are not tried")
            return "refused"
        finally:
            if not whole:
                sweep([job.stem.parent])
        report.rendered += 1
        for step, seconds in answer["seconds"].items():
            report.seconds[step] = report.seconds.get(step, 0.0) + seconds
        peak = answer["peak_memory_gb"]
        if peak is not None:
            report.peak_memory_gb = max(peak, report.peak_memory_gb or 0.0)
        return describe(answer)

    def _note(self, line: str) -> None:
        if line not in self.report.warnings:
            self.report.warnings.append(line)
            if self._warn:
                self._warn(line)


def _quality(wanted: Wanted) -> str:
    """How well ``rgb`` is rendered."""
    if wanted.error is None and wanted.seconds is None:
        return f"{wanted.spp} samples per pixel"
    goals = [] if wanted.error is None else [f"to {100 * wanted.error:.3g} % error"]
    goals += [] if wanted.seconds is None else [f"for {wanted.seconds:g} s"]
    return f"{' or '.join(goals)}, at most {wanted.spp} samples per pixel"
