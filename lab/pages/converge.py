"""Makes what docs/converge.md shows: error against run time of three renderers.

    python lab/pages/converge.py [--fast] [-o FOLDER]

Renders one frame of configs/mars_yard.json, 128 x 96, up a ladder of samples per pixel, with and
without denoising, each rung from four noise seeds; then to an error, and for a time; and drawn
scenes, as lab/benchmarks/estimate.py does.
"""

from __future__ import annotations

import json
import shutil
from itertools import product
from pathlib import Path
from typing import Any

from scenec.backends.run.render import render
from scenec.compiler.compile import compile_cfg
from scenec.lab.benchmarks.estimate import share, trials
from scenec.lab.pictures import beside_assets
from scenec.lab.runner import CONFIGS, Page, run
from scenec.quality.converge import Ladder, converge
from scenec.quality.converge.metrics import Reference, root, square_and_error
from scenec.quality.converge.run import NORMAL_95
from scenec.quality.converge.series import floor_cells, percent, step_cells
from scenec.schemas.frames import read_frame
from scenec.testing.small import small_cfg

CFG = CONFIGS / "mars_yard.json"
BACKENDS = ("mitsuba", "cycles", "pyrender")
#: Drawn scenes, and the error that they are rendered to in rounds.
SCENES, ERROR = 40, 0.1


class Example:
    """One frame, and what was measured on it."""

    def __init__(self, page: Page) -> None:
        self.page = page
        self.ladder = Ladder(
            spp=(4, 16) if page.fast else (4, 16, 64),
            repeats=2 if page.fast else 4,
            reference_spp=64 if page.fast else 512,
            denoise=True,
            samples=range(1),
        )
        cfg = small_cfg() if page.fast else json.loads(CFG.read_text(encoding="utf-8"))
        cfg |= {"samples": 1, "batches": 1}
        for rig in cfg["rigs"].values():
            for sensor in rig["sensors"].values():
                sensor["resolution"] = [64, 48] if page.fast else [128, 96]
        file = beside_assets(page.scratch) / "converge.json"
        file.write_text(json.dumps(cfg), encoding="utf-8")
        self.out = compile_cfg(file, seed=1, out=page.scratch / "out").out
        self.found = converge(self.out, BACKENDS, self.ladder)

    def show(self, name: str) -> None:
        """Copies a picture of the report."""
        shutil.copyfile(self.out / "converge" / name, self.page.picture(Path(name).stem))

    def true_error(self, stem: Path, backend: str) -> str:
        """Measures a frame's error against its backend's reference, with its 95 % interval."""
        frame = read_frame(stem)
        folder = self.out / "converge" / "pictures" / "batch_0000" / backend / "reference"
        first, second = (
            read_frame(folder / name / "frames" / backend / stem.parent.name / stem.name)
            for name in ("first", "second")
        )
        on = first.passes["depth"] < float("inf")
        reference = Reference.of_two(*(one.passes["rgb"][on] for one in (first, second)))
        square, error = square_and_error(frame.passes["rgb"][on], reference)
        low, high = (root(square + sign * NORMAL_95 * error) or 0.0 for sign in (-1, 1))
        return f"{percent(root(square))} ({percent(low)} to {percent(high)})"

    def ladders(self, _: Page) -> None:
        """Tables each backend's convergence to itself, and the slopes of it."""
        own = [series for series in self.found.series if series.own]
        self.page.rows(
            [series.name, *step_cells(step)[:3], f"{percent(step.low)} to {percent(step.high)}",
             *step_cells(step)[3:]]
            for series in own for step in series.steps
        )  # fmt: skip
        self.show("convergence.png")
        self.page.rows(
            [series.name, _slope(series.over_spp), _slope(series.over_seconds),
             series.over_spp.verdict]
            for series in own if series.over_spp is not None
        )  # fmt: skip

    def floors(self, _: Page) -> None:
        """Tables what stays between backends however many samples."""
        self.page.rows([floor_cells(floor) for floor in self.found.floors])
        self.show("floor.png")
        for path in self.found.files:
            if path.parent.name == "differences" and path.stem.endswith("mitsuba_pyrender"):
                self.show(f"differences/{path.name}")

    def targets(self, _: Page) -> None:
        """Renders to an error, and for a time."""
        rows = []
        goals: list[dict[str, Any]] = [{"error": 0.1}, {"error": 0.03}, {"seconds": 1.0},
                                       {"seconds": 4.0}]  # fmt: skip
        for number, (goal, backend) in enumerate(product(goals, ("mitsuba", "cycles"))):
            folder = self.out / "targets" / str(number)
            report = render(self.out, backend, passes=["rgb"], folder=folder, **goal)
            sidecar = read_frame(report.frames[0]).sidecar
            rounds, found = sidecar.rounds, sidecar.error
            assert rounds is not None
            ((name, value),) = goal.items()
            rows.append([
                f"`--backend {backend} --{name} {value:g}`", str(sidecar.samples_per_pixel),
                str(len(rounds.rounds)), f"{rounds.seconds:.2f}",
                percent(found.relative_rms), percent(found.relative_rms_bound_95),
                self.true_error(report.frames[0], backend),
            ])  # fmt: skip
        self.page.rows(rows)

    def estimate(self, _: Page) -> None:
        """Tables how often the bound holds."""
        count = 3 if self.page.fast else SCENES
        found, _ = trials(count, 0, ERROR)
        names = {
            "single": "one picture a scene, 8 to 64 samples",
            "pooled": "four pictures a scene, 8 to 64 samples",
            "adaptive": f"in rounds, `--error {ERROR:g}`",
        }
        rows = [[name, *share([t.below for t in found[key]])] for key, name in names.items()]
        met = [t.true <= ERROR for t in found["adaptive"]]
        rows.append([f"in rounds: true error at most {ERROR:g}", *share(met)])
        self.page.rows(rows)
        self.page.value("scenes", str(count))


def main(page: Page) -> None:
    """Refreshes the page."""
    one = Example(page)
    parts = (one.ladders, one.floors, one.targets, one.estimate)
    packages = ("mitsuba", "bpy", "pyrender-maintained")
    page.refresh(packages, parts)


def _slope(fit: Any) -> str:
    if fit is None:
        return "-"
    sure = "" if fit.low is None else f" ({fit.low:.3f} to {fit.high:.3f})"
    return f"{fit.slope:.3f}{sure}"


if __name__ == "__main__":
    run(main, page="converge")
