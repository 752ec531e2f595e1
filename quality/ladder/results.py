"""Holds the results of ladders, for people, scripts and plots."""

from __future__ import annotations

import io
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from functools import cached_property
from typing import Literal

from scenec.quality.ladder.cost import Clock
from scenec.quality.ladder.points import Floats, rms, worst
from scenec.quality.ladder.slopes import Slope, slope
from scenec.schemas.codec import Facts
from scenec.schemas.csv_cells import csv_writer, guarded_line

#: All there are, in the order of reports.
APPROXIMATIONS = ("tessellation", "lod", "sky", "smoothing", "craters", "textures")

#: What rounding may add to a measured error before a claim counts as broken.
_HAIR = 1e-6


@dataclass(frozen=True)
class Rung:
    """One value of an approximation.

    Attributes:
        value: Of what is varied.
        used: Whether the cfg has it.
        worst, rms: Error that was measured, in the ladder's unit.
        claimed: Error that the compiler itself states for this value, in that unit; None: it
            states none.
        seconds: Of the processor, all threads together; of the machine, not of the scene.
        bytes: That it takes in the stage.
        triangles: Of what it shapes, or None where it shapes none.
        details: Further numbers.
    """

    value: float
    used: bool
    worst: float
    rms: float
    claimed: float | None
    seconds: float
    bytes: int
    triangles: int | None = None
    details: dict[str, float | int | bool] = field(default_factory=dict)

    @classmethod
    def of(
        cls,
        error: Floats,
        clock: Clock,
        size: int,
        triangles: int | None = None,
        **details: float | bool,
    ) -> Rung:  # fmt: skip
        """Makes a rung of errors at points, float64 [n]; its value is set when it is known."""
        seconds, worst_, rms_ = clock.seconds, worst(error), rms(error)
        return cls(0.0, False, worst_, rms_, None, seconds, size, triangles, details)


@dataclass(frozen=True)
class Ladder:
    """One approximation over a range of values.

    Attributes:
        name: One of ``APPROXIMATIONS``.
        what: What is varied: a key of the cfg, or a constant of the code.
        unit: Of the errors.
        reference: What errors are measured against.
        claim: What ``claimed`` is, or why there is none.
        claim_of: The measured error that it is a claim of.
        rungs: From the coarsest to the finest.
        notes: What else is to be known.
    """

    name: str
    what: str
    unit: str
    reference: str
    claim: str
    claim_of: Literal["worst", "rms"]
    rungs: tuple[Rung, ...]
    notes: tuple[str, ...] = ()

    def measured(self, rung: Rung) -> float:
        """The measured error that a rung's claim is about."""
        return rung.worst if self.claim_of == "worst" else rung.rms

    def holds(self, rung: Rung) -> bool | None:
        """Whether a rung's claim bounds what was measured; None: it makes none."""
        if rung.claimed is None:
            return None
        return self.measured(rung) <= rung.claimed * (1.0 + _HAIR)

    @cached_property
    def slopes(self) -> dict[str, Slope | None]:
        """Returns slopes of the rms error over seconds, bytes, and triangles if there are some."""
        errors = [rung.rms for rung in self.rungs]
        found = {
            "seconds": slope([rung.seconds for rung in self.rungs], errors),
            "bytes": slope([float(rung.bytes) for rung in self.rungs], errors),
        }
        triangles = [rung.triangles for rung in self.rungs if rung.triangles is not None]
        if len(triangles) == len(self.rungs):
            found["triangles"] = slope([float(count) for count in triangles], errors)
        return found

    def as_json(self) -> Facts:
        """Everything, finite numbers only."""
        return {
            "name": self.name,
            "what": self.what,
            "unit": self.unit,
            "reference": self.reference,
            "claim": self.claim,
            "claim_of": self.claim_of,
            "rungs": [{**asdict(rung), "claim_holds": self.holds(rung)} for rung in self.rungs],
            "slopes": {
                over: None if found is None else asdict(found)
                for over, found in self.slopes.items()
            },
            "notes": list(self.notes),
        }


def units(ladder: Ladder) -> str:
    """The unit of a ladder's errors, in words."""
    return {"px": "pixels of the nearest view", "m": "meters", "relative": "parts of the mean"}[
        ladder.unit
    ]


def cells(ladder: Ladder) -> tuple[list[str], list[list[str]]]:
    """Header and rows of a ladder's table; a star marks the cfg's own value."""
    pixels = all("worst_px" in rung.details for rung in ladder.rungs)
    meters = all("worst_m" in rung.details for rung in ladder.rungs)
    header = ["value", "", "worst", "rms", "claimed", "holds"]
    header += ["worst, m"] if meters else ["worst, px"] if pixels else []
    header += ["CPU s", "bytes", "triangles"]
    rows = []
    for rung in ladder.rungs:
        row = [f"{rung.value:g}", "*" if rung.used else "", f"{rung.worst:.3g}", f"{rung.rms:.3g}"]
        row.append("-" if rung.claimed is None else f"{rung.claimed:.3g}")
        row.append({None: "-", True: "yes", False: "NO"}[ladder.holds(rung)])
        if meters or pixels:
            row.append(f"{rung.details['worst_m' if meters else 'worst_px']:.3g}")
        row += [f"{rung.seconds:.3g}", f"{rung.bytes:,}"]
        row.append("-" if rung.triangles is None else f"{rung.triangles:,}")
        rows.append(row)
    return header, rows


@dataclass(frozen=True)
class LadderReport:
    """All ladders of one scene.

    Attributes:
        scene: The cfg's name.
        seed, batch: Of the scene.
        ladders: In the order of ``APPROXIMATIONS``; one can have several.
        absent: Name of an approximation that was asked for -> why it has no ladder here.
    """

    scene: str
    seed: int
    batch: int
    ladders: tuple[Ladder, ...]
    absent: dict[str, str]

    def as_json(self) -> Facts:
        """Everything, finite numbers only."""
        return {
            "scene": self.scene,
            "seed": self.seed,
            "batch": self.batch,
            "ladders": [ladder.as_json() for ladder in self.ladders],
            "absent": dict(self.absent),
        }

    def as_csv(self) -> str:
        """One line a rung, with a header; details are left out."""
        out = io.StringIO()
        writer = csv_writer(out)
        writer.writerow(
            ["scene", "batch", "ladder", "what", "value", "used", "unit", "worst", "rms",
             "claimed", "claim_of", "claim_holds", "seconds", "bytes", "triangles"]
        )  # fmt: skip
        for ladder in self.ladders:
            for rung in ladder.rungs:
                line = [
                    self.scene, self.batch, ladder.name, ladder.what, rung.value,
                    _word(rung.used), ladder.unit, rung.worst, rung.rms, _cell(rung.claimed),
                    ladder.claim_of, _word(ladder.holds(rung)), rung.seconds, rung.bytes,
                    _cell(rung.triangles),
                ]  # fmt: skip
                writer.writerow(guarded_line(line))
        return out.getvalue()


def _cell(value: float | None) -> float | str:
    return "" if value is None else value


def _word(value: bool | None) -> str:
    return "" if value is None else str(value).lower()


def steps(finer: int, coarser: int) -> Sequence[float]:
    """Factors 2^coarser ... 2^-finer on a tolerance, from the coarsest to the finest."""
    return [2.0**k for k in range(coarser, -finer - 1, -1)]


def split(rungs: int) -> tuple[int, int]:
    """Divides a number of rungs into finer and coarser ones than the setting in use.

    Finer ones are what takes the time: a third of them.
    """
    finer = (rungs - 1) // 3
    return finer, rungs - 1 - finer
