"""Frames as a map-style PyTorch dataset, read from where they were rendered: nothing is converted.

    from torch.utils.data import DataLoader
    from scenec.datasets.torch_dataset import FrameDataset, collate

    train = FrameDataset("out", passes=("rgb", "label.class", "depth"),
                         split="train", splits="train=0.8,val=0.2")
    for batch in DataLoader(train, batch_size=4, num_workers=2, collate_fn=collate):
        batch["rgb"]           # float32 [4, 3, h, w]

PyTorch is imported when the first sample is made, and not at all with ``as_numpy=True``.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from pathlib import Path
from typing import Any, TypedDict, Unpack

import numpy as np
from numpy.typing import NDArray

from scenec.datasets import pictures
from scenec.datasets.filters import make_filters
from scenec.datasets.formats.encode import instance_label
from scenec.datasets.remap import Remap, parse_remap, read_remap
from scenec.datasets.source import LoadedFrame, Source
from scenec.datasets.splits import assign, parse_splits
from scenec.schemas.errors import FrameError, OutputError
from scenec.schemas.spelling import nearest
from scenec.schemas.versions import optional

Sample = dict[str, Any]

#: Parts of a target in the form of torchvision's detection models.
TARGETS = ("boxes", "labels", "masks")


class Options(TypedDict, total=False):
    """Declares the other keyword arguments of a ``FrameDataset``.

    Args:
        split: Name of the split; None (the default) takes all frames.
        splits: As ``--splits`` has them (``train=0.8,val=0.2``): whole batches, as in exports.
        split_seed: Another one than 0 gives another assignment of batches.
        batches: Only these.
        cameras: Only these.
        samples: Only these.
        keep: Conditions on instances (``area>=40``), as in exports.
        rejected: What becomes of other instances: ``drop`` (the default) or ``ignore``.
        remap: Other labels: a file, its JSON values, or a ``Remap``.
        level: Whose labels targets have; None takes the first.
        target: Which of ``TARGETS`` samples have; none for no ``target``.
        rgb: ``linear`` (the default) or ``srgb``.
        transform: Called with each sample; what it returns is the sample.
        allow_missing: Whether frames that should be there may be missing.
        as_numpy: Whether samples hold NumPy arrays of the same types and shapes.
    """

    split: str | None
    splits: str | Mapping[str, float | range]
    split_seed: int
    batches: Collection[int] | None
    cameras: Sequence[str] | None
    samples: Collection[int] | None
    keep: Sequence[str]
    rejected: str
    remap: Remap | Mapping[str, Any] | Path | str | None
    level: str | None
    target: Sequence[str]
    rgb: str
    transform: Callable[[Sample], Any] | None
    allow_missing: bool
    as_numpy: bool


class FrameDataset:
    """Frames of an output folder, for ``torch.utils.data.DataLoader``.

    A sample is a dict of tensors:

    ===================  =======================================================================
    ``rgb``              float32 [3, h, w]: linear radiance, or with ``rgb="srgb"`` the frame's
                         picture in [0, 1]: what its sensor took, else radiance developed
    ``depth``            float32 [h, w], meters; +inf without a hit
    ``range``            likewise
    ``label.<level>``    int64 [h, w]
    ``instance``         int64 [h, w], frame ids; ``face`` likewise
    ``normal``           float32 [3, h, w]
    ``position``         float32 [3, h, w], meters
    ``K``                float64 [3, 3], pixels
    ``camera_to_world``  float64 [4, 4], camera axes as OpenCV has them
    ``time_s``           float64 []
    ``target``           where asked for: ``boxes`` float32 [n, 4] (x0, y0, x1, y1, ends excluded),
                         ``labels`` int64 [n] (ids at ``level``, 0 where faces differ), ``masks``
                         uint8 [n, h, w], and always ``ids`` int64 [n], ``area`` float32 [n],
                         ``iscrowd`` int64 [n] (1: kept, but failed a filter), ``image_id`` int64 []
    ===================  =======================================================================

    and ``frame`` (``batch/camera/sample``), ``batch``, ``camera``, ``sample``.

    It can be pickled, so workers may be forked or spawned.

    Args:
        out: Output folder of ``compile`` and ``render``, or a USD file that was rendered.
        passes: Names; ``label`` stands for all levels. None takes all that the frames have.
        backend: Whose frames; None takes the first there is.
        options: See ``Options``.

    Attributes:
        frames: In order of batch, camera and sample.
        labels: Level -> id -> name, without 0, after remapping.
        passes: Names of the passes that samples have.

    Raises:
        FrameError: There are no frames, or one is missing.
        OutputError: Something asked for makes no sense, or PyTorch is not installed.
        StageError: A batch asked for is not there.
    """

    def __init__(
        self,
        out: Path | str,
        passes: Sequence[str] | None = None,
        backend: str | None = None,
        **options: Unpack[Options],
    ) -> None:
        for name in options:
            if name not in Options.__annotations__:
                raise TypeError(
                    f"FrameDataset has no option {name!r}{nearest(name, Options.__annotations__)}"
                )
        target, rgb = tuple(options.get("target", ())), options.get("rgb", "linear")
        self._as_numpy = options.get("as_numpy", False)
        if not self._as_numpy:
            _import_torch()
        if rgb not in ("linear", "srgb"):
            raise OutputError(f"rgb: expected linear or srgb, not {rgb!r}")
        for name in target:
            if name not in TARGETS:
                raise OutputError(f"target: there is no {name!r}{nearest(name, TARGETS)}")
        self._source = Source(
            out,
            backend,
            batches=options.get("batches"),
            cameras=options.get("cameras"),
            samples=options.get("samples"),
        )
        if self._source.missing and not options.get("allow_missing", False):
            missing = self._source.missing
            more = f" (and {len(missing) - 1} more)" if len(missing) > 1 else ""
            raise FrameError(f"{missing[0].message}{more}; render it, or give allow_missing=True")
        self._remap = _as_remap(options.get("remap"))
        self._remap.check(self._source.labels())
        self.labels = self._remap.labels(self._source.labels())
        self._level = options.get("level") or next(iter(self.labels), "")
        if self.labels and self._level not in self.labels:
            raise OutputError(
                f"there is no label level {self._level!r}{nearest(self._level, self.labels)}"
            )
        keep = options.get("keep", ())
        self._filters = make_filters(keep, options.get("rejected", "drop"))
        self._target, self._rgb = target, rgb
        self._transform = options.get("transform")
        self.passes = _choose_passes(passes, self._source.passes())
        needs_instances = bool(self._target or keep)
        if needs_instances and "instance" not in self._source.passes():
            raise OutputError(
                f"{out}: targets and conditions speak of instances, and the frames have no pass "
                "instance; render with --passes …,instance"
            )
        self._needed = (*self.passes, "instance") if needs_instances else self.passes
        self.frames = self._source.frames
        if (split := options.get("split")) is not None:
            found = _assigned(self._source, split, options)
            self.frames = tuple(ref for ref in self.frames if found.get(ref.batch) == split)

    def __len__(self) -> int:
        return len(self.frames)

    def __getitem__(self, index: int) -> Any:
        """A sample.

        Raises:
            FrameError: The frame is missing, foreign or damaged.
            IndexError: There is none of this number.
        """
        frame = self.load(index)
        arrays = {name: frame.passes[name] for name in self.passes}
        if "rgb" in arrays and self._rgb == "srgb":
            arrays["rgb"] = pictures.picture(frame).astype(np.float32) / np.float32(255.0)
        target = self._make_target(frame, range(len(self))[index]) if self._target else None
        sample = make_sample(frame, arrays, target, as_numpy=self._as_numpy)
        return sample if self._transform is None else self._transform(sample)

    def load(self, index: int) -> LoadedFrame:
        """A frame, remapped and filtered, before it is made a sample.

        Raises:
            FrameError: It is missing, foreign or damaged.
            IndexError: There is none of this number.
        """
        frame = self._source.load(self.frames[index], self._needed)
        self._remap.apply(frame)
        self._filters.apply(frame)
        return frame

    def _make_target(self, frame: LoadedFrame, number: int) -> dict[str, NDArray[Any]]:
        table = frame.table
        ids = table["id"].astype(np.int64)
        target: dict[str, NDArray[Any]] = {
            "ids": ids,
            "area": table["pixels"].astype(np.float32),
            "iscrowd": frame.ignored.astype(np.int64),
            "image_id": np.array(number, np.int64),
        }
        if "boxes" in self._target:
            corners = [table["x_min"], table["y_min"], table["x_max"] + 1, table["y_max"] + 1]
            target["boxes"] = np.stack(corners, axis=-1).astype(np.float32)
        if "labels" in self._target:
            target["labels"] = instance_label(frame, self._level)
        if "masks" in self._target:
            shown = frame.passes["instance"].astype(np.int64)
            target["masks"] = (shown[None] == ids[:, None, None]).astype(np.uint8)
        return target


def make_sample(
    frame: LoadedFrame,
    arrays: Mapping[str, NDArray[Any]],
    target: Mapping[str, NDArray[Any]] | None = None,
    *,
    as_numpy: bool = False,
) -> Sample:
    """Makes a sample as ``FrameDataset`` describes it.

    Args:
        frame: Whose it is.
        arrays: Its passes by name, [h, w] or [h, w, channels].
        target: As of ``FrameDataset``; None for none.
        as_numpy: Whether it holds arrays, not tensors.

    Raises:
        OutputError: Tensors are asked for, and PyTorch is not installed.
    """
    sample: Sample = {name: _channels_first(array) for name, array in arrays.items()}
    sample["K"] = frame.intrinsics
    sample["camera_to_world"] = frame.camera_to_world
    sample["time_s"] = np.array(frame.time_s, np.float64)
    if target is not None:
        sample["target"] = target
    if not as_numpy:
        sample = _as_tensors(sample)
    sample |= frame.optics
    sample["frame"] = frame.ref.name
    sample["batch"] = frame.ref.batch
    sample["camera"] = frame.ref.camera
    sample["sample"] = frame.ref.sample
    return sample


def _channels_first(array: NDArray[Any]) -> NDArray[Any]:
    is_picture = array.dtype == np.uint8 and array.ndim == 3
    if array.dtype.kind == "u" and not is_picture:
        return array.astype(np.int64)
    if array.ndim == 3:
        array = np.moveaxis(array, -1, 0)
    return np.ascontiguousarray(array, np.uint8 if is_picture else np.float32)


def collate(samples: Sequence[Sample]) -> Sample:
    """A batch: what has one shape in all samples is stacked, the rest is a list.

    ``target`` (a dict each, of as many instances as each frame shows) and text are always lists, as
    torchvision's detection models take them.

    Args:
        samples: Of a ``FrameDataset``, of tensors or of arrays.
    """
    # A lens, and a shutter, are there where a camera has one.
    names = dict.fromkeys(name for sample in samples for name in sample)
    return {name: _together(name, [s.get(name) for s in samples]) for name in names}


def _together(name: str, values: list[Any]) -> Any:
    first = values[0]
    if name == "target" or not all(hasattr(value, "shape") for value in values):
        return values
    if any(value.shape != first.shape for value in values):
        return values
    return np.stack(values) if isinstance(first, np.ndarray) else _import_torch().stack(values)


def _as_tensors(values: Mapping[str, Any]) -> dict[str, Any]:
    torch = _import_torch()
    return {
        name: _as_tensors(value) if isinstance(value, dict) else torch.from_numpy(value)
        for name, value in values.items()
    }


def _assigned(source: Source, split: str, options: Options) -> dict[int, str]:
    """The split of each batch.

    Raises:
        OutputError: There is no split of this name.
    """
    chosen = options.get("splits", "")
    if isinstance(chosen, str):
        chosen = parse_splits(chosen) if chosen else {}
    if split not in chosen:
        raise OutputError(
            f"split {split!r} is none of splits{nearest(split, chosen)}; give "
            "splits='train=0.8,val=0.2' or the like"
        )
    batches = sorted({ref.batch for ref in source.frames})
    return assign(batches, chosen, options.get("split_seed", 0), source.outputs.twins())


def _as_remap(remap: Remap | Mapping[str, Any] | Path | str | None) -> Remap:
    if remap is None:
        return Remap()
    if isinstance(remap, Remap):
        return remap
    return read_remap(remap) if isinstance(remap, Path | str) else parse_remap(dict(remap))


def _choose_passes(wanted: Sequence[str] | None, there: Sequence[str]) -> tuple[str, ...]:
    if wanted is None:
        return tuple(there)
    names: list[str] = []
    for name in wanted:
        levels = [p for p in there if p.startswith("label.")] if name == "label" else []
        if name not in there and not levels:
            raise OutputError(
                f"passes: the frames have no {name!r}{nearest(name, there)} (they have "
                f"{', '.join(there)})"
            )
        names += levels or [name]
    return tuple(dict.fromkeys(names))


def _import_torch() -> Any:
    return optional(
        "torch",
        "tensors need the package torch: pip install 'scenec[torch]'; or give as_numpy=True",
    )
