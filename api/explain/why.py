"""``scenec explain OUT --why``: why one thing is in the stage of a batch, or is not."""

from __future__ import annotations

import html
import textwrap
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from scenec.api.declare import held_to_types
from scenec.api.explain.data import BatchData, read_batches
from scenec.api.explain.sight import Sight, nearest_camera
from scenec.api.explain.stage import ClassContents, StageContents, read_contents
from scenec.schemas import stage as names
from scenec.schemas.codec import Facts
from scenec.schemas.errors import OutputError
from scenec.schemas.left_out import Reason, Record, read_left_out
from scenec.schemas.report import ClassFacts
from scenec.schemas.spelling import nearest

_OBJECTS = f"{names.ROOT}/Objects/"
_TERRAIN = f"{names.ROOT}/Terrain/"
_SINGLE = "instance_"
#: Columns of an answer.
_WIDTH = 100
_NOTHING_MISSING = "nothing is missing from this batch"


@dataclass(frozen=True)
class Level:
    """The level of detail of an instance.

    Attributes:
        mesh: Name of its prototype.
        triangles: Of it.
        error_m: How far it is from the finest level, meters; None: no levels are known of it.
        error_px: The same in pixels where the nearest camera would show it; None without cameras.
    """

    mesh: str
    triangles: int
    error_m: float | None = None
    error_px: float | None = None


@dataclass(frozen=True)
class Why:
    """An answer.

    Attributes:
        what: What was asked for: "rocks/4711", or a prim path.
        batch: Name of the batch.
        in_stage: Whether it is in the stage.
        reason: In a word or two, as in left_out.json.
        why: In words.
        id: Of an instance as frames have it; None: it has none.
        position: World, meters, at the first sample; None where it is not in the stage.
        level: Of an instance in the stage.
        nearest: The camera that comes nearest to it.
        counts: Of a whole class: how many of its numbers have each reason.
        triangles: Of a tile of the terrain in the stage.
    """

    what: str
    batch: str
    in_stage: bool
    reason: str
    why: str
    id: int | None = None
    position: tuple[float, float, float] | None = None
    level: Level | None = None
    nearest: Sight | None = None
    counts: dict[str, int] = field(default_factory=dict)
    triangles: int | None = None

    @property
    def text(self) -> str:
        """For people, a line for each thing that is known."""
        verb = "is in the stage" if self.in_stage else "is not in the stage"
        first = f"{self.what} {verb} of {self.batch}: {self.why}"
        lines = textwrap.wrap(first, _WIDTH, subsequent_indent="  ", break_on_hyphens=False)
        for reason, count in self.counts.items():
            lines.append(f"  {count:>10,}  {reason}")
        if self.id is not None:
            lines.append(f"  id in frames    {self.id}")
        if self.position is not None:
            x, y, z = self.position
            lines.append(f"  stands at       x {x:.3f} m, y {y:.3f} m, z {z:.3f} m")
        if self.nearest is not None:
            lines.append(f"  nearest camera  {self.nearest.text}")
        if self.level is not None:
            lines.append(f"  level           {_level_text(self.level)}")
        if self.triangles is not None:
            lines.append(f"  triangles       {self.triangles:,}")
        return "\n".join(lines)

    def __str__(self) -> str:
        return self.text

    def _repr_html_(self) -> str:
        return f"<pre>{html.escape(self.text)}</pre>"

    def as_json(self) -> Facts:
        """For scripts: the attributes, by name."""
        found = dict(vars(self))
        found["level"] = None if self.level is None else dict(vars(self.level))
        found["nearest"] = None if self.nearest is None else dict(vars(self.nearest))
        return found


@held_to_types
def why(out: Path | str, question: str, batch: int | None = None) -> Why:
    """Why something is in a stage, or why it is not.

    Args:
        out: Output folder of a compile.
        question: "rocks/4711" (a class and a number in it), "rocks" (all of a class), "4711" (an
            instance id as frames have it), or a prim path.
        batch: Index of the batch; None takes the first there is.

    Raises:
        OutputError: No such class, number, id or prim (says what there is), or damaged files.
        StageError: No such batch, or a stage that cannot be read.
    """
    data = read_batches(Path(out), None if batch is None else [batch])[0]
    asked = _BatchIndex(data, read_contents(data.stage), read_left_out(data.folder))
    if question.startswith("/"):
        return _of_prim(asked, question.rstrip("/"))
    if question.isascii() and question.isdigit():
        return _of_id(asked, int(question))
    name, slash, number = question.rpartition("/")
    if not slash:
        return _of_class(asked, _require_class(asked, question))
    _require_class(asked, name)
    if not (number.isascii() and number.isdigit()):
        raise OutputError(f"{question}: {number!r} is no number; ask for {name}/1, for example")
    return _of_instance(asked, name, int(number))


class _BatchIndex:
    """A batch, and what is known of its classes."""

    def __init__(self, data: BatchData, contents: StageContents, record: Record | None) -> None:
        self.data = data
        self.contents = contents
        self.record = record
        self.names = tuple(data.report.objects)

    def drawn(self, name: str) -> int:
        """Largest local id of a class."""
        if self.record is not None and name in self.record.classes:
            return self.record.classes[name].drawn
        there = self.contents.classes.get(name)
        if there is None:
            return 0
        return there.count if there.ids is None else int(there.ids.max(initial=0))

    def base(self, name: str) -> int:
        """Returns the offset of a class's local ids: the sum over the classes before it."""
        there = self.contents.classes.get(name)
        if there is not None and there.base is not None:
            return there.base
        return sum(self.drawn(other) for other in self.names[: self.names.index(name)])

    @property
    def has_ids(self) -> bool:
        """Whether frames have instance ids, though every class may be pruned whole."""
        based = any(one.base is not None for one in self.contents.classes.values())
        return based or self.contents.needs_ids

    def place(self, name: str, local_id: int) -> int | None:
        """Index of an instance in its class; None where it is not in the stage."""
        there = self.contents.classes.get(name)
        if there is None:
            return None
        ids = there.ids
        if ids is None and self.record is not None and name in self.record.classes:
            # The stage has no ids: those that were kept, in their order, are what it has.
            one = self.record.classes[name]
            ids = one.ids[[one.of(int(i)).kept for i in one.ids]]
        if ids is None:
            return local_id - 1 if 1 <= local_id <= there.count else None
        at = int(np.searchsorted(ids, local_id))
        return at if at < len(ids) and int(ids[at]) == local_id else None


def _require_class(index: _BatchIndex, name: str) -> str:
    if name not in index.names:
        hint = nearest(name, index.names) if index.names else "; there are no objects"
        raise OutputError(f"{index.data.folder}: no class {name!r}{hint}")
    return name


def _of_class(index: _BatchIndex, name: str) -> Why:
    there = index.contents.classes.get(name)
    kept = 0 if there is None else there.count
    record = index.record.classes.get(name) if index.record is not None else None
    counts = {} if record is None else {str(r): n for r, n in record.counts().items()}
    drawn = index.drawn(name)
    text = f"{kept:,} of {drawn:,}" + ("" if record is not None else f"; {_NOTHING_MISSING}")
    return Why(name, index.data.name, kept > 0, "class", text, counts=counts)


def _of_id(index: _BatchIndex, number: int) -> Why:
    if not index.has_ids:
        raise OutputError(
            f"{index.data.folder}: its frames have no instance ids, since no sensor asks for "
            f"instances; ask by class and number{_example(index)}"
        )
    ranges = [(name, index.base(name), index.drawn(name)) for name in index.names]
    for name, base, drawn in ranges:
        if base < number <= base + drawn:
            return _of_instance(index, name, number - base)
    last = max(base + drawn for _, base, drawn in ranges)
    said = ", ".join(
        f"{name} {base + 1} to {base + drawn}" for name, base, drawn in ranges if drawn
    )
    hint = "0 is no instance" if number == 0 else f"ids go from 1 to {last}"
    raise OutputError(f"{index.data.folder}: no instance {number}: {hint} ({said})")


def _example(index: _BatchIndex) -> str:
    return f", {index.names[0]}/1 for example" if index.names else ""


def _of_instance(index: _BatchIndex, name: str, local_id: int) -> Why:
    drawn = index.drawn(name)
    if not 1 <= local_id <= drawn:
        known = f"the numbers 1 to {drawn:,}" if drawn else "no object"
        raise OutputError(f"{index.data.folder}: {name} has {known}, not {local_id}")
    record = index.record.classes.get(name) if index.record is not None else None
    reason = Reason.ALL if record is None else record.of(local_id)
    at = index.place(name, local_id)
    if record is None and at is None:
        reason = Reason.NOT_PLACED
    if reason.kept != (at is not None):
        raise OutputError(f"{index.data.folder}: its record and its stage differ; compile again")
    words = _NOTHING_MISSING if record is None and reason.kept else reason.text
    there = index.contents.classes.get(name)
    shown = index.has_ids if there is None else there.base is not None
    what = f"{name}/{local_id}"
    frame_id = index.base(name) + local_id if shown else None
    if at is None or there is None:
        return Why(what, index.data.name, False, str(reason), words, frame_id)
    x, y, z = there.positions[at].tolist()
    sight = nearest_camera(index.data.stage, (x, y, z))
    return Why(
        what,
        index.data.name,
        True,
        str(reason),
        words,
        frame_id,
        (x, y, z),
        _level(index.data.report.objects[name], there, at, sight),
        sight,
    )


def _level(entry: ClassFacts, there: ClassContents, at: int, sight: Sight | None) -> Level:
    mesh = there.meshes[there.which[at]]
    triangles = int(there.triangles[there.which[at]])
    known = entry.levels.get(mesh)
    if known is None:
        return Level(mesh, triangles)
    error = known.error * float(there.scales[at])
    return Level(mesh, triangles, error, None if sight is None else error * sight.pixels_per_m)


def _level_text(level: Level) -> str:
    text = f"{level.mesh}, {level.triangles:,} triangles"
    if level.error_m is None:
        return text
    if level.error_m == 0.0:
        return f"{text}: the finest"
    pixels = "" if level.error_px is None else f", {level.error_px:.2g} px as seen from there"
    return f"{text}: {level.error_m:.2g} m off the finest{pixels}"


def _of_prim(index: _BatchIndex, path: str) -> Why:
    if path.startswith(_OBJECTS):
        name, _, rest = path.removeprefix(_OBJECTS).partition("/")
        _require_class(index, name)
        if not rest:
            return _of_class(index, name)
        number = rest.split("/")[0].removeprefix(_SINGLE)
        if rest.startswith(_SINGLE) and number.isascii() and number.isdigit():
            return _of_instance(index, name, int(number))
        if name not in index.contents.classes:
            # What stood below it is gone with it.
            return _of_class(index, name)
    if path.startswith(_TERRAIN):
        tile = path.removeprefix(_TERRAIN).split("/")[0]
        triangles = index.contents.tiles.get(tile)
        gone = {} if index.record is None else index.record.tiles
        if triangles is not None:
            return Why(path, index.data.name, True, "tile", "it is a tile of the terrain",
                       triangles=triangles)  # fmt: skip
        if tile in gone:
            return Why(path, index.data.name, False, str(gone[tile]), gone[tile].text)
        known = [*index.contents.tiles, *gone]
        raise OutputError(
            f"{index.data.folder}: the terrain has no tile {tile!r}{nearest(tile, known)}"
        )
    return _of_other(index, path)


def _of_other(index: _BatchIndex, path: str) -> Why:
    """A prim that is neither of the terrain nor an object: a material, a light, a camera."""
    from pxr import Sdf

    from scenec.backends.stage.sources import open_stage

    with open_stage(index.data.stage) as stage:
        there = Sdf.Path.IsValidPathString(path) and stage.GetPrimAtPath(path)
        known = [str(prim.GetPath()) for prim in stage.TraverseAll()]
    if there:
        return Why(path, index.data.name, True, "prim", "it is one of its prims")
    last = path.rsplit("/", 1)[-1]
    for entry in index.data.report.left_out:
        if last in entry.what.partition(":")[0].split("/"):
            return Why(path, index.data.name, False, "left out", f"{entry.what}: {entry.why}")
    raise OutputError(f"{index.data.folder}: no prim {path}{nearest(path, known)}")
