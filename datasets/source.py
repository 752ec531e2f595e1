"""Lists the frames of an output folder, in a fixed order, and their faults.

A frame is *missing* where the manifest or its fellows say that it should be there, *foreign* where
it was made from another stage than the one that lies beside it, or with other labels than the rest,
*damaged* where it cannot be read. Each is named; nothing of the kind is taken silently. *Stray* is
what an earlier stage left at a sample that the camera has no frame at any more: no part of the
output, named and passed over.
"""

from __future__ import annotations

import hashlib
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenec.datasets.outputs import find_outputs
from scenec.schemas import rle
from scenec.schemas.amodal import Amodal, amodal_path, read_amodal
from scenec.schemas.codec import JSON, Facts, encode
from scenec.schemas.consistency import frame_faults, table_faults
from scenec.schemas.errors import ForeignFrameError, FrameError
from scenec.schemas.files import sha256
from scenec.schemas.frames import Frame, frame_stem, read_frame
from scenec.schemas.instances import (
    AMODAL_COLUMNS,
    FRAME_COLUMNS,
    frame_table_path,
    read_frame_table,
)
from scenec.schemas.lens import Lens
from scenec.schemas.manifest import FRAMES, RECTIFIED, Batch
from scenec.schemas.passes import ANNOTATION, ANNOTATION_NAMES
from scenec.schemas.records import FileDigest, FrameRecord
from scenec.schemas.sidecars import lens_of, read_sidecar
from scenec.schemas.spelling import nearest


@dataclass(frozen=True, slots=True)
class FrameRef:
    """Identifies a frame.

    Attributes:
        index: Its number among all frames that the output has a place for, from 0: batch by batch,
            camera by camera, sample by sample. What is missing or not asked for leaves a gap.
        batch: Number of its batch.
        batch_name: Folder name of its batch.
        backend: Who rendered it.
        camera: Name of the camera.
        sample: Time code.
        stem: Its path without a suffix.
        settings: Of its point, in a sweep (``outputs.DatasetPoint.settings``); of others none.
    """

    index: int
    batch: int
    batch_name: str
    backend: str
    camera: str
    sample: int
    stem: Path
    settings: Mapping[str, JSON] = field(default_factory=dict, compare=False)

    @property
    def name(self) -> str:
        """Returns the frame's name in messages and indices."""
        return f"{self.batch_name}/{self.camera}/{self.sample:06d}"

    @property
    def key(self) -> str:
        """The same as a file name without folders."""
        return f"{self.batch_name}_{self.camera}_{self.sample:06d}"

    def at(self, base: Path) -> FrameRef:
        """The same, for a process whose working directory is not ``base``."""
        return replace(self, stem=base / self.stem)


@dataclass(frozen=True)
class FrameFault:
    """A frame that cannot be taken.

    Attributes:
        name: ``FrameRef.name``.
        kind: ``missing``, ``foreign``, ``damaged`` or ``stray``.
        message: What is wrong, with the file.
    """

    name: str
    kind: str
    message: str


@dataclass
class LoadedFrame:
    """A frame in memory, as exporters take it.

    Attributes:
        ref: Where it was.
        passes: Arrays by pass name, see ``scenec.schemas.exr``.
        sidecar: What its sidecar holds.
        table: Columns of its table of instances (``scenec.schemas.instances``), one line each;
            ``{}`` where the frame has no pass ``instance``.
        labels: Level -> id -> name, without 0; after remapping, the new ones.
        ignored: One a line of ``table``: whether it failed a filter that keeps it as ignored.
    """

    ref: FrameRef
    passes: dict[str, NDArray[Any]]
    sidecar: FrameRecord
    table: dict[str, NDArray[Any]]
    labels: dict[str, dict[int, str]]
    ignored: NDArray[np.bool_] = field(default_factory=lambda: np.zeros(0, np.bool_))

    @property
    def width(self) -> int:
        """Columns of pixels."""
        return self.sidecar.resolution[0]

    @property
    def height(self) -> int:
        """Rows of pixels."""
        return self.sidecar.resolution[1]

    @property
    def intrinsics(self) -> NDArray[np.float64]:
        """K, float64 [3, 3], pixels."""
        return np.array(self.sidecar.intrinsics, np.float64)

    @property
    def lens(self) -> Lens | None:
        """Returns the lens that bends the intrinsics' plane to pixels; None: a pinhole."""
        return lens_of(self.sidecar.lens)

    @property
    def optics(self) -> Facts:
        """``lens`` and ``shutter`` as the sidecar has them, of cameras that have such."""
        held = {"lens": self.sidecar.lens, "shutter": self.sidecar.shutter}
        return {name: encode(one) for name, one in held.items() if one is not None}

    @property
    def point(self) -> Facts:
        """``settings`` with those of its point, of frames of a sweep."""
        return {"settings": dict(self.ref.settings)} if self.ref.settings else {}

    @property
    def rolls(self) -> bool:
        """Whether rows of the picture have poses of their own (the frame's is the middle's)."""
        shutter, middle = self.sidecar.shutter, self.sidecar.camera_to_world
        return (
            shutter is not None
            and shutter.readout_s != 0.0
            and any(pose != middle for pose in shutter.camera_to_world)
        )

    @property
    def camera_to_world(self) -> NDArray[np.float64]:
        """Pose, float64 [4, 4], camera axes as OpenCV has them."""
        return np.array(self.sidecar.camera_to_world, np.float64)

    @property
    def time_s(self) -> float:
        """Returns seconds by the stage; the sample's number where it has no times.

        They count from the batch's start, or by a track's clock: from an epoch of its own.
        """
        time = self.sidecar.time_s
        return float(self.ref.sample if time is None else time)

    @property
    def png(self) -> Path | None:
        """The picture on disk; None without ``rgb``."""
        path = self.ref.stem.with_suffix(".png")
        return path if self.sidecar.png else None

    @cached_property
    def picture_digest(self) -> str:
        """sha256 of the picture on disk; empty without ``rgb``."""
        return "" if self.png is None else sha256(self.png)

    @property
    def amodal(self) -> Amodal | None:
        """Its amodal masks, read when asked for; None where it was rendered without.

        Raises:
            FrameError: They cannot be read.
        """
        return read_amodal(self.ref.stem) if self.sidecar.amodal is not None else None

    def annotation_digest(self) -> str:
        """sha256 over all passes but ``rgb``, in order of names: a line of text, then the pixels.

        The line is name, type and shape. Of floats the bytes follow; of ids those of
        ``rle.row_runs``, since hashing is slow and ids lie in runs: values, then lengths.
        Annotation is exact, so this is the same on every machine and for every backend.
        """
        state = hashlib.sha256()
        for name in sorted(self.passes):
            if name != "rgb":
                array = self.passes[name]
                state.update(f"{name} {array.dtype.str} {array.shape}\n".encode())
                parts = rle.row_runs(array) if array.dtype.kind == "u" else (array,)
                for part in parts:
                    state.update(np.ascontiguousarray(part).data)
        return state.hexdigest()


def pictures_first(backends: Iterable[str]) -> tuple[str, ...]:
    """Names in the order they are taken in: of several backends first those with pictures."""
    return tuple(sorted(backends, key=lambda name: (name == ANNOTATION, name)))


class Source:
    """The frames of one backend in an output folder or a sweep (or beside a USD file).

    Args:
        out: Output folder of ``compile`` and ``render``, a sweep (``outputs.SweptOutputs``), or a
            USD file that was rendered.
        backend: Whose frames; None takes the only one there is, and of several the first by name.
        batches: Only these.
        cameras: Only these.
        samples: Only these.
        rectified: Batches and cameras whose frames are taken from ``RECTIFIED``.

    Attributes:
        out: As given.
        backend: Whose frames they are.
        backends: All that have frames here.
        frames: In order of batch, camera and sample.
        missing: Faults of frames that should be there.
        strays: Faults of frames at samples that their camera has none at.
        outputs: Where the batches are: an output folder, a USD file, all points of a sweep.

    Raises:
        FrameError: There are no frames, or none of this backend or camera.
        OutputError: No manifest.
        StageError: A batch asked for is not there.
    """

    def __init__(
        self,
        out: Path | str,
        backend: str | None = None,
        *,
        batches: Collection[int] | None = None,
        cameras: Sequence[str] | None = None,
        samples: Collection[int] | None = None,
        rectified: Collection[tuple[int, str]] = (),
    ) -> None:
        self.out = Path(out)
        self._rectified = frozenset(rectified)
        self.outputs = find_outputs(self.out)
        self._batches = self.outputs.find(batches)
        self.backends = self._rendered()
        self.backend = self._choose(backend)
        seen = self._folders(self._batches)
        for camera in cameras or ():
            if camera not in seen:
                raise FrameError(
                    f"{self.out}: no frames of camera {camera!r}{nearest(camera, seen)}"
                )
        self._cameras = list(cameras) if cameras else seen
        self._every = self.outputs.find() if batches is not None else self._batches
        self._samples = None if samples is None else set(samples)
        self.missing: tuple[FrameFault, ...] = ()
        self.strays: tuple[FrameFault, ...] = ()
        self._digests = self.outputs.digests(self._batches)
        self.frames = self._list()
        if not self.frames:
            raise FrameError(
                f"{self.out}: no frames of {self.backend} in the range asked for; "
                f"{self.outputs.mend} --backend {self.backend}"
            )
        self._labels: dict[str, dict[int, str]] | None = None

    @property
    def stages(self) -> dict[str, Path]:
        """Root layers of the batches' stages, by the batch's name."""
        return {batch.name: batch.stage for batch in self._batches}

    def is_foreign(self, ref: FrameRef) -> bool:
        """Whether a frame's sidecar names another stage than the manifest has."""
        digest, record = self._digests.get(ref.batch_name), record_of(ref)
        return digest is not None and record is not None and record.stage_digest != digest

    def __len__(self) -> int:
        return len(self.frames)

    def load(
        self, ref: FrameRef, passes: Sequence[str] | None = None, unused: Sequence[str] = ()
    ) -> LoadedFrame:
        """Read a frame, and hold it against what it should be.

        Args:
            ref: One of ``frames``.
            passes: Names that must be there.
            unused: Names of passes that are not decoded.

        Raises:
            FrameError: It is damaged, foreign, or lacks a pass; the message names the file.
        """
        frame = read_frame(ref.stem, passes, unused)
        self._refuse_foreign(ref, frame)
        for told in frame_faults(frame.passes, frame.sidecar, unused):
            raise FrameError(f"{ref.stem}.exr: {told}; render it again")
        table = {}
        if "instance" in frame.passes:
            path = _vouched(frame.sidecar.instance_table, frame_table_path(ref.stem))
            table = read_frame_table(path)
            # Amodal areas came later: all of them, or none.
            more = AMODAL_COLUMNS if set(AMODAL_COLUMNS) & table.keys() else ()
            if lacking := [name for name in (*FRAME_COLUMNS, *more) if name not in table]:
                raise FrameError(f"{path}: a table of instances without {', '.join(lacking)}")
            for told in table_faults(frame.passes["instance"], table, _label_names(frame)):
                raise FrameError(f"{path}: {told}; render it again")
            _vouched(frame.sidecar.amodal, amodal_path(ref.stem))
        labels = _label_names(frame)
        loaded = LoadedFrame(ref, frame.passes, frame.sidecar, table, labels)
        loaded.ignored = np.zeros(len(table["id"]) if table else 0, np.bool_)
        if loaded.png is not None and not loaded.png.is_file():
            raise FrameError(f"{loaded.png}: missing, though its sidecar is there; render it again")
        return loaded

    def labels(self) -> dict[str, dict[int, str]]:
        """Level -> id -> name, as the first readable sidecar has them: all frames must agree.

        Raises:
            FrameError: No sidecar can be read.
        """
        if self._labels is None:
            self._labels = _label_names(self._first)
        return self._labels

    def passes(self) -> tuple[str, ...]:
        """Passes of the first readable frame.

        Raises:
            FrameError: No sidecar can be read.
        """
        return self._first.sidecar.passes

    def first_sidecar(self) -> FrameRecord:
        """The first sidecar that can be read.

        Raises:
            FrameError: None can.
        """
        return self._first.sidecar

    def __getstate__(self) -> dict[str, Any]:
        # A worker is told which frames to take: it need not be sent the list of all of them.
        _ = self._first
        return {**self.__dict__, "frames": (), "missing": (), "strays": (), "outputs": None}

    @cached_property
    def _first(self) -> Frame:
        fault: Exception | None = None
        for ref in self.frames:
            path = ref.stem.with_suffix(".json")
            try:
                return Frame(path, {}, read_sidecar(path))
            except FrameError as error:
                fault = error
        raise FrameError(f"{self.out}: no frame has a sidecar that can be read: {fault}")

    def _rendered(self) -> tuple[str, ...]:
        folders = [batch.folder / FRAMES for batch in self._batches]
        names = {p.name for f in folders if f.is_dir() for p in f.iterdir() if p.is_dir()}
        if len(names) < 2:
            return tuple(names)
        # A frame or two that were tried by another renderer are not the dataset.
        held = {n: sum(1 for f in folders for _ in (f / n).glob("*/*.json")) for n in names}
        return tuple(sorted(pictures_first(names), key=lambda n: (n == ANNOTATION, -held[n])))

    def _choose(self, wanted: str | None) -> str:
        there = self.backends
        if not there:
            raise FrameError(f"{self.out}: no frames; {self.outputs.mend}")
        wanted = ANNOTATION if wanted in ANNOTATION_NAMES else wanted
        if wanted is not None and wanted not in there:
            raise FrameError(f"{self.out}: no frames of {wanted}{nearest(wanted, there)}")
        return wanted or there[0]

    def _list(self) -> tuple[FrameRef, ...]:
        refs: list[FrameRef] = []
        places = self._places()
        missing = [
            FrameFault(point.name, "missing", f"{point.out}: no such point: {point.entry.state}")
            for point in self.outputs.points
            if point.manifest is None and self._every is self._batches
        ]
        strays: list[FrameFault] = []
        lengths = self.outputs.lengths()
        for batch in self._batches:
            settings = self.outputs.settings(batch)
            for camera in self._cameras:
                there = self._numbers(batch, camera)
                known = lengths.get(batch.index) or (max(there) + 1 if there else 0)
                expected = set(range(known)) if self._samples is None else self._samples
                if self._samples is not None and lengths.get(batch.index):
                    expected = expected & set(range(lengths[batch.index]))
                every, first = self._trigger(batch, camera, there)
                # Without a manifest nobody says where samples end.
                end = known if lengths.get(batch.index) else 1 + max({known, *expected})
                fires = set(range(first, end, every))
                expected &= fires
                for sample in sorted(there | expected):
                    if self._samples is not None and sample not in self._samples:
                        continue
                    kind = RECTIFIED if (batch.index, camera) in self._rectified else FRAMES
                    stem = frame_stem(batch.folder, self.backend, camera, sample, kind)
                    number = places.get((batch.index, camera), 0) + sample
                    ref = FrameRef(
                        number,
                        batch.index,
                        batch.name,
                        self.backend,
                        camera,
                        sample,
                        stem,
                        settings,
                    )
                    if sample in there and sample not in fires:
                        told = f"{stem}.json: {_astray(sample, known, every, first)}"
                        strays.append(FrameFault(ref.name, "stray", told))
                    elif sample in there:
                        refs.append(ref)
                    else:
                        missing.append(
                            FrameFault(ref.name, "missing", f"{stem}.json: no such frame")
                        )
        self.missing = tuple(missing)
        self.strays = tuple(strays)
        return tuple(refs)

    def _places(self) -> dict[tuple[int, str], int]:
        """Returns the number of the first frame of each batch and camera, for any selection."""
        lengths, names = self.outputs.lengths(), self._folders(self._every)
        places: dict[tuple[int, str], int] = {}
        total = 0
        for batch in self._every:
            length = lengths.get(batch.index)
            for camera in names:
                places[batch.index, camera] = total
                total += length or 1 + max(self._numbers(batch, camera), default=-1)
        return places

    def _folders(self, batches: Iterable[Batch]) -> list[str]:
        """Lists cameras of which any of some batches has frames."""
        folders = [batch.folder / FRAMES / self.backend for batch in batches]
        return sorted({p.name for f in folders if f.is_dir() for p in f.iterdir()})

    def _trigger(self, batch: Batch, camera: str, there: set[int]) -> tuple[int, int]:
        """Returns the camera's trigger, as a sidecar of the stage says; (1, 0) if none can."""
        digest = self._digests.get(batch.name)
        for sample in sorted(there):
            stem = frame_stem(batch.folder, self.backend, camera, sample)
            try:
                sidecar = read_sidecar(stem.with_suffix(".json"))
            except FrameError:
                # A damaged sidecar is told where its frame is read.
                continue
            if digest in (None, sidecar.stage_digest):
                return sidecar.firing
        return 1, 0

    def _numbers(self, batch: Batch, camera: str) -> set[int]:
        folder = batch.folder / FRAMES / self.backend / camera
        if not folder.is_dir():
            return set()
        # An EXR or a picture without its sidecar is a frame that was never finished.
        return {int(p.stem) for p in folder.glob("*.json") if p.stem.isascii() and p.stem.isdigit()}

    def _refuse_foreign(self, ref: FrameRef, frame: Frame) -> None:
        digest = frame.sidecar.stage_digest
        known = self._digests.setdefault(ref.batch_name, digest)
        if digest != known:
            raise ForeignFrameError(
                f"{frame.path}: foreign: was rendered from another stage than the one beside it; "
                "render it again"
            )
        if (frame.sidecar.camera, frame.sidecar.sample) != (ref.camera, ref.sample):
            raise ForeignFrameError(
                f"{frame.path}: foreign: says it is {frame.sidecar.camera} {frame.sidecar.sample}"
            )
        if _label_names(frame) != self.labels():
            raise ForeignFrameError(
                f"{frame.path}: foreign: its labels are not those of the other frames; export "
                "these batches apart"
            )


def kind_of(error: FrameError) -> str:
    """Returns the kind of fault that an error of ``Source.load`` is: ``foreign`` or ``damaged``."""
    return "foreign" if isinstance(error, ForeignFrameError) else "damaged"


def _astray(sample: int, samples: int, every: int, first: int) -> str:
    """Why a stage has no frame at a sample, and what to do with one that is there."""
    if sample >= samples:
        reason = f"the batch has samples 0 to {samples - 1}"
    else:
        reason = f"its camera is triggered at samples {first}, {first + every}, …"
    return f"not of this stage: {reason}, not at {sample}; delete it"


def record_of(ref: FrameRef) -> FrameRecord | None:
    """A frame's sidecar; None where it cannot be read, which is told where its frame is."""
    try:
        return read_sidecar(ref.stem.with_suffix(".json"))
    except FrameError:
        return None


def one_of_each(frames: Iterable[FrameRef]) -> dict[str, FrameRecord]:
    """A readable sidecar of each camera that has one."""
    records: dict[str, FrameRecord] = {}
    for ref in frames:
        values = None if ref.camera in records else record_of(ref)
        if values is not None:
            records[ref.camera] = values
    return records


def _vouched(digest: FileDigest | None, path: Path) -> Path:
    """A file beside the frame, held against the sidecar's checksum where that has one.

    Raises:
        FrameError: It is another file, or missing.
    """
    if digest is not None:
        if not path.is_file():
            raise FrameError(f"{path}: missing, though its sidecar names it; render it again")
        if sha256(path) != digest.sha256:
            raise FrameError(
                f"{path}: truncated, damaged or changed since it was written (its checksum is not "
                "the sidecar's); render it again"
            )
    return path


def _label_names(frame: Frame) -> dict[str, dict[int, str]]:
    return {
        level: {int(number): name for number, name in table.items()}
        for level, table in frame.sidecar.labels.items()
    }


def sequences(frames: Sequence[FrameRef]) -> Iterator[list[FrameRef]]:
    """Frames of one batch and camera each, in order of samples."""
    run: list[FrameRef] = []
    for ref in frames:
        if run and (run[-1].batch_name, run[-1].camera) != (ref.batch_name, ref.camera):
            yield run
            run = []
        run.append(ref)
    if run:
        yield run
