"""What the tests cost, by file and by cause.

    python studies/benchmarks/durations.py [--read FILE]

Runs the tests of ``make test`` with this module as a pytest plugin, or reads what an earlier run
left by ``pytest -p durations --durations-json FILE``; then writes ``docs/tests.md`` and
``tests/durations.json``, by which ``tests/conftest.py`` begins with the longest files.

A test's cost is that of its process and of all processes below it from the end of the test before
to its own, its fixtures included.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import threading
import time
from collections import defaultdict
from pathlib import Path
from typing import Any

import pytest
from numba.core import event

ROOT = Path(__file__).resolve().parents[2]
PAGE = ROOT / "docs" / "tests.md"
#: Seconds of each file that takes at least three.
ORDER = ROOT / "tests" / "durations.json"
MARKED = "not slow or invariant"
FILES = 30
CAUSES = {
    "start": "starts of the test processes: imports, collection",
    "kernels": "kernels: numba compiles them or reads them from its cache",
    "renderer": "Mitsuba's kernels: Dr.Jit traces and compiles them",
    "children": "processes that tests start: renderers' workers, command lines",
    "hypothesis": "property tests (hypothesis), their kernels aside",
    "rest": "everything else",
}


# As a plugin


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--durations-json", metavar="FILE", type=Path, help="what each test costs")


def pytest_configure(config: pytest.Config) -> None:
    if config.option.durations_json:
        config.pluginmanager.register(Meter(config))


class Meter:
    """Measures where tests run (pytest-xdist's workers), writes where their reports arrive."""

    def __init__(self, config: pytest.Config) -> None:
        self._config = config
        self._begun = time.time()
        self._start_cpu_s = 0.0
        self._tests: list[dict[str, Any]] = []
        self._kernels = Kernels()
        self._last = dict.fromkeys(self._clocks(), 0.0)
        # Nothing removes an audit hook: it counts for as long as the process lives.
        self._started = 0
        sys.addaudithook(self._count_starts)

    def _count_starts(self, name: str, _: tuple[Any, ...]) -> None:
        self._started += name in ("subprocess.Popen", "os.posix_spawn")

    def _clocks(self) -> dict[str, float]:
        times = os.times()
        return {
            "wall_s": time.perf_counter(),
            "cpu_s": times.user + times.system,
            "children_s": times.children_user + times.children_system + living_children(),
            "kernels_s": self._kernels.seconds,
        }

    def _since(self) -> dict[str, float]:
        before, self._last = self._last, self._clocks()
        return {name: round(now - before[name], 4) for name, now in self._last.items()}

    def pytest_collection_finish(self) -> None:
        self._start_cpu_s += self._since()["cpu_s"]

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_makereport(self, item: pytest.Item, call: pytest.CallInfo[None]) -> Any:
        report = yield
        if call.when == "teardown":
            started, self._started = self._started, 0
            report.cost = self._since() | {
                "renderer_s": round(drjit_seconds(), 4),
                "processes": started,
                "property": hasattr(getattr(item, "obj", None), "hypothesis"),
                "worker": os.environ.get("PYTEST_XDIST_WORKER", "main"),
                "end_s": round(time.time(), 2),
            }
        return report

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        if hasattr(report, "cost"):
            self._tests.append({"test": report.nodeid} | report.cost)

    @pytest.hookimpl(optionalhook=True)
    def pytest_testnodedown(self, node: Any) -> None:
        self._start_cpu_s += node.workeroutput.get("start_cpu_s", 0.0)

    def pytest_sessionfinish(self) -> None:
        if hasattr(self._config, "workeroutput"):
            self._config.workeroutput["start_cpu_s"] = self._start_cpu_s
            return
        data = {
            "wall_s": round(time.time() - self._begun, 2),
            "start_cpu_s": round(self._start_cpu_s, 2),
            "tests": self._tests,
        }
        self._config.option.durations_json.write_text(json.dumps(data, indent=0))


class Kernels(event.Listener):
    """CPU seconds of numba's compiler and cache; compilations within another count once."""

    def __init__(self) -> None:
        self.seconds = 0.0
        self._thread = threading.local()
        event.register("numba:compiler_lock", self)

    def on_start(self, event: Any) -> None:
        self._thread.depth = getattr(self._thread, "depth", 0) + 1
        if self._thread.depth == 1:
            self._thread.start = time.thread_time()

    def on_end(self, event: Any) -> None:
        self._thread.depth -= 1
        if self._thread.depth == 0:
            self.seconds += time.thread_time() - self._thread.start


def drjit_seconds() -> float:
    """Seconds Dr.Jit has compiled since the last call; its first test goes uncounted."""
    drjit = sys.modules.get("drjit")
    if drjit is None or not hasattr(drjit, "kernel_history"):
        return 0.0
    if not drjit.flag(drjit.JitFlag.KernelHistory):
        drjit.set_flag(drjit.JitFlag.KernelHistory, True)
        return 0.0
    times = [
        k.get("codegen_time", 0.0) + k.get("backend_time", 0.0) for k in drjit.kernel_history()
    ]
    return sum(times) / 1000.0


def living_children() -> float:
    """CPU seconds of all living processes below this one, and of those they outlived."""
    ticks, below = 0, [os.getpid()]
    while below:
        for file in Path("/proc", str(below.pop()), "task").glob("*/children"):
            try:
                for child in file.read_text().split():
                    fields = Path("/proc", child, "stat").read_text().rpartition(")")[2].split()
                    ticks += sum(map(int, fields[11:15]))
                    below.append(int(child))
            except OSError:
                continue  # It has ended meanwhile; its parent counts it.
    return ticks / os.sysconf("SC_CLK_TCK")


# As a script

HEAD = """<!-- Generated by studies/benchmarks/durations.py. Do not edit. -->

# What the tests cost

    python studies/benchmarks/durations.py

runs the tests of `make test`, in two processes, and writes this page; kernels that are not there
yet are compiled in it. A test's cost is that of its process and of all processes below it. CPU
seconds hold on a busy machine, too, more or less; wall-clock seconds do not.

"""


def causes(test: dict[str, Any]) -> dict[str, float]:
    """CPU seconds of a test by cause."""
    kernels = min(test["kernels_s"], test["cpu_s"])
    renderer = min(test["renderer_s"], test["cpu_s"] - kernels)
    return {
        "kernels": kernels,
        "renderer": renderer,
        "children": test["children_s"],
        "hypothesis" if test["property"] else "rest": test["cpu_s"] - kernels - renderer,
    }


def summed(tests: list[dict[str, Any]]) -> dict[str, float]:
    """CPU seconds of tests by cause."""
    total = dict.fromkeys(CAUSES, 0.0)
    for test in tests:
        for cause, seconds in causes(test).items():
            total[cause] += seconds
    return total


def page(run: dict[str, Any], files: dict[str, list[dict[str, Any]]]) -> str:
    """The whole page."""
    total = summed(run["tests"])
    total["start"] = run["start_cpu_s"]
    ends = defaultdict(float)
    for test in run["tests"]:
        ends[test["worker"]] = max(ends[test["worker"]], test["end_s"])
    lines = [
        f"{len(run['tests'])} tests, {sum(total.values()) / 60:.1f} CPU minutes, "
        f"{run['wall_s'] / 60:.1f} minutes; the first of {len(ends)} processes ended "
        f"{max(ends.values()) - min(ends.values()):.0f} s before the last.\n",
        "## By cause\n",
        "| cause | CPU s |",
        "|---|---:|",
        *(f"| {CAUSES[cause]} | {seconds:.0f} |" for cause, seconds in total.items()),
        f"\n## By file, the {FILES} with the most CPU seconds\n",
        "| file | tests | CPU s | wall s | most of it |",
        "|---|---:|---:|---:|---|",
    ]
    by_file = {file: summed(tests) for file, tests in files.items()}
    most = sorted(by_file, key=lambda file: -sum(by_file[file].values()))[:FILES]
    for file in most:
        cost = by_file[file]
        cause = max(cost, key=lambda name: cost[name])
        lines.append(
            f"| `{file}` | {len(files[file])} | {sum(cost.values()):.1f} "
            f"| {sum(test['wall_s'] for test in files[file]):.1f} "
            f"| {CAUSES[cause].partition(':')[0]}, {cost[cause]:.1f} |"
        )
    return HEAD + "\n".join(lines) + "\n"


def main() -> int:
    """Measures unless told what to read, writes page and order; pytest's exit status."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--read", type=Path, help="what an earlier run left")
    path, status = parser.parse_args().read, 0
    if path is None:
        path = ROOT / ".pytest_cache" / "durations.json"
        path.parent.mkdir(exist_ok=True)
        options = ["-n", "2", "--dist", "loadfile", "--no-loadscope-reorder", "-m", MARKED]
        command = ["-m", "pytest", "-p", "durations", "--durations-json", str(path), *options]
        environment = os.environ | {"PYTHONPATH": str(Path(__file__).parent)}
        status = subprocess.run([sys.executable, *command], cwd=ROOT, env=environment).returncode
    run = json.loads(path.read_text())
    files = defaultdict(list)
    for test in run["tests"]:
        files[test["test"].partition("::")[0]].append(test)
    seconds = {file: sum(test["wall_s"] for test in files[file]) for file in sorted(files)}
    order = {file: round(wall) for file, wall in seconds.items() if wall >= 3.0}
    ORDER.write_text(json.dumps(order, indent=1) + "\n", encoding="utf-8")
    PAGE.write_text(page(run, files), encoding="utf-8")
    print(f"wrote {PAGE.relative_to(ROOT)} and {ORDER.relative_to(ROOT)}")
    return status


if __name__ == "__main__":
    sys.exit(main())
