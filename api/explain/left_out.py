"""Lists what a batch leaves out, most effective first, with what that spares."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from dataclasses import dataclass, replace

from scenec.api.explain.data import BatchData
from scenec.api.explain.stage import StageContents
from scenec.schemas.codec import Facts
from scenec.schemas.report import BatchReport, ClassFacts, MeshFacts, SurfaceFacts

#: Bytes that stand for a triangle where nothing was rendered: three corners in float32.
_TRIANGLE = 36


@dataclass(frozen=True)
class LeftOut:
    """One thing that is not in the stage.

    Attributes:
        what: The cfg's path of the thing, then what of it.
        why: In words.
        instances, triangles, bytes: How much that spares.
        seconds: The same, estimated from the output's own timings; None where there are none.
    """

    what: str
    why: str
    instances: int = 0
    triangles: int = 0
    bytes: int = 0
    seconds: float | None = None

    @property
    def weight(self) -> float:
        """Bytes, with triangles as what they take where none was rendered."""
        return self.bytes + _TRIANGLE * self.triangles


@dataclass(frozen=True)
class Rates:
    """Holds this batch's costs of a byte and of a triangle.

    Attributes:
        emit_s: Seconds that writing the stage took; None where it is not known.
        bytes: Of the stage.
        load_s: Seconds that a renderer took to load it, of the slowest; None: nothing was rendered.
        triangles: That it loaded.
        backend: Its name.
    """

    emit_s: float | None
    bytes: int
    load_s: float | None
    triangles: int
    backend: str

    def seconds(self, one: LeftOut) -> float | None:
        """Estimates the seconds that leaving something out spared; None if too little is known."""
        if not self.known:
            return None
        assert self.emit_s is not None
        assert self.load_s is not None
        return self.emit_s / self.bytes * one.bytes + self.load_s / self.triangles * one.triangles

    @property
    def known(self) -> bool:
        """Whether there are timings of both writing and loading."""
        known = self.emit_s is not None and self.load_s is not None
        return known and self.bytes > 0 and self.triangles > 0

    @property
    def text(self) -> str:
        """Describes how seconds are estimated."""
        if not self.known:
            return "seconds saved are not known: nothing was rendered, or there are no timings"
        return (
            "* estimated from this output's own timings: writing "
            f"{self.bytes:,} bytes took {self.emit_s:.3g} s, loading {self.triangles:,} triangles "
            f"{self.load_s:.3g} s ({self.backend})"
        )


@dataclass(frozen=True)
class Parts:
    """Holds how much of a batch is in its stage: (in it, of how much)."""

    instances: tuple[int, int]
    triangles: tuple[int, int]
    bytes: tuple[int, int]

    @property
    def text(self) -> str:
        """In one line."""
        (i, of_i), (t, of_t), (b, of_b) = self.instances, self.triangles, self.bytes
        return (
            f"kept {i:,} of {of_i:,} instances, {t:,} of {of_t:,} triangles, "
            f"{size(b)} of {size(of_b)}"
        )


def rates_of(batch: BatchData, contents: StageContents) -> Rates:
    """Measures a batch's costs of a byte and of a triangle."""
    loads = [(one.seconds["load"], one.backend) for one in batch.frames if "load" in one.seconds]
    load, backend = max(loads, default=(None, ""))
    return Rates(batch.seconds.get("emit"), batch.report.bytes, load, contents.triangles, backend)


def left_out_of(report: BatchReport, rates: Rates | None = None) -> list[LeftOut]:
    """Lists what is not in the stage, most effective first.

    By seconds where they can be estimated, else by bytes and triangles; then by instances.

    Args:
        report: Of the batch.
        rates: For seconds.
    """
    found = [
        LeftOut(one.what, one.why, one.instances, one.triangles, one.bytes or 0)
        for one in report.left_out
    ]
    found += _coarser_ground(report.ground.mesh)
    for name, entry in report.objects.items():
        found += _coarser_objects(name, entry)
        why = f"of a model of objects/{name}; the surface model has no place for it"
        found += [LeftOut(note, why) for note in entry.left_out]
    for name, surface in report.surfaces.items():
        found += _smaller_pictures(name, surface)
    if rates is not None:
        found = [replace(one, seconds=rates.seconds(one)) for one in found]
    return sorted(found, key=lambda one: (-(one.seconds or 0.0), -one.weight, -one.instances))


def parts_of(report: BatchReport, contents: StageContents, left: Sequence[LeftOut]) -> Parts:
    """Measures how much of a batch is in its stage.

    Args:
        report: Of the batch.
        contents: What the stage holds.
        left: What is not in it.
    """
    instances, triangles, written = contents.instances, contents.triangles, report.bytes
    return Parts(
        (instances, instances + sum(one.instances for one in left)),
        (triangles, triangles + sum(one.triangles for one in left)),
        (written, written + sum(one.bytes for one in left)),
    )


def left_out_text(left: Sequence[LeftOut], rates: Rates, width: int) -> str:
    """The list: one thing a line, why in the next.

    Args:
        left: As ``left_out_of`` returns it.
        rates: What seconds were estimated from.
        width: Columns there are.
    """
    if not left:
        return "left out: nothing"
    mark = "seconds*" if rates.known else ""
    room = width - 47
    head = "left out, most effective first"
    titles = f"{'instances':>10}  {'triangles':>12}  {'bytes':>9}  {mark:>8}"
    lines = [f"{head:<{room}}  {titles}".rstrip()]
    for one in left:
        spared = "" if not one.seconds else f"{one.seconds:.2g}"
        parts = textwrap.wrap(one.what, room - 2, break_on_hyphens=False) or [""]
        numbers = [f"{n:,}" if n else "" for n in (one.instances, one.triangles)]
        much = size(one.bytes) if one.bytes else ""
        lines.append(
            f"  {parts[0]:<{room - 2}}  {numbers[0]:>10}  {numbers[1]:>12}  {much:>9}  "
            f"{spared:>8}".rstrip()
        )
        lines += [f"  {part}" for part in parts[1:]]
        lines += [f"      {part}" for part in textwrap.wrap(one.why, width - 6)]
    lines += textwrap.wrap(rates.text, width)
    return "\n".join(lines)


def as_json(left: Sequence[LeftOut]) -> list[Facts]:
    """The list for scripts."""
    return [dict(vars(one)) for one in left]


def size(number: int) -> str:
    """A number of bytes as people say it."""
    value, unit = float(number), "B"
    for larger in ("KiB", "MiB", "GiB"):
        if abs(value) < 1000.0:
            break
        value, unit = value / 1024.0, larger
    return f"{value:.0f} {unit}" if unit == "B" else f"{value:.3g} {unit}"


def _coarser_ground(mesh: MeshFacts | None) -> list[LeftOut]:
    if mesh is None or mesh.triangles >= mesh.triangles_of_grid:
        return []
    spared = mesh.triangles_of_grid - mesh.triangles
    why = f"no view shows more than {mesh.tolerance_reached_px:.2g} px of them"
    return [LeftOut("terrain: triangles of the grid", why, triangles=spared)]


def _coarser_objects(name: str, entry: ClassFacts) -> list[LeftOut]:
    spared = entry.triangles_spared
    if spared <= 0:
        return []
    why = f"coarser levels of detail show errors of {entry.lod_error_max_px:.2g} px at most"
    return [LeftOut(f"objects/{name}: finer levels of detail", why, triangles=spared)]


def _smaller_pictures(name: str, entry: SurfaceFacts) -> list[LeftOut]:
    found = []
    for kind, picture in entry.pictures.items():
        if picture.bytes_saved <= 0 or picture.texels_kept is None:
            continue
        wide, high = picture.texels_kept
        why = f"a pixel shows no more than {wide} × {high} of them"
        what = f"materials/{name}: texels of {kind.replace('_', ' ')}"
        found.append(LeftOut(what, why, bytes=int(picture.bytes_saved)))
    return found
