"""Is the stated error of a picture true: over drawn scenes, how often is it below its 95 % bound.

    python studies/benchmarks/estimate.py [--scenes 100] [--first 0] [--error 0.15]
                                          [--keep FOLDER] [--json FILE] [--fast]

Each scene is a cfg drawn from its number (suns from 3 degrees up, skies or none, gloss, metals,
glowing stones, a planetary law), seen at 48 x 32 by Mitsuba. A scene that shows no lit surface (a
camera that looks past the ground's edge, a night) says nothing of noise: it is left out, and the
next number is drawn, until there are as many scenes as were asked for.

Against a reference of its own noise, whose variance (from its halves) is subtracted, each scene
gives: one picture of 8, 16, 32 or 64 samples per pixel in turn (the calibration asked for: its
true relative rms error is below the bound in 90 to 99 % of scenes), one picture at each of these
(how sure that share is), and one picture rendered in rounds to a target error (a bound that is
looked at after every round errs a little more often). Samples of Mitsuba are independent: a
picture of 64 is the mean of two of 32, and a round of 40 that of one of 32 and one of 8, so one set
of small pictures serves all. With ``--keep`` they are kept, a file a scene, and a run that was
broken off goes on; a changed estimate is judged without rendering again.
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
from scenec.backends.picture.adaptive import Target, collect, round_seed
from scenec.backends.picture.noise import estimate
from scenec.backends.run.session import Session
from scenec.compiler.compile import compile_cfg
from scenec.studies.runner import Cell, Study, run

from small import small_cfg

#: Samples per pixel of single pictures.
SPP = (8, 16, 32, 64)
#: Samples per pixel of a scene's small pictures, and how many there are.
SMALL, LARGE = (8, 14), (32, 6)
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
class Pictures:
    """One scene's.

    Attributes:
        reference: Its halves, [2, h, w, 3].
        small, large: Halves of each picture, [n, 2, h, w, 3].
        covered: Pixels that surfaces touch in any of them, [h, w].
    """

    reference: NDArray[np.float32]
    small: NDArray[np.float32]
    large: NDArray[np.float32]
    covered: NDArray[np.bool_]

    def mean(self, small: Sequence[int], large: Sequence[int]) -> NDArray[np.float64]:
        """Halves of the mean of some of them."""
        parts = [(SMALL[0], self.small[i]) for i in small]
        parts += [(LARGE[0], self.large[i]) for i in large]
        total = sum(spp for spp, _ in parts)
        return sum(spp / total * part.astype(np.float64) for spp, part in parts)  # type: ignore[return-value]

    def single(self, spp: int) -> NDArray[np.float64]:
        """A picture of ``SPP``; no two share samples."""
        return self.mean(*{8: ([0], []), 16: ([1, 2], []), 32: ([], [0]), 64: ([], [1, 2])}[spp])

    def true_error(self, halves: NDArray[np.float64]) -> float:
        """Relative rms error, with the reference's own variance subtracted."""
        reference = self.reference.astype(np.float64)
        mean = 0.5 * (reference[0] + reference[1])
        variance = (0.5 * (reference[0] - reference[1])) ** 2
        picture = 0.5 * (halves[0] + halves[1])
        square = float(((picture - mean) ** 2 - variance)[self.covered].mean())
        return math.sqrt(max(square, 0.0)) / float(mean[self.covered].mean())

    def judged(self, spp: int, halves: NDArray[np.float64]) -> Trial:
        """True error beside what its halves tell."""
        noise = estimate(halves, self.covered)
        return Trial(
            spp, self.true_error(halves), noise.relative_rms or 0.0, noise.relative_rms_bound or 0.0
        )

    def to_target(self, error: float) -> Trial | None:
        """The picture that rounds end with; None if there are too few samples for it."""
        small, large = list(range(SMALL[1])), list(range(LARGE[1]))

        def draw(spp: int, _seed: int) -> Radiance:
            taken: tuple[list[int], list[int]] = [], []
            left = spp
            while left > 0 and (small or large):
                if large and (left >= LARGE[0] or not small):
                    taken[1].append(large.pop())
                    left -= LARGE[0]
                else:
                    taken[0].append(small.pop())
                    left -= SMALL[0]
            halves = self.mean(*taken)
            drawn = SMALL[0] * len(taken[0]) + LARGE[0] * len(taken[1])
            return Radiance(halves.astype(np.float32), self.covered.astype(np.float32), drawn)

        most = SMALL[0] * SMALL[1] + LARGE[0] * LARGE[1]
        picture, rounds = collect(draw, 0, Target(error, None, most))
        if rounds.stopped != "error":
            return None
        return self.judged(picture.spp, picture.halves.astype(np.float64))


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


def rendered(number: int) -> Pictures | None:
    """One scene's pictures; None if no lit surface is seen."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "cfg.json"
        path.write_text(json.dumps(drawn_cfg(number)), encoding="utf-8")
        out = compile_cfg(path, seed=number, out=Path(folder) / "out").out
        session = Session.open(out / "batch_0000" / "stage.usda", "mitsuba")
        camera, backend = session.scene.cameras[0][0], session.backend
        backend.load(session.scene)

        def drawn(name: int, spp: int, count: int) -> list[Radiance]:
            return [
                backend.radiance(camera, 0, spp, round_seed(number, name + i)) for i in range(count)
            ]

        large = drawn(1000, *LARGE)
        if not any(one.halves.any() for one in large):
            return None
        small, reference = drawn(2000, *SMALL), drawn(3000, REFERENCE, 2)
        covered = np.any([one.coverage > 0.0 for one in (*small, *large, *reference)], axis=0)

        def halves(made: list[Radiance]) -> NDArray[np.float32]:
            return np.stack([one.halves for one in made])

        return Pictures(
            halves(reference).mean(axis=1), halves(small), halves(large), np.asarray(covered)
        )


def pictures(number: int, keep: Path | None) -> Pictures | None:
    """One scene's pictures, from ``keep`` if they are there."""
    path = None if keep is None else keep / f"{number:04d}.npz"
    if path is not None and path.is_file():
        with np.load(path) as found:
            return None if "black" in found else Pictures(**found)
    made = rendered(number)
    if path is not None:
        aside = path.with_suffix(".part.npz")
        np.savez_compressed(aside, **({"black": np.ones(1)} if made is None else vars(made)))
        aside.rename(path)
    return made


def main(study: Study) -> None:
    """Measure and print."""
    options = study.options
    count = 3 if study.fast else options.scenes
    if options.keep:
        options.keep.mkdir(parents=True, exist_ok=True)
    found: dict[str, list[Trial]] = {"single": [], "pooled": [], "adaptive": []}
    unmet, dark, number = 0, 0, options.first
    while len(found["single"]) < count:
        scene = pictures(number, options.keep)
        number += 1
        if scene is None:
            dark += 1
            continue
        each = [scene.judged(spp, scene.single(spp)) for spp in SPP]
        found["single"].append(each[len(found["single"]) % len(SPP)])
        found["pooled"] += each
        to_target = scene.to_target(options.error)
        unmet += to_target is None
        found["adaptive"] += [] if to_target is None else [to_target]
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
    most = SMALL[0] * SMALL[1] + LARGE[0] * LARGE[1]
    study.say(f"Target not met within {most} spp: {unmet} scenes.")
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
    run(main, scenes=100, first=0, error=0.15, keep=Path, json=Path)
