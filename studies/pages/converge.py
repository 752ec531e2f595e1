"""Writes docs/converge.md: error against run time of three renderers, and what follows from it.

python studies/pages/converge.py [--fast] [--out FOLDER]

Renders one frame of configs/mars_yard.json, 128 x 96, up a ladder of samples per pixel, with and
without denoising, each rung from four noise seeds; then to an error, for a time, and with the
backend that the measured curves choose. How often the bound of an error holds takes longer to
measure: the page shows what studies/benchmarks/estimate.py left in docs/converge_estimate.json.
"""

from __future__ import annotations

import json
import shutil
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from page import ROOT, Page, table
from scipy.stats import binomtest
from small import small_cfg

from scenec.backends.run.render import render
from scenec.compiler.compile import compile_cfg
from scenec.schemas.frames import read_frame
from scenec.studies.converge import ConvergeReport, Ladder, converge
from scenec.studies.converge.metrics import FORMULAS, Reference, root, square_and_error
from scenec.studies.converge.run import NORMAL_95

CFG = "configs/mars_yard.json"
BACKENDS = ("mitsuba", "cycles", "pyrender")
#: Written by ``estimate.py --json``.
ESTIMATE = ROOT / "docs" / "converge_estimate.json"
ERRORS = (0.1, 0.03)
SECONDS = (1.0, 4.0)
HEAD = """# Error against run time

Written by `studies/pages/converge.py` (`make docs`) on {cores} cores with {versions};
seconds are those of that machine, errors follow from the code and the seeds.

    scenec converge OUT --backends mitsuba,cycles,pyrender --denoise

renders a ladder of qualities per backend against a reference of many samples, whose own noise is
subtracted, and writes tables (CSV, JSON), plots and pictures of differences into `OUT/converge/`.
"""


class Example:
    """One frame, and what was measured on it."""

    def __init__(self, page: Page, folder: Path) -> None:
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
            self.out = compile_cfg(file, seed=1, out=folder / "out").out
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
        folder = self.out / "converge" / "pictures" / "batch_0000" / backend / "annotation"
        first, second = (
            read_frame(folder / name / "frames" / backend / stem.parent.name / stem.name)
            for name in ("first", "second")
        )
        on = first.passes["depth"] < float("inf")
        reference = Reference.of_two(*(one.passes["rgb"][on] for one in (first, second)))
        square, error = square_and_error(frame.passes["rgb"][on], reference)
        low, high = (root(square + sign * NORMAL_95 * error) or 0.0 for sign in (-1, 1))
        return f"{_percent(root(square))} ({_percent(low)} to {_percent(high)})"

    def ladders(self) -> str:
        """Each backend against itself."""
        rows = [
            [
                series.name,
                f"{step.spp:g}",
                f"{step.seconds:.2f}",
                _percent(step.mean),
                "" if step.mean is None else f"{_percent(step.low)} to {_percent(step.high)}",
                _percent(step.estimated),
                f"{step.relative_mse:.2g}",
                f"{step.relative_mse_trimmed:.2g}",
                "-" if step.flip is None else f"{step.flip:.4f}",
                f"{100 * step.bias:+.3f} %"
                + ("" if step.bias_error is None else f" ± {100 * step.bias_error:.3f}"),
            ]
            for series in self.found.series
            if series.own
            for step in series.steps
        ]
        header = ["backend", "samples", "s", "relative rms", "95 %", "as the picture's halves tell",
                  "relMSE", "trimmed", "FLIP", "bias"]  # fmt: skip
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
        rows = [
            [
                f"{floor['backend']} : {floor['against']}",
                _percent(floor["relative_rms"]),
                f"{_percent(floor['relative_rms_low'])} to {_percent(floor['relative_rms_high'])}",
                f"{floor['relative_mse']:.2g}",
                "-" if floor["flip"] is None else f"{floor['flip']:.4f}",
                f"{100 * floor['bias']:+.3f} %",
            ]
            for floor in self.found.floors
        ]
        text = "## The floor between backends\n\nOf references, the noise of both subtracted (not "
        text += "from FLIP).\n\n"
        text += table(["backends", "relative rms", "95 %", "relMSE", "FLIP", "bias"], rows) + "\n"
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
                rounds, found = sidecar["rounds"], sidecar["estimated_error"]
                asked = "--error" if "error" in goal else "--seconds"
                rows.append(
                    [
                        f"`--backend {backend} {asked} {next(iter(goal.values())):g}`",
                        str(sidecar["samples_per_pixel"]),
                        str(len(rounds["rounds"])),
                        f"{rounds['seconds']:.2f}",
                        _percent(found["relative_rms"]),
                        _percent(found["relative_rms_bound_95"]),
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
            text += f"    scenec render OUT --backend auto --passes rgb {words}\n"
            text += "".join(f"    {line}\n" for line in lines if line.startswith("auto:")) + "\n"
        return text

    def estimate(self) -> str:
        """How often the bound holds."""
        text = "## How often the bound holds\n\n"
        if not ESTIMATE.is_file():
            return (
                text
                + f"Not measured: `studies/benchmarks/estimate.py --json docs/{ESTIMATE.name}`.\n"
            )
        found = json.loads(ESTIMATE.read_text(encoding="utf-8"))
        text += f"Over {len(found['single'])} drawn scenes (`studies/benchmarks/estimate.py`): "
        text += "the share of pictures whose true error is below the 95 % bound that their halves "
        text += "give.\n\n"
        names = {
            "single": "one picture a scene, 8 to 64 samples",
            "pooled": "four pictures a scene, 8 to 64 samples",
            "adaptive": f"in rounds, `--error {found['error']:g}`",
        }
        rows = [
            [name, *_share([t["true"] <= t["bound"] for t in found[key]])]
            for key, name in names.items()
        ]
        goal = [t["true"] <= found["error"] for t in found["adaptive"]]
        rows.append([f"in rounds: true error at most {found['error']:g}", *_share(goal)])
        return text + table(["pictures", "hold", "share", "95 % interval"], rows)


def main() -> None:
    """Writes the page."""
    page = Page.of_command_line("converge")
    with tempfile.TemporaryDirectory() as folder:
        example = Example(page, Path(folder))
        page.write(
            HEAD,
            ("mitsuba", "bpy", "pyrender-maintained"),
            [example.ladders, example.slopes, example.floors, example.targets,
             example.choice, example.estimate],
        )  # fmt: skip


def _percent(value: float | None) -> str:
    return "-" if value is None else f"{100 * value:.3g} %"


def _slope(fit: Any) -> str:
    if fit is None:
        return "-"
    sure = "" if fit.low is None else f" ({fit.low:.3f} to {fit.high:.3f})"
    return f"{fit.slope:.3f}{sure}"


def _share(held: Sequence[bool]) -> list[str]:
    """Count, share and its interval (Clopper and Pearson 1934)."""
    if not held:
        return ["0 of 0", "-", "-"]
    interval = binomtest(sum(held), len(held)).proportion_ci(0.95)
    return [
        f"{sum(held)} of {len(held)}",
        f"{100 * sum(held) / len(held):.1f} %",
        f"{100 * interval.low:.1f} to {100 * interval.high:.1f} %",
    ]


def _items(lines: Any) -> str:
    return "".join(f"- {line}\n" for line in lines)


if __name__ == "__main__":
    main()
