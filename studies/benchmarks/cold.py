"""What the first run costs: wall and CPU seconds with an empty and with a full cache of numba's.

    python studies/benchmarks/cold.py [CFG]

Per step (compile, then a frame of the stage by ``reference`` and by ``mitsuba``), in processes and
with a cache folder of its own: first with nothing in it, then again with what the first
left there. Then the kernels that cost most to compile, without what they call. A kernel that is
compiled in the second run, too, is counted: there should be none.
"""

from __future__ import annotations

import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from collections import defaultdict
from pathlib import Path

HERE = Path(__file__).resolve().parent
STEPS = ("compile", "reference", "mitsuba")
PASSES = ["depth", "label", "instance"]

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
        note = [name, bool(kernel.targetoptions.get("parallel")), spent - inner]
        with open(f"{os.environ['BENCH_COLD_NOTES']}.{os.getpid()}", "a") as file:
            file.write(json.dumps(note) + "\\n")

event.register("numba:compile", Notes())
"""


def do(step: str, cfg: str, out: str) -> None:
    """One step, in this process (and the workers it starts)."""
    if step == "compile":
        from scenec.compiler.compile import compile_cfg

        compile_cfg(cfg, seed=1, out=out)
        return
    from scenec.backends.run.render import render

    passes = [*PASSES, "rgb"] if step == "mitsuba" else PASSES
    render(out, step, spp=2, passes=passes, samples=[0])


def timed(step: str, cfg: Path, folder: Path, out: Path, notes: Path) -> tuple[float, float]:
    """Wall and CPU seconds of a step in a process of its own."""
    paths = [str(folder / "site"), *filter(None, [os.environ.get("PYTHONPATH")])]
    environment = {
        **os.environ,
        "SCENEC_CACHE": "",
        "NUMBA_CACHE_DIR": str(folder / f"numba_{step}"),
        "BENCH_COLD_NOTES": str(notes),
        "PYTHONPATH": os.pathsep.join(paths),
    }
    before, start = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
    subprocess.run(
        [sys.executable, __file__, step, str(cfg), str(out)], env=environment, check=True
    )
    wall, after = time.perf_counter() - start, resource.getrusage(resource.RUSAGE_CHILDREN)
    return wall, after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def read_notes(notes: Path) -> list[tuple[str, bool, float]]:
    """Of all processes: name, whether numba's own threads are used, CPU seconds."""
    lines = [
        json.loads(line)
        for file in sorted(notes.parent.glob(f"{notes.name}.*"))
        for line in file.read_text(encoding="utf-8").splitlines()
    ]
    return [(name, parallel, spent) for name, parallel, spent in lines]


def small(folder: Path) -> Path:
    """The tests' small cfg, one sample."""
    sys.path.insert(0, str(HERE.parents[1] / "tests"))
    from small import small_cfg, write_cfg

    return write_cfg(folder, small_cfg(samples=1))


def main() -> None:
    """Measures and prints."""
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        (folder / "site").mkdir()
        (folder / "site" / "sitecustomize.py").write_text(_NOTES, encoding="utf-8")
        cfg = Path(sys.argv[1]).resolve() if len(sys.argv) > 1 else small(folder)
        print("step        cache   wall s   CPU s   compiled   of these parallel")
        spent: dict[str, float] = defaultdict(float)
        for step in STEPS:
            for cache in ("empty", "full"):
                out = folder / f"out_{cache}"
                notes = folder / f"{step}_{cache}"
                wall, cpu = timed(step, cfg, folder, out, notes)
                found = read_notes(notes)
                for name, _, seconds in found:
                    spent[name] += seconds
                threads = sum(parallel for _, parallel, _ in found)
                print(
                    f"{step:10}  {cache:5}  {wall:7.1f} {cpu:7.1f} {len(found):10d} {threads:19d}",
                    flush=True,
                )
        print("\nCostliest kernels, CPU seconds of their own")
        for name, seconds in sorted(spent.items(), key=lambda item: -item[1])[:10]:
            print(f"{seconds:6.2f}  {name}")


if __name__ == "__main__":
    if len(sys.argv) == 4:
        do(*sys.argv[1:])
    else:
        main()
