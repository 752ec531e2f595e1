"""Render what was compiled: every batch, camera and sample, each once."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Collection, Hashable, Sequence
from contextlib import ExitStack, closing, suppress
from dataclasses import dataclass, field, replace
from operator import methodcaller
from pathlib import Path
from typing import Any

from scenec.backends.picture import brightness
from scenec.backends.registry import AUTO
from scenec.backends.run.auto import choose
from scenec.backends.run.executors import make_executor
from scenec.backends.run.frames import frames_of, may_lose, opening_of, unasked
from scenec.backends.run.plan import RenderPlan
from scenec.backends.run.supervise import FrameLostError
from scenec.backends.run.units import (
    Made,
    OfSession,
    Opened,
    Opening,
    RenderFrame,
    open_stage,
    require_replaceable,
)
from scenec.schemas.errors import (
    CameraRefusedError,
    FrameError,
    PluginError,
    StageError,
)
from scenec.schemas.files import check_writable, sweep
from scenec.schemas.frames import ANNOTATION_NAMES, frame_stem, is_done
from scenec.schemas.lock import BusyError, Lock
from scenec.schemas.manifest import FRAMES, Batch, find_batches, gaps, read_manifest
from scenec.schemas.records import BackendChoice
from scenec.schemas.sidecars import read_sidecar
from scenec.schemas.strays import strays, told
from scenec.schemas.units import Executor, Outcome, Unit
from scenec.schemas.update import reading

#: ``progress(done, total, text)``, called after each frame.
Progress = Callable[[int, int, str], None]
Say = Callable[[str], None]

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
        choice: Why this one, where none was named; None otherwise.
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
    choice: BackendChoice | None = None
    peak_memory_gb: float | None = None


def render(
    out: Path | str,
    plan: RenderPlan | str,
    *,
    executor: Executor | None = None,
    progress: Progress | None = None,
    warn: Say | None = None,
    say: Say | None = None,
    **options: Any,
) -> RenderReport:
    """Render to ``<batch>/frames/<backend>/<camera>/<sample>.{exr,png,json}``.

    Frames that are there and were made from the same stage with the same passes, samples per pixel
    (or target), noise seed, denoising and backend are not made again; nor are those that hold more
    passes. One that lacks passes alone is made again with all of them. One that differs otherwise
    is replaced only where the plan says so; else nothing is rendered.

    Several processes may render one output at once, with one backend or several: what one is making
    the others leave to it, and look at it again in the end. While one renders nobody compiles.

    A batch whose stage cannot be read costs no other; it is said in ``failed``. A frame that kills
    its worker again and again is given up, said in ``failed``, and costs no other. One that the
    backend refuses (a camera it cannot draw, a pass the camera has not what it takes for) costs the
    other frames of that camera in the batch, which are not tried, and no other camera's.

    Args:
        out: Output folder of a compile, or a USD file (its frames go beside it).
        plan: What is asked; or the backend's name, and the other fields as ``options``.
        executor: Who renders, see ``run.executors``; None: one process of its own.
        progress: Called after each frame.
        warn: Called with lines worth showing at once.
        say: Called with lines about what is being done.
        options: Fields of ``RenderPlan``.

    Raises:
        StageError: Nothing to render, or no stage can be read, or is whole.
        BackendError: The backend is not there, or cannot do what is asked: it refuses every camera,
            or is to denoise the picture of one with an aperture or an open shutter, which is said
            before anything is rendered.
        OutputError: No manifest, a frame cannot be written or is not to be replaced, or a
            compilation is at work.
    """
    plan = RenderPlan(plan, **options) if isinstance(plan, str) else replace(plan, **options)
    out, say = Path(out), say or (lambda _line: None)
    with ExitStack() as stack:
        stack.enter_context(reading(out))
        batches = find_batches(out, plan.batches)
        check_writable(plan.folder or batches[0].folder)
        choice = None
        if plan.backend == AUTO:
            choice = choose(out, plan, say)
            plan = replace(plan, backend=choice.backend)
        if plan.folder is not None:
            single = len(batches) == 1
            batches = [
                replace(b, folder=plan.folder if single else plan.folder / b.name) for b in batches
            ]
        report = RenderReport(backend=plan.backend, choice=choice)
        manifest = read_manifest(out) if out.is_dir() else None
        judged = {batch.name for batch in batches if may_lose(batch, plan, manifest)}
        run = _Render(plan, batches, judged, report, progress, warn, say)
        # Beside a USD file there may be the frames of another.
        run.strays_count = plan.folder is None and out.is_dir()
        if plan.batches is None and manifest is not None:
            run.warn(*gaps(manifest))
        executor = executor or stack.enter_context(make_executor())
        drawn = plan.passes is None or "rgb" in plan.passes
        backend = plan.backend if drawn else ""
        executor.prepare(plan.folder or batches[0].folder, plan.device, backend)
        run.run(executor)
    if not report.frames:
        alone = plan.backend in ANNOTATION_NAMES and plan.passes is None
        why = ", or rgb alone is asked for" if alone else ""
        raise StageError(
            f"{out}: no frame to render: no camera, or no sample in the range asked{why}"
        )
    return report


@dataclass
class _Work:
    """A batch that has been opened: its frames, and what is known of them.

    Attributes:
        ready: Units to give out, in order.
        left: Frames of which nothing came yet.
        refused: By camera, the frame that was refused.
    """

    batch: Batch
    opened: Opened
    frames: list[RenderFrame]
    ready: deque[Unit]
    left: int
    refused: dict[str, str] = field(default_factory=dict)


class _Render:
    """One call of ``render``: gives out units, and notes what came of them.

    Args:
        plan: What is asked.
        batches: Of what.
        report: Filled.
        judged: Names of batches that may hold frames which are not to be replaced.
        progress, warn, say: Told.
    """

    def __init__(
        self,
        plan: RenderPlan,
        batches: Sequence[Batch],
        judged: Collection[str],
        report: RenderReport,
        progress: Progress | None,
        warn: Say | None,
        say: Say,
    ) -> None:
        self._progress, self._warn, self._say = progress, warn, say
        self.strays_count = False
        self._plan = plan
        self._report = report
        self._batches = {opening_of(batch, plan): batch for batch in batches}
        self._count = len(batches)
        #: Nothing is rendered before all of them are opened.
        self._unjudged = {one for one, batch in self._batches.items() if batch.name in judged}
        self._unopened = deque(sorted(self._batches, key=lambda one: one not in self._unjudged))
        self._works: dict[Hashable, _Work] = {}
        #: Frames that others are making.
        self._busy: list[RenderFrame] = []
        self._under_way: list[Unit] = []
        self._done = 0
        self._said: set[tuple[str, str]] = set()
        # Said once another batch can be read: what is wrong with all is one error.
        self._unread: list[tuple[str, StageError]] = []

    def run(self, executor: Executor) -> None:
        """Render all.

        Raises:
            ScenecError: See ``render``.
        """
        try:
            with closing(executor.work(self._take)) as ended:
                for unit, outcome in ended:
                    self._ended_unit(unit, outcome)
        finally:
            # Amid work only: what a worker that was ended had begun.
            for unit in self._under_way:
                if isinstance(unit, RenderFrame):
                    unit.clean()
        if self._unread and not self._report.frames:
            raise self._unread[0][1]
        order = {batch.folder: number for number, batch in enumerate(self._batches.values())}
        self._report.frames.sort(key=lambda stem: order[stem.parents[3]])

    def warn(self, *lines: str) -> None:
        """Warns of some things, each once."""
        for line in lines:
            if line not in self._report.warnings:
                self._report.warnings.append(line)
                if self._warn:
                    self._warn(line)

    def _fail(self, line: str) -> None:
        """Notes what cannot be made."""
        self._report.failed.append(line)
        self.warn(line)

    def _ended_unit(self, unit: Unit, outcome: Outcome) -> None:
        self._under_way.remove(unit)
        self._report.deaths += outcome.deaths
        self._report.replaced += outcome.replaced
        self.warn(*outcome.warnings)
        for line in outcome.notes:
            self._say(line)
        if isinstance(unit, RenderFrame):
            self._frame(unit, outcome)
        elif isinstance(unit.holds, Opening) and unit.holds not in self._works:
            self._open(unit.holds, outcome)
        elif isinstance(outcome.error, FrameLostError):
            self._fail(str(outcome.error))
        else:
            outcome.result()

    def _take(self, holds: Hashable) -> Unit | None:
        unit = self._next(holds)
        if unit is not None:
            self._under_way.append(unit)
        return unit

    def _next(self, holds: Hashable) -> Unit | None:
        """A unit for a worker: of the stage it holds, a stage to open, or of another's stage."""
        if self._unjudged:
            first = self._unopened[0] if self._unopened else None
            return open_stage(self._unopened.popleft()) if first in self._unjudged else None
        own = self._works.get(holds)
        works = ([own] if own else []) + (
            sorted(self._works.values(), key=lambda work: -len(work.ready))
            if not self._unopened
            else []
        )
        for work in works:
            if work.ready:
                return work.ready.popleft()
        if self._unopened:
            return open_stage(self._unopened.popleft())
        if self._busy and not self._under_way:
            return self._wait()
        return None

    def _wait(self) -> Unit:
        """The first frame that nobody else is making any more."""
        said = False
        while True:
            for frame in self._busy:
                try:
                    with Lock(frame.claim, what=frame.what):
                        pass
                except BusyError as error:
                    if not said and not is_done(frame.stem, frame.key):
                        self._say(f"waiting: {error}")
                        said = True
                    continue
                self._busy.remove(frame)
                return frame
            time.sleep(_LOOK_S)

    def _open(self, opening: Opening, outcome: Outcome) -> None:
        """Notes what a batch holds."""
        batch = self._batches[opening]
        self._unjudged.discard(opening)
        try:
            opened: Opened = outcome.result()
            frames = frames_of(batch, self._plan, opened, self._report.choice)
        except StageError as error:
            self._unread.append((f"{batch.name}: {error}", error))
            self._tell_unread()
            return
        require_replaceable(frames)
        self._tell_opened(opened, rgb=any("rgb" in frame.key.passes for frame in frames))
        if self.strays_count:
            self._strays(batch, opened)
        folder = batch.folder / FRAMES
        sweep([folder, *sorted((folder / opened.backend).glob("*"))])
        work = _Work(batch, opened, frames, deque(), len(frames))
        self._works[opening] = work
        for frame in frames:
            self._report.frames.append(
                frame_stem(batch.folder, opened.backend, frame.camera, frame.sample)
            )
        self._tell_unread()
        if any("instance" in frame.key.passes for frame in frames):
            table = methodcaller("write_instances", folder.absolute())
            work.ready.append(OfSession(opening, "the table of instances", table))
        for frame in frames:
            if is_done(frame.stem, frame.key):
                self._ended(work, frame, "there already")
                self._report.skipped += 1
            else:
                work.ready.append(frame)
        self._finish(work)

    def _tell_unread(self) -> None:
        if self._report.frames:
            for line, _ in self._unread:
                self._fail(line)
            self._unread.clear()

    def _frame(self, frame: RenderFrame, outcome: Outcome) -> None:
        """Notes what came of a frame; what a renderer cannot survive costs no other.

        Raises:
            CameraRefusedError: Nothing has been made, and the last of the batch's cameras is
                refused.
        """
        work, report = self._works[frame.holds], self._report
        if outcome.deaths or outcome.error is not None:
            frame.clean()
        if isinstance(outcome.error, FrameLostError | PluginError):
            self._fail(str(outcome.error))
            self._ended(work, frame, "given up")
        elif isinstance(outcome.error, CameraRefusedError):
            self._refuse(work, frame, outcome.error)
        else:
            made: Made = outcome.result()
            if made.busy is not None:
                self._busy.append(frame)
                return
            if made.now:
                report.rendered += 1
            else:
                report.skipped += 1
            for step, seconds in made.seconds.items():
                report.seconds[step] = report.seconds.get(step, 0.0) + seconds
            if made.peak_memory_gb is not None:
                report.peak_memory_gb = max(made.peak_memory_gb, report.peak_memory_gb or 0.0)
            self._ended(work, frame, made.text)
        self._finish(work)

    def _refuse(self, work: _Work, frame: RenderFrame, error: CameraRefusedError) -> None:
        """Leaves out the other frames of a camera that the backend cannot draw."""
        report = self._report
        work.refused.setdefault(frame.camera, frame.what)
        cameras = {of.camera for of in work.frames}
        if report.rendered + report.skipped == 0 and cameras <= work.refused.keys():
            raise error
        report.refused += 1
        report.failed.append(f"{frame.what}: {error}")
        if (frame.camera, str(error)) not in self._said:
            # Once a render: it holds for the other batches, too.
            self._said.add((frame.camera, str(error)))
            self.warn(f"{frame.what}: {error}; other frames of this camera are not tried")
        self._ended(work, frame, "refused")
        others = [
            of for of in work.ready if isinstance(of, RenderFrame) and of.camera == frame.camera
        ]
        for other in others:
            work.ready.remove(other)
            report.refused += 1
            report.failed.append(
                f"{other.what}: not tried, as {work.refused[frame.camera]} was refused"
            )
            self._ended(work, other, "not tried")

    def _ended(self, work: _Work, frame: RenderFrame, text: str) -> None:
        work.left -= 1
        self._done += 1
        if self._progress:
            known = sum(len(of.frames) for of in self._works.values())
            total = known + (self._count - len(self._works)) * len(work.frames)
            self._progress(self._done, total, f"{frame.what}: {text}")

    def _finish(self, work: _Work) -> None:
        """Notes what is wrong with all pictures of a camera, once a batch is whole."""
        if work.left:
            return
        sweep({frame.stem.parent for frame in work.frames})
        pictures: dict[str, list[brightness.FrameBrightness]] = {}
        for frame in work.frames:
            # What was given up, or was deleted meanwhile, shows nothing.
            with suppress(FrameError):
                record = read_sidecar(frame.stem.with_suffix(".json"))
                pictures.setdefault(frame.camera, []).append(brightness.brief(record))
        for camera, found in pictures.items():
            line = brightness.told(found)
            if line is not None:
                self.warn(f"{work.batch.name}/{camera}: {line}")
            sky = brightness.told_of_sky(found)
            # Once a render: other batches mostly show as much of it.
            if sky is not None and (camera, "sky") not in self._said:
                self._said.add((camera, "sky"))
                self.warn(f"{work.batch.name}/{camera}: {sky}")

    def _strays(self, batch: Batch, opened: Opened) -> None:
        """Notes frames of an earlier stage that this one does not replace."""
        # Of all backends: who renders with another one now may not come back to the first.
        firing = [[(camera.name, camera.fires) for camera in of] for of in opened.cameras]
        found = list(strays(batch.folder, firing))
        if found:
            # Once a render: other batches have them for the same reason.
            self.strays_count = False
            self.warn(told(found))

    def _tell_opened(self, opened: Opened, *, rgb: bool) -> None:
        """Tells what will render, and what it cannot."""
        plan, report = self._plan, self._report
        plan.check_rgb(rgb=rgb)
        if not report.backend_version:
            report.backend, report.backend_version = opened.backend, opened.version
            report.device = opened.device
            report.denoiser = opened.denoiser if plan.denoise else None
            parts = [f"rgb: {plan.quality}"] if rgb else []
            parts += [f"denoised by {report.denoiser}"] if report.denoiser else []
            more = f" ({', '.join(parts)})" if parts else ""
            self._say(f"rendering with {opened.version} on {opened.device}{more}")
        if opened.warning:
            self.warn(opened.warning)
        self.warn(*unasked(opened.cameras[0] if opened.cameras else []))
        report.losses += [line for line in opened.losses if line not in report.losses]
        self.warn(*opened.losses)
