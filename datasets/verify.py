"""Is a dataset as it was written, and does it have the same annotation as another one?

What two datasets (or output folders with frames) have in common is decided frame by frame, by the
digests of their annotation: sha256 over all passes but ``rgb``, as they were rendered, so neither
the format nor filters nor remapping matter. Pictures are compared where both are at hand.
"""

from __future__ import annotations

import csv
import hashlib
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenec.datasets.export import CARD, INDEX, STATISTICS
from scenec.datasets.export_records import EXPORT, INDEX_COLUMNS, ExportRecord, read_export
from scenec.datasets.holdings import coco_differences, setting_differences
from scenec.datasets.source import Source
from scenec.datasets.sums import SUMS, read_sums
from scenec.schemas.codec import read_record
from scenec.schemas.csv_cells import unguarded
from scenec.schemas.errors import FrameError, OutputError
from scenec.schemas.files import sha256, tree
from scenec.schemas.manifest import MANIFEST, STAGE_SUFFIXES
from scenec.schemas.native import native_reading
from scenec.schemas.sweep import is_sweep
from scenec.schemas.units import Say
from scenec.schemas.update import finish_update

#: Weight of the mean in relMSE's denominator, as in ``scenec check --backends``.
_EPSILON = 0.01


@dataclass(frozen=True)
class Flaw:
    """Something that is not as it was written.

    Attributes:
        where: File, or frame.
        message: What is wrong.
    """

    where: str
    message: str

    def __str__(self) -> str:
        return f"error: {self.where}: {self.message}"


@dataclass(frozen=True)
class ComparedFrame:
    """A frame, as far as it is compared.

    Attributes:
        annotation: sha256 of its annotation.
        picture: sha256 of its picture's file; "" without one.
        file: The picture's file, where it is at hand.
        instances: How many are told of.
        split: That it is in; "" in an output folder.
    """

    annotation: str
    picture: str
    file: Path | None
    instances: int
    split: str


@dataclass
class Comparison:
    """Two datasets, frame by frame.

    Attributes:
        frames: In both.
        differing: Those whose annotation differs.
        only_first: Frames of the first that the second lacks.
        only_second: Likewise.
        unreadable: Frames that cannot be read, with the reason.
        held: In what the two differ though the frames' annotation is the same: a line for each
            setting, frame or image (``scenec.datasets.holdings``).
        pictures_same: Pictures with the same bytes.
        pictures_differing: Pictures with other bytes.
        mean_difference: Of each of those that were both at hand, mean |difference| of 8-bit values,
            and ...
        relative_mse: ... mean((b - a)^2 / (a^2 + 0.01 mean(a)^2)).
    """

    frames: int = 0
    differing: list[str] = field(default_factory=list)
    only_first: list[str] = field(default_factory=list)
    only_second: list[str] = field(default_factory=list)
    unreadable: list[str] = field(default_factory=list)
    held: list[str] = field(default_factory=list)
    pictures_same: int = 0
    pictures_differing: int = 0
    mean_difference: list[float] = field(default_factory=list)
    relative_mse: list[float] = field(default_factory=list)

    @property
    def same(self) -> bool:
        """Tells whether both hold the same frames, annotation, settings and images."""
        parts = (self.differing, self.only_first, self.only_second, self.unreadable, self.held)
        return self.frames > 0 and not any(parts)


def is_dataset(folder: Path) -> bool:
    """Whether a folder is what ``scenec export`` makes."""
    return (folder / EXPORT).is_file()


def verify(folder: Path) -> list[Flaw]:
    """All that is wrong with a dataset: files against their sums, index and counts.

    Raises:
        OutputError: It is no dataset.
    """
    summary = _summary(folder)
    flaws: list[Flaw] = []
    sums = _sums(folder, flaws)
    for name, digest in sums.items():
        path = folder / name
        if not path.is_file():
            flaws.append(Flaw(name, "is missing"))
        elif sha256(path) != digest:
            flaws.append(Flaw(name, f"was changed: its sha256 is not that of {SUMS}"))
    ours = (EXPORT, INDEX, STATISTICS, CARD)
    flaws.extend(Flaw(SUMS, f"does not list {name}") for name in ours if name not in sums)
    flaws.extend(
        Flaw(path.as_posix(), f"is no part of the dataset: {SUMS} does not list it")
        for path in tree(folder)
        if path.as_posix() not in sums and path.as_posix() != SUMS
    )
    if not any(flaw.where in (EXPORT, INDEX, STATISTICS) for flaw in flaws):
        flaws.extend(_contradictions(folder, summary))
    return flaws


def opened(folder: Path) -> list[Flaw]:
    """Lists the flaws that pycocotools finds in a COCO dataset; empty for another format.

    Raises:
        OutputError: pycocotools is not installed.
    """
    if _summary(folder).format != "coco":
        return []
    # Imported here: pycocotools is needed for this alone.
    from scenec.datasets.evaluate.coco_files import ANNOTATIONS, flaws_of

    flaws: list[Flaw] = []
    for file in sorted((folder / ANNOTATIONS).glob("instances_*.json")):
        name = file.relative_to(folder).as_posix()
        try:
            with native_reading(file):
                flaws.extend(Flaw(name, f"pycocotools: {text}") for text in flaws_of(file))
        except FrameError as error:
            flaws.append(Flaw(name, f"pycocotools would not read it: {error}"))
    return flaws


def compare(first: Path, second: Path, say: Say | None = None) -> Comparison:
    """Two datasets, or output folders with frames, or one of each.

    Args:
        first: A folder, or a USD file that was rendered.
        second: Likewise. Of an output folder the frames are taken that the other side's backend
            made, where it has such.
        say: Called with lines worth showing.

    Raises:
        FrameError: One has no frames.
        OutputError: One is neither.
    """
    say = say or (lambda _line: None)
    backends = [_backend(folder) for folder in (first, second)]
    found = Comparison()
    one = _frames(first, backends[1], found, say)
    two = _frames(second, backends[0], found, say)
    unreadable = {text.partition(":")[0] for text in found.unreadable}
    found.only_first = [name for name in one if name not in two and name not in unreadable]
    found.only_second = [name for name in two if name not in one and name not in unreadable]
    for name in one:
        if name in two:
            found.frames += 1
            if one[name].annotation != two[name].annotation:
                found.differing.append(name)
            found.held += _differences(name, one[name], two[name])
            _compare_pictures(one[name], two[name], found)
    if all(map(is_dataset, (first, second))):
        summaries = [_summary(folder) for folder in (first, second)]
        found.held += setting_differences(*summaries)
        if [one.format for one in summaries] == ["coco", "coco"]:
            kinds = {one.options.get("segmentation", "rle") for one in summaries}
            found.held += coco_differences(first, second, len(kinds) == 1)
    return found


def _differences(name: str, one: ComparedFrame, two: ComparedFrame) -> Iterator[str]:
    """Yields in what two sides differ of a frame."""
    if one.instances != two.instances:
        yield f"{name}: {one.instances:,} against {two.instances:,} instances"
    if one.split and two.split and one.split != two.split:
        yield f"{name}: in the split {one.split} against {two.split}"


def _summary(folder: Path) -> ExportRecord:
    finish_update(folder)
    path = folder / EXPORT
    try:
        return read_export(path)
    except FileNotFoundError as error:
        raise OutputError(f"{folder}: is no dataset of scenec (no {EXPORT})") from error


def _sums(folder: Path, flaws: list[Flaw]) -> dict[str, str]:
    """Name -> sha256, as ``SHA256SUMS`` has them."""
    sums: dict[str, str] = {}
    try:
        for number, name, digest in read_sums(folder):
            if name:
                sums[name] = digest
            else:
                flaws.append(
                    Flaw(f"{SUMS}:{number}", "is no line of sha256sum, or of a file elsewhere")
                )
    except FileNotFoundError:
        flaws.append(Flaw(SUMS, "is missing"))
    except OutputError as error:
        flaws.append(Flaw(SUMS, str(error)))
    return sums


def _index(folder: Path) -> list[dict[str, str]]:
    """Lines of ``frames.csv``.

    Raises:
        OutputError: It is none.
    """
    path = folder / INDEX
    try:
        with path.open(encoding="utf-8", newline="") as file:
            lines = list(csv.DictReader(file, strict=True))
    except (OSError, ValueError, csv.Error) as error:
        raise OutputError(f"{path}: cannot be read: {error}") from error
    if any(line.get(name) is None for line in lines for name in INDEX_COLUMNS):
        raise OutputError(f"{path}: expected the columns {', '.join(INDEX_COLUMNS)} in each line")
    return [{name: unguarded(line[name]) for name in INDEX_COLUMNS} for line in lines]


def _contradictions(folder: Path, summary: ExportRecord) -> Iterator[Flaw]:
    """Yields contradictions between index, summary and statistics."""
    try:
        lines = _index(folder)
        statistics = read_record(folder / STATISTICS, dict[str, Any], OutputError, STATISTICS)
    except (OSError, OutputError) as error:
        yield Flaw(INDEX, str(error))
        return
    for name, count in Counter(line["frame"] for line in lines).items():
        if count > 1:
            yield Flaw(INDEX, f"lists {name} {count} times")
    if len(lines) != summary.frames or statistics.get("frames") != summary.frames:
        yield Flaw(
            EXPORT,
            f"says {summary.frames} frames, {INDEX} lists {len(lines)}, {STATISTICS} counts "
            f"{statistics.get('frames')}",
        )
    counts = dict.fromkeys(summary.splits, 0)
    for line in lines:
        counts[line["split"]] = counts.get(line["split"], 0) + 1
    if counts != summary.splits:
        yield Flaw(EXPORT, f"says {summary.splits} frames in splits, {INDEX} has {counts}")
    split_of: dict[str, str] = {}
    for line in lines:
        if split_of.setdefault(line["batch"], line["split"]) != line["split"]:
            yield Flaw(INDEX, f"has {line['batch']} in more than one split")
            break
    for key, column in (("annotation", "annotation_sha256"), ("pictures", "picture_sha256")):
        state = hashlib.sha256()
        for line in lines:
            state.update(f"{line['frame']} {line[column]}\n".encode())
        if state.hexdigest() != getattr(summary.digest, key):
            yield Flaw(EXPORT, f"its digest of all {key} is not that of {INDEX}")


def _backend(folder: Path) -> str | None:
    """Whose frames a dataset holds; None for an output folder."""
    return str(_summary(folder).backend) if is_dataset(folder) else None


def _frames(
    folder: Path, backend: str | None, comparison: Comparison, say: Say
) -> dict[str, ComparedFrame]:
    """Frames by name, in order."""
    if is_dataset(folder):
        files = {digest: folder / name for name, digest in _sums(folder, []).items()}
        return {
            line["frame"]: ComparedFrame(
                line["annotation_sha256"],
                line["picture_sha256"],
                files.get(line["picture_sha256"]),
                int(line["instances"]) if line["instances"].isdecimal() else 0,
                line["split"],
            )
            for line in _index(folder)
        }
    stage = folder.suffix.lower() in STAGE_SUFFIXES and folder.is_file()
    if not stage and not (folder / MANIFEST).is_file() and not is_sweep(folder):
        raise OutputError(
            f"{folder}: is neither a dataset of scenec (no {EXPORT}) nor an output folder (no "
            f"{MANIFEST})"
        )
    source = Source(folder)
    if backend in source.backends and backend != source.backend:
        source = Source(folder, backend)
    say(f"{folder}: {len(source)} frames of {source.backend}")
    frames: dict[str, ComparedFrame] = {}
    for ref in source.frames:
        try:
            frame = source.load(ref)
        except FrameError as error:
            comparison.unreadable.append(f"{ref.name}: {error}")
            continue
        png = frame.png
        at_hand = png is not None and png.is_file()
        frames[ref.name] = ComparedFrame(
            frame.annotation_digest(),
            frame.picture_digest if at_hand else "",
            png if at_hand else None,
            len(frame.table.get("id", ())),
            "",
        )
    return frames


def _compare_pictures(one: ComparedFrame, two: ComparedFrame, comparison: Comparison) -> None:
    if not one.picture and not two.picture:
        return
    if one.picture == two.picture:
        comparison.pictures_same += 1
        return
    comparison.pictures_differing += 1
    a, b = _pixels(one.file), _pixels(two.file)
    if a is None or b is None or a.shape != b.shape:
        return
    comparison.mean_difference.append(float(np.abs(a - b).mean()))
    floor = _EPSILON * float(a.mean()) ** 2
    denominator = a * a + floor
    comparison.relative_mse.append(
        float(np.mean((b - a) ** 2 / np.where(denominator > 0.0, denominator, 1.0)))
    )


def _pixels(file: Path | None) -> NDArray[np.float64] | None:
    """8-bit values of a picture; None where it cannot be read."""
    from PIL import Image

    if file is None or file.suffix.lower() != ".png":
        return None
    try:
        with Image.open(file) as picture:
            return np.asarray(picture.convert("RGB"), np.float64)
    except (OSError, SyntaxError, ValueError):
        return None
