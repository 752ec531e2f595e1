"""Is the stated error of a picture true: over drawn scenes, how often is it below its 95 % bound.

    python lab/benchmarks/estimate.py [--scenes 100] [--first 0] [--error 0.1] [--fast]

Each scene is a cfg drawn from its number (suns from 3 degrees up, skies or none, gloss, metals,
glowing stones, a planetary law), seen at 48 x 32 by Mitsuba. A scene that shows no lit surface (a
camera that looks past the ground's edge, a night) says nothing of noise: it is left out, and the
next number is drawn, until there are as many scenes as were asked for.

Against a reference of its own noise, whose variance (from its halves) is subtracted, each scene
gives: one picture of 8, 16, 32 or 64 samples per pixel in turn (the calibration asked for: its
true relative rms error is below the bound in 90 to 99 % of scenes), one picture at each of these
(how sure that share is), and one picture rendered in rounds to a target error (a bound that is
looked at after every round errs a little more often).
"""

from __future__ import annotations

import sys
from collections.abc import Sequence

import numpy as np

from scenec.lab.runner import Cell, Study, run
from scenec.testing.drawn_scenes import MOST, REFERENCE, SPP, Trial, rendered


def trials(count: int, first: int, error: float) -> tuple[dict[str, list[Trial]], int]:
    """Single, pooled and adaptive trials of scenes; how many more showed nothing lit."""
    found: dict[str, list[Trial]] = {"single": [], "pooled": [], "adaptive": []}
    number = first
    while len(found["single"]) < count:
        scene = rendered(number, error)
        number += 1
        if scene is None:
            continue
        each = scene.single
        found["single"].append(each[len(found["single"]) % len(SPP)])
        found["pooled"] += each
        found["adaptive"] += [] if scene.rounds is None else [scene.rounds]
        pairs = ", ".join(f"{t.true / t.bound:.3f}" for t in each if t.bound > 0.0)
        print(f"scene {number - 1}: true over bound {pairs}", file=sys.stderr, flush=True)
    return found, number - first - count


def main(study: Study) -> None:
    """Measure and print."""
    options = study.options
    count = 3 if study.fast else options.scenes
    found, dark = trials(count, options.first, options.error)
    study.say(f"{count} drawn scenes, 48 x 32, reference {2 * REFERENCE} samples per pixel;")
    study.say(f"{dark} more showed no lit surface and were drawn again.\n")
    pooled, adaptive = found["pooled"], found["adaptive"]
    rows = [_row("one picture a scene", found["single"]), _row("four pictures a scene", pooled)]
    rows += [_row(f"of these at {spp} spp", [t for t in pooled if t.spp == spp]) for spp in SPP]
    if adaptive:
        rows.append(_row(f"in rounds to {100 * options.error:g} %", adaptive))
        met = [t.true <= options.error for t in adaptive]
        rows.append(["true error below that target", *share(met), None, None])
    header = ["pictures", "bound holds", "share", "95 % interval", "true/est.", "bound/est."]
    study.table(header, rows)
    study.say(f"Target not met within {MOST} spp: {count - len(adaptive)} scenes.")


def share(held: Sequence[bool]) -> list[str]:
    """Count, share and its 95 % interval (Clopper and Pearson 1934), in words."""
    from scipy.stats import binomtest

    if not held:
        return ["0 of 0", "-", "-"]
    interval = binomtest(sum(held), len(held)).proportion_ci(0.95)
    return [
        f"{sum(held)} of {len(held)}",
        f"{100 * sum(held) / len(held):.1f} %",
        f"{100 * interval.low:.1f} to {100 * interval.high:.1f} %",
    ]


def _row(name: str, found: list[Trial]) -> list[Cell]:
    known = [t for t in found if t.estimate > 0.0]
    ratio = np.median([t.true / t.estimate for t in known])
    width = np.median([t.bound / t.estimate for t in known])
    return [name, *share([t.below for t in found]), ratio, width]


if __name__ == "__main__":
    run(main, scenes=100, first=0, error=0.1)
