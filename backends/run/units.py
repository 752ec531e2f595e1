"""Units of rendering (``schemas.units``): what a worker is asked, and what it answers."""

from __future__ import annotations

import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from scenec.backends.picture.brightness import FrameBrightness, brief
from scenec.schemas.errors import BackendError, OutputError, StageError
from scenec.schemas.files import sweep
from scenec.schemas.frames import FrameKey, is_done, would_lose
from scenec.schemas.lock import LOCK, BusyError, Lock
from scenec.schemas.memory import GB
from scenec.schemas.native import native_reading
from scenec.schemas.passes import ANNOTATION_NAMES
from scenec.schemas.records import BackendChoice, ExposureRecord, FrameRecord, RendererFacts
from scenec.schemas.units import Keeper, Rest

if TYPE_CHECKING:
    from scenec.backends.run.facts import FrameResult
    from scenec.backends.run.session import Session
    from scenec.backends.stage.scene import Camera


@dataclass(frozen=True)
class Opening:
    """A stage, and who draws it: what a worker keeps from frame to frame.

    Attributes:
        stage: Absolute path.
        backend, device, allow_missing: As of ``RenderPlan``.
        passes: Those that any frame will have; None: what each camera asks for, of annotation all
            of that but ``rgb``.
    """

    stage: str
    backend: str
    device: str = "auto"
    passes: tuple[str, ...] | None = None
    allow_missing: bool = False

    def session(self, keeper: Keeper) -> Session:
        """The stage, read, and its renderer, started if it is needed."""
        return keeper.keep(self, self._open)

    def _open(self) -> Session:
        # A crash within is the stage's fault.
        with native_reading(Path(self.stage)):
            from scenec.backends.run.session import Session
            from scenec.backends.stage.read import read_stage

            scene = read_stage(Path(self.stage), allow_missing=self.allow_missing)
        return Session.open(scene, self.backend, self.device, self.passes)


@dataclass(frozen=True)
class CameraFacts:
    """A camera at one sample.

    Attributes:
        name: Its own.
        passes: What its frame will have (``Session.passes``).
        fires: Whether it is triggered.
        outputs: What the stage was compiled for.
        undenoised: Why its picture cannot be denoised, or None.
    """

    name: str
    passes: tuple[str, ...]
    fires: bool
    outputs: tuple[str, ...]
    undenoised: str | None


@dataclass(frozen=True)
class Opened:
    """Describes an opened stage and its renderer (``Session.facts``).

    Attributes:
        digest: Of the stage.
        cameras, lidars: Of each sample; names of lidars.
        losses: A line for each thing that is not read, or that ``rgb`` leaves out.
        read_s: Seconds that opening it took.
        renderer: Who draws.
    """

    digest: str
    cameras: list[list[CameraFacts]]
    lidars: list[list[str]]
    losses: tuple[str, ...]
    read_s: float
    renderer: RendererFacts


@dataclass(frozen=True)
class OfSession:
    """Have something done with an open stage; returns what it returns.

    Attributes:
        holds: The stage.
        what: In messages.
        do: Takes the session; what can be pickled, such as an ``operator.methodcaller``.
    """

    holds: Opening
    what: str
    do: Callable[[Session], Any]

    def run(self, keeper: Keeper) -> Any:
        """Do it."""
        return self.do(self.holds.session(keeper))


@dataclass(frozen=True)
class OfBackend:
    """Have something done with a backend and no stage; returns what it returns.

    Attributes:
        backend: Name.
        do: Takes the name; a function of a module, or a ``functools.partial`` of one.
    """

    backend: str
    do: Callable[[str], Any]
    holds: None = None

    @property
    def what(self) -> str:
        """In messages."""
        return f"backend {self.backend}"

    def run(self, keeper: Keeper) -> Any:
        """Do it."""
        return self.do(self.backend)


@dataclass(frozen=True)
class OpenStage:
    """Opens a stage, and tells what there is to render and to scan: ``Opened``."""

    holds: Opening

    @property
    def what(self) -> str:
        """In messages."""
        return f"opening {self.holds.stage}"

    def run(self, keeper: Keeper) -> Opened:
        """Reads it, unless it is held."""
        start = time.perf_counter()
        session = self.holds.session(keeper)
        scene, passes = session.scene, self.holds.passes
        every_but_rgb = passes is None and self.holds.backend in ANNOTATION_NAMES

        def facts(camera: Camera, sample: int) -> CameraFacts:
            outputs = tuple(camera.outputs)
            wanted = [n for n in outputs if n != "rgb"] if every_but_rgb else passes
            made, fires = session.passes(wanted, camera), camera.fires(sample)
            return CameraFacts(camera.name, made, fires, outputs, session.undenoised(camera))

        return Opened(
            scene.digest,
            [[facts(camera, n) for camera in of] for n, of in enumerate(scene.cameras)],
            [[lidar.name for lidar in of] for of in scene.lidars],
            session.losses,
            time.perf_counter() - start,
            session.facts(),
        )


@dataclass(frozen=True)
class UnitResult:
    """Reports the outcome of a frame or a scan.

    Attributes:
        busy: Who else is making it, in words; None: it is there.
        now: Whether it was made now.
        seconds: Per step.
        peak_memory_gb: At most, 10^9 bytes; None where the system does not say.
        text: One line about it.
        sight: What ``picture.brightness`` takes from a frame's sidecar; None of one not made now.
    """

    busy: str | None = None
    now: bool = False
    seconds: dict[str, float] = field(default_factory=dict)
    peak_memory_gb: float | None = None
    text: str = "there already"
    sight: FrameBrightness | None = None


@dataclass(frozen=True)
class MakeFile(ABC):
    """Makes a frame or a scan, unless it is there or another process is making it: ``UnitResult``.

    Attributes:
        holds: Its stage.
        what: Its name in messages.
        stem: Its path without a suffix, absolute.
        sensor: The camera or the lidar, by name.
        number: Of that at this sample.
        sample: Time code.
    """

    holds: Opening
    what: str
    stem: Path
    sensor: str
    number: int
    sample: int

    @abstractmethod
    def is_done(self) -> bool:
        """Tells whether it is there, made as asked."""

    def loss(self) -> str | None:
        """Describes what would go that is not to be replaced; it is not done. None: nothing."""
        return None

    @property
    def claim(self) -> Path:
        """The lock file of who makes it."""
        return self.stem.with_name(f"{LOCK}-{self.stem.name}")

    @abstractmethod
    def run(self, keeper: Keeper) -> UnitResult | Rest[UnitResult]:
        """Makes it.

        Raises:
            BackendError: The renderer failed, or cannot do what is asked.
            StageError: The stage is no more what it was.
            OutputError: A file cannot be written, or is not to be replaced.
        """

    @contextmanager
    def claimed(self, session: Session) -> Iterator[UnitResult | None]:
        """Keeps other processes from making it; yields what came of it if there is nothing to do.

        Raises:
            OutputError: A file cannot be written, or is not to be replaced.
        """
        folder = self.stem.parent
        if folder not in session.folders:
            try:
                folder.mkdir(parents=True, exist_ok=True)
            except OSError as error:
                raise OutputError(f"{folder}: cannot be made: {error.strerror}") from error
            # On this machine one may have been killed, of whom nobody else can say so.
            self.clean()
            session.folders.add(folder)
        try:
            lock = Lock(self.claim, what=self.what)
        except BusyError as error:
            yield UnitResult(busy=str(error))
            return
        with lock:
            # It may have come while nobody looked.
            if self.is_done():
                yield UnitResult()
            else:
                require_replaceable([self])
                yield None

    def clean(self) -> None:
        """Removes what a worker that died left half written."""
        sweep([self.stem.parent])


@dataclass(frozen=True)
class RenderFrame(MakeFile):
    """Makes a frame.

    Attributes:
        key: What it is made with.
        seed: Of its noise.
        choice: Why this backend, for the sidecar, or None.
        replace: As of ``RenderPlan``.
    """

    key: FrameKey
    seed: int
    choice: BackendChoice | None = None
    replace: bool = False

    def is_done(self) -> bool:
        """Tells whether it is there, or one with more passes."""
        return is_done(self.stem, self.key)

    def loss(self) -> str | None:
        """Describes what the frame that is there has of this stage, and this one would not have."""
        return None if self.replace else would_lose(self.stem, self.key)

    def clean(self) -> None:
        """Removes what a worker that died left half written, of the batch's exposures too."""
        sweep([self.stem.parent, self.stem.parents[2]])

    def run(self, keeper: Keeper) -> UnitResult | Rest[UnitResult]:
        """Renders and writes it; a worker may write it beside the next one.

        Raises:
            ScenecError: See ``MakeFile``.
        """
        # Imported here: who gives units out has no need of it.
        from scenec.backends.picture.adaptive import Target
        from scenec.backends.picture.noise import quantile_of_f
        from scenec.backends.run import memory
        from scenec.backends.run.exposures import exposed, prepare
        from scenec.backends.run.reuse import find_annotation

        session, key, sample = self.holds.session(keeper), self.key, self.sample
        scene = session.scene
        if not key.backend_version.startswith(session.facts().version):
            # A process that was replaced has imported it again.
            raise BackendError(f"backend {key.backend} has changed meanwhile; run again")
        with ExitStack() as claim:
            found = claim.enter_context(self.claimed(session))
            if found is not None:
                return found
            if key.stage_digest != scene.digest:
                # A process that was replaced has opened it again.
                raise StageError(f"{scene.source}: has changed since rendering began; run again")
            camera = session.camera(self.number, sample)
            memory.reset_peak()
            annotation = [name for name in key.passes if name != "rgb"]
            ready = find_annotation(self.stem, scene.digest, annotation) if annotation else None
            once = key.error is None and key.seconds is None
            target = None if once else Target(key.error, key.seconds, key.spp)
            exposure, metering = None, dict[str, float]()
            seconds: dict[str, float] = {}
            drawn = None
            if "rgb" in key.passes:
                # SciPy is loaded by this thread: a renderer's libraries may let the interpreter's
                # lock go while they are loaded, and who imports beside them then waits for ever.
                quantile_of_f()
                # The renderer keeps to this thread, as some must.
                with ThreadPoolExecutor(1, "prepare") as beside:
                    finding = beside.submit(
                        exposed, session, camera, sample, self.stem.parents[2], metering, keeper.say
                    )
                    casts = bool(annotation) and ready is None
                    preparing = beside.submit(prepare, session, metering if casts else None)
                    try:
                        session.renderer(seconds)
                    finally:
                        camera, exposure = finding.result()
                    drawn = session.draw(
                        camera, sample, key.spp, self.seed, key.denoise, target, seconds
                    )
                preparing.result()
            complete = partial(session.complete, camera, sample, key.passes, drawn, ready, seconds)
            # The cast takes as long as pictures do: beside it the last one is written.
            made = complete() if drawn is None else None
            held, peak = claim.pop_all(), memory.peak()

        def rest() -> UnitResult:
            with held:
                result = complete() if made is None else made
                return self._finish(session, camera, result, exposure, metering, peak)

        return keeper.finish(rest)

    def _finish(
        self,
        session: Session,
        camera: Camera,
        result: FrameResult,
        exposure: ExposureRecord | None,
        metering: dict[str, float],
        peak: int | None,
    ) -> UnitResult:
        """Writes a frame that is complete.

        Args:
            session, camera: What shows it.
            result: The frame.
            exposure: Where the camera's comes from; None without ``rgb``.
            metering: Seconds by step before it was drawn.
            peak: Bytes of this process until then.
        """
        from scenec.backends.run import memory
        from scenec.backends.run.session import timed
        from scenec.backends.run.writer import write_frame

        seconds = dict(result.record.seconds or {})
        for step, took in metering.items():
            seconds[step] = seconds.get(step, 0.0) + took
        peak = max(filter(None, (peak, memory.peak())), default=None)
        taken = None
        if camera.imaging is not None and "rgb" in result.arrays:
            # Imported here: few cameras have any.
            from scenec.backends.imaging.camera import take

            with timed(seconds, "imaging"):
                taken = take(result.arrays["rgb"], camera, camera.imaging, self.sample)
        record = replace(
            result.record,
            exposure=exposure,
            peak_memory_gb=None if peak is None else round(peak / GB, 3),
            choice=self.choice,
            seconds=dict(seconds),
        )
        with timed(seconds, "write"):
            result = replace(result, record=record)
            record = write_frame(self.stem, result, self.key, session.scene, camera, taken)
        record = replace(record, seconds=seconds)
        return UnitResult(
            now=True,
            seconds=dict(record.seconds or {}),
            peak_memory_gb=record.peak_memory_gb,
            text=describe(record),
            sight=brief(record),
        )


def require_replaceable(files: Iterable[MakeFile]) -> None:
    """Refuses to replace frames of the same stage by others that lack something of them.

    Args:
        files: Of one batch, none of them done.

    Raises:
        OutputError: One of them would be; says which, and what it has.
    """
    found = [(file, lost) for file in files if (lost := file.loss()) is not None]
    if found:
        file, lost = found[0]
        more = f" (and {len(found) - 1} more like it)" if len(found) > 1 else ""
        raise OutputError(
            f"{file.stem.with_suffix('.exr')}{more} is there, {lost}; --replace renders it again "
            "as asked now; to keep both, compile into another folder"
        )


def describe(record: FrameRecord) -> str:
    """One line about a frame: seconds by step, and how far ``rgb`` is from converged."""
    seconds = record.seconds or {}
    parts = [f"{sum(seconds.values()):.2f} s"]
    parts += [f"{step} {value:.2f}" for step, value in seconds.items() if value >= 0.005]
    if record.estimated_error is not None:
        error = record.estimated_error.relative_rms
        parts.append("error unknown" if error is None else f"error {100 * error:.1f} %")
        noisy = record.estimated_error_before_denoising
        if noisy is not None and noisy.relative_rms is not None:
            parts[-1] += f" ({100 * noisy.relative_rms:.1f} % before denoising)"
    if record.rounds is not None:
        made = len(record.rounds.rounds)
        parts.append(f"{record.samples_per_pixel} samples per pixel in {made} rounds")
        if record.rounds.target_met is False:
            parts.append("target not met")
    return ", ".join(parts)
