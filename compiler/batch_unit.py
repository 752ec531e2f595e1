"""Compiles one batch as a unit of work (``schemas.units``), from cfg and seed to files."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING

from scenec.compiler.cache.memo import Memo, memoizing
from scenec.compiler.cache.store import Store
from scenec.compiler.cfg.load import load
from scenec.compiler.output import batch_name
from scenec.compiler.views.needed import Keep
from scenec.schemas.codec import decode, encode
from scenec.schemas.errors import CfgError, Fault, OutputError, SceneError
from scenec.schemas.files import tree, write_json
from scenec.schemas.georeference import Georeference
from scenec.schemas.left_out import write_left_out
from scenec.schemas.manifest import REPORT
from scenec.schemas.native import commentary
from scenec.schemas.plugins import blaming
from scenec.schemas.report import BatchReport
from scenec.schemas.strays import Firing
from scenec.schemas.units import Keeper

if TYPE_CHECKING:
    from scenec.compiler.build import BuildLog
    from scenec.compiler.scene.rig import Lidar, Rig, Sensor
    from scenec.compiler.scene.scene import Scene

#: How often a batch is drawn before it is given up.
_MOST_ATTEMPTS = 16
#: Told lines of text, and steps: the batch's name and what is done.
Tell = Callable[[str], None]


@dataclass
class Compiled:
    """Reports how the compilation of one batch went.

    Attributes:
        error: Why it could not be built, or None.
        attempt: How often it was drawn again.
        seconds: Of each pass.
        report: What was written of it; None where it could not be built.
        made, taken: How often each step was made, or taken from the cache; None without one.
        cameras, lidars: When each is triggered (``schemas.strays``).
        georeference: Where on a body it lies, or None.
    """

    error: SceneError | None = None
    samples: int = 0
    attempt: int = 0
    seconds: dict[str, float] = field(default_factory=dict)
    report: BatchReport | None = None
    made: dict[str, int] | None = None
    taken: dict[str, int] | None = None
    cameras: Firing = field(default_factory=list)
    lidars: Firing = field(default_factory=list)
    georeference: Georeference | None = None


@dataclass(frozen=True)
class CompileBatch:
    """Compile a batch into a folder; returns ``Compiled``.

    Attributes:
        cfg, text: Absolute path of the cfg, by which its files are found; all that it says.
        digest: Of its ``Spec``: what is compiled is what was checked.
        seed, batch, keep: As of ``compile_cfg``.
        first: The attempt to begin with.
        redraw: Whether to draw it again where it cannot be built.
        cache: As of ``compile_cfg``.
        folder: Takes the batch's folder; absolute, emptied first.
        out: The output folder, as messages name it.
    """

    cfg: Path
    text: bytes
    digest: str
    seed: int
    batch: int
    keep: Keep
    first: int
    redraw: bool
    cache: Path | None
    folder: Path
    out: Path

    @property
    def what(self) -> str:
        """In messages."""
        return batch_name(self.batch)

    @property
    def holds(self) -> tuple[Path, str]:
        """The cfg."""
        return self.cfg, self.digest

    def run(self, keeper: Keeper) -> Compiled:
        """Compile it.

        Raises:
            CfgError: The cfg is no more what it was.
            OutputError: A file cannot be written.
        """
        say, step = keeper.say, keeper.step
        spec = keeper.keep(self.holds, lambda: load(self.cfg, text=self.text))
        # Here, so that a faulty cfg is told without.
        from scenec.compiler.build import BuildLog, build
        from scenec.compiler.draw import draw

        if spec.digest != self.digest:
            text = "has changed since compiling began; run again"
            raise CfgError([Fault(str(self.cfg), 1, 1, "", text)])
        store = None if self.cache is None else Store(self.cache, say=say)
        last = max(self.first + 1, _MOST_ATTEMPTS if self.redraw else 0)
        compiled = Compiled()
        for attempt in range(self.first, last):
            again = f", attempt {attempt + 1}" if attempt else ""
            if step is not None or attempt:
                say(f"compiling {self.what} of {spec.cfg['name']}, seed {self.seed}{again}")
            log = BuildLog(seconds={}, tell=step)
            memo = None if store is None else Memo(store)
            try:
                # Before steps run on threads: OpenUSD, being loaded, lets the interpreter's lock go
                # while it holds the loader's; another thread that imports then waits for ever.
                import_module("scenec.compiler.emit.batch")
                with blaming(kind=SceneError), memoizing(memo):
                    with log.timed("draw"):
                        plans = [draw(spec, self.seed, self.batch, attempt)]
                    # Handed over, so that it can let go of what it has built.
                    scene = build(plans.pop(), log, self.keep)
                    with self._naming():
                        report = self._emit(scene, log, attempt)
            except SceneError as error:
                compiled.error = error
                if last > self.first + 1:
                    say(f"warning: {self.what} cannot be built: {error}")
                continue
            compiled = Compiled(None, scene.samples, attempt, log.seconds, report)
            if memo is not None:
                compiled.made, compiled.taken = dict(memo.made), dict(memo.taken)
            compiled.cameras = _firing(scene, lambda rig: rig.sensors)
            compiled.lidars = _firing(scene, lambda rig: rig.lidars)
            if scene.georeference is not None:
                compiled.georeference = scene.georeference.place
            break
        return compiled

    @contextmanager
    def _naming(self) -> Iterator[None]:
        """Replaces the temporary folder by the final one in errors about writing."""
        try:
            yield
        except OSError as error:
            reason = error.strerror or error
            raise OutputError(f"{self.out}: cannot be written: {reason}") from error
        except OutputError as error:
            raise OutputError(str(error).replace(str(self.folder), str(self.out))) from error

    def _emit(self, scene: Scene, log: BuildLog, attempt: int) -> BatchReport:
        """Writes the batch and its report."""
        shutil.rmtree(self.folder, ignore_errors=True)
        folder = self.folder / self.what
        folder.mkdir(parents=True)
        with log.timed("emit"):
            _write(folder, scene)
        log.facts["bytes"] = sum((folder / path).stat().st_size for path in tree(folder))
        drawn = {"batch": self.batch} | ({"attempt": attempt} if attempt else {})
        write_json(folder / REPORT, {**drawn, **log.facts})
        if log.record is not None:
            write_left_out(folder, log.record)
        return decode(encode(log.facts), BatchReport, OutputError, str(folder / REPORT))


def _write(folder: Path, scene: Scene) -> None:
    from pxr import Tf

    from scenec.compiler.emit.batch import write_batch

    try:
        write_batch(folder, scene)
    except Tf.ErrorException as error:
        # A full disk reaches us as USD's own exception.
        text = next((commentary(e) for e in error.args), "USD gives no reason").splitlines()[0]
        raise OutputError(f"{folder}: cannot be written: {text}") from error


def _firing(scene: Scene, sensors: Callable[[Rig], Iterable[Sensor | Lidar]]) -> Firing:
    """Lists for each sample the sensors, and whether each is triggered."""
    named = [(f"{rig.name}_{s.name}", s.trigger) for rig in scene.rigs for s in sensors(rig)]
    return [
        [(name, i >= first and (i - first) % every == 0) for name, (every, first) in named]
        for i in range(scene.samples)
    ]
