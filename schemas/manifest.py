"""The manifest of an output folder: what was compiled, and the hash of every file.

``cfg``: ``sha256`` of the cfg in full (defaults filled in, with its files' hashes), ``inputs``
(JSON pointer without its first slash -> sha256 of the file named there) and ``licenses`` (the same
pointers -> ``file`` as the cfg has it, ``license``, ``copyright`` and the ``source`` that says so).
``cfg`` also has ``batch_sha256``, of all of that but the number of batches: what decides each one;
and ``settings``, the words after ``--set``, if there were any. ``files`` holds every file of the
batches and ``cfg.json``: the cfg's own bytes, or where these are no JSON or not all of it, the cfg
with what it extends and its settings, which makes the same stages alone. ``failed`` lists
the batches that could not be built and were passed over, if there are any, each with its
``reason``; a batch has an ``attempt`` where it was drawn again.
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

from scenec.schemas.codec import JSON, UNSET, Natural, Unset, natural, read_record
from scenec.schemas.errors import OutputError, StageError
from scenec.schemas.files import inside
from scenec.schemas.georeference import Georeference
from scenec.schemas.update import finish_update

MANIFEST = "manifest.json"
TIMINGS = "timings.json"
#: The cfg, whole and as JSON; paths in it are relative to the folder that it lay in.
CFG = "cfg.json"
#: Key of ``timings.json``: that folder, relative to the output, where the cfg names files in it.
CFG_FOLDER = "cfg_folder"
#: Endings of a cfg's name.
CFG_SUFFIXES = (".json", ".jsonc", ".yaml", ".yml")
#: Root layer of a batch.
STAGE = "stage.usda"
#: In each batch's folder.
REPORT = "report.json"
#: Why each instance is in the stage or is not (``schemas.left_out``).
LEFT_OUT = "left_out.json"
FRAMES = "frames"
#: Likewise of frames taken to pinholes, which exports make.
RECTIFIED = "rectified"
MANIFEST_FORMAT = 1
#: Endings of a path that is a stage itself.
STAGE_SUFFIXES = (".usda", ".usdc", ".usd", ".usdz")


#: As the cfg's schema has it.
_MOST_SAMPLES = 1_000_000


def _samples(value: Any) -> str | None:
    fine = natural(value) is None and value <= _MOST_SAMPLES
    return None if fine else f"a whole number from 0 to {_MOST_SAMPLES}"


@dataclass(frozen=True, kw_only=True)
class CfgEntry:
    """The cfg that an output was compiled from: see the module."""

    sha256: str | Unset = UNSET
    batch_sha256: str | Unset = UNSET
    inputs: Mapping[str, str] | Unset = UNSET
    licenses: Mapping[str, Mapping[str, JSON]] | Unset = UNSET
    settings: tuple[str, ...] | Unset = UNSET


@dataclass(frozen=True, kw_only=True)
class BatchEntry:
    """A batch: paths of its folder and root layer; ``attempt`` where it was drawn again;
    ``georeference`` where its terrain says on which place of a body it lies.
    """

    index: Natural
    path: str
    stage: str
    samples: Annotated[int, _samples] = 0
    attempt: Natural | Unset = UNSET
    georeference: Georeference | Unset = UNSET


@dataclass(frozen=True, kw_only=True)
class FileEntry:
    """Describes a file, with the size and digest by which it is verified."""

    what: str | Unset = UNSET
    bytes: Natural | Unset = UNSET
    sha256: str


@dataclass(frozen=True, kw_only=True)
class FailedBatch:
    """A batch that could not be built, and why."""

    index: Natural
    path: str
    reason: str


@dataclass(frozen=True, kw_only=True)
class Manifest:
    """The manifest of an output folder: see the module."""

    format: JSON | Unset = UNSET
    name: str | Unset = UNSET
    cfg: CfgEntry | Unset = UNSET
    seed: Natural | Unset = UNSET
    keep: str | Unset = UNSET
    scenec: str | Unset = UNSET
    libraries: Mapping[str, str] | Unset = UNSET
    plugins: Mapping[str, JSON] | Unset = UNSET
    batches: tuple[BatchEntry, ...]
    files: Mapping[str, FileEntry]
    failed: tuple[FailedBatch, ...] | Unset = UNSET


def read_manifest(out: Path) -> Manifest:
    """The manifest of an output folder; what a killed compilation began there is finished first.

    Raises:
        OutputError: There is none, it is none, or it names a path outside of the folder.
    """
    if out.is_file():
        mend = f"; compile it: scenec compile {out} -o OUT" if out.suffix in CFG_SUFFIXES else ""
        raise OutputError(
            f"{out}: is a file; expected the output folder of a compile, or a USD file{mend}"
        )
    finish_update(out)
    path = out / MANIFEST
    try:
        manifest = read_record(path, Manifest, OutputError, "scenec manifest")
    except (FileNotFoundError, NotADirectoryError) as error:
        raise OutputError(f"{out}: holds no {MANIFEST}; compile a cfg into it first") from error
    numbers: dict[int, int] = {}
    for i, batch in enumerate(manifest.batches):
        first = numbers.setdefault(batch.index, i)
        if first != i:
            raise OutputError(
                f"{path}: is no scenec manifest: /batches/{i}/index: {batch.index} is the index "
                f"of /batches/{first} too"
            )
        for key, name in (("path", batch.path), ("stage", batch.stage)):
            inside(out, name, f"{path}: /batches/{i}/{key}")
    return manifest


@dataclass(frozen=True)
class Batch:
    """A stage, and the folder its frames go to (below ``frames/``).

    Attributes:
        index: Of the batch in the cfg; 0 for a stage of its own.
        name: Folder name, or the stage's.
        stage: The root layer.
        folder: Where the batch lies.
    """

    index: int
    name: str
    stage: Path
    folder: Path


def find_batches(out: Path, batches: Collection[int] | None = None) -> list[Batch]:
    """The stages of an output folder, or the one stage of a USD file.

    Raises:
        OutputError: No manifest.
        StageError: A batch that is asked for is not there, or none is asked for.
    """
    if out.suffix.lower() in STAGE_SUFFIXES and not out.is_dir():
        if not out.is_file():
            raise StageError(f"{out}: no such file")
        return [Batch(0, out.stem, out, out.parent)]
    manifest = read_manifest(out)
    found = {
        entry.index: Batch(entry.index, entry.path, out / entry.stage, out / entry.path)
        for entry in manifest.batches
    }
    if batches is not None and len(batches) == 0:
        raise StageError(f"{out}: no batch is asked for")
    missing = [index for index in (found if batches is None else batches) if index not in found]
    if missing or not found:
        there = ", ".join(map(str, found)) or "none"
        wanted = f"batch {missing[0]}" if missing else "a batch"
        why = [f" ({e.reason})" for e in manifest.failed or () if e.index in missing]
        raise StageError(f"{out}: does not hold {wanted}{next(iter(why), '')}; it holds {there}")
    return [found[index] for index in (found if batches is None else sorted(batches))]


def gaps(manifest: Manifest) -> list[str]:
    """A line about each batch that is not there since it could not be built."""
    return [
        f"{entry.path} is not there: it could not be built: {entry.reason}"
        for entry in manifest.failed or ()
    ]


def stage_digest(manifest: Manifest, batch: str) -> str:
    """The digest that frames of a batch carry, as it follows from the manifest alone.

    A stage that the compiler wrote is composed of all the batch's files but its report and the
    record of what was left out.

    Args:
        manifest: As ``read_manifest`` returns it.
        batch: Folder name.
    """
    return digest_of_files(_files_of(manifest, batch).items())


def files_of_stage(stage: Path) -> dict[str, str] | None:
    """Returns the manifest's digests of the files that a stage is composed of.

    Args:
        stage: Root layer.

    Returns:
        Paths relative to the stage's folder -> sha256; None where no manifest lists the stage.
    """
    folder = Path(os.path.abspath(stage)).parent
    try:
        manifest = read_manifest(folder.parent)
    except OutputError:
        # Of no output, or beside a manifest of something else.
        return None
    name = f"{folder.name}/{stage.name}"
    batch = next((b.path for b in manifest.batches if b.stage == name), None)
    return None if batch is None else _files_of(manifest, batch)


def _files_of(manifest: Manifest, batch: str) -> dict[str, str]:
    """Files of a batch's stage, relative to its folder, and their sha256."""
    begin = f"{batch}/"
    inside = {
        path.removeprefix(begin): entry.sha256
        for path, entry in manifest.files.items()
        if path.startswith(begin)
    }
    return {path: sha for path, sha in inside.items() if path not in (REPORT, LEFT_OUT)}


def digest_of_files(files: Iterable[tuple[str, str]]) -> str:
    """sha256 over relative paths and the sha256 of what is in them, whatever their order."""
    lines = sorted(f"{path} {digest}" for path, digest in files)
    return hashlib.sha256("\n".join(lines).encode()).hexdigest()
