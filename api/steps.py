"""Takes the steps of the main calls: compiling, rendering, scanning.

What takes long to import is imported where it is used: a command says what it reads before.
"""

from __future__ import annotations

import json
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager, nullcontext
from dataclasses import fields
from pathlib import Path
from typing import TYPE_CHECKING, Any

from scenec.api import forms
from scenec.api.options import (
    PictureOptions,
    RenderOptions,
    RunOptions,
    ScanOptions,
    StageOptions,
    WorkOptions,
)
from scenec.schemas.codec import JsonObject
from scenec.schemas.errors import CfgError, ScenecError

if TYPE_CHECKING:
    from scenec.backends.run.plan import RenderPlan
    from scenec.backends.run.render import RenderReport
    from scenec.backends.run.scan import ScanReport
    from scenec.compiler.cfg.builder import CompleteCfg
    from scenec.compiler.cfg.fill import Cfg
    from scenec.compiler.cfg.load import Spec
    from scenec.compiler.compile import CompileReport
    from scenec.schemas.units import Executor

#: A cfg: its file, what it holds, or one that is written in Python (``compiler.cfg.builder``).
#: Files that the latter two name are relative to the working directory.
type AnyCfg = Path | str | JsonObject | CompleteCfg
type Folder = Path | str
#: Names a cfg that is in no file, in faults.
_PYTHON = "cfg"


def read_cfg(cfg: AnyCfg, settings: Sequence[str] = ()) -> Spec:
    """Reads and validates a cfg, whoever wrote it.

    Args:
        cfg: A file, what it holds, or one that is written in Python.
        settings: What is set over it, each ``path=value``.

    Raises:
        CfgError: With all of its faults; said of no file they have JSON pointers.
        ScenecError: It is none, or holds what JSON does not.
    """
    from scenec.compiler.cfg.load import load

    path, text = source_of(cfg)
    with placed(text is None):
        return load(path, settings, text)


@contextmanager
def placed(in_file: bool) -> Iterator[None]:
    """Takes line and column from faults of a cfg that is in no file: nobody has seen its text."""
    try:
        yield
    except CfgError as error:
        if in_file:
            raise
        raise error.unplaced(_PYTHON) from None


def source_of(cfg: AnyCfg) -> tuple[Path | str, bytes | None]:
    """Returns a cfg's file, and the text in place of its content, where it is no file.

    Raises:
        ScenecError: As of ``read_cfg``.
    """
    if isinstance(cfg, Path | str):
        return cfg, None
    from scenec.compiler.cfg.builder import CompleteCfg

    if not isinstance(cfg, Mapping | CompleteCfg):
        raise ScenecError(f"cfg: {cfg!r:.60}: expected a file, a dict, or a Cfg of the builder")
    try:
        text = json.dumps(cfg, default=plain) if isinstance(cfg, Mapping) else cfg.text()
    except (TypeError, ValueError) as error:
        raise ScenecError(f"cfg: {error}") from error
    return Path(_PYTHON), text.encode()


def plain(value: Any) -> Any:
    """Returns NumPy's numbers and arrays as JSON has them."""
    if hasattr(value, "tolist"):
        return value.tolist()
    raise TypeError(f"{value!r:.60}: a {type(value).__name__} is no value of a cfg")


def compile_spec(spec: Spec, out: Folder, options: StageOptions, seed: int) -> CompileReport:
    """Compiles what was read of a cfg; raises as ``compile`` does."""
    listener = options.listener
    for line in spec.warnings:
        listener.warn(str(line))
    # Here: what is wrong with a cfg is told before the rest is imported.
    from scenec.compiler.compile import compile_cfg
    from scenec.compiler.views.needed import Keep

    cache = cache_folder(options.cache)
    steps = listener.steps("compiled", unit="batch", units="batches")

    def tell(text: str, place: tuple[int, int] | None) -> None:
        if place is None:
            listener.say(text)
        else:
            steps.now(*place, text)

    chosen = options.workers not in (None, 0, forms.AUTO)
    given = options.executor is not None or chosen or options.cluster
    with hire(options, limited=False) if given else nullcontext() as executor:
        report = compile_cfg(
            spec,
            seed=seed,
            out=out,
            batches=options.batches,
            keep=Keep(options.keep),
            progress=tell,
            cache=cache,
            replace=options.replace,
            faults=options.faults,
            executor=executor,
        )
    listener.compiled(report, cache)
    return report


def cache_folder(cache: bool | Path | str) -> Path | None:
    """The folder that an option and the environment name; None: there shall be none."""
    from scenec.compiler.cache.store import default_folder

    if isinstance(cache, bool):
        return default_folder() if cache else None
    return Path(cache)


def render_output(
    out: Folder,
    options: PictureOptions,
    executor: Executor | None = None,
    batches: Collection[int] | None = None,
) -> RenderReport:
    """Renders as ``render`` does.

    Args:
        out: Output folder, or a USD file.
        options: What is rendered.
        executor: Who works; None: who the options say.
        batches: Only these; None: those that the options say.
    """
    listener = options.listener
    with hire(options, executor) as worker:
        # Imported here: beside the start of a worker.
        from scenec.backends.run.render import render as render_stages

        plan = plan_of(options, batches)
        report = render_stages(
            out,
            plan,
            executor=worker,
            progress=listener.steps("frame"),
            warn=listener.warn,
            say=listener.say,
        )
    listener.rendered(report)
    return report


def scan_output(
    out: Folder,
    options: ScanOptions | PictureOptions,
    executor: Executor | None = None,
    batches: Collection[int] | None = None,
) -> ScanReport:
    """Scans as ``scan`` does; arguments as of ``render_output``."""
    from scenec.backends.run.scan import scan_output as scan_stages
    from scenec.schemas.clouds import CLOUDS

    own = options if isinstance(options, ScanOptions) else ScanOptions()
    with hire(options, executor, limited=False) as worker:
        report = scan_stages(
            out,
            samples=options.samples,
            batches=getattr(options, "batches", None) if batches is None else batches,
            lidars=own.lidars,
            clouds=[kind for kind in CLOUDS if getattr(own, kind)],
            allow_missing=own.allow_missing,
            progress=options.listener.steps("scan", unit="scan"),
            executor=worker,
        )
    for line in report.warnings:
        options.listener.warn(line)
    options.listener.scanned(report)
    return report


def plan_of(options: PictureOptions, batches: Collection[int] | None = None) -> RenderPlan:
    """The plan of what is asked to be rendered.

    Raises:
        BackendError: It cannot be.
    """
    from scenec.backends.run.plan import RenderPlan

    names = {field.name for field in fields(RenderPlan)}
    asked = {name: value for name, value in vars(options).items() if name in names}
    if isinstance(asked.get("folder"), str):
        asked["folder"] = Path(asked["folder"])
    return RenderPlan(**asked if batches is None else {**asked, "batches": batches})


def hire(
    options: WorkOptions, executor: Executor | None = None, *, limited: bool = True
) -> AbstractContextManager[Executor]:
    """Returns the executor until the context ends: the given one, or else that of the options.

    Args:
        options: Of the call.
        executor: Who is given.
        limited: Whether workers may take no more than the options of pictures allow.

    Raises:
        BackendError: The cluster cannot be reached or used.
    """
    from scenec.backends.run.executors import make_executor, read_workers
    from scenec.backends.run.limits import Limits
    from scenec.schemas.memory import GB

    executor = executor or options.executor
    if executor is not None:
        return nullcontext(executor)
    may_choose = isinstance(options, RenderOptions | RunOptions)
    workers = read_workers(options.workers, forms.AUTO if may_choose else None)
    if not (limited and isinstance(options, PictureOptions)):
        return make_executor(1 if workers is None else workers, options.cluster)
    most = None if options.memory_limit is None else round(options.memory_limit * GB)
    if workers is None:
        workers = _choose_workers(options, most) if options.cluster in (None, "local") else 1
    # What is to be rendered is read while the worker imports; that of ``run`` has time enough.
    modules = ["scenec.backends.run.session"] if isinstance(options, RenderOptions) else []
    limits = Limits(options.timeout, memory_bytes=most)
    return make_executor(workers, options.cluster, limits, modules)


def _choose_workers(options: PictureOptions, most: int | None) -> int:
    """The number of workers for what is asked; says which, where it is not the usual one."""
    from scenec.backends.run.workers import this_machine, workers_for

    machine, asked = this_machine(), (options.backend, options.device, options.passes)
    count, why = workers_for(machine, *asked, most)
    if count > 1 or options.workers == forms.AUTO:
        options.listener.say(f"auto: {count} worker{'' if count == 1 else 's'}: {why}")
    return count


def refuse_early(options: PictureOptions, cfg: Cfg, executor: Executor | None = None) -> bool:
    """Refuses pictures that no renderer on this machine can draw, before any compilation.

    Args:
        options: What is to be rendered.
        cfg: What will be compiled.
        executor: Who starts the renderer, and has it then; None: a process of its own.

    Returns:
        Whether there are lidars.

    Raises:
        BackendError: The backend cannot render what is asked for.
    """
    from scenec.backends.run.auto import check_backend
    from scenec.schemas.passes import ANNOTATION_NAMES

    wanted = options.passes
    rigs = cfg["rigs"]
    sensors = {f"{rig}_{name}": s for rig in rigs for name, s in rigs[rig]["sensors"].items()}
    drawn = [n for n, s in sensors.items() if "rgb" in (wanted or s["outputs"])]
    if wanted is None:
        wanted = [name for s in sensors.values() for name in s["outputs"]]
        if options.backend in ANNOTATION_NAMES and set(wanted) != {"rgb"}:
            # All but that is made.
            wanted = [name for name in wanted if name != "rgb"]
    apertures = [name for name in drawn if "focus" in sensors[name]]
    check_backend(plan_of(options), rgb="rgb" in wanted, apertures=apertures, executor=executor)
    return any("lidars" in rig for rig in rigs.values())
