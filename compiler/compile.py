"""Compiles a cfg and a seed into stages and a manifest: the main call."""

from __future__ import annotations

import time
from collections.abc import Callable, Generator, Sequence
from contextlib import ExitStack, closing
from dataclasses import dataclass, field
from dataclasses import replace as replace_
from pathlib import Path

from scenec.compiler.batch_unit import CompileBatch, Compiled
from scenec.compiler.cache.store import Store
from scenec.compiler.cfg.check_files import require_unchanged
from scenec.compiler.cfg.load import Spec, load
from scenec.compiler.estimate import needs_of, require_memory, time_warning
from scenec.compiler.output import Output, locked
from scenec.compiler.views.needed import Keep
from scenec.schemas.errors import ScenecError, SceneError
from scenec.schemas.files import temporary_folder
from scenec.schemas.report import BatchReport
from scenec.schemas.strays import stray_line, stray_scans, strays
from scenec.schemas.units import Executor, Keeper, LocalExecutor, Outcome, Say, Unit, run_all

Tell = Callable[[str, tuple[int, int] | None], None]
#: What to do about a batch that cannot be built.
FAULTS = ("stop", "skip", "redraw")


@dataclass(frozen=True)
class CompileReport:
    """Reports what a compilation did.

    Attributes:
        out: Output folder.
        batches: Indices of the batches compiled now.
        unchanged: How many of them were there already, byte for byte.
        seconds: Per batch, seconds of each pass.
        reports: Per batch, its report.
        strays: A line for each batch beside which frames or scans of an earlier stage lie that this
            one has no place for, and one for each with files that are not the compiler's: nothing
            replaces them.
        failed: Batches that could not be built and were passed over -> why.
        attempts: Batches that were drawn again -> how often.
        made, taken: Per batch, how often each step was made, or taken from the cache; empty
            without one.
    """

    out: Path
    batches: tuple[int, ...]
    unchanged: int
    seconds: dict[str, dict[str, float]]
    reports: dict[str, BatchReport]
    strays: tuple[str, ...] = ()
    failed: dict[str, str] = field(default_factory=dict)
    attempts: dict[str, int] = field(default_factory=dict)
    made: dict[str, dict[str, int]] = field(default_factory=dict)
    taken: dict[str, dict[str, int]] = field(default_factory=dict)


def compile_cfg(
    cfg: Path | str | Spec,
    *,
    seed: int,
    out: Path | str,
    batches: range | None = None,
    keep: Keep = Keep.SEEN,
    progress: Tell | None = None,
    cache: Path | str | None = None,
    replace: bool = False,
    faults: str = "stop",
    executor: Executor | None = None,
) -> CompileReport:
    """Compiles a cfg into USD stages, one per batch.

    The same cfg, seed and version give the same bytes in every file of the manifest, whoever
    compiles which batch. Batches that are there already with the same bytes are left alone, and so
    are their frames.

    Args:
        cfg: The cfg's file, or what ``load`` read of it.
        seed: 0 <= seed < 2**64; 0 is a seed like any other.
        out: Output folder; made if it is not there.
        batches: Which batches; None compiles all.
        keep: How much stays in the stages.
        progress: Called with lines worth saying, and None; and with a text when a step of a batch
            begins (with an executor: when a batch is there), and batches done and in all.
        cache: Folder of steps that were made before and are taken where nothing they depend on
            has changed (``cache.store.default_folder`` is the command line's); the bytes are
            the same with it and without, and ``$SCENEC_CACHE_MAX`` bounds it. None: all is made.
        replace: Whether batches of another cfg, seed, ``keep`` or version may be replaced that are
            in the folder; those that are not compiled now go, and so do frames of other stages.
        faults: What to do about a batch that cannot be built: ``stop``, ``skip`` it, or ``redraw``
            it from other streams, up to 15 times (the bytes are the same each time).
        executor: Who compiles the batches; None: this process, one after the other.

    Raises:
        CfgError: The cfg has faults; all of them are in the error. Or a file that it names was
            changed meanwhile; batches before are there.
        SceneError: The cfg is valid but what it asks for cannot be built; batches before that one
            are there. With ``skip`` and ``redraw``: no batch can be built, and nothing is written.
        OutputError: The output folder cannot be written, holds something that is not to be
            replaced, or another process is at work on it.
    """
    notify = progress or (lambda _text, _place: None)
    started = time.perf_counter()
    if faults not in FAULTS:
        raise ScenecError(f"faults: {faults!r}: expected one of {', '.join(FAULTS)}")
    spec = cfg if isinstance(cfg, Spec) else load(cfg)
    load_seconds = time.perf_counter() - started
    out = Path(out)
    cache = None if cache is None else Path(cache).absolute()
    if cache is not None and Store(cache, say=lambda line: notify(line, None)).refused:
        cache = None  # Said once, not by each batch.
    chosen = _chosen(spec, batches)
    report = CompileReport(out, (), 0, {}, {})
    left_over: list[str] = []
    done: list[int] = []
    failed = report.failed
    unchanged = 0
    with locked(out), temporary_folder(out) as folder, ExitStack() as stack:
        output = Output(out, spec, seed, keep, chosen, replace, lambda line: notify(line, None))
        units = [
            CompileBatch(
                cfg=spec.path.absolute(),
                text=spec.text,
                digest=spec.digest,
                seed=seed,
                batch=batch,
                keep=keep,
                first=output.attempt(batch),
                redraw=faults == "redraw",
                cache=cache,
                folder=folder.absolute() / str(batch),
                out=out,
            )
            for batch in chosen
        ]
        ended = stack.enter_context(closing(_compiled(units, spec, executor, notify)))
        for unit, compiled in ended:
            name, batch = unit.what, unit.batch
            require_unchanged(spec.files, spec.path)
            if compiled.error is not None:
                if faults == "stop":
                    raise _stopped(compiled.error, name, done, len(chosen)) from compiled.error
                if faults == "skip":
                    notify(f"warning: {name} cannot be built: {compiled.error}", None)
                failed[name] = str(compiled.error)
                output.fail(batch, failed[name])
                continue
            unchanged += output.put(
                unit.folder, batch, compiled.samples, compiled.attempt, compiled.georeference
            )
            done.append(batch)
            if compiled.attempt:
                report.attempts[name] = compiled.attempt
            report.seconds[name] = {"load": load_seconds, **compiled.seconds}
            if compiled.report is not None:
                report.reports[name] = compiled.report
            left_over += _strays(out / name, compiled)
            left_over += output.foreign(batch)
            if compiled.made is not None and compiled.taken is not None:
                report.made[name], report.taken[name] = compiled.made, compiled.taken
            # After each batch: what an interrupted run has finished can be gone on with.
            output.write_timings(report.seconds)
        if not done:
            reason = next(iter(failed.values()))
            raise SceneError(f"none of {len(chosen)} batches can be built; the first: {reason}")
        output.close()
    if cache is not None and any(report.made.values()):
        Store(cache).tidy()
    return replace_(report, batches=tuple(done), unchanged=unchanged, strays=tuple(left_over))


def _compiled(
    units: Sequence[CompileBatch],
    spec: Spec,
    executor: Executor | None,
    notify: Tell,
) -> Generator[tuple[CompileBatch, Compiled]]:
    """Compiles batches, itself or by an executor, and yields their results in order."""

    def say(line: str) -> None:
        notify(line, None)

    total, done, ends = len(units), 0, 0
    room = None
    if executor is None:

        def step(text: str) -> None:
            notify(f"{units[done].what}: {text}", (done, total))

        keeper = Keeper(say, step)
        keeper.keep(units[0].holds, lambda: spec)
        executor = LocalExecutor(keeper)
    else:
        executor.prepare(units[0].folder.parent)
        room = executor.room(total)
    # In this process the others are looked at when it is their turn.
    for number, unit in enumerate(units[: total if room else 1]):
        _require_room(spec, unit, None if number else total, say, room)
    if room:
        batches = f"{total} batches" if total > 1 else units[0].what
        say(f"compiling {batches} of {spec.cfg['name']}, seed {units[0].seed}, {room[1]} at once")

    def ended(unit: Unit, outcome: Outcome) -> None:
        nonlocal ends
        ends += 1
        for line in outcome.warnings:
            say(f"warning: {line}")
        if room:
            notify(f"{unit.what} is compiled", (ends, total))

    # In their order: where one cannot be built, those before it are there, and no others.
    with closing(run_all(executor, units, in_order=True, ended=ended)) as outcomes:
        for unit, (_, outcome) in zip(units, outcomes, strict=True):
            for line in outcome.notes:
                say(line)
            yield unit, outcome.result()
            done += 1
            if not room and done < total:
                _require_room(spec, units[done], None, say)


def _require_room(
    spec: Spec,
    unit: CompileBatch,
    batches: int | None,
    say: Say,
    room: tuple[int, int] | None = None,
) -> None:
    """Refuses a batch that does not fit into memory; tells of one that will be tight, or long.

    Args:
        batches: How many there are in all, where their time is to be told; else None.
        room: As of ``Executor.room``; None: all that is free here.

    Raises:
        SceneError: It does not fit.
    """
    needs = needs_of(spec, unit.seed, unit.batch)
    tight = require_memory(needs) if room is None else require_memory(needs, *room)
    if tight is not None:
        say(f"warning: {unit.what}: {tight}")
    long = None if batches is None else time_warning(needs, batches)
    if long is not None:
        say(long)


def _stopped(error: SceneError, name: str, done: list[int], total: int) -> SceneError:
    """The same, with the batch and what can be done, where there are several."""
    if total == 1:
        return error
    before = f"{len(done)} batches before it are there" if done else "no batch is there yet"
    stopped = SceneError(
        f"{name}: {error} ({before}; --faults skip passes such a batch over, --faults redraw draws "
        "it again)"
    )
    stopped.batches = tuple(done)
    return stopped


def _strays(folder: Path, compiled: Compiled) -> list[str]:
    """A line about frames and scans that are none of this stage's, if there are any."""
    found = list(strays(folder, compiled.cameras))
    found += stray_scans(folder, compiled.lidars)
    return [stray_line(found)] if found else []


def _chosen(spec: Spec, batches: range | None) -> range:
    count = int(spec.cfg["batches"])
    if batches is None:
        return range(count)
    if batches.start < 0 or batches.stop > count or not len(batches):
        raise ScenecError(
            f"--batches {batches.start}:{batches.stop}: the cfg has batches 0 to {count - 1}; "
            f"a range A:B holds A to B-1"
        )
    return batches
