"""``scenec run``: all that the cfg asks for is there when it ends."""

from __future__ import annotations

import json

import pytest

from scenec.cli.main import main
from scenec.testing.small import small_cfg, write_cfg


@pytest.mark.usefixtures("worker_here")
def test_it_compiles_renders_and_scans(tmp_path, capsys):
    cfg = small_cfg(samples=1, outputs=["depth"])
    cfg["rigs"]["rover"]["lidars"] = {
        "top": {"beams": 4, "elevation_deg": [5, -25], "azimuths": 30, "range_m": [0.2, 30]}
    }
    out = tmp_path / "out"
    words = ["run", str(write_cfg(tmp_path, cfg)), "--seed", "1", "-o", str(out), "--json"]
    assert main([*words, "--backend", "reference"]) == 0
    made = json.loads(capsys.readouterr().out)
    assert made.keys() == {"compile", "scan", "render"}
    assert made["scan"]["made"] == made["render"]["rendered"] == 1
    assert (out / "batch_0000" / "scans" / "rover_top" / "000000.npz").is_file()
    assert (out / "batch_0000" / "frames" / "annotation" / "rover_front" / "000000.exr").is_file()
