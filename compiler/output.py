"""Keeps the output folder of a compilation: what is in it, and how batches come into it.

A batch comes in as one update (``schemas.update``) of its files, the cfg and the manifest: whenever
a compilation ends, the manifest is true of what lies beside it. Only what an earlier manifest lists
is ever replaced or removed, and with ``replace`` frames and scans of stages that go.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Callable, Collection, Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

from scenec.compiler.cfg import licenses
from scenec.compiler.cfg.load import Spec, digest_of
from scenec.compiler.cfg.resources import PREFIX
from scenec.compiler.views.needed import Keep
from scenec.schemas.codec import UNSET, encode
from scenec.schemas.errors import OutputError
from scenec.schemas.files import (
    as_json,
    check_writable,
    sha256,
    sweep,
    temporary_folder,
    tree,
    write_json,
)
from scenec.schemas.georeference import Georeference
from scenec.schemas.lock import LOCK, Lock
from scenec.schemas.manifest import (
    CFG,
    CFG_FOLDER,
    FRAMES,
    LEFT_OUT,
    MANIFEST,
    MANIFEST_FORMAT,
    REPORT,
    STAGE,
    TIMINGS,
    BatchEntry,
    CfgEntry,
    FailedBatch,
    FileEntry,
    Manifest,
    read_manifest,
    stage_digest,
)
from scenec.schemas.materialx import LAYER_SUFFIX
from scenec.schemas.scans import SCANS
from scenec.schemas.strays import count_rendered, rendered_files
from scenec.schemas.update import finish_locked_update, replace_files
from scenec.schemas.versions import version_of

#: Whose version can change the bytes of the output.
_LIBRARIES = ("numpy", "numba", "scipy", "usd-core", "openexr")


@contextmanager
def locked(out: Path) -> Iterator[None]:
    """Takes an output folder for a compilation, and mends what a killed one left there.

    The folder is made if it is not there, and goes again if it is empty in the end.

    Raises:
        BusyError: Another command is at work on it.
        OutputError: It cannot be written.
    """
    made = [path for path in (out, *out.parents) if not path.exists()]
    check_writable(out)
    try:
        with ExitStack() as stack:
            try:
                out.mkdir(parents=True, exist_ok=True)
            except OSError as error:
                raise OutputError(f"{out}: cannot be written: {error.strerror}") from error
            stack.enter_context(Lock(out / LOCK))
            finish_locked_update(out)
            sweep([out])
            yield
    finally:
        for path in made:
            with suppress(OSError):
                path.rmdir()


def batch_name(batch: int) -> str:
    """Name of a batch's folder."""
    return f"batch_{batch:04d}"


class Output:
    """An output folder that this process has ``locked``, and its manifest.

    Args:
        spec, seed, keep: What is compiled into it.
        chosen: The batches that are compiled now.
        may_replace: Whether what was compiled from something else may go.
        say: Called with a line about what goes.

    Raises:
        OutputError: The folder holds something else.
    """

    def __init__(
        self,
        out: Path,
        spec: Spec,
        seed: int,
        keep: Keep,
        chosen: Collection[int],
        may_replace: bool,
        say: Callable[[str], None],
    ) -> None:
        self._out = out
        self._cfg = spec.text
        self._cfg_role = "the cfg, " + ("as it was given" if spec.is_verbatim else "in one piece")
        self._replace = may_replace
        self._origin = _origin(spec, out)
        head = _head(spec, seed, keep)
        old = _old_manifest(out)
        #: What the compiler has written here: all else is not ours.
        self._ours = set(old.files)
        #: Files of batches that go with the first batch that comes.
        self._dropped: set[str] = set()
        self._stale = False
        if not old.batches and not old.failed:
            self._manifest = replace(head, files=old.files)
            return
        other = _difference(old, head)
        count = int(spec.cfg["batches"])
        kept = () if other else tuple(b for b in old.batches if b.index < count)
        gone = [b for b in old.batches if b not in kept]
        if gone and not may_replace:
            raise OutputError(
                f"{out}: holds {_described(out, gone)}, {other or 'which this cfg has no more'}; "
                "--replace makes them anew and keeps frames of stages that stay the same, or "
                "choose another folder"
            )
        if gone:
            say(
                f"replacing {_described(out, gone)} in {out}; frames of stages that stay the same "
                "are kept"
            )
        paths = {b.path for b in kept}
        self._stale = bool(other)
        files = {p: e for p, e in old.files.items() if p.partition("/")[0] in paths or p == CFG}
        self._dropped = set(old.files) - set(files)
        for batch in gone:
            # Frames of batches that come again are judged when their stage is known.
            if batch.index not in chosen:
                self._dropped |= _names(out, rendered_files(out / batch.path))
        self._manifest = replace(head, batches=kept, files=files)
        self._note_failed(() if other else [f for f in old.failed or () if f.index < count])

    def attempt(self, batch: int) -> int:
        """Returns how often a batch was drawn again when it was compiled to this output before."""
        return next((b.attempt or 0 for b in self._manifest.batches if b.index == batch), 0)

    def put(
        self,
        folder: Path,
        batch: int,
        samples: int,
        attempt: int,
        georeference: Georeference | None = None,
    ) -> bool:
        """Brings a batch in, and lists it in the manifest.

        Args:
            folder: Beside the output's files, with the batch's in its folder of the same name.

        Returns:
            Whether it was there already, byte for byte.

        Raises:
            OutputError: Something cannot be written, or lies where a file goes and is not ours.
        """
        name = batch_name(batch)
        files = {f"{name}/{path.as_posix()}": _entry(folder / name / path, path)
                 for path in tree(folder / name)}  # fmt: skip
        before = {path for path in self._manifest.files if path.startswith(f"{name}/")}
        unchanged = before == set(files)
        for path, entry in files.items():
            if self._holds(path, entry):
                (folder / path).unlink()
            elif path not in self._ours and (self._out / path).exists() and not self._replace:
                raise OutputError(
                    f"{self._out / path}: a file of the stage goes here, and what lies here is "
                    "not the compiler's; move it away, or give --replace"
                )
            else:
                unchanged = False
        made = BatchEntry(
            index=batch,
            path=name,
            stage=f"{name}/{STAGE}",
            samples=samples,
            attempt=attempt or UNSET,
            georeference=georeference or UNSET,
        )
        batches = [made, *(b for b in self._manifest.batches if b.index != batch)]
        others = {path: e for path, e in self._manifest.files.items() if path not in before}
        self._manifest = replace(
            self._manifest,
            batches=tuple(sorted(batches, key=lambda b: b.index)),
            files=others | files,
        )
        self._note_failed([f for f in self._manifest.failed or () if f.index != batch])
        gone = (before | self._dropped) - set(files)
        if self._stale:
            digest = stage_digest(self._manifest, name)
            gone |= _names(self._out, rendered_files(self._out / name, digest))
        self._commit(folder, gone)
        return unchanged

    def _holds(self, path: str, entry: FileEntry) -> bool:
        place = self._out / path
        same = place.is_file() and place.stat().st_size == entry.bytes
        return same and sha256(place) == entry.sha256

    def _commit(self, folder: Path, removed: set[str]) -> None:
        digest = hashlib.sha256(self._cfg).hexdigest()
        entry = FileEntry(what=self._cfg_role, bytes=len(self._cfg), sha256=digest)
        files = {**self._manifest.files, CFG: entry}
        self._manifest = replace(self._manifest, files=dict(sorted(files.items())))
        text = as_json(encode(self._manifest)).encode()
        for path, data in ((CFG, self._cfg), (MANIFEST, text)):
            place = self._out / path
            if not place.is_file() or place.read_bytes() != data:
                (folder / path).write_bytes(data)
        if tree(folder) or removed:
            replace_files(folder, self._out, sorted(removed))
        self._ours = set(self._manifest.files)
        self._dropped = set()

    def _note_failed(self, failed: Collection[FailedBatch]) -> None:
        ordered = tuple(sorted(failed, key=lambda f: f.index))
        self._manifest = replace(self._manifest, failed=ordered or UNSET)

    def fail(self, batch: int, reason: str) -> None:
        """Lists a batch that cannot be built, from the next ``put`` or ``close`` on."""
        others = [f for f in self._manifest.failed or () if f.index != batch]
        entry = FailedBatch(index=batch, path=batch_name(batch), reason=reason)
        self._note_failed([*others, entry])
        if self._stale:
            self._dropped |= _names(self._out, rendered_files(self._out / batch_name(batch)))

    def close(self) -> None:
        """Writes the manifest where batches failed after the last one that came in."""
        with temporary_folder(self._out) as folder:
            self._commit(folder, self._dropped)

    def foreign(self, batch: int) -> list[str]:
        """A line about files in a batch's folder that are not the compiler's, if there are any."""
        name = batch_name(batch)
        found = [
            path
            for path in tree(self._out / name)
            if path.parts[0] not in (FRAMES, SCANS)
            and f"{name}/{path.as_posix()}" not in self._manifest.files
        ]
        more = f" (and {len(found) - 1} more in {name})" if len(found) > 1 else ""
        return [f"{self._out / name / path}{more}: no part of the stage; left as it is"
                for path in found[:1]]  # fmt: skip

    def write_timings(self, seconds: dict[str, dict[str, float]]) -> None:
        """Writes seconds of each pass by batch, beside those of batches of earlier compilations."""
        known = {b.path for b in self._manifest.batches}
        timings: dict[str, Any] = {}
        path = self._out / TIMINGS
        if path.exists():
            try:
                timings = json.loads(path.read_text(encoding="utf-8")).get("compile", {})
                timings = dict(timings)
            except (ValueError, AttributeError, TypeError, RecursionError):
                # Timings promise nothing: a broken file is begun anew.
                timings = {}
        merged = {**{k: v for k, v in timings.items() if k in known}, **seconds}
        write_json(path, {"compile": dict(sorted(merged.items())), **self._origin})


def _head(spec: Spec, seed: int, keep: Keep) -> Manifest:
    """Returns what the manifest says of all batches."""
    alone = {key: value for key, value in spec.cfg.items() if key != "batches"}
    return Manifest(
        format=MANIFEST_FORMAT,
        name=spec.cfg["name"],
        cfg=CfgEntry(
            sha256=spec.digest,
            batch_sha256=digest_of(alone, spec.files, spec.plugins),
            inputs={pointer: file.sha256 for pointer, file in spec.files.items()},
            licenses={pointer: licenses.as_json(file) for pointer, file in spec.files.items()},
            settings=tuple(spec.settings) or UNSET,
        ),
        seed=seed,
        keep=str(keep),
        scenec=version_of(),
        libraries={name: version_of(name) for name in _LIBRARIES},
        plugins=dict(spec.plugins) or UNSET,
        batches=(),
        files={},
    )


def _origin(spec: Spec, out: Path) -> dict[str, str]:
    """Tells where an output's cfg finds the files that it names; not part of the promise."""
    beside = [f for f in spec.files.values() if not f.reference.startswith(PREFIX)]
    if not beside:
        return {}
    relative = os.path.relpath(os.path.realpath(spec.folder), os.path.realpath(out))
    return {CFG_FOLDER: Path(relative).as_posix()}


def held(out: Path, spec: Spec, seed: int, keep: Keep) -> tuple[set[int], str | None]:
    """Returns the batches of which an output has all files, and how its inputs differ.

    Raises:
        OutputError: It is no output.
    """
    old = read_manifest(out)
    lost = {path.partition("/")[0] for path in old.files if not (out / path).is_file()}
    batches = {b.index for b in old.batches if b.path not in lost}
    return batches, _difference(old, _head(spec, seed, keep)) if old.batches else None


def _old_manifest(out: Path) -> Manifest:
    """The manifest that is there; one without batches where there is nothing.

    Raises:
        OutputError: There is something, and it is no output.
    """
    if (out / MANIFEST).exists():
        return read_manifest(out)
    # What begins with a dot is of the file manager, or ours.
    if any(not path.name.startswith(".") for path in out.iterdir()):
        raise OutputError(
            f"{out}: is not empty and holds no scenec output (no {MANIFEST}); choose another folder"
        )
    return Manifest(batches=(), files={})


def _difference(old: Manifest, head: Manifest) -> str | None:
    """In words, what else an output was compiled from; None where its batches are the same.

    The number of batches is no part of it, nor are the terms of what went in.
    """
    for key, then, asked in (
        ("seed", old.seed, head.seed),
        ("keep", old.keep, head.keep),
        ("scenec", old.scenec, head.scenec),
    ):
        if then != asked:
            return f"of {key} {None if then is UNSET else then}, not {asked}"
    if (old.libraries, old.format) != (head.libraries, head.format):
        return "made with other versions of libraries"
    others = old.plugins or {}, head.plugins or {}
    for name in sorted(others[0].keys() & others[1].keys()):
        if others[0][name] != others[1][name]:
            return f"made with {others[0][name]}, not {others[1][name]}"
    was, now = old.cfg or CfgEntry(), head.cfg or CfgEntry()
    same = was.sha256 == now.sha256 or was.batch_sha256 == now.batch_sha256
    return None if same and was.inputs == now.inputs else "of another cfg"


def _described(out: Path, batches: list[BatchEntry]) -> str:
    """Batches in words, with what was rendered of them."""
    frames, scans = count_rendered(out / batch.path for batch in batches)
    first, last = batches[0].path, batches[-1].path
    parts = [first if len(batches) == 1 else f"{len(batches)} batches ({first} to {last})"]
    parts += [f"{n} {what}" for n, what in ((frames, "frames"), (scans, "scans")) if n]
    return " with ".join([parts[0], " and ".join(parts[1:])]) if parts[1:] else parts[0]


def _names(out: Path, paths: Iterator[Path]) -> set[str]:
    return {path.relative_to(out).as_posix() for path in paths}


def _entry(file: Path, path: Path) -> FileEntry:
    return FileEntry(what=_role(path), bytes=file.stat().st_size, sha256=sha256(file))


def _role(path: Path) -> str:
    """Names the role of a batch's file, by its place."""
    folders = {"objects": "object class", "looks": "material", "textures": "texture"}
    if len(path.parts) > 1:
        return folders[path.parts[0]]
    return {
        STAGE: "root layer: open this",
        "terrain.usdc": "terrain",
        f"terrain{LAYER_SUFFIX}": "mix of the ground's materials, for MaterialX",
        "objects.usdc": "object classes",
        "looks.usda": "materials",
        "lights.usdc": "suns, sky and lamps",
        "sky.usdc": "labels of the sky, and haze",
        "cameras.usdc": "rigs, cameras, render products, times of the samples",
        REPORT: "error of every pass, counts, what was left out",
        LEFT_OUT: "why each instance is in the stage or is not",
    }[path.name]
