"""Datasets that the exact caster makes of stages: what their exports have in common.

The files of a batch are made beside the dataset, with a record of each batch, and replace the
dataset at the end. What an export that was cut short has made is not made again.
"""

from __future__ import annotations

import hashlib
import os
import shutil
from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, ClassVar, Self

from scenec.api.models import ModelsReport, dataset_folder
from scenec.api.options import ExportOptions
from scenec.api.steps import hire
from scenec.backends.run.units import Opening
from scenec.datasets.export_records import EXPORT
from scenec.datasets.models.verify import ModelsRecord
from scenec.schemas.codec import JsonObject, encode, read_record
from scenec.schemas.errors import OutputError
from scenec.schemas.files import as_json, check_writable, read_json, sha256, sweep, write_json
from scenec.schemas.lock import LOCK, Lock
from scenec.schemas.manifest import LEFT_OUT, Batch
from scenec.schemas.passes import ANNOTATION
from scenec.schemas.point_tracks import TrackFacts, TrackOptions
from scenec.schemas.site_map import MapOptions, SiteFacts
from scenec.schemas.spelling import nearest
from scenec.schemas.units import Executor, Unit, run_all
from scenec.schemas.update import finish_update, reading, replace_files
from scenec.schemas.versions import version_of

_PRUNED = (
    "objects and ground that no camera sees the effect of are not in the stage, or are coarse; "
    "scenec compile --keep all keeps them"
)


@dataclass
class StageExport[Facts: (SiteFacts, TrackFacts)](ABC):
    """One export of stages to one format.

    Attributes:
        out: Output folder of a compile, or a USD file.
        batches: Of it.
        asked: What is asked of the format.
        folder: Of the dataset.
        partial: Beside it, for what is not finished.
        options: Of the call.
        executor: Who does the work.
    """

    #: Name; what its files are, in messages; changes whenever the same stage would give others.
    format: ClassVar[str]
    files: ClassVar[str]
    version: ClassVar[int]

    out: Path
    batches: Sequence[Batch]
    asked: MapOptions | TrackOptions
    folder: Path
    partial: Path
    options: ExportOptions
    executor: Executor

    @classmethod
    def export(
        cls,
        out: Path,
        batches: Sequence[Batch],
        asked: MapOptions | TrackOptions,
        options: ExportOptions,
    ) -> ModelsReport:
        """Writes a folder a batch, and ``export.json`` about them.

        Args:
            out: Output folder of a compile, or a USD file.
            batches: Of it.
            asked: What is asked of the format.
            options: Of the call.

        Raises:
            StageError: A stage cannot be read.
            OutputError: The folder holds another dataset, or cannot be written.
        """
        folder = dataset_folder(out, cls.format, options)
        finish_update(folder)
        check_writable(folder.parent)
        partial = folder.with_name(f".{folder.name}.partial")
        try:
            (partial / "data").mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise OutputError(f"{partial}: cannot be written: {error.strerror or error}") from error
        work = replace(options, workers=options.workers or 0)
        with reading(out), Lock(partial / LOCK, what=folder), hire(work) as executor:
            return cls(out, batches, asked, folder, partial, options, executor)._run()

    def _run(self: Self) -> ModelsReport:
        """Makes what is missing."""
        self.executor.prepare(self.partial)
        old = self._written()
        if old is not None and old["key"] == self.key:
            self.options.listener.say(
                f"the {self.files} are there already, made of the same stages"
            )
            shutil.rmtree(self.partial, ignore_errors=True)
            return self._report(old)
        if any((batch.folder / LEFT_OUT).is_file() for batch in self.batches):
            self.options.listener.warn(_PRUNED)
        made = {batch.name: self._batch(batch) for batch in self.batches}
        content = {
            "format": self.format,
            "scenec": version_of(),
            "key": self.key,
            "options": encode(self.asked),
            "batches": {name: one["batch"] for name, one in made.items()},
            "files": {path: of for one in made.values() for path, of in one["files"].items()},
        }
        data = self.partial / "data"
        sweep([data])
        write_json(data / EXPORT, content)
        gone = set() if old is None else set(old["files"]) - set(content["files"])
        self.folder.parent.mkdir(parents=True, exist_ok=True)
        replace_files(data, self.folder, sorted(p for p in gone if (self.folder / p).is_file()))
        shutil.rmtree(self.partial, ignore_errors=True)
        return self._report(content)

    def _report(self, content: dict[str, Any]) -> ModelsReport:
        files = tuple(self.folder / path for path in content["files"])
        return ModelsReport(self.folder, self.format, files, content)

    @cached_property
    def facts(self) -> dict[str, Facts]:
        """What there is in each batch's stage, by its name; has a ``digest``."""
        units = [self.describe(batch) for batch in self.batches]
        found = (facts for _, facts in self.done(units, in_order=True))
        return {batch.name: facts for batch, facts in zip(self.batches, found, strict=True)}

    @cached_property
    def key(self) -> str:
        """Digest of all that the files depend on."""
        return self._digest(self.batches)

    def _digest(self, batches: Sequence[Batch]) -> str:
        stages = [[batch.name, self.identity(batch)] for batch in batches]
        known = [version_of(), self.version, encode(self.asked), stages]
        return hashlib.sha256(as_json(known).encode()).hexdigest()

    def done(self, units: Sequence[Unit], in_order: bool = False) -> Iterator[tuple[Any, Any]]:
        """Has units done; yields each with its result, in their order if that is asked for."""
        with closing(run_all(self.executor, units, in_order=in_order)) as ended:
            for unit, outcome in ended:
                for line in outcome.warnings:
                    self.options.listener.warn(line)
                yield unit, outcome.result()

    def _batch(self, batch: Batch) -> dict[str, Any]:
        """Makes a batch's files, unless an earlier export has; returns what is said of them."""
        key = self._digest([batch])
        record = self.partial / f"{batch.name}.json"
        if record.is_file():
            found: dict[str, Any] = read_json(record, OutputError, "record of an export")
            if found.get("key") == key:
                return found
        folder = self.partial / "data" / batch.name
        # What a killed process left half written goes.
        shutil.rmtree(folder, ignore_errors=True)
        folder.mkdir(parents=True)
        tiles = self.partial / "tiles" / key[:16]
        said, names = self.make(batch, folder, tiles)
        written = {
            f"{batch.name}/{name}": {
                "bytes": (folder / name).stat().st_size,
                "sha256": sha256(folder / name),
            }
            for name in names
        }
        if (batch.folder / LEFT_OUT).is_file():
            said["losses"].append(_PRUNED)
        entry = {"key": key, "batch": said, "files": written}
        write_json(record, entry)
        shutil.rmtree(tiles, ignore_errors=True)
        return entry

    @abstractmethod
    def describe(self, batch: Batch) -> Unit:
        """What finds out what there is in a stage."""

    def identity(self, batch: Batch) -> str:
        """Digest of all that the files of a batch depend on, but for what is asked."""
        return self.facts[batch.name].digest

    @abstractmethod
    def make(self, batch: Batch, folder: Path, tiles: Path) -> tuple[JsonObject, list[str]]:
        """Makes the files of a batch.

        Args:
            batch: The batch.
            folder: Where.
            tiles: A folder for parts that are kept if the export is cut short.

        Returns:
            What ``export.json`` says of the batch, ``losses`` in it, and the names of the files.
        """

    def _written(self) -> dict[str, Any] | None:
        """What ``export.json`` says of what is there; None where the folder is free.

        Raises:
            OutputError: Something else is there, and is not to be replaced.
        """
        folder = self.folder
        if not folder.exists() or (folder.is_dir() and not any(folder.iterdir())):
            return None
        path = folder / EXPORT
        found = read_json(path, OutputError, "export.json") if path.is_file() else None
        if not isinstance(found, dict) or found.get("format") != self.format:
            raise OutputError(
                f"{folder}: is not empty and holds no {self.files} of scenec; choose another "
                "folder with -o"
            )
        read_record(path, ModelsRecord, OutputError, f"{EXPORT} of scenec")
        if found.get("key") != self.key and not self.options.replace:
            raise OutputError(
                f"{folder}: holds other {self.files} (of other stages, or made in another way); "
                "choose another folder with -o, or give --replace"
            )
        return found


def opening(batch: Batch) -> Opening:
    """The stage of a batch, for what needs no renderer."""
    return Opening(os.path.abspath(batch.stage), ANNOTATION, "auto", ())


def parsed(settings: Sequence[str], known: Sequence[str]) -> dict[str, tuple[str, str]]:
    """Settings by name: the value, and the text it stands in.

    Args:
        settings: As ``--set`` has them.
        known: Names that there are.

    Raises:
        OutputError: A name is unknown.
    """
    given = {}
    for text in settings:
        name, equals, value = (part.strip() for part in text.partition("="))
        if not equals or name not in known:
            raise OutputError(
                f"--set {text!r}: expected NAME=VALUE of {', '.join(known)}{nearest(name, known)}"
            )
        given[name] = value, text
    return given
