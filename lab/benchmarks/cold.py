"""Times the first minute: seconds until each command answers, with and without kernels.

    python lab/benchmarks/cold.py [--cfg FILE]

``--help`` and a faulty cfg, which need no kernel; then, per step (compile, a frame of the stage by
``annotation`` and by ``mitsuba``), in processes and with a folder of kernels of its own: first with
nothing in it, then again with what the first left there, as an installed wheel has it. Then the
kernels that cost most to compile, without what they call. A kernel that is compiled in the second
run, too, is counted: there should be none.
"""

from __future__ import annotations

import json
import os
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path

from scenec.lab.runner import SCENEC, Cell, Study, command, run
from scenec.testing.small import small_cfg

#: By step, what follows the command; the output folder stands before it.
STEPS = {
    "compile": ["--seed", "1", "--no-cache"],
    "annotation": ["--passes", "depth,label,instance", "--samples", "0"],
    "mitsuba": ["--passes", "depth,label,instance,rgb", "--spp", "2", "--samples", "0"],
}
#: Noted in every process (``sitecustomize``): each kernel compiled, in CPU seconds of its own.
_NOTES = """
import json, os, time
from numba.core import event

class Notes(event.Listener):
    def __init__(self):
        self.open = []
    def on_start(self, e):
        self.open.append([time.process_time(), 0.0])
    def on_end(self, e):
        start, inner = self.open.pop()
        spent = time.process_time() - start
        if self.open:
            self.open[-1][1] += spent
        kernel = e.data["dispatcher"]
        name = f"{kernel.py_func.__module__}.{kernel.py_func.__qualname__}"
        with open(f"{os.environ['BENCH_COLD_NOTES']}.{os.getpid()}", "a") as file:
            file.write(json.dumps([name, spent - inner]) + "\\n")

event.register("numba:compile", Notes())
"""


def notes_of(place: Path) -> list[tuple[str, float]]:
    """Reads the notes of all processes: kernel and CPU seconds."""
    return [
        tuple(json.loads(line))
        for file in sorted(place.parent.glob(f"{place.name}.*"))
        for line in file.read_text(encoding="utf-8").splitlines()
    ]


def steps(study: Study, cfg: Path, spent: dict[str, float]) -> Iterator[list[Cell]]:
    """The rows; adds up what kernels take."""
    folder = study.scratch
    (folder / "sitecustomize.py").write_text(_NOTES, encoding="utf-8")
    for step, more in list(STEPS.items())[: 2 if study.fast else 3]:
        for cache in ("empty", "full"):
            out, notes = folder / f"out_{cache}", folder / f"{step}_{cache}"
            words: list[str | Path] = ["compile", cfg, "-o", out]
            if step != "compile":
                words = ["render", out, "--backend", step]
            cost = command(
                [*SCENEC, *words, *more],
                NUMBA_CACHE_DIR=str(folder / f"numba_{step}"),
                BENCH_COLD_NOTES=str(notes),
                PYTHONPATH=os.pathsep.join([str(folder), os.environ.get("PYTHONPATH", "")]),
            )
            found = notes_of(notes)
            for name, seconds in found:
                spent[name] += seconds
            yield [step, cache, cost.wall_s, cost.cpu_s, len(found)]


def main(study: Study) -> None:
    """Prints both tables."""
    cfg = Path(study.options.cfg or study.cfg(small_cfg(samples=1))).resolve()
    slip = study.scratch / "slip.json"
    slip.write_text(cfg.read_text(encoding="utf-8").replace('"samples"', '"samplez"'), "utf-8")
    answers = {"--help": command([*SCENEC, "--help"])}
    words = [*SCENEC, "compile", slip, "--seed", "1", "-o", study.scratch / "none"]
    answers["compile, a faulty cfg"] = command(words, status=2)
    rows = ([name, cost.wall_s, cost.cpu_s] for name, cost in answers.items())
    study.table(["scenec", "wall s", "CPU s"], rows)
    spent: dict[str, float] = defaultdict(float)
    header = ["step", "kernels", "wall s", "CPU s", "kernels compiled"]
    study.table(header, steps(study, cfg, spent))
    most = sorted(spent.items(), key=lambda item: -item[1])[:10]
    study.table(["costliest kernels", "CPU s of their own"], map(list, most))


if __name__ == "__main__":
    run(main, cfg=Path)
