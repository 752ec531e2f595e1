"""Benchmarks of adapters beside bare scripts compare the same pictures."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from scenec.compiler.compile import compile_cfg
from scenec.testing.small import small_cfg, write_cfg

BENCH = Path(__file__).resolve().parents[2] / "lab" / "benchmarks" / "adapters.py"


@pytest.mark.slow
def test_adapter_and_bare_script_draw_one_picture_whatever_the_number_of_samples(tmp_path):
    pytest.importorskip("bpy")
    cfg = small_cfg(samples=3)
    # What the bare script does not know.
    cfg["materials"]["gravel"]["maps"] = {"procedural": {"type": "gravel", "resolution": 64}}
    cfg["light"]["haze"] = {"visibility_m": 50}
    cfg["light"]["lamps"] = {"spot": {"mount": {"type": "rig", "rig": "rover"}, "intensity": 5000}}
    compile_cfg(write_cfg(tmp_path, cfg), seed=1, out=tmp_path / "out")
    stage = tmp_path / "out" / "batch_0000" / "stage.usda"
    command = [sys.executable, str(BENCH), "--backends", "cycles", "--stage", str(stage)]
    command += ["--spp", "16", "--rounds", "3"]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert "mean radiance" in done.stdout


@pytest.mark.slow
def test_a_shipped_cfg_is_held_against_its_plain_self_and_the_bare_script():
    pytest.importorskip("bpy")
    command = [sys.executable, str(BENCH), "--shipped", "jacksboro", "--fast"]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    rows = [line.split(" | ") for line in done.stdout.splitlines() if "| jacksboro" in line]
    assert {row[1] for row in rows} == {"mitsuba", "cycles"}
    assert all(float(cell.rstrip(" |%")) > 0.0 for row in rows for cell in row[3:])
