"""The compiler's main call: cfg and seed in, stages and a manifest out."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from dataclasses import replace as replace_
from pathlib import Path
from typing import Any

from pxr import Tf

from scenec.compiler.build import BuildLog, build
from scenec.compiler.draw import draw
from scenec.compiler.emit.batch import write_batch
from scenec.compiler.estimate import needs_of, require_memory, told_time
from scenec.compiler.frontend.load import Spec, load
from scenec.compiler.incremental.memo import Memo, memoizing
from scenec.compiler.incremental.store import Store
from scenec.compiler.output import Output, batch_name, locked
from scenec.compiler.passes.keep import Keep
from scenec.compiler.rig import Lidar, Rig, Sensor
from scenec.compiler.scene import Scene
from scenec.schemas.errors import OutputError, ScenecError, SceneError
from scenec.schemas.files import temporary_folder, tree, write_json
from scenec.schemas.left_out import write_left_out
from scenec.schemas.manifest import REPORT
from scenec.schemas.strays import Firing, stray_scans, strays, told

#: What to do about a batch that cannot be built.
FAULTS = ("stop", "skip", "redraw")
#: How often a batch is drawn before it is given up.
_MOST_ATTEMPTS = 16


@dataclass(frozen=True)
class CompileReport:
    """What a compilation did.

    Attributes:
        out: Output folder.
        batches: Indices of the batches compiled now.
        unchanged: How many of them were there already, byte for byte.
        seconds: Per batch, seconds of each pass.
        facts: Per batch, the contents of its report.json.
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
    facts: dict[str, dict[str, Any]]
    strays: tuple[str, ...] = ()
    failed: dict[str, str] = field(default_factory=dict)
    attempts: dict[str, int] = field(default_factory=dict)
    made: dict[str, dict[str, int]] = field(default_factory=dict)
    taken: dict[str, dict[str, int]] = field(default_factory=dict)


def compile_cfg(
    cfg: Path | str,
    *,
    seed: int,
    out: Path | str,
    batches: range | None = None,
    keep: Keep = Keep.SEEN,
    progress: Callable[[str], None] | None = None,
    step: Callable[[int, int, str], None] | None = None,
    cache: Path | str | None = None,
    replace: bool = False,
    faults: str = "stop",
) -> CompileReport:
    """Compiles a cfg into USD stages, one per batch.

    The same cfg, seed and version give the same bytes in every file of the manifest. Batches that
    are there already with the same bytes are left alone, and so are their frames.

    Args:
        cfg: The cfg's JSON file.
        seed: 0 <= seed < 2**64; 0 is a seed like any other.
        out: Output folder; made if it is not there.
        batches: Which batches; None compiles all.
        keep: How much stays in the stages.
        progress: Called with a line of text before each batch.
        step: Called when a step of a batch begins, with batches done, batches in all, and a text.
        cache: Folder of steps that were made before and are taken where nothing they depend on
            has changed (``incremental.store.default_folder`` is the command line's); the bytes are
            the same with it and without, and ``$SCENEC_CACHE_MAX`` bounds it. None: all is made.
        replace: Whether batches of another cfg, seed, ``keep`` or version may be replaced that are
            in the folder; those that are not compiled now go, and so do frames of other stages.
        faults: What to do about a batch that cannot be built: ``stop``, ``skip`` it, or ``redraw``
            it from other streams, up to 15 times (the bytes are the same each time).

    Raises:
        CfgError: The cfg has faults; all of them are in the error.
        SceneError: The cfg is valid but what it asks for cannot be built; batches before that one
            are there. With ``skip`` and ``redraw``: no batch can be built, and nothing is written.
        OutputError: The output folder cannot be written, holds something that is not to be
            replaced, or another process is at work on it.
    """
    say = progress or (lambda _text: None)
    started = time.perf_counter()
    if faults not in FAULTS:
        raise ScenecError(f"faults: {faults!r}: expected one of {', '.join(FAULTS)}")
    spec = load(Path(cfg))
    load_seconds = time.perf_counter() - started
    out = Path(out)
    chosen = _chosen(spec, batches)
    report = CompileReport(out, (), 0, {}, {})
    store = None if cache is None else Store(Path(cache), say=say)
    left_over: list[str] = []
    made: list[int] = []
    failed = report.failed
    unchanged = 0
    with locked(out):
        output = Output(out, spec, seed, keep, chosen, replace, say)
        for done, batch in enumerate(chosen):
            name = batch_name(batch)
            tell = _teller(step, done, len(chosen), name)
            _require_room(spec, seed, batch, len(chosen) if done == 0 else None, say)
            for attempt in _attempts(output.attempt(batch), faults):
                again = f", attempt {attempt + 1}" if attempt else ""
                say(f"compiling {name} of {spec.cfg['name']}, seed {seed}{again}")
                log = BuildLog(seconds={"load": load_seconds}, tell=tell)
                memo = None if store is None else Memo(store)
                try:
                    scene = _build(spec, (seed, batch, attempt), keep, log, memo)
                    with temporary_folder(out) as folder, memoizing(memo):
                        _emit(folder / name, scene, log, batch, attempt)
                        unchanged += output.put(folder, batch, scene.samples, attempt)
                except SceneError as error:
                    if faults == "stop":
                        raise _stopped(error, name, made, len(chosen)) from error
                    say(f"warning: {name} cannot be built: {error}")
                    failed[name] = str(error)
                else:
                    failed.pop(name, None)
                    break
            if name in failed:
                output.fail(batch, failed[name])
                continue
            made.append(batch)
            if attempt:
                report.attempts[name] = attempt
            report.seconds[name], report.facts[name] = log.seconds, log.facts
            left_over += _strays(out / name, scene)
            left_over += output.foreign(batch)
            if memo is not None:
                report.made[name], report.taken[name] = dict(memo.made), dict(memo.taken)
            # After each batch: what an interrupted run has finished can be gone on with.
            output.write_timings(report.seconds)
        if not made:
            reason = next(iter(failed.values()))
            raise SceneError(f"none of {len(chosen)} batches can be built; the first: {reason}")
        output.close()
    if store is not None:
        store.tidy()
    return replace_(report, batches=tuple(made), unchanged=unchanged, strays=tuple(left_over))


def _require_room(
    spec: Spec, seed: int, batch: int, batches: int | None, say: Callable[[str], None]
) -> None:
    """Refuses a batch that does not fit into memory; tells of one that will be tight, or long.

    Args:
        spec, seed, batch: What will be drawn.
        batches: How many there are in all, where their time is to be told; else None.
        say: Told.

    Raises:
        SceneError: It does not fit.
    """
    needs = needs_of(spec, seed, batch)
    tight = require_memory(needs)
    if tight is not None:
        say(f"warning: {batch_name(batch)}: {tight}")
    long = None if batches is None else told_time(needs, batches)
    if long is not None:
        say(long)


def _attempts(first: int, faults: str) -> range:
    """Numbers of the attempts at a batch."""
    return range(first, max(first + 1, _MOST_ATTEMPTS if faults == "redraw" else 0))


def _stopped(error: SceneError, name: str, made: list[int], total: int) -> SceneError:
    """The same, with the batch and what can be done, where there are several."""
    if total == 1:
        return error
    before = f"{len(made)} batches before it are there" if made else "no batch is there yet"
    stopped = SceneError(
        f"{name}: {error} ({before}; --faults skip passes such a batch over, --faults redraw draws "
        "it again)"
    )
    stopped.batches = tuple(made)
    return stopped


def _build(
    spec: Spec, drawn: tuple[int, int, int], keep: Keep, log: BuildLog, memo: Memo | None
) -> Scene:
    """The scene of one batch; ``drawn``: seed, batch, attempt."""
    with log.timed("draw"):
        plans = [draw(spec, *drawn)]
    with memoizing(memo):
        # Handed over, so that it can let go of what it has built.
        return build(plans.pop(), log, keep)


def _emit(folder: Path, scene: Scene, log: BuildLog, batch: int, attempt: int) -> None:
    """Writes a batch and its report."""
    folder.mkdir()
    with log.timed("emit"):
        _write(folder, scene)
    log.facts["bytes"] = sum((folder / path).stat().st_size for path in tree(folder))
    drawn = {"batch": batch} | ({"attempt": attempt} if attempt else {})
    write_json(folder / REPORT, {**drawn, **log.facts})
    if log.record is not None:
        write_left_out(folder, log.record)


def _teller(
    step: Callable[[int, int, str], None] | None, done: int, total: int, batch: str
) -> Callable[[str], None] | None:
    return None if step is None else lambda text: step(done, total, f"{batch}: {text}")


def _write(folder: Path, scene: Scene) -> None:
    try:
        write_batch(folder, scene)
    except Tf.ErrorException as error:
        # A full disk reaches us as USD's own exception.
        text = next((e.commentary for e in error.args), "USD gives no reason").splitlines()[0]
        raise OutputError(f"{folder}: cannot be written: {text}") from error


def _strays(folder: Path, scene: Scene) -> list[str]:
    """A line about frames and scans that are none of this scene's, if there are any."""

    def firing(sensors: Callable[[Rig], Iterable[Sensor | Lidar]]) -> Firing:
        named = [(f"{rig.name}_{s.name}", s.trigger) for rig in scene.rigs for s in sensors(rig)]
        return [
            [(name, i >= first and (i - first) % every == 0) for name, (every, first) in named]
            for i in range(scene.samples)
        ]

    found = list(strays(folder, firing(lambda rig: rig.sensors)))
    found += stray_scans(folder, firing(lambda rig: rig.lidars))
    return [told(found)] if found else []


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
