"""Writes docs/converge.md: error against run time of three renderers, and what follows from it.

python lab/pages/converge.py [--fast] [-o FOLDER]

Renders one frame of configs/mars_yard.json, 128 x 96, up a ladder of samples per pixel, with and
without denoising, each rung from four noise seeds; then to an error, for a time, and with the
backend that the measured curves choose. How often the bound of an error holds takes longer to
measure: the page shows what lab/benchmarks/estimate.py left in docs/converge_estimate.json.
"""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

from scenec.backends.run.render import render
from scenec.compiler.compile import compile_cfg
from scenec.lab.benchmarks.estimate import share
from scenec.lab.runner import ROOT, Page, run, table
from scenec.quality.converge import ConvergeReport, Ladder, converge
from scenec.quality.converge.metrics import FORMULAS, Reference, root, square_and_error
from scenec.quality.converge.run import NORMAL_95
from scenec.quality.converge.series import (
    FLOOR_HEADER,
    STEP_HEADER,
    floor_cells,
    percent,
    step_cells,
)
from scenec.schemas.frames import read_frame
from scenec.testing.small import small_cfg

CFG = "configs/mars_yard.json"
BACKENDS = ("mitsuba", "cycles", "pyrender")
#: Written by ``estimate.py --json``.
ESTIMATE = ROOT / "docs" / "converge_estimate.json"
ERRORS = (0.1, 0.03)
SECONDS = (1.0, 4.0)
HEAD = """# Error against run time

Written by `lab/pages/converge.py` (`make docs`) on {cores} cores with {versions};
seconds are those of that machine, errors follow from the code and the seeds.

    scenec converge OUT --backends mitsuba,cycles,pyrender --denoise

renders each backend at several qualities and compares with a reference of many samples, whose own
noise is subtracted. It writes tables (CSV, JSON), plots and pictures of differences into
`OUT/converge/`.
"""


class Example:
    """One frame, and what was measured on it."""

    def __init__(self, page: Page) -> None:
        self.page = page
        self.ladder = Ladder(
            spp=(4, 16) if page.fast else (4, 16, 64),
            repeats=2 if page.fast else 4,
            reference_spp=64 if page.fast else 1024,
            denoise=True,
            samples=range(1),
        )
        cfg = small_cfg() if page.fast else json.loads((ROOT / CFG).read_text(encoding="utf-8"))
        cfg |= {"samples": 1, "batches": 1}
        for rig in cfg["rigs"].values():
            for sensor in rig["sensors"].values():
                sensor["resolution"] = [64, 48] if page.fast else [128, 96]
        # Beside the shipped ones, whose files it names.
        file = ROOT / "configs" / ".converge_example.json"
        file.write_text(json.dumps(cfg), encoding="utf-8")
        try:
            self.out = compile_cfg(file, seed=1, out=page.scratch / "out").out
        finally:
            file.unlink()
        self._found: ConvergeReport | None = None

    @property
    def found(self) -> ConvergeReport:
        """The report, made when it is first asked for."""
        if self._found is None:
            self._found = converge(self.out, BACKENDS, self.ladder)
        return self._found

    def show(self, name: str, what: str) -> str:
        """Copies a picture of the report; returns the Markdown that shows it."""
        source = self.out / "converge" / name
        path = self.page.picture(Path(name).stem)
        shutil.copyfile(source, path)
        return f"![{what}](pictures/{path.name})\n"

    def true_error(self, stem: Path, backend: str) -> str:
        """Of a frame, against the ladder's reference of its backend, with its 95 % interval."""
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

    def ladders(self) -> str:
        """Each backend against itself."""
        rows = [
            [series.name, *step_cells(step), f"{percent(step.low)} to {percent(step.high)}"]
            for series in self.found.series
            if series.own
            for step in series.steps
        ]
        header = ["backend", *STEP_HEADER, "rel. rms, 95 %"]
        frame = "small" if self.page.fast else f"`{CFG}`"
        text = f"## Each backend's convergence to itself\n\nOne frame of {frame}.\n\n"
        text += table(header, rows) + "\n" + self.show("convergence.png", "convergence")
        return text + "\nThe numbers:\n\n" + _items(f"`{k}`: {v}" for k, v in FORMULAS.items())

    def slopes(self) -> str:
        """What they mean."""
        rows = [
            [series.name, _slope(series.over_spp), _slope(series.over_seconds),
             series.over_spp.verdict]
            for series in self.found.series
            if series.own and series.over_spp is not None
        ]  # fmt: skip
        text = (
            "## Slopes\n\nOf log(error) over log(samples) and log(seconds), with 95 % intervals.\n"
        )
        text += "Independent samples have -1/2; a flatter slope is a finding.\n\n"
        text += table(["backend", "over samples", "over seconds", "over samples means"], rows)
        notes = [note for note in self.found.notes if "slope" not in note or "FINDING" in note]
        return text + "\n" + _items(notes)

    def floors(self) -> str:
        """What stays however many samples."""
        text = "## The floor between backends\n\nOf references, the noise of both subtracted (not "
        text += "from FLIP).\n\n"
        text += table(FLOOR_HEADER, [floor_cells(floor) for floor in self.found.floors]) + "\n"
        text += self.show("floor.png", "floor")
        for path in self.found.files:
            if path.parent.name == "differences" and path.stem.endswith("mitsuba_pyrender"):
                text += (
                    "\nTwo pictures, FLIP between them (black 0, white 0.5 and more), and where "
                )
                text += "annotation differs (red):\n\n"
                text += self.show(f"differences/{path.name}", "differences")
        return text

    def targets(self) -> str:
        """Rendered to an error, and for a time."""
        rows = []
        goals: list[dict[str, Any]] = [{"error": value} for value in ERRORS]
        goals += [{"seconds": value} for value in SECONDS]
        for number, goal in enumerate(goals):
            for backend in ("mitsuba", "cycles"):
                folder = self.out / "targets" / str(number)
                report = render(self.out, backend, passes=["rgb"], folder=folder, **goal)
                sidecar = read_frame(report.frames[0]).sidecar
                rounds, found = sidecar.rounds, sidecar.error
                assert rounds is not None
                asked = "--error" if "error" in goal else "--seconds"
                rows.append(
                    [
                        f"`--backend {backend} {asked} {next(iter(goal.values())):g}`",
                        str(sidecar.samples_per_pixel),
                        str(len(rounds.rounds)),
                        f"{rounds.seconds:.2f}",
                        percent(found.relative_rms),
                        percent(found.relative_rms_bound_95),
                        self.true_error(report.frames[0], backend),
                    ]
                )
        return "## To an error, or for a time\n\n" + table(
            ["asked", "samples", "rounds", "s", "estimate", "95 % bound", "true error (95 %)"], rows
        )

    def choice(self) -> str:
        """``--backend auto``."""
        asked = ["--error 0.1", "--error 0.01", "--seconds 2", "--spp 64"]
        goals: list[dict[str, Any]] = [{"error": 0.1}, {"error": 0.01}, {"seconds": 2.0},
                                       {"spp": 64}]  # fmt: skip
        text = "## `--backend auto`\n\n"
        for number, (words, goal) in enumerate(zip(asked, goals, strict=True)):
            lines: list[str] = []
            folder = self.out / "choices" / str(number)
            render(self.out, "auto", passes=["rgb"], folder=folder, say=lines.append, **goal)
            text += f"    scenec render OUT --backend auto --passes rgb {words} --replace\n"
            text += "".join(f"    {line}\n" for line in lines if line.startswith("auto:")) + "\n"
        return text

    def estimate(self) -> str:
        """How often the bound holds."""
        text = "## How often the bound holds\n\n"
        if not ESTIMATE.is_file():
            return (
                text + f"Not measured: `lab/benchmarks/estimate.py --json docs/{ESTIMATE.name}`.\n"
            )
        found = json.loads(ESTIMATE.read_text(encoding="utf-8"))
        text += f"Over {len(found['single'])} drawn scenes (`lab/benchmarks/estimate.py`): "
        text += "the share of pictures whose true error is below the 95 % bound that their halves "
        text += "give.\n\n"
        names = {
            "single": "one picture a scene, 8 to 64 samples",
            "pooled": "four pictures a scene, 8 to 64 samples",
            "adaptive": f"in rounds, `--error {found['error']:g}`",
        }
        rows = [
            [name, *share([t["true"] <= t["bound"] for t in found[key]])]
            for key, name in names.items()
        ]
        goal = [t["true"] <= found["error"] for t in found["adaptive"]]
        rows.append([f"in rounds: true error at most {found['error']:g}", *share(goal)])
        return text + table(["pictures", "hold", "share", "95 % interval"], rows)


def main(page: Page) -> None:
    """Writes the page."""
    one = Example(page)
    parts = (
        one.ladders, one.slopes, one.floors, one.targets, one.choice, one.estimate
    )  # fmt: skip
    packages = ("mitsuba", "bpy", "pyrender-maintained")
    page.write(HEAD, packages, [lambda _, part=part: part() for part in parts])


def _slope(fit: Any) -> str:
    if fit is None:
        return "-"
    sure = "" if fit.low is None else f" ({fit.low:.3f} to {fit.high:.3f})"
    return f"{fit.slope:.3f}{sure}"


def _items(lines: Any) -> str:
    return "".join(f"- {line}\n" for line in lines)


if __name__ == "__main__":
    run(main, page="converge")
