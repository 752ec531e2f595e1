"""Shares code of trajectory formats: time stamps, rigs, pictures, lists in text files."""

from __future__ import annotations

import shutil
from collections.abc import Iterable, Sequence
from dataclasses import replace
from decimal import Decimal, InvalidOperation
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from scenec.datasets.formats.contract import Format, Option
from scenec.datasets.pictures import picture
from scenec.datasets.source import FrameRef, LoadedFrame, record_of
from scenec.schemas.csv_cells import csv_writer, guarded_line
from scenec.schemas.errors import FrameError, OutputError
from scenec.schemas.files import atomic
from scenec.schemas.picture import write_png

#: Said of datasets whose time stamps are numbers of samples.
NO_IMUS = "times=samples: what IMUs read has no place among the numbers of samples"
#: At the root of such datasets: what each sequence is.
SEQUENCES = "sequences.csv"


#: Time stamps are whole numbers of ticks in 64 bits with sign.
_MOST_TICKS = 2**63


def time_options() -> dict[str, Option]:
    """Returns the options ``times`` and ``start_s``."""
    return {
        "times": Option(
            "stage",
            "time stamps: the stage's times, or the numbers of the samples as seconds",
            ("stage", "samples"),
        ),
        "start_s": Option(
            "0",
            "relative: seconds added to every time stamp, not the first stamp itself; may be "
            "negative",
        ),
    }


def start_ticks(form: Format, ticks: int) -> int:
    """The option ``start_s`` in ticks.

    Raises:
        OutputError: It is no number.
    """
    text = form.option("start_s")
    try:
        value = Decimal(text)
    except InvalidOperation:
        value = Decimal("nan")
    if not value.is_finite() or abs(value) >= _MOST_TICKS:
        raise OutputError(f"format {form.name}, option start_s: expected seconds, not {text!r}")
    return int((value * ticks).to_integral_value())


def stamp(form: Format, frame: LoadedFrame, ticks: int) -> int:
    """A frame's time stamp, to the nearest tick.

    Args:
        form: With ``time_options``.
        frame: The frame.
        ticks: Per second.

    Raises:
        OutputError: It is negative, or more than a format holds.
    """
    seconds = float(frame.ref.sample) if form.option("times") == "samples" else frame.time_s
    value = ticks_of(form, seconds, ticks)
    if value < 0:
        raise OutputError(
            f"{frame.ref.name}: its time is {as_seconds(value, ticks)} s, and format {form.name} "
            "knows no negative ones; give the option start_s, or times=samples"
        )
    if value >= _MOST_TICKS:
        raise OutputError(
            f"{frame.ref.name}: its time is {seconds!r} s, and format {form.name} holds those "
            f"below {_MOST_TICKS // ticks} s; give the option start_s, or times=samples"
        )
    return value


def as_seconds(value: int, ticks: int) -> str:
    """Formats a time stamp in seconds, all of its digits: ``1700000000.123456717``."""
    whole, rest = divmod(abs(value), ticks)
    digits = len(str(ticks)) - 1
    return f"{'-' if value < 0 else ''}{whole}.{rest:0{digits}d}"


def check_after(form: Format, frame: LoadedFrame, before: int, ticks: int) -> None:
    """Refuse a frame whose time stamp is not after that of a sample before, if that can be read.

    Files are named by time stamps: two of one name would be found much later.

    Args:
        form: With ``time_options``.
        frame: The frame.
        before: Sample before it; below 0 for none.
        ticks: Per second.

    Raises:
        OutputError: It is not.
    """
    if before < 0 or form.option("times") == "samples":
        return
    other = replace(frame.ref, sample=before, stem=frame.ref.stem.with_name(f"{before:06d}"))
    earlier = stamp_on_disk(form, other, ticks)
    if earlier is not None:
        now = stamp(form, frame, ticks), frame.ref.name
        check_rising(form, (earlier, other.name), now)


def stamp_on_disk(form: Format, ref: FrameRef, ticks: int) -> int | None:
    """Reads the time stamp of a frame that is not loaded; None where its sidecar has none."""
    if form.option("times") == "samples":
        return ticks_of(form, float(ref.sample), ticks)
    record = record_of(ref)
    if record is None or record.time_s is None:
        return None
    return ticks_of(form, record.time_s, ticks)


def ticks_of(form: Format, seconds: float, ticks: int) -> int:
    """Seconds as a whole number of ticks, the option ``start_s`` added."""
    return start_ticks(form, ticks) + round(Decimal(seconds) * ticks)


def check_rising(form: Format, before: tuple[int, str] | None, now: tuple[int, str]) -> None:
    """Refuse a sequence whose time stamps do not rise.

    Args:
        form: The format.
        before: Stamp and name of the frame before; None for the first.
        now: Of this one.

    Raises:
        OutputError: They do not.
    """
    if before is not None and now[0] <= before[0]:
        raise OutputError(
            f"{now[1]}: its time stamp is not after that of {before[1]} (at the resolution of "
            f"format {form.name}); give the option times=samples to number the frames instead"
        )


def rigs(frames: Sequence[FrameRef]) -> list[tuple[str, str, dict[str, list[FrameRef]]]]:
    """Frames by batch and rig: cameras below ``/World/Rigs/<rig>`` are one rig's.

    Args:
        frames: In order of batch, camera and sample.

    Returns:
        (batch name, rig, camera -> frames) in order of the frames; a camera that is on no rig has
        one of its own, of its own name.
    """
    cameras: dict[tuple[str, str], list[FrameRef]] = {}
    for ref in frames:
        cameras.setdefault((ref.batch_name, ref.camera), []).append(ref)
    result: dict[tuple[str, str], dict[str, list[FrameRef]]] = {}
    for (batch, camera), refs in cameras.items():
        known = (record.camera_prim for record in map(record_of, refs) if record is not None)
        parts = (next(known, None) or "").strip("/").split("/")
        on_rig = len(parts) >= 3 and parts[-3] == "Rigs"
        result.setdefault((batch, parts[-2] if on_rig else camera), {})[camera] = refs
    return [(batch, rig, members) for (batch, rig), members in result.items()]


def copy_picture(frame: LoadedFrame, path: Path, gray: bool = False) -> None:
    """The frame's picture, as it is or in shades of gray (ITU-R 601-2 luma, rounded).

    Raises:
        FrameError: The frame has none.
        OutputError: The file cannot be written.
    """
    if gray:
        write_png(path, gray_pixels(frame))
        return
    source = picture_path(frame)
    with atomic(path) as temporary:
        shutil.copyfile(source, temporary)


def picture_path(frame: LoadedFrame) -> Path:
    """Returns the path of the frame's picture.

    Raises:
        FrameError: It has none, or it is gone.
    """
    source = frame.png
    if source is None or not source.is_file():
        raise FrameError(
            f"{frame.ref.stem}.png: missing, and the format needs pictures; render with the pass "
            "rgb"
        )
    return source


def color_pixels(frame: LoadedFrame) -> NDArray[np.uint8]:
    """The frame's picture, uint8 [h, w, 3].

    Raises:
        FrameError: The frame has none, or it cannot be read.
    """
    picture_path(frame)
    return picture(frame)


def gray_pixels(frame: LoadedFrame) -> NDArray[np.uint8]:
    """The same in shades of gray, uint8 [h, w]."""
    rgb = color_pixels(frame).astype(np.int64)
    # In whole numbers, so that no machine rounds otherwise.
    luma = (rgb[..., 0] * 299 + rgb[..., 1] * 587 + rgb[..., 2] * 114 + 500) // 1000
    return luma.astype(np.uint8)


def write_table(path: Path, columns: Sequence[str], lines: Iterable[Sequence[object]]) -> None:
    """A CSV with a head, by atomic rename.

    Raises:
        OutputError: It cannot be written.
    """
    with atomic(path) as temporary, temporary.open("w", encoding="utf-8", newline="") as file:
        writer = csv_writer(file)
        writer.writerow(columns)
        writer.writerows(map(guarded_line, lines))
