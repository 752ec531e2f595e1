"""The pictures of a ladder: each backend's rungs, repeats and references, rendered once."""

from __future__ import annotations

import json
import time
from collections.abc import Collection
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from scenec.backends.picture.adaptive import MOST_SPP
from scenec.backends.run.executors import make_executor
from scenec.backends.run.frames import frames_of, opening_of
from scenec.backends.run.plan import RenderPlan
from scenec.backends.run.units import Opened, OpenStage, RenderFrame
from scenec.schemas.files import write_json
from scenec.schemas.frames import Frame, is_done, read_frame
from scenec.schemas.manifest import Batch
from scenec.schemas.scratch import scratch_folder
from scenec.schemas.units import Executor, Say, Unit, run_all

#: Beside ``rgb`` in the first of a backend's references.
ANNOTATION = ("label", "instance", "depth")
#: What is known of a backend's start, beside its pictures.
START = "start.json"
#: Noise seeds of references; those of repeats count from 0.
_REFERENCE_SEED = 1_000_000


@dataclass(frozen=True)
class Rung:
    """One quality: samples per pixel, or seconds a frame (and then samples as they come)."""

    spp: int
    seconds: float | None = None

    @property
    def name(self) -> str:
        """Returns the name of its folder, also used in tables."""
        return f"spp_{self.spp:06d}" if self.seconds is None else f"seconds_{self.seconds:g}"


@dataclass(frozen=True)
class Ladder:
    """Declares what to render.

    Attributes:
        spp: Samples per pixel of the rungs, ascending.
        seconds: More rungs, by seconds a frame.
        repeats: Pictures of each rung, each of its own noise.
        reference_spp: Samples per pixel of a backend's reference, in two halves; None is 8 times
            the highest rung.
        denoise: Whether to climb the ladder again with denoising, where a backend can.
        samples: Time codes.
        cameras: Names; None takes all.
        device: See ``render``.
        allow_missing: Whether to take what is there of a stage that is not whole.
    """

    spp: tuple[int, ...] = (4, 16, 64, 256)
    seconds: tuple[float, ...] = ()
    repeats: int = 4
    reference_spp: int | None = None
    denoise: bool = False
    samples: Collection[int] | None = None
    cameras: tuple[str, ...] | None = None
    device: str = "auto"
    allow_missing: bool = False

    @property
    def rungs(self) -> tuple[Rung, ...]:
        """All of them."""
        return (
            *(Rung(spp) for spp in self.spp),
            *(Rung(MOST_SPP, seconds) for seconds in self.seconds),
        )

    @property
    def reference(self) -> int:
        """Samples per pixel of each of a reference's two halves."""
        return max(1, (self.reference_spp or 8 * max((*self.spp, 16))) // 2)


@dataclass(frozen=True)
class LadderFrame:
    """One frame of a ladder, read back when it is asked for."""

    stem: Path
    place: str

    def read(self) -> Frame:
        """The frame."""
        return read_frame(self.stem)


@dataclass(frozen=True)
class Climbed:
    """One batch as one backend draws it.

    Attributes:
        backend, version, device: Who, and where it ran.
        stochastic: Whether it has noise; without, there is one picture of each frame.
        references: Two lists of frames (one without noise), in one order; the first have
            annotation.
        rungs: (rung, denoised, repeats of frames in the same order).
        denoiser: What denoised, or None.
        losses: What this backend leaves out of the batch.
        digest: Of the stage.
        start_s: Seconds until a first picture was there: process, stage, scene, kernels; None
            where all pictures were there and nothing is known of it.
    """

    backend: str
    version: str
    device: str
    stochastic: bool
    references: tuple[list[LadderFrame], ...]
    rungs: list[tuple[Rung, bool, list[list[LadderFrame]]]]
    denoiser: str | None
    losses: tuple[str, ...]
    digest: str
    start_s: float | None


def climb(batch: Batch, backend: str, ladder: Ladder, folder: Path, say: Say) -> Climbed:
    """Render all of one backend's pictures of one batch; those that are there are not made again.

    One process makes them all, and draws a picture that does not count first: what a renderer
    does once (hierarchies, kernels) is no part of a picture's seconds.

    Args:
        batch: The stage.
        backend: Name.
        ladder: What to render.
        folder: Where the frames go.
        say: Told what is rendered.

    Raises:
        StageError: The stage cannot be read, or has no such sample or camera.
        BackendError: The backend cannot draw it.
        OutputError: A frame cannot be written.
    """
    with make_executor(1) as executor:
        one = _Climb(batch, backend, ladder, folder, say, executor)
        return one.all()


class _Climb:
    """One call of ``climb``."""

    def __init__(
        self, batch: Batch, backend: str, ladder: Ladder, folder: Path, say: Say, executor: Executor
    ) -> None:
        self._batch = batch
        self._ladder = ladder
        self._folder = folder
        self._say = say
        self._executor = executor
        self._wanted = RenderPlan(
            backend,
            spp=1,
            passes=("rgb", *ANNOTATION),
            samples=ladder.samples,
            device=ladder.device,
            cameras=ladder.cameras,
            allow_missing=ladder.allow_missing,
        )
        start = time.perf_counter()
        # Opened with every pass that is asked for later; requests name those of each frame.
        self._opened: Opened = self._ask(OpenStage(opening_of(batch, self._wanted)))
        self._opening_s = time.perf_counter() - start
        self._warm = False

    def all(self) -> Climbed:
        ladder, opened = self._ladder, self._opened
        first = self._render(
            "reference/first", spp=ladder.reference, seed=_REFERENCE_SEED, all_=True
        )
        estimates = [shown.read().sidecar.error.relative_rms for shown in first]
        stochastic = any(value is not None for value in estimates)
        references: tuple[list[LadderFrame], ...] = (first,)
        rungs: list[tuple[Rung, bool, list[list[LadderFrame]]]] = []
        if stochastic:
            again = _REFERENCE_SEED + 1
            references += (self._render("reference/second", spp=ladder.reference, seed=again),)
            for denoise in (False, True) if ladder.denoise else (False,):
                if denoise and opened.renderer.denoiser is None:
                    self._say(f"{self._wanted.backend} has no denoiser: one ladder for it")
                    continue
                rungs += [(rung, denoise, self._repeats(rung, denoise)) for rung in ladder.rungs]
        else:
            self._say(
                f"{self._wanted.backend} has no noise: one picture, whatever the samples; it has "
                "no slope"
            )
        return Climbed(
            self._wanted.backend,
            opened.renderer.version,
            opened.renderer.device,
            stochastic,
            references,
            rungs,
            opened.renderer.denoiser if ladder.denoise else None,
            opened.losses,
            opened.digest,
            self._start_s(),
        )

    def _start_s(self) -> float | None:
        try:
            known = json.loads((self._folder / self._wanted.backend / START).read_bytes())
            same = known["stage_digest"] == self._opened.digest
            return float(known["seconds"]) if same else None
        except (OSError, ValueError, KeyError, TypeError):
            return None

    def _repeats(self, rung: Rung, denoise: bool) -> list[list[LadderFrame]]:
        kind = "denoised" if denoise else "plain"
        return [
            self._render(
                f"{kind}/{rung.name}/{seed:03d}", spp=rung.spp, seed=seed, denoise=denoise,
                seconds=rung.seconds,
            )
            for seed in range(self._ladder.repeats)
        ]  # fmt: skip

    def _render(
        self,
        name: str,
        *,
        spp: int,
        seed: int,
        denoise: bool = False,
        seconds: float | None = None,
        all_: bool = False,
    ) -> list[LadderFrame]:
        """All frames of one quality and noise; with annotation if ``all_``."""
        plan = replace(
            self._wanted, spp=spp, noise_seed=seed, denoise=denoise, seconds=seconds, replace=True
        )
        folder = self._folder / self._wanted.backend / name
        frames = self._frames(plan, folder, all_)
        todo = [frame for frame in frames if not is_done(frame.stem, frame.key)]
        if todo:
            self._say(f"{self._batch.name}: {self._wanted.backend} {name}, {len(todo)} frames")
        if todo and not self._warm:
            self._warm_up()
        self._ask(*(replace(frame, what=f"{plan.backend} {name} {frame.what}") for frame in todo))
        return [LadderFrame(frame.stem, frame.what) for frame in frames]

    def _ask(self, *units: Unit) -> Any:
        """Runs units; returns what the last one returns."""
        value = None
        for _, outcome in run_all(self._executor, units):
            for line in outcome.warnings:
                self._say(line)
            value = outcome.result()
        return value

    def _frames(self, plan: RenderPlan, folder: Path, all_: bool) -> list[RenderFrame]:
        batch = replace(self._batch, folder=folder)
        return frames_of(batch, plan, self._opened, passes=None if all_ else ("rgb",))

    def _warm_up(self) -> None:
        self._warm = True
        start = time.perf_counter()
        with scratch_folder() as aside:
            frame = self._frames(replace(self._wanted, spp=2), Path(aside), all_=False)[0]
            self._ask(replace(frame, what=f"{self._wanted.backend}: the first picture"))
        seconds = self._opening_s + time.perf_counter() - start
        write_json(
            self._folder / self._wanted.backend / START,
            {"stage_digest": self._opened.digest, "seconds": seconds},
        )
