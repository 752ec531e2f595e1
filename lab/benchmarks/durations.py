"""Measures what the tests cost, by file.

    python lab/benchmarks/durations.py [--read FILE]

Runs the tests of ``make test`` with this module as a pytest plugin, or reads what an earlier run
left by ``pytest -p durations --durations-json FILE``; then prints a table and writes
``tests/durations.json``, by which ``tests/conftest.py`` begins with the longest files.

A test's cost is that of its process and of all processes below it from the end of the test before
to its own, its fixtures included. CPU seconds hold on a busy machine, too, more or less.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import time
from collections import defaultdict
from pathlib import Path
from typing import Any

import psutil
import pytest

ROOT = Path(__file__).resolve().parents[2]
#: Seconds of each file that takes at least three.
ORDER = ROOT / "tests" / "durations.json"
MARKED = "not slow or invariant"
FILES = 30


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
        self._tests: list[dict[str, Any]] = []
        self._last = self._clocks()

    def _clocks(self) -> dict[str, float]:
        times = os.times()
        return {
            "wall_s": time.perf_counter(),
            "cpu_s": times.user + times.system,
            "children_s": times.children_user + times.children_system + living_children(),
        }

    def _since(self) -> dict[str, float]:
        before, self._last = self._last, self._clocks()
        return {name: round(now - before[name], 4) for name, now in self._last.items()}

    def pytest_collection_finish(self) -> None:
        self._since()

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_makereport(self, item: pytest.Item, call: pytest.CallInfo[None]) -> Any:
        report = yield
        if call.when == "teardown":
            report.cost = self._since()
        return report

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        if hasattr(report, "cost"):
            self._tests.append({"test": report.nodeid} | report.cost)

    def pytest_sessionfinish(self) -> None:
        if not hasattr(self._config, "workeroutput"):
            self._config.option.durations_json.write_text(json.dumps(self._tests, indent=0))


def living_children() -> float:
    """CPU seconds of all living processes below this one, and of those they outlived."""
    found = 0.0
    for child in psutil.Process().children(recursive=True):
        try:
            found += sum(child.cpu_times()[:4])
        except psutil.Error:
            continue  # It has ended meanwhile; its parent counts it.
    return found


# As a script


def main() -> int:
    """Measures unless told what to read, prints the table, writes the order; pytest's status."""
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
    files: dict[str, list[float]] = defaultdict(lambda: [0, 0.0, 0.0, 0.0])
    for test in json.loads(path.read_text()):
        cost = (1, test["cpu_s"], test["children_s"], test["wall_s"])
        row = files[test["test"].partition("::")[0]]
        row[:] = [had + more for had, more in zip(row, cost, strict=True)]
    print("tests  CPU s  of processes below  wall s  file")
    most = sorted(files.items(), key=lambda item: -item[1][1] - item[1][2])
    for name, (count, own, below, wall) in most[:FILES]:
        print(f"{count:5}  {own + below:5.1f}  {below:18.1f}  {wall:6.1f}  {name}")
    order = {name: round(row[3]) for name, row in sorted(files.items()) if row[3] >= 3.0}
    ORDER.write_text(json.dumps(order, indent=1) + "\n", encoding="utf-8")
    print(f"wrote {ORDER.relative_to(ROOT)}")
    return status


if __name__ == "__main__":
    sys.exit(main())
