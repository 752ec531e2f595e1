"""The compiler's main call: cfg and seed in, stages and a manifest out."""

from __future__ import annotations

import hashlib
import json
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from pxr import Tf

from scenec.compiler.build import BuildLog, build
from scenec.compiler.draw import draw
from scenec.compiler.emit.batch import STAGE, write_batch
from scenec.compiler.estimate import needs_of, require_memory, told_time
from scenec.compiler.frontend import licenses
from scenec.compiler.frontend.load import Spec, load
from scenec.compiler.incremental.memo import Memo, memoizing
from scenec.compiler.incremental.store import Store
from scenec.compiler.passes.keep import Keep
from scenec.compiler.rig import Lidar, Rig, Sensor
from scenec.compiler.scene import Scene
from scenec.schemas.errors import OutputError, ScenecError
from scenec.schemas.files import (
    atomic,
    replace_folder,
    same_tree,
    sha256,
    temporary_folder,
    tree,
    write_json,
)
from scenec.schemas.left_out import write_left_out
from scenec.schemas.manifest import (
    CFG,
    FRAMES,
    LEFT_OUT,
    MANIFEST,
    MANIFEST_FORMAT,
    REPORT,
    TIMINGS,
)
from scenec.schemas.materialx import LAYER_SUFFIX
from scenec.schemas.scans import SCANS
from scenec.schemas.strays import Firing, stray_scans, strays, told
from scenec.schemas.versions import version_of

#: Whose version can change the bytes of the output.
_LIBRARIES = ("numpy", "numba", "scipy", "usd-core", "openexr")


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
            one has no place for: nothing replaces them.
        made, taken: Per batch, how often each step was made, or taken from the cache; empty
            without one.
    """

    out: Path
    batches: tuple[int, ...]
    unchanged: int
    seconds: dict[str, dict[str, float]]
    facts: dict[str, dict[str, Any]]
    strays: tuple[str, ...] = ()
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
    cache_max: int | None = None,
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
            the same with it and without. None: all is made.
        cache_max: Bytes that the folder may hold; None: ``$SCENEC_CACHE_MAX``, or 4 GiB.

    Raises:
        CfgError: The cfg has faults; all of them are in the error.
        SceneError: The cfg is valid but what it asks for cannot be built.
        OutputError: The output folder cannot be written, or holds something that is not to be
            replaced.
    """
    say = progress or (lambda _text: None)
    started = time.perf_counter()
    spec = load(Path(cfg))
    load_seconds = time.perf_counter() - started
    out = Path(out)
    chosen = _chosen(spec, batches)
    manifest = _begin_manifest(spec, seed, out, chosen, keep)
    seconds: dict[str, dict[str, float]] = {}
    facts: dict[str, dict[str, Any]] = {}
    store = None if cache is None else Store(Path(cache), cache_max, say)
    made: dict[str, dict[str, int]] = {}
    taken: dict[str, dict[str, int]] = {}
    unchanged = 0
    left_over: list[str] = []
    for done, batch in enumerate(chosen):
        name = f"batch_{batch:04d}"
        needs = needs_of(spec, seed, batch)
        tight = require_memory(needs)
        if tight is not None:
            say(f"warning: {name}: {tight}")
        long = told_time(needs, len(chosen)) if batch == chosen[0] else None
        if long is not None:
            say(long)
        say(f"compiling {name} of {spec.cfg['name']}, seed {seed}")
        log = BuildLog(seconds={"load": load_seconds}, tell=_teller(step, done, len(chosen), name))
        with log.timed("draw"):
            plan = draw(spec, seed, batch)
        memo = None if store is None else Memo(store)
        with memoizing(memo):
            scene = build(plan, log, keep)
        with temporary_folder(out / name) as folder, memoizing(memo):
            with log.timed("emit"):
                _write(folder, scene, out / name)
            log.facts["bytes"] = sum((folder / path).stat().st_size for path in tree(folder))
            write_json(folder / REPORT, {"batch": batch, **log.facts})
            if log.record is not None:
                write_left_out(folder, log.record)
            if (out / name).is_dir() and same_tree(folder, out / name, ignore=(FRAMES, SCANS)):
                unchanged += 1
            else:
                replace_folder(folder, out / name, keep=(FRAMES, SCANS))
        seconds[name], facts[name] = log.seconds, log.facts
        left_over += _strays(out / name, scene)
        if memo is not None:
            made[name], taken[name] = dict(memo.made), dict(memo.taken)
        _add_batch(manifest, out, name, batch, plan.samples)
        # After each batch: what an interrupted run has finished counts, and can be gone on with.
        _write_manifest(manifest, out, seconds, spec.text)
    if store is not None:
        store.tidy()
    return CompileReport(
        out, tuple(chosen), unchanged, seconds, facts, tuple(left_over), made, taken
    )


def _teller(
    step: Callable[[int, int, str], None] | None, done: int, total: int, batch: str
) -> Callable[[str], None] | None:
    return None if step is None else lambda text: step(done, total, f"{batch}: {text}")


def _write(folder: Path, scene: Scene, final: Path) -> None:
    try:
        write_batch(folder, scene)
    except Tf.ErrorException as error:
        # A full disk reaches us as USD's own exception.
        text = next((e.commentary for e in error.args), "USD gives no reason").splitlines()[0]
        raise OutputError(f"{final}: cannot be written: {text}") from error


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


def _begin_manifest(spec: Spec, seed: int, out: Path, chosen: range, keep: Keep) -> dict[str, Any]:
    """A manifest for this cfg and seed; batches of an earlier, equal run are kept.

    Raises:
        OutputError: The folder holds something else, or batches of another cfg or seed that would
            be left over.
    """
    head = {
        "format": MANIFEST_FORMAT,
        "name": spec.cfg["name"],
        "cfg": {
            "sha256": spec.digest,
            "inputs": {pointer: file.sha256 for pointer, file in spec.files.items()},
            "licenses": {pointer: licenses.as_json(file) for pointer, file in spec.files.items()},
        },
        "seed": seed,
        "keep": str(keep),
        "scenec": version_of(),
        "libraries": {name: version_of(name) for name in _LIBRARIES},
    }
    old = _read_manifest(out)
    if old is not None:
        if _essence(old) == _essence(head):
            return {**head, "batches": old["batches"], "files": old["files"]}
        left_over = [b["path"] for b in old["batches"] if b["index"] not in chosen]
        if left_over:
            raise OutputError(
                f"{out}: holds {left_over[0]} of another cfg, seed, keep or version, which would "
                "be left beside the new batches; choose another folder, or delete this one"
            )
        return {**head, "batches": [], "files": {}}
    # What a killed run left behind begins with a dot, and is ours.
    if out.exists() and (
        not out.is_dir() or any(not p.name.startswith(".") for p in out.iterdir())
    ):
        raise OutputError(
            f"{out}: is not empty and holds no scenec output (no {MANIFEST}); choose another folder"
        )
    return {**head, "batches": [], "files": {}}


def _essence(manifest: dict[str, Any]) -> dict[str, Any]:
    """What decides the batches: not what is known of the terms of what went in."""
    keys = ("format", "name", "seed", "keep", "scenec", "libraries")
    cfg = manifest.get("cfg")
    inputs = (cfg.get("sha256"), cfg.get("inputs")) if isinstance(cfg, dict) else None
    return {"cfg": inputs, **{key: manifest.get(key) for key in keys}}


def _read_manifest(out: Path) -> dict[str, Any] | None:
    path = out / MANIFEST
    if not path.exists():
        return None
    try:
        manifest = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise OutputError(f"{path}: is no manifest: {error}") from error
    if not isinstance(manifest, dict) or not isinstance(manifest.get("batches"), list):
        raise OutputError(f"{path}: is no scenec manifest; choose another folder")
    return manifest


def _add_batch(manifest: dict[str, Any], out: Path, name: str, index: int, samples: int) -> None:
    manifest["batches"] = sorted(
        [b for b in manifest["batches"] if b["index"] != index]
        + [{"index": index, "path": name, "stage": f"{name}/{STAGE}", "samples": samples}],
        key=lambda b: b["index"],
    )
    files = {
        path: entry for path, entry in manifest["files"].items() if not path.startswith(f"{name}/")
    }
    for path in tree(out / name):
        if path.parts[0] in (FRAMES, SCANS):
            continue
        file = out / name / path
        files[f"{name}/{path.as_posix()}"] = {
            "what": _role(path),
            "bytes": file.stat().st_size,
            "sha256": sha256(file),
        }
    manifest["files"] = dict(sorted(files.items()))


def _role(path: Path) -> str:
    """What a file of a batch is, by its place in it."""
    folders = {"objects": "object class", "looks": "material", "textures": "texture"}
    if len(path.parts) > 1:
        return folders[path.parts[0]]
    return {
        STAGE: "root layer: open this",
        "terrain.usdc": "terrain",
        f"terrain{LAYER_SUFFIX}": "mix of the ground's materials, for MaterialX",
        "lights.usda": "suns, sky and lamps",
        "cameras.usda": "rigs, cameras, render products",
        REPORT: "error of every pass, counts, what was left out",
        LEFT_OUT: "why each instance is in the stage or is not",
    }[path.name]


def _write_manifest(
    manifest: dict[str, Any], out: Path, seconds: dict[str, dict[str, float]], cfg: bytes
) -> None:
    with atomic(out / CFG) as temporary:
        temporary.write_bytes(cfg)
    manifest["files"][CFG] = {
        "what": "the cfg, as it was given",
        "bytes": len(cfg),
        "sha256": hashlib.sha256(cfg).hexdigest(),
    }
    manifest["files"] = dict(sorted(manifest["files"].items()))
    known = {b["path"] for b in manifest["batches"]}
    timings: dict[str, Any] = {}
    path = out / TIMINGS
    if path.exists():
        try:
            timings = json.loads(path.read_text(encoding="utf-8")).get("compile", {})
            timings = dict(timings)
        except (ValueError, AttributeError, TypeError):
            # Timings promise nothing: a broken file is begun anew.
            timings = {}
    merged = {**{k: v for k, v in timings.items() if k in known}, **seconds}
    write_json(path, {"compile": dict(sorted(merged.items()))})
    write_json(out / MANIFEST, manifest)
