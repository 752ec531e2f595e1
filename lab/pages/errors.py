"""Makes the ladders of docs/errors.md: error against cost of the compiler's approximations.

    python lab/pages/errors.py [--fast] [-o FOLDER]

Needs the extra "demo" (matplotlib). Seconds are readings on the machine that runs it; errors and
bytes are facts of the code.
"""

from __future__ import annotations

from collections.abc import Mapping

from scenec.compiler.cfg.load import load
from scenec.lab.runner import ROOT, Page, run, table
from scenec.quality.ladder import APPROXIMATIONS, Ladder, LadderReport
from scenec.quality.ladder.base import Base
from scenec.quality.ladder.plots import draw
from scenec.quality.ladder.results import cells, units
from scenec.quality.ladder.run import climb_base
from scenec.quality.ladder.slopes import Slope

#: Cfgs that ship, all with seed 1, batch 0, and which approximations of each are shown: together
#: every one, in some minutes.
SCENES = {
    "jacksboro": tuple(name for name in APPROXIMATIONS if name != "craters"),
    "lunar_mare": ("tessellation", "craters"),
    "mars_yard": ("sky",),
}
_RUNGS, _FAST = 4, 2


def scene(page: Page, name: str, told: set[str]) -> str:
    """All ladders of one cfg; ``told`` holds what the page says already."""
    base = Base(load(ROOT / "configs" / f"{name}.json"), 1, 0)
    only = ("lod", "sky") if page.fast else SCENES[name]
    report = climb_base(base, only, _FAST if page.fast else _RUNGS)
    draw(page.picture(name), report)
    shown = f"![measured and claimed errors of {name}](pictures/{page.picture(name).name})\n"
    parts = [f"## {name}\n", shown]
    parts += [ladder_text(ladder, told) for ladder in report.ladders]
    return "\n".join(parts) + findings(report)


def ladder_text(ladder: Ladder, told: set[str]) -> str:
    """One ladder: table, what it is against, what half the error costs."""
    header, rows = cells(ladder)
    rows = [[f"**{value}**" if used else value, *rest] for value, used, *rest in rows]
    # Columns in which nothing stands.
    columns = [
        column
        for column in zip([header[0], *header[2:]], *rows, strict=True)
        if set(column[1:]) != {"-"}
    ]
    header, *rows = map(list, zip(*columns, strict=True))
    lines = [f"Against: {ladder.reference}."]
    lines += [f"Claim: {ladder.claim}."] if "claimed" in header else []
    lines += [f"{note[0].upper()}{note[1:]}." for note in ladder.notes]
    lines = [line for line in lines if line not in told]
    told.update(lines)
    return (
        f"### {ladder.name}: {ladder.what}, in {units(ladder)}\n\n"
        + table(header, rows)
        + "\n"
        + "\n".join(f"- {line}" for line in [*lines, half(ladder.slopes)])
        + "\n"
    )


def half(slopes: Mapping[str, Slope | None]) -> str:
    """What half the rms error costs."""
    bought = {over: found.halving for over, found in slopes.items() if found and found.halving}
    said = [f"{times:.3g} times the {over}" for over, times in bought.items()]
    rest = " and ".join(over for over in slopes if over not in bought)
    said += [f"{rest} do not buy it"] if rest else []
    return f"Half the rms error: {', '.join(said)}."


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
    return "\nClaims that do not hold:\n\n" + "\n".join(lines) + "\n" if lines else ""


def main(page: Page) -> None:
    """Refreshes the page, whose tables are as many as there are approximations."""
    told: set[str] = set()
    page.value("ladders", "\n\n" + "\n".join(scene(page, name, told) for name in SCENES))
    page.refresh(("numpy", "numba"), ())


if __name__ == "__main__":
    run(main, page="errors")
