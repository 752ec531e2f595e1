"""Finds the batches of an output folder, of a USD file, or of all points of a sweep."""

from __future__ import annotations

from collections.abc import Collection, Iterable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from scenec.schemas.codec import JSON, UNSET, Facts, encode
from scenec.schemas.errors import StageError
from scenec.schemas.georeference import Georeference
from scenec.schemas.manifest import (
    MANIFEST,
    STAGE_SUFFIXES,
    Batch,
    BatchEntry,
    Manifest,
    find_batches,
    read_manifest,
    stage_digest,
)
from scenec.schemas.sweep import SweepEntry, is_sweep, read_sweep


@dataclass(frozen=True)
class DatasetPoint:
    """Locates a point of a sweep in its dataset.

    Attributes:
        name: ``point_0003``; the names of its batches begin with it.
        entry: As the sweep lists it.
        out: Its output folder.
        manifest: Of that; None where it was not made.
    """

    name: str
    entry: SweepEntry
    out: Path
    manifest: Manifest | None

    @property
    def settings(self) -> dict[str, JSON]:
        """Returns its columns in tables: name, folder, seed, and the value at each path set."""
        entry = self.entry
        own: dict[str, JSON] = {"point": self.name, "folder": entry.folder, "seed": entry.seed}
        return {**own, **entry.settings, **own}


class Outputs:
    """Finds the batches of an output folder or a USD file; ``SweptOutputs`` those of a sweep.

    Args:
        out: The folder or file.

    Attributes:
        out: As given.
        name: As the cfg has it, or the file's.
        manifest: Of the output; None beside a USD file, and of a sweep.
        points: Of the sweep; none of others.
        mend: What to do where there are no frames.

    Raises:
        OutputError: No manifest.
    """

    def __init__(self, out: Path) -> None:
        is_stage = out.suffix.lower() in STAGE_SUFFIXES and not out.is_dir()
        self.out = out
        self.manifest = None if is_stage else read_manifest(out)
        self.points: tuple[DatasetPoint, ...] = ()
        named = self.manifest is not None and (self.manifest.name or out.name)
        self.name = str(named or out.stem)
        self.mend = f"render first: scenec render {out}"

    @property
    def folders(self) -> tuple[Path, ...]:
        """Returns the output folders, or the file."""
        return (self.out,)

    def find(self, batches: Collection[int] | None = None) -> list[Batch]:
        """Lists batches, all or those of some numbers.

        Raises:
            StageError: One that is asked for is not there.
        """
        return find_batches(self.out, batches)

    def lengths(self) -> dict[int, int]:
        """Returns the samples of each batch, by the manifest."""
        batches = () if self.manifest is None else self.manifest.batches
        return {entry.index: entry.samples for entry in batches}

    def digests(self, batches: Iterable[Batch]) -> dict[str, str]:
        """Returns the digests that frames carry by their batch's name; none without a manifest."""
        manifest = self.manifest
        if manifest is None:
            return {}
        return {batch.name: stage_digest(manifest, batch.name) for batch in batches}

    def georeferences(self) -> dict[int, Georeference]:
        """Returns where on a body each batch lies that says so."""
        batches = () if self.manifest is None else self.manifest.batches
        return {entry.index: entry.georeference for entry in batches if entry.georeference}

    def origin(self) -> Facts:
        """Returns what ``export.json`` says of the frames' origin, as the manifest has it."""
        manifest = self.manifest
        if manifest is None:
            return {"stage": self.out.name}
        shown = replace(manifest, format=UNSET, keep=UNSET, failed=UNSET, batches=(), files={})
        origin: dict[str, Any] = encode(shown) | {"batches": len(manifest.batches)}
        del origin["files"]
        return origin

    def twins(self) -> dict[int, int]:
        """Returns the first batch with the same terrain, of those that are not the first.

        Points of one seed share it, unless what is set changes it: they count as if they did.
        """
        return {}

    def settings(self, _batch: Batch) -> dict[str, JSON]:
        """Returns the settings of the point that a batch is of; nothing but in a sweep."""
        return {}


class SweptOutputs(Outputs):
    """Finds the batches of all points of a sweep, under names and numbers of their own.

    Batch 2 of point 3 is ``point_0003_batch_0002``, its number 3 * n + 2, where n is the most
    batches that a point has; a point that is made later does not change those of others.
    """

    def __init__(self, out: Path) -> None:
        listed = read_sweep(out)
        self.out, self.name, self.manifest = out, listed.name, None
        self.mend = "render its points first: scenec sweep without --compile-only"
        self.points = tuple(
            DatasetPoint(f"point_{number:04d}", entry, out / entry.folder, _made(out, entry))
            for number, entry in enumerate(listed.points)
        )
        stride = 1
        for point in self.points:
            if manifest := point.manifest:
                numbers = [one.index for one in manifest.batches]
                numbers += [one.index for one in manifest.failed or ()]
                stride = max([stride, *(number + 1 for number in numbers)])
        self._point: dict[int, DatasetPoint] = {}
        self._own: dict[int, Batch] = {}
        self._entry: dict[int, BatchEntry] = {}
        for number, point in enumerate(self.points):
            first = number * stride
            for entry in () if point.manifest is None else point.manifest.batches:
                place = first + entry.index
                stage, folder = point.out / entry.stage, point.out / entry.path
                self._own[place] = Batch(entry.index, entry.path, stage, folder)
                self._point[place], self._entry[place] = point, entry
        self._batches = {
            number: replace(batch, index=number, name=f"{self._point[number].name}_{batch.name}")
            for number, batch in self._own.items()
        }

    @property
    def folders(self) -> tuple[Path, ...]:
        """Returns the output folders of points that were made."""
        return tuple(point.out for point in self.points if point.manifest is not None)

    def find(self, batches: Collection[int] | None = None) -> list[Batch]:
        """Lists batches by their numbers in the sweep.

        Raises:
            StageError: One that is asked for is not there.
        """
        there = self._batches
        numbers = sorted(there if batches is None else batches)
        lacking = [number for number in numbers if number not in there]
        if lacking or not numbers:
            wanted = f"batch {lacking[0]}" if lacking else "a batch"
            held = ", ".join(map(str, there)) or "none"
            raise StageError(f"{self.out}: the sweep does not hold {wanted}; it holds {held}")
        return [there[number] for number in numbers]

    def lengths(self) -> dict[int, int]:
        """Returns the samples of each batch, by its point's manifest."""
        return {number: entry.samples for number, entry in self._entry.items()}

    def digests(self, batches: Iterable[Batch]) -> dict[str, str]:
        """Returns the digests that frames carry, by the names that batches have in the sweep."""
        found = {}
        for batch in batches:
            manifest = self._point[batch.index].manifest
            assert manifest is not None
            found[batch.name] = stage_digest(manifest, self._own[batch.index].name)
        return found

    def georeferences(self) -> dict[int, Georeference]:
        """Returns where on a body each batch lies that says so."""
        entries = self._entry.items()
        return {number: one.georeference for number, one in entries if one.georeference}

    def twins(self) -> dict[int, int]:
        """Returns the first batch of the same seed and number, of those that are not the first."""
        first: dict[tuple[int, int], int] = {}
        return {
            number: first.setdefault((self._point[number].entry.seed, batch.index), number)
            for number, batch in sorted(self._own.items())
        }

    def settings(self, batch: Batch) -> dict[str, JSON]:
        """Returns the settings of the point that a batch is of."""
        return self._point[batch.index].settings

    def origin(self) -> Facts:
        """Returns what ``export.json`` says of the origin: points, and the inputs of all."""
        inputs: dict[str, Any] = {}
        licenses: dict[str, Any] = {}
        for point in self.points:
            cfg = {} if point.manifest is None else encode(point.manifest).get("cfg", {})
            for pointer, digest in cfg.get("inputs", {}).items():
                # Of points with other files at the same place, each has its own line.
                same = inputs.get(pointer, digest) == digest
                key = pointer if same else f"{pointer} ({point.name})"
                inputs[key] = digest
                if pointer in cfg.get("licenses", {}):
                    licenses[key] = cfg["licenses"][pointer]
        cfg = {name: held for name, held in (("inputs", inputs), ("licenses", licenses)) if held}
        points = [{**point.settings, "cfg_sha256": point.entry.cfg_sha256} for point in self.points]
        return {"name": self.name, "sweep": points, **({"cfg": cfg} if cfg else {})}


def _made(out: Path, entry: SweepEntry) -> Manifest | None:
    """The manifest of a point; None where it was not made."""
    folder = out / entry.folder
    return read_manifest(folder) if (folder / MANIFEST).is_file() else None


def find_outputs(out: Path) -> Outputs:
    """Finds what there is: a sweep, an output folder, or a USD file.

    Raises:
        OutputError: It is none of these.
    """
    return SweptOutputs(out) if is_sweep(out) else Outputs(out)
