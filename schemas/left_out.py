"""Records what a compilation left out of a batch, and why: in the report, and by instance.

**Entries.** ``report.json`` lists under ``left_out`` what has no place in the stage, each entry as
``entry`` makes it: ``pass`` (what decided it), ``what`` (beginning with the cfg's path of the
thing), ``why``, and how much that spared: ``instances``, ``triangles`` (each instance's counted)
and ``bytes`` (of arrays as they are in memory, USD may pack them; of pictures, of the file). All of
it is the same in every run; seconds stand in ``timings.json``.

**The record.** ``left_out.json`` in a batch's folder says of every local id of every class of
objects why it is in the stage, or why not. It is written only where an id or a tile is missing, and
is no part of the stage: frames do not depend on it. It holds

``format``   2
``tiles``    prim name of each tile of the terrain that was left out -> reason
``classes``  class -> ``{"drawn", "kept", "reasons", "bits", "codes"}`` and maybe ``ids``

``drawn`` is the largest local id, ``kept`` how many instances are in the stage. ``codes`` is base64
of indices into ``reasons``, ``bits`` (1, 2 or 4) each, the first in the lowest bits of the first
byte. They are those of the ids 1, 2, …, ``drawn``; or, with ``ids``, of the ids listed there, and
all others were never placed.
"""

from __future__ import annotations

import base64
from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray

from scenec.schemas.codec import UNSET, Facts, Natural, Unset, read_record
from scenec.schemas.errors import OutputError
from scenec.schemas.files import write_json
from scenec.schemas.manifest import LEFT_OUT as LEFT_OUT

_FORMAT = 2
#: Classes with fewer objects than one in so many numbers have their ids listed.
_SPARSE = 4
_BITS = (1, 2, 4)


class Reason(StrEnum):
    """Why an instance, or a tile of the terrain, is in the stage or is not."""

    #: A camera may see it.
    SEEN = "seen"
    #: Its shadow may fall on what a camera sees.
    SHADOW = "shadow"
    #: It is near enough and large enough, as seen from what is seen, to change the light there.
    LIGHT = "light"
    #: Nothing of the kind was to be left out.
    ALL = "all"
    #: It lies outside of every picture, and nothing in any picture shows its effect.
    OUT_OF_VIEW = "out of view"
    #: It lies in pictures' cones, but behind the ground; nothing in any picture shows its effect.
    BEHIND_GROUND = "behind the ground"
    #: It found no place on the terrain, or its number was never given.
    NOT_PLACED = "not placed"

    @property
    def kept(self) -> bool:
        """Whether what has this reason is in the stage."""
        return self in (Reason.SEEN, Reason.SHADOW, Reason.LIGHT, Reason.ALL)

    @property
    def text(self) -> str:
        """In words, after "it is in the stage: " or "it is not in the stage: "."""
        return _TEXTS[self]


_TEXTS = {
    Reason.SEEN: "a camera may see it",
    Reason.SHADOW: "no camera sees it, but its shadow may fall on what one sees",
    Reason.LIGHT: "no camera sees it, but it is near enough and large enough, as seen from what "
    "one sees, to change the light there",
    Reason.ALL: "nothing of its kind was to be left out",
    Reason.OUT_OF_VIEW: "it lies outside of every picture, and none shows its effect",
    Reason.BEHIND_GROUND: "every camera that looks its way has ground in between, and no picture "
    "shows its effect",
    Reason.NOT_PLACED: "it found no place, or no object has this number",
}


#: The reasons in a fixed order: what arrays of reasons hold are places in it.
ORDER = tuple(Reason)


def _is_reason(value: Any) -> str | None:
    return None if value in list(Reason) else f"one of {', '.join(Reason)}"


@dataclass(frozen=True, kw_only=True)
class PackedClass:
    """Records a class's instances in ``left_out.json``: see the module."""

    drawn: Natural
    bits: Natural
    reasons: tuple[Annotated[str, _is_reason], ...]
    codes: str
    ids: tuple[Natural, ...] | Unset = UNSET


@dataclass(frozen=True, kw_only=True)
class PackedRecord:
    """Records the content of ``left_out.json``: see the module."""

    format: Natural
    tiles: Mapping[str, Annotated[str, _is_reason]]
    classes: Mapping[str, PackedClass]


@dataclass(frozen=True)
class ClassRecord:
    """Why each instance of a class is where it is.

    Attributes:
        drawn: Largest local id.
        ids: Local ids of what was placed, ascending, int64 [n]; the others are ``NOT_PLACED``.
        reasons: Of each, as an index into ``ORDER``, uint8 [n].
    """

    drawn: int
    ids: NDArray[np.int64]
    reasons: NDArray[np.uint8]

    def of(self, local_id: int) -> Reason:
        """The reason of one id."""
        at = int(np.searchsorted(self.ids, local_id))
        if at < len(self.ids) and int(self.ids[at]) == local_id:
            return ORDER[int(self.reasons[at])]
        return Reason.NOT_PLACED

    def counts(self) -> dict[Reason, int]:
        """Counts the ids 1 … ``drawn`` by reason, for each reason that any has."""
        numbers = np.bincount(self.reasons, minlength=len(ORDER))
        numbers[ORDER.index(Reason.NOT_PLACED)] += self.drawn - len(self.ids)
        return {reason: int(n) for reason, n in zip(ORDER, numbers, strict=True) if n}

    def where(self, reason: Reason) -> NDArray[np.int64]:
        """The placed ids of a reason, ascending."""
        return self.ids[self.reasons == ORDER.index(reason)]


@dataclass(frozen=True)
class Record:
    """Holds the content of ``left_out.json``.

    Attributes:
        classes: By name of the class.
        tiles: Reason of each tile that was left out, by prim name.
    """

    classes: dict[str, ClassRecord]
    tiles: dict[str, Reason]


def entry(
    of_pass: str, what: str, why: str, *, instances: int = 0, triangles: int = 0, size: int = 0
) -> Facts:
    """One entry of ``left_out`` in ``report.json``.

    Args:
        of_pass: Name of the pass that left it out.
        what: The cfg's path of the thing, then what of it: "objects/rocks: 812 instances".
        why: In words.
        instances, triangles: How many are spared.
        size: Bytes that are spared.
    """
    return {
        "pass": of_pass,
        "what": what,
        "why": why,
        "instances": int(instances),
        "triangles": int(triangles),
        "bytes": int(size),
    }


def write_left_out(folder: Path, record: Record) -> None:
    """Writes the record of a batch, by atomic rename; equal records give equal bytes.

    Args:
        folder: Of the batch.
        record: What to write.

    Raises:
        OutputError: It cannot be written.
    """
    write_json(
        folder / LEFT_OUT,
        {
            "format": _FORMAT,
            "tiles": {name: str(reason) for name, reason in record.tiles.items()},
            "classes": {name: _as_json(one) for name, one in record.classes.items()},
        },
    )


def read_left_out(folder: Path) -> Record | None:
    """The record of a batch; None where nothing is missing from its stage.

    Args:
        folder: Of the batch.

    Raises:
        OutputError: The file is damaged, or of another version.
    """
    path = folder / LEFT_OUT
    what = "record of what was left out"
    try:
        value = read_record(path, PackedRecord, OutputError, what)
    except FileNotFoundError:
        return None
    if value.format != _FORMAT:
        raise OutputError(f"{path}: a record of another version; compile again")
    classes = {}
    for name, one in value.classes.items():
        try:
            classes[name] = _from_json(one)
        except (ValueError, OverflowError, MemoryError) as error:
            raise OutputError(f"{path}: is no {what}: /classes/{name}: {error}") from error
    tiles = {name: Reason(reason) for name, reason in value.tiles.items()}
    return Record(classes, tiles)


def _as_json(one: ClassRecord) -> dict[str, Any]:
    listed = one.drawn > _SPARSE * len(one.ids)
    reasons = one.reasons
    if not listed:
        reasons = np.full(one.drawn, ORDER.index(Reason.NOT_PLACED), np.uint8)
        reasons[one.ids - 1] = one.reasons
    used, codes = np.unique(reasons, return_inverse=True)
    bits = next(b for b in _BITS if len(used) <= 1 << b)
    return {
        "drawn": one.drawn,
        "kept": sum(n for reason, n in one.counts().items() if reason.kept),
        "reasons": [str(ORDER[code]) for code in used.tolist()],
        "bits": bits,
        "codes": base64.b64encode(_packed(codes.astype(np.uint8), bits)).decode("ascii"),
        **({"ids": one.ids.tolist()} if listed else {}),
    }


def _from_json(value: PackedClass) -> ClassRecord:
    """The other way.

    Raises:
        ValueError, OverflowError: It is not what ``_as_json`` makes.
    """
    drawn, bits = value.drawn, value.bits
    # Before there are arrays of that size: base64 takes four characters for three bytes.
    if bits not in _BITS or (value.ids is UNSET and drawn > 6 * (len(value.codes) + 1)):
        raise ValueError("numbers out of range")
    ids = np.arange(1, drawn + 1) if value.ids is UNSET else np.array(value.ids, np.int64)
    if len(ids) and not (ids[0] > 0 and ids[-1] <= drawn and (np.diff(ids) > 0).all()):
        raise ValueError("numbers out of range")
    names = np.array([ORDER.index(Reason(name)) for name in value.reasons], np.uint8)
    codes = _unpacked(base64.b64decode(value.codes, validate=True), bits, len(ids))
    if len(codes) and codes.max() >= len(names):
        raise ValueError("a code without a reason")
    reasons = names[codes] if len(codes) else np.zeros(0, np.uint8)
    placed = reasons != ORDER.index(Reason.NOT_PLACED)
    return ClassRecord(drawn, ids[placed], reasons[placed])


def _packed(codes: NDArray[np.uint8], bits: int) -> bytes:
    """The lowest bits of codes, one code after the other."""
    each = np.unpackbits(codes[:, None], axis=1, count=bits, bitorder="little")
    return np.packbits(each, bitorder="little").tobytes()


def _unpacked(data: bytes, bits: int, count: int) -> NDArray[np.uint8]:
    if len(data) != -(-count * bits // 8):
        raise ValueError("as many codes as ids were expected")
    each = np.unpackbits(np.frombuffer(data, np.uint8), count=count * bits, bitorder="little")
    return np.packbits(each.reshape(count, bits), axis=1, bitorder="little")[:, 0]
