"""Makes frames without end: scenes that are compiled and rendered as they are asked for."""

from __future__ import annotations

import shutil
from collections import deque
from collections.abc import Collection, Generator, Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack, closing, nullcontext
from dataclasses import dataclass, field, replace
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from scenec.api import forms
from scenec.api.declare import Spread, held, option
from scenec.api.options import PictureOptions, StageOptions
from scenec.api.steps import AnyCfg, cache_folder, hire, plan_of, read_cfg, refuse_early
from scenec.schemas.codec import JsonObject
from scenec.schemas.errors import BackendError, FrameError, ScenecError, SceneError
from scenec.schemas.passes import LABEL
from scenec.schemas.units import Keeper, LocalExecutor, Rest, Unit

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from scenec.backends.run.plan import RenderPlan
    from scenec.compiler.cfg.load import Spec
    from scenec.datasets.source import LoadedFrame
    from scenec.schemas.records import FrameRecord
    from scenec.schemas.units import Executor, Outcome

#: One after the other, or each with its index. Not looked through beforehand: they may be an
#: iterator.
type Seeds = Iterable[int] | Iterable[tuple[int, int]]
#: Scenes a worker that are begun and not yet given: one that it draws, one that it compiles
#: meanwhile, one that waits for another worker's.
_AHEAD = 3
#: More than any number of workers.
_MANY = 1 << 20


@dataclass(frozen=True, kw_only=True)
class StreamOptions(StageOptions, PictureOptions):
    """Holds options of ``stream``.

    Attributes:
        settings: As of ``CompileOptions``.
    """

    seeds: Seeds = option(
        range(2**64),
        "of the scenes, one after the other; or pairs (index, seed), of a part of them "
        "(default: 0, 1, … without end)",
    )
    start: int = option(0, "index of the first scene (default: 0)", form=forms.counted)
    color: str = option(
        "srgb8",
        "what ``frame.rgb`` is: srgb8, the picture, uint8 [h, w, 3] (default); srgb, the same as "
        "float32 in [0, 1]; radiance, linear, float32",
        choices=("srgb8", "srgb", "radiance"),
    )
    out: Path | str | None = option(
        None,
        "folder that keeps the output of each seed, SEED as ``run`` makes it, of which nothing is "
        "made twice (default: a temporary one, each scene removed once its frames were given)",
    )
    settings: Sequence[str] = held((), many=True)
    cache: bool | Path | str = option(
        False, "as of ``compile``; of scenes that are new little can be taken (default: none)"
    )

    def __post_init__(self) -> None:
        """Holds seeds to be several; those of an iterator are read when it is their turn.

        Raises:
            ScenecError: They are not.
        """
        super().__post_init__()
        seeds: object = self.seeds
        if not isinstance(seeds, Iterable) or isinstance(seeds, str | bytes):
            raise ScenecError(f"seeds: {seeds!r}: expected seeds, such as range(100)")
        if isinstance(seeds, Sequence) and not isinstance(seeds, range):
            deque(numbered(seeds, 0), 0)


@dataclass(frozen=True)
class StreamFrame:
    """Holds a frame of a stream.

    Attributes:
        index, seed: Of its scene; ``start=index + 1`` goes on behind it.
        rgb: As asked for; None without that pass.
        loaded: All that there is of it; its files may be gone.
    """

    index: int
    seed: int
    rgb: NDArray[Any] | None
    loaded: LoadedFrame

    @property
    def name(self) -> str:
        """Names it among all frames of the stream: ``SEED/BATCH/CAMERA/SAMPLE``."""
        return f"{self.seed}/{self.loaded.ref.name}"

    @property
    def passes(self) -> Mapping[str, NDArray[Any]]:
        """Holds the arrays by name, as ``read_frame`` gives them: ``rgb`` is radiance here."""
        return self.loaded.passes

    def __getitem__(self, name: str) -> NDArray[Any]:
        """A pass by name.

        Raises:
            FrameError: The frame has none of this name.
        """
        if name not in self.passes:
            raise FrameError(
                f"{self.name}: has no {name}, but {', '.join(self.passes)}; ask for it: passes="
            )
        return self.passes[name]

    @property
    def depth(self) -> NDArray[np.float32]:
        """Tells the depth, float32 [h, w], meters; +inf without a hit."""
        return self["depth"]

    @property
    def labels(self) -> dict[str, NDArray[np.uint32]]:
        """Holds the ids of each level of labels, uint32 [h, w]; ``loaded.labels`` names them."""
        levels = (name for name in self.passes if name.startswith(f"{LABEL}."))
        return {name.removeprefix(f"{LABEL}."): self.passes[name] for name in levels}

    @property
    def instances(self) -> NDArray[np.uint32]:
        """Tells which instance each pixel shows, uint32 [h, w]; ``loaded.table`` lists them."""
        return self["instance"]

    @property
    def record(self) -> FrameRecord:
        """Says what the sidecar does of intrinsics, pose, labels, errors and times."""
        return self.loaded.sidecar


@Spread(StreamOptions).one
def stream(cfg: AnyCfg, options: StreamOptions) -> Iterator[StreamFrame]:
    """Compiles and renders scene after scene, and yields their frames as arrays.

    The frames are those of ``run`` with the same seed and options, to the bit on one machine and
    device. They come in the order of seeds, and of a scene by batch, camera and sample, whoever
    makes them. Workers keep their renderer from scene to scene, draw one while they compile the
    next, and are a few scenes ahead. Nothing starts before the first frame is asked for, and
    nothing is left once the iterator is closed: by ``break``, an error, Ctrl-C, or its last frame.

    Args:
        cfg: As of ``compile``.
        options: As fields of ``StreamOptions``.

    Raises:
        CfgError: The cfg has faults; all of them are in the error.
        SceneError: A scene cannot be built; ``faults`` says whether others then follow.
        BackendError, OutputError, StageError: As of ``render``; also where it gives up a frame.
    """
    spec = read_cfg(cfg, options.settings)
    for line in spec.warnings:
        options.listener.warn(str(line))
    return _frames(spec, options)


def _frames(spec: Spec, options: StreamOptions) -> Iterator[StreamFrame]:
    from scenec.schemas.scratch import scratch_folder

    heard: set[str] = set()
    with ExitStack() as stack:
        folder = Path(options.out or stack.enter_context(scratch_folder())).absolute()
        folder.mkdir(parents=True, exist_ok=True)
        executor = stack.enter_context(hire(options))
        refuse_early(options, spec.cfg, executor)
        made = stack.enter_context(closing(_make(executor, _scenes(spec, options, folder))))
        for scene, backend, lines in made:
            # Most hold for every scene.
            for line in lines:
                if line not in heard:
                    heard.add(line)
                    options.listener.warn(line)
            if backend:
                yield from _read(scene, backend, options.color)
            scene.remove()


def _make(
    executor: Executor, scenes: Iterator[Scene]
) -> Generator[tuple[Scene, str, Sequence[str]]]:
    """Has scenes compiled and drawn; yields them in order, with the frames' backend and warnings.

    Each worker has one scene to draw and one to compile; a few wait for those before them.
    """
    workers = executor.room(_MANY)[1]
    given, compiled = deque[Scene](), deque[DrawScene]()
    made: dict[tuple[int, range], Outcome] = {}
    compiling = 0

    def take(_holds: object) -> Unit | None:
        nonlocal compiling
        if compiling < workers and len(given) < _AHEAD * workers:
            scene = next(scenes, None)
            if scene is not None:
                compiling += 1
                given.append(scene)
                return CompileScene(scene)
        return compiled.popleft() if compiled else None

    with closing(executor.work(take)) as outcomes:
        for unit, outcome in outcomes:
            assert isinstance(unit, CompileScene | DrawScene)
            scene = unit.scene
            if isinstance(unit, CompileScene):
                compiling -= 1
                if outcome.error is None and outcome.value.batches:
                    compiled.append(DrawScene(scene, outcome.value.batches))
                    continue
            made[scene.index, scene.batches] = outcome
            while given and (key := (given[0].index, given[0].batches)) in made:
                # An error, too, comes after the scenes before it.
                ended = made.pop(key)
                done: SceneDone = ended.result()
                yield given.popleft(), done.backend, [*ended.warnings, *ended.notes, *done.lines]


def _scenes(spec: Spec, options: StreamOptions, folder: Path) -> Iterator[Scene]:
    """Yields the scenes that are asked for: of a seed that is kept all batches, else one each."""
    kept = options.out is not None
    batches = options.batches or range(int(spec.cfg["batches"]))
    first = Scene(
        cfg=spec.path.absolute(),
        text=spec.text,
        digest=spec.digest,
        plan=plan_of(options),
        stages={
            "keep": options.keep,
            "cache": cache_folder(options.cache),
            "replace": options.replace,
            "faults": options.faults,
        },
        kept=kept,
    )
    for index, seed in numbered(options.seeds, options.start):
        for part in [batches] if kept else (range(one, one + 1) for one in batches):
            name = f"seed={seed}" if kept else f"{index}_{part.start}"
            yield replace(first, index=index, seed=seed, batches=part, folder=folder / name)


def numbered(seeds: Iterable[Any], start: int) -> Iterator[tuple[int, int]]:
    """Yields index and seed from an index on.

    Raises:
        ScenecError: One is no seed.
    """
    first = start if isinstance(seeds, range) else 0
    # Of a range none of those before it need be counted off.
    for number, given in enumerate(seeds[first:] if isinstance(seeds, range) else seeds, first):
        index, seed = given if isinstance(given, tuple) else (number, given)
        try:
            index, seed = forms.counted(str(index)), forms.seed(str(seed))
        except ScenecError as error:
            raise ScenecError(f"seeds: {error}") from error
        if index >= start:
            yield index, seed


@dataclass
class _Warm:
    """Holds what a worker keeps from scene to scene.

    Attributes:
        spec: The cfg, read.
        rendering: The stage and the renderer of the last scene.
        backend: The renderer that ``auto`` has chosen.
    """

    spec: Spec
    rendering: Keeper = field(default_factory=Keeper)
    backend: str = ""


class SceneDone(NamedTuple):
    """Reports what came of a step: the batches that are compiled, or whose frames there are."""

    batches: Collection[int] = ()
    backend: str = ""
    lines: Sequence[str] = ()


@dataclass(frozen=True)
class Scene:
    """Describes batches of a seed, and how they are compiled and rendered.

    Attributes:
        cfg, text, digest: As of ``CompileBatch``.
        plan: What is rendered.
        stages: How it is compiled, by keywords of ``compile_cfg``.
        kept: Whether the folder stays.
        index, seed, batches: Which scene.
        folder: Its output folder.
    """

    cfg: Path
    text: bytes
    digest: str
    plan: RenderPlan
    stages: JsonObject
    kept: bool
    index: int = 0
    seed: int = 0
    batches: range = range(1)
    folder: Path = Path()

    def remove(self) -> None:
        """Removes it, unless it is kept."""
        if not self.kept:
            shutil.rmtree(self.folder, ignore_errors=True)

    def warm(self, keeper: Keeper) -> _Warm:
        """Returns what a worker keeps, which is the same for all scenes of a stream."""
        from scenec.compiler.cfg.load import load

        return keeper.keep(self.digest, lambda: _Warm(load(self.cfg, text=self.text)))


@dataclass(frozen=True, eq=False)
class SceneStep:
    """Does something for a scene, as a unit of work (``schemas.units``).

    Attributes:
        scene: Which.
    """

    scene: Scene

    @property
    def what(self) -> str:
        """In messages."""
        scene = self.scene
        batch = f", batch {scene.batches.start}" if len(scene.batches) == 1 else ""
        return f"scene {scene.index} (seed {scene.seed}{batch})"

    @property
    def holds(self) -> str:
        """Names what a worker keeps."""
        return self.scene.digest


class CompileScene(SceneStep):
    """Compiles a scene; returns ``SceneDone``."""

    def clean(self) -> None:
        """Removes what is half written."""
        self.scene.remove()

    def run(self, keeper: Keeper) -> SceneDone | Rest[SceneDone]:
        """Compiles it; a worker does so beside the drawing of the last one.

        Raises:
            ScenecError: As of ``stream``.
        """
        # Loaded by this thread, as for steps that run on threads (``compiler.batch_unit``).
        import_module("scenec.compiler.emit.batch")
        # Not the other way around: some renderers are bound to the thread that started them.
        return keeper.finish(partial(self._compile, self.scene.warm(keeper).spec))

    def _compile(self, spec: Spec) -> SceneDone:
        from scenec.compiler.compile import compile_cfg
        from scenec.compiler.views.needed import Keep
        from scenec.schemas.update import short_lived

        scene = self.scene
        how = {**scene.stages, "keep": Keep(scene.stages["keep"])}
        try:
            with nullcontext() if scene.kept else short_lived():
                done = compile_cfg(
                    spec, seed=scene.seed, out=scene.folder, batches=scene.batches, **how
                )
        except SceneError as error:
            if how["faults"] == "stop":
                raise SceneError(f"{self.what}: {error}") from error
            return SceneDone(lines=[f"{self.what}: {error}"])
        return SceneDone(done.batches)


@dataclass(frozen=True, eq=False)
class DrawScene(SceneStep):
    """Renders a scene; returns ``SceneDone``.

    Attributes:
        batches: Those that were compiled.
    """

    batches: Collection[int]

    def run(self, keeper: Keeper) -> SceneDone:
        """Renders it, as the command does.

        Raises:
            ScenecError: As of ``stream``.
        """
        from scenec.backends.run.render import render

        warm, lines = self.scene.warm(keeper), list[str]()
        plan = self.scene.plan
        plan = replace(plan, batches=self.batches, backend=warm.backend or plan.backend)
        worker = LocalExecutor(warm.rendering)
        report = render(self.scene.folder, plan, executor=worker, warn=lines.append)
        if report.failed:
            raise BackendError(f"{self.what}: {report.failed[0]}")
        if report.choice is not None:
            warm.backend = report.backend
        return SceneDone(self.batches, report.backend, lines)


def _read(scene: Scene, backend: str, color: str) -> Iterator[StreamFrame]:
    """Reads the frames of a scene."""
    import numpy as np

    from scenec.datasets.pictures import picture
    from scenec.datasets.source import Source

    plan = scene.plan
    cameras = None if plan.cameras is None else [*plan.cameras]
    source = Source(
        scene.folder, backend, batches=scene.batches, cameras=cameras, samples=plan.samples
    )
    for ref in source.frames:
        loaded = source.load(ref)
        shown: NDArray[Any] | None = loaded.passes.get("rgb")
        if shown is not None and color != "radiance":
            shown = picture(loaded)
            if color == "srgb":
                shown = shown.astype(np.float32) / np.float32(255.0)
        yield StreamFrame(scene.index, scene.seed, shown, loaded)
