"""Writes docs/errors.md: error against cost of the compiler's approximations, for shipped cfgs.

    python lab/pages/errors.py [--fast] [-o FOLDER]

Needs the extra "demo" (matplotlib). Seconds are readings on the machine that runs it; errors and
bytes are facts of the code.
"""

from __future__ import annotations

from functools import partial

from scenec.compiler.cfg.load import load
from scenec.lab.runner import ROOT, Page, run, table
from scenec.quality.ladder import APPROXIMATIONS, Ladder, LadderReport
from scenec.quality.ladder.base import Base
from scenec.quality.ladder.plots import draw
from scenec.quality.ladder.results import cells, units
from scenec.quality.ladder.run import climb_base
from scenec.quality.ladder.slopes import slope_text

#: Cfgs that ship, all with seed 1, batch 0, and which approximations of each are shown: together
#: every one, in some minutes.
SCENES = {
    "jacksboro": APPROXIMATIONS,
    "lunar_mare": ("tessellation", "lod", "sky", "smoothing", "craters"),
    "mars_yard": ("sky",),
}
_RUNGS, _FAST = 4, 2

HEAD = """# Error against cost of the compiler's approximations

The compiler approximates: meshes, levels of detail, skies, smoothing, pictures. This page varies
each approximation alone, in three cfgs that ship (seed 1, batch 0), around the cfg's value, which
is **bold**. `scenec explain OUT --ladder` measures the same for any output.

- **worst** and **rms** are measured against a reference that does not depend on the rung: the
  surface itself, the finest meshes, the atmosphere evaluated ray by ray. It stands below each
  table. A worst case over points is a lower bound of the worst there is.
- **claimed** is what the compiler itself states for that value (`report.json`), and **holds**
  says whether that bounds the measured error; "-" where it states nothing.
- **CPU s** is the processor time, over all threads, to make and write what the approximation
  shapes, on {cores} cores ({versions}): a single reading if it is long; below a second, the mean of
  repetitions that take 0.3 s together, after a first call. **bytes** is its size in the stage,
  before leaving out what no camera sees.
- Slopes are of the rms error, fitted through logarithms over all rungs: where error ~ cost^-a, half
  the error costs 2^(1/a) times as much. For triangles of a smooth surface theory gives a = 1 (the
  error of linear interpolation grows with the square of an edge). Fine detail, and a tolerance in
  pixels, which lets far ground be coarse, change it.

In the plots filled marks are measured errors, open marks are claims, and squares are the cfg's
values.
"""


def scene(page: Page, name: str) -> str:
    """All ladders of one cfg."""
    base = Base(load(ROOT / "configs" / f"{name}.json"), 1, 0)
    only = ("lod", "sky") if page.fast else SCENES[name]
    report = climb_base(base, only, _FAST if page.fast else _RUNGS)
    draw(page.picture(name), report)
    shown = f"![measured and claimed errors of {name}](pictures/{page.picture(name).name})\n"
    parts = [f"## {name}\n", shown]
    parts += [ladder_text(ladder) for ladder in report.ladders]
    parts += [f"No ladder of {what}: {why}.\n" for what, why in report.absent.items()]
    return "\n".join(parts) + findings(report)


def ladder_text(ladder: Ladder) -> str:
    """One ladder: table, what it is against, slopes."""
    header, rows = cells(ladder)
    rows = [[f"**{value}**" if used else value, *rest] for value, used, *rest in rows]
    lines = [f"Against: {ladder.reference}.", f"Claim: {ladder.claim}."]
    lines += [f"The rms error {slope_text(over, found)}." for over, found in ladder.slopes.items()]
    lines += [f"{note[0].upper()}{note[1:]}." for note in ladder.notes]
    return (
        f"### {ladder.name}: {ladder.what}\n\nErrors in {units(ladder)}.\n\n"
        + table([header[0], *header[2:]], rows)
        + "\n"
        + "\n".join(f"- {line}" for line in lines)
        + "\n"
    )


def findings(report: LadderReport) -> str:
    """Claims that do not bound what was measured, and the largest excess of each."""
    lines = []
    for ladder in report.ladders:
        broken = [
            (ladder.measured(rung) / rung.claimed, rung)
            for rung in ladder.rungs
            if ladder.holds(rung) is False and rung.claimed
        ]
        if broken:
            factor, rung = max(broken, key=lambda one: one[0])
            lines.append(
                f"- {ladder.name} ({ladder.what}): {len(broken)} of {len(ladder.rungs)} claims are "
                f"exceeded, at most {factor:.4g} times (at {rung.value:g})"
            )
    if not lines:
        return "\nEvery claim made here bounds what was measured.\n"
    return "\nClaims that do not bound what was measured:\n\n" + "\n".join(lines) + "\n"


def main(page: Page) -> None:
    """Writes the page."""
    page.write(HEAD, ("scenec", "numpy", "numba"), [partial(scene, name=name) for name in SCENES])


if __name__ == "__main__":
    run(main, page="errors")
