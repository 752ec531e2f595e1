"""Is the stated error of a picture true: over drawn scenes, how often is it below its 95 % bound.

    python studies/benchmarks/estimate.py [--scenes 100] [--first 0] [--error 0.1]
                                          [--json FILE] [--fast]

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

import json
import math
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenec.backends.contract import Radiance
from scenec.backends.noise_seeds import round_seed
from scenec.backends.picture.adaptive import Draw, Target, collect
from scenec.backends.picture.noise import estimate
from scenec.backends.run.session import Session
from scenec.compiler.compile import compile_cfg
from scenec.studies.runner import Cell, Study, run

from small import small_cfg

#: Samples per pixel of single pictures.
SPP = (8, 16, 32, 64)
#: Samples per pixel that rounds end at.
MOST = 512
#: Of each of the reference's two halves.
REFERENCE = 1024
#: Few kinds of materials, the rest drawn: Mitsuba compiles anew for each kind.
LOOKS = ("dull", "gloss", "metal", "glow", "planet")


@dataclass(frozen=True)
class Trial:
    """One picture: its true relative rms error, what was estimated, and the bound."""

    spp: int
    true: float
    estimate: float
    bound: float

    @property
    def below(self) -> bool:
        """Whether the bound holds."""
        return self.true <= self.bound


@dataclass
class Truth:
    """What a scene's pictures are held against.

    Attributes:
        reference: Its halves, [2, h, w, 3].
        covered: Pixels that surfaces touch in it, [h, w].
    """

    reference: NDArray[np.float32]
    covered: NDArray[np.bool_]

    def error(self, halves: NDArray[np.float64]) -> float:
        """Relative rms error, with the reference's own variance subtracted."""
        reference = self.reference.astype(np.float64)
        mean = 0.5 * (reference[0] + reference[1])
        variance = (0.5 * (reference[0] - reference[1])) ** 2
        picture = 0.5 * (halves[0] + halves[1])
        square = float(((picture - mean) ** 2 - variance)[self.covered].mean())
        return math.sqrt(max(square, 0.0)) / float(mean[self.covered].mean())

    def judged(self, picture: Radiance) -> Trial:
        """True error beside what its halves tell."""
        halves = picture.halves.astype(np.float64)
        noise = estimate(halves, self.covered)
        bound = noise.relative_rms_bound or 0.0
        return Trial(picture.spp, self.error(halves), noise.relative_rms or 0.0, bound)


@dataclass(frozen=True)
class Trials:
    """One scene's.

    Attributes:
        single: A picture of each of ``SPP``.
        rounds: The picture that rounds end with; None if ``MOST`` samples are too few for it.
    """

    single: list[Trial]
    rounds: Trial | None


def drawn_cfg(number: int) -> dict[str, Any]:
    """A small scene, drawn from its number."""
    rng = np.random.default_rng(number)

    def uniform(low: float, high: float) -> float:
        return round(float(rng.uniform(low, high)), 4)

    look = LOOKS[number % len(LOOKS)]

    def material() -> dict[str, Any]:
        made: dict[str, Any] = {
            "base_color": [uniform(0.02, 0.8) for _ in range(3)],
            "variation": uniform(0.05, 0.4),
        }
        if look in ("gloss", "metal"):
            made |= {"specular": uniform(0.02, 0.3), "roughness": uniform(0.15, 0.9)}
        if look == "metal":
            made |= {"metallic": uniform(0.2, 1.0)}
        return made

    cfg = small_cfg(name=f"drawn{number}", samples=1)
    cfg["terrain"]["size_m"], cfg["terrain"]["spacing_m"] = [14, 12], 0.4
    cfg["terrain"]["relief"][1]["amplitude_m"] = uniform(0.1, 1.5)
    cfg["materials"] = {name: material() for name in cfg["materials"]}
    if look == "glow":
        cfg["materials"]["stone"]["emission"] = [uniform(1.0, 400.0)] * 3
    if look == "planet":
        cfg["materials"]["sand"]["reflectance"] = {"type": "lommel_seeliger"}
    rocks = cfg["objects"]["rocks"]
    rocks["count"], rocks["subdivisions"] = int(rng.integers(5, 120)), 1
    rocks["size_m"] = {"type": "log_uniform", "min": 0.1, "max": uniform(0.5, 2.5)}
    cfg["light"] = {
        "sun": {"elevation_deg": uniform(3, 80), "azimuth_deg": uniform(0, 360)},
        "sky": {"type": "clear", "resolution": 16, "labels": {"class": "sky", "surface": "sky"}},
    }
    dark = rng.random()
    if dark < 0.2:
        cfg["light"]["sky"] = {"type": "none", "labels": {"class": "sky", "surface": "sky"}}
    elif dark < 0.4:
        cfg["light"]["sun"] = None
    position = cfg["rigs"]["rover"]["pose"]["position"]
    position["height_m"] = uniform(0.4, 6.0)
    cfg["rigs"]["rover"]["sensors"]["front"] = {
        "resolution": [48, 32],
        "fov_deg": uniform(30, 100),
    }
    return cfg


def rendered(number: int, error: float) -> Trials | None:
    """One scene's pictures, that in rounds to an error; None if no lit surface is seen."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "cfg.json"
        path.write_text(json.dumps(drawn_cfg(number)), encoding="utf-8")
        out = compile_cfg(path, seed=number, out=Path(folder) / "out").out
        session = Session.open(out / "batch_0000" / "stage.usda", "mitsuba")
        camera, backend = session.scene.cameras[0][0], session.backend
        backend.load(session.scene)

        def draw(spp: int, seed: int, first: int = 0) -> Radiance:
            return backend.radiance(camera, 0, spp, seed, first=first)

        truth = draw(2 * REFERENCE, round_seed(number, 3000))
        if not truth.halves.any():
            return None
        made = Truth(truth.halves, truth.coverage > 0.0)
        return judged(made, draw, number, error, continues=True)


def judged(truth: Truth, draw: Draw, number: int, error: float, continues: bool = False) -> Trials:
    """What comes of pictures of each of ``SPP``, and of rounds to an error."""
    single = [truth.judged(draw(spp, round_seed(number, 1000 + spp))) for spp in SPP]
    seed, target = round_seed(number, 2000), Target(error, None, MOST)
    picture, rounds = collect(draw, seed, target, continues=continues)
    return Trials(single, truth.judged(picture) if rounds.stopped == "error" else None)


def main(study: Study) -> None:
    """Measure and print."""
    options = study.options
    count = 3 if study.fast else options.scenes
    found: dict[str, list[Trial]] = {"single": [], "pooled": [], "adaptive": []}
    unmet, dark, number = 0, 0, options.first
    while len(found["single"]) < count:
        scene = rendered(number, options.error)
        number += 1
        if scene is None:
            dark += 1
            continue
        each = scene.single
        found["single"].append(each[len(found["single"]) % len(SPP)])
        found["pooled"] += each
        unmet += scene.rounds is None
        found["adaptive"] += [] if scene.rounds is None else [scene.rounds]
        pairs = ", ".join(f"{t.true / t.bound:.3f}" for t in each if t.bound > 0.0)
        print(f"scene {number - 1}: true over bound {pairs}", file=sys.stderr, flush=True)
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
    study.say(f"Target not met within {MOST} spp: {unmet} scenes.")
    if options.json:
        lists = {name: [_rounded(t) for t in trials] for name, trials in found.items()}
        about = {"error": options.error, "dark": dark, "unmet": unmet}
        text = json.dumps({**about, **lists}).replace("}, {", "},\n{")
        options.json.write_text(text + "\n", encoding="utf-8")


def _rounded(trial: Trial) -> dict[str, float]:
    return {name: float(f"{value:.6g}") for name, value in vars(trial).items()}


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
    run(main, scenes=100, first=0, error=0.1, json=Path)
