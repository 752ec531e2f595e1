"""Drawn scenes of few pixels and what Mitsuba's pictures of them err, beside what they state."""

from __future__ import annotations

import json
import math
import tempfile
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
from scenec.testing.small import small_cfg

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
        bound = noise.relative_rms_bound_95 or 0.0
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
        camera = session.scene.cameras[0][0]
        backend: Any = session.backend
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
