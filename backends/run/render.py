"""Render what was compiled: every batch, camera and sample, each once."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from contextlib import ExitStack, suppress
from dataclasses import dataclass, field, replace
from operator import methodcaller
from pathlib import Path
from typing import Any

from scenec.backends.picture import brightness
from scenec.backends.registry import AUTO
from scenec.backends.run.auto import choose
from scenec.backends.run.batches import BatchRun, OpenBatch, WorkReport
from scenec.backends.run.executors import make_executor
from scenec.backends.run.frames import frames_of, may_lose, not_requested, opening_of
from scenec.backends.run.plan import RenderPlan
from scenec.backends.run.units import OfSession, Opened, Opening, RenderFrame
from scenec.schemas.errors import FrameError, StageError
from scenec.schemas.files import check_writable, sweep
from scenec.schemas.manifest import FRAMES, Batch, find_batches, gaps, read_manifest
from scenec.schemas.passes import ANNOTATION_NAMES
from scenec.schemas.records import BackendChoice
from scenec.schemas.sidecars import read_sidecar
from scenec.schemas.strays import strays
from scenec.schemas.units import Executor, Progress, Say, Unit
from scenec.schemas.update import reading


@dataclass
class RenderReport(WorkReport):
    """Reports the outcome of a render.

    Attributes:
        backend_version: Renderer, version and variant.
        device: Where it ran.
        denoiser: What denoised ``rgb``, or None.
        losses: A line for each thing in the stages that was not read, or that ``rgb`` leaves out.
        backend: The backend's name.
        choice: Why this one, where none was named; None otherwise.
    """

    backend_version: str = ""
    device: str = ""
    denoiser: str | None = None
    losses: list[str] = field(default_factory=list)
    backend: str = ""
    choice: BackendChoice | None = None

    @property
    def frames(self) -> list[Path]:
        """Paths of all sidecars asked for, without suffix ``.json``, in order."""
        return self.stems

    @property
    def rendered(self) -> int:
        """Frames made now."""
        return self.made


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
        elif not out.is_dir():
            say(f"frames go into {batches[0].folder / FRAMES}/, beside {out.name}")
        report = RenderReport(backend=plan.backend, choice=choice)
        manifest = read_manifest(out) if out.is_dir() else None
        opened = {opening_of(batch, plan): batch for batch in batches}
        judged = {of for of, batch in opened.items() if may_lose(batch, plan, manifest)}
        run = _Render(plan, opened, report, progress, warn, say, judged)
        # Beside a USD file there may be the frames of another.
        run.counts_strays = plan.folder is None and out.is_dir()
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


class _Render(BatchRun):
    """One call of ``render``.

    Attributes:
        counts_strays: Whether frames of an earlier stage are looked for.
    """

    report: RenderReport
    counts_strays = False

    def __init__(self, plan: RenderPlan, batches: Mapping[Opening, Batch], *more: Any) -> None:
        super().__init__(batches, *more)
        self._plan = plan

    def files(self, batch: Batch, holds: Opening, opened: Opened) -> Sequence[RenderFrame]:
        """Lists the frames that the plan asks for.

        Raises:
            StageError: The stage does not hold what is asked for.
        """
        return frames_of(batch, self._plan, opened, self.report.choice)

    def begin(self, batch: Batch, opened: Opened, files: Sequence[RenderFrame]) -> Iterable[Unit]:
        """Tells what will render, and what it cannot; returns who writes the table of instances."""
        plan, report, renderer = self._plan, self.report, opened.renderer
        rgb = any("rgb" in frame.key.passes for frame in files)
        plan.check_rgb(rgb=rgb)
        if not report.backend_version:
            report.backend, report.backend_version = renderer.backend, renderer.version
            report.device = renderer.device
            report.denoiser = renderer.denoiser if plan.denoise else None
            parts = [f"rgb: {plan.quality}"] if rgb else []
            parts += [f"denoised by {report.denoiser}"] if report.denoiser else []
            more = f" ({', '.join(parts)})" if parts else ""
            self.say(f"rendering with {renderer.version} on {renderer.device}{more}")
        if renderer.warning:
            self.warn(renderer.warning)
        self.warn(*not_requested(opened.cameras[0] if opened.cameras else []))
        report.losses += [line for line in opened.losses if line not in report.losses]
        self.warn(*opened.losses)
        if self.counts_strays:
            # Of all backends: who renders with another one now may not come back to the first.
            firing = [[(camera.name, camera.fires) for camera in of] for of in opened.cameras]
            self.warn_of_strays(strays(batch.folder, firing))
        folder = batch.folder / FRAMES
        sweep([folder, *sorted((folder / renderer.backend).glob("*"))])
        if any("instance" in frame.key.passes for frame in files):
            table = methodcaller("write_instances", folder.absolute())
            return [OfSession(files[0].holds, "the table of instances", table)]
        return []

    def finish(self, work: OpenBatch) -> None:
        """Tells what is wrong with all pictures of a camera."""
        super().finish(work)
        frames_of: dict[str, list[brightness.FrameBrightness]] = {}
        for frame in work.files:
            made = work.made.get(frame.what)
            # What was given up, or was deleted meanwhile, shows nothing.
            with suppress(FrameError):
                sight = made.sight if made else None
                if sight is None:
                    sidecar = read_sidecar(frame.stem.with_suffix(".json"))
                    sight = brightness.brief(sidecar)
                frames_of.setdefault(frame.sensor, []).append(sight)
        for camera, sights in frames_of.items():
            line = brightness.picture_warning(sights)
            if line is not None:
                self.warn(f"{work.batch.name}/{camera}: {line}")
            sky = brightness.sky_warning(sights)
            if sky is not None:
                # Once a render: other batches mostly show as much of it.
                self.warn_of((camera, "sky"), f"{work.batch.name}/{camera}: {sky}")
