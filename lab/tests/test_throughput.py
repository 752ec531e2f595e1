"""The benchmark of throughput counts frames, and says what bounds them."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from scenec.lab.benchmarks.gpu import most_gib
from scenec.lab.benchmarks.throughput import Case, at_most, least

BENCH = Path(__file__).resolve().parents[2] / "lab" / "benchmarks" / "throughput.py"


def case(**more: object) -> Case:
    # Eight frames: workers start for 10 s, the first four take 2 s each, the others 1 s.
    done = [12.0, 14.0, 16.0, 18.0, 19.0, 20.0, 21.0, 22.0]
    return Case(**{"start_s": 2.0, "done_s": done, "cpu_s": [3.0 * s for s in done]} | more)


def test_the_start_counts_in_all_and_steady_is_the_second_half():
    assert case().rate == pytest.approx(8 / 20)
    assert case().steady_s == pytest.approx(1.0)
    assert case().steady_cpu_s == pytest.approx(3.0)


def test_the_gpu_is_busy_as_often_as_it_was_seen_to_be_in_the_second_half():
    looks = [(5.0, 0.0, 100.0), (17.0, 100.0, 3172.0), (19.0, 40.0, 2148.0), (21.0, 20.0, 2148.0)]
    assert case(gpu=looks).busy == pytest.approx(0.3)
    assert most_gib(looks) == pytest.approx(3.0)
    assert case().busy is None


def test_what_a_worker_does_once_is_told_of_the_frames_that_did_it():
    phases = [{"load": 4.0, "radiance": 3.0}, *[{"load": 3e-6, "radiance": 1.0}] * 4]
    assert case(phases=phases).median("load") == pytest.approx(4.0)
    assert case(phases=phases).median("radiance") == pytest.approx(1.0)


def test_the_rest_of_a_workers_time_is_what_no_phase_took():
    late = case(phases=[*[{"radiance": 9.0}] * 4, *[{"radiance": 1.2, "write": 0.3}] * 4])
    assert late.rest_s(1) == pytest.approx(1.0 - 1.5)
    assert late.rest_s(2) == pytest.approx(2.0 - 1.5)


def test_frames_a_second_are_bounded_by_cores_or_by_the_gpu():
    assert at_most(0.5, 0.0, 16) == pytest.approx(32.0)
    assert at_most(0.5, 0.1, 2) == pytest.approx(4.0)
    assert at_most(0.5, 0.1, 16) == pytest.approx(10.0)
    looks = [(19.0, 50.0, 0.0)]
    hurried = case(gpu=looks, cpu_s=[1.0 * s for s in range(8)])
    assert least([case(gpu=[(19.0, 80.0, 0.0)]), hurried]) == pytest.approx((1.0, 0.5))


@pytest.mark.slow
def test_the_script_renders_what_it_counts():
    done = subprocess.run(
        [sys.executable, str(BENCH), "--fast", "--backends", "annotation"],
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    first, phases, bound, units = (
        part.splitlines()[2].strip("| ").split(" | ")
        for part in done.stdout.split("\n\n")
        if part.startswith("|")
    )
    assert first[:4] == ["annotation", "cpu", "1", "2"]
    assert all(float(cell.replace(",", "")) > 0.0 for cell in first[4:9])
    assert float(phases[1]) > 0.0
    assert float(bound[2]) > 0.0
    assert float(units[1]) > 0.0
